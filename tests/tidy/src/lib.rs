//! The rules of the design page as checks over the repository, so that they cannot rot.
//!
//! - **What:** a [`Tree`] holds the text files of a repository; each check takes it and returns what it finds wrong
//!   as [`Problem`]s that say what, where and how to mend it. No problem means that the rule holds.
//! - **Walk:** none. [`readme_walk`] reads the walk of one packet out of the README for the test that replays it.
//! - **Invariants:** a check reads only the tree, so it can be shown to fail on a small bad tree in memory. A check that
//!   finds nothing to look at says so as a problem: it never passes on an empty set.
//! - **Context:** `cargo test -p tidy`; the same tests run within a plain `cargo test`.
//!
//! ```
//! use tidy::{Tree, modules};
//!
//! let tree = Tree::from_files(&[("sim/src/world.rs", "pub struct World;\n")]);
//! let found = modules::have_docs(&tree);
//! assert_eq!(found[0].to_string(), "sim/src/world.rs:1: the module has no docs of its own; begin the file with `//!`");
//! ```
#![forbid(unsafe_code)]

pub mod chips;
pub mod clauses;
pub mod dependencies;
pub mod facts;
pub mod manifest;
pub mod modules;
pub mod problem;
pub mod sizes;
pub mod tree;
pub mod walk;
pub mod words;

pub use problem::Problem;
pub use tree::Tree;
pub use walk::{WalkError, readme_walk};

//! What has to stand at the top of files: no unsafe code, no standard library in the cores, docs in every module.

use crate::dependencies::CORES;
use crate::manifest::{self, Member, Place};
use crate::problem::Problem;
use crate::tree::{File, Tree};

/// The root of every library and binary says `#![forbid(unsafe_code)]`, but for those of boards and images, which reach
/// registers; [`crate::chips`] has what they owe for it.
#[must_use]
pub fn forbid_unsafe(tree: &Tree) -> Vec<Problem> {
    let mend = "put `#![forbid(unsafe_code)]` below the docs of the crate";
    per_member(tree, |member| {
        if member.roots.is_empty() {
            let what = format!("`{}` has no library or binary whose attributes could be checked", member.name);
            return vec![Problem::in_file(&member.manifest, what, "add src/lib.rs or src/main.rs")];
        }
        if member.place() != Place::Host {
            return Vec::new();
        }
        let lacks = |file: &&File| !file.facts.as_ref().is_some_and(|facts| facts.forbids_unsafe);
        let roots = member.roots.iter().filter_map(|root| tree.file(root)).filter(lacks);
        roots.map(|file| Problem::at(&file.path, 1, "the crate does not forbid unsafe code", mend)).collect()
    })
}

/// The library of every core says `#![no_std]`, at least outside of its tests.
#[must_use]
pub fn cores_are_no_std(tree: &Tree) -> Vec<Problem> {
    let mend = "put `#![no_std]` below the docs of the crate: it runs on microcontrollers";
    per_member(tree, |member| {
        let root = format!("{}/src/lib.rs", member.folder);
        let is_no_std = tree.file(&root).and_then(|file| file.facts.as_ref()).is_some_and(|facts| facts.no_std);
        if is_no_std || !CORES.contains(&member.name.as_str()) {
            return Vec::new();
        }
        vec![Problem::at(root, 1, format!("`{}` is a core and is not `no_std`", member.name), mend)]
    })
}

/// Every Rust file under a `src` folder begins with docs of its own.
#[must_use]
pub fn have_docs(tree: &Tree) -> Vec<Problem> {
    let begins_with_docs = |file: &File| {
        file.text.lines().find(|line| !line.trim().is_empty()).is_some_and(|line| line.starts_with("//!"))
    };
    let lacking = tree.rust_files().filter(|file| file.lies_in("src") && !begins_with_docs(file));
    lacking
        .map(|file| Problem::at(&file.path, 1, "the module has no docs of its own", "begin the file with `//!`"))
        .collect()
}

/// Runs `check` on each member; a manifest that cannot be used is a problem too.
fn per_member(tree: &Tree, check: impl Fn(&Member) -> Vec<Problem>) -> Vec<Problem> {
    let (members, mut problems) = manifest::members(tree);
    problems.extend(members.iter().flat_map(check));
    problems
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One member in `folder` whose `root` file has `text`.
    fn tree(folder: &str, name: &str, root: &str, text: &str) -> Tree {
        Tree::from_files(&[
            ("Cargo.toml", &format!("[workspace]\nmembers = [{folder:?}]\n")),
            (&format!("{folder}/Cargo.toml"), &format!("[package]\nname = {name:?}\n")),
            (&format!("{folder}/{root}"), text),
        ])
    }

    #[test]
    fn a_root_that_does_not_forbid_unsafe_code_is_found() {
        let good = "//! A.\n#![forbid(unsafe_code)]\n";
        assert_eq!(forbid_unsafe(&tree("a", "a", "src/lib.rs", good)), []);
        for root in ["src/lib.rs", "src/main.rs", "src/bin/tool.rs"] {
            let [problem] = &forbid_unsafe(&tree("a", "a", root, "//! A.\n#![deny(unsafe_code)]\n"))[..] else {
                panic!("one problem in {root}")
            };
            assert_eq!(problem.path, format!("a/{root}"));
        }
    }

    #[test]
    fn boards_and_images_may_have_unsafe_code_and_what_only_looks_like_one_may_not() {
        let allows = |folder: &str| forbid_unsafe(&tree(folder, "a", "src/lib.rs", "//! A.\n")).is_empty();
        assert!(allows("boards/a") && allows("rtic-firmware/a"));
        assert!(!allows("rtic-firmware/app") && !allows("boards/a/b") && !allows("boards"));
    }

    #[test]
    fn a_member_without_a_root_does_not_pass_unseen() {
        let [problem] = &forbid_unsafe(&tree("a", "a", "tests/x.rs", ""))[..] else { panic!("one problem") };
        assert!(problem.what.contains("no library or binary"), "{problem}");
    }

    #[test]
    fn a_core_with_the_standard_library_is_found() {
        let std = "//! A.\n#![forbid(unsafe_code)]\n";
        let [problem] = &cores_are_no_std(&tree("runtime", "osap-runtime", "src/lib.rs", std))[..] else {
            panic!("one problem")
        };
        assert_eq!((&problem.path[..], problem.line), ("runtime/src/lib.rs", Some(1)));
        assert_eq!(cores_are_no_std(&tree("runtime", "osap-runtime", "src/lib.rs", "#![no_std]\n")), []);
        assert_eq!(cores_are_no_std(&tree("sim", "osap-sim", "src/lib.rs", std)), []);
    }

    #[test]
    fn a_module_without_docs_is_found() {
        for text in ["", "// A.\n", "/// A.\nfn a() {}\n", "#![no_std]\n//! A.\n"] {
            assert_eq!(have_docs(&Tree::from_files(&[("a/src/b/c.rs", text)])).len(), 1, "{text:?}");
        }
        let good = [("a/src/b.rs", "//! A.\n"), ("a/src/c.rs", "\n//! A.\n"), ("a/build.rs", "fn main() {}\n")];
        assert_eq!(have_docs(&Tree::from_files(&good)), []);
    }

    #[test]
    fn manifests_that_cannot_be_used_are_not_passed_over() {
        let empty = Tree::from_files(&[]);
        assert_eq!((forbid_unsafe(&empty).len(), cores_are_no_std(&empty).len()), (1, 1));
    }
}

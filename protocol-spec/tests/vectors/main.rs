//! Every vector of `vectors/*.toml` against the code.
//!
//! - **What:** [`vector_file`] reads a file into the kinds of vectors it may hold; each test runs the real code on one file.
//! - **Invariants:** a file without a test, a kind of vector without one, a field nobody asked for, a vector without a clause of the
//!   specification and two vectors of one name are errors. A failure names file and vector.
//! - **Clauses:** each vector names its own.

mod framing;
mod headers;
mod messages;
mod motion;
mod sizes;
mod system;

use serde::Deserialize;
use serde::de::{DeserializeOwned, Error as _};
use std::collections::BTreeSet;
use std::fmt;
use std::path::{Path, PathBuf};

/// Files that a test below reads. Another one in the folder is an error.
const FILES: [&str; 11] = [
    headers::HEADER,
    headers::INSTRUCTIONS,
    headers::ROUTES,
    headers::TTL,
    headers::MTU,
    framing::FRAMING,
    messages::TRANSPORT,
    system::SYSTEM,
    messages::DISCOVERY,
    sizes::SIZES,
    motion::MOTION,
];

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// Where a vector stands, for the message of a failure.
struct At<'a> {
    file: &'a str,
    name: &'a str,
}

impl fmt::Display for At<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "vectors/{}: \"{}\"", self.file, self.name)
    }
}

/// Bytes as a string of hexadecimal digits, with white space where it helps.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Hex(Vec<u8>);

impl<'de> Deserialize<'de> for Hex {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        let byte = |pair: &str| u8::from_str_radix(pair, 16).ok().filter(|_| pair.len() == 2);
        text.split_whitespace()
            .map(|pair| {
                byte(pair).ok_or_else(|| D::Error::custom(format!("`{pair}` is no byte of two hexadecimal digits")))
            })
            .collect::<Result<_, _>>()
            .map(Self)
    }
}

/// One clause or several.
#[derive(Deserialize)]
#[serde(untagged)]
enum Clauses {
    One(String),
    Several(Vec<String>),
}

impl Clauses {
    fn ids(&self) -> &[String] {
        match self {
            Self::One(id) => std::slice::from_ref(id),
            Self::Several(ids) => ids,
        }
    }
}

/// What every vector has.
trait Vector {
    fn name(&self) -> &str;
    fn clause(&self) -> &Clauses;
}

/// Gives each type of vector its name and clause.
macro_rules! vectors {
    ($($type:ty),* $(,)?) => {
        $(impl $crate::Vector for $type {
            fn name(&self) -> &str {
                &self.name
            }
            fn clause(&self) -> &$crate::Clauses {
                &self.clause
            }
        })*
    };
}
pub(crate) use vectors;

/// Reads a whole file; what it holds that `T` does not know is an error.
fn vector_file<T: DeserializeOwned>(file: &str) -> T {
    let text =
        std::fs::read_to_string(folder("vectors").join(file)).unwrap_or_else(|error| panic!("vectors/{file}: {error}"));
    toml::from_str(&text).unwrap_or_else(|error| panic!("vectors/{file}: {error}"))
}

/// Runs `check` on each vector of one kind, after a look at what all vectors must have.
fn each<V: Vector>(file: &str, vectors: &[V], mut check: impl FnMut(&At<'_>, &V)) {
    assert!(!vectors.is_empty(), "vectors/{file}: a kind of vector without a single one");
    let mut names = BTreeSet::new();
    let specification = specification();
    for vector in vectors {
        let at = At { file, name: vector.name() };
        assert!(!at.name.is_empty() && names.insert(at.name), "{at}: the name is empty or taken");
        assert!(!vector.clause().ids().is_empty(), "{at}: no clause");
        for id in vector.clause().ids() {
            assert!(specification.contains(&format!("**[{id}]**")), "{at}: there is no clause `{id}`");
        }
        check(&at, vector);
    }
}

/// All pages of the specification, one after the other.
fn specification() -> String {
    let entries = std::fs::read_dir(folder("spec")).expect("the specification lies beside the vectors");
    let paths = entries.map(|entry| entry.expect("a readable folder").path());
    paths
        .filter(|path| path.extension().is_some_and(|it| it == "md"))
        .filter_map(|path| std::fs::read_to_string(path).ok())
        .collect()
}

/// A vector file that no test reads would prove nothing and look as if it did.
#[test]
fn every_file_has_its_test() {
    let entries = std::fs::read_dir(folder("vectors")).expect("there is a folder of vectors");
    let found: BTreeSet<String> =
        entries.map(|entry| entry.expect("a readable folder").file_name().to_string_lossy().into_owned()).collect();
    assert_eq!(found, FILES.iter().map(ToString::to_string).collect());
}

//! What the tests of this crate share: the hand-written vectors as plain tables, and files that go away again.
//!
//! - **Invariant:** nothing here decides what is right; it only finds the vectors that say so.
#![forbid(unsafe_code)]

use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// The root of the repository.
#[must_use]
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The vectors of one kind in a file of `protocol-spec/vectors`, in their order.
///
/// # Panics
/// Where the file cannot be read or has no such vectors: a test without its vectors proves nothing.
#[must_use]
pub fn vectors(file: &str, kind: &str) -> Vec<Table> {
    let text = std::fs::read_to_string(root().join("protocol-spec/vectors").join(file));
    let table: Table = text.expect("the vectors lie in the repository").parse().expect("the vectors are TOML");
    let kinds = table.get(kind).and_then(Value::as_array).unwrap_or_else(|| panic!("vectors/{file} has no `{kind}`"));
    kinds.iter().filter_map(Value::as_table).cloned().collect()
}

/// A field of a vector that is text.
///
/// # Panics
/// Where there is none.
#[must_use]
pub fn text<'a>(vector: &'a Table, field: &str) -> &'a str {
    vector.get(field).and_then(Value::as_str).unwrap_or_else(|| panic!("no text `{field}` in {vector:?}"))
}

/// A field of a vector that is bytes.
///
/// # Panics
/// Where there is none.
#[must_use]
pub fn bytes(vector: &Table, field: &str) -> Vec<u8> {
    osap::explain::parse_hex(text(vector, field)).unwrap_or_else(|error| panic!("{field}: {error}"))
}

/// A file in the system's folder for such, gone when this is dropped.
#[derive(Debug)]
pub struct ScratchFile(PathBuf);

impl ScratchFile {
    /// A path that no other process and no other `name` of this one has.
    #[must_use]
    pub fn new(name: &str) -> Self {
        Self(std::env::temp_dir().join(format!("osap-e2e-{}-{name}", std::process::id())))
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for ScratchFile {
    fn drop(&mut self) {
        // It may never have been written.
        let _ = std::fs::remove_file(&self.0);
    }
}

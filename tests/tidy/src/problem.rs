//! One thing that a check found: what is wrong, where, and how to mend it.

use std::fmt;

/// What a check found wrong at one place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// Path from the root of the repository, with forward slashes.
    pub path: String,
    /// Line, counted from one; `None` where the whole file is meant.
    pub line: Option<usize>,
    /// What is wrong.
    pub what: String,
    /// What to do about it.
    pub mend: String,
}

impl Problem {
    /// A problem of a whole file.
    pub fn in_file(path: impl Into<String>, what: impl Into<String>, mend: impl Into<String>) -> Self {
        Self { path: path.into(), line: None, what: what.into(), mend: mend.into() }
    }

    /// A problem at `line`, counted from one.
    pub fn at(path: impl Into<String>, line: usize, what: impl Into<String>, mend: impl Into<String>) -> Self {
        Self { line: Some(line), ..Self::in_file(path, what, mend) }
    }
}

impl fmt::Display for Problem {
    /// In the form that editors and terminals make a link of: `path:line: what; mend`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            Some(line) => write!(f, "{}:{line}: {}; {}", self.path, self.what, self.mend),
            None => write!(f, "{}: {}; {}", self.path, self.what, self.mend),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_problem_reads_as_place_what_and_mend() {
        assert_eq!(Problem::at("a/b.rs", 7, "is bad", "make it good").to_string(), "a/b.rs:7: is bad; make it good");
        assert_eq!(Problem::in_file("a/b.rs", "is bad", "make it good").to_string(), "a/b.rs: is bad; make it good");
    }
}

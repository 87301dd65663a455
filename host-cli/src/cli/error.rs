//! Why a command failed: what happened, where, and what to do next.
//!
//! - **Invariant:** none is made without a next step; the border of the CLI is where a library's error gets one.

use super::exit::Exit;
use super::output::{ERROR, HINT};
use serde::Serialize;
use std::fmt;
use std::io;

/// Ends a command early.
#[derive(Debug)]
pub enum CliError {
    /// Something failed; all of it is told to whoever called.
    Failed {
        /// What kind of failure, for scripts.
        exit: Exit,
        /// What happened.
        what: String,
        /// On which link, device or file.
        place: String,
        /// What to do about it, with a command where there is one.
        next: String,
    },
    /// Whoever read the output has gone: nothing to say, and nobody to say it to.
    ReaderGone,
}

impl CliError {
    /// A failure.
    pub fn new(exit: Exit, what: impl Into<String>, place: impl Into<String>, next: impl Into<String>) -> Self {
        Self::Failed { exit, what: what.into(), place: place.into(), next: next.into() }
    }

    /// A file that could not be read or written.
    #[must_use]
    pub fn file(path: &std::path::Path, doing: &str, error: &io::Error) -> Self {
        let next = match error.kind() {
            io::ErrorKind::NotFound => "check the path: a folder or file in it does not exist",
            io::ErrorKind::PermissionDenied => "choose a place you may use, or change its permissions",
            io::ErrorKind::AlreadyExists => "choose another name, or remove the file first",
            _ => "mend what the system complains about, or choose another place",
        };
        Self::new(Exit::Io, format!("cannot {doing}: {error}"), path.display().to_string(), next)
    }

    /// The code to end with.
    #[must_use]
    pub const fn exit(&self) -> Exit {
        match self {
            Self::Failed { exit, .. } => *exit,
            Self::ReaderGone => Exit::Ok,
        }
    }

    /// The same as a document, for `--json`.
    #[must_use]
    pub fn document(&self) -> Option<impl Serialize> {
        #[derive(Serialize)]
        struct Document<'a> {
            schema: &'static str,
            code: u8,
            what: &'a str,
            r#where: &'a str,
            next: &'a str,
        }
        let Self::Failed { exit, what, place, next } = self else { return None };
        Some(Document { schema: "osap.error/1", code: exit.code(), what, r#where: place, next })
    }
}

/// Three lines in colour; the sink takes the colour out where it has no place.
impl fmt::Display for CliError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self::Failed { what, place, next, .. } = self else { return Ok(()) };
        writeln!(f, "{ERROR}error:{ERROR:#} {what}")?;
        writeln!(f, "{HINT}where:{HINT:#} {place}")?;
        write!(f, "{HINT} next:{HINT:#} {next}")
    }
}

impl std::error::Error for CliError {}

/// Of the output itself; files have [`CliError::file`].
impl From<io::Error> for CliError {
    fn from(error: io::Error) -> Self {
        if error.kind() == io::ErrorKind::BrokenPipe {
            return Self::ReaderGone;
        }
        let next = "make room or repair the pipe that the output goes to, then run the command again";
        Self::new(Exit::Io, format!("cannot write the output: {error}"), "standard output", next)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reader_that_went_away_is_no_failure() {
        let gone = CliError::from(io::Error::from(io::ErrorKind::BrokenPipe));
        assert!(gone.exit() == Exit::Ok && gone.document().is_none());
        assert_eq!(CliError::from(io::Error::from(io::ErrorKind::StorageFull)).exit(), Exit::Io);
    }

    #[test]
    fn the_document_says_what_the_text_says() {
        let error = CliError::new(Exit::NoLink, "nothing is plugged in", "USB", "plug something in");
        let document = serde_json::to_value(error.document()).unwrap();
        assert_eq!(document["code"], 3);
        let text = error.to_string();
        for field in ["what", "where", "next"] {
            assert!(text.contains(document[field].as_str().unwrap()), "{field}: {text}");
        }
    }
}

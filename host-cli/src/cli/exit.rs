//! The exit codes of `osap`: one enum, from which help, man page and errors take them.
//!
//! - **Invariant:** the numbers are what scripts rely on: never reused for another meaning.
//!
//! ```
//! use osap::cli::Exit;
//! assert_eq!(Exit::NoAnswer.code(), 6);
//! assert!(Exit::table().contains("6  a device did not answer"));
//! ```

use std::fmt::Write as _;
use std::process::{ExitCode, Termination};

/// How a command ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Exit {
    /// Done.
    Ok = 0,
    /// Done, and what was looked at is not as it should be.
    Differs = 1,
    /// The command line makes no sense.
    Usage = 2,
    /// There is no link to talk over.
    NoLink = 3,
    /// No device answers to this name, id or route.
    DeviceNotFound = 4,
    /// More than one does.
    DeviceAmbiguous = 5,
    /// A device did not answer, or nobody did at all.
    NoAnswer = 6,
    /// A device refused what it was asked.
    Refused = 7,
    /// A file, pipe or socket failed.
    Io = 8,
    /// A link beyond this machine needs a key.
    KeyNeeded = 9,
    /// Clocks did not settle in time.
    NotSettled = 10,
}

impl Exit {
    /// All of them, in the order of their codes.
    pub const ALL: [Self; 11] = [
        Self::Ok,
        Self::Differs,
        Self::Usage,
        Self::NoLink,
        Self::DeviceNotFound,
        Self::DeviceAmbiguous,
        Self::NoAnswer,
        Self::Refused,
        Self::Io,
        Self::KeyNeeded,
        Self::NotSettled,
    ];

    /// What the shell sees.
    #[must_use]
    pub const fn code(self) -> u8 {
        self as u8
    }

    /// What it means, for people.
    #[must_use]
    pub const fn meaning(self) -> &'static str {
        match self {
            Self::Ok => "done",
            Self::Differs => "done, and something differs, is faulty or was lost: the output says what",
            Self::Usage => "the command line cannot be carried out as it stands",
            Self::NoLink => "no link could be opened",
            Self::DeviceNotFound => "no device has this name, unique id or route",
            Self::DeviceAmbiguous => "several devices have this name or begin with this unique id",
            Self::NoAnswer => "a device did not answer, or nobody did on any link",
            Self::Refused => "a device refused what it was asked",
            Self::Io => "a file, pipe or socket could not be read or written",
            Self::KeyNeeded => "a link beyond this machine needs a key",
            Self::NotSettled => "clocks did not settle in time",
        }
    }

    /// The text of help and man page.
    #[must_use]
    pub fn table() -> String {
        Self::ALL.iter().fold("Exit codes:".to_owned(), |mut text, exit| {
            // Writing to a string cannot fail.
            let _ = write!(text, "\n  {:<2} {}", exit.code(), exit.meaning());
            text
        })
    }
}

impl Termination for Exit {
    fn report(self) -> ExitCode {
        ExitCode::from(self.code())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_codes_count_up_from_zero_and_each_is_in_the_table() {
        let table = Exit::table();
        for (code, exit) in Exit::ALL.into_iter().enumerate() {
            assert_eq!(usize::from(exit.code()), code);
            assert!(table.contains(&format!("\n  {code:<2} {}", exit.meaning())));
        }
        assert_eq!(table.lines().count(), 1 + Exit::ALL.len());
    }
}

//! How programs are started: from the root of the repository, with no input, their output seen as it comes.

use std::ffi::{OsStr, OsString};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};

/// Why something that this driver was to do did not come about.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Error {
    /// A program could not be started.
    #[error("cannot start `{command}`: {source}; is it installed and on the PATH?")]
    Start {
        /// The program and its arguments.
        command: String,
        /// What the system said.
        source: io::Error,
    },
    /// A program ran and did not succeed.
    #[error("`{command}` failed with {status}; what it says above tells why")]
    Failed {
        /// The program and its arguments.
        command: String,
        /// How it ended.
        status: ExitStatus,
    },
    /// The output of a program could not be passed on.
    #[error("cannot pass on the output of `{command}`: {source}; is the disk full, or the reader of a pipe gone?")]
    Output {
        /// The program and its arguments.
        command: String,
        /// What the system said.
        source: io::Error,
    },
    /// A file could not be read or written.
    #[error("cannot {what} {}: {source}; check that the place exists and that you may", path.display())]
    File {
        /// `read` or `write`.
        what: &'static str,
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The committed picture is not what the demonstration shows now.
    #[error("{} is not what `osap demo` shows now; run `cargo xtask demo-picture` and commit the file", path.display())]
    PictureDiffers {
        /// The picture.
        path: PathBuf,
    },
    /// The output of the demonstration cannot be drawn.
    #[error("cannot draw the output of `osap demo`: {0}")]
    Picture(#[from] crate::picture::PictureError),
    /// An image cannot be used.
    #[error(transparent)]
    Image(#[from] crate::images::ImageError),
    /// The ELF of an image tells nothing that can be used.
    #[error("{}: {source}", path.display())]
    Elf {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: crate::elf::ElfError,
    },
    /// An image cannot become a UF2 file.
    #[error("{}: {source}", path.display())]
    Uf2 {
        /// The ELF.
        path: PathBuf,
        /// What is wrong with it.
        source: crate::uf2::Uf2Error,
    },
    /// This could not be done here. Not a failure of what was to be checked, and never to be taken for a success.
    #[error("NOT RUN: {what}: {why}")]
    NotRunHere {
        /// What did not run.
        what: String,
        /// Why, and what to do.
        why: String,
    },
    /// Something is missing on this machine and could not be installed.
    #[error("{count} thing(s) could not be set up, as said above; install what is named there and run this again")]
    NotRun {
        /// How many.
        count: usize,
    },
}

/// The root of the repository.
pub(crate) fn root() -> PathBuf {
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    own.parent().unwrap_or(own).to_owned()
}

/// A program to be started in the root of the repository.
pub(crate) struct Program {
    command: Command,
    is_quiet: bool,
}

impl Program {
    /// The program `name`, with no input: nothing that this driver starts may wait for an answer.
    pub(crate) fn new(name: impl AsRef<OsStr>) -> Self {
        let mut command = Command::new(name);
        command.current_dir(root()).stdin(Stdio::null());
        if is_ci() {
            command.env("CARGO_TERM_COLOR", "never").env("NO_COLOR", "1");
        }
        Self { command, is_quiet: false }
    }

    /// Cargo, the one that runs this driver, with `arguments` that are split at spaces.
    pub(crate) fn cargo(arguments: &str) -> Self {
        let cargo = std::env::var_os("CARGO").unwrap_or_else(|| OsString::from("cargo"));
        Self::new(cargo).args(arguments.split_whitespace())
    }

    /// Adds arguments as they are.
    pub(crate) fn args(mut self, arguments: impl IntoIterator<Item = impl AsRef<OsStr>>) -> Self {
        self.command.args(arguments);
        self
    }

    /// Sets a variable of the environment.
    pub(crate) fn env(mut self, name: &str, value: &str) -> Self {
        self.command.env(name, value);
        self
    }

    /// Takes a variable out of the environment.
    pub(crate) fn env_remove(mut self, name: &str) -> Self {
        self.command.env_remove(name);
        self
    }

    /// Runs it in `folder` instead of the root of the repository.
    pub(crate) fn within(mut self, folder: &Path) -> Self {
        self.command.current_dir(folder);
        self
    }

    /// Does not say that it runs: a question of our own, not a step.
    pub(crate) fn quiet(mut self) -> Self {
        self.is_quiet = true;
        self
    }

    /// Runs it with its output where ours goes.
    pub(crate) fn run(mut self) -> Result<(), Error> {
        let shown = self.announce();
        let status = self.command.status().map_err(|source| Error::Start { command: shown.clone(), source })?;
        succeeded(shown, status)
    }

    /// Runs it, passes its standard output on as it comes and hands each piece to `watch`.
    pub(crate) fn run_watched(self, watch: impl FnMut(&[u8])) -> Result<(), Error> {
        self.run_into(&mut io::stdout(), watch)
    }

    fn run_into(mut self, to: &mut impl Write, mut watch: impl FnMut(&[u8])) -> Result<(), Error> {
        let shown = self.announce();
        let started = self.command.stdout(Stdio::piped()).spawn();
        let mut child = started.map_err(|source| Error::Start { command: shown.clone(), source })?;
        let copied = child.stdout.take().map_or(Ok(()), |mut output| copy(&mut output, to, &mut watch));
        // The child is waited for whatever became of its output, so that none is left behind.
        let status = child.wait().map_err(|source| Error::Start { command: shown.clone(), source })?;
        copied.map_err(|source| Error::Output { command: shown.clone(), source })?;
        succeeded(shown, status)
    }

    /// Runs it and returns its standard output; what it says on standard error is seen as it comes.
    pub(crate) fn capture(mut self) -> Result<String, Error> {
        let shown = self.announce();
        let output = self.command.stderr(Stdio::inherit()).output();
        let output = output.map_err(|source| Error::Start { command: shown.clone(), source })?;
        succeeded(shown, output.status)?;
        Ok(String::from_utf8_lossy(&output.stdout).into_owned())
    }

    /// As [`Program::capture`], whether it succeeds or not: a program may fail because of what it found, and tell that. An error where it
    /// said nothing.
    pub(crate) fn capture_all(mut self) -> Result<String, Error> {
        let shown = self.announce();
        let output = self.command.stderr(Stdio::inherit()).output();
        let output = output.map_err(|source| Error::Start { command: shown.clone(), source })?;
        if output.stdout.is_empty() {
            succeeded(shown, output.status)?;
        }
        Ok(String::from_utf8_lossy(&output.stdout).into_owned())
    }

    /// Runs it unseen and returns its standard output, or `None` where it is missing or fails: a question, not a step.
    pub(crate) fn ask(mut self) -> Option<String> {
        let output = self.command.output().ok().filter(|output| output.status.success())?;
        Some(String::from_utf8_lossy(&output.stdout).trim().to_owned())
    }

    /// Says on standard error what is about to run, as one would type it.
    fn announce(&self) -> String {
        let name = Path::new(self.command.get_program()).file_name().unwrap_or_default();
        let words = std::iter::once(name).chain(self.command.get_args());
        let shown = words.map(|word| quoted(&word.to_string_lossy())).collect::<Vec<_>>().join(" ");
        if !self.is_quiet {
            eprintln!("$ {shown}");
        }
        shown
    }
}

/// A word as a shell would take it, for the eye.
fn quoted(word: &str) -> String {
    let needs_quotes = word.is_empty() || word.contains(|c: char| c.is_whitespace() || "'\"$|&;*".contains(c));
    if needs_quotes { format!("{word:?}") } else { word.to_owned() }
}

/// Whether this is a run of continuous integration.
fn is_ci() -> bool {
    std::env::var("CI").is_ok_and(|value| value == "true" || value == "1")
}

fn succeeded(command: String, status: ExitStatus) -> Result<(), Error> {
    if status.success() { Ok(()) } else { Err(Error::Failed { command, status }) }
}

/// Copies all of `from` to `to`, flushed at each piece so that half a line is seen too.
fn copy(from: &mut impl Read, to: &mut impl Write, watch: &mut impl FnMut(&[u8])) -> io::Result<()> {
    let mut buffer = [0; 8192];
    loop {
        let count = match from.read(&mut buffer) {
            Ok(0) => return Ok(()),
            Ok(count) => count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(error),
        };
        watch(&buffer[..count]);
        to.write_all(&buffer[..count])?;
        to.flush()?;
    }
}

/// Writes `text` to `path`, with the folders above it.
pub(crate) fn write(path: &Path, text: &str) -> Result<(), Error> {
    let written = path.parent().map_or(Ok(()), std::fs::create_dir_all).and_then(|()| std::fs::write(path, text));
    written.map_err(|source| Error::File { what: "write", path: path.to_owned(), source })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn output_is_passed_on_whole_and_watched() {
        let (mut seen, mut passed) = (Vec::new(), Vec::new());
        let text = b"line\nhalf".repeat(3000);
        copy(&mut &text[..], &mut passed, &mut |piece: &[u8]| seen.extend_from_slice(piece)).unwrap();
        assert_eq!((passed, seen), (text.clone(), text));
    }

    #[test]
    fn a_program_that_is_missing_is_named_with_what_to_do() {
        let said =
            Program::new("no-such-program-anywhere").args(["--flag", "two words"]).run().unwrap_err().to_string();
        assert!(said.starts_with("cannot start `no-such-program-anywhere --flag \"two words\"`"), "{said}");
        assert!(said.ends_with("is it installed and on the PATH?"), "{said}");
    }

    #[test]
    fn a_program_that_fails_is_an_error_and_one_that_succeeds_is_watched() {
        let shell = |script: &str| Program::new("sh").args(["-c", script]);
        let (mut passed, mut seen) = (Vec::new(), Vec::new());
        shell("echo said").run_into(&mut passed, |piece| seen.extend_from_slice(piece)).unwrap();
        assert_eq!(
            (&passed[..], &seen[..]),
            (
                &b"said
"[..],
                &b"said
"[..]
            )
        );
        let failed = shell("exit 3").run_into(&mut passed, |_| ()).unwrap_err();
        assert!(failed.to_string().contains("exit status: 3"), "{failed}");
        assert!(shell("exit 3").ask().is_none());
    }
}

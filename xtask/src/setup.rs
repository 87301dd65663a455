//! What a machine needs before the checks can run; installed where it is missing, left alone where it is there.
//!
//! Whatever cannot be had is reported as `NOT RUN` with the reason and the way out, by the stage that misses it.

use crate::run::{Error, Program};

/// Targets that the cores are built for: Cortex-M0+ and Cortex-M4F/M7.
pub(crate) const TARGETS: [&str; 2] = ["thumbv6m-none-eabi", "thumbv7em-none-eabihf"];

/// Parts of the compiler's distribution that minimal installs leave out: the component, the command it brings, and the
/// stage that needs it.
const COMPONENTS: [(&str, &str, &str); 2] = [("rustfmt", "fmt", "format"), ("clippy", "clippy", "lint")];

/// Debian packages that tests need: the package, the program it brings, and the test that needs it.
pub(crate) const PACKAGES: [(&str, &str, &str); 1] = [("tshark", "tshark", "Wireshark dissector test")];

/// Something that could not be installed.
#[derive(Clone, Debug)]
pub(crate) struct Missing {
    /// The stage or test that cannot run without it.
    pub(crate) stage: String,
    /// Why it could not be installed, and what to do.
    pub(crate) why: String,
}

/// What was looked for, is not there and could not be installed.
#[derive(Debug, Default)]
pub(crate) struct Setup {
    missing: Vec<Missing>,
}

impl Setup {
    /// Why `stage` cannot run, and what to do; `None` where it can.
    pub(crate) fn why_not(&self, stage: &str) -> Option<&str> {
        self.missing.iter().find(|missing| missing.stage == stage).map(|missing| missing.why.as_str())
    }

    /// An error where anything is missing.
    pub(crate) fn complete(&self) -> Result<(), Error> {
        let count = self.missing.len();
        if count == 0 { Ok(()) } else { Err(Error::NotRun { count }) }
    }

    /// Says at once what will not run, and keeps it for the report.
    pub(crate) fn add(&mut self, stage: String, why: String) {
        println!("NOT RUN: {stage}: {why}");
        self.missing.push(Missing { stage, why });
    }
}

/// The name of the stage that builds the cores for `target`.
pub(crate) fn build_stage(target: &str) -> String {
    format!("no_std build for {target}")
}

/// Installs what is missing and says what could not be installed.
pub(crate) fn run() -> Setup {
    let mut setup = targets();
    for (component, command, stage) in COMPONENTS {
        if Program::cargo(command).args(["--version"]).ask().is_some() {
            continue;
        }
        if let Err(error) = Program::new("rustup").args(["component", "add", component]).run() {
            let why = format!("{error}; install the component `{component}` of your Rust compiler");
            setup.add(stage.to_owned(), why);
        }
    }
    for (package, program, test) in PACKAGES {
        if Program::new(program).args(["--version"]).ask().is_some() {
            continue;
        }
        if let Err(why) = install(package) {
            setup.add(test.to_owned(), why);
        }
    }
    setup
}

/// Installs the bare-metal targets only; does nothing where they are there.
pub(crate) fn targets() -> Setup {
    let mut setup = Setup::default();
    for target in TARGETS.into_iter().filter(|target| !has_target(target)) {
        if let Err(error) = Program::new("rustup").args(["target", "add", target]).run() {
            let why = format!("{error}; install the target `{target}` of your Rust compiler");
            setup.add(build_stage(target), why);
        }
    }
    setup
}

/// Whether the compiler has a core library for `target`. Asked of the compiler itself, which need not come from rustup.
fn has_target(target: &str) -> bool {
    let folder = Program::new("rustc").args(["--print", "target-libdir", "--target", target]).ask();
    let mut files = folder.and_then(|folder| std::fs::read_dir(folder).ok()).into_iter().flatten().flatten();
    files.any(|file| file.file_name().to_string_lossy().starts_with("libcore-"))
}

/// Installs a Debian package, where this is Debian and we are root.
fn install(package: &str) -> Result<(), String> {
    let by_hand = format!("install `{package}` with your system's package manager and run this again");
    if Program::new("apt-get").args(["--version"]).ask().is_none() {
        return Err(format!("`{package}` is missing and there is no apt-get to install it; {by_hand}"));
    }
    if Program::new("id").args(["-u"]).ask().as_deref() != Some("0") {
        return Err(format!(
            "`{package}` is missing and only root may install it; run `sudo apt-get install {package}`"
        ));
    }
    let apt = |arguments: &[&str]| {
        let program = Program::new("apt-get").args(arguments).env("DEBIAN_FRONTEND", "noninteractive");
        program.run().map_err(|error| format!("{error}; {by_hand}"))
    };
    apt(&["update", "--quiet"])?;
    apt(&["install", "--yes", "--quiet", "--no-install-recommends", package])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_stops_its_own_stage_only_and_makes_a_setup_incomplete() {
        let mut setup = Setup::default();
        setup.complete().unwrap();
        setup.add(build_stage(TARGETS[0]), "no network".to_owned());
        assert_eq!(setup.why_not(&build_stage(TARGETS[0])), Some("no network"));
        assert_eq!(setup.why_not(&build_stage(TARGETS[1])), None);
        assert!(setup.complete().unwrap_err().to_string().starts_with("1 thing(s) could not be set up"));
    }

    #[test]
    fn a_target_that_no_compiler_has_is_not_taken_to_be_there() {
        assert!(!has_target("no-such-target"));
    }

    #[test]
    fn the_compilers_own_target_is_found() {
        let version = Program::new("rustc").args(["-vV"]).ask().expect("rustc runs");
        let host = version.lines().find_map(|line| line.strip_prefix("host: ")).expect("rustc names its host");
        assert!(has_target(host), "{host}");
    }
}

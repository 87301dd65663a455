//! What a machine needs before the checks can run; installed where it is missing, left alone where it is there.
//!
//! Whatever cannot be had is reported as `NOT RUN` with the reason and the way out, by the stage that misses it.

use crate::run::{Error, Program};
use crate::{hil, system, toolchain};

/// Targets that the cores are built for: Cortex-M0+ and Cortex-M4F/M7.
pub(crate) const TARGETS: [&str; 2] = ["thumbv6m-none-eabi", "thumbv7em-none-eabihf"];

/// Parts of the compiler's distribution that minimal installs leave out: the component, the command it brings, and the
/// stage that needs it.
const COMPONENTS: [(&str, &str, &str); 2] = [("rustfmt", "fmt", "format"), ("clippy", "clippy", "lint")];

/// The test of the Wireshark dissector, which says itself that it did not run.
pub(crate) const DISSECTOR: &str = "Wireshark dissector test";

/// The stage of the emulated network.
pub(crate) const HIL: &str = "hil";

/// The stage of the emulated RP2040's own tests.
pub(crate) const RP2040_TESTS: &str = "test of the emulated RP2040";

/// The model of processors that no emulator has to the cycle: of `cargo xtask motion` alone, so no check needs it.
pub(crate) const MODEL: &str = "model of processors";

/// A program that checks need, and where it comes from.
#[derive(Clone, Copy, Debug)]
struct Needed {
    /// The program.
    program: &'static str,
    /// The Debian packages that bring it.
    packages: &'static [&'static str],
    /// The stages or tests that cannot run without it.
    by: &'static [&'static str],
}

/// Programs that are looked for, and installed where they are missing.
const NEEDED: [Needed; 5] = [
    Needed { program: "tshark", packages: &["tshark"], by: &[DISSECTOR] },
    Needed { program: "qemu-system-arm", packages: &["qemu-system-arm"], by: &[HIL] },
    Needed { program: "node", packages: &["nodejs"], by: &[HIL, RP2040_TESTS] },
    Needed { program: "npm", packages: &["npm"], by: &[HIL, RP2040_TESTS] },
    Needed { program: "llvm-mca", packages: &["llvm"], by: &[MODEL] },
];

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
    provide(&mut setup, |needed| needed.by != [MODEL]);
    // Tests of the harness talk to the emulated RP2040, so that its packages have to be there before any test runs.
    if setup.why_not(RP2040_TESTS).is_none()
        && let Err(error) = hil::install_packages()
    {
        for stage in [HIL, RP2040_TESTS] {
            setup.add(stage.to_owned(), error.to_string());
        }
    }
    setup
}

/// Installs the bare-metal targets only; does nothing where they are there.
pub(crate) fn targets() -> Setup {
    let mut setup = Setup::default();
    for target in TARGETS {
        if let Err(why) = toolchain::provide(target) {
            setup.add(build_stage(target), why);
        }
    }
    setup
}

/// Installs only the programs that `stage` needs.
pub(crate) fn programs_of(stage: &str) -> Setup {
    let mut setup = Setup::default();
    provide(&mut setup, |needed| needed.by.contains(&stage));
    setup
}

fn provide(setup: &mut Setup, is_wanted: impl Fn(&Needed) -> bool) {
    for needed in NEEDED.iter().filter(|needed| is_wanted(needed)) {
        if Program::new(needed.program).args(["--version"]).ask().is_some() {
            continue;
        }
        if let Err(why) = system::install(needed.packages) {
            for stage in needed.by {
                setup.add((*stage).to_owned(), why.clone());
            }
        }
    }
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
}

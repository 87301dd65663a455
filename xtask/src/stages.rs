//! The commands, and `test`, which runs them all as stages and goes on after one that fails.

use std::process::ExitCode;
use std::time::{Duration, Instant};

use crate::images::{Features, Image, Images};
use crate::picture;
use crate::report::{Outcome, Report};
use crate::run::{Error, Program, root, write};
use crate::setup::{self, Setup, TARGETS};
use crate::tally::{Counts, Runner, Tally};
use crate::{hil, toolchain};

/// Crates that run on a device, built for each bare-metal target.
const CORES: &str = "-p fixed-math -p osap-protocol -p osap-runtime -p firmware-app";

/// A short run on every change; a long one is `cargo xtask fuzz`.
const FUZZ: &str = "run --release -p osap-fuzz -- --inputs 200000 --seed 1";

/// Shells that completions are written for, with the file names that the shells look for.
const SHELLS: [(&str, &str); 3] = [("bash", "osap.bash"), ("zsh", "_osap"), ("fish", "osap.fish")];

/// Runs every check and closes with a table and a count. One run reports all that is wrong.
pub(crate) fn test() -> ExitCode {
    let started = Instant::now();
    let setup = setup::run();
    let mut report = Report::default();
    report.add("setup", Outcome::Ok, started.elapsed(), Counts::default());
    stage(&mut report, &setup, "format", || fmt(true));
    stage(&mut report, &setup, "lint", lint_host);
    // Before the tests: those of the harness look at what was built.
    let images = Images::read();
    image_stages(&mut report, &setup, images.as_ref());
    counted_stage(&mut report, &setup, "test, with tidy and doc tests", Runner::Cargo, || Ok(host_tests()));
    if let Some(why) = setup.why_not(setup::DISSECTOR) {
        report.add(setup::DISSECTOR, Outcome::NotRun(why.to_owned()), Duration::ZERO, Counts::default());
    }
    stage(&mut report, &setup, "documentation", documentation);
    for target in TARGETS {
        stage(&mut report, &setup, &setup::build_stage(target), || build_cores(target));
    }
    emulator_stages(&mut report, &setup, images.as_ref());
    stage(&mut report, &setup, "fuzz, short", || Program::cargo(FUZZ).run());
    stage(&mut report, &setup, "picture in the README", || picture::demo(true));
    println!("\n{}", report.render());
    if report.has_failed() { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}

/// Formats all sources, or only looks.
pub(crate) fn fmt(check: bool) -> Result<(), Error> {
    Program::cargo("fmt --all").args(check.then_some("--check")).run()
}

/// Clippy on everything, each image for its own chip, warnings denied.
pub(crate) fn lint() -> Result<(), Error> {
    lint_host()?;
    Images::read()?.all().iter().try_for_each(Image::lint)
}

/// Clippy on everything that builds on a host, warnings denied.
fn lint_host() -> Result<(), Error> {
    Program::cargo("clippy --all-targets -- -D warnings").run()
}

/// Builds the cores for every bare-metal target.
pub(crate) fn nostd() -> Result<(), Error> {
    let setup = setup::targets();
    for target in TARGETS.into_iter().filter(|target| setup.why_not(&setup::build_stage(target)).is_none()) {
        build_cores(target)?;
    }
    setup.complete()
}

/// The rules of the repository as tests.
pub(crate) fn tidy() -> Result<(), Error> {
    Program::cargo("test -p tidy").run()
}

/// A fuzz run of any length.
pub(crate) fn fuzz(inputs: u64, seed: u64, target: &str) -> Result<(), Error> {
    let (inputs, seed) = (inputs.to_string(), seed.to_string());
    let flags = ["--inputs", &inputs, "--seed", &seed, "--target", target];
    Program::cargo("run --release -p osap-fuzz --").args(flags).run()
}

/// Benchmarks, with whatever they take.
pub(crate) fn bench(arguments: &[String]) -> Result<(), Error> {
    Program::cargo("run --release -p osap-bench --").args(arguments).run()
}

/// Man pages and shell completions, as the program itself writes them.
pub(crate) fn docs() -> Result<(), Error> {
    let osap = || Program::cargo("run --quiet --release -p osap --bin osap --");
    osap().args(["man", "--out", "target/man"]).run()?;
    for (shell, file) in SHELLS {
        let text = osap().args(["completions", shell]).capture()?;
        write(&root().join("target/completions").join(file), &text)?;
    }
    eprintln!("wrote target/man and target/completions");
    Ok(())
}

/// Unit, integration and doc tests of every crate that builds on a host; `tidy` is one of them.
fn host_tests() -> Program {
    Program::cargo("test --no-fail-fast")
}

/// Tests of the boards whose crates build on a host too: clocks, layouts.
fn board_tests() -> Program {
    Program::cargo("test --no-fail-fast -p board-mps2-an500 -p board-stm32h743-nucleo")
}

/// Builds and lints each image that the workspace lists. What each takes is measured by `cargo xtask size`, which builds it seven times
/// more.
fn image_stages(report: &mut Report, setup: &Setup, images: Result<&Images, &Error>) {
    let images = match images {
        Ok(images) => images,
        Err(error) => {
            return report.add("images", Outcome::Failed(error.to_string()), Duration::ZERO, Counts::default());
        }
    };
    for image in images.all() {
        let name = &image.name;
        stage(report, setup, &format!("image {name}"), || images.build(image, &Features::default()).map(drop));
        stage(report, setup, &format!("lint of image {name}"), || image.lint());
    }
}

/// Tests the emulated RP2040, and runs the images in emulators.
fn emulator_stages(report: &mut Report, setup: &Setup, images: Result<&Images, &Error>) {
    counted_stage(report, setup, "tests of boards on this computer", Runner::Cargo, || Ok(board_tests()));
    counted_stage(report, setup, setup::RP2040_TESTS, Runner::Node, hil::rp2040_tests);
    if let Some(images) = images.ok().filter(|images| images.has_member(hil::HARNESS)) {
        counted_stage(report, setup, setup::HIL, Runner::Cargo, || {
            hil::ready(images)?;
            Ok(hil::harness(&["all".to_owned()]))
        });
    }
}

/// Runs a stage that prints how many tests passed, unless what it needs is missing.
fn counted_stage(
    report: &mut Report,
    setup: &Setup,
    name: &str,
    runner: Runner,
    program: impl FnOnce() -> Result<Program, Error>,
) {
    let started = Instant::now();
    let mut tally = Tally::of(runner);
    let outcome = match setup.why_not(name) {
        Some(why) => Outcome::NotRun(why.to_owned()),
        None => outcome(program().and_then(|program| program.run_watched(|piece| tally.feed(piece)))),
    };
    report.add(name, outcome, started.elapsed(), tally.finish());
}

fn documentation() -> Result<(), Error> {
    Program::cargo("doc --no-deps").env("RUSTDOCFLAGS", "-D warnings").run()
}

/// One Cargo call for each target, so that features wanted by one never reach the other.
fn build_cores(target: &str) -> Result<(), Error> {
    let what = setup::build_stage(target);
    let toolchain = toolchain::provide(target).map_err(|why| Error::NotRunHere { what, why })?;
    toolchain.cargo("build").args(CORES.split_whitespace()).args(["--target", target]).run()
}

/// Runs a stage, unless what it needs is missing.
fn stage(report: &mut Report, setup: &Setup, name: &str, run: impl FnOnce() -> Result<(), Error>) {
    let started = Instant::now();
    let outcome = match setup.why_not(name) {
        Some(why) => Outcome::NotRun(why.to_owned()),
        None => outcome(run()),
    };
    report.add(name, outcome, started.elapsed(), Counts::default());
}

fn outcome(result: Result<(), Error>) -> Outcome {
    match result {
        Ok(()) => Outcome::Ok,
        Err(Error::NotRunHere { why, .. }) => Outcome::NotRun(why),
        Err(error) => Outcome::Failed(error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_that_fails_is_reported_and_the_next_one_runs() {
        let (mut report, setup) = (Report::default(), Setup::default());
        stage(&mut report, &setup, "bad", || Err(Error::NotRun { count: 1 }));
        stage(&mut report, &setup, "good", || Ok(()));
        let text = report.render();
        assert!(report.has_failed() && text.contains("bad   FAILED") && text.contains("good  ok"), "{text}");
    }

    #[test]
    fn a_stage_that_misses_something_is_not_tried() {
        let (mut report, mut setup) = (Report::default(), Setup::default());
        setup.add("build".to_owned(), "no network".to_owned());
        stage(&mut report, &setup, "build", || panic!("it was tried"));
        let text = report.render();
        assert!(!report.has_failed() && text.contains("build  NOT RUN") && text.ends_with("1 skipped"), "{text}");
    }
}

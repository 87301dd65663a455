//! `cargo xtask motion`: the measurements of exact motion, each made ready and run, and one table of all.
//!
//! - **Walk:** the emulated images', the [`model`]'s and the benchmarks' documents, kept below `target/motion/` → the benchmarks' report.
//! - **Invariant:** what cannot run is told with its reason, and the others run all the same.

mod model;

use std::path::PathBuf;

use crate::clock::{not_run, why_empty};
use crate::hil;
use crate::images::Images;
use crate::run::{Error, Program, root, write};

const BENCH: &str = "run --release -p osap-bench --";
/// Points that are injected: in full, and quickly.
const POINTS: [&str; 2] = ["100000000", "1000000"];

/// Measures all and prints the table; the page and the document go where they are wanted.
pub(crate) fn motion(is_quick: bool, html: Option<PathBuf>, json: Option<PathBuf>) -> Result<(), Error> {
    let folder = root().join("target/motion");
    let points = POINTS[usize::from(is_quick)];
    let images = Images::read().and_then(|images| hil::ready(&images));
    let emulated = |scenario: &str| match &images {
        Ok(()) => scenario_document(scenario),
        Err(error) => Err(Error::NotRunHere { what: "the images".to_owned(), why: error.to_string() }),
    };
    let mut report = Program::cargo(BENCH).args(["motion-report"]);
    let found = [
        ("evaluations", "cycles and shares on an RP2040", emulated("evaluations")),
        ("modelled", "cycles on Cortex-M4F and M7", model::document()),
        ("outputs", "jitter of output edges", emulated("motion")),
        ("errors", "errors of evaluators", Program::cargo(BENCH).args(["motion-error", "--json"]).capture()),
        ("injection", "injected points", injected(points)),
    ];
    for (name, what, document) in found {
        report = match document {
            Ok(document) => {
                let path = folder.join(name).with_extension("json");
                write(&path, &document)?;
                report.args([format!("--{name}").into(), path.into_os_string()])
            }
            Err(error) => report.args(["--not-run".to_owned(), not_run(what, &error)]),
        };
    }
    for (flag, path) in [("--html", html), ("--json", json)] {
        // the report runs in the root of the repository, the caller may not
        let absolute = |path: PathBuf| std::path::absolute(&path).unwrap_or(path).into_os_string();
        report = report.args(path.map(|path| [flag.into(), absolute(path)]).into_iter().flatten());
    }
    report.run()
}

/// It fails where a goal is missed, and its document tells which.
fn scenario_document(scenario: &str) -> Result<String, Error> {
    let document = hil::harness(&[scenario, "--json"].map(str::to_owned)).capture_all()?;
    match why_empty(&document) {
        Some(why) => Err(Error::NotRunHere { what: format!("hil {scenario}"), why }),
        None => Ok(document),
    }
}

/// It fails where a limit was broken, and its document tells how many.
fn injected(points: &str) -> Result<String, Error> {
    let document = Program::cargo(BENCH).args(["motion-inject", "--json", "--points", points]).capture_all()?;
    match serde_json::from_str::<serde_json::Value>(&document) {
        Ok(_) => Ok(document),
        Err(_) => Err(Error::NotRunHere { what: "bench motion-inject".to_owned(), why: document.trim().to_owned() }),
    }
}

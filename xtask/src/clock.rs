//! `cargo xtask clock`: the three measurements of clocks, each made ready and run, and one table of all.
//!
//! - **Walk:** the simulator's, the emulated images' and the pseudo-terminal's documents, kept below `target/clock/` → the benchmarks'
//!   report.
//! - **Invariant:** what cannot run is told with its reason, and the others run all the same.

use std::path::PathBuf;

use serde_json::Value;

use crate::hil;
use crate::images::Images;
use crate::run::{Error, Program, root, write};

const BENCH: &str = "run --release -p osap-bench --";

/// How much is measured: seeds, virtual ms of images, seconds of each case on this computer.
struct Extent {
    seeds: &'static str,
    images_ms: &'static str,
    host_s: &'static str,
}

const FULL: Extent = Extent { seeds: "30", images_ms: "12000", host_s: "60" };
const QUICK: Extent = Extent { seeds: "3", images_ms: "3000", host_s: "8" };

/// Measures all three and prints the table; the page and the document go where they are wanted.
pub(crate) fn clock(is_quick: bool, html: Option<PathBuf>, json: Option<PathBuf>) -> Result<(), Error> {
    let extent = if is_quick { QUICK } else { FULL };
    let folder = root().join("target/clock");
    let series = folder.join("series.csv");
    write(&series, "")?;
    let mut report = Program::cargo(BENCH).args(["clock-report"]);
    let found = [
        ("simulated", "simulated networks", simulated(&extent, &series)),
        ("images", "emulated RP2040 images", images(&extent)),
        ("host", "a host over a pseudo-terminal", host(&extent)),
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
    report = report.args(["--series".into(), series.into_os_string()]);
    for (flag, path) in [("--html", html), ("--json", json)] {
        // the report runs in the root of the repository, the caller may not
        let absolute = |path: PathBuf| std::path::absolute(&path).unwrap_or(path).into_os_string();
        report = report.args(path.map(|path| [flag.into(), absolute(path)]).into_iter().flatten());
    }
    report.run()
}

/// What did not run, and why, in a line.
pub(crate) fn not_run(what: &str, error: &Error) -> String {
    match error {
        Error::NotRunHere { what: part, why } => format!("{what}: {part}: {why}"),
        error => format!("{what}: {error}"),
    }
}

fn simulated(extent: &Extent, series: &std::path::Path) -> Result<String, Error> {
    let bench = Program::cargo(BENCH).args(["clock", "--json", "--seeds", extent.seeds, "--series"]);
    bench.args([series]).capture()
}

/// It fails where a goal is missed, and its document tells which.
fn images(extent: &Extent) -> Result<String, Error> {
    hil::ready(&Images::read()?)?;
    let arguments = ["clock", "--ms", extent.images_ms, "--json"].map(str::to_owned);
    let document = hil::harness(&arguments).capture_all()?;
    match why_empty(&document) {
        Some(why) => Err(Error::NotRunHere { what: "hil clock".to_owned(), why }),
        None => Ok(document),
    }
}

fn host(extent: &Extent) -> Result<String, Error> {
    if !cfg!(unix) {
        let why = "this system has no pseudo-terminals; run it on Linux or macOS".to_owned();
        return Err(Error::NotRunHere { what: "bench clock-pty".to_owned(), why });
    }
    let text = Program::cargo(BENCH).args(["clock-pty", "--json", "--seconds", extent.host_s]).capture()?;
    let (document, missing) = host_document(&text);
    match document {
        Some(document) if missing.is_empty() => Ok(document),
        _ => Err(Error::NotRunHere { what: "bench clock-pty".to_owned(), why: missing }),
    }
}

/// The document among what a benchmark printed, and the lines beside it, which say what did not run.
fn host_document(text: &str) -> (Option<String>, String) {
    let (documents, beside): (Vec<&str>, Vec<&str>) = text.lines().partition(|line| line.starts_with('{'));
    (documents.first().map(|line| (*line).to_owned()), beside.join("; "))
}

/// Why a scenario's document has no figures.
pub(crate) fn why_empty(document: &str) -> Option<String> {
    let document: Value = match serde_json::from_str(document) {
        Ok(document) => document,
        Err(error) => return Some(format!("the harness gave no document: {error}")),
    };
    if document["data"].as_object().is_some_and(|data| !data.is_empty()) {
        return None;
    }
    let checks = document["checks"].as_array().into_iter().flatten();
    let told = checks.filter_map(|check| check["why"].as_str().or(check["what"].as_str()));
    Some(told.collect::<Vec<_>>().join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_document_without_figures_says_why() {
        let document = |data: &str, check: &str| format!("{{\"data\":{data},\"checks\":[{check}]}}");
        let missing = r#"{"what":"all of it","result":"not run","why":"no node"}"#;
        assert_eq!(why_empty(&document("{}", missing)).as_deref(), Some("no node"));
        assert_eq!(why_empty(&document("{}", r#"{"what":"it broke","result":"failed"}"#)).as_deref(), Some("it broke"));
        assert_eq!(why_empty(&document(r#"{"idle-1":1}"#, missing)), None);
        assert!(why_empty("no document").is_some());
    }

    #[test]
    fn what_did_not_run_stands_beside_the_document() {
        assert_eq!(host_document("{\"rows\":[]}\n"), (Some("{\"rows\":[]}".to_owned()), String::new()));
        let (document, beside) = host_document("NOT RUN: idle: no terminal\n{}\n");
        assert_eq!((document.as_deref(), beside.as_str()), (Some("{}"), "NOT RUN: idle: no terminal"));
    }
}

//! What scenarios give back: tables for people, a document for programs, and verdicts that add up as `cargo test`'s do.
//!
//! - **Invariants:** a check is passed, failed or not run, and says so; nothing that did not run counts as passed.
//! - **Context:** data on stdout, talk on stderr.

use crate::cosim::CosimError;
use crate::images::Missing;
use serde_json::{Value, json};
use std::fmt::Write as _;

/// Why a scenario ended early.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// Something it needs is not here: it did not run.
    #[error("{0}")]
    NotRun(String),
    /// It ran and went wrong.
    #[error("{0}")]
    Failed(String),
}

impl From<Missing> for Failure {
    fn from(missing: Missing) -> Self {
        Self::NotRun(missing.to_string())
    }
}

impl From<CosimError> for Failure {
    fn from(error: CosimError) -> Self {
        match error {
            CosimError::Start { .. } => Self::NotRun(error.to_string()),
            other => Self::Failed(other.to_string()),
        }
    }
}

/// Errors that end a scenario as failed.
macro_rules! fails {
    ($($error:ty),*) => {
        $(impl From<$error> for Failure {
            fn from(error: $error) -> Self {
                Self::Failed(error.to_string())
            }
        })*
    };
}
fails!(osap::error::NetworkError, osap::error::AskError, osap::scan::ScanError, std::io::Error, serde_json::Error);

/// One thing that a scenario shows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It is so.
    Passed,
    /// It is not.
    Failed,
    /// Nobody looked, and why.
    NotRun(String),
}

/// What a scenario found.
#[derive(Debug, Default)]
pub struct Report {
    /// What is shown, and whether it is so.
    pub checks: Vec<(String, Verdict)>,
    /// For people.
    pub text: String,
    /// For programs, by name.
    pub data: serde_json::Map<String, Value>,
}

impl Report {
    /// Nothing yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a line for people.
    pub fn line(&mut self, line: impl AsRef<str>) {
        self.text.push_str(line.as_ref());
        self.text.push('\n');
    }

    /// Adds a value for programs.
    pub fn datum(&mut self, name: &str, value: Value) {
        self.data.insert(name.to_owned(), value);
    }

    /// Notes whether something is so; `what` says it with its operands.
    pub fn check(&mut self, is_so: bool, what: impl Into<String>) {
        self.checks.push((what.into(), if is_so { Verdict::Passed } else { Verdict::Failed }));
    }

    /// Notes that something was not looked at.
    pub fn not_run(&mut self, what: impl Into<String>, why: impl Into<String>) {
        self.checks.push((what.into(), Verdict::NotRun(why.into())));
    }

    /// Takes in what another found.
    pub fn add(&mut self, other: Self) {
        self.text.push_str(&other.text);
        self.checks.extend(other.checks);
        self.data.extend(other.data);
    }

    /// Passed, failed and not run.
    #[must_use]
    pub fn counts(&self) -> (usize, usize, usize) {
        let count = |wanted: fn(&Verdict) -> bool| self.checks.iter().filter(|(_, verdict)| wanted(verdict)).count();
        (
            count(|verdict| *verdict == Verdict::Passed),
            count(|verdict| *verdict == Verdict::Failed),
            count(|verdict| matches!(verdict, Verdict::NotRun(_))),
        )
    }

    /// The closing lines: one a check, then the sum as `cargo test` writes it.
    #[must_use]
    pub fn closing(&self, name: &str, seconds: f64) -> String {
        let mut text = String::new();
        for (what, verdict) in &self.checks {
            // writing to a string never fails
            let _fits = match verdict {
                Verdict::Passed => writeln!(text, "test {name}: {what} ... ok"),
                Verdict::Failed => writeln!(text, "test {name}: {what} ... FAILED"),
                Verdict::NotRun(why) => writeln!(text, "NOT RUN: {name}: {what}: {why}"),
            };
        }
        let (passed, failed, _) = self.counts();
        let result = if failed == 0 { "ok" } else { "FAILED" };
        let _fits = writeln!(
            text,
            "test result: {result}. {passed} passed; {failed} failed; 0 ignored; 0 measured; 0 filtered out; finished in {seconds:.2}s"
        );
        text
    }

    /// The document for programs.
    #[must_use]
    pub fn document(&self, name: &str) -> Value {
        let checks = self.checks.iter().map(|(what, verdict)| match verdict {
            Verdict::Passed => json!({ "what": what, "result": "passed" }),
            Verdict::Failed => json!({ "what": what, "result": "failed" }),
            Verdict::NotRun(why) => json!({ "what": what, "result": "not run", "why": why }),
        });
        json!({ "version": 1, "scenario": name, "checks": checks.collect::<Vec<_>>(), "data": self.data })
    }
}

/// A count as a real number, for shares and rates.
#[must_use]
pub const fn real(count: u64) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "exact below 2^53")]
    let real = count as f64;
    real
}

/// A table with a head, its columns as wide as they need.
#[must_use]
pub fn table(head: &[&str], rows: &[Vec<String>]) -> String {
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column).map(|cell| cell.chars().count()));
        cells.chain(head.get(column).map(|cell| cell.chars().count())).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..head.len()).map(width).collect();
    let line = |cells: &[String]| {
        let padded = cells.iter().zip(&widths).enumerate().map(|(column, (cell, width))| {
            if column == 0 { format!("{cell:<width$}") } else { format!("{cell:>width$}") }
        });
        padded.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    let head: Vec<String> = head.iter().map(|cell| (*cell).to_owned()).collect();
    let mut text = line(&head);
    text.push('\n');
    text.push_str(&widths.iter().map(|width| "-".repeat(*width)).collect::<Vec<_>>().join("  "));
    text.push('\n');
    for row in rows {
        text.push_str(&line(row));
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_did_not_run_is_not_passed_and_one_failure_fails() {
        let mut report = Report::new();
        report.check(true, "a");
        report.not_run("b", "no board");
        assert_eq!(report.counts(), (1, 0, 1));
        assert!(
            report
                .closing("x", 1.0)
                .contains("NOT RUN: x: b: no board\ntest result: ok. 1 passed; 0 failed; 0 ignored")
        );
        report.check(false, "c");
        assert!(report.closing("x", 1.0).contains("test result: FAILED. 1 passed; 1 failed"));
        assert_eq!(report.document("x")["checks"][1]["result"], "not run");
    }

    #[test]
    fn columns_are_as_wide_as_their_widest_cell() {
        let text = table(&["a", "µs"], &[vec!["hub".into(), "1".into()], vec!["d".into(), "10.5".into()]]);
        assert_eq!(text, "a      µs\n---  ----\nhub     1\nd    10.5\n");
    }
}

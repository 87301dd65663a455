//! What `cargo xtask test` closes with: a table of the stages, and a plain count alone on the last line.

use std::fmt::Write;
use std::time::Duration;

use crate::tally::Counts;

/// What became of one stage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// It ran and found nothing wrong.
    Ok,
    /// It ran, or should have been able to, and this is wrong.
    Failed(String),
    /// It could not run here, for this reason. Never to be taken for a success.
    NotRun(String),
}

/// One row of the table.
#[derive(Debug)]
struct Row {
    stage: String,
    outcome: Outcome,
    took: Duration,
    tests: Counts,
}

/// The rows so far, in the order in which the stages ran.
#[derive(Debug, Default)]
pub(crate) struct Report {
    rows: Vec<Row>,
}

impl Report {
    /// Adds a stage, with the tests that were counted in it.
    pub(crate) fn add(&mut self, stage: impl Into<String>, outcome: Outcome, took: Duration, tests: Counts) {
        self.rows.push(Row { stage: stage.into(), outcome, took, tests });
    }

    /// Whether a stage failed.
    pub(crate) fn has_failed(&self) -> bool {
        self.rows.iter().any(|row| matches!(row.outcome, Outcome::Failed(_)))
    }

    /// The table and, alone on the last line, the count.
    pub(crate) fn render(&self) -> String {
        let width = self.rows.iter().map(|row| row.stage.chars().count()).max().unwrap_or(0);
        let mut text = String::new();
        for row in &self.rows {
            let (outcome, note) = match &row.outcome {
                Outcome::Ok => ("ok", ""),
                Outcome::Failed(why) => ("FAILED", why.as_str()),
                Outcome::NotRun(why) => ("NOT RUN", why.as_str()),
            };
            let seconds = row.took.as_secs_f64();
            let line = format!("{:width$}  {outcome:7}  {seconds:7.1} s  {note}", row.stage);
            text += line.trim_end();
            text.push('\n');
            for why in &row.tests.not_run {
                // Writing to a string cannot fail.
                let _ = writeln!(text, "{:width$}  NOT RUN             {why}", "");
            }
        }
        text + "\n" + &self.count_line()
    }

    /// `N passed, M failed`, and `, K skipped` where something did not run.
    ///
    /// A failed stage that counted no failed test (a lint, a build) counts as one failure itself, so that a red run
    /// never closes with `0 failed`.
    fn count_line(&self) -> String {
        let mut total = Counts::default();
        let mut skipped = 0;
        for row in &self.rows {
            total.passed += row.tests.passed;
            total.failed += match row.outcome {
                Outcome::Failed(_) => row.tests.failed.max(1),
                _ => row.tests.failed,
            };
            skipped += row.tests.ignored + row.tests.not_run.len() as u64;
            skipped += u64::from(matches!(row.outcome, Outcome::NotRun(_)));
        }
        let skipped = if skipped > 0 { format!(", {skipped} skipped") } else { String::new() };
        format!("{} passed, {} failed{skipped}", total.passed, total.failed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counts(passed: u64, failed: u64, ignored: u64) -> Counts {
        Counts { passed, failed, ignored, not_run: Vec::new() }
    }

    fn report(rows: &[(&str, Outcome, Counts)]) -> Report {
        let mut report = Report::default();
        for (stage, outcome, tests) in rows {
            report.add(*stage, outcome.clone(), Duration::from_millis(1500), tests.clone());
        }
        report
    }

    fn last_line(report: &Report) -> String {
        report.render().lines().last().unwrap_or_default().to_owned()
    }

    #[test]
    fn a_green_run_is_a_table_and_a_bare_count() {
        let report = report(&[("format", Outcome::Ok, counts(0, 0, 0)), ("test", Outcome::Ok, counts(12, 0, 0))]);
        assert!(!report.has_failed());
        assert_eq!(report.render(), "format  ok           1.5 s\ntest    ok           1.5 s\n\n12 passed, 0 failed");
    }

    #[test]
    fn what_did_not_run_is_skipped_and_says_why() {
        let mut tests = counts(12, 0, 1);
        tests.not_run.push("dissector: no tshark".to_owned());
        let report =
            report(&[("test", Outcome::Ok, tests), ("bare", Outcome::NotRun("no target".into()), counts(0, 0, 0))]);
        let text = report.render();
        assert!(text.contains("bare  NOT RUN      1.5 s  no target\n"), "{text}");
        assert!(text.contains("dissector: no tshark\n"), "{text}");
        assert_eq!(last_line(&report), "12 passed, 0 failed, 3 skipped");
    }

    #[test]
    fn a_stage_that_fails_without_a_failed_test_counts_as_one() {
        let failed = Outcome::Failed("status 1".into());
        let report = report(&[("lint", failed.clone(), counts(0, 0, 0)), ("test", failed, counts(10, 3, 0))]);
        assert!(report.has_failed());
        assert_eq!(last_line(&report), "10 passed, 4 failed");
    }
}

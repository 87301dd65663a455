//! Counts tests by reading what a test runner prints, while it is passed on to the reader.
//!
//! Cargo's runners close with one line each, and so does the emulators' harness. Node's runner closes with a line for each
//! count, behind `#` where it writes TAP and behind `ℹ` where it writes for people; which of the two differs from version to
//! version.

use std::collections::BTreeMap;

/// Line with which a test that could not run says so, past the test harness.
const NOT_RUN: &str = "NOT RUN: ";

/// What every test binary, and the doc tests of every crate, close with.
const RESULT: &str = "test result:";

/// What a line of Node's runner that is not the result of a test begins with, in its two forms.
const NODE_MARKS: [&str; 2] = ["# ", "ℹ "];

/// Whose output is read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Runner {
    /// `cargo test`, or what closes as its binaries do.
    #[default]
    Cargo,
    /// `node --test`.
    Node,
}

/// Tests counted so far.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Counts {
    /// Tests that passed.
    pub(crate) passed: u64,
    /// Tests that failed.
    pub(crate) failed: u64,
    /// Tests marked as ignored.
    pub(crate) ignored: u64,
    /// What tests said that they could not run, and why.
    pub(crate) not_run: Vec<String>,
}

/// Reads the output of a test runner in pieces of any size.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    runner: Runner,
    counts: Counts,
    /// Counts of Node's closing lines, by name, until the last of them has come.
    closing: BTreeMap<String, u64>,
    /// The line that has not ended yet.
    line: Vec<u8>,
}

impl Tally {
    /// Reads what `runner` prints.
    pub(crate) fn of(runner: Runner) -> Self {
        Self { runner, ..Self::default() }
    }

    /// Takes the next piece.
    pub(crate) fn feed(&mut self, piece: &[u8]) {
        for &byte in piece {
            if byte == b'\n' {
                self.end_line();
            } else {
                self.line.push(byte);
            }
        }
    }

    /// The counts, once all has been read.
    pub(crate) fn finish(mut self) -> Counts {
        self.end_line();
        self.counts
    }

    fn end_line(&mut self) {
        let line = std::mem::take(&mut self.line);
        let line = String::from_utf8_lossy(&line);
        let line = line.trim();
        match self.runner {
            Runner::Cargo => self.read_cargo(line),
            Runner::Node => self.read_node(&without_colours(line)),
        }
    }

    /// Notes what a test said that it could not run; whether the line is such a word.
    fn read_not_run(&mut self, line: &str) -> bool {
        let why = line.strip_prefix(NOT_RUN);
        self.counts.not_run.extend(why.map(str::to_owned));
        why.is_some()
    }

    fn read_cargo(&mut self, line: &str) {
        if let Some(result) = line.strip_prefix(RESULT) {
            self.counts.passed += count_of(result, "passed");
            self.counts.failed += count_of(result, "failed");
            self.counts.ignored += count_of(result, "ignored");
        } else {
            self.read_not_run(line);
        }
    }

    /// The runner's counts are taken with the last of them, where they add up: a test may print lines that look alike.
    fn read_node(&mut self, line: &str) {
        if self.read_not_run(line) {
            return;
        }
        let Some(said) = NODE_MARKS.into_iter().find_map(|mark| line.strip_prefix(mark)) else { return };
        if self.read_not_run(said) {
            return;
        }
        let Some((name, number)) = said.trim().split_once(' ') else { return };
        if name != "duration_ms" {
            self.closing.extend(number.parse().ok().map(|number| (name.to_owned(), number)));
            return;
        }
        let closing = std::mem::take(&mut self.closing);
        let count = |name: &str| closing.get(name).copied().unwrap_or(0);
        let (failed, ignored) = (count("fail") + count("cancelled"), count("skipped") + count("todo"));
        if closing.contains_key("tests") && count("tests") == count("pass") + failed + ignored {
            self.counts.passed += count("pass");
            self.counts.failed += failed;
            self.counts.ignored += ignored;
        }
    }
}

/// A line without the sequences that colour it on a terminal.
fn without_colours(line: &str) -> String {
    let mut parts = line.split("\x1b[");
    let mut text = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        text += part.split_once('m').map_or(part, |(_, rest)| rest);
    }
    text.trim().to_owned()
}

/// The number before `word;` in ` ok. 3 passed; 0 failed; …`; zero where it is not there.
fn count_of(result: &str, word: &str) -> u64 {
    let mut fields = result.split(['.', ';']).map(str::trim);
    let number = fields.find_map(|field| field.strip_suffix(word)).map(|number| number.trim().parse());
    number.and_then(Result::ok).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const OUTPUT: &str = "running 7 tests
test a ... FAILED
test result: FAILED. 3 passed; 2 failed; 2 ignored; 0 measured; 7 filtered out; finished in 0.01s

NOT RUN: dissector: tshark is missing
test b ... FAILED
test result: FAILED. 40 passed; 1 failed; 0 ignored; 0 measured; 0 filtered out; finished in 1.50s";

    fn counted() -> Counts {
        Counts { passed: 43, failed: 3, ignored: 2, not_run: vec!["dissector: tshark is missing".to_owned()] }
    }

    #[test]
    fn results_of_all_binaries_are_added_up() {
        let mut tally = Tally::default();
        tally.feed(OUTPUT.as_bytes());
        assert_eq!(tally.finish(), counted());
    }

    #[test]
    fn pieces_may_end_anywhere() {
        for size in 1..40 {
            let mut tally = Tally::default();
            OUTPUT.as_bytes().chunks(size).for_each(|piece| tally.feed(piece));
            assert_eq!(tally.finish(), counted(), "pieces of {size}");
        }
    }

    #[test]
    fn colours_do_not_hide_a_result() {
        let mut tally = Tally::default();
        tally.feed(b"test result: \x1b[32mok\x1b[0m. 5 passed; 0 failed; 0 ignored; 0 measured\n");
        assert_eq!(tally.finish().passed, 5);
    }

    #[test]
    fn what_a_test_prints_about_results_is_not_counted() {
        let mut tally = Tally::default();
        tally.feed(b"the test result: ok. 5 passed; 0 failed\nassertion NOT RUN: no\ntest result\n");
        assert_eq!(tally.finish(), Counts::default());
    }

    fn node(output: &str) -> Counts {
        let mut tally = Tally::of(Runner::Node);
        tally.feed(output.as_bytes());
        tally.finish()
    }

    const TAP: &str = "TAP version 13
# Subtest: a
ok 1 - a
  ---
  duration_ms: 0.5
  ...
# NOT RUN: b: no image
1..7
# tests 7
# suites 1
# pass 3
# fail 1
# cancelled 1
# skipped 1
# todo 1
# duration_ms 45.7";

    #[test]
    fn nodes_runner_is_counted_in_both_of_its_forms() {
        let expected = Counts { passed: 3, failed: 2, ignored: 2, not_run: vec!["b: no image".to_owned()] };
        assert_eq!(node(TAP), expected);
        let for_people = TAP.replace("# ", "ℹ ").replace("ℹ NOT", "NOT");
        assert_eq!(node(&for_people), expected);
        let coloured: Vec<_> = for_people.lines().map(|line| format!("\x1b[34m{line}\x1b[39m")).collect();
        assert_eq!(node(&coloured.join("\n")), expected);
        assert_eq!(node(&format!("{TAP}\n{TAP}")).passed, 6, "two runs");
    }

    #[test]
    fn what_a_test_of_nodes_prints_about_results_is_not_counted() {
        assert_eq!(node("# pass 5\n# fail 1\n"), Counts::default(), "no end");
        assert_eq!(node("# tests 9\n# pass 5\n# duration_ms 4\n"), Counts::default(), "does not add up");
        assert_eq!(node("pass 5\n# pass five\n# duration_ms 4\n"), Counts::default());
        assert_eq!(node(&format!("# pass 5\n{TAP}")).passed, 3);
    }
}

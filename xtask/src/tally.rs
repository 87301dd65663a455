//! Counts tests by reading what `cargo test` prints, while it is passed on to the reader.

/// Line with which a test that could not run says so, past the test harness.
const NOT_RUN: &str = "NOT RUN: ";

/// What every test binary, and the doc tests of every crate, close with.
const RESULT: &str = "test result:";

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

/// Reads the output of `cargo test` in pieces of any size.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    counts: Counts,
    /// The line that has not ended yet.
    line: Vec<u8>,
}

impl Tally {
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
        let line = String::from_utf8_lossy(&self.line);
        let line = line.trim();
        if let Some(result) = line.strip_prefix(RESULT) {
            self.counts.passed += count_of(result, "passed");
            self.counts.failed += count_of(result, "failed");
            self.counts.ignored += count_of(result, "ignored");
        } else if let Some(why) = line.strip_prefix(NOT_RUN) {
            self.counts.not_run.push(why.to_owned());
        }
        self.line.clear();
    }
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
}

//! Golden transcripts: what a person sees of `osap`, command for command, against machines simulated in virtual time.
//!
//! `TRYCMD=overwrite cargo test -p osap --test transcripts` writes them anew; read the difference before you commit it.

#[test]
fn transcripts_are_as_they_were() {
    let cases = trycmd::TestCases::new();
    // What a person has in the environment shall not change what the tests see.
    for (name, value) in [("OSAP_LINK", ""), ("COLUMNS", "100"), ("NO_COLOR", "1"), ("CLICOLOR_FORCE", "0")] {
        cases.env(name, value);
    }
    cases.case("tests/cli/*.trycmd");
}

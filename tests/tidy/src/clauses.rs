//! Clauses: each numbered clause of the specification is named beside the code that meets it and the test that proves it.
//!
//! A clause is defined by a line of `protocol-spec/spec/*.md` that begins with its id in brackets and bold. Source is
//! any `src` folder outside of `#[cfg(test)]`; a test is a file under `tests`, a `#[cfg(test)]` item, or a vector that
//! gives the id as its `clause`. This crate's own folder is left out: its examples name clauses that mean nothing.

use std::collections::{BTreeMap, BTreeSet};

use toml::Value;

use crate::problem::Problem;
use crate::tree::{File, Tree};

/// Folder of the specification; clauses are defined in its own files, not in folders below it.
const SPEC: &str = "protocol-spec/spec/";

/// Folder of the hand-written vectors.
const VECTORS: &str = "protocol-spec/vectors/";

/// Folders whose mentions of clauses say nothing: this crate, and the hub, which checks itself against the vectors.
const LEFT_OUT: [&str; 2] = ["tests/tidy/", "hdl/"];

/// Where clauses were named.
#[derive(Debug, Default)]
struct Named {
    in_source: BTreeSet<String>,
    in_tests: BTreeSet<String>,
}

/// Every clause is defined once and named in source and tests, and no other is named.
#[must_use]
pub fn are_covered(tree: &Tree) -> Vec<Problem> {
    let (defined, mut problems) = definitions(tree);
    if defined.is_empty() {
        let mend = "define them in lines that begin with `**[ABC-01]**`";
        problems.push(Problem::in_file(SPEC, "no clause is defined", mend));
    }
    let families: BTreeSet<&str> = defined.keys().map(|id| &id[..3]).collect();
    let mut named = Named::default();
    for file in tree.files().filter(|file| !LEFT_OUT.iter().any(|folder| file.path.starts_with(folder))) {
        note_names(file, &mut named, &mut problems);
        problems.extend(unknown(file, &defined, &families));
    }
    for (id, (path, line)) in &defined {
        for (named, place, mend) in [
            (&named.in_source, "source", "name it beside the code that meets it"),
            (&named.in_tests, "test", "name it beside the test, or in the vector, that proves it"),
        ] {
            if !named.contains(id) {
                problems.push(Problem::at(path, *line, format!("`[{id}]` is named in no {place}"), mend));
            }
        }
    }
    problems
}

/// Where each clause is defined, by id, and those that are defined twice.
fn definitions(tree: &Tree) -> (BTreeMap<String, (String, usize)>, Vec<Problem>) {
    let (mut defined, mut problems) = (BTreeMap::new(), Vec::new());
    for file in tree.files().filter(|file| is_in(file, SPEC, "md")) {
        for (number, line) in file.lines() {
            let Some(id) = defined_by(line) else { continue };
            if let Some((path, first)) = defined.insert(id.to_owned(), (file.path.clone(), number)) {
                let what = format!("`[{id}]` is defined a second time, first at {path}:{first}");
                problems.push(Problem::at(&file.path, number, what, "give one of them the next free number"));
            }
        }
    }
    (defined, problems)
}

/// Whether `file` lies directly in `folder` and ends in `.extension`.
fn is_in(file: &File, folder: &str, extension: &str) -> bool {
    file.path.strip_prefix(folder).is_some_and(|name| !name.contains('/')) && file.has_extension(extension)
}

/// The id that a line of the specification defines.
fn defined_by(line: &str) -> Option<&str> {
    let id = line.strip_prefix("**[")?.split_once("]**")?.0;
    is_id(id).then_some(id)
}

/// Three capital letters, a dash, two digits.
fn is_id(text: &str) -> bool {
    let bytes = text.as_bytes();
    bytes.len() == 6
        && bytes[..3].iter().all(u8::is_ascii_uppercase)
        && bytes[3] == b'-'
        && bytes[4..].iter().all(u8::is_ascii_digit)
}

/// All that looks like an id in `text`, with where it begins. `AB-CDE-01` and `CDE-012` do not.
fn ids(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let continues = |byte: Option<&u8>| byte.is_some_and(|byte| byte.is_ascii_alphanumeric() || b"-_".contains(byte));
    (0..text.len().saturating_sub(5)).filter_map(move |at| {
        let id = text.get(at..at + 6).filter(|id| is_id(id))?;
        let bytes = text.as_bytes();
        let before = at.checked_sub(1).and_then(|before| bytes.get(before));
        let after = bytes.get(at + 6).filter(|byte| **byte != b'-');
        (!continues(before) && !continues(after)).then_some((at, id))
    })
}

fn note_names(file: &File, named: &mut Named, problems: &mut Vec<Problem>) {
    if is_in(file, VECTORS, "toml") {
        match file.text.parse::<toml::Table>() {
            Ok(table) => note_vector(&Value::Table(table), &mut named.in_tests),
            Err(error) => {
                problems.push(Problem::in_file(
                    &file.path,
                    format!("not TOML: {}", error.message()),
                    "mend the vector",
                ));
            }
        }
    }
    if !file.has_extension("rs") {
        return;
    }
    for (number, line) in file.lines() {
        let found = ids(line).map(|(_, id)| id.to_owned());
        if file.is_test_line(number) {
            named.in_tests.extend(found);
        } else if file.lies_in("src") {
            named.in_source.extend(found);
        }
    }
}

/// The ids in all `clause` fields at any depth, one or a list.
fn note_vector(value: &Value, found: &mut BTreeSet<String>) {
    match value {
        Value::Table(table) => {
            for (key, inner) in table {
                if key == "clause" {
                    found.extend(ids(&inner.to_string()).map(|(_, id)| id.to_owned()));
                } else {
                    note_vector(inner, found);
                }
            }
        }
        Value::Array(values) => values.iter().for_each(|inner| note_vector(inner, found)),
        _ => {}
    }
}

/// Names in `file` of clauses that do not exist. Without brackets only the families in use are looked at: a checksum's
/// name is no clause.
fn unknown(file: &File, defined: &BTreeMap<String, (String, usize)>, families: &BTreeSet<&str>) -> Vec<Problem> {
    let mut problems = Vec::new();
    for (number, line) in file.lines() {
        for (at, id) in ids(line).filter(|(_, id)| !defined.contains_key(*id)) {
            let is_bracketed = line[..at].ends_with('[') && line[at + 6..].starts_with(']');
            if is_bracketed || families.contains(&id[..3]) {
                let mend = "name a clause that exists, or define this one in the specification";
                problems.push(Problem::at(&file.path, number, format!("there is no clause `[{id}]`"), mend));
            }
        }
    }
    problems
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPEC_FILE: (&str, &str) = ("protocol-spec/spec/packet.md", "# Packets\n\n**[PKT-01]** A packet has bytes.\n");

    fn found(files: &[(&str, &str)]) -> Vec<String> {
        are_covered(&Tree::from_files(files)).iter().map(ToString::to_string).collect()
    }

    const SOURCE_LACKS: &str = "protocol-spec/spec/packet.md:3: `[PKT-01]` is named in no source; \
                                name it beside the code that meets it";
    const TEST_LACKS: &str = "protocol-spec/spec/packet.md:3: `[PKT-01]` is named in no test; \
                              name it beside the test, or in the vector, that proves it";

    #[test]
    fn a_clause_that_is_named_nowhere_lacks_both() {
        assert_eq!(found(&[SPEC_FILE]), [SOURCE_LACKS, TEST_LACKS]);
    }

    #[test]
    fn source_alone_lacks_a_test_and_every_kind_of_test_counts() {
        let source = ("runtime/src/node.rs", "//! `[PKT-01]`.\n");
        assert_eq!(found(&[SPEC_FILE, source]), [TEST_LACKS]);
        for test in [
            ("runtime/tests/a.rs", "// PKT-01\n"),
            ("tests/fuzz/src/main.rs", "// [PKT-01]\n"),
            ("runtime/src/b.rs", "#[cfg(test)]\nmod tests {\n    const A: &str = \"PKT-01\";\n}\n"),
            ("protocol-spec/vectors/a.toml", "[[vector]]\nclause = \"PKT-01\"\n"),
            ("protocol-spec/vectors/a.toml", "[deep.er]\nclause = [\"PKT-01\"]\n"),
        ] {
            assert_eq!(found(&[SPEC_FILE, source, test]), [""; 0], "{test:?}");
            assert_eq!(found(&[SPEC_FILE, test]), [SOURCE_LACKS], "{test:?}");
        }
    }

    #[test]
    fn what_does_not_prove_or_meet_a_clause_does_not_count() {
        for nothing in [
            ("README.md", "[PKT-01]\n"),
            ("hdl/src/lib.rs", "// [PKT-01]\n"),
            ("tests/tidy/src/clauses.rs", "// [PKT-01]\n"),
            ("runtime/examples/a.rs", "// [PKT-01]\n"),
            ("protocol-spec/vectors/a.toml", "# PKT-01\nname = \"PKT-01\"\n"),
            ("runtime/src/b.rs", "// XPKT-01 and PKT-011 and A-PKT-01\n"),
        ] {
            assert_eq!(found(&[SPEC_FILE, nothing]), [SOURCE_LACKS, TEST_LACKS], "{nothing:?}");
        }
    }

    #[test]
    fn a_clause_defined_twice_is_found() {
        let twice = ("protocol-spec/spec/routing.md", "**[PKT-01]** Again.\n");
        let found = found(&[SPEC_FILE, twice]);
        assert!(
            found[0].starts_with(
                "protocol-spec/spec/routing.md:1: `[PKT-01]` is defined a second time, first at \
                                  protocol-spec/spec/packet.md:3"
            ),
            "{found:?}"
        );
    }

    #[test]
    fn a_clause_that_does_not_exist_is_found_and_a_checksum_is_none() {
        let covered = [SPEC_FILE, ("a/src/b.rs", "// [PKT-01]\n"), ("a/tests/b.rs", "// [PKT-01]\n")];
        for text in ["// see [ABC-12]\n", "// see PKT-99.\n", "// [PKT-02]–[PKT-01]\n"] {
            let found = found(&[&covered[..], &[("a/src/c.rs", text)]].concat());
            assert!(found.len() == 1 && found[0].contains("there is no clause"), "{text}: {found:?}");
        }
        assert_eq!(found(&[&covered[..], &[("a/src/c.rs", "// CRC-16/IBM-3740, ISO-32\n")]].concat()), [""; 0]);
    }

    #[test]
    fn a_specification_without_clauses_does_not_pass() {
        let decision = ("protocol-spec/spec/decisions/0001-a.md", "**[PKT-01]** Only talked about.\n");
        let found = found(&[decision]);
        assert!(found.iter().any(|problem| problem.contains("no clause is defined")), "{found:?}");
    }

    #[test]
    fn a_vector_that_is_no_toml_is_found() {
        let found = found(&[SPEC_FILE, ("protocol-spec/vectors/a.toml", "clause = \n")]);
        assert!(found[0].starts_with("protocol-spec/vectors/a.toml: not TOML"), "{found:?}");
    }
}

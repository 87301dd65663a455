//! Files and functions stay small, or say why they may not.
//!
//! A file counts without its `#[cfg(test)]` items; a function counts from its signature to its closing brace, tests
//! too. Beyond the limit a comment `tidy: size:` with a reason excuses one of them: a function where it stands in the
//! comment directly above, or within the first lines of the body; the file where it stands anywhere else. A marker
//! that excuses nothing is a problem as well, so that none outlives its reason.

use std::ops::RangeInclusive;

use crate::facts::Function;
use crate::problem::Problem;
use crate::tree::{File, Tree};

/// Lines that a file may have, tests not counted.
pub const FILE_LINES_MAX: usize = 600;

/// Lines that a function may have.
pub const FUNCTION_LINES_MAX: usize = 70;

/// Lines below the opening brace of a function in which its marker may stand.
const MARKER_WITHIN_LINES: usize = 3;

/// What a marker begins with.
const MARKER: &str = concat!("// tidy: ", "size:");

/// No file and no function is over its limit without an excuse.
#[must_use]
pub fn are_small(tree: &Tree) -> Vec<Problem> {
    // Of a script only its file is measured: the parser knows Rust alone.
    let is_source = |file: &&File| file.has_extension("rs") || file.has_extension("mjs");
    tree.files().filter(is_source).flat_map(check_file).collect()
}

fn check_file(file: &File) -> Vec<Problem> {
    let mut problems = Vec::new();
    let mut markers: Vec<usize> = file.lines().filter_map(|(number, line)| is_marker(line).then_some(number)).collect();
    let mend = format!("split it where a reader would look for a part, or say why not in a line `{MARKER} <reason>`");
    for function in file.facts.iter().flat_map(|facts| &facts.functions) {
        let length = function.len_lines();
        if length <= FUNCTION_LINES_MAX {
            continue;
        }
        let region = marker_region(file, function);
        let all = markers.len();
        markers.retain(|line| !region.contains(line));
        if markers.len() == all {
            let what = format!("the function `{}` has {length} lines, over {FUNCTION_LINES_MAX}", function.name);
            problems.push(Problem::at(&file.path, *function.lines.start(), what, &mend));
        }
    }
    let length = file.lines().filter(|&(number, _)| !is_left_out(file, number)).count();
    if length <= FILE_LINES_MAX {
        let what = "this `size` marker excuses nothing: what it stands at is within its limit";
        problems.extend(markers.iter().map(|&line| Problem::at(&file.path, line, what, "remove the marker")));
    } else if markers.is_empty() {
        let what = format!("the file has {length} lines without its tests, over {FILE_LINES_MAX}");
        problems.push(Problem::in_file(&file.path, what, mend));
    }
    problems
}

fn is_marker(line: &str) -> bool {
    line.trim_start().strip_prefix(MARKER).is_some_and(|reason| !reason.trim().is_empty())
}

/// Whether a line does not count for its file's length: it is in a `#[cfg(test)]` item, or its file is the body of one.
/// Files in `tests` folders do count: nothing makes them long but themselves.
fn is_left_out(file: &File, line: usize) -> bool {
    file.is_test_line(line) && !file.lies_in("tests")
        || file.facts.as_ref().is_some_and(|facts| facts.is_test_line(line))
}

/// Lines in which a marker belongs to `function`: its attributes, the comments right above, and its first lines.
fn marker_region(file: &File, function: &Function) -> RangeInclusive<usize> {
    let lines: Vec<&str> = file.text.lines().collect();
    let above = lines[..function.head - 1].iter().rev();
    let comments = above.take_while(|line| line.trim_start().starts_with("//")).count();
    function.head - comments..=function.open + MARKER_WITHIN_LINES
}

#[cfg(test)]
mod tests {
    use super::*;

    fn function(name: &str, lines: usize, head: &str, first: &str) -> String {
        format!("{head}fn {name}() {{\n{first}{}}}\n", "    ();\n".repeat(lines - 2 - first.lines().count()))
    }

    fn problems(path: &str, text: &str) -> Vec<String> {
        are_small(&Tree::from_files(&[(path, text)])).iter().map(|problem| problem.what.clone()).collect()
    }

    #[test]
    fn a_function_may_have_its_limit_and_not_one_line_more() {
        assert_eq!(problems("a/src/b.rs", &function("b", FUNCTION_LINES_MAX, "", "")), [""; 0]);
        let found = problems("a/src/b.rs", &function("b", FUNCTION_LINES_MAX + 1, "", ""));
        assert_eq!(found, ["the function `b` has 71 lines, over 70"]);
    }

    #[test]
    fn a_marker_above_or_in_the_first_lines_excuses_its_function_only() {
        let marker = format!("{MARKER} one table\n");
        for text in [
            function("b", 80, &format!("{marker}/// Docs.\n#[inline]\n"), ""),
            function("b", 80, &format!("/// Docs.\n{marker}"), ""),
            function("b", 80, "", &marker),
        ] {
            assert_eq!(problems("a/src/b.rs", &text), [""; 0], "{text}");
            let both = format!("{text}{}", function("c", 80, "", ""));
            assert_eq!(problems("a/src/b.rs", &both), ["the function `c` has 80 lines, over 70"]);
        }
    }

    #[test]
    fn a_marker_without_a_reason_excuses_nothing() {
        let text = function("b", 80, &format!("{MARKER} \n"), "");
        assert_eq!(problems("a/src/b.rs", &text), ["the function `b` has 80 lines, over 70"]);
    }

    #[test]
    fn a_marker_that_is_no_longer_needed_is_found() {
        let text = function("b", 10, &format!("{MARKER} one table\n"), "");
        let found = problems("a/src/b.rs", &text);
        assert!(found.len() == 1 && found[0].contains("excuses nothing"), "{found:?}");
    }

    #[test]
    fn a_file_may_have_its_limit_without_its_tests_and_not_one_line_more() {
        let tests = format!("#[cfg(test)]\nmod tests {{\n{}}}\n", "// a\n".repeat(500));
        let full = "// a\n".repeat(FILE_LINES_MAX) + &tests;
        assert_eq!(problems("a/src/b.rs", &full), [""; 0]);
        let over = format!("// a\n{full}");
        assert_eq!(problems("a/src/b.rs", &over), ["the file has 601 lines without its tests, over 600"]);
        assert_eq!(problems("a/src/b.rs", &format!("{MARKER} one table\n{over}")), [""; 0]);
    }

    #[test]
    fn a_script_has_the_limit_of_a_file_too() {
        assert_eq!(problems("tests/a/src/b.mjs", &"// a\n".repeat(FILE_LINES_MAX)), [""; 0]);
        let found = problems("tests/a/src/b.mjs", &"// a\n".repeat(FILE_LINES_MAX + 1));
        assert_eq!(found, ["the file has 601 lines without its tests, over 600"]);
    }

    #[test]
    fn a_functions_marker_does_not_excuse_its_file() {
        let text = function("b", 80, &format!("{MARKER} one table\n"), "") + &"// a\n".repeat(600);
        assert_eq!(problems("a/src/b.rs", &text), ["the file has 681 lines without its tests, over 600"]);
    }

    #[test]
    fn a_file_of_tests_counts_unless_it_is_a_modules_body() {
        let long = "// a\n".repeat(601);
        assert_eq!(problems("a/tests/b.rs", &long).len(), 1);
        let tree = Tree::from_files(&[("a/src/lib.rs", "#[cfg(test)]\nmod tests;\n"), ("a/src/tests.rs", &long)]);
        assert_eq!(are_small(&tree), []);
    }
}

//! The walk of one packet as the README tells it: the names of the stages, in order.
//!
//! The README has a section headed `## One packet's walk`. Its numbered list, or its table, gives one stage an item;
//! an item starts with the stage's name in backticks. In a table a first cell that is only a number may come before.
//! The end-to-end tests compare these names with the trace of a simulated packet, so that the map cannot rot.

use std::path::{Path, PathBuf};
use std::{fs, io};

/// The heading that the walk stands under.
pub const HEADING: &str = "## One packet's walk";

/// Why the README tells no walk.
#[derive(Debug, thiserror::Error)]
pub enum WalkError {
    /// The file could not be read.
    #[error("cannot read {}: {source}; the walk is told in the README at the root of the repository", path.display())]
    Read {
        /// Where it was looked for.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// There is no such section.
    #[error("README.md has no section `{HEADING}`; add it with one numbered item per stage")]
    NoSection,
    /// The section has neither a numbered list nor a table.
    #[error(
        "README.md:{line}: the walk has no stages; add a numbered list whose items start with `stage` in backticks"
    )]
    NoStages {
        /// Line of the heading, counted from one.
        line: usize,
    },
    /// An item does not start with a name in backticks.
    #[error("README.md:{line}: this item names no stage: {text:?}; start it with the stage's name in backticks")]
    NoName {
        /// Line of the item, counted from one.
        line: usize,
        /// The item.
        text: String,
    },
}

/// The stages of one packet's walk, in the order in which the README at `root` tells them.
///
/// # Errors
/// Where there is no README, no such section, no stage in it, or an item that does not start with a name.
pub fn readme_walk(root: &Path) -> Result<Vec<String>, WalkError> {
    let path = root.join("README.md");
    match fs::read_to_string(&path) {
        Ok(text) => parse(&text),
        Err(source) => Err(WalkError::Read { path, source }),
    }
}

fn parse(text: &str) -> Result<Vec<String>, WalkError> {
    let mut lines = text.lines().zip(1..);
    let heading = lines.by_ref().find(|(line, _)| line.trim_end() == HEADING).ok_or(WalkError::NoSection)?.1;
    let (mut stages, mut in_code, mut in_table_body) = (Vec::new(), false, false);
    for (line, number) in lines {
        if line.trim_start().starts_with("```") {
            in_code = !in_code;
        }
        if in_code {
            continue;
        }
        if line.starts_with("# ") || line.starts_with("## ") {
            break;
        }
        let item = match line.strip_prefix('|') {
            Some(row) if in_table_body => Some(table_item(row)),
            Some(row) => {
                in_table_body = is_separator(row);
                None
            }
            None => {
                in_table_body = false;
                numbered_item(line)
            }
        };
        if let Some(item) = item {
            let text = item.to_owned();
            stages.push(stage_name(item).ok_or(WalkError::NoName { line: number, text })?.to_owned());
        }
    }
    if stages.is_empty() { Err(WalkError::NoStages { line: heading }) } else { Ok(stages) }
}

/// The text of `12. text`; a list inside an item is indented and is none.
fn numbered_item(line: &str) -> Option<&str> {
    let (number, text) = line.split_once(". ")?;
    is_number(number).then(|| text.trim_start())
}

/// The part of a table's row that holds the name: behind the number's cell, where there is one.
fn table_item(row: &str) -> &str {
    match row.split_once('|') {
        Some((first, rest)) if is_number(first.trim()) => rest.trim(),
        _ => row.trim(),
    }
}

fn is_number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

/// Whether a row is the line between a table's head and its body.
fn is_separator(row: &str) -> bool {
    row.contains('-') && row.chars().all(|c| "|-: ".contains(c))
}

fn stage_name(item: &str) -> Option<&str> {
    let name = item.strip_prefix('`')?.split_once('`')?.0;
    (!name.is_empty()).then_some(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(text: &str) -> String {
        parse(text).unwrap_err().to_string()
    }

    #[test]
    fn a_numbered_list_gives_its_stages_up_to_the_next_section() {
        let text = format!(
            "# A\n1. `not this`\n{HEADING}\nIn one line.\n1. `receive` takes bytes\n   1. `inner` is no stage\n\
             2. `link::deframe`: checks\n\n```text\n3. `code`\n```\n### More\n10. `route`\n## Next\n1. `nor this`\n"
        );
        assert_eq!(parse(&text).unwrap(), ["receive", "link::deframe", "route"]);
    }

    #[test]
    fn a_table_gives_its_stages_with_or_without_numbers() {
        for row in ["| 1 | `receive` | a |", "| `receive` | a | b |", "|`receive`|a|b|"] {
            let text = format!("{HEADING}\n\n| # | stage | what |\n|---|:--|---|\n{row}\n| 2 | `route` | b |\n");
            assert_eq!(parse(&text).unwrap(), ["receive", "route"], "{row}");
        }
    }

    #[test]
    fn what_is_missing_is_told_with_its_place() {
        assert!(said("# A\n").contains("no section"));
        assert!(said(&format!("# A\n{HEADING}\nNothing.\n")).starts_with("README.md:2: the walk has no stages"));
        for item in ["1. receive", "1. `receive", "1. ``", "1. the `receive`"] {
            let said = said(&format!("{HEADING}\n{item}\n"));
            assert!(said.starts_with("README.md:2: this item names no stage"), "{item}: {said}");
        }
        assert!(said(&format!("{HEADING}\n| a |\n|---|\n| receive |\n")).starts_with("README.md:4:"));
    }

    #[test]
    fn a_readme_is_read_from_the_root_and_its_absence_is_told() {
        let root = tempfile::tempdir().unwrap();
        let said = readme_walk(root.path()).unwrap_err().to_string();
        assert!(said.contains("cannot read") && said.contains("README.md"), "{said}");
        fs::write(root.path().join("README.md"), format!("{HEADING}\n1. `receive`\n")).unwrap();
        assert_eq!(readme_walk(root.path()).unwrap(), ["receive"]);
    }
}

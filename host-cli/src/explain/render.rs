//! An explanation as a table for people, without colours.

use super::{Explanation, Kind, Part};
use std::fmt::Write as _;

/// Bytes shown of a long field; JSON has them all.
const BYTES_SHOWN: usize = 8;

/// Lines of text, each ended: what the bytes were taken for, a table of their fields, what is wrong, the verdict.
#[must_use]
pub fn render(explanation: &Explanation) -> String {
    let mut text = String::new();
    line(&mut text, &explanation.why);
    for part in [Part::Frame, Part::Packet] {
        let rows: Vec<[String; 5]> = explanation
            .fields
            .iter()
            .filter(|field| field.part == part)
            .map(|field| {
                [
                    field.offset.to_string(),
                    shortened(&field.hex),
                    field.name.clone(),
                    field.value.clone(),
                    field.note.clone(),
                ]
            })
            .collect();
        if rows.is_empty() {
            continue;
        }
        if explanation.kind == Kind::Frame {
            line(&mut text, if part == Part::Frame { "\nframe" } else { "\npacket in it" });
        }
        table(&mut text, &rows);
    }
    if !explanation.problems.is_empty() {
        line(&mut text, "");
    }
    for problem in &explanation.problems {
        let place = match (explanation.kind, problem.part) {
            (Kind::Frame, Part::Packet) => format!("byte {} of the packet", problem.offset),
            _ => format!("byte {}", problem.offset),
        };
        line(&mut text, &format!("wrong at {place}: {} [{}]", problem.what, problem.clause));
        line(&mut text, &format!("  then: {}", problem.then));
    }
    line(&mut text, &format!("\n{}", explanation.verdict));
    text
}

fn line(text: &mut String, content: &str) {
    // Writing to a string cannot fail.
    let _ = writeln!(text, "{content}");
}

fn shortened(hex: &str) -> String {
    match hex.char_indices().nth(BYTES_SHOWN * 3 - 1) {
        Some((at, _)) => format!("{} …", &hex[..at]),
        None => hex.to_owned(),
    }
}

/// Columns as wide as what stands in them; the first is of numbers, the last is not filled up.
fn table(text: &mut String, rows: &[[String; 5]]) {
    let head = ["byte", "hex", "field", "says", ""].map(str::to_owned);
    let rows: Vec<&[String; 5]> = std::iter::once(&head).chain(rows).collect();
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or_default();
    let widths = [width(0), width(1), width(2), width(3)];
    for row in &rows {
        let [at, hex, name, value, note] = row;
        let [a, b, c, d] = widths;
        line(text, format!("{at:>a$}  {hex:<b$}  {name:<c$}  {value:<d$}  {note}").trim_end());
    }
}

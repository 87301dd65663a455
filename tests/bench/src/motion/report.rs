//! What the measurements of motion found, as one table, one document and one page.
//!
//! - **Walk:** the documents of the emulated images, of the model and of `bench motion-error` and `motion-inject` → [`Row`]s → table, document,
//!   page.
//! - **Invariants:** every row has its goal, how it was found, its conditions and the command that finds it again. What did not run is told as
//!   that, with its reason, and is not met.

mod rows;

use rows::{Row, Verdict};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Where the measurements are, and where the report goes.
#[derive(clap::Args, Debug)]
pub(crate) struct Options {
    /// The document of the emulated images' `evaluations`
    #[arg(long, value_name = "FILE")]
    evaluations: Option<PathBuf>,
    /// The document of the emulated images' `motion`
    #[arg(long, value_name = "FILE")]
    outputs: Option<PathBuf>,
    /// The document of the model of other processors
    #[arg(long, value_name = "FILE")]
    modelled: Option<PathBuf>,
    /// The document of `motion-error`
    #[arg(long, value_name = "FILE")]
    errors: Option<PathBuf>,
    /// The document of `motion-inject`
    #[arg(long, value_name = "FILE")]
    injection: Option<PathBuf>,
    /// A measurement that did not run, and why
    #[arg(long, value_name = "TEXT")]
    not_run: Vec<String>,
    /// A page to write
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// A document to write
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// Makes rows of a document.
type Reader = fn(&Value) -> Vec<Row>;

/// Prints the table and writes what is asked for. Fails where nothing could be read, not where a goal is missed.
pub(crate) fn run(options: &Options) -> ExitCode {
    match report(options) {
        Ok(()) => ExitCode::SUCCESS,
        Err(fault) => {
            eprintln!("error: {fault}");
            ExitCode::FAILURE
        }
    }
}

fn report(options: &Options) -> Result<(), String> {
    let parts: [(&Option<PathBuf>, Reader); 5] = [
        (&options.evaluations, rows::evaluations),
        (&options.modelled, rows::modelled),
        (&options.outputs, rows::outputs),
        (&options.errors, rows::errors),
        (&options.injection, rows::injection),
    ];
    let mut rows = Vec::new();
    for (path, read) in parts {
        if let Some(path) = path {
            rows.extend(read(&document(path)?));
        }
    }
    let table = table(&rows, &options.not_run);
    print!("{table}");
    if let Some(path) = &options.html {
        write(path, &page(&table))?;
    }
    if let Some(path) = &options.json {
        let all: Vec<Value> = rows.iter().map(Row::json).collect();
        let document = json!({ "version": 1, "report": "motion", "rows": all, "not_run": options.not_run });
        write(path, &format!("{document:#}\n"))?;
    }
    Ok(())
}

fn document(path: &Path) -> Result<Value, String> {
    let text = std::fs::read_to_string(path)
        .map_err(|error| format!("cannot read {}: {error}; measure first", path.display()))?;
    serde_json::from_str(&text).map_err(|error| format!("{} is no document: {error}", path.display()))
}

fn write(path: &Path, text: &str) -> Result<(), String> {
    std::fs::write(path, text)
        .map_err(|error| format!("cannot write {}: {error}; name another file", path.display()))?;
    eprintln!("wrote {}", path.display());
    Ok(())
}

/// All rows below one head, columns as wide as they need.
fn table(rows: &[Row], not_run: &[String]) -> String {
    let cells: Vec<[String; Row::COLUMNS]> = std::iter::once(Row::head()).chain(rows.iter().map(Row::cells)).collect();
    let width = |column: usize| cells.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: [usize; Row::COLUMNS] = std::array::from_fn(width);
    let mut text = String::new();
    for row in &cells {
        let padded = row.iter().zip(&widths).enumerate().map(|(column, (cell, width))| {
            if column == Row::FIGURE { format!("{cell:>width$}") } else { format!("{cell:<width$}") }
        });
        text.push_str(padded.collect::<Vec<_>>().join("  ").trim_end());
        text.push('\n');
    }
    for what in not_run {
        // writing to a string cannot fail
        let _ = writeln!(text, "NOT RUN: {what}");
    }
    let count = |wanted: Verdict| rows.iter().filter(|row| row.verdict() == wanted).count();
    let _ = writeln!(
        text,
        "{} goals met, {} missed, {} figures without a goal, {} not run",
        count(Verdict::Met),
        count(Verdict::Missed),
        count(Verdict::NoGoal),
        not_run.len()
    );
    text
}

fn page(table: &str) -> String {
    let escaped = table.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<title>Motion</title>\n\
         <style>body{{font:16px/1.4 sans-serif;margin:2em}}pre{{overflow:auto;font-size:12px}}</style>\n</head>\n\
         <body>\n<h1>Exact motion on the device</h1>\n<pre>{escaped}</pre>\n</body>\n</html>\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A goal that is missed, one that is met and what did not run are told apart and counted.
    #[test]
    fn the_table_counts_what_it_shows() {
        let document = json!({ "data": { "evaluations": [
            { "name": "a", "cycles": 39.6, "goal": 40.0 }, { "name": "b", "cycles": 20.5, "goal": 20.0 },
            { "name": "c", "cycles": 5.0, "goal": null } ] } });
        let text = table(&rows::evaluations(&document), &["model: no llvm-mca".to_owned()]);
        assert!(text.contains("NOT RUN: model: no llvm-mca\n"), "{text}");
        assert!(text.ends_with("1 goals met, 1 missed, 1 figures without a goal, 1 not run\n"), "{text}");
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[1].contains("39.6") && lines[1].contains("met") && lines[2].contains("MISSED"), "{text}");
        assert!(page(&text).contains("&lt;") == text.contains('<'));
    }
}

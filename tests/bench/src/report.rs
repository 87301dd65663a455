//! What the three measurements of clocks found, as one table, one document and one page of plots.
//!
//! - **Walk:** the documents of `bench clock`, of the emulated images and of `bench clock-pty` → [`Row`]s → table, document, page.
//! - **Invariants:** a row is judged by what it was measured for; what did not run is told as that, and is not met.

mod page;
mod rows;

use rows::{Row, Verdict};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Where the measurements are, and where the report goes.
#[derive(clap::Args, Debug)]
pub(crate) struct Options {
    /// The document of `clock`
    #[arg(long, value_name = "FILE")]
    simulated: Option<PathBuf>,
    /// Time series of `clock`
    #[arg(long, value_name = "FILE")]
    series: Option<PathBuf>,
    /// The document of the emulated images' `clock`
    #[arg(long, value_name = "FILE")]
    images: Option<PathBuf>,
    /// The document of `clock-pty`
    #[arg(long, value_name = "FILE")]
    host: Option<PathBuf>,
    /// A measurement that did not run, and why
    #[arg(long, value_name = "TEXT")]
    not_run: Vec<String>,
    /// A page of plots to write
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// A document to write
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// One curve: a node's errors and bounds over time.
#[derive(Clone, Debug, PartialEq)]
struct Curve {
    /// Of the row that it belongs to.
    name: String,
    hops: u64,
    /// Seconds since joining, error µs, bound µs.
    points: Vec<(f64, f64, Option<f64>)>,
}

/// Prints the table and writes what is asked for.
pub(crate) fn run(options: &Options) -> ExitCode {
    match report(options) {
        Ok(is_met) if is_met => ExitCode::SUCCESS,
        Ok(_) => ExitCode::FAILURE,
        Err(fault) => {
            eprintln!("error: {fault}");
            ExitCode::FAILURE
        }
    }
}

/// Whether no bound was broken; goals that are missed are told, not failed.
fn report(options: &Options) -> Result<bool, String> {
    let mut rows = Vec::new();
    let mut curves = Vec::new();
    if let Some(path) = &options.simulated {
        rows.extend(rows::simulated(&document(path)?));
    }
    if let Some(path) = &options.series {
        curves.extend(of_csv(&text(path)?));
    }
    if let Some(path) = &options.images {
        let (found, drawn) = rows::images(&document(path)?);
        rows.extend(found);
        curves.extend(drawn);
    }
    if let Some(path) = &options.host {
        let (found, drawn) = rows::host(&document(path)?);
        rows.extend(found);
        curves.extend(drawn);
    }
    let table = table(&rows, &options.not_run);
    print!("{table}");
    if let Some(path) = &options.html {
        write(path, &page::page(&table, &curves)?)?;
    }
    if let Some(path) = &options.json {
        let all: Vec<Value> = rows.iter().map(Row::json).collect();
        let document = json!({ "version": 1, "report": "clock", "rows": all, "not_run": options.not_run });
        write(path, &format!("{document:#}\n"))?;
    }
    Ok(rows.iter().all(|row| row.verdict() != Verdict::BoundBroken))
}

fn text(path: &Path) -> Result<String, String> {
    std::fs::read_to_string(path).map_err(|error| format!("cannot read {}: {error}; measure first", path.display()))
}

fn document(path: &Path) -> Result<Value, String> {
    serde_json::from_str(&text(path)?).map_err(|error| format!("{} is no document: {error}", path.display()))
}

fn write(path: &Path, text: &str) -> Result<(), String> {
    std::fs::write(path, text)
        .map_err(|error| format!("cannot write {}: {error}; name another file", path.display()))?;
    eprintln!("wrote {}", path.display());
    Ok(())
}

/// The curves of `bench clock --series`; lines that are none are left out.
fn of_csv(text: &str) -> Vec<Curve> {
    let mut curves: Vec<Curve> = Vec::new();
    for line in text.lines().skip(1) {
        // names may have commas in them
        let mut fields = line.rsplitn(7, ',');
        let (bound, error, after, hops) = (fields.next(), fields.next(), fields.next(), fields.next());
        let (_node, servo, name) = (fields.next(), fields.next(), fields.next());
        let (Some(Ok(after_us)), Some(Ok(error_us)), Some(Ok(hops)), Some(servo), Some(name)) =
            (after.map(str::parse::<f64>), error.map(str::parse::<f64>), hops.map(str::parse::<u64>), servo, name)
        else {
            continue;
        };
        let name = rows::named(name, servo);
        let point = (after_us * 1e-6, error_us, bound.and_then(|bound| bound.parse().ok()));
        match curves.last_mut() {
            Some(last) if last.name == name && last.hops == hops => last.points.push(point),
            _ => curves.push(Curve { name, hops, points: vec![point] }),
        }
    }
    curves
}

/// All rows below one head, columns as wide as they need.
fn table(rows: &[Row], not_run: &[String]) -> String {
    let cells: Vec<Vec<String>> = std::iter::once(Row::head()).chain(rows.iter().map(Row::cells)).collect();
    let columns = cells.first().map_or(0, Vec::len);
    let widths: Vec<usize> = (0..columns)
        .map(|column| cells.iter().map(|row| row.get(column).map_or(0, |cell| cell.chars().count())).max().unwrap_or(0))
        .collect();
    let mut text = String::from("errors and bounds in µs; times in s, median / worst run\n");
    for row in &cells {
        let padded = row.iter().zip(&widths).enumerate().map(|(at, (cell, width))| {
            if at < rows::TEXT_COLUMNS || at + 1 == columns {
                format!("{cell:<width$}")
            } else {
                format!("{cell:>width$}")
            }
        });
        text.push_str(padded.collect::<Vec<_>>().join("  ").trim_end());
        text.push('\n');
    }
    for what in not_run {
        // writing to a string cannot fail
        let _ = writeln!(text, "NOT RUN: {what}");
    }
    let count = |wanted: fn(&Verdict) -> bool| rows.iter().filter(|row| wanted(&row.verdict())).count();
    let (met, missed) = (count(|it| *it == Verdict::Met), count(|it| matches!(it, Verdict::Missed(_))));
    let broken = count(|it| *it == Verdict::BoundBroken);
    let missing = not_run.len();
    let _ = writeln!(text, "{met} rows meet their goals, {missed} miss one, {broken} break a bound, {missing} not run");
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn series_become_curves_by_row_and_hops() {
        let text = "scene,servo,node,hops,after_us,error_us,bound_us\n4 hops, late,estimator,1,1,1000,0.5,\n\
                    4 hops, late,estimator,1,1,2000,-0.5,1.5\n4 hops, late,estimator,2,2,2000,7,2\nno line\n";
        let curves = of_csv(text);
        assert_eq!(curves.len(), 2);
        assert_eq!((curves[0].name.as_str(), curves[0].hops), ("4 hops, late", 1));
        assert_eq!(curves[0].points, [(0.001, 0.5, None), (0.002, -0.5, Some(1.5))]);
        assert_eq!(curves[1].points, [(0.002, 7.0, Some(2.0))]);
    }

    /// What did not run stands in the table, and is counted.
    #[test]
    fn what_did_not_run_is_told() {
        let text = table(&[], &["images: no emulator".to_owned()]);
        assert!(
            text.contains("NOT RUN: images: no emulator\n") && text.ends_with("0 break a bound, 1 not run\n"),
            "{text}"
        );
    }
}

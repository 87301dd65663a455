//! `osap maxl error`: how far a spline is from the path its points came from, for every interval, and which one to take.
//!
//! - **Walk:** file → [`Path`] → [`measure`] → a table with the bound beside each interval, or one document; plots of it.

use super::chart::{Chart, Scale, Series};
use super::{EndsArg, figure, html, input, plot};
use crate::cli::output::{GOOD, count, printable};
use crate::cli::progress::Progress;
use crate::cli::table::{Align, Table};
use crate::cli::{CliError, Exit, Output};
use crate::motion::curve::Ends;
use crate::motion::deviation::{Choice, IntervalReport, Setup, best, choices, longest_by_bound, measure};
use crate::motion::fit::Fit;
use crate::motion::path::Path;
use crate::motion::points::Lsb;
use clap::{Args, ValueEnum};
use osap_protocol::motion::{POINTS_MAX, Points};
use serde::Serialize;
use std::path::PathBuf;

/// Intervals that a device knows.
const INTERVALS: u64 = 7;

/// Bytes of a message's packet and frame over one link beside the message itself: pointer, TTL and MTU 5, the step over the link 1, the
/// port 3, the transport's key 1, CRC-32 4, stuffing and delimiter 2.
const FRAME_BYTES: u32 = 5 + 1 + 3 + 1 + 4 + 2;
/// Bytes of a point, after those that its message has once.
const POINT_BYTES: u32 = 4;

/// Shows how far splines are from a path for each interval, and recommends one
#[derive(Debug, Args)]
#[command(
    long_about = "Shows how far splines are from a path for each interval, and recommends one\n\n\
                  FILE is a time series: a first row of names, a first column named time_us or time_s, a column of positions for each axis. \
                  Between two rows the path is a straight line run through at constant speed, so give it at a period well below 256 µs where it \
                  is smooth.\n\n\
                  For each interval control points are made from the path, rounded to --lsb and played by a device's own arithmetic; the \
                  deviation is taken at equal times, in the file's units, as the length of the vector of all axes. The bound beside it is \
                  h²A/6 + 13/48·h·|Δv|, for points on the path, with A and Δv read off the file: the split that makes it least. \
                  What rounding adds, 1.5 steps an axis, is in it.",
    after_help = "Points are made by one of:\n  sample     on the path: never accelerates more than the path does\n  quasi      beside it, by what a \
                  parabola would be cut\n  prefilter  where the spline goes through the samples\n\n\
                  Examples:\n  osap maxl error path.csv --tolerance 0.005\n  osap maxl error path.csv --fit sample --plot\n  osap maxl error path.csv --html path.html"
)]
pub(super) struct ErrorArgs {
    /// A path over time as comma-separated values; `-` is standard input
    file: PathBuf,
    /// How far a spline may be off, units: 10 µm where these are mm
    #[arg(long, value_name = "UNITS", default_value_t = 0.01, value_parser = parse_tolerance)]
    tolerance: f64,
    /// How points are made
    #[arg(long, value_enum, default_value = "all")]
    fit: FitArg,
    /// What one step of a device's 32-bit position is in units: 2^-16, 1/256, 0.001
    #[arg(long, value_name = "STEP", default_value_t = Lsb::DEFAULT)]
    lsb: Lsb,
    /// Time between looks at the spline: a power of two, 256 at most; 64 is a device's usual beat
    #[arg(long, value_name = "N", default_value = "64", value_parser = parse_every)]
    every_us: u32,
    /// Offsets at which the path is laid against the grid of points; the worst counts
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=64))]
    phases: u32,
    /// Where the path ends: repeat lets it stand still before its first row and after its last; open looks only where all points a spline needs
    /// are in it
    #[arg(long, value_enum, default_value = "repeat")]
    ends: EndsArg,
    /// Points of an axis in one message, for the bytes that they take on a wire: 1 to 32
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=POINTS_MAX as i64))]
    batch: u32,
    /// Draws deviation over interval after the table
    #[arg(long)]
    plot: bool,
    /// Writes a page with plots and tables to this file
    #[arg(long, value_name = "OUT")]
    html: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum FitArg {
    All,
    Sample,
    Quasi,
    Prefilter,
}

impl FitArg {
    const fn fits(self) -> &'static [Fit] {
        match self {
            Self::All => &Fit::ALL,
            Self::Sample => &[Fit::Sample],
            Self::Quasi => &[Fit::Quasi],
            Self::Prefilter => &[Fit::Prefilter],
        }
    }
}

fn parse_tolerance(text: &str) -> Result<f64, String> {
    let value: Option<f64> = text.parse().ok();
    value
        .filter(|it| it.is_finite() && *it > 0.0)
        .ok_or_else(|| format!("expected a length above zero, such as 0.01, not {text:?}"))
}

fn parse_every(text: &str) -> Result<u32, String> {
    let value: Option<u32> = text.parse().ok();
    let wanted = || format!("expected 1, 2, 4, 8, 16, 32, 64, 128 or 256 µs, not {text:?}");
    value.filter(|us| us.is_power_of_two() && *us <= 256).ok_or_else(wanted)
}

#[derive(Serialize)]
struct Recommendation<'a> {
    #[serde(flatten)]
    choice: &'a Choice,
    bytes_per_s_per_axis: f64,
}

#[derive(Serialize)]
struct Document<'a> {
    axes: &'a [String],
    rows: usize,
    duration_s: f64,
    every_us: u32,
    phases: u32,
    /// Units a step.
    lsb: f64,
    ends: Ends,
    tolerance: f64,
    /// Points a message.
    batch: u32,
    intervals: &'a [IntervalReport],
    /// For each fit that was asked for and has one, the longest interval within the tolerance.
    choices: &'a [Choice],
    /// The longest interval whose bound is within the tolerance.
    longest_by_bound_us: Option<u32>,
    recommendation: Option<Recommendation<'a>>,
}

pub(super) fn run(args: &ErrorArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    if args.plot && output.json() {
        let next = "leave out one of them; --html draws beside --json";
        return Err(CliError::new(Exit::Usage, "--plot and --json exclude each other", "the command line", next));
    }
    let table = input::table(&args.file)?;
    let path = Path::from_table(&table).map_err(|error| input::no_path(&args.file, &error))?;
    let setup = Setup { lsb: args.lsb, ends: args.ends.into(), phases: args.phases, every_us: args.every_us };
    let bar = Progress::bar(output, "measuring", INTERVALS);
    let measured = measure(&path, &setup, |_| bar.step());
    drop(bar);
    let mut reports = measured.map_err(|error| {
        let next = "take a coarser step by --lsb, or positions nearer to 0";
        CliError::new(Exit::Io, error.to_string(), input::place(&args.file), next)
    })?;
    for report in &mut reports {
        report.fits.retain(|it| args.fit.fits().contains(&it.fit));
    }
    let found =
        Found { args, path: &path, reports: &reports, choices: choices(&reports, args.fit.fits(), args.tolerance) };
    found.tell(output)?;
    Ok(if best(&found.choices).is_some() { Exit::Ok } else { Exit::Differs })
}

struct Found<'a> {
    args: &'a ErrorArgs,
    path: &'a Path,
    reports: &'a [IntervalReport],
    choices: Vec<Choice>,
}

impl Found<'_> {
    fn tell(&self, output: &mut Output<'_>) -> Result<(), CliError> {
        let advice = self.advice();
        if output.json() {
            output.document("maxl-error", &self.document())?;
        } else {
            output.line(self.conditions())?;
            output.text(self.table())?;
            for report in self.reports {
                if let Some(why) = &report.not_measured {
                    output.say(format!("note: nothing at {} µs: {why}", report.interval_us));
                }
            }
            output.line("")?;
            for line in &advice {
                output.line(line)?;
            }
        }
        if self.args.plot {
            output.line("")?;
            output.text(plot::draw(&self.chart()))?;
        }
        if let Some(file) = &self.args.html {
            let title = format!("Splines of {}", input::place(&self.args.file));
            let advice = anstream::adapter::strip_str(&advice.join("\n")).to_string();
            let tables = [("Conditions", self.conditions()), ("Deviations", self.table().plain()), ("Advice", advice)];
            html::write(file, &title, &[self.chart()], &tables, output)?;
        }
        Ok(())
    }

    fn conditions(&self) -> String {
        format!(
            "{}, {}, {:.3} s; {} of the grid, a look every {} µs, steps of {}",
            count(self.path.names().len(), "axis", "axes"),
            count(self.path.len(), "row", "rows"),
            self.path.duration_us() / 1e6,
            count(self.args.phases as usize, "phase", "phases"),
            self.args.every_us,
            self.args.lsb,
        )
    }

    fn document(&self) -> Document<'_> {
        let recommendation = best(&self.choices);
        Document {
            axes: self.path.names(),
            rows: self.path.len(),
            duration_s: self.path.duration_us() / 1e6,
            every_us: self.args.every_us,
            phases: self.args.phases,
            lsb: self.args.lsb.units(),
            ends: self.args.ends.into(),
            tolerance: self.args.tolerance,
            batch: self.args.batch,
            intervals: self.reports,
            choices: &self.choices,
            longest_by_bound_us: longest_by_bound(self.reports, self.args.tolerance),
            recommendation: recommendation
                .map(|choice| Recommendation { choice, bytes_per_s_per_axis: self.bytes_per_s(choice) }),
        }
    }

    fn bytes_per_s(&self, choice: &Choice) -> f64 {
        #[expect(clippy::cast_possible_truncation, reason = "eleven")]
        let message = FRAME_BYTES + Points::HEAD_BYTES as u32 + POINT_BYTES * self.args.batch;
        choice.points_per_s * f64::from(message) / f64::from(self.args.batch)
    }

    /// A row for each interval and fit.
    fn table(&self) -> Table {
        let names = self.path.names();
        let columns = [("µs", Align::Right), ("points/s", Align::Right), ("fit", Align::Left)];
        let columns = columns.map(|(name, align)| (name.to_owned(), align)).into_iter();
        let axes = names.iter().filter(|_| names.len() > 1).map(|name| (printable(name), Align::Right));
        let more = ["max", "at s", "rms", "bound", "A", "Δv", "accel", "over", "jerk"];
        let mut table = Table::new(columns.chain(axes).chain(more.map(|name| (name.to_owned(), Align::Right))));
        for report in self.reports {
            for (row, it) in report.fits.iter().enumerate() {
                let points_per_s = 1e6 / f64::from(report.interval_us);
                let head = if row == 0 {
                    [report.interval_us.to_string(), format!("{points_per_s:.0}")]
                } else {
                    [String::new(), String::new()]
                };
                let axes = it.axes.iter().filter(|_| names.len() > 1).map(|axis| figure(axis.max));
                let norm = [figure(it.norm.max), format!("{:.4}", it.norm.max_at_s), figure(it.norm.rms)];
                let bound = it.bound.map_or_else(Default::default, |bound| {
                    let of = &report.norm_bound;
                    [figure(bound), figure(of.acceleration_per_s2), figure(of.velocity_change_per_s)]
                });
                let spline =
                    [figure(it.acceleration_max_per_s2), format!("{:.2}", it.overshoot), figure(it.jerk_max_per_s3)];
                let cells = head.into_iter().chain([it.fit.name().to_owned()]).chain(axes).chain(norm);
                table.row(cells.chain(bound).chain(spline));
            }
        }
        table
    }

    /// What to take, and what each fit would allow.
    fn advice(&self) -> Vec<String> {
        let tolerance = figure(self.args.tolerance);
        let mut lines: Vec<String> = self
            .choices
            .iter()
            .map(|it| {
                let over = if it.overshoot > 1.005 {
                    format!(", accelerations up to {:.2} times those of sample", it.overshoot)
                } else {
                    String::new()
                };
                format!(
                    "{:<9} {} µs keeps {tolerance}: off by {}{over}",
                    it.fit.name(),
                    it.interval_us,
                    figure(it.deviation)
                )
            })
            .collect();
        if let Some(us) = longest_by_bound(self.reports, self.args.tolerance) {
            lines.push(format!("{:<9} {us} µs keeps {tolerance} on any path as fast as this, points on it", "bound"));
        }
        lines.push(best(&self.choices).map_or_else(
            || {
                let shortest = self.reports.iter().flat_map(|it| &it.fits).map(|it| it.norm.max).reduce(f64::min);
                let most = shortest.map_or_else(|| "nothing could be measured".to_owned(), |it| format!("the least is {}", figure(it)));
                format!("no interval keeps {tolerance}: {most}; slow the path down, round its corners, or allow more by --tolerance")
            },
            |it| {
                format!(
                    "{GOOD}take {} µs with {}{GOOD:#}: {} points/s and {} bytes/s an axis over one link, {} a message",
                    it.interval_us,
                    it.fit.name(),
                    figure(it.points_per_s),
                    figure(self.bytes_per_s(it)),
                    count(self.args.batch as usize, "point", "points"),
                )
            },
        ));
        lines
    }

    /// Deviation over interval, both on logarithmic scales, with the bound and the tolerance.
    fn chart(&self) -> Chart {
        // what is exactly 0 has no logarithm, and a spline of whole steps is no better than a fraction of one
        let log = |units: f64| units.max(self.args.lsb.units() / 1e3).log10();
        let at = |report: &IntervalReport| f64::from(report.interval_us).log2();
        let of_fit = |fit: &Fit| {
            let points = self.reports.iter().filter_map(|report| {
                let it = report.fits.iter().find(|it| it.fit == *fit)?;
                Some((at(report), log(it.norm.max)))
            });
            Series::new(fit.name(), &points.collect::<Vec<_>>())
        };
        let mut series: Vec<Series> = self.args.fit.fits().iter().map(of_fit).collect();
        let bound = |it: &IntervalReport| (at(it), log(it.norm_bound.deviation + it.rounding));
        series.push(Series::new("bound of sample", &self.reports.iter().map(bound).collect::<Vec<_>>()));
        let tolerance = |it: &IntervalReport| (at(it), log(self.args.tolerance));
        series.push(Series::new("tolerance", &self.reports.iter().map(tolerance).collect::<Vec<_>>()));
        Chart::of("largest deviation", ("interval, µs", Scale::PowersOfTwo), ("units", Scale::Decades), series)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_is_as_long_as_it_is_counted() {
        for positions in [&[1][..], &[1, 2, 3]] {
            let mut out = [0; 64];
            let points = Points { axis: 0, time: fixed_math::time::NetTime::from_us(0), positions };
            let length = points.encode(&mut out).unwrap();
            assert_eq!(length, Points::HEAD_BYTES + POINT_BYTES as usize * positions.len());
        }
    }

    #[test]
    fn tolerances_and_looks_are_checked() {
        assert_eq!((parse_tolerance("0.5"), parse_every("8")), (Ok(0.5), Ok(8)));
        for wrong in ["0", "-1", "inf", "nan", "x"] {
            assert!(parse_tolerance(wrong).is_err(), "{wrong}");
        }
        for wrong in ["0", "3", "512", "x"] {
            assert!(parse_every(wrong).is_err(), "{wrong}");
        }
    }
}

//! `osap maxl eval`: control points in, samples of the spline out, as a device plays it.
//!
//! - **Walk:** file → [`Points`] → [`Curve`] → a row of CSV for each instant, or one document, or plots.

use super::chart::{Chart, Scale, Series};
use super::{EndsArg, figure, html, input, plot};
use crate::cli::output::printable;
use crate::cli::table::{Align, Table};
use crate::cli::{CliError, Exit, Output};
use crate::motion::curve::{Curve, Ends};
use crate::motion::points::{Lsb, Points};
use clap::Args;
use fixed_math::spline::IntervalLog2;
use serde::Serialize;
use std::path::PathBuf;

/// Position and its derivatives, and what a column's name ends in.
const VALUES: [(&str, &str); 4] =
    [("position", ""), ("velocity", "_per_s"), ("acceleration", "_per_s2"), ("jerk", "_per_s3")];

/// Plays control points: position, velocity, acceleration and jerk as a device calculates them
#[derive(Debug, Args)]
#[command(
    long_about = "Plays control points: position, velocity, acceleration and jerk as a device calculates them\n\n\
                  FILE has one row for each point and one column for each axis, separated by commas. A first row may name the columns; \
                  a first column named time_us or time_s has the points' times, which are multiples of the interval. Lines that begin \
                  with # are comments.\n\n\
                  Positions become whole steps of --lsb, as a device has them. What comes out is in the file's own units, units/s, units/s² \
                  and units/s³.",
    after_help = "Examples:\n  osap maxl eval points.csv --interval-us 1024 > samples.csv\n  osap maxl eval points.csv --interval-us 4096 --plot\n  \
                  some-planner | osap maxl eval - --interval-us 2048 --lsb 1/256 --json"
)]
pub(super) struct EvalArgs {
    /// Control points as comma-separated values; `-` is standard input
    file: PathBuf,
    /// Time between points: a power of two from 256 to 16384
    #[arg(long, value_name = "N", value_parser = input::parse_interval)]
    interval_us: IntervalLog2,
    /// Time between samples; 64 is a device's usual beat
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..))]
    every_us: u32,
    /// What one step of a device's 32-bit position is in units: 2^-16, 1/256, 0.001
    #[arg(long, value_name = "STEP", default_value_t = Lsb::DEFAULT)]
    lsb: Lsb,
    /// Where the curve ends: repeat takes the first and the last point thrice, so that it begins and ends in them at rest; open takes them
    /// once, so that it lasts from the second point to the last but one
    #[arg(long, value_enum, default_value = "repeat")]
    ends: EndsArg,
    /// Draws plots instead of writing the samples
    #[arg(long)]
    plot: bool,
    /// Writes a page with plots to this file
    #[arg(long, value_name = "OUT")]
    html: Option<PathBuf>,
}

/// The largest of one value, and when.
#[derive(Clone, Copy, Debug, Serialize)]
struct Peak {
    largest: f64,
    at_us: i64,
}

#[derive(Serialize)]
struct AxisDocument<'a> {
    name: &'a str,
    /// Units.
    position: Vec<f64>,
    velocity_per_s: Vec<f64>,
    acceleration_per_s2: Vec<f64>,
    jerk_per_s3: Vec<f64>,
    /// Without their signs, of velocity, acceleration and jerk.
    velocity_peak: Peak,
    acceleration_peak: Peak,
    jerk_peak: Peak,
}

#[derive(Serialize)]
struct Document<'a> {
    interval_us: u32,
    every_us: u32,
    /// Units a step.
    lsb: f64,
    ends: Ends,
    time_us: Vec<i64>,
    axes: Vec<AxisDocument<'a>>,
}

pub(super) fn run(args: &EvalArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    if args.plot && output.json() {
        let next = "leave out one of them; --html draws beside --json";
        return Err(CliError::new(Exit::Usage, "--plot and --json exclude each other", "the command line", next));
    }
    let table = input::table(&args.file)?;
    let points =
        Points::from_table(&table, args.interval_us, args.lsb).map_err(|error| input::no_points(&args.file, &error))?;
    let place = |axis, point| format!("row {}, column {}", points.line(point), points.column(axis));
    let curve = points.curve(args.ends.into()).map_err(|error| input::no_curve(&args.file, &error, place))?;
    let play = Play { args, points: &points, curve: &curve };
    let mut kept = Kept::of(points.names().len(), play.begin_us(), output.json() || args.plot || args.html.is_some());
    play.run(&mut kept, output)?;
    if output.json() {
        output.document("maxl-eval", &play.document(&kept))?;
    }
    let charts = if args.plot || args.html.is_some() { play.charts(&kept) } else { Vec::new() };
    if args.plot {
        for chart in &charts {
            output.text(plot::draw(chart))?;
        }
    }
    let summary = play.summary(&kept);
    if let Some(file) = &args.html {
        let title = format!("Spline of {}", input::place(&args.file));
        html::write(file, &title, &charts, &[("Largest", summary.plain())], output)?;
    }
    if !output.json() {
        output.say(summary.to_string().trim_end());
    }
    Ok(Exit::Ok)
}

/// What was played: peaks always, samples where something else needs them.
struct Kept {
    all: bool,
    time_us: Vec<i64>,
    /// For each axis its samples, in units.
    samples: Vec<Vec<[f64; 4]>>,
    peaks: Vec<[Peak; 4]>,
}

impl Kept {
    fn of(axes: usize, begin_us: i64, all: bool) -> Self {
        let none = Peak { largest: 0.0, at_us: begin_us };
        Self { all, time_us: Vec::new(), samples: vec![Vec::new(); axes], peaks: vec![[none; 4]; axes] }
    }

    fn take(&mut self, axis: usize, at_us: i64, values: [f64; 4]) {
        for (peak, value) in self.peaks[axis].iter_mut().zip(values) {
            if value.abs() > peak.largest {
                *peak = Peak { largest: value.abs(), at_us };
            }
        }
        if self.all {
            self.samples[axis].push(values);
        }
    }
}

struct Play<'a> {
    args: &'a EvalArgs,
    points: &'a Points,
    curve: &'a Curve,
}

impl<'a> Play<'a> {
    /// When the curve begins: by the first point's time, or at 0 where points have none.
    fn begin_us(&self) -> i64 {
        let start = self.points.start_us().and_then(|start| i64::try_from(start).ok());
        start.map_or(0, |start| start + self.curve.begins_us())
    }

    /// Evaluates all, and writes it as it comes unless something else is wanted.
    fn run(&self, kept: &mut Kept, output: &mut Output<'_>) -> Result<(), CliError> {
        let writes = !output.json() && !self.args.plot;
        if writes {
            let columns =
                self.points.names().iter().flat_map(|name| VALUES.map(|(_, unit)| quoted(&format!("{name}{unit}"))));
            output.line(std::iter::once("time_us".to_owned()).chain(columns).collect::<Vec<_>>().join(","))?;
        }
        let every_us = self.args.every_us;
        for number in 0..self.curve.samples(every_us) {
            let since_us = number * u64::from(every_us);
            let at_us = self.begin_us().saturating_add_unsigned(since_us);
            let mut line = at_us.to_string();
            for axis in 0..self.points.names().len() {
                let sample = self.curve.sample(axis, since_us);
                let values = sample.in_units(self.points.interval(), self.points.lsb());
                kept.take(axis, at_us, values);
                if writes {
                    line.extend(values.map(|value| format!(",{value}")));
                }
            }
            if kept.all {
                kept.time_us.push(at_us);
            }
            if writes {
                output.line(line)?;
            }
        }
        Ok(())
    }

    fn document(&self, kept: &Kept) -> Document<'a> {
        let axis = |(number, name): (usize, &'a str)| {
            let column = |value: usize| kept.samples[number].iter().map(|it: &[f64; 4]| it[value]).collect();
            let [_, velocity_peak, acceleration_peak, jerk_peak] = kept.peaks[number];
            AxisDocument {
                name,
                position: column(0),
                velocity_per_s: column(1),
                acceleration_per_s2: column(2),
                jerk_per_s3: column(3),
                velocity_peak,
                acceleration_peak,
                jerk_peak,
            }
        };
        Document {
            interval_us: self.points.interval().us(),
            every_us: self.args.every_us,
            lsb: self.points.lsb().units(),
            ends: self.args.ends.into(),
            time_us: kept.time_us.clone(),
            axes: self.points.names().iter().map(String::as_str).enumerate().map(axis).collect(),
        }
    }

    fn charts(&self, kept: &Kept) -> Vec<Chart> {
        let chart = |(value, (what, unit)): (usize, &(&str, &str))| {
            let series = |(name, samples): (&String, &Vec<[f64; 4]>)| {
                #[expect(clippy::cast_precision_loss, reason = "for plots")]
                let seconds = kept.time_us.iter().map(|&us| us as f64 / 1e6);
                let points: Vec<(f64, f64)> = seconds.zip(samples.iter().map(|it| it[value])).collect();
                Series::new(name, &points)
            };
            let series = self.points.names().iter().zip(&kept.samples).map(series).collect();
            let unit = format!("units{}", unit.replace("_per_s", "/s").replace("s2", "s²").replace("s3", "s³"));
            Chart::of(what, ("s", Scale::Linear), (&unit, Scale::Linear), series)
        };
        VALUES.iter().enumerate().map(chart).collect()
    }

    /// The largest of each derivative, and when.
    fn summary(&self, kept: &Kept) -> Table {
        let columns =
            [("largest", Align::Left), ("units/s", Align::Right), ("at s", Align::Right), ("units/s²", Align::Right)];
        let more = [("at s", Align::Right), ("units/s³", Align::Right), ("at s", Align::Right)];
        let mut table = Table::new(columns.into_iter().chain(more));
        for (name, peaks) in self.points.names().iter().zip(&kept.peaks) {
            #[expect(clippy::cast_precision_loss, reason = "microseconds of days")]
            let at = |peak: &Peak| format!("{:.6}", peak.at_us as f64 / 1e6);
            let cells = peaks[1..].iter().flat_map(|peak| [figure(peak.largest), at(peak)]);
            table.row(std::iter::once(printable(name)).chain(cells));
        }
        table
    }
}

/// A name as a cell of CSV.
fn quoted(name: &str) -> String {
    if name.contains([',', '"', '\n', '\r', '#']) {
        format!("\"{}\"", name.replace('"', "\"\""))
    } else {
        name.to_owned()
    }
}

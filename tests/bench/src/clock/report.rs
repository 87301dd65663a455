//! Figures of series, as a table, as JSON, and the series themselves.

use super::scene::{Scene, Series, Shape};
use super::{KEPT_FOR, LIMITS_US, SETTLED_AFTER};
use fixed_math::time::Span;
use osap_protocol::discovery::ServoKind;
use serde_json::{Value, json};
use std::cell::RefCell;
use std::fmt::Write as _;
use std::path::PathBuf;

/// Where the results go.
pub(crate) struct Output {
    is_json: bool,
    series: Option<PathBuf>,
    rows: RefCell<Vec<Value>>,
    lines: RefCell<String>,
}

/// What came of all nodes at one distance from the root.
struct Figures {
    runs: usize,
    rms_us: f64,
    p999_us: f64,
    max_us: f64,
    /// Of each limit: median and worst time until it was kept, s; `None` where a run of those never kept it.
    kept_s: [[Option<f64>; 2]; LIMITS_US.len()],
    bound_us: Option<f64>,
    ratio_max: Option<f64>,
}

impl Output {
    /// A table, or JSON; the series of each scene's first seed go to a file as well where one is named.
    pub(crate) fn new(is_json: bool, series: Option<PathBuf>) -> Self {
        let lines = String::from("scene,servo,node,hops,after_us,error_us,bound_us\n");
        Self { is_json, series, rows: RefCell::default(), lines: RefCell::new(lines) }
    }

    pub(super) fn begin(&self, seeds: u64) {
        if self.is_json {
            return;
        }
        println!("clocks, all simulated in virtual time: 3 Mbaud UARTs, RP2040 at 125 MHz, crystals of ±50 ppm with 0.01 ppm/s of ramp, timers of");
        println!("1 µs, boots within 50 ms, 30 % of stamps delayed by 8 µs in the mean where nothing else is said; up to {seeds} seeds, 20 s each.");
        println!("errors in µs from {} s after joining; times in s after joining, median / worst", seconds(SETTLED_AFTER));
        println!(
            "{:<32}{:<11}{:>5}{:>6}{:>9}{:>9}{:>10}{:>16}{:>16}{:>10}{:>9}",
            "network", "servo", "hops", "runs", "rms", "p99.9", "max", "< 10 µs", "< 1 µs", "bound", "err/bnd"
        );
    }

    pub(super) fn scene(&self, name: &str, scene: &Scene, of_seeds: &[Vec<Series>]) {
        if let Some(first) = of_seeds.first().filter(|_| self.series.is_some()) {
            let mut lines = self.lines.borrow_mut();
            series(name, scene.servo, first, &mut lines);
        }
        let last = of_seeds.iter().flatten().map(|it| it.hops).max().unwrap_or(0);
        let told = (1..=last).filter(|hops| match scene.shape {
            Shape::Line { hops: of } => of <= 5 || *hops == 1 || hops % 5 == 0,
            Shape::Tree { .. } => true,
        });
        for hops in told {
            let nodes: Vec<&Series> = of_seeds.iter().flatten().filter(|it| it.hops == hops).collect();
            let figures = Figures::of(&nodes);
            if self.is_json {
                self.rows.borrow_mut().push(figures.json(name, scene.servo, hops));
            } else {
                figures.print(name, scene.servo, hops);
            }
        }
    }

    pub(super) fn end(&self) {
        if self.is_json {
            println!("{}", json!({ "version": 1, "bench": "clock", "is_simulated": true, "rows": *self.rows.borrow() }));
        }
        if let Some(path) = &self.series {
            match std::fs::write(path, self.lines.borrow().as_bytes()) {
                Ok(()) => eprintln!("series of the first seeds: {}", path.display()),
                Err(error) => eprintln!("cannot write the series to {}: {error}; name another file", path.display()),
            }
        }
    }
}

/// Series as lines of CSV: what a plot needs.
pub(super) fn series(name: &str, servo: ServoKind, of_nodes: &[Series], lines: &mut String) {
    for it in of_nodes {
        for sample in &it.samples {
            let bound = sample.bound_us.map_or(String::new(), |bound| format!("{bound:.3}"));
            let (node, hops, servo) = (it.node, it.hops, servo.name());
            // a string takes all that it is given
            let _never_fails =
                writeln!(lines, "{name},{servo},{node},{hops},{},{:.4},{bound}", sample.after_us, sample.error_us);
        }
    }
}

impl Figures {
    fn of(nodes: &[&Series]) -> Self {
        let from_us = SETTLED_AFTER.as_us_floor();
        let all = || nodes.iter().flat_map(|it| &it.samples);
        let steady = || all().filter(|sample| u64::from(sample.after_us) >= from_us);
        let mut errors: Vec<f64> = steady().map(|sample| f64::from(sample.error_us.abs())).collect();
        errors.sort_by(f64::total_cmp);
        let mut bounds: Vec<f64> = steady().filter_map(|sample| sample.bound_us).map(f64::from).collect();
        bounds.sort_by(f64::total_cmp);
        // a root's neighbours may be told a bound of nothing: then half a step is what rounding may leave
        let ratio = |error: f32, bound: f32| f64::from(error.abs()) / f64::from(bound).max(1.0 / 512.0);
        let ratios = all().filter_map(|sample| sample.bound_us.map(|bound| ratio(sample.error_us, bound)));
        Self {
            runs: nodes.len(),
            rms_us: (errors.iter().map(|it| it * it).sum::<f64>() / count(errors.len())).sqrt(),
            p999_us: quantile(&errors, 999).unwrap_or(f64::NAN),
            max_us: quantile(&errors, 1_000).unwrap_or(f64::NAN),
            kept_s: LIMITS_US.map(|limit| {
                let mut times: Vec<f64> = nodes.iter().map(|it| kept(it, limit).unwrap_or(f64::INFINITY)).collect();
                times.sort_by(f64::total_cmp);
                [500, 1_000].map(|part| quantile(&times, part).filter(|time| time.is_finite()))
            }),
            bound_us: quantile(&bounds, 500),
            ratio_max: ratios.max_by(f64::total_cmp),
        }
    }

    fn print(&self, name: &str, servo: ServoKind, hops: usize) {
        let time = |time: Option<f64>| time.map_or("never".to_owned(), |time| format!("{time:.3}"));
        let [ten, one] = self.kept_s.map(|[median, worst]| format!("{} / {}", time(median), time(worst)));
        let maybe = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.2}"));
        println!(
            "{name:<32}{:<11}{hops:>5}{:>6}{:>9.3}{:>9.2}{:>10.2}{ten:>16}{one:>16}{:>10}{:>9}",
            servo.name(),
            self.runs,
            self.rms_us,
            self.p999_us,
            self.max_us,
            maybe(self.bound_us),
            maybe(self.ratio_max),
        );
    }

    fn json(&self, name: &str, servo: ServoKind, hops: usize) -> Value {
        let [[ten, ten_worst], [one, one_worst]] = self.kept_s;
        json!({
            "network": name, "servo": servo.name(), "hops": hops, "runs": self.runs,
            "rms_us": self.rms_us, "p999_us": self.p999_us, "max_us": self.max_us,
            "below_10_us_s": { "median": ten, "worst": ten_worst },
            "below_1_us_s": { "median": one, "worst": one_worst },
            "bound_us": self.bound_us, "error_over_bound_max": self.ratio_max,
        })
    }
}

/// Seconds after joining from which no error was above `limit_us` for as long as `KEPT_FOR`.
fn kept(series: &Series, limit_us: f64) -> Option<f64> {
    let mut since = None;
    for sample in &series.samples {
        if f64::from(sample.error_us.abs()) >= limit_us {
            since = None;
            continue;
        }
        let from = *since.get_or_insert(sample.after_us);
        if u64::from(sample.after_us - from) >= KEPT_FOR.as_us_floor() {
            return Some(f64::from(from) * 1e-6);
        }
    }
    None
}

/// The value that `part` of a thousand are not above.
fn quantile(sorted: &[f64], part: usize) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    sorted.get((last * part).div_ceil(1_000)).copied()
}

#[expect(clippy::cast_precision_loss, reason = "far below 2^53")]
fn count(len: usize) -> f64 {
    len as f64
}

#[expect(clippy::cast_precision_loss, reason = "far below 2^53")]
fn seconds(span: Span) -> f64 {
    span.as_us_floor() as f64 * 1e-6
}

//! Figures of series, as a table, as JSON, and the series themselves.

use super::scene::{Sample, Scene, Series, Shape};
use super::{KEPT_FOR, LIMITS_US, Purpose, SETTLED_AFTER};
use fixed_math::time::Span;
use osap_protocol::discovery::ServoKind;
use serde_json::{Value, json};
use std::cell::RefCell;
use std::fmt::Write as _;
use std::path::PathBuf;

/// What rounding adds to an error: a step of 1/256 µs for each of the two counters, the two lines and the map.
const ROUNDING_US: f64 = 5.0 / 256.0;

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
    /// Where something happens to the network: how fast or slow a live time went at most against its counter, and how far those of one root
    /// were apart.
    rate_max_ppm: f64,
    apart_max_us: f64,
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
        println!(
            "clocks, all simulated in virtual time: 3 Mbaud UARTs, RP2040 at 125 MHz, crystals of ±50 ppm with 0.01 ppm/s of ramp, timers of"
        );
        println!(
            "1 µs, boots within 50 ms, 30 % of stamps delayed by 8 µs in the mean where nothing else is said; up to {seeds} seeds, 20 s each."
        );
        println!(
            "errors in µs from {} s after joining; times in s after joining, median / worst. Where something happens to the",
            seconds(SETTLED_AFTER)
        );
        println!(
            "network, all of it is live, errors are against each node's own root, times count from the last thing that happens, and"
        );
        println!(
            "told are the most by which a time ran faster or slower than its counter (500 ppm of slewing, and crystals), and the most"
        );
        println!("by which settled nodes of one root, but for the first node, were apart.");
        println!(
            "{:<32}{:<11}{:>5}{:>6}{:>9}{:>9}{:>10}{:>16}{:>16}{:>10}{:>9}",
            "network", "servo", "hops", "runs", "rms", "p99.9", "max", "< 10 µs", "< 1 µs", "bound", "err/bnd"
        );
    }

    pub(super) fn scene(&self, name: &str, scene: &Scene, purpose: Purpose, of_seeds: &[Vec<Series>]) {
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
                self.rows.borrow_mut().push(figures.json(name, scene, purpose, hops));
            } else {
                figures.print(name, scene.servo, hops);
            }
        }
        let most = |value: fn(&Series) -> f64| of_seeds.iter().flatten().map(value).fold(0.0, f64::max);
        if !self.is_json && !scene.script.is_empty() {
            let (rate, apart) = (most(|it| it.rate_max_ppm), most(|it| it.apart_max_us));
            println!("{:<32}at most {rate:.0} ppm against a counter, {apart:.2} µs apart", "");
        }
    }

    pub(super) fn end(&self) {
        if self.is_json {
            println!(
                "{}",
                json!({ "version": 1, "bench": "clock", "is_simulated": true, "rows": *self.rows.borrow() })
            );
        }
        if let Some(path) = &self.series {
            match std::fs::write(path, self.lines.borrow().as_bytes()) {
                Ok(()) => eprintln!("series of the first seeds: {}", path.display()),
                Err(error) => eprintln!("cannot write the series to {}: {error}; name another file", path.display()),
            }
        }
    }
}

/// All samples of the first two seconds, then one of eight.
fn thinned(samples: &[Sample]) -> impl Iterator<Item = &Sample> {
    let is_early = |sample: &Sample| u64::from(sample.after_us) < SETTLED_AFTER.as_us_floor();
    samples.iter().enumerate().filter(move |(at, sample)| at % 8 == 0 || is_early(sample)).map(|(_, sample)| sample)
}

/// Series as lines of CSV, of the first node at each distance: what a plot needs.
pub(super) fn series(name: &str, servo: ServoKind, of_nodes: &[Series], lines: &mut String) {
    let mut told = 0;
    for it in of_nodes {
        if it.hops <= told {
            continue;
        }
        told = it.hops;
        for sample in thinned(&it.samples) {
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
        let all = || nodes.iter().flat_map(|it| &it.samples);
        let steady =
            || nodes.iter().flat_map(|it| it.samples.iter().filter(|sample| sample.after_us >= it.settled_from_us));
        let mut errors: Vec<f64> = steady().map(|sample| f64::from(sample.error_us.abs())).collect();
        errors.sort_by(f64::total_cmp);
        let mut bounds: Vec<f64> = steady().filter_map(|sample| sample.bound_us).map(f64::from).collect();
        bounds.sort_by(f64::total_cmp);
        // a root has a bound of nothing, and so have those who have just become one
        let ratio = |error: f32, bound: f32| {
            (f64::from(error.abs()) - ROUNDING_US).max(0.0) / f64::from(bound).max(ROUNDING_US)
        };
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
            rate_max_ppm: nodes.iter().map(|it| it.rate_max_ppm).fold(0.0, f64::max),
            apart_max_us: nodes.iter().map(|it| it.apart_max_us).fold(0.0, f64::max),
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

    fn json(&self, name: &str, scene: &Scene, purpose: Purpose, hops: usize) -> Value {
        let [[ten, ten_worst], [one, one_worst]] = self.kept_s;
        let changes = (!scene.script.is_empty())
            .then(|| json!({ "rate_max_ppm": self.rate_max_ppm, "apart_max_us": self.apart_max_us }));
        json!({
            "network": name, "servo": scene.servo.name(), "hops": hops, "runs": self.runs,
            "real": "runtime, estimator", "simulated": "counters, wires, processors",
            "has_goal": purpose == Purpose::Goal, "is_promised": purpose != Purpose::Unpromised, "changes": changes,
            "rms_us": self.rms_us, "p999_us": self.p999_us, "max_us": self.max_us,
            "below_10_us_s": { "median": ten, "worst": ten_worst },
            "below_1_us_s": { "median": one, "worst": one_worst },
            "bound_us": self.bound_us, "error_over_bound_max": self.ratio_max,
        })
    }
}

/// Seconds after joining, or after the last thing that happened, from which no error was above `limit_us` for as long as `KEPT_FOR`.
fn kept(series: &Series, limit_us: f64) -> Option<f64> {
    let mut since = None;
    for sample in series.samples.iter().filter(|sample| sample.after_us >= series.counts_from_us) {
        if f64::from(sample.error_us.abs()) >= limit_us {
            since = None;
            continue;
        }
        let from = *since.get_or_insert(sample.after_us);
        if u64::from(sample.after_us - from) >= KEPT_FOR.as_us_floor() {
            return Some(f64::from(from - series.counts_from_us) * 1e-6);
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

#[cfg(test)]
mod tests {
    use super::*;

    fn node(counts_from_us: u32, errors: &[(u32, f32, Option<f32>)]) -> Series {
        let samples = errors.iter().map(|(ms, error_us, bound_us)| Sample {
            after_us: ms * 1_000,
            error_us: *error_us,
            bound_us: *bound_us,
        });
        let settled_from_us = u32::try_from(SETTLED_AFTER.as_us_floor()).unwrap();
        let samples = samples.collect();
        let (rate_max_ppm, apart_max_us, last) = (0.0, 0.0, None);
        Series { node: 1, hops: 1, counts_from_us, settled_from_us, samples, rate_max_ppm, apart_max_us, last }
    }

    /// Of ten values the median is the sixth, and none but the largest has 999 of 1000 below it.
    #[test]
    fn quantiles_are_values_that_were_there() {
        let sorted: Vec<f64> = (0..10).map(f64::from).collect();
        assert_eq!(
            [0, 500, 999, 1_000].map(|part| quantile(&sorted, part)),
            [Some(0.0), Some(5.0), Some(9.0), Some(9.0)]
        );
        assert_eq!(quantile(&[], 500), None);
        let many: Vec<f64> = (0..=10_000).map(f64::from).collect();
        assert_eq!(quantile(&many, 999), Some(9_990.0));
    }

    /// A limit is kept from where nothing is above it for a second; what comes later does not count, nor what was before the last thing
    /// that happened.
    #[test]
    fn a_limit_is_kept_for_a_second() {
        let errors = [
            (0, 0.5, None),
            (400, -1.0, None),
            (500, 0.9, None),
            (1_400, -0.9, None),
            (1_500, 0.1, None),
            (1_600, 3.0, None),
        ];
        assert_eq!(kept(&node(0, &errors), 1.0), Some(0.5));
        assert_eq!(kept(&node(0, &errors), 10.0), Some(0.0));
        assert_eq!(kept(&node(0, &errors), 0.3), None);
        let after = kept(&node(450_000, &errors), 1.0).unwrap();
        assert!((after - 0.05).abs() < 1e-9, "{after}");
        assert_eq!(kept(&node(600_000, &errors), 1.0), None);
    }

    /// Errors are of the steady state; a bound is to hold always.
    #[test]
    fn figures_are_of_the_steady_state_and_bounds_of_all() {
        let it = node(0, &[(100, 8.0, Some(4.0)), (2_000, 3.0, Some(6.0)), (3_000, -4.0, Some(8.0))]);
        let figures = Figures::of(&[&it]);
        assert!((figures.rms_us - 12.5f64.sqrt()).abs() < 1e-9);
        let ratio = (8.0 - ROUNDING_US) / 4.0;
        assert_eq!((figures.max_us, figures.bound_us, figures.ratio_max), (4.0, Some(8.0), Some(ratio)));
    }
}

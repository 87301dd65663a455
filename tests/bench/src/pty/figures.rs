//! The figures of a case, as a row of a table and of a document.

use super::Options;
use serde_json::{Value, json};

/// When the steady state begins: the burst at the beginning is over, and the bound has had time to shrink.
const SETTLED_AFTER_S: f64 = 2.0;
/// The goal of the issue for p99 under load, µs.
const GOAL_US: f64 = 100.0;
/// For how long no error may be above the goal for it to count as reached.
const KEPT_FOR_S: f64 = 1.0;

/// One look.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// Since the link was opened.
    pub(super) at_s: f64,
    /// System time less the root's.
    pub(super) error_us: f64,
    /// As published; `None` where there was none.
    pub(super) bound_us: Option<f64>,
}

/// What came of one case.
#[derive(Debug)]
pub(super) struct Case {
    name: &'static str,
    burners: usize,
    asymmetry_us: f64,
    samples: usize,
    /// With its sign: what no averaging takes away.
    pub(super) mean_us: f64,
    rms_us: f64,
    /// p50, p99, p99.9, greatest.
    quantiles_us: [f64; 4],
    /// From when on the error stayed below the goal.
    reached_s: Option<f64>,
    bound_us: Option<f64>,
    ratio_max: Option<f64>,
    /// Looks whose error was above the bound.
    violations: usize,
}

impl Case {
    pub(super) fn of(name: &'static str, burners: usize, asymmetry_us: f64, samples: &[Sample]) -> Self {
        let steady: Vec<&Sample> =
            samples.iter().filter(|it| it.at_s >= SETTLED_AFTER_S && it.bound_us.is_some()).collect();
        let mut errors: Vec<f64> = steady.iter().map(|it| it.error_us.abs()).collect();
        errors.sort_by(f64::total_cmp);
        let mut bounds: Vec<f64> = steady.iter().filter_map(|it| it.bound_us).collect();
        bounds.sort_by(f64::total_cmp);
        let square_sum: f64 = errors.iter().map(|error| error * error).sum();
        // all looks with a bound, from the first on
        let ratios = samples.iter().filter_map(|it| Some(it.error_us.abs() / it.bound_us?.max(1.0 / 512.0)));
        let ratios: Vec<f64> = ratios.collect();
        Self {
            name,
            burners,
            asymmetry_us,
            samples: errors.len(),
            mean_us: steady.iter().map(|it| it.error_us).sum::<f64>() / count(errors.len()),
            rms_us: (square_sum / count(errors.len())).sqrt(),
            quantiles_us: [500, 990, 999, 1_000].map(|part| quantile(&errors, part).unwrap_or(f64::NAN)),
            reached_s: reached(samples),
            bound_us: quantile(&bounds, 500),
            ratio_max: ratios.iter().copied().max_by(f64::total_cmp),
            violations: ratios.iter().filter(|ratio| **ratio > 1.0).count(),
        }
    }

    fn json(&self) -> Value {
        let [p50, p99, p999, max] = self.quantiles_us;
        json!({
            "network": format!("host over a pseudo-terminal, {}", self.name), "servo": "estimator", "hops": 1, "runs": 1,
            "real": "links, threads, scheduler, terminal of this computer",
            "simulated": "the root's counter: the kernel's clock with a synthetic offset and skew",
            "burning_processes": self.burners, "asymmetry_us": self.asymmetry_us, "samples": self.samples, "mean_us": self.mean_us,
            "rms_us": self.rms_us, "p50_us": p50, "p99_us": p99, "p999_us": p999, "max_us": max,
            "below_100_us_s": self.reached_s,
            "bound_us": self.bound_us, "error_over_bound_max": self.ratio_max, "bound_violations": self.violations,
        })
    }
}

/// Prints all cases and what they were measured under.
pub(super) fn print(options: Options, cores: usize, cases: &[Case]) {
    if options.json {
        let rows: Vec<Value> = cases.iter().map(Case::json).collect();
        let Options { seconds, skew_ppb, .. } = options;
        println!(
            "{}",
            json!({
                "version": 1, "bench": "clock-pty", "is_simulated": false, "seconds": seconds, "skew_ppb": skew_ppb,
                "cores": cores, "load_average": load_average(), "rows": rows
            })
        );
        return;
    }
    println!(
        "host over a pseudo-terminal: real links, threads and kernel; the root's counter is the kernel's clock with {} ppb of skew;",
        options.skew_ppb
    );
    println!(
        "{} s a case, {cores} cores, load average at the end {}; errors in µs from {SETTLED_AFTER_S} s on",
        options.seconds,
        load_average().unwrap_or_else(|| "unknown".to_owned())
    );
    println!(
        "{:<22}{:>8}{:>11}{:>9}{:>9}{:>9}{:>9}{:>9}{:>9}{:>9}{:>12}{:>9}{:>9}{:>10}",
        "case",
        "burning",
        "asymmetry",
        "samples",
        "mean",
        "rms",
        "p50",
        "p99",
        "p99.9",
        "max",
        "< 100 µs s",
        "bound",
        "err/bnd",
        "violated"
    );
    let maybe = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.2}"));
    for it in cases {
        let [p50, p99, p999, max] = it.quantiles_us;
        println!(
            "{:<22}{:>8}{:>11.2}{:>9}{:>9.2}{:>9.2}{p50:>9.2}{p99:>9.2}{p999:>9.2}{max:>9.2}{:>12}{:>9}{:>9}{:>10}",
            it.name,
            it.burners,
            it.asymmetry_us,
            it.samples,
            it.mean_us,
            it.rms_us,
            maybe(it.reached_s),
            maybe(it.bound_us),
            maybe(it.ratio_max),
            it.violations,
        );
    }
    println!("goal: p99 below {GOAL_US} µs under load, and no error above its bound");
}

/// From when on no error was above the goal for as long as [`KEPT_FOR_S`].
fn reached(samples: &[Sample]) -> Option<f64> {
    let mut since = None;
    for it in samples {
        if it.bound_us.is_none() || it.error_us.abs() >= GOAL_US {
            since = None;
            continue;
        }
        let from = *since.get_or_insert(it.at_s);
        if it.at_s - from >= KEPT_FOR_S {
            return Some(from);
        }
    }
    None
}

/// The value that `part` of a thousand are not above.
fn quantile(sorted: &[f64], part: usize) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    sorted.get((last * part).div_ceil(1_000)).copied()
}

/// What else this computer had to do, where the system tells.
fn load_average() -> Option<String> {
    let text = std::fs::read_to_string("/proc/loadavg").ok()?;
    text.split_whitespace().next().map(str::to_owned)
}

#[expect(clippy::cast_precision_loss, reason = "far below 2^53")]
fn count(len: usize) -> f64 {
    len as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_of_the_steady_state_and_bounds_of_all() {
        let sample = |at_s: f64, error_us: f64| Sample { at_s, error_us, bound_us: Some(10.0) };
        let samples = [sample(0.5, 20.0), sample(2.0, -3.0), sample(3.0, 4.0), sample(4.0, 0.0)];
        let case = Case::of("idle", 0, 0.0, &samples);
        assert_eq!((case.samples, case.violations, case.ratio_max), (3, 1, Some(2.0)));
        assert_eq!(case.quantiles_us.map(f64::to_bits), [3.0, 4.0, 4.0, 4.0f64].map(f64::to_bits));
        assert!((case.rms_us - (25.0f64 / 3.0).sqrt()).abs() < 1e-12);
        assert_eq!(case.reached_s, Some(0.5));
    }
}

//! Rows of the report: each measurement's document in the same terms, and what the goals say of it.

use super::Curve;
use serde_json::{Value, json};

/// Columns that are texts and stand on the left.
pub(super) const TEXT_COLUMNS: usize = 3;
/// Goals of the issue: rms, p99.9, and times until errors stay below 10 and 1 µs.
const GOAL_RMS_US: f64 = 0.5;
const GOAL_P999_US: f64 = 1.5;
const GOAL_BELOW_S: [f64; 2] = [0.5, 1.0];
/// And p99 of a host under load.
const GOAL_HOST_P99_US: f64 = 100.0;

/// What a row is judged by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Goal {
    /// A microsecond, soon.
    Microsecond,
    /// 99 of 100 errors of a host below 100 µs.
    Host,
    /// Its bound alone.
    Bound,
    /// Nothing: it breaks what is promised.
    None,
}

/// What came of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    Met,
    /// Which of the goals, with figures.
    Missed(String),
    /// An error was above its bound.
    BoundBroken,
    /// There is no goal, and the bound held.
    Held,
    /// Nothing was promised.
    Unpromised,
}

/// One row.
#[derive(Clone, Debug)]
pub(super) struct Row {
    name: String,
    real: String,
    simulated: String,
    hops: u64,
    rms_us: Option<f64>,
    p99_us: Option<f64>,
    p999_us: Option<f64>,
    max_us: Option<f64>,
    /// Below 10 and 1 µs: median and worst run.
    below_s: [[Option<f64>; 2]; 2],
    bound_us: Option<f64>,
    ratio_max: Option<f64>,
    goal: Goal,
    note: String,
}

/// A network under another servo than the estimator is a row of its own.
pub(super) fn named(network: &str, servo: &str) -> String {
    if servo == "estimator" { network.to_owned() } else { format!("{network}, {servo}") }
}

fn text(value: &Value, key: &str) -> String {
    value[key].as_str().unwrap_or("not told").to_owned()
}

/// The rows of `bench clock`.
pub(super) fn simulated(document: &Value) -> Vec<Row> {
    let rows = document["rows"].as_array().into_iter().flatten();
    rows.map(|row| {
        let below = |key: &str| [row[key]["median"].as_f64(), row[key]["worst"].as_f64()];
        let changes = &row["changes"];
        // how far nodes are apart is told once for all of a network
        let apart = changes["apart_max_us"].as_f64().filter(|us| *us > 0.0);
        let apart = apart.map_or(String::new(), |us| format!(", {us:.2} apart"));
        let note = changes["rate_max_ppm"].as_f64().map_or(String::new(), |ppm| format!("{ppm:.0} ppm{apart}"));
        Row {
            name: named(&text(row, "network"), &text(row, "servo")),
            real: text(row, "real"),
            simulated: text(row, "simulated"),
            hops: row["hops"].as_u64().unwrap_or(0),
            rms_us: row["rms_us"].as_f64(),
            p99_us: None,
            p999_us: row["p999_us"].as_f64(),
            max_us: row["max_us"].as_f64(),
            below_s: [below("below_10_us_s"), below("below_1_us_s")],
            bound_us: row["bound_us"].as_f64(),
            ratio_max: row["error_over_bound_max"].as_f64(),
            goal: match (row["is_promised"].as_bool(), row["has_goal"].as_bool()) {
                (Some(false), _) => Goal::None,
                (_, Some(true)) => Goal::Microsecond,
                _ => Goal::Bound,
            },
            note,
        }
    })
    .collect()
}

/// The rows and curves of the emulated images.
pub(super) fn images(document: &Value) -> (Vec<Row>, Vec<Curve>) {
    let (mut rows, mut curves) = (Vec::new(), Vec::new());
    for (key, data) in document["data"].as_object().into_iter().flatten() {
        let Some((load, hops)) = key.rsplit_once('-') else { continue };
        let Ok(hops) = hops.parse() else { continue };
        let name = format!("RP2040 images, {load}");
        // one run: its median is its worst
        let below = |key: &str| [data[key].as_f64().map(|ms| ms / 1e3); 2];
        rows.push(Row {
            name: name.clone(),
            real: "image on its own code".to_owned(),
            simulated: "chips, wires, crystals".to_owned(),
            hops,
            rms_us: data["rms_us"].as_f64(),
            p99_us: None,
            p999_us: data["p999_us"].as_f64(),
            max_us: data["max_us"].as_f64(),
            below_s: [below("within_10_us_ms"), below("within_1_us_ms")],
            bound_us: data["bound_median_us"].as_f64(),
            ratio_max: data["error_of_bound_max"].as_f64(),
            goal: Goal::Microsecond,
            note: String::new(),
        });
        curves.extend(curve(name, hops, &data["series_ms_error_us_bound_us"], 1e-3));
    }
    (rows, curves)
}

/// The rows and curves of `bench clock-pty`.
pub(super) fn host(document: &Value) -> (Vec<Row>, Vec<Curve>) {
    let (mut rows, mut curves) = (Vec::new(), Vec::new());
    for row in document["rows"].as_array().into_iter().flatten() {
        let (name, hops) = (text(row, "network"), row["hops"].as_u64().unwrap_or(0));
        rows.push(Row {
            name: name.clone(),
            real: "kernel, terminal, threads".to_owned(),
            simulated: "skew of the other counter".to_owned(),
            hops,
            rms_us: row["rms_us"].as_f64(),
            p99_us: row["p99_us"].as_f64(),
            p999_us: row["p999_us"].as_f64(),
            max_us: row["max_us"].as_f64(),
            below_s: [[None; 2]; 2],
            bound_us: row["bound_us"].as_f64(),
            ratio_max: row["error_over_bound_max"].as_f64(),
            goal: if row["burning_processes"].as_u64() == Some(0) { Goal::Bound } else { Goal::Host },
            note: row["p99_us"].as_f64().map_or(String::new(), |p99| format!("p99 {p99:.1}")),
        });
        curves.extend(curve(name, hops, &row["series_s_error_us_bound_us"], 1.0));
    }
    (rows, curves)
}

/// Points of `[time, error, bound or null]`, whose times are in units of `seconds`.
fn curve(name: String, hops: u64, series: &Value, seconds: f64) -> Option<Curve> {
    let points = series.as_array()?.iter();
    let points = points.filter_map(|it| Some((it[0].as_f64()? * seconds, it[1].as_f64()?, it[2].as_f64())));
    Some(Curve { name, hops, points: points.collect() })
}

impl Row {
    pub(super) fn head() -> Vec<String> {
        let names =
            ["row", "real", "simulated", "hops", "rms", "p99.9", "max", "< 10", "< 1", "bound", "err/bound", "goal"];
        names.map(str::to_owned).into()
    }

    pub(super) fn cells(&self) -> Vec<String> {
        let number = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.2}"));
        let time = |[median, worst]: [Option<f64>; 2]| match (median, worst) {
            _ if self.goal == Goal::Host || self.real.starts_with("kernel") => "-".to_owned(),
            (None, _) => "never".to_owned(),
            (Some(median), None) => format!("{median:.2} / never"),
            (Some(median), Some(worst)) => format!("{median:.2} / {worst:.2}"),
        };
        let said = match self.verdict() {
            Verdict::Met => "met".to_owned(),
            Verdict::Missed(which) => format!("missed: {which}"),
            Verdict::BoundBroken => "BOUND BROKEN".to_owned(),
            Verdict::Held => "bound held".to_owned(),
            Verdict::Unpromised => "not promised".to_owned(),
        };
        let said = if self.note.is_empty() { said } else { format!("{said}; {}", self.note) };
        let [ten, one] = self.below_s.map(time);
        let figures = [self.rms_us, self.p999_us, self.max_us].map(number);
        let texts = [self.name.clone(), self.real.clone(), self.simulated.clone(), self.hops.to_string()];
        let rest = [ten, one, number(self.bound_us), number(self.ratio_max), said];
        texts.into_iter().chain(figures).chain(rest).collect()
    }

    /// What the goals say. An error above its bound is worse than any goal missed.
    pub(super) fn verdict(&self) -> Verdict {
        if self.goal == Goal::None {
            return Verdict::Unpromised;
        }
        if self.ratio_max.is_some_and(|ratio| ratio > 1.0) {
            return Verdict::BoundBroken;
        }
        let goals: Vec<(&str, Option<f64>, f64)> = match self.goal {
            Goal::Bound | Goal::None => return Verdict::Held,
            Goal::Host => vec![("p99", self.p99_us, GOAL_HOST_P99_US)],
            Goal::Microsecond => {
                let [ten, one] = self.below_s.map(|[_, worst]| worst);
                let [ten_s, one_s] = GOAL_BELOW_S;
                vec![
                    ("rms", self.rms_us, GOAL_RMS_US),
                    ("p99.9", self.p999_us, GOAL_P999_US),
                    ("< 10", ten, ten_s),
                    ("< 1", one, one_s),
                ]
            }
        };
        // what was never reached, or not told, is not met
        let missed = goals.iter().filter(|(_, value, goal)| value.is_none_or(|value| value > *goal));
        let told = missed.map(|(name, value, goal)| match value {
            Some(value) => format!("{name} {value:.2} of {goal}"),
            None => format!("{name} never, of {goal}"),
        });
        let told: Vec<String> = told.collect();
        if told.is_empty() { Verdict::Met } else { Verdict::Missed(told.join(", ")) }
    }

    pub(super) fn json(&self) -> Value {
        let (verdict, missed) = match self.verdict() {
            Verdict::Met => ("met", None),
            Verdict::Missed(which) => ("missed", Some(which)),
            Verdict::BoundBroken => ("bound broken", None),
            Verdict::Held => ("bound held", None),
            Verdict::Unpromised => ("not promised", None),
        };
        let [ten, one] = self.below_s.map(|[median, worst]| json!({ "median": median, "worst": worst }));
        json!({
            "row": self.name, "real": self.real, "simulated": self.simulated, "hops": self.hops,
            "rms_us": self.rms_us, "p99_us": self.p99_us, "p999_us": self.p999_us, "max_us": self.max_us,
            "below_10_us_s": ten, "below_1_us_s": one, "bound_us": self.bound_us, "error_over_bound_max": self.ratio_max,
            "verdict": verdict, "missed": missed, "note": self.note,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bench(changes: &Value) -> Value {
        let mut row = json!({
            "network": "4 hops", "servo": "estimator", "hops": 4, "real": "a", "simulated": "b", "has_goal": true, "is_promised": true,
            "rms_us": 0.5, "p999_us": 1.5, "max_us": 2.0, "below_10_us_s": { "median": 0.1, "worst": 0.5 },
            "below_1_us_s": { "median": 0.1, "worst": 1.0 }, "bound_us": 3.0, "error_over_bound_max": 1.0,
        });
        for (key, value) in changes.as_object().unwrap() {
            row[key] = value.clone();
        }
        json!({ "rows": [row] })
    }

    /// At its goal a row meets it, and above it misses; a bound that is broken goes before, unless nothing was promised.
    #[test]
    fn a_row_is_judged_by_what_it_is_for() {
        let verdict = |changes: Value| simulated(&bench(&changes))[0].verdict();
        assert_eq!(verdict(json!({})), Verdict::Met);
        assert_eq!(verdict(json!({ "rms_us": 0.51 })), Verdict::Missed("rms 0.51 of 0.5".to_owned()));
        let never = json!({ "below_1_us_s": { "median": 0.1, "worst": null } });
        assert_eq!(verdict(never), Verdict::Missed("< 1 never, of 1".to_owned()));
        assert_eq!(verdict(json!({ "rms_us": 9, "has_goal": false })), Verdict::Held);
        assert_eq!(verdict(json!({ "error_over_bound_max": 1.01, "has_goal": false })), Verdict::BoundBroken);
        assert_eq!(verdict(json!({ "error_over_bound_max": 2, "is_promised": false })), Verdict::Unpromised);
    }

    /// The three documents give rows of the same columns, in their own terms.
    #[test]
    fn documents_of_all_three_become_rows() {
        let image = json!({ "data": { "idle-2": {
            "rms_us": 0.04, "p999_us": 0.06, "max_us": 0.06, "within_10_us_ms": 20.0, "within_1_us_ms": 270.0,
            "bound_median_us": 0.2, "error_of_bound_max": 0.4, "series_ms_error_us_bound_us": [[10.0, -3.0, null], [20.0, 1.0, 2.0]],
        } } });
        let (rows, curves) = images(&image);
        assert_eq!((rows[0].name.as_str(), rows[0].hops, rows[0].verdict()), ("RP2040 images, idle", 2, Verdict::Met));
        assert_eq!(rows[0].below_s[1], [Some(0.27); 2]);
        assert_eq!(curves[0].points, [(0.01, -3.0, None), (0.02, 1.0, Some(2.0))]);
        let loaded = |p99: f64| {
            let row = json!({ "network": "host", "hops": 1, "p99_us": p99, "burning_processes": 2, "error_over_bound_max": 0.5 });
            host(&json!({ "rows": [row] })).0[0].verdict()
        };
        assert_eq!(loaded(99.0), Verdict::Met);
        assert_eq!(loaded(101.0), Verdict::Missed("p99 101.00 of 100".to_owned()));
        assert_eq!(rows[0].cells().len(), Row::head().len());
    }
}

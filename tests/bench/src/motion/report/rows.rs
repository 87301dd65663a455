//! Rows of the report: each measurement's document in the same terms.

use serde_json::{Value, json};

/// What a figure is held against.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Goal {
    None,
    AtMost(f64),
    Below(f64),
}

/// What came of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    Met,
    Missed,
    NoGoal,
}

/// One figure.
#[derive(Clone, Debug)]
pub(super) struct Row {
    what: String,
    figure: f64,
    /// Digits behind the point.
    digits: usize,
    unit: &'static str,
    goal: Goal,
    /// Measured, modelled or simulated.
    kind: &'static str,
    conditions: String,
    command: &'static str,
}

const MEASURED: &str = "measured, emulated RP2040";
const MODELLED: &str = "modelled";
const SIMULATED: &str = "calculated on this computer";
const HIL_EVALUATIONS: &str = "cargo xtask hil evaluations";
const HIL_MOTION: &str = "cargo xtask hil motion";
/// What is looked for in the description of each evaluator.
const OURS: &str = "(ours)";
const BASELINE: &str = "(baseline)";
/// Goals: the share of three axes at 100 kHz, delays of edges, errors.
const GOAL_SHARE_PERCENT: f64 = 25.0;
const GOAL_JITTER_US: f64 = 1.0;
const GOAL_ERROR_LSB: f64 = 1.0;

impl Row {
    /// Columns of a table.
    pub(super) const COLUMNS: usize = 7;
    /// The column that holds numbers.
    pub(super) const FIGURE: usize = 1;

    pub(super) fn head() -> [String; Self::COLUMNS] {
        ["what", "figure", "unit", "goal", "", "kind and conditions", "command"].map(str::to_owned)
    }

    pub(super) fn cells(&self) -> [String; Self::COLUMNS] {
        let goal = match self.goal {
            Goal::None => String::new(),
            Goal::AtMost(goal) => format!("≤ {goal}"),
            Goal::Below(goal) => format!("< {goal}"),
        };
        let verdict = match self.verdict() {
            Verdict::Met => "met",
            Verdict::Missed => "MISSED",
            Verdict::NoGoal => "",
        };
        let digits = self.digits;
        [
            self.what.clone(),
            format!("{:.digits$}", self.figure),
            self.unit.to_owned(),
            goal,
            verdict.to_owned(),
            format!("{}; {}", self.kind, self.conditions),
            self.command.to_owned(),
        ]
    }

    pub(super) fn verdict(&self) -> Verdict {
        let is_met = match self.goal {
            Goal::None => return Verdict::NoGoal,
            Goal::AtMost(goal) => self.figure <= goal,
            Goal::Below(goal) => self.figure < goal,
        };
        if is_met { Verdict::Met } else { Verdict::Missed }
    }

    pub(super) fn json(&self) -> Value {
        let goal = match self.goal {
            Goal::None => Value::Null,
            Goal::AtMost(goal) => json!({ "at_most": goal }),
            Goal::Below(goal) => json!({ "below": goal }),
        };
        let is_met = match self.verdict() {
            Verdict::NoGoal => Value::Null,
            verdict => (verdict == Verdict::Met).into(),
        };
        json!({ "what": self.what, "figure": self.figure, "unit": self.unit, "goal": goal, "is_met": is_met,
            "kind": self.kind, "conditions": self.conditions, "command": self.command })
    }
}

fn list(value: &Value) -> impl Iterator<Item = &Value> {
    value.as_array().into_iter().flatten()
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or("not told")
}

/// Cycles on a Cortex-M0+ and shares of an RP2040: the scenario `evaluations`.
pub(super) fn evaluations(document: &Value) -> Vec<Row> {
    let data = &document["data"];
    let cycles = list(&data["evaluations"]).filter_map(|found| {
        Some(Row {
            what: format!("M0+: {}", text(&found["name"])),
            figure: found["cycles"].as_f64()?,
            digits: 1,
            unit: "cycles",
            goal: found["goal"].as_f64().map_or(Goal::None, Goal::AtMost),
            kind: MEASURED,
            conditions: "image in RAM, state in memory, less an empty function".to_owned(),
            command: HIL_EVALUATIONS,
        })
    });
    cycles.chain(list(&data["share"]).flat_map(shares)).collect()
}

/// Of one image and number of axes: at its own rate and, of the fast one, at 100 kHz.
fn shares(found: &Value) -> Vec<Row> {
    let (image, axes) = (text(&found["image"]), found["axes"].as_u64().unwrap_or(0));
    let figure = |key: &str| found[key].as_f64();
    let (Some(rate_hz), Some(mean)) = (figure("rate_hz"), figure("cycles_mean")) else { return Vec::new() };
    let steps = figure("steps_hz").unwrap_or(0.0) / 1e3;
    let worst = found["cycles_max"].as_u64().unwrap_or(0);
    let row = |khz: f64, figure: f64, goal: Goal, how: &str| Row {
        what: format!("share of the processor, {khz} kHz, {axes} axes"),
        figure,
        digits: 1,
        unit: "%",
        goal,
        kind: MEASURED,
        conditions: format!(
            "{image}, {mean:.0} cycles an interrupt, {worst} at most, {steps:.1} thousand steps/s{how}"
        ),
        command: HIL_EVALUATIONS,
    };
    let own = figure("share_percent").map(|percent| row(rate_hz / 1e3, percent, Goal::None, ""));
    let goal = if axes == 3 { Goal::Below(GOAL_SHARE_PERCENT) } else { Goal::None };
    let scaled = figure("share_at_100_khz_percent");
    let scaled = scaled.map(|percent| row(100.0, percent, goal, ", calculated from those at 125 kHz"));
    own.into_iter().chain(scaled).collect()
}

/// What a model of other processors says.
pub(super) fn modelled(document: &Value) -> Vec<Row> {
    let found = list(&document["rows"]).filter_map(|found| {
        Some(Row {
            what: format!("{}: {}", text(&found["processor"]), text(&found["name"])),
            figure: found["cycles"].as_f64()?,
            digits: 1,
            unit: "cycles",
            goal: Goal::None,
            kind: MODELLED,
            conditions: format!("{}, less an empty function, no wait states", text(&document["model"])),
            command: "cargo xtask motion",
        })
    });
    found.collect()
}

/// Delays of edges: the scenario `motion`, whose data are named by what was going on and which motor.
pub(super) fn outputs(document: &Value) -> Vec<Row> {
    let data = document["data"].as_object().into_iter().flatten();
    let found = data.filter_map(|(name, found)| {
        let load = if name.starts_with("loaded") {
            "both wires at 80 % both ways, user code that never ends"
        } else {
            "idle but for the tracks"
        };
        let entry = &found["entry_us"];
        Some(Row {
            what: format!("jitter of output edges, {name}"),
            figure: entry["max"].as_f64()?,
            digits: 3,
            unit: "µs",
            goal: Goal::AtMost(GOAL_JITTER_US),
            kind: MEASURED,
            conditions: format!("{load}; median {:.3}, p99 {:.3}", entry["median"].as_f64()?, entry["p99"].as_f64()?),
            command: HIL_MOTION,
        })
    });
    found.collect()
}

/// Errors of evaluators.
pub(super) fn errors(document: &Value) -> Vec<Row> {
    let found = list(&document["accuracy"]).flat_map(|found| {
        let name = text(&found["name"]);
        let is_ours = name.contains(OURS);
        let row = |what: &str, key: &str, unit: &'static str, digits, goal| {
            Some(Row {
                what: format!("{what}, {name}"),
                figure: found[key].as_f64()?,
                digits,
                unit,
                goal,
                kind: SIMULATED,
                conditions: "against integers of 128 bits and double precision, seeded random segments".to_owned(),
                command: "cargo xtask bench motion-error",
            })
        };
        let goal = if is_ours { Goal::AtMost(GOAL_ERROR_LSB) } else { Goal::None };
        let wanted = is_ours || name.contains(BASELINE);
        let rows = [
            row("error over the full travel", "full_travel_max_lsb", "LSB", 2, goal),
            row("error against double precision", "against_double_max_lsb", "LSB", 2, goal),
            row("gain error", "gain_ppm", "ppm", 1, Goal::None),
        ];
        rows.into_iter().flatten().filter(move |_| wanted)
    });
    found.collect()
}

/// Points at random.
pub(super) fn injection(document: &Value) -> Vec<Row> {
    let Some(violations) = document["violations"].as_f64() else { return Vec::new() };
    let number = |key: &str| document[key].as_u64().unwrap_or(0);
    let conditions = format!(
        "{} points offered, {} accepted, {} beats, {} stops seen, seed {}",
        number("offered"),
        number("accepted"),
        number("beats"),
        number("stops_seen"),
        number("seed")
    );
    vec![Row {
        what: "limits broken, stops off the path".to_owned(),
        figure: violations,
        digits: 0,
        unit: "",
        goal: Goal::AtMost(0.0),
        kind: SIMULATED,
        conditions,
        command: "cargo xtask bench motion-inject",
    }]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_share_of_three_axes_has_a_goal_at_100_khz_alone() {
        let document = json!({ "data": { "share": [
            { "image": "fast", "axes": 3, "rate_hz": 125_000.0, "cycles_mean": 300.0, "cycles_max": 400, "steps_hz": 6_300.0,
              "share_percent": 30.0, "share_at_100_khz_percent": 24.0 },
            { "image": "slow", "axes": 1, "rate_hz": 15_625.0, "cycles_mean": 1.0, "cycles_max": 2, "share_percent": 9.0,
              "share_at_100_khz_percent": null } ] } });
        let verdicts: Vec<(String, Verdict)> =
            evaluations(&document).iter().map(|row| (row.what.clone(), row.verdict())).collect();
        let share = |what: &str| format!("share of the processor, {what}");
        assert_eq!(
            verdicts,
            [
                (share("125 kHz, 3 axes"), Verdict::NoGoal),
                (share("100 kHz, 3 axes"), Verdict::Met),
                (share("15.625 kHz, 1 axes"), Verdict::NoGoal)
            ]
        );
    }

    #[test]
    fn errors_of_ours_have_a_goal_the_baseline_is_beside_them_and_others_are_left_out() {
        let one = |name: &str, lsb: f64| json!({ "name": name, "full_travel_max_lsb": lsb, "against_double_max_lsb": lsb, "gain_ppm": 0.0 });
        let document = json!({ "accuracy": [one("a (ours)", 1.1), one("b (baseline)", 9.0), one("f32", 3.0)] });
        let rows = errors(&document);
        assert_eq!(rows.len(), 6);
        assert_eq!(rows.iter().filter(|row| row.verdict() == Verdict::Missed).count(), 2);
        assert!(rows.iter().all(|row| !row.what.contains("f32")));
    }

    #[test]
    fn one_violation_misses_the_goal_and_a_delay_of_edges_is_judged_by_its_most() {
        assert_eq!(injection(&json!({ "violations": 1 }))[0].verdict(), Verdict::Missed);
        assert_eq!(injection(&json!({ "violations": 0 }))[0].verdict(), Verdict::Met);
        assert!(injection(&json!({})).is_empty());
        let document =
            json!({ "data": { "loaded one": { "entry_us": { "median": 0.1, "p99": 0.2, "max": 1.1 } }, "other": {} } });
        let rows = outputs(&document);
        assert_eq!((rows.len(), rows[0].verdict()), (1, Verdict::Missed));
    }
}

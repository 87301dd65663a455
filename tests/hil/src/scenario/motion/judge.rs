//! Edges at pins, each put to its beat in system time, and compared with where the spline has to be.
//!
//! - **Walk:** [`Edge`]s → [`Pins::take`] → steps of each axis with their beats → [`follow`] against a [`Series`].
//! - **Invariants:** an edge belongs to the multiple of 64 µs of system time that is nearest to it; how far it is from there is its error. A
//!   track is compared at every beat, with an edge or without.

use super::stage::Truth;
use super::track::{STEP_LOG2, Series};
use crate::pins::{AXES, Edge, Level, PICO_AXES, PICO_ENABLE};
use crate::report::real;
use fixed_math::steps::{Direction, StepBits};
use fixed_math::time::NetTime;

/// From one beat to the next.
pub(super) const BEAT_US: u64 = 64;
const BEAT_NS: f64 = 64_000.0;
/// What a position may be off by, LSB: the goal, and what a device's arithmetic promises, 0.72, is below it.
const ERROR_LSB_MAX: f64 = 1.0;

/// One step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct StepEdge {
    /// Its beat: system time over 64 µs.
    pub(super) beat: u64,
    pub(super) is_up: bool,
    /// After its beat, ns.
    pub(super) late_ns: f64,
    pub(super) global_ns: f64,
}

/// What one motor's pins did.
#[derive(Clone, Debug)]
pub(super) struct Pins {
    /// Steps of each axis.
    pub(super) steps: [Vec<StepEdge>; AXES],
    /// Edges of other pins: pin, level, system time, ns.
    pub(super) others: Vec<(u8, bool, f64)>,
    directions: [(bool, f64); AXES],
    raised_ns: [f64; AXES],
    /// Shortest time from a change of direction to the next step, of a step's pulse, ns.
    pub(super) set_up_ns_min: f64,
    pub(super) pulse_ns_min: f64,
}

impl Pins {
    pub(super) fn new() -> Self {
        Self {
            steps: Default::default(),
            others: Vec::new(),
            directions: [(false, f64::NEG_INFINITY); AXES],
            raised_ns: [f64::NEG_INFINITY; AXES],
            set_up_ns_min: f64::INFINITY,
            pulse_ns_min: f64::INFINITY,
        }
    }

    /// Takes in edges, in order.
    pub(super) fn take(&mut self, edges: &[Edge], truth: &Truth) {
        for edge in edges {
            let is_high = edge.level == Level::High;
            let system_ns = truth.system_ns(edge.global_ns);
            let Some(axis) = PICO_AXES.iter().position(|(step, direction)| [step, direction].contains(&&edge.pin))
            else {
                self.others.push((edge.pin, is_high, system_ns));
                continue;
            };
            if edge.pin == PICO_AXES[axis].1 {
                self.directions[axis] = (is_high, edge.local_ns);
                // pins of one store come in any order: a step of the same instant counts as one without set-up time
                if (edge.local_ns - self.raised_ns[axis]).abs() < 4.0 {
                    self.set_up_ns_min = 0.0;
                }
            } else if is_high {
                self.raised_ns[axis] = edge.local_ns;
                let (is_up, changed_ns) = self.directions[axis];
                self.set_up_ns_min = self.set_up_ns_min.min(edge.local_ns - changed_ns);
                let (beat, late_ns) = beat_of(system_ns);
                self.steps[axis].push(StepEdge { beat, is_up, late_ns, global_ns: edge.global_ns });
            } else {
                self.pulse_ns_min = self.pulse_ns_min.min(edge.local_ns - self.raised_ns[axis]);
            }
        }
    }

    /// The steps so far, to begin anew.
    pub(super) fn drain(&mut self) -> [Vec<StepEdge>; AXES] {
        std::mem::take(&mut self.steps)
    }

    /// When the drivers were switched, and how: system time, ns.
    pub(super) fn enables(&self) -> Vec<(bool, f64)> {
        self.others.iter().filter(|(pin, ..)| *pin == PICO_ENABLE).map(|(_, is_high, at)| (*is_high, *at)).collect()
    }
}

/// The nearest beat, and how far after it.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a time after the origin")]
pub(super) fn beat_of(system_ns: f64) -> (u64, f64) {
    let beat = (system_ns / BEAT_NS).round();
    (beat as u64, system_ns - beat * BEAT_NS)
}

/// What came of a comparison.
#[derive(Clone, Debug, Default)]
pub(super) struct Followed {
    /// Steps seen.
    pub(super) steps: usize,
    /// Where the motor stood at last, steps from where the series began.
    pub(super) moved: i32,
    /// Where the spline ends, likewise.
    pub(super) expected: i32,
    /// The first beat at which the pins were not what the device's own arithmetic says, and what.
    pub(super) unlike: Option<String>,
    /// The greatest distance of the exact spline from what the motor's step allows, LSB; a step too many or too few shows here too.
    pub(super) error_lsb: f64,
}

impl Followed {
    /// Every edge in its beat, no step lost, and the spline within a LSB of all.
    pub(super) fn is_exact(&self) -> bool {
        self.unlike.is_none() && self.moved == self.expected && self.error_lsb <= ERROR_LSB_MAX
    }
}

/// Compares the steps of one axis with a series over the beats `from` to `to`; `track` is the track time at a system time.
pub(super) fn follow(
    series: &Series,
    steps: &[StepEdge],
    (from, to): (u64, u64),
    mut track: impl FnMut(NetTime) -> NetTime,
) -> Followed {
    let hysteresis = StepBits::quarter(STEP_LOG2);
    let Ok(mut device) = StepBits::new(STEP_LOG2, hysteresis, series.rest) else { return Followed::default() };
    let mut found = Followed::default();
    let mut seen = steps.iter().skip_while(|step| step.beat < from).peekable();
    let mut at = series.rest >> STEP_LOG2;
    let (mut was_up, mut is_turning) = (true, false);
    for beat in from..to {
        let time = track(NetTime::from_us(beat * BEAT_US));
        let wanted = device.update(series.played(time)[0]);
        let edge = seen.next_if(|step| step.beat == beat);
        if let Some(edge) = edge {
            at += if edge.is_up { 1 } else { -1 };
            found.steps += 1;
        }
        let (got, due) = (edge.map(|edge| edge.is_up), wanted.is_step.then_some(wanted.direction == Direction::Up));
        if got != due && found.unlike.is_none() {
            found.unlike = Some(format!("beat {beat}: a step {got:?}, due {due:?}"));
        }
        // a beat that turns round puts its step out with the next one
        let turned = (wanted.direction == Direction::Up) != was_up;
        was_up = wanted.direction == Direction::Up;
        if !turned && !is_turning {
            found.error_lsb = found.error_lsb.max(outside(series.exact(time), at));
        }
        is_turning = turned;
    }
    if let Some(extra) = seen.next_if(|step| step.beat < to) {
        found.unlike = found.unlike.or_else(|| Some(format!("two steps in beat {}", extra.beat)));
    }
    found.moved = at - (series.rest >> STEP_LOG2);
    found.expected = device.at() - (series.rest >> STEP_LOG2);
    found
}

/// How far a position is outside of what a motor at step `at` stands for, LSB: from there, less a quarter of a step, to the next one.
fn outside(position: f64, at: i32) -> f64 {
    let step = f64::from(1 << STEP_LOG2);
    let (low, high) = (f64::from(at) * step - step / 4.0, f64::from(at + 1) * step);
    (low - position).max(position - high).max(0.0)
}

/// Median, 99th percentile and the greatest of some figures.
pub(super) fn quantiles(mut figures: Vec<f64>) -> [f64; 3] {
    figures.sort_by(f64::total_cmp);
    let at = |part: f64| {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
        let index = (part * real(figures.len() as u64)).ceil() as usize;
        figures.get(index.saturating_sub(1)).copied().unwrap_or(f64::NAN)
    };
    [at(0.5), at(0.99), at(1.0)]
}

#[cfg(test)]
mod tests {
    use super::super::track::{Shape, limits, settings, shape};
    use super::*;
    use fixed_math::spline::IntervalLog2;

    /// What a device's own arithmetic puts out is found exact; with a step moved, lost or turned over it is not.
    #[test]
    fn every_edge_counts() {
        let interval = IntervalLog2::new(12).unwrap();
        let points = shape(Shape { reach: 30_000.0, turns: 1.0 }, 0, interval, 200_000);
        let first = NetTime::from_us(1 << 20);
        let series = Series::new(interval, first, 0, points, *limits(&settings(interval)).brake());
        let mut device = StepBits::new(STEP_LOG2, StepBits::quarter(STEP_LOG2), 0).unwrap();
        let beats = (first.as_us() / BEAT_US - 256, first.as_us() / BEAT_US + 4_000);
        let mut steps = Vec::new();
        for beat in beats.0..beats.1 {
            let step = device.update(series.played(NetTime::from_us(beat * BEAT_US))[0]);
            let is_up = step.direction == Direction::Up;
            if step.is_step {
                steps.push(StepEdge { beat, is_up, late_ns: 0.0, global_ns: 0.0 });
            }
        }
        let exact = follow(&series, &steps, beats, |system| system);
        assert!(exact.is_exact() && exact.steps > 200, "{exact:?}");
        for at in [0, steps.len() / 3, steps.len() - 1] {
            let mut moved = steps.clone();
            moved[at].beat += 1;
            let mut lost = steps.clone();
            lost.remove(at);
            let mut turned = steps.clone();
            turned[at].is_up ^= true;
            let mut doubled = steps.clone();
            doubled.insert(at, steps[at]);
            for wrong in [moved, lost, turned, doubled] {
                assert!(!follow(&series, &wrong, beats, |system| system).is_exact());
            }
        }
        assert!(
            quantiles((1..=1_000).map(f64::from).collect())
                .iter()
                .zip([500.0, 990.0, 1_000.0])
                .all(|(a, b)| (a - b).abs() < 0.5)
        );
    }
}

//! Tracks to be played, and where an axis has to be by them: as exact numbers say, and as a device's arithmetic does.
//!
//! - **Walk:** [`shape`] → points → [`Series`] → [`Series::exact`] and [`Series::played`] at a track time.
//! - **Invariants:** a series rests before its first point; behind its last one it goes on as the device's brake does. Exact values are the
//!   spline's polynomial in double precision: off by less than 2^−20 LSB for the positions here, a test compares them with integers of 128 bits.
//! - **Context:** the judge's side; nothing of it is sent but the points.

use fixed_math::brake::Brake;
use fixed_math::limits::{Curve, Knot, Limits};
use fixed_math::spline::IntervalLog2;
use fixed_math::spline::horner::Cubic;
use fixed_math::time::{NetTime, Span};
use fixed_math::warp::Warp;
use osap_protocol::motion::{AxisSettings, CurveSettings, StarvedPolicy};

/// Steps of 2^n LSB.
pub(super) const STEP_LOG2: u32 = 8;
/// Halts take 3·2^n µs: 98 ms.
pub(super) const STOP_LOG2: u8 = 15;
/// Limits of all axes, LSB a second^n: 12,200 steps a second, a stop from there within some 60 ms.
const VELOCITY: f64 = 3.125e6;
const ACCELERATION: f64 = 4.8e8;
const JERK: f64 = 8.8e10;
/// Positions allowed, LSB.
const REACH: i32 = 1 << 20;
/// Missing points that a device makes up in a row.
pub(super) const MISSING_MAX: usize = 2;
/// Points that the brake may add.
const BRAKE_POINTS_MAX: usize = 1_024;

/// One axis' way: `turns` times there and back over `reach` LSB, beginning and ending at rest.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shape {
    /// From one end to the other, LSB.
    pub(super) reach: f64,
    /// How often there and back.
    pub(super) turns: f64,
}

/// Points of a shape that takes `us`, one interval apart, rounded; three more at rest end it.
#[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "small numbers")]
pub(super) fn shape(shape: Shape, rest: i32, interval: IntervalLog2, us: u64) -> Vec<i32> {
    let turn = core::f64::consts::TAU;
    let count = (us / u64::from(interval.us())) as usize;
    let at = |index: usize| {
        let part = index as f64 / count as f64;
        // its first two derivatives are 0 at both ends
        let angle = turn * part - (turn * part).sin();
        rest + (shape.reach / 2.0 * (1.0 - (shape.turns * angle).cos())).round() as i32
    };
    (1..=count).map(at).chain([rest; 3]).collect()
}

/// Settings of an axis with intervals of 2^`interval_log2` µs: the limits above in differences, each with what rounding of points adds.
#[expect(clippy::cast_possible_truncation, reason = "small numbers")]
pub(super) fn settings(interval: IntervalLog2) -> AxisSettings {
    let h = f64::from(interval.us()) / 1e6;
    let flat = |value: f64, rounding: i32| {
        let value = value.floor() as i32 + rounding;
        CurveSettings { at_rest: value, at_full: value, knee: 0 }
    };
    AxisSettings {
        interval_log2: interval.log2() as u8,
        step_log2: STEP_LOG2 as u8,
        policy: StarvedPolicy::Stop,
        missing_max: MISSING_MAX as u8,
        stop_log2: STOP_LOG2,
        position_min: -REACH,
        position_max: REACH,
        velocity: (VELOCITY * h).floor() as i32 + 1,
        acceleration: flat(ACCELERATION * h * h, 2),
        jerk: flat(JERK * h * h * h, 4),
    }
}

/// What points of an axis with [`settings`] have to keep: its limits less the reserve of a stop.
///
/// # Panics
/// Where the settings above are none.
pub(super) fn limits(settings: &AxisSettings) -> Limits {
    let AxisSettings { position_min, position_max, velocity, acceleration, jerk, .. } = *settings;
    let (acceleration, jerk) = (Curve::flat(acceleration.at_rest), Curve::flat(jerk.at_rest));
    let whole = Limits::new((position_min, position_max), velocity, acceleration, jerk).expect("limits above");
    let interval = IntervalLog2::new(settings.interval_log2.into()).expect("an interval above");
    warp().limits_within(&whole, interval).expect("a stop long enough")
}

/// Stops of all axes.
pub(super) fn warp() -> Warp {
    Warp::new(STOP_LOG2.into()).expect("in range")
}

/// Points of an axis since it was armed.
#[derive(Clone, Debug)]
pub(super) struct Series {
    /// Time between points.
    pub(super) interval: IntervalLog2,
    /// Time of the rest position, one interval before the first point.
    pub(super) start: NetTime,
    /// Where it was armed.
    pub(super) rest: i32,
    /// As sent.
    pub(super) points: Vec<i32>,
    /// As the brake goes on, until it rests.
    braked: Vec<i32>,
}

impl Series {
    /// Of `points`, whose first is at `first`.
    pub(super) fn new(interval: IntervalLog2, first: NetTime, rest: i32, points: Vec<i32>, brake: Brake) -> Self {
        let start = first.shifted(-i64::from(interval.steps()));
        let mut knot = Knot::resting(rest);
        for position in &points {
            let velocity = position - knot.position;
            knot = Knot { position: *position, velocity, acceleration: velocity - knot.velocity };
        }
        let mut braked = Vec::new();
        while !knot.is_at_rest() && braked.len() < BRAKE_POINTS_MAX {
            knot = brake.next(knot);
            braked.push(knot.position);
        }
        Self { interval, start, rest, points, braked }
    }

    /// The first `count` points, after which `rebuilt` more are made up from the last three, as a device does, and then the brake's.
    pub(super) fn cut(&self, count: usize, rebuilt: usize, brake: Brake) -> Self {
        let first = self.start + Span::from_steps(self.interval.steps().into());
        let mut points = self.points[..count].to_vec();
        for _ in 0..rebuilt {
            if let [.., before, last_but_one, last] = points[..] {
                points.push(3 * last - 3 * last_but_one + before);
            }
        }
        let mut cut = Self::new(self.interval, first, self.rest, points, brake);
        let made_up = cut.points.split_off(count);
        cut.braked.splice(0..0, made_up);
        cut
    }

    /// Point `index`, of which 0 is the rest position.
    fn point(&self, index: i64) -> i32 {
        let Ok(index) = usize::try_from(index - 1) else { return self.rest };
        let mut all = self.points.iter().chain(&self.braked);
        *all.nth(index).unwrap_or_else(|| self.last())
    }

    fn last(&self) -> &i32 {
        self.braked.last().or(self.points.last()).unwrap_or(&self.rest)
    }

    /// Where it ends.
    pub(super) fn end(&self) -> i32 {
        *self.last()
    }

    /// When it has come to rest, track time.
    pub(super) fn end_time(&self) -> NetTime {
        let count = (self.points.len() + self.braked.len() + 3) as u64;
        self.start + Span::from_steps(count * u64::from(self.interval.steps()))
    }

    /// The greatest second and third differences of all points, those of the brake among them.
    pub(super) fn differences_max(&self) -> (i32, i32) {
        let all: Vec<i32> =
            [self.rest; 3].iter().chain(&self.points).chain(&self.braked).chain([self.last(); 3]).copied().collect();
        let differences = |of: &[i32]| of.windows(2).map(|pair| pair[1] - pair[0]).collect::<Vec<_>>();
        let second = differences(&differences(&all));
        let third = differences(&second);
        let most = |of: &[i32]| of.iter().map(|it| it.abs()).max().unwrap_or(0);
        (most(&second), most(&third))
    }

    /// Four points around a track time, and steps since the second of them.
    fn around(&self, at: NetTime) -> ([i32; 4], u32) {
        let after = at.steps_after(self.start);
        let step = i64::from(self.interval.steps());
        let index = after.div_euclid(step);
        let since = u32::try_from(after.rem_euclid(step)).unwrap_or(0);
        ([-1, 0, 1, 2].map(|offset| self.point(index + offset)), since)
    }

    /// The position by the polynomial, LSB.
    pub(super) fn exact(&self, at: NetTime) -> f64 {
        let (points, since) = self.around(at);
        let [p0, p1, p2, p3] = points.map(f64::from);
        let u = f64::from(since) / f64::from(self.interval.steps());
        let (c1, c2, c3) = (3.0 * (p2 - p0), 3.0 * (p0 - 2.0 * p1 + p2), p3 - p0 + 3.0 * (p1 - p2));
        (p0 + 4.0 * p1 + p2 + u * (c1 + u * (c2 + u * c3))) / 6.0
    }

    /// Position and velocity as a device has them, LSB and 2^−4 LSB an interval; acceleration likewise an interval², and jerk.
    pub(super) fn played(&self, at: NetTime) -> [i32; 4] {
        let (points, since) = self.around(at);
        let Ok(cubic) = Cubic::new(points) else { return [points[1], 0, 0, 0] };
        let part = self.interval.part(since);
        let (position, velocity) = cubic.position_velocity(part);
        [position, velocity, cubic.acceleration(part), cubic.jerk()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fixed_math::spline::Segment;

    fn series(log2: u32) -> Series {
        let interval = IntervalLog2::new(log2).unwrap();
        let points = shape(Shape { reach: 50_000.0, turns: 2.0 }, 100, interval, 200_000);
        let settings = settings(interval);
        Series::new(interval, NetTime::from_us(1 << 20), 100, points, *limits(&settings).brake())
    }

    /// At whole microseconds the polynomial in double precision rounds to what integers of 128 bits give, or lies at a half.
    #[test]
    fn exact_positions_are_those_of_the_reference() {
        for log2 in [10, 12] {
            let series = series(log2);
            for us in (0..220_000).step_by(64) {
                let at = series.start + Span::from_us(us);
                let (points, since) = series.around(at);
                let reference = Segment::new(points, series.interval).sample(since >> 8).position;
                let distance = (series.exact(at) - f64::from(reference)).abs();
                assert!(distance <= 0.5 + 1e-6, "{us} µs: {distance}");
                assert!((series.exact(at) - f64::from(series.played(at)[0])).abs() <= 1.0, "{us} µs");
            }
        }
    }

    /// The shapes keep the limits and rest at both ends; one that is cut off is braked within them.
    #[test]
    fn shapes_keep_their_limits_and_so_does_the_brake_behind_them() {
        for log2 in [10, 12] {
            let whole = series(log2);
            assert!(whole.braked.is_empty() && whole.end() == 100);
            let settings = settings(whole.interval);
            let limits = limits(&settings);
            let cut = whole.cut(whole.points.len() / 3, 2, *limits.brake());
            assert!(cut.braked.len() > 2);
            for series in [whole, cut] {
                let (second, third) = series.differences_max();
                assert!(
                    second <= limits.acceleration().at_rest() && third <= limits.jerk().at_rest(),
                    "{log2}: {second} {third}"
                );
            }
        }
    }
}

//! A spline of control points as a device plays it: evaluated by the device's own fixed-point code.
//!
//! - **Walk:** [`Points`] or [`fit`](super::fit)ted ones → [`Curve`] → [`Cubic`], the evaluator of the interpolator → [`Sample`]s.
//! - **Invariants:** nothing here calculates a position or one of its derivatives; what a device would not play is refused. All
//!   that is done in floats is the last step, from LSB an interval^n to units a second^n, for people.
//!
//! ```
//! use fixed_math::spline::IntervalLog2;
//! use osap::motion::curve::{Curve, Ends};
//! let curve = Curve::new(&[vec![0, 4096]], IntervalLog2::new(12).unwrap(), Ends::Repeat).unwrap();
//! // from rest an interval before the first point to rest an interval after the last
//! assert_eq!((curve.duration_us(), curve.sample(0, 0).position), (3 * 4096, 0));
//! assert_eq!(curve.sample(0, 3 * 4096).position, 4096);
//! ```

use super::points::{Lsb, Points};
use fixed_math::spline::horner::{Cubic, GUARD_BITS};
use fixed_math::spline::{DIFFERENCE_MAX, IntervalLog2, TooFar};
use serde::Serialize;

/// Points that one interval of the spline takes.
const SUPPORT: usize = 4;
/// Steps of system time in a µs.
const STEPS_PER_US: u32 = 256;
/// Microseconds in a second.
const US_PER_S: f64 = 1e6;

/// How the ends of a list of points are treated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Ends {
    /// The first and the last point stand there thrice: the curve begins and ends in them, at rest.
    Repeat,
    /// As they are: the curve begins near the second point and ends near the last but one.
    Open,
}

/// What is missing for a curve.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CurveError {
    /// Fewer points than one interval takes.
    #[error("{found} points make no curve with open ends: it takes {SUPPORT}")]
    TooFew {
        /// How many there are.
        found: usize,
    },
    /// Two neighbours are further apart than a device takes.
    #[error(
        "the points {point} and {} of axis {axis} are {} LSB apart, more than the {DIFFERENCE_MAX} that a device plays",
        point + 1,
        distance.unsigned_abs()
    )]
    TooFar {
        /// Number of the axis, from 0.
        axis: usize,
        /// The first of the two, from 0.
        point: usize,
        /// The second less the first, LSB.
        distance: i64,
    },
}

/// A device's values at one instant, in its own units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// LSB.
    pub position: i32,
    /// 2^-4 LSB an interval.
    pub velocity: i32,
    /// 2^-4 LSB an interval².
    pub acceleration: i32,
    /// LSB an interval³.
    pub jerk: i32,
}

impl Sample {
    /// The same in units, units/s, units/s² and units/s³.
    #[must_use]
    pub fn in_units(&self, interval: IntervalLog2, lsb: Lsb) -> [f64; 4] {
        let per_interval = US_PER_S / f64::from(interval.us());
        let guard = lsb.units() / f64::from(1u32 << GUARD_BITS);
        [
            f64::from(self.position) * lsb.units(),
            f64::from(self.velocity) * guard * per_interval,
            f64::from(self.acceleration) * guard * per_interval.powi(2),
            f64::from(self.jerk) * lsb.units() * per_interval.powi(3),
        ]
    }
}

/// The splines of one or more axes over the same intervals.
#[derive(Clone, Debug)]
pub struct Curve {
    interval: IntervalLog2,
    ends: Ends,
    /// For each axis one for each interval, and one at rest behind them where the ends repeat.
    axes: Vec<Vec<Cubic>>,
}

impl Curve {
    /// The splines that `axes`, all of one length, span.
    ///
    /// # Errors
    /// Where there are too few, or a device would not play them.
    pub fn new(axes: &[Vec<i32>], interval: IntervalLog2, ends: Ends) -> Result<Self, CurveError> {
        let spline = |(axis, points): (usize, &Vec<i32>)| {
            if ends == Ends::Open && points.len() < SUPPORT {
                return Err(CurveError::TooFew { found: points.len() });
            }
            // At rest for an interval before the first point and from an interval after the last: three of each.
            let (before, after) = if ends == Ends::Repeat { (2, 3) } else { (0, 0) };
            let (first, last) = (points.iter().take(1), points.iter().rev().take(1));
            let first = first.flat_map(|&point| std::iter::repeat_n(point, before));
            let last = last.flat_map(|&point| std::iter::repeat_n(point, after));
            let all: Vec<i32> = first.chain(points.iter().copied()).chain(last).collect();
            let segment = |(at, window): (usize, &[i32])| {
                let points = [window[0], window[1], window[2], window[3]];
                let too_far = |error: TooFar| CurveError::TooFar {
                    axis,
                    // repeated points are not apart, so this one is of the list
                    point: (at + usize::from(error.index)).saturating_sub(before),
                    distance: error.value,
                };
                Cubic::new(points).map_err(too_far)
            };
            all.windows(SUPPORT).enumerate().map(segment).collect::<Result<Vec<Cubic>, CurveError>>()
        };
        let axes = axes.iter().enumerate().map(spline).collect::<Result<_, _>>()?;
        Ok(Self { interval, ends, axes })
    }

    /// How many intervals it lasts.
    #[must_use]
    pub fn intervals(&self) -> usize {
        let all = self.axes.first().map_or(0, Vec::len);
        if self.ends == Ends::Repeat { all.saturating_sub(1) } else { all }
    }

    /// From its beginning to its end, µs.
    #[must_use]
    pub fn duration_us(&self) -> u64 {
        self.intervals() as u64 * u64::from(self.interval.us())
    }

    /// When it begins, relative to its first point, µs.
    #[must_use]
    pub fn begins_us(&self) -> i64 {
        let h = i64::from(self.interval.us());
        if self.ends == Ends::Repeat { -h } else { h }
    }

    /// How many samples `every_us` there are from its beginning on: to the end or the first one behind it where it comes to rest
    /// there, before the end where it is open.
    #[must_use]
    pub fn samples(&self, every_us: u32) -> u64 {
        self.duration_us().div_ceil(u64::from(every_us.max(1))) + u64::from(self.ends == Ends::Repeat)
    }

    /// Values of an axis `at_us` after the beginning; behind the end, those of the end.
    ///
    /// # Panics
    /// Where there is no such axis, or the curve has no interval.
    #[must_use]
    pub fn sample(&self, axis: usize, at_us: u64) -> Sample {
        let (cubic, part) = self.segment(axis, at_us);
        let (position, velocity) = cubic.position_velocity(part);
        Sample { position, velocity, acceleration: cubic.acceleration(part), jerk: cubic.jerk() }
    }

    /// The position alone, LSB: as of [`Curve::sample`].
    ///
    /// # Panics
    /// Where there is no such axis, or the curve has no interval.
    #[must_use]
    pub fn position(&self, axis: usize, at_us: u64) -> i32 {
        let (cubic, part) = self.segment(axis, at_us);
        cubic.position(part)
    }

    fn segment(&self, axis: usize, at_us: u64) -> (&Cubic, u16) {
        let h = u64::from(self.interval.us());
        let cubics = &self.axes[axis];
        let last = cubics.len() - 1;
        let index = usize::try_from(at_us / h).map_or(last, |index| index.min(last));
        let since_us = (at_us - index as u64 * h).min(h);
        // at most 2^14 · 256
        let steps = u32::try_from(since_us).map_or(u32::MAX, |us| us * STEPS_PER_US);
        (&cubics[index], self.interval.part(steps))
    }
}

impl Points {
    /// Their curve.
    ///
    /// # Errors
    /// As of [`Curve::new`].
    pub fn curve(&self, ends: Ends) -> Result<Curve, CurveError> {
        Curve::new(self.axes(), self.interval(), ends)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fixed_math::spline::Segment;

    fn interval(log2: u32) -> IntervalLog2 {
        IntervalLog2::new(log2).unwrap()
    }

    /// Positions less than the one LSB that the evaluator states from the exact spline, which is itself rounded by a half: at most one.
    #[test]
    #[expect(clippy::cast_precision_loss, reason = "the sixteenth digit is allowed for where it counts")]
    fn it_is_the_spline_of_its_points() {
        let points = vec![0, 70_000, -3_000_000, 41, 12_345_678, 12_345_678, 7];
        let curve = Curve::new(std::slice::from_ref(&points), interval(9), Ends::Open).unwrap();
        assert_eq!((curve.intervals(), curve.begins_us()), (4, 512));
        for at_us in 0..curve.duration_us() {
            let index = usize::try_from(at_us / 512).unwrap();
            let four = [points[index], points[index + 1], points[index + 2], points[index + 3]];
            let exact = Segment::new(four, interval(9)).sample(u32::try_from(at_us % 512).unwrap());
            assert!((curve.position(0, at_us) - exact.position).abs() <= 1, "{at_us}");
            let sample = curve.sample(0, at_us);
            assert_eq!(sample.position, curve.position(0, at_us));
            let [_, velocity, acceleration, jerk] = sample.in_units(interval(9), Lsb::new(1.0).unwrap());
            let per_interval = 1e6 / 512.0;
            // stated by the evaluator: from 6/16 below to 1/16 above an interval, 1/16 below an interval²; one half is the reference's
            assert!((velocity - exact.velocity_per_s as f64).abs() <= 6.0 / 16.0 * per_interval + 0.5);
            assert!((acceleration - exact.acceleration_per_s2 as f64).abs() <= per_interval.powi(2) / 16.0 + 0.5);
            // jerk is exact but for the reference's half, and for the sixteenth digit of what may be 1e17
            assert!((jerk - exact.jerk_per_s3 as f64).abs() <= 0.5 + 1e-14 * jerk.abs(), "{jerk} {exact:?}");
        }
    }

    #[test]
    fn repeated_ends_begin_and_end_at_rest_in_the_points_themselves() {
        let curve = Curve::new(&[vec![1000, -5, 77_777]], interval(8), Ends::Repeat).unwrap();
        assert_eq!((curve.intervals(), curve.begins_us(), curve.samples(100)), (4, -256, 12));
        let rest = |position| Sample { position, velocity: 0, acceleration: 0, jerk: 0 };
        assert_eq!(Sample { jerk: 0, ..curve.sample(0, 0) }, rest(1000));
        assert_eq!([1024, 1100, u64::MAX].map(|at| curve.sample(0, at)), [rest(77_777); 3]);
        assert_eq!(Curve::new(&[vec![5]], interval(8), Ends::Repeat).unwrap().sample(0, 3), rest(5));
    }

    #[test]
    fn what_a_device_would_not_play_is_refused_with_its_place() {
        let far = DIFFERENCE_MAX + 1;
        let error = Curve::new(&[vec![0; 5], vec![0, 0, 0, 0, far]], interval(8), Ends::Open).unwrap_err();
        assert_eq!(error, CurveError::TooFar { axis: 1, point: 3, distance: i64::from(far) });
        let error = Curve::new(&[vec![far, 0, 0]], interval(8), Ends::Repeat).unwrap_err();
        assert_eq!(error, CurveError::TooFar { axis: 0, point: 0, distance: -i64::from(far) });
        let error = Curve::new(&[vec![i32::MIN, i32::MAX]], interval(8), Ends::Repeat).unwrap_err();
        assert_eq!(error, CurveError::TooFar { axis: 0, point: 0, distance: (1 << 32) - 1 });
        let error = Curve::new(&[vec![1, 2, 3]], interval(8), Ends::Open).unwrap_err();
        assert_eq!(error, CurveError::TooFew { found: 3 });
        assert!(Curve::new(&[vec![0, DIFFERENCE_MAX]], interval(8), Ends::Repeat).is_ok());
    }
}

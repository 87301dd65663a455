//! How far the spline that a device plays is from the path its points came from, for each interval and each way to make points.
//!
//! - **Walk:** [`Path`] → samples at the points' times → [`Fit`] → LSB → [`Curve`] → positions at the device's rate → less the path at the
//!   same instants. Beside it the [`Bound`] of the path; at the end the longest interval that is good enough.
//! - **Invariants:** positions are those of the device's own evaluator. The deviation is taken at equal times, so it holds what a spline cuts off a
//!   corner and what it lags or leads along the path.
//! - **Phases:** where a path lies against the grid of its points is chance, so it is laid at several offsets and the worst is kept.

use super::bound::{Bound, ROUNDING_LSB};
use super::curve::{Curve, CurveError, Ends};
use super::fit::{Fit, MARGIN};
use super::path::Path;
use super::points::Lsb;
use fixed_math::spline::{INTERVAL_LOG2_MAX, INTERVAL_LOG2_MIN, IntervalLog2};
use serde::Serialize;

/// Microseconds in a second.
const US_PER_S: f64 = 1e6;

/// Points on either side of an interval's four that have to lie in a path with open ends: what is behind them weighs less than 0.27^4,
/// half a hundredth, for the fit that looks furthest.
pub const OPEN_MARGIN: usize = 4;

/// How it is measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setup {
    /// Step of a position.
    pub lsb: Lsb,
    /// Whether the path stands still before its first row and after its last, or is looked at only where four points lie in it.
    pub ends: Ends,
    /// Offsets of the points' grid, at least one.
    pub phases: u32,
    /// Time between two positions, µs: a power of two, 256 at most.
    pub every_us: u32,
}

/// Distances of one axis, or of all as a vector.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Distance {
    /// The largest, units.
    pub max: f64,
    /// Root of the mean square, units.
    pub rms: f64,
    /// When it was largest, after the path's first row, s.
    pub max_at_s: f64,
}

/// One interval with one fit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Deviation {
    /// Time between points, µs.
    pub interval_us: u32,
    /// How points were made.
    pub fit: Fit,
    /// Of each axis.
    pub axes: Vec<Distance>,
    /// Of all axes as a vector.
    pub norm: Distance,
    /// Largest acceleration of the spline as a vector, units/s².
    pub acceleration_max_per_s2: f64,
    /// The same over that of the fit `sample`, which never has more than the path.
    pub overshoot: f64,
    /// Largest jerk as a vector, units/s³.
    pub jerk_max_per_s3: f64,
    /// What the formula allows, rounding included, units; of `sample` alone.
    pub bound: Option<f64>,
}

/// One interval: its bounds and its fits.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct IntervalReport {
    /// Time between points, µs.
    pub interval_us: u32,
    /// For each axis, without rounding.
    pub axis_bounds: Vec<Bound>,
    /// For all axes as a vector, without rounding.
    pub norm_bound: Bound,
    /// What rounding to LSB may add to the vector, units.
    pub rounding: f64,
    /// For each fit; none where `not_measured` says why.
    pub fits: Vec<Deviation>,
    /// Why nothing could be measured here.
    pub not_measured: Option<NotMeasured>,
}

/// Why an interval has no deviation.
#[derive(Clone, Debug, PartialEq, thiserror::Error, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NotMeasured {
    /// No four points and [`OPEN_MARGIN`] more on either side lie in it.
    #[error("the path is too short for open ends")]
    TooShort,
    /// Two points are further apart than a device takes.
    #[error("points {at_s} s after the first row are {} LSB apart, more than a device plays", distance.unsigned_abs())]
    TooFast {
        /// After the first row, s.
        at_s: f64,
        /// The second less the first, LSB.
        distance: i64,
    },
}

/// The interval to take.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Choice {
    /// The way to make points.
    pub fit: Fit,
    /// The longest interval for which it, and each shorter one, keeps the tolerance, µs.
    pub interval_us: u32,
    /// The largest deviation there, units.
    pub deviation: f64,
    /// As of [`Deviation::overshoot`].
    pub overshoot: f64,
    /// Points a second for each axis.
    pub points_per_s: f64,
}

/// Measures a path at every interval that a device knows, the shortest first; `done` hears of each.
///
/// # Errors
/// Where a position of it takes more than 32 bits.
pub fn measure(path: &Path, setup: &Setup, mut done: impl FnMut(u32)) -> Result<Vec<IntervalReport>, OutOfRange> {
    let bends = path.bends(setup.ends == Ends::Repeat);
    let mut report = |interval: IntervalLog2| {
        let axes = path.names().len();
        let axis_bounds = (0..axes).map(|axis| Bound::of(&bends, |change| change[axis].abs(), interval)).collect();
        let norm_bound = Bound::of(&bends, norm, interval);
        let rounding = ROUNDING_LSB * setup.lsb.units() * root_of(axes);
        let fits = measure_interval(path, setup, interval, norm_bound.deviation + rounding);
        done(interval.us());
        let (fits, not_measured) = match fits {
            Ok(fits) => (fits, None),
            Err(Stopped::NotMeasured(why)) => (Vec::new(), Some(why)),
            Err(Stopped::OutOfRange(error)) => return Err(error),
        };
        Ok(IntervalReport { interval_us: interval.us(), axis_bounds, norm_bound, rounding, fits, not_measured })
    };
    (INTERVAL_LOG2_MIN..=INTERVAL_LOG2_MAX).filter_map(IntervalLog2::new).map(&mut report).collect()
}

/// For each of `fits`, in their order, the longest interval within `tolerance`; none where even the shortest is not.
#[must_use]
pub fn choices(reports: &[IntervalReport], fits: &[Fit], tolerance: f64) -> Vec<Choice> {
    let of_fit = |&fit: &Fit| {
        let deviation = |report: &IntervalReport| report.fits.iter().find(|it| it.fit == fit).cloned();
        let kept = reports.iter().map_while(deviation).take_while(|it| it.norm.max <= tolerance);
        let longest = kept.last()?;
        Some(Choice {
            fit,
            interval_us: longest.interval_us,
            deviation: longest.norm.max,
            overshoot: longest.overshoot,
            points_per_s: US_PER_S / f64::from(longest.interval_us),
        })
    };
    fits.iter().filter_map(of_fit).collect()
}

/// The longest interval of `choices`; of equals, the first.
#[must_use]
pub fn best(choices: &[Choice]) -> Option<&Choice> {
    choices.iter().rev().max_by_key(|choice| choice.interval_us)
}

/// The longest interval whose bound, rounding included, is within `tolerance`, µs: good for every path as fast as this one.
#[must_use]
pub fn longest_by_bound(reports: &[IntervalReport], tolerance: f64) -> Option<u32> {
    let kept = reports.iter().take_while(|it| it.norm_bound.deviation + it.rounding <= tolerance);
    kept.last().map(|it| it.interval_us)
}

/// A position takes more than 32 bits.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("axis {axis} is at {value} {at_s} s after the first row: more than 2^31 steps of {lsb}")]
pub struct OutOfRange {
    /// Number of the axis, from 0.
    pub axis: usize,
    /// After the first row, s.
    pub at_s: f64,
    /// The control point, units.
    pub value: f64,
    /// The step.
    pub lsb: Lsb,
}

/// What ends the measuring of an interval.
enum Stopped {
    NotMeasured(NotMeasured),
    OutOfRange(OutOfRange),
}

fn norm(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum::<f64>().sqrt()
}

fn root_of(axes: usize) -> f64 {
    norm(&vec![1.0; axes])
}

/// One layout of points: when the first is, and how many.
struct Grid {
    interval: IntervalLog2,
    /// Time of the first point, after the path's first row, µs.
    first_us: f64,
    points: usize,
}

impl Grid {
    /// Points at `phase` of `phases`, from well before the path to well after it.
    fn over(path: &Path, interval: IntervalLog2, phase: u32, phases: u32) -> Self {
        let h = f64::from(interval.us());
        let margin = u32::try_from(MARGIN + 3).map_or(0.0, f64::from);
        let first_us = -h * (margin + f64::from(phase) / f64::from(phases));
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at most a day over 2^8 µs, not negative"
        )]
        let points = ((path.duration_us() - first_us) / h + margin).ceil() as usize + 1;
        Self { interval, first_us, points }
    }

    fn time_us(&self, point: usize) -> f64 {
        let h = u64::from(self.interval.us());
        #[expect(clippy::cast_precision_loss, reason = "a day of µs is below 2^53")]
        let since = (point as u64 * h) as f64;
        self.first_us + since
    }

    /// The path at all points. With open ends it goes straight on as it began and ended.
    fn samples(&self, path: &Path, axis: usize, ends: Ends) -> Vec<f64> {
        let mut cursor = 0;
        let slopes = path.end_slopes(axis);
        let mut at = |at_us: f64| {
            let inside_us = at_us.clamp(0.0, path.duration_us());
            let slope = match ends {
                Ends::Repeat => 0.0,
                Ends::Open => slopes[usize::from(at_us > inside_us)],
            };
            path.position(axis, inside_us, &mut cursor) + slope * (at_us - inside_us)
        };
        (0..self.points).map(|point| at(self.time_us(point))).collect()
    }

    /// The intervals, by the first of their four points, in which the spline is compared.
    fn compared(&self, path: &Path, ends: Ends) -> std::ops::Range<usize> {
        let h = f64::from(self.interval.us());
        // at rest nothing deviates further out than the four points of an interval reach
        let (beyond_us, margin) = if ends == Ends::Repeat { (3.0 * h, 0) } else { (0.0, OPEN_MARGIN) };
        let range_us = -beyond_us..=path.duration_us() + beyond_us;
        let inside = |point: &usize| range_us.contains(&self.time_us(*point));
        let first = (0..self.points).find(inside).unwrap_or(0) + margin;
        let last = (0..self.points).rev().find(inside).unwrap_or(0).saturating_sub(margin);
        first..last.saturating_sub(2).max(first)
    }
}

/// What one fit has come to so far.
struct Tally {
    fit: Fit,
    axes: Vec<Distance>,
    /// The vector's, as the last.
    norm: Distance,
    acceleration_max_per_s2: f64,
    jerk_max_per_s3: f64,
    samples: u32,
}

impl Tally {
    fn new(fit: Fit, axes: usize) -> Self {
        let axes = vec![Distance::default(); axes];
        Self { fit, axes, norm: Distance::default(), acceleration_max_per_s2: 0.0, jerk_max_per_s3: 0.0, samples: 0 }
    }

    /// One instant: the deviation of each axis. `rms` holds sums of squares until the end.
    fn take(&mut self, at_us: f64, deviations: &[f64]) {
        let take = |distance: &mut Distance, size: f64| {
            distance.rms += size * size;
            if size > distance.max {
                (distance.max, distance.max_at_s) = (size, at_us / US_PER_S);
            }
        };
        for (distance, deviation) in self.axes.iter_mut().zip(deviations) {
            take(distance, deviation.abs());
        }
        take(&mut self.norm, norm(deviations));
        self.samples += 1;
    }

    /// The largest second and third differences of the points from `from` to before `to`: where a cubic's acceleration is largest.
    fn take_differences(
        &mut self,
        axes: &[Vec<i32>],
        range: std::ops::Range<usize>,
        setup: &Setup,
        interval: IntervalLog2,
    ) {
        let per_interval = US_PER_S / f64::from(interval.us());
        let lsb = setup.lsb.units();
        for first in range {
            let difference = |points: &Vec<i32>, weights: [f64; 4]| {
                let four = &points[first..first + 4];
                four.iter().zip(weights).map(|(&point, weight)| f64::from(point) * weight).sum::<f64>()
            };
            let of =
                |weights: [f64; 4]| norm(&axes.iter().map(|points| difference(points, weights)).collect::<Vec<f64>>());
            let bend = of([1.0, -2.0, 1.0, 0.0]).max(of([0.0, 1.0, -2.0, 1.0]));
            self.acceleration_max_per_s2 = self.acceleration_max_per_s2.max(bend * lsb * per_interval.powi(2));
            self.jerk_max_per_s3 = self.jerk_max_per_s3.max(of([-1.0, 3.0, -3.0, 1.0]) * lsb * per_interval.powi(3));
        }
    }

    fn finish(mut self, interval: IntervalLog2, sampled_per_s2: f64, bound: f64) -> Deviation {
        for distance in self.axes.iter_mut().chain([&mut self.norm]) {
            distance.rms = (distance.rms / f64::from(self.samples.max(1))).sqrt();
        }
        let overshoot = if sampled_per_s2 > 0.0 { self.acceleration_max_per_s2 / sampled_per_s2 } else { 1.0 };
        Deviation {
            interval_us: interval.us(),
            fit: self.fit,
            axes: self.axes,
            norm: self.norm,
            acceleration_max_per_s2: self.acceleration_max_per_s2,
            overshoot,
            jerk_max_per_s3: self.jerk_max_per_s3,
            bound: (self.fit == Fit::Sample).then_some(bound),
        }
    }
}

fn measure_interval(path: &Path, setup: &Setup, interval: IntervalLog2, bound: f64) -> Result<Vec<Deviation>, Stopped> {
    let axes = path.names().len();
    let mut tallies = Fit::ALL.map(|fit| Tally::new(fit, axes));
    for phase in 0..setup.phases {
        let grid = Grid::over(path, interval, phase, setup.phases);
        let compared = grid.compared(path, setup.ends);
        let samples: Vec<Vec<f64>> = (0..axes).map(|axis| grid.samples(path, axis, setup.ends)).collect();
        let mut curves = Vec::new();
        for tally in &mut tallies {
            let points = points(tally.fit, &samples, &grid, setup)?;
            tally.take_differences(&points, compared.clone(), setup, interval);
            curves.push(curve(&points, &grid)?);
        }
        compare(path, setup, &grid, compared, &curves, &mut tallies);
    }
    if tallies[0].samples == 0 {
        return Err(Stopped::NotMeasured(NotMeasured::TooShort));
    }
    let sampled = tallies[0].acceleration_max_per_s2;
    Ok(tallies.into_iter().map(|tally| tally.finish(interval, sampled, bound)).collect())
}

/// Points of all axes, LSB.
fn points(fit: Fit, samples: &[Vec<f64>], grid: &Grid, setup: &Setup) -> Result<Vec<Vec<i32>>, Stopped> {
    let axis = |(axis, samples): (usize, &Vec<f64>)| {
        let step = |(point, value): (usize, f64)| {
            let at_s = grid.time_us(point) / US_PER_S;
            setup.lsb.steps(value).ok_or(Stopped::OutOfRange(OutOfRange { axis, at_s, value, lsb: setup.lsb }))
        };
        fit.points(samples).into_iter().enumerate().map(step).collect::<Result<Vec<i32>, Stopped>>()
    };
    samples.iter().enumerate().map(axis).collect()
}

fn curve(points: &[Vec<i32>], grid: &Grid) -> Result<Curve, Stopped> {
    Curve::new(points, grid.interval, Ends::Open).map_err(|error| {
        Stopped::NotMeasured(match error {
            CurveError::TooFar { point, distance, .. } => {
                NotMeasured::TooFast { at_s: grid.time_us(point) / US_PER_S, distance }
            }
            CurveError::TooFew { .. } => NotMeasured::TooShort,
        })
    })
}

/// Takes the deviation of each curve at each instant into its tally.
fn compare(
    path: &Path,
    setup: &Setup,
    grid: &Grid,
    compared: std::ops::Range<usize>,
    curves: &[Curve],
    tallies: &mut [Tally],
) {
    let axes = path.names().len();
    let h = grid.interval.us();
    let mut cursor = 0;
    let (mut wanted, mut deviations) = (vec![0.0; axes], vec![0.0; axes]);
    for first in compared {
        for since_us in (0..h).step_by(setup.every_us as usize) {
            // the interval of four points begins at the second; the open curve's time begins at the grid's second point
            let at_us = grid.time_us(first + 1) + f64::from(since_us);
            let curve_us = first as u64 * u64::from(h) + u64::from(since_us);
            for (axis, wanted) in wanted.iter_mut().enumerate() {
                *wanted = path.position(axis, at_us, &mut cursor);
            }
            for (curve, tally) in curves.iter().zip(&mut *tallies) {
                for (axis, deviation) in deviations.iter_mut().enumerate() {
                    let played = f64::from(curve.position(axis, curve_us)) * setup.lsb.units();
                    *deviation = played - wanted[axis];
                }
                tally.take(at_us, &deviations);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::table::Table;
    use proptest::prelude::*;
    use std::f64::consts::TAU;
    use std::fmt::Write as _;

    const LSB: f64 = 1.0 / 65_536.0;

    fn setup(ends: Ends, phases: u32) -> Setup {
        Setup { lsb: Lsb::DEFAULT, ends, phases, every_us: 64 }
    }

    fn path(rows: impl Iterator<Item = (u32, Vec<f64>)>) -> Path {
        let mut rows = rows.peekable();
        let axes = rows.peek().map_or(0, |(_, axes)| axes.len());
        let head = (0..axes).fold("time_us".to_owned(), |head, axis| format!("{head},a{axis}"));
        let text = rows.fold(format!("{head}\n"), |mut text, (at_us, axes)| {
            // writing to a string cannot fail
            let _ = write!(text, "{at_us}");
            for position in axes {
                let _ = write!(text, ",{position}");
            }
            text.push('\n');
            text
        });
        Path::from_table(&Table::read(text.as_bytes()).unwrap()).unwrap()
    }

    /// A path of `at` every `step_us` for `duration_us`.
    fn sampled(step_us: u32, duration_us: u32, at: impl Fn(f64) -> Vec<f64>) -> Path {
        path((0..=duration_us / step_us).map(|row| (row * step_us, at(f64::from(row * step_us) / US_PER_S))))
    }

    fn h(report: &IntervalReport) -> f64 {
        f64::from(report.interval_us) / US_PER_S
    }

    /// At constant speed nothing deviates, but for what rounding adds.
    #[test]
    fn a_straight_line_has_no_deviation() {
        let line = path([(0, vec![-3.0, 7.0]), (400_000, vec![41.0, -2.0])].into_iter());
        for report in measure(&line, &setup(Ends::Open, 3), |_| ()).unwrap() {
            assert_eq!(report.fits.len(), 3, "{report:?}");
            assert!(report.norm_bound.deviation.abs() < f64::EPSILON);
            for it in &report.fits {
                assert!(it.norm.max > 0.0 && it.norm.max <= report.rounding, "{it:?}");
                assert!(it.axes.iter().all(|axis| axis.max <= ROUNDING_LSB * LSB), "{it:?}");
            }
        }
    }

    /// Around a circle the spline of samples lies inside by R·(1 − cos ωh)/3 at its knots and by R·(1 − (23·cos ½ωh + cos 1½ωh)/24)
    /// between them, where that is largest: R·(ωh)²/6 less 0.068·(ωh)² of itself, so the formula is met to a factor of 1 − (ωh)²/12.
    #[test]
    fn a_circle_keeps_the_bound_and_nearly_meets_it() {
        let (radius, omega) = (20.0, 15.0);
        let acceleration: f64 = radius * omega * omega;
        let step_us = 16;
        let circle = sampled(step_us, 420_000, |t| vec![radius * (omega * t).cos(), radius * (omega * t).sin()]);
        for report in measure(&circle, &setup(Ends::Open, 4), |_| ()).unwrap() {
            let it = &report.fits[0];
            let half = omega * h(&report) / 2.0;
            let expected = radius * (1.0 - (23.0 * half.cos() + (3.0 * half).cos()) / 24.0);
            // a chord of the rows lies inside of the circle too
            let chord = acceleration * (f64::from(step_us) / US_PER_S).powi(2) / 8.0;
            assert!((it.norm.max - expected).abs() <= report.rounding + chord, "{it:?} {expected}");
            let formula = acceleration * h(&report).powi(2) / 6.0;
            assert!(it.norm.max <= it.bound.unwrap(), "{it:?}");
            let tight = 1.0 - (omega * h(&report)).powi(2) / 12.0;
            assert!(it.norm.max >= formula * tight - report.rounding - chord, "{it:?} {formula}");
            // the bound read off the file is the formula's: D²/8 with D = 16 µs is less than 0.3 % of h²/6, the rows' digits a thousandth
            assert!((report.norm_bound.deviation / formula - 1.0).abs() < 5e-3, "{report:?}");
        }
    }

    /// A corner in the middle of an interval, seen there: 13/48·h·|Δv| to the last step.
    #[test]
    fn a_corner_at_its_worst_phase_meets_the_bound() {
        let corner = path([(0, vec![0.0, 0.0]), (262_144, vec![10.0, 0.0]), (524_288, vec![10.0, 10.0])].into_iter());
        let change = 2f64.sqrt() * 10.0 / 0.262_144;
        for report in measure(&corner, &setup(Ends::Open, 2), |_| ()).unwrap() {
            let it = &report.fits[0];
            let worst = 13.0 / 48.0 * h(&report) * change;
            assert!((report.norm_bound.deviation / worst - 1.0).abs() < 1e-12, "{report:?}");
            assert!((it.norm.max - worst).abs() <= report.rounding, "{it:?} {worst}");
            assert!((it.norm.max_at_s - 0.262_144).abs() < 1e-9, "{it:?}");
            // with knots in the corner alone it is h/6 there, and 7/1152 less than 13/48 at most anywhere
            let knot = &measure_interval(
                &corner,
                &setup(Ends::Open, 1),
                IntervalLog2::new(report.interval_us.ilog2()).unwrap(),
                0.0,
            );
            let knot = knot.as_ref().ok().map(|fits| fits[0].norm.max).unwrap();
            assert!((knot - h(&report) / 6.0 * change).abs() <= report.rounding, "{knot}");
        }
    }

    /// What quasi-interpolation and the prefilter are for: a parabola comes out as itself, where samples are h²A/6 off.
    #[test]
    fn fits_of_a_parabola_are_exact() {
        let acceleration = 5_000.0;
        let parabola = sampled(16, 262_144, |t| vec![acceleration * t * t / 2.0]);
        let chord = acceleration * 16e-6f64.powi(2) / 8.0;
        for report in measure(&parabola, &setup(Ends::Open, 2), |_| ()).unwrap() {
            let [sample, quasi, prefilter] = [0, 1, 2].map(|fit| report.fits[fit].norm.max);
            assert!((sample - acceleration * h(&report).powi(2) / 6.0).abs() <= report.rounding + chord, "{report:?}");
            assert!(quasi <= report.rounding + chord, "{report:?}");
            // the path is taken to go straight on at its ends, which is a step of acceleration: what is left of it four points in,
            // at most h²A/12·0.268⁴
            let end = acceleration * h(&report).powi(2) / 12.0 * 0.268f64.powi(4);
            assert!(prefilter <= report.rounding + chord + end, "{report:?}");
        }
    }

    #[test]
    fn what_a_device_cannot_play_and_what_is_too_short_is_told() {
        // 2^25 steps in 2^13 µs are 62.5 units a millisecond
        let fast = path([(0, vec![0.0]), (10_000, vec![800.0])].into_iter());
        let reports = measure(&fast, &setup(Ends::Repeat, 1), |_| ()).unwrap();
        let played = |reports: &[IntervalReport]| reports.iter().take_while(|it| it.not_measured.is_none()).count();
        assert_eq!(played(&reports), 5, "{reports:?}");
        assert!(matches!(reports[5].not_measured, Some(NotMeasured::TooFast { distance, .. }) if distance > 1 << 25));
        let short = path([(0, vec![0.0]), (20_000, vec![1.0])].into_iter());
        // eleven intervals of 1024 µs are in it, not of 2048
        let reports = measure(&short, &setup(Ends::Open, 1), |_| ()).unwrap();
        assert_eq!(played(&reports), 3);
        assert_eq!(reports[3].not_measured, Some(NotMeasured::TooShort));
        let far = path([(0, vec![0.0]), (20_000, vec![40_000.0])].into_iter());
        let error = measure(&far, &setup(Ends::Repeat, 1), |_| ()).unwrap_err();
        assert_eq!((error.axis, error.lsb), (0, Lsb::DEFAULT));
    }

    #[test]
    fn the_longest_interval_is_chosen_whose_shorter_ones_are_good_as_well() {
        let line = sampled(1_000, 300_000, |t| vec![(40.0 * t).sin()]);
        let mut reports = measure(&line, &setup(Ends::Repeat, 1), |_| ()).unwrap();
        for (number, report) in reports.iter_mut().enumerate() {
            let of_sample = [0.1, 0.2, 0.9, 0.3, 0.4, 1.0, 2.0][number];
            for (fit, factor) in report.fits.iter_mut().zip([1.0, 0.5, 0.5]) {
                fit.norm.max = of_sample * factor;
            }
            (report.norm_bound.deviation, report.rounding) = (of_sample, 0.01);
        }
        let found = choices(&reports, &Fit::ALL, 0.5);
        let chosen: Vec<(Fit, u32)> = found.iter().map(|it| (it.fit, it.interval_us)).collect();
        assert_eq!(chosen, [(Fit::Sample, 512), (Fit::Quasi, 8_192), (Fit::Prefilter, 8_192)]);
        // of equals the simpler one
        assert_eq!(best(&found).map(|it| it.fit), Some(Fit::Quasi));
        assert_eq!(longest_by_bound(&reports, 0.205), Some(256));
        assert!(choices(&reports, &Fit::ALL, 0.01).is_empty() && best(&[]).is_none());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// Whatever the path, the spline of its samples is within the bound: for each axis, and for the vector.
        #[test]
        fn no_polyline_breaks_the_bound(
            rows in proptest::collection::vec((1u32..40_000, -2.0f64..2.0, -2.0f64..2.0), 2..40),
            phases in 1u32..6,
            open in any::<bool>(),
        ) {
            let mut at_us = 0;
            let path = path(rows.into_iter().map(|(gap_us, x, y)| {
                at_us += gap_us;
                (at_us, vec![x, y])
            }));
            let ends = if open { Ends::Open } else { Ends::Repeat };
            for report in measure(&path, &setup(ends, phases), |_| ()).unwrap() {
                let Some(it) = report.fits.first() else { continue };
                // 1e-9: what a search for the least of the bound, and sums of 40 changes, may lose of it
                let allowed = |deviation: f64, rounding: f64| deviation * (1.0 + 1e-9) + rounding;
                prop_assert!(it.norm.max <= allowed(report.norm_bound.deviation, report.rounding), "{:?}", report);
                for (axis, bound) in it.axes.iter().zip(&report.axis_bounds) {
                    prop_assert!(axis.max <= allowed(bound.deviation, ROUNDING_LSB * LSB), "{:?}", report);
                }
            }
        }
    }

    /// A full turn, so that TAU is what it says in the other tests' words: the path ends where it began.
    #[test]
    fn at_rest_before_and_after_a_turn_nothing_is_seen_of_the_ends() {
        let turn = sampled(64, 500_000, |t| {
            let u = t / 0.5;
            let angle = TAU * u * u * u * (10.0 - 15.0 * u + 6.0 * u * u);
            vec![10.0 * angle.cos(), 10.0 * angle.sin()]
        });
        for report in measure(&turn, &setup(Ends::Repeat, 2), |_| ()).unwrap() {
            let it = &report.fits[0];
            assert!(it.norm.max <= it.bound.unwrap() && it.norm.rms < it.norm.max, "{it:?}");
            assert!((0.1..0.4).contains(&it.norm.max_at_s), "{it:?}");
        }
    }
}

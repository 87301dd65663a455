//! The most that a spline of samples can be off a path: ε ≤ h²A/6 + (13/48)·h·|Δv|, with A and Δv read off the path.
//!
//! - **Walk:** [`Path::bends`](super::path::Path::bends) → [`Bound::of`], for each axis and for the length of the vector.
//! - **Invariants:** it holds for every phase of the points against the path, before rounding to LSB; [`ROUNDING_LSB`] is what that adds.
//!
//! # Why it holds for a polyline
//!
//! The spline of samples keeps straight lines, so its deviation at t is ∑ K(t, tᵢ)·dᵢ over the path's rows, with dᵢ the change of velocity at
//! row i and K what a change of one at tᵢ does at t. K is never negative, zero where |t − tᵢ| leaves the four points, a span of 3h, at most
//! 13h/48 (a change in the middle of an interval, seen there), and its integral over tᵢ is h²/6. Any share of each |dᵢ| may be
//! taken for acceleration, the rest for a change at once: |dᵢ| ≤ A·wᵢ + eᵢ, with wᵢ the time that row i stands for. Then
//! ε ≤ A·(h²/6 + D²/8) + (13/48)·h·Δv, with Δv the largest sum of eᵢ within 3h and D the longest step between rows: D²/8 is what a sum over rows
//! may be more than the integral, K being made of straight pieces. A row further than h/4 from the next counts as h/4 from it, since rows
//! with no change could be added there. The sum is convex in A, so the A that makes it least is found by a search: it is the acceleration
//! of a path that is smooth, and what exceeds it is a corner.
//!
//! ```
//! use fixed_math::spline::IntervalLog2;
//! use osap::motion::{bound::Bound, path::Path, table::Table};
//! // a corner of 100 units/s in one axis, at 2.048 ms
//! let table = Table::read("time_us,x\n0,0\n100000,0\n200000,10\n".as_bytes()).unwrap();
//! let bends = Path::from_table(&table).unwrap().bends(false);
//! let bound = Bound::of(&bends, |change| change[0].abs(), IntervalLog2::new(11).unwrap());
//! assert_eq!((bound.acceleration_per_s2, bound.velocity_change_per_s), (0.0, 100.0));
//! assert!((bound.deviation - 13.0 / 48.0 * 2.048e-3 * 100.0).abs() < 1e-12);
//! ```

use super::path::Bend;
use fixed_math::spline::IntervalLog2;
use serde::Serialize;

/// Microseconds in a second.
const US_PER_S: f64 = 1e6;
/// Of a change of velocity in the middle of an interval, seen there: ½·(23/48 + 3/48).
const CORNER: f64 = 13.0 / 48.0;
/// Steps of the search for A. Each leaves 0.618 of the range: 64 of them 4e-14.
const SEARCH_STEPS: usize = 64;
/// 1/φ, the golden section.
const GOLDEN: f64 = 0.618_033_988_749_894_8;

/// What a path can do to the spline of its samples.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bound {
    /// A: what the path is taken to accelerate by, units/s².
    pub acceleration_per_s2: f64,
    /// Δv: what it changes its velocity by beyond that, within three intervals, units/s.
    pub velocity_change_per_s: f64,
    /// The most that the spline is off it, units.
    pub deviation: f64,
}

/// The most that rounding adds for each axis, LSB: one half for a point, one for the device's evaluator
/// ([`fixed_math::spline::horner`] states less than one).
pub const ROUNDING_LSB: f64 = 0.5 + 1.0;

/// One row of the path, as the bound sees it.
struct Change {
    at_us: f64,
    /// The time it stands for, s.
    weight_s: f64,
    /// |d|, units/s.
    size_per_s: f64,
}

impl Bound {
    /// The bound of a path with these `bends`, `size` of whose changes of velocity is what counts: one axis, or the vector's length.
    #[must_use]
    pub fn of(bends: &[Bend], size: impl Fn(&[f64]) -> f64, interval: IntervalLog2) -> Self {
        let h_us = f64::from(interval.us());
        let gaps = bends.iter().flat_map(|bend| [bend.before_us, bend.after_us]).filter(|gap| gap.is_finite());
        let step_us = gaps.fold(0.0, f64::max).min(h_us / 4.0);
        let change = |bend: &Bend| Change {
            at_us: bend.at_us,
            weight_s: f64::midpoint(bend.before_us.min(step_us), bend.after_us.min(step_us)) / US_PER_S,
            size_per_s: size(&bend.velocity_change_per_s),
        };
        let changes: Vec<Change> = bends.iter().map(change).collect();
        let (h, step) = (h_us / US_PER_S, step_us / US_PER_S);
        let smooth = h * h / 6.0 + step * step / 8.0;
        let at = |acceleration: f64| {
            let rest = largest_rest(&changes, acceleration, 3.0 * h_us);
            Self {
                acceleration_per_s2: acceleration,
                velocity_change_per_s: rest,
                deviation: acceleration * smooth + CORNER * h * rest,
            }
        };
        let steepest = changes.iter().filter(|it| it.size_per_s > 0.0).map(|it| it.size_per_s / it.weight_s);
        let found = least(at, steepest.fold(0.0, f64::max));
        // a path of corners alone has its least exactly here, which a search only comes near to
        [at(0.0), found].into_iter().min_by(|a, b| a.deviation.total_cmp(&b.deviation)).unwrap_or(found)
    }
}

/// The largest sum, over any `window_us`, of what changes exceed `acceleration` by, units/s.
fn largest_rest(changes: &[Change], acceleration: f64, window_us: f64) -> f64 {
    let rest = |change: &Change| (change.size_per_s - acceleration * change.weight_s).max(0.0);
    let (mut oldest, mut sum, mut largest) = (0, 0.0, 0f64);
    for change in changes {
        while change.at_us - changes[oldest].at_us > window_us {
            sum -= rest(&changes[oldest]);
            oldest += 1;
        }
        sum += rest(change);
        largest = largest.max(sum);
    }
    largest
}

/// The least of a convex function of 0 to `high`, by golden section.
fn least(at: impl Fn(f64) -> Bound, high: f64) -> Bound {
    let (mut low, mut high) = (0.0, high);
    let mut left = at(high - GOLDEN * (high - low));
    let mut right = at(low + GOLDEN * (high - low));
    for _ in 0..SEARCH_STEPS {
        if left.deviation <= right.deviation {
            high = right.acceleration_per_s2;
            right = left;
            left = at(high - GOLDEN * (high - low));
        } else {
            low = left.acceleration_per_s2;
            left = right;
            right = at(low + GOLDEN * (high - low));
        }
    }
    if left.deviation <= right.deviation { left } else { right }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::path::Path;
    use crate::motion::table::Table;
    use std::fmt::Write as _;

    fn bound(log2: u32, step_us: u32, rows: u32, position: impl Fn(f64) -> f64) -> Bound {
        let text = (0..rows).fold("time_us,x\n".to_owned(), |mut text, row| {
            let at_us = row * step_us;
            let _ = writeln!(text, "{at_us},{}", position(f64::from(at_us) / US_PER_S));
            text
        });
        let path = Path::from_table(&Table::read(text.as_bytes()).unwrap()).unwrap();
        Bound::of(&path.bends(false), |change| change[0].abs(), IntervalLog2::new(log2).unwrap())
    }

    /// K of the module's docs, from its definition: what a change of velocity of one at 0 does at t, the points at `phase`, h = 1.
    fn kernel(t: f64, phase: f64) -> f64 {
        let knot = (t - phase).floor();
        let u = t - phase - knot;
        let weights =
            [(1.0 - u).powi(3), 3.0 * u.powi(3) - 6.0 * u * u + 4.0, 3.0 * (u - u.powi(3) + u * u) + 1.0, u.powi(3)];
        let samples = [-1.0, 0.0, 1.0, 2.0].map(|offset| (phase + knot + offset).max(0.0));
        let spline: f64 = weights.iter().zip(samples).map(|(weight, sample)| weight / 6.0 * sample).sum();
        spline - t.max(0.0)
    }

    /// What the proof rests on: K ≥ 0, no more than 13/48, zero beyond the four points, its integral 1/6.
    #[test]
    fn the_kernel_is_what_the_proof_says() {
        let steps = 48;
        let mut largest = 0f64;
        for phase in (0..steps).map(|step| f64::from(step) / f64::from(steps)) {
            for t in (-4 * steps..=4 * steps).map(|step| f64::from(step) / f64::from(steps)) {
                let value = kernel(t, phase);
                // 1e-14: sums of four products of at most 6, each to 2^-53 of itself
                assert!(value > -1e-14 && value < CORNER + 1e-14, "{t} {phase}: {value}");
                assert!(t.abs() < 2.0 || value.abs() < 1e-14, "{t} {phase}: {value}");
                largest = largest.max(value);
            }
        }
        assert!((largest - CORNER).abs() < 1e-14, "{largest}");
        for u in [0.0, 0.25, 0.5, 0.9] {
            // over where the change is, seen from u: K(u − s) with the points at −s
            let fine = 4_000;
            let sum: f64 = (-3 * fine..3 * fine)
                .map(|step| (f64::from(step) + 0.5) / f64::from(fine))
                .map(|s| kernel(u - s, -s))
                .sum();
            // a midpoint sum of straight pieces: 5 bends of at most one, each 1/(8·fine²)
            assert!((sum / f64::from(fine) - 1.0 / 6.0).abs() < 1e-6, "{u}");
        }
    }

    #[test]
    fn a_parabola_is_all_acceleration_and_a_corner_is_none() {
        let smooth = bound(11, 64, 1_000, |t| 5_000.0 * t * t / 2.0);
        assert!((smooth.acceleration_per_s2 / 5_000.0 - 1.0).abs() < 1e-6, "{smooth:?}");
        // FIGURES: 3.5 µm at 2048 µs and 5 m/s²; the rows' 64 µs add 3/4·(64/2048)² = 0.07 %
        assert!((smooth.deviation / 3.495e-3 - 1.0).abs() < 2e-3, "{smooth:?}");
        let corner = bound(11, 50_000, 3, |t| (t - 0.05).max(0.0) * 200.0);
        assert_eq!((corner.acceleration_per_s2, corner.velocity_change_per_s), (0.0, 200.0));
    }

    /// Both at once: the corner is no acceleration, even though a row's step makes a large one of it.
    #[test]
    fn a_corner_in_a_parabola_is_told_apart() {
        let both = bound(11, 64, 1_001, |t| 5_000.0 * t * t / 2.0 + (t - 0.032).max(0.0) * 10.0);
        assert!((both.acceleration_per_s2 / 5_000.0 - 1.0).abs() < 1e-6, "{both:?}");
        assert!((both.velocity_change_per_s / 10.0 - 1.0).abs() < 1e-4, "{both:?}");
    }

    /// Two corners within the reach of four points add up; further apart they do not.
    #[test]
    fn corners_near_each_other_add_up() {
        let apart = |gap_us: u32| bound(11, gap_us, 6, |t| (t * US_PER_S / f64::from(gap_us)).clamp(1.0, 2.0));
        let (near, far) = (apart(3_000), apart(6_200));
        assert!((near.velocity_change_per_s / (1.0 / 3e-3) - 2.0).abs() < 0.01, "{near:?}");
        assert!((far.velocity_change_per_s / (1.0 / 6.2e-3) - 1.0).abs() < 0.01, "{far:?}");
    }

    #[test]
    fn a_line_has_none() {
        let line = bound(14, 100, 1_000, |t| 3.0 * t);
        // changes of velocity of 1e-10 are what a sixteenth digit of the positions makes
        assert!(line.deviation < 1e-9, "{line:?}");
    }
}

//! The stop along the path: exact ends, no step back, and what it adds to a path is within its reserve.
#![expect(clippy::cast_precision_loss, reason = "the truth is kept in floating point where it is not in wide integers")]

use crate::truth::{Line, Truth, points_of};
use fixed_math::limits::{Curve, Knot, Limits, LimitsError};
use fixed_math::spline::IntervalLog2;
use fixed_math::time::Span;
use fixed_math::warp::{RATE_ONE, WARP_LOG2_MAX, WARP_LOG2_MIN, Warp, WarpTooShort};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

fn all() -> impl Iterator<Item = Warp> {
    (WARP_LOG2_MIN..=WARP_LOG2_MAX).map(|log2| Warp::new(log2).unwrap())
}

fn stopped(warp: Warp, since: u64) -> u64 {
    warp.stopped(Span::from_steps(since)).steps()
}

fn resumed(warp: Warp, since: u64) -> u64 {
    warp.resumed(Span::from_steps(since)).steps()
}

/// Whether `steps` is within one step of x − 2x³/3T² for x ≤ T/2, or of T/2 − 2(T − x)³/3T² beyond: in integers, times 3T².
fn is_close(duration: u64, since: u64, steps: u64) -> bool {
    let (t, x, steps) = (i128::from(duration), i128::from(since), i128::from(steps));
    let whole = 3 * t * t;
    let exact = if 2 * x <= t { x * whole - 2 * x.pow(3) } else { t / 2 * whole - 2 * (t - x).pow(3) };
    (steps * whole - exact).abs() < whole
}

/// Every step of the shortest stop.
#[test]
fn the_shortest_stop_step_by_step() {
    let warp = Warp::new(WARP_LOG2_MIN).unwrap();
    let duration = warp.duration().steps();
    assert_eq!(duration, 3 << 16);
    for since in 0..duration {
        let (here, next) = (stopped(warp, since), stopped(warp, since + 1));
        assert!(here <= next && next <= here + 1, "{since}: {here}, {next}");
        assert!(is_close(duration, since, here), "{since}: {here}");
        assert_eq!(resumed(warp, since), warp.used().steps() - stopped(warp, duration - since), "the mirror");
        let rate = warp.stop_rate(Span::from_steps(since));
        assert!(rate <= RATE_ONE && warp.stop_rate(Span::from_steps(since + 1)) <= rate);
        assert_eq!(warp.resume_rate(Span::from_steps(duration - since)), rate);
    }
}

/// What all nodes agree on without a word: a stop uses up half of its duration, a resume as much less than what passes.
#[test]
fn ends_are_exact() {
    for warp in all() {
        let (duration, used) = (warp.duration().steps(), warp.used().steps());
        assert_eq!(duration, 3 << (warp.log2() + 8));
        assert_eq!(used * 2, duration);
        assert_eq!((stopped(warp, 0), resumed(warp, 0)), (0, 0));
        assert_eq!((stopped(warp, duration), resumed(warp, duration)), (used, used));
        assert_eq!((stopped(warp, u64::MAX), resumed(warp, duration + 77)), (used, used + 77));
        // where the two halves meet
        assert_eq!(stopped(warp, used), used - duration / 12);
        let rate = |since| warp.stop_rate(Span::from_steps(since));
        assert_eq!((rate(0), rate(used), rate(duration)), (RATE_ONE, RATE_ONE / 2, 0));
    }
    assert!(Warp::new(WARP_LOG2_MIN - 1).is_none() && Warp::new(WARP_LOG2_MAX + 1).is_none());
}

fn flat(value: i32) -> Line {
    Line { at_rest: value, at_full: value, knee: 0, full: 1 }
}

/// Worked by hand: V = 600 a 2^10 µs and a stop of 3·2^12 µs, so T = 12 intervals: 2V/T = 100, 3.27·A/T = 27.25 with A = 100, 4V/T² = 16.7.
#[test]
fn a_hand_worked_reserve() {
    let (warp, interval) = (Warp::new(12).unwrap(), IntervalLog2::new(10).unwrap());
    let reserve = warp.reserve(interval, 600, 100);
    assert_eq!((reserve.acceleration, reserve.jerk), (100, 28 + 17));
}

#[test]
fn a_stop_that_is_too_short_names_the_least() {
    let interval = IntervalLog2::new(10).unwrap();
    let limits = Limits::new((0, 1_000_000), 600, Curve::flat(100), Curve::flat(60)).unwrap();
    let WarpTooShort { error, least_log2 } = Warp::new(10).unwrap().limits_within(&limits, interval).unwrap_err();
    assert!(matches!(error, LimitsError::OutOfRange { .. }), "{error:?}");
    let least = least_log2.unwrap();
    assert_eq!(least, 13, "at 12 nothing is left of the acceleration");
    assert!(Warp::new(least).unwrap().limits_within(&limits, interval).is_ok());
    assert!((WARP_LOG2_MIN..least).all(|log2| Warp::new(log2).unwrap().limits_within(&limits, interval).is_err()));
}

/// A spline at a time in intervals: velocity, acceleration and jerk.
fn derivatives(points: &[i32], at: f64) -> (f64, f64, f64) {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within the points")]
    let index = (at as usize).min(points.len() - 4);
    let [p0, p1, p2, p3] = [0, 1, 2, 3].map(|offset| f64::from(points[index + offset]));
    let u = at - index as f64;
    let jerk = p3 - 3.0 * p2 + 3.0 * p1 - p0;
    let bend = p0 - 2.0 * p1 + p2;
    ((p2 - p0) / 2.0 + bend * u + jerk * u * u / 2.0, bend + jerk * u, jerk)
}

/// p(τ(t)) on paths along the limits less the reserve: velocity, acceleration and jerk over real time stay within the limits themselves.
#[test]
fn stops_and_resumes_keep_the_limits() {
    let mut rng = Pcg64::seed_from_u64(17);
    let mut nearest: f64 = 0.0;
    for case in 0..400 {
        let interval = IntervalLog2::new(rng.random_range(8..=14)).unwrap();
        let velocity = rng.random_range(1_000..1 << 22);
        let acceleration = (velocity / rng.random_range(2..100)).max(10);
        let jerk = (acceleration / rng.random_range(1..30)).max(5);
        let truth = Truth { min: -1 << 30, max: 1 << 30, velocity, acceleration: flat(acceleration), jerk: flat(jerk) };
        let Ok(limits) = truth.limits() else { continue };
        let Some(warp) = all().find(|warp| warp.limits_within(&limits, interval).is_ok()) else { continue };
        let within = warp.limits_within(&limits, interval).unwrap();
        let duration = warp.duration().steps() as f64 / f64::from(interval.steps());
        let mut knot = Knot::resting(0);
        let mut points = points_of(knot).to_vec();
        let mut push = 1;
        for _ in 0..600 {
            if rng.random_bool(0.05) {
                push = rng.random_range(-1..=1);
            }
            let bend = (knot.acceleration + push * within.jerk().at_full())
                .clamp(-within.acceleration().at_full(), within.acceleration().at_full());
            let next = within.check(knot, knot.position.saturating_add(knot.velocity + bend));
            knot = next.unwrap_or_else(|_| {
                push = rng.random_range(-1..=1);
                within.brake().next(knot)
            });
            points.push(knot.position);
        }
        let start = rng.random_range(0.0..300.0);
        for sample in 0..=2_000 {
            let s = f64::from(sample) / 2_000.0;
            let (rate, first, second) = if s <= 0.5 {
                (1.0 - 2.0 * s * s, -4.0 * s / duration, -4.0 / (duration * duration))
            } else {
                (2.0 * (1.0 - s) * (1.0 - s), -4.0 * (1.0 - s) / duration, 4.0 / (duration * duration))
            };
            let passed = if s <= 0.5 { s - 2.0 / 3.0 * s.powi(3) } else { 0.5 - 2.0 / 3.0 * (1.0 - s).powi(3) };
            // a resume is the same backwards: rates of rates change their sign, and their sums with either sign are looked at
            for sign in [-1.0, 1.0] {
                let (v, a, j) = derivatives(&points, (start + passed * duration).min(599.0));
                let total_a = a * rate * rate + sign * v * first;
                let total_j = j * rate.powi(3) + sign * 3.0 * a * rate * first + v * second;
                assert!((v * rate).abs() <= f64::from(velocity) + 1e-6, "case {case}");
                assert!(
                    total_a.abs() <= f64::from(acceleration) + 1e-6,
                    "case {case}, s {s}: {total_a} of {acceleration}"
                );
                assert!(total_j.abs() <= f64::from(jerk) + 1e-6, "case {case}, s {s}: {total_j} of {jerk}");
                nearest = nearest.max(total_a.abs() / f64::from(acceleration));
            }
        }
    }
    println!("nearest to an acceleration limit: {nearest:.3}");
    assert!(nearest > 0.8, "the walk does not come near its limits: {nearest}");
}

proptest! {
    /// Any stop at any instant: within a step of the curve, in order, and a resume from there is its mirror.
    #[test]
    fn any_instant_of_any_stop(log2 in WARP_LOG2_MIN..=WARP_LOG2_MAX, at in 0..1u64 << 32, later in 0..1u64 << 24) {
        let warp = Warp::new(log2).unwrap();
        let duration = warp.duration().steps();
        let at = at % duration;
        let here = stopped(warp, at);
        prop_assert!(is_close(duration, at, here));
        prop_assert!(stopped(warp, at + 1) - here <= 1);
        prop_assert!(stopped(warp, at + later) >= here && stopped(warp, at + later) - here <= later);
        prop_assert_eq!(resumed(warp, duration - at), warp.used().steps() - here);
    }
}

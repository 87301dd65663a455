//! Points that limits accept, and the stop after any of them, keep the limits: exhaustively at small widths, by random walks at large.

use crate::truth::{Line, Truth, points_of};
use fixed_math::limits::{Curve, Knot, LimitKind, Limits, LimitsError, STOP_INTERVALS_MAX, Violation};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use std::collections::BTreeSet;

fn flat(value: i32) -> Line {
    Line { at_rest: value, at_full: value, knee: 0, full: 1 }
}

fn falling(at_rest: i32, at_full: i32, knee: i32, full: i32) -> Line {
    Line { at_rest, at_full, knee, full }
}

/// The points that a stop from `knot` makes, with the three before.
fn stop(limits: &Limits, mut knot: Knot) -> Vec<i32> {
    let mut points = points_of(knot).to_vec();
    for _ in 0..=limits.stop_intervals() + 1 {
        knot = limits.brake().next(knot);
        points.push(knot.position);
    }
    assert!(knot.is_at_rest(), "no rest after {} intervals: {knot:?}", limits.stop_intervals());
    points
}

/// Every state that can be reached from rest by accepted points, and every next point.
fn explore(truth: &Truth) -> usize {
    let limits = truth.limits().unwrap();
    let key = |knot: Knot| (knot.position, knot.velocity, knot.acceleration);
    let mut seen = BTreeSet::new();
    let mut open: Vec<Knot> = (truth.min..=truth.max).map(Knot::resting).collect();
    while let Some(knot) = open.pop() {
        if !seen.insert(key(knot)) {
            continue;
        }
        truth
            .keeps_all(&stop(&limits, knot))
            .unwrap_or_else(|broken| panic!("stop from {knot:?} of {truth:?}: {broken}"));
        for position in truth.min - 2..=truth.max + 2 {
            let Ok(next) = limits.check(knot, position) else { continue };
            let [p0, p1, p2] = points_of(knot);
            truth
                .keeps([p0, p1, p2, position])
                .unwrap_or_else(|broken| panic!("after {knot:?} of {truth:?}: {broken}"));
            open.push(next);
        }
    }
    seen.len()
}

#[test]
fn all_that_small_limits_accept_keeps_them() {
    let cases = [
        Truth { min: -20, max: 20, velocity: 9, acceleration: flat(4), jerk: flat(2) },
        Truth { min: 0, max: 45, velocity: 12, acceleration: falling(6, 2, 3, 12), jerk: flat(2) },
        Truth { min: -30, max: 10, velocity: 10, acceleration: falling(7, 3, 0, 10), jerk: falling(5, 1, 4, 10) },
        Truth { min: 0, max: 60, velocity: 15, acceleration: flat(3), jerk: flat(1) },
        Truth { min: -8, max: 8, velocity: 16, acceleration: flat(20), jerk: flat(40) },
        Truth { min: 3, max: 3, velocity: 5, acceleration: flat(2), jerk: flat(1) },
    ];
    for truth in cases {
        let states = explore(&truth);
        println!("{states} states of {truth:?}");
        // a range of one position has one
        assert!(states > 100 || truth.min == truth.max, "{states} states of {truth:?}");
    }
}

/// Limits of all sizes.
fn random_truth(rng: &mut Pcg64) -> Option<Truth> {
    let velocity: i32 = 1 << rng.random_range(4..=25);
    let velocity = rng.random_range(velocity / 2..=velocity);
    let steps = rng.random_range(1..=200);
    let at_full: i32 = (velocity / steps).max(1);
    let at_rest = at_full.saturating_add(rng.random_range(0..=at_full));
    let jerk = (at_full / rng.random_range(1..=50)).max(1);
    let jerk_at_rest = jerk + rng.random_range(0..=2 * jerk);
    let knee = rng.random_range(0..velocity);
    let travel = i64::from(velocity) * rng.random_range(1..=600);
    let max = i32::try_from(travel.min(i64::from(i32::MAX))).ok()?;
    let min = if rng.random_bool(0.5) { -max } else { 0 };
    let truth = Truth {
        min,
        max,
        velocity,
        acceleration: falling(at_rest, at_full, knee, velocity),
        jerk: falling(jerk_at_rest, jerk, rng.random_range(0..velocity), velocity),
    };
    truth.limits().is_ok().then_some(truth)
}

/// The next point of a walk that stays near limits: full jerk most of the time, one LSB beside it often.
fn wanted(rng: &mut Pcg64, limits: &Limits, knot: Knot, push: i32) -> i32 {
    let speed = knot.velocity.unsigned_abs();
    let jerk = limits.jerk().at(speed);
    let bend = limits.acceleration().at(speed);
    let change = match rng.random_range(0..8) {
        0 => rng.random_range(-jerk..=jerk),
        1 => 0,
        2 => push * (jerk - 1),
        3 => push * (jerk + 1),
        _ => push * jerk,
    };
    let acceleration = knot.acceleration.saturating_add(change).clamp(-bend, bend);
    let velocity = knot.velocity.saturating_add(acceleration);
    let velocity = if rng.random_bool(0.5) { velocity.clamp(-limits.velocity(), limits.velocity()) } else { velocity };
    knot.position.saturating_add(velocity)
}

#[test]
fn random_walks_along_the_limits_and_stops_at_any_moment_keep_them() {
    let mut rng = Pcg64::seed_from_u64(5);
    let (mut accepted, mut refused, mut of_stop) = (0, 0, 0);
    for case in 0..300 {
        let Some(truth) = random_truth(&mut rng) else { continue };
        let limits = truth.limits().unwrap();
        let (low, high) = (truth.min, truth.max);
        let mut knot = Knot::resting(rng.random_range(low..=high));
        let mut points = points_of(knot).to_vec();
        let mut push = 1;
        for _ in 0..400 {
            if rng.random_bool(0.03) {
                push = rng.random_range(-1..=1);
            }
            let position = wanted(&mut rng, &limits, knot, push);
            match limits.check(knot, position) {
                Ok(next) => (knot, accepted) = (next, accepted + 1),
                Err(violation) => {
                    of_stop += usize::from(violation.is_of_stop);
                    refused += 1;
                    push = rng.random_range(-1..=1);
                    knot = limits.brake().next(knot);
                }
            }
            points.push(knot.position);
            if rng.random_bool(0.05) {
                truth
                    .keeps_all(&stop(&limits, knot))
                    .unwrap_or_else(|broken| panic!("case {case}, {truth:?}, stop from {knot:?}: {broken}"));
            }
        }
        truth.keeps_all(&points).unwrap_or_else(|broken| panic!("case {case}, {truth:?}: {broken}"));
    }
    println!("{accepted} accepted, {refused} refused, {of_stop} of them for the stop that would follow");
    assert!(accepted > 10_000 && refused > 1_000 && of_stop > 1_000, "{accepted}, {refused}, {of_stop}");
}

/// A limit's own operands, one by one.
#[test]
fn each_limit_is_named_with_its_operands() {
    let limits = Limits::new((-1_000, 1_000), 100, Curve::flat(20), Curve::flat(8)).unwrap();
    let violation = |limit, is_of_stop, value, bound| Err(Violation { limit, is_of_stop, value, bound });
    let rest = Knot::resting(0);
    assert_eq!(limits.check(Knot::resting(1_000), 1_001), violation(LimitKind::PositionMax, false, 1_001, 1_000));
    assert_eq!(limits.check(Knot::resting(-1_000), -1_001), violation(LimitKind::PositionMin, false, -1_001, -1_000));
    assert_eq!(limits.check(rest, 101), violation(LimitKind::Velocity, false, 101, 100));
    assert_eq!(limits.check(rest, -21), violation(LimitKind::Acceleration, false, -21, 20));
    assert_eq!(limits.check(rest, 9), violation(LimitKind::Jerk, false, 9, 8));
    assert!(limits.check(rest, 8).is_ok());
    // at 96 an acceleration of 8 cannot be let go of below 100
    let fast = Knot { position: 0, velocity: 96, acceleration: 0 };
    assert_eq!(limits.check(fast, 100), Ok(Knot { position: 100, velocity: 100, acceleration: 4 }));
    let faster = Knot { position: 0, velocity: 80, acceleration: 12 };
    assert_eq!(limits.check(faster, 96), violation(LimitKind::Velocity, true, 104, 100));
    // one LSB short of the limit and moving
    let violation = limits.check(Knot { position: 985, velocity: 10, acceleration: 0 }, 997).unwrap_err();
    assert_eq!((violation.limit, violation.is_of_stop), (LimitKind::PositionMax, true));
    // differences that do not fit 32 bits
    let whole = Limits::new((i32::MIN, i32::MAX), 1 << 25, Curve::flat(1 << 20), Curve::flat(1 << 16)).unwrap();
    let far = whole.check(Knot::resting(i32::MIN), i32::MAX).unwrap_err();
    assert_eq!((far.limit, far.value), (LimitKind::Velocity, i32::MAX), "saturates to its own side");
    let far = whole.check(Knot::resting(i32::MAX), i32::MIN).unwrap_err();
    assert_eq!((far.limit, far.value), (LimitKind::Velocity, i32::MIN));
}

#[test]
fn limits_that_cannot_be_kept_are_refused() {
    let new = |range, velocity, acceleration, jerk| {
        Limits::new(range, velocity, Curve::flat(acceleration), Curve::flat(jerk))
    };
    assert_eq!(new((1, 0), 1, 1, 1), Err(LimitsError::PositionsCrossed { min: 1, max: 0 }));
    for (velocity, acceleration, jerk, limit) in [
        (0, 1, 1, LimitKind::Velocity),
        ((1 << 25) + 1, 1 << 20, 1 << 20, LimitKind::Velocity),
        (10, 0, 1, LimitKind::Acceleration),
        (10, (1 << 26) + 1, 1, LimitKind::Acceleration),
        (10, 1, 0, LimitKind::Jerk),
        (10, 1, (1 << 27) + 1, LimitKind::Jerk),
    ] {
        let refused = new((0, 1), velocity, acceleration, jerk);
        assert!(matches!(refused, Err(LimitsError::OutOfRange { limit: named, .. }) if named == limit), "{refused:?}");
    }
    let long = new((0, 1), 100_000, 100, 100);
    assert!(matches!(long, Err(LimitsError::StopTooLong { most: STOP_INTERVALS_MAX, .. })), "{long:?}");
    assert!(Curve::falling(2, 3, 0, 10).is_none() && Curve::falling(3, 2, 10, 10).is_none());
    assert!(Curve::falling(3, 2, -1, 10).is_none() && Curve::falling(3, 0, 1, 10).is_none());
}

proptest! {
    /// The curve never allows more than its line, falls, and is less than two below it.
    #[test]
    fn curves_are_rounded_down(at_full in 1..1_i32 << 25, more in 0..1_i32 << 25, knee in 0..1_i32 << 25, run in 1..1_i32 << 20, speeds: [u32; 8]) {
        let (at_rest, full) = (at_full.saturating_add(more), knee + run);
        let curve = Curve::falling(at_rest, at_full, knee, full).unwrap();
        let line = falling(at_rest, at_full, knee, full);
        let mut speeds = speeds.map(|speed| speed % (2 * full.unsigned_abs()));
        speeds.sort_unstable();
        for speed in speeds {
            let value = curve.at(speed);
            prop_assert!((at_full..=at_rest).contains(&value));
            prop_assert!(line.allows(value.into(), speed.into(), 1));
            // a slope of 2^16 and more is cut
            let is_steep = i64::from(more) >= i64::from(run) << 15;
            let rounding = 2 + i128::from(speed >> 15);
            prop_assert!(is_steep || value == at_rest || !line.allows(i128::from(value) + rounding, speed.into(), 1));
        }
        prop_assert!(speeds.is_sorted_by(|a, b| curve.at(*a) >= curve.at(*b)));
    }

    /// Whatever comes, it is accepted or refused.
    #[test]
    fn nothing_panics(position: i32, velocity: i32, acceleration: i32, next: i32) {
        let limits = Limits::new((i32::MIN, i32::MAX), 1 << 25, Curve::flat(1 << 22), Curve::flat(1 << 20)).unwrap();
        let _either = limits.check(Knot { position, velocity, acceleration }, next);
    }
}

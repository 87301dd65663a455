//! From anywhere the brake comes to rest, and never asks for more than it may.

use fixed_math::brake::Brake;
use fixed_math::limits::Knot;
use proptest::prelude::*;

/// Brakes to rest; the number of steps. Every step is looked at.
fn brake_to_rest(brake: Brake, start: Knot, most: u32) -> u32 {
    let (jerk, cap) = (i64::from(brake.jerk()), i64::from(brake.acceleration()));
    let mut knot = start;
    for step in 0..most {
        if knot.is_at_rest() {
            assert_eq!(brake.next(knot), knot, "rest is kept");
            return step;
        }
        let next = brake.next(knot);
        let (now, then) = (i64::from(knot.acceleration), i64::from(next.acceleration));
        assert_eq!(i64::from(next.velocity), i64::from(knot.velocity) + then);
        assert_eq!(next.position, knot.position.saturating_add(next.velocity));
        assert!((then - now).abs() <= jerk, "{brake:?} from {start:?}: {knot:?} to {next:?}");
        assert!(then.abs() <= cap.max(now.abs()), "{brake:?} from {start:?}: {knot:?} to {next:?}");
        // it never builds up acceleration with the movement
        let with = i64::from(knot.velocity).signum();
        assert!(with * then <= (with * now).max(0), "{brake:?} from {start:?}: {knot:?} to {next:?}");
        knot = next;
    }
    panic!("{brake:?} from {start:?} is at {knot:?} after {most}");
}

/// All velocities and accelerations of small brakes.
#[test]
fn every_small_state_comes_to_rest() {
    for jerk in 1..=6 {
        for cap in 1..=14 {
            let brake = Brake::new(jerk, cap);
            for velocity in -60..=60 {
                for acceleration in -20..=20 {
                    // at the least 1 an interval: 20 to let go, 60 + 19 + … + 1 = 250 at the peak, and one more
                    let steps = brake_to_rest(brake, Knot { position: 0, velocity, acceleration }, 300);
                    assert!(steps <= 271, "{brake:?} from {velocity}, {acceleration}: {steps}");
                }
            }
        }
    }
}

/// Where deceleration can be let go of in time, velocity never changes its sign.
#[test]
fn a_stop_from_no_acceleration_does_not_turn_back() {
    for (jerk, cap) in [(1, 1), (1, 7), (3, 5), (4, 40), (50, 20)] {
        let brake = Brake::new(jerk, cap);
        for velocity in 0..=2_000 {
            let mut knot = Knot { position: 0, velocity, acceleration: 0 };
            while !knot.is_at_rest() {
                knot = brake.next(knot);
                assert!((0..=velocity).contains(&knot.velocity), "{brake:?} from {velocity}: {knot:?}");
            }
        }
    }
}

/// It is as fast as the formula: v/A + A/J intervals, or 2·√(v/J) where A is not reached, and three for rounding.
#[test]
fn a_stop_takes_no_longer_than_the_formula_says() {
    for (jerk, cap, velocity) in [(40, 2_000, 400_000), (7, 100, 5_000), (1_000, 100_000, 1_000_000), (3, 900, 20_000)]
    {
        let steps = brake_to_rest(Brake::new(jerk, cap), Knot { position: 0, velocity, acceleration: 0 }, 10_000);
        let (j, a, v) = (f64::from(jerk), f64::from(cap), f64::from(velocity));
        let ideal = if v > a * a / j { v / a + a / j } else { 2.0 * (v / j).sqrt() };
        println!("J {jerk}, A {cap}, v {velocity}: {steps} intervals, {ideal:.1} by the formula");
        assert!(f64::from(steps) <= ideal + 3.0, "{steps} against {ideal}");
    }
}

proptest! {
    /// Any brake and any state within what limits allow: no step breaks jerk or builds up too much.
    #[test]
    fn any_state_comes_to_rest(
        jerk in 1..=1_i32 << 20,
        cap in 1..=1_i32 << 20,
        velocity in -(1 << 25)..=1 << 25,
        acceleration in -(1 << 22)..=1 << 22,
    ) {
        // slow brakes take long: what one jerk a step and the cap can do, twice over
        let slowest = i64::from(jerk.min(cap));
        let change = i64::from(acceleration).pow(2) / i64::from(jerk) + i64::from(velocity).abs() + 1;
        prop_assume!(change / slowest < 100_000);
        let most = u32::try_from(4 * change / slowest + 200).unwrap();
        brake_to_rest(Brake::new(jerk, cap), Knot { position: 0, velocity, acceleration }, most.max(20_000));
    }

    /// What no limits ever lead to: nothing panics.
    #[test]
    fn nothing_panics(jerk: i32, cap: i32, position: i32, velocity: i32, acceleration: i32) {
        let _any = Brake::new(jerk, cap).next(Knot { position, velocity, acceleration });
    }
}

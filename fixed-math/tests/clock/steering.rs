//! The map that is steered, and what steers it.

use fixed_math::clock::{Diffusion, Estimate, Follow, Gains, Neighbour, Oldest, Servo, SlewedMap, TimeLine, ewma};
use fixed_math::time::{LocalTicks, NetTime, Rate, Span};
use proptest::prelude::*;

/// One second.
const SECOND: i64 = 256_000_000;

fn line(at: u64, system: u64, ppb: i32) -> TimeLine {
    TimeLine { at: LocalTicks::from_steps(at), system: NetTime::from_steps(system), rate: Rate::from_ppb(ppb) }
}

/// 100 µs behind, 500 ppm at most: it takes 0.2 s, whatever the horizon says.
#[test]
fn a_slew_takes_as_long_as_its_limit_says() {
    let start = LocalTicks::from_us(1_000_000);
    for (offset_us, horizon_us, expected_us) in
        [(100i64, 1, 200_000u64), (-100, 1, 200_000), (100, 400_000, 400_000), (-3, 50_000, 50_000)]
    {
        let mut map = SlewedMap::new(TimeLine { at: start, system: NetTime::from_us(5_000_000), rate: Rate::ZERO });
        let target = TimeLine { system: NetTime::from_us(5_000_000).shifted(offset_us * 256), ..map.target() };
        map.slew_to(target, start, Span::from_us(horizon_us), Rate::from_ppb(500_000));
        assert_eq!(map.system_at(start), NetTime::from_us(5_000_000));
        assert_eq!(map.behind_steps(start), offset_us * 256);
        let half = start + Span::from_us(expected_us / 2);
        assert!((map.behind_steps(half) - offset_us * 128).abs() <= 3, "{}", map.behind_steps(half));
        // the limit is a whole number of 2^−32, and so some millionths off
        let just_before = start + Span::from_us(expected_us - expected_us / 100);
        assert_ne!(map.behind_steps(just_before), 0);
        let met = start + Span::from_us(expected_us + 2);
        assert_eq!((map.behind_steps(met), map.rate_at(met)), (0, target.rate));
        // and back from there
        assert!(map.local_at(map.system_at(half)).steps_after(half).abs() <= 1);
        assert!(map.local_at(map.system_at(met)).steps_after(met).abs() <= 1);
    }
}

/// A new target: (how far it is from the map, its rate, how long after the one before, horizon, limit).
fn turns() -> impl Strategy<Value = Vec<(i64, i32, i64, u64, i32)>> {
    let turn = (-SECOND..SECOND, -30_000_000i32..30_000_000, 0..SECOND, 0u64..1 << 30, 1_000i32..100_000_000);
    prop::collection::vec(turn, 1..8)
}

proptest! {
    /// Exactly where it was when it is told to slew, never backwards anywhere, nowhere faster than limit and rates allow, and on the
    /// target in the end.
    #[test]
    fn a_map_never_steps_and_never_turns_back(turns in turns(), looks in prop::collection::vec(0i64..1 << 20, 32)) {
        let mut now = LocalTicks::from_us(1 << 40);
        let mut map = SlewedMap::new(line(now.steps(), 1 << 60, 0));
        for (jump, ppb, wait, horizon, limit_ppb) in turns {
            now = now.shifted(wait);
            let before = map.system_at(now);
            let target = line(now.steps(), before.steps().saturating_add_signed(jump), ppb);
            let limit = Rate::from_ppb(limit_ppb);
            map.slew_to(target, now, Span::from_steps(horizon), limit);
            prop_assert_eq!(map.system_at(now), before);
            prop_assert_eq!(map.target(), target);
            let mut at = now;
            for step in looks.iter().copied().chain([1; 64]) {
                let later = at.shifted(step);
                let (from, to) = (map.system_at(at), map.system_at(later));
                prop_assert!(to >= from);
                let fastest = i64::from(target.rate.bits()) + i64::from(limit.bits());
                // both ends are rounded, and where the pieces meet two steps may be skipped
                let most = step + Rate::saturated(fastest).over(step) + 5;
                prop_assert!(to.steps_after(from) <= most, "{} {most}", to.steps_after(from));
                at = later;
            }
            // by the limit or by the horizon, whichever is later
            let needed = (i128::from(jump.abs()) << 32) / i128::from(limit.bits());
            let met = now.shifted(i64::try_from(needed.max(i128::from(horizon))).unwrap() + 512);
            prop_assert!(map.behind_steps(met) == 0, "{} left", map.behind_steps(met));
        }
    }

    /// The steps just before and after the meeting, one by one.
    #[test]
    fn the_meeting_is_seamless(
        jump in -1i64 << 20..1 << 20,
        ppb in -30_000_000i32..30_000_000,
        limit_ppb in 1_000i32..100_000_000,
        horizon in 0u64..1 << 28,
    ) {
        let now = LocalTicks::from_us(1 << 40);
        let mut map = SlewedMap::new(line(now.steps(), 1 << 60, 0));
        let target = line(now.steps(), (1u64 << 60).saturating_add_signed(jump), ppb);
        map.slew_to(target, now, Span::from_steps(horizon), Rate::from_ppb(limit_ppb));
        // from the meeting on the rate is the target's
        let (mut low, mut high) = (-1i64, 1i64 << 46);
        while high - low > 1 {
            let middle = low.midpoint(high);
            if map.rate_at(now.shifted(middle)) == target.rate { high = middle } else { low = middle }
        }
        prop_assert_eq!(map.behind_steps(now.shifted(high)), 0);
        for step in (high - 40).max(0)..high + 40 {
            let (from, to) = (map.system_at(now.shifted(step)), map.system_at(now.shifted(step + 1)));
            prop_assert!((0..=5).contains(&to.steps_after(from)), "{}", to.steps_after(from));
        }
    }
}

/// Two counters 30 ppm and 5 ms apart, offsets measured exactly every 50 ms: what is left after a minute, and at most in its last ten
/// seconds, µs.
fn converge(servo: &mut dyn Servo, gains: &Gains) -> (f64, f64) {
    let mut map = SlewedMap::new(line(0, 0, 0));
    let (mut filtered, mut worst, mut last) = (0i64, 0i64, 0i64);
    let truth = line(0, 5_000 * 256, 30_000);
    for round in 1..1_200u64 {
        let now = LocalTicks::from_us(round * 50_000);
        let offset = truth.system_at(now).steps_after(map.system_at(now));
        filtered = ewma(filtered, offset, gains.filter_q16);
        let estimate = Estimate { line: truth, ..Estimate::default() };
        // one farther from the root, which lies to those who ask it for more than its offset
        let far = Neighbour { tier: 9, offset_steps: offset, filtered_steps: 1 << 40, estimate: Estimate::default() };
        let near = Neighbour { tier: 1, offset_steps: offset, filtered_steps: filtered, estimate };
        servo.steer(now, &[far, near], gains, &mut map);
        last = offset;
        if round > 1_000 {
            worst = worst.max(offset.abs());
        }
    }
    (last as f64 / 256.0, worst as f64 / 256.0)
}

const GAINS: Gains = Gains {
    interval: Span::from_us(50_000),
    filter_q16: 1 << 14,
    proportional_q16: 1 << 13,
    integral_q16: 1 << 8,
    limit: Rate::from_ppb(1_000_000),
    adopt_steps: 1 << 40,
};

/// All three end where the other counter is. The estimator takes a quarter of what is left off in an interval, and less than four steps are
/// a quarter of none. 5 ms at 1000 ppm take 5 s; the PI controller then needs its slowest mode, about
/// proportional / integral = 32 intervals, some times over; a shim without an integral is left with 30 ppm of an interval over its gain,
/// 30e-6 · 50 ms · 8 = 12 µs.
#[test]
fn each_servo_converges() {
    let (_, follow) = converge(&mut Follow, &GAINS);
    assert!(follow < 4.0 / 256.0, "{follow}");
    let (_, diffusion) = converge(&mut Diffusion::default(), &GAINS);
    assert!(diffusion < 0.1, "{diffusion}");
    let (oldest, worst) = converge(&mut Oldest::default(), &GAINS);
    assert!((oldest - 12.0).abs() < 0.5 && worst < 12.5, "{oldest} {worst}");
}

/// A substantially older clock is adopted at once, a younger one never.
#[test]
fn the_oldest_is_adopted() {
    let gains = Gains { adopt_steps: 256_000, ..GAINS };
    let now = LocalTicks::from_us(1_000);
    for (offset_steps, adopted) in [(256_001, true), (256_000, false), (-1 << 40, false)] {
        let mut map = SlewedMap::new(line(0, 0, 0));
        let young = Neighbour { offset_steps: -1_000_000, ..Neighbour::default() };
        let other = Neighbour { offset_steps, ..Neighbour::default() };
        Oldest::default().steer(now, &[young, other], &gains, &mut map);
        assert_eq!(map.system_at(now) == NetTime::from_us(1_000).shifted(offset_steps), adopted);
        assert_eq!(map.system_at(now) == NetTime::from_us(1_000), !adopted);
    }
}

/// With nobody to follow nothing changes.
#[test]
fn nobody_is_followed_by_nothing() {
    let before = SlewedMap::new(line(5, 17, 20_000));
    for servo in [&mut Follow as &mut dyn Servo, &mut Diffusion::default(), &mut Oldest::default()] {
        let mut map = before;
        servo.steer(LocalTicks::from_us(1_000), &[], &GAINS, &mut map);
        assert_eq!(map, before);
    }
}

/// What a servo learnt is forgotten by a restart: the map then runs as its counter does.
#[test]
fn a_restart_forgets() {
    let now = LocalTicks::from_us(1_000);
    let ahead = [Neighbour { offset_steps: 10_000, filtered_steps: 10_000, ..Neighbour::default() }];
    let level = [Neighbour::default()];
    for servo in [&mut Diffusion::default() as &mut dyn Servo, &mut Oldest::default()] {
        let mut map = SlewedMap::new(line(0, 0, 0));
        servo.steer(now, &ahead, &GAINS, &mut map);
        servo.steer(now, &level, &GAINS, &mut map);
        assert!(map.rate_at(now) > Rate::ZERO);
        servo.restart();
        servo.steer(now, &level, &GAINS, &mut map);
        assert_eq!(map.rate_at(now), Rate::ZERO);
    }
}

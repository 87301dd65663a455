//! Each way in which a point is refused, with its operands and its counter.

use crate::world::{H, HISTORY, QUEUE, TestFeeder, at, config, play, point, ramp};
use fixed_math::limits::LimitKind;
use fixed_math::time::{NetTime, Span};
use fixed_math::warp::Warp;
use osap_maxl::axis::{AxisConfig, AxisRings, MISSING_MAX};
use osap_maxl::{ArmError, ConfigError, FeederState, Player, Refusal, StarvedCause};

fn armed<'a>(rings: &'a mut AxisRings<QUEUE>, config: &AxisConfig) -> (TestFeeder<'a>, Player<'a, QUEUE>) {
    let (mut feeder, player) = rings.split::<HISTORY>();
    feeder.arm(config, 0, at(10), at(5)).unwrap();
    (feeder, player)
}

#[test]
fn before_it_is_armed_nothing_is_taken() {
    let mut rings = AxisRings::<QUEUE>::new();
    let (mut feeder, _player) = rings.split::<HISTORY>();
    assert_eq!(feeder.offer(point(11, 0), at(5)), Err(Refusal::NotArmed));
    assert_eq!((feeder.counters().not_armed, feeder.state()), (1, FeederState::Unarmed));
    assert_eq!(feeder.needed_by(), None);
}

/// `[MOT-04]`: each with its operands.
#[test]
fn late_off_grid_gap_repeated_and_full() {
    let mut rings = AxisRings::<QUEUE>::new();
    let (mut feeder, _player) = armed(&mut rings, &config());
    // point 11 is needed from 9 on
    let late = Refusal::Late { needed_by: at(9), now: at(9) };
    assert_eq!(feeder.offer(point(11, 0), at(9)), Err(late));
    let beside = NetTime::from_us(11 * H + 1);
    let off_grid = Refusal::OffGrid { time: beside, interval: Span::from_us(H) };
    assert_eq!(feeder.offer(osap_maxl::Point { time: beside, position: 0 }, at(8)), Err(off_grid));
    assert_eq!(feeder.offer(point(14, 0), at(8)), Err(Refusal::Gap { missing: 3, most: 2 }));
    assert!(feeder.offer(point(11, 0), at(8)).is_ok_and(|accepted| accepted.is_fresh && accepted.free == 15));
    let repeated = Refusal::NonMonotonic { time: at(11), newest: at(11) };
    assert_eq!(feeder.offer(point(11, 0), at(8)), Err(repeated));
    // two missing, then held
    assert!(feeder.offer(point(14, 0), at(8)).is_ok_and(|accepted| accepted.is_fresh));
    let repeated = Refusal::NonMonotonic { time: at(14), newest: at(14) };
    assert_eq!(feeder.offer(point(14, 0), at(8)), Err(repeated));
    assert!(feeder.offer(point(12, 0), at(8)).is_ok_and(|accepted| !accepted.is_fresh), "what was missing still fits");
    assert!(feeder.offer(point(13, 0), at(8)).is_ok());
    for index in 15..=26 {
        assert!(feeder.offer(point(index, 0), at(8)).is_ok(), "{index}");
    }
    assert_eq!(feeder.offer(point(27, 0), at(8)), Err(Refusal::Full { needed: 17, room: 16 }));
    let counters = feeder.counters();
    assert_eq!((counters.accepted, counters.late, counters.off_grid), (16, 1, 1));
    assert_eq!((counters.gap, counters.non_monotonic, counters.full), (1, 2, 1));
}

/// A limit latches: it names the point, the limit, the value and the bound, and nothing more is taken until it is cleared at rest.
#[test]
fn a_limit_latches_until_it_is_cleared_at_rest() {
    let mut rings = AxisRings::<QUEUE>::new();
    let (mut feeder, mut player) = armed(&mut rings, &config());
    feeder.offer(point(11, 10), at(8)).unwrap();
    let refused = feeder.offer(point(12, 50), at(8)).unwrap_err();
    let Refusal::Limit(fault) = refused else { panic!("{refused:?}") };
    assert_eq!((fault.point_time, fault.limit, fault.is_of_stop), (at(12), LimitKind::Jerk, false));
    // an acceleration of 30 after 10; of 20 less 3.27·100/384 and 4·1000/384², each rounded up
    assert_eq!((fault.value, fault.bound), (20, 18));
    assert_eq!(feeder.fault(), Some(fault));
    assert_eq!(feeder.offer(point(12, 20), at(8)), Err(Refusal::Latched(fault)));
    assert!(!feeder.clear_fault(), "it still moves");
    play(&mut player, at(8), at(40));
    feeder.run(at(40));
    assert_eq!(feeder.state(), FeederState::Resting { cause: StarvedCause::NoPoint });
    assert_eq!(
        feeder.arm(&config(), 0, at(60), at(40)).unwrap_err(),
        ArmError::Elsewhere { position: 0, rests_at: player.points().0[3] }
    );
    assert_eq!(feeder.arm(&config(), player.points().0[3], at(60), at(40)), Err(ArmError::Latched(fault)));
    assert!(feeder.clear_fault());
    assert_eq!(feeder.arm(&config(), player.points().0[3], at(60), at(40)), Ok(()));
    assert_eq!((feeder.counters().limit, feeder.counters().latched, feeder.counters().starved), (1, 1, 1));
}

/// `[MOT-08]`, `[MOT-09]`.
#[test]
fn configurations_that_cannot_be_are_refused() {
    let mut rings = AxisRings::<QUEUE>::new();
    let (mut feeder, _player) = rings.split::<HISTORY>();
    let mut arm = |config: &AxisConfig, start, now| feeder.arm(config, 0, start, now).unwrap_err();
    let many = AxisConfig { missing_max: MISSING_MAX + 1, ..config() };
    let error = ConfigError::MissingMax { value: MISSING_MAX + 1, most: MISSING_MAX };
    assert_eq!(arm(&many, at(10), at(0)), ArmError::Config(error));
    let early = AxisConfig { lead: Span::from_us(13 * H), ..config() };
    let error = ConfigError::Lead { value: Span::from_us(13 * H), most: Span::from_us(12 * H) };
    assert_eq!(arm(&early, at(10), at(0)), ArmError::Config(error), "more than the queue holds");
    let hasty = AxisConfig { warp: Warp::new(10).unwrap(), ..config() };
    let ArmError::Config(ConfigError::Warp(error)) = arm(&hasty, at(10), at(0)) else { panic!("too short a stop") };
    // 2V/T is 2,000·2^10/(3·2^n): 42 of 100 at n = 14
    assert_eq!(error.least_log2, Some(14));
    let start = NetTime::from_us(10 * H + 1);
    assert_eq!(arm(&config(), start, at(0)), ArmError::OffGrid { start, interval: Span::from_us(H) });
    assert_eq!(arm(&config(), at(10), at(9)), ArmError::Late { needed_by: at(9), now: at(9) });
    assert!(matches!(feeder.arm(&config(), 1_000_001, at(10), at(0)), Err(ArmError::Limit(_))));
    assert_eq!(feeder.arm(&config(), 5, at(10), at(0)), Ok(()));
    assert_eq!(feeder.arm(&config(), 5, at(10), at(0)), Err(ArmError::Moving));
}

/// `[MOT-05]`: a missing point between others comes out as (−P₋₂ + 4P₋₁ + 4P₊₁ − P₊₂)/6, and one at the end as 3P₋₁ − 3P₋₂ + P₋₃; both are counted.
#[test]
fn missing_points_are_rebuilt_in_time() {
    let mut rings = AxisRings::<QUEUE>::new();
    let (mut feeder, mut player) = armed(&mut rings, &config());
    for index in 1..=3 {
        feeder.offer(point(10 + index, ramp(index)), at(5)).unwrap();
    }
    // point 14 is missing; of points 11, 13, 15 and 16 it is (−30 + 4·60 + 4·150 − 210)/6 = 100, as it was
    feeder.offer(point(15, ramp(5)), at(5)).unwrap();
    feeder.offer(point(16, ramp(6)), at(5)).unwrap();
    assert_eq!(feeder.needed_by(), Some(at(12)));
    feeder.run(at(11));
    assert_eq!(feeder.counters().rebuilt, 0, "it may still come");
    feeder.run(at(12));
    assert_eq!(feeder.counters().rebuilt, 1);
    assert_eq!(feeder.offer(point(14, 0), at(12)), Err(Refusal::Late { needed_by: at(12), now: at(12) }));
    play(&mut player, at(8), at(15));
    assert_eq!(player.points().0, [60, 100, 150, 210]);
    // none behind: 3·210 − 3·150 + 100 = 280, then 360, and no third
    feeder.run(at(15));
    assert_eq!((feeder.counters().rebuilt, feeder.needed_by()), (2, Some(at(16))));
    play(&mut player, at(15), at(16));
    assert_eq!(player.points().0, [100, 150, 210, 280]);
    feeder.run(at(16));
    feeder.run(at(17));
    assert_eq!(feeder.counters().rebuilt, 3, "at most two in a row");
}

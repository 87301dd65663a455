//! What a player does with points and without.

use crate::world::{H, HISTORY, QUEUE, at, config, play, point, ramp};
use fixed_math::time::{NetTime, Span};
use osap_maxl::axis::{AxisConfig, AxisRings};
use osap_maxl::{FeederState, PlayerState, Refusal, StarvedCause, StarvedPolicy};

/// A straight line is played as it is, and told as velocity in 2^−4 LSB an interval.
#[test]
fn points_are_played_at_their_times() {
    let mut rings = AxisRings::<QUEUE>::new();
    let (mut feeder, mut player) = rings.split::<HISTORY>();
    assert_eq!(player.beat(at(1)).state, PlayerState::Idle);
    feeder.arm(&config(), -500, at(10), at(1)).unwrap();
    for index in 1..=12 {
        feeder.offer(point(10 + index, -500 + ramp(index)), at(1)).unwrap();
    }
    let output = play(&mut player, at(1), at(9));
    assert_eq!((output.position, output.velocity, output.state), (-500, 0, PlayerState::Following));
    // in the middle of constant acceleration the spline is the parabola, a sixth of the second difference above it
    let output = player.beat(at(9));
    assert_eq!(output.position, -500);
    let output = play(&mut player, at(9), at(20));
    let output = if output.state == PlayerState::Following { player.beat(at(20)) } else { output };
    assert!((output.position - (-500 + ramp(10) + 1)).abs() <= 1, "{output:?}");
    assert!((output.velocity - 16 * 105).abs() <= 6 && (output.acceleration - 160).abs() <= 1, "{output:?}");
    let told = feeder.position_at(at(15)).unwrap();
    assert!((told.position - (-500 + ramp(5) + 1)).abs() <= 1, "{told:?}");
    assert_eq!(told.jerk, 0);
}

/// `[MOT-07]`: every policy ends at rest, says so, and takes no more points until it is armed again.
#[test]
fn without_points_every_policy_comes_to_rest() {
    for (policy, state) in [
        (StarvedPolicy::Stop, PlayerState::Resting),
        (StarvedPolicy::Hold, PlayerState::Holding),
        (StarvedPolicy::Relax, PlayerState::Released),
    ] {
        let mut rings = AxisRings::<QUEUE>::new();
        let (mut feeder, mut player) = rings.split::<HISTORY>();
        feeder.arm(&AxisConfig { policy, ..config() }, 0, at(10), at(1)).unwrap();
        for index in 1..=8 {
            feeder.offer(point(10 + index, ramp(index)), at(1)).unwrap();
        }
        let output = play(&mut player, at(1), at(18));
        assert_eq!(output.state, PlayerState::Stopping);
        feeder.run(at(18));
        assert_eq!(feeder.state(), FeederState::Stopping { cause: StarvedCause::NoPoint });
        let refusal = Refusal::Starved { cause: StarvedCause::NoPoint };
        assert_eq!(feeder.offer(point(19, ramp(9)), at(17)), Err(refusal));
        // 80 an interval at 10 an interval²: v/A + A/J is far below 20 intervals
        let output = play(&mut player, at(18), at(40));
        assert_eq!((output.state, output.velocity, output.acceleration), (state, 0, 0));
        feeder.run(at(40));
        assert_eq!(feeder.state(), FeederState::Resting { cause: StarvedCause::NoPoint });
        let rests_at = feeder.position_at(at(39)).unwrap();
        assert_eq!((rests_at.position, rests_at.velocity), (output.position, 0));
        assert_eq!(feeder.position_at(at(5_000)).unwrap().position, output.position, "from then on");
        feeder.arm(&config(), output.position, at(60), at(40)).unwrap();
        assert_eq!(player.beat(at(41)).state, PlayerState::Following);
    }
}

/// `[MOT-10]`: what the feeder computes of a stop is what the player did.
#[test]
fn the_feeder_knows_where_the_axis_braked() {
    let mut rings = AxisRings::<QUEUE>::new();
    let (mut feeder, mut player) = rings.split::<HISTORY>();
    feeder.arm(&config(), 0, at(10), at(1)).unwrap();
    for index in 1..=12 {
        feeder.offer(point(10 + index, ramp(index)), at(1)).unwrap();
    }
    let mut now = at(1);
    while now < at(45) {
        let output = player.beat(now);
        feeder.run(now);
        if let Some(told) = feeder.position_at(now) {
            let output = (output.position, output.velocity, output.acceleration);
            assert_eq!((told.position, told.velocity, told.acceleration), output, "at {} us", now.as_us());
        } else {
            panic!("nothing known of {} us", now.as_us());
        }
        now = now + Span::from_us(64);
    }
    assert_eq!(feeder.state(), FeederState::Resting { cause: StarvedCause::NoPoint });
}

/// A stall of a few intervals is made up for; a leap is not followed: the axis brakes from where it was.
#[test]
fn stalls_are_made_up_for_and_leaps_are_not_followed() {
    for (stall, follows) in [(4, true), (8, true), (9, false), (1_000_000, false)] {
        let mut rings = AxisRings::<QUEUE>::new();
        let (mut feeder, mut player) = rings.split::<HISTORY>();
        feeder.arm(&config(), 0, at(10), at(1)).unwrap();
        for index in 1..=14 {
            feeder.offer(point(10 + index, ramp(index)), at(1)).unwrap();
        }
        play(&mut player, at(1), at(12));
        let before = player.beat(at(12));
        let after = player.beat(at(12 + stall));
        if follows {
            let expected = ramp(2 + stall) + 1;
            assert_eq!(after.state, PlayerState::Following);
            assert!((after.position - expected).abs() <= 1, "{after:?} where {expected}");
        } else {
            assert_eq!((after.state, after.position), (PlayerState::Stopping, before.position));
            let rest = play(&mut player, at(12 + stall), at(12 + stall + 30));
            assert_eq!(rest.state, PlayerState::Resting);
            feeder.run(at(12 + stall + 30));
            assert_eq!(feeder.state(), FeederState::Resting { cause: StarvedCause::Leapt });
            assert_eq!(feeder.position_at(at(12)), None, "its points were not where their times say");
        }
    }
}

/// A series that is given up ends in a stop, and what is left of its points is never played.
#[test]
fn what_is_given_up_stops_and_is_forgotten() {
    let mut rings = AxisRings::<QUEUE>::new();
    let (mut feeder, mut player) = rings.split::<HISTORY>();
    feeder.arm(&config(), 0, at(10), at(1)).unwrap();
    for index in 1..=14 {
        feeder.offer(point(10 + index, ramp(index)), at(1)).unwrap();
    }
    play(&mut player, at(1), at(13));
    assert!(feeder.abandon());
    let rest = play(&mut player, at(13), at(30));
    assert_eq!(rest.state, PlayerState::Resting);
    feeder.run(at(30));
    assert_eq!(feeder.state(), FeederState::Resting { cause: StarvedCause::Abandoned });
    assert!(rest.position < ramp(14), "{rest:?}");
    assert!(feeder.disarm());
    assert_eq!(player.beat(at(31)).state, PlayerState::Idle);
    feeder.arm(&config(), -7, at(40), at(31)).unwrap();
    let output = player.beat(at(32));
    assert_eq!((output.position, output.origin), (-7, 2), "another origin");
    for index in 1..=4 {
        feeder.offer(point(40 + index, -7 + ramp(index)), at(32)).unwrap();
    }
    let output = play(&mut player, at(32), at(40));
    assert_eq!(output.state, PlayerState::Following);
    assert_eq!(player.points().0, [-7, -7, -7, 3]);
    assert_eq!(player.points().1, NetTime::from_us(39 * H));
}

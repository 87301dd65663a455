//! Stops and resumes of a node's track time: in order, late, repeated, and one during the other.

use fixed_math::time::NetTime;
use fixed_math::warp::{RATE_ONE, Warp};
use osap_maxl::{BeatClock, ClockRings, HaltError, MotionState};

/// A stop of 3·2^10 µs, which uses up 1,536.
const DURATION: u64 = 3_072;

fn us(us: u64) -> NetTime {
    NetTime::from_us(us)
}

/// Beats of 64 µs from `from` to `to`; the last track time.
fn beat(clock: &mut BeatClock<'_>, from: u64, to: u64) -> NetTime {
    let times = (from..=to).step_by(64).map(|now| clock.advance(us(now)).time);
    let mut last = NetTime::ZERO;
    for time in times {
        assert!(time >= last);
        last = time;
    }
    last
}

/// `[MOT-24]`: half a stop's time is used up, and the resume is its mirror.
#[test]
fn a_stop_and_its_resume_cost_what_lies_between_their_epochs() {
    let mut rings = ClockRings::new();
    let (mut motion, mut clock) = rings.split(Warp::new(10).unwrap());
    assert_eq!(beat(&mut clock, 0, 6_400), us(6_400));
    motion.stop(1, us(12_800), us(6_400)).unwrap();
    assert_eq!(beat(&mut clock, 6_464, 12_800), us(12_800));
    let stopped = us(12_800 + DURATION / 2);
    assert_eq!(beat(&mut clock, 12_864, 12_800 + DURATION), stopped);
    assert_eq!(clock.state(), MotionState::Stopped);
    assert_eq!(beat(&mut clock, 16_000, 64_000), stopped, "and stands");
    motion.resume(2, us(70_400), us(64_000)).unwrap();
    assert_eq!(beat(&mut clock, 64_064, 70_400), stopped);
    let track = beat(&mut clock, 70_464, 89_600);
    assert_eq!(track, us(89_600 - (70_400 - 12_800)));
    assert_eq!(clock.advance(us(89_664)).rate, RATE_ONE);
    // what was
    motion.run();
    assert_eq!(motion.track_time(us(5_000)).time, us(5_000));
    assert_eq!(motion.track_time(us(30_000)).time, stopped);
    assert_eq!(motion.track_time(us(89_600)).time, track);
    assert_eq!(motion.state(us(14_000)), MotionState::Stopping);
}

/// `[MOT-21]`, as far as one node's clock goes.
#[test]
fn repeated_and_old_halts_do_nothing() {
    let mut rings = ClockRings::new();
    let (mut motion, mut clock) = rings.split(Warp::new(10).unwrap());
    beat(&mut clock, 0, 640);
    assert_eq!(motion.resume(1, us(1_000), us(640)), Err(HaltError::NotStopped));
    motion.stop(5, us(1_280), us(640)).unwrap();
    motion.stop(5, us(9_999), us(640)).unwrap();
    assert_eq!(motion.stop(4, us(640), us(640)), Err(HaltError::Stale { sequence: 4, last: 5 }));
    assert_eq!(
        motion.resume(5, us(2_000), us(640)),
        Err(HaltError::Stale { sequence: 5, last: 5 }),
        "the stop goes before"
    );
    assert_eq!(motion.resume(6, us(2_000), us(640)), Err(HaltError::Busy), "not before the beat has it");
    beat(&mut clock, 704, 1_920);
    assert_eq!(motion.resume(6, us(2_000), us(1_920)), Err(HaltError::StillStopping { until: us(1_280 + DURATION) }));
    assert_eq!(beat(&mut clock, 1_984, 10_048), us(1_280 + DURATION / 2));
    motion.resume(6, us(0), us(10_048)).unwrap();
    motion.resume(6, us(0), us(10_048)).unwrap();
    beat(&mut clock, 10_112, 20_032);
    assert_eq!(clock.state(), MotionState::Running);
    motion.stop(6, us(0), us(20_032)).unwrap();
    beat(&mut clock, 20_096, 30_016);
    assert_eq!(clock.state(), MotionState::Stopped, "of one sequence the stop goes before");
}

/// A stop that comes late begins at once, not in the past; the task learns when.
#[test]
fn a_late_stop_begins_at_the_next_beat() {
    let mut rings = ClockRings::new();
    let (mut motion, mut clock) = rings.split(Warp::new(10).unwrap());
    beat(&mut clock, 0, 6_400);
    motion.stop(1, us(100), us(6_000)).unwrap();
    assert_eq!(beat(&mut clock, 6_464, 20_032), us(6_400 + DURATION / 2));
    motion.run();
    assert_eq!(motion.track_time(us(6_400)).time, us(6_400));
    assert_eq!(motion.track_time(us(20_032)).time, us(6_400 + DURATION / 2));
}

/// A stop during a resume waits for its end; before a resume has begun it cancels it; before a later stop it goes first.
#[test]
fn a_stop_is_never_in_vain() {
    let mut rings = ClockRings::new();
    let (mut motion, mut clock) = rings.split(Warp::new(10).unwrap());
    motion.stop(1, us(640_000), us(0)).unwrap();
    beat(&mut clock, 0, 640);
    motion.stop(2, us(1_280), us(640)).unwrap();
    let stopped = us(1_280 + DURATION / 2);
    assert_eq!(beat(&mut clock, 704, 9_664), stopped, "the earlier one");
    motion.resume(3, us(64_000), us(9_664)).unwrap();
    beat(&mut clock, 9_728, 12_800);
    motion.stop(4, us(12_800), us(12_800)).unwrap();
    assert_eq!(beat(&mut clock, 12_864, 99_968), stopped, "the resume was cancelled");
    motion.run();
    assert_eq!(motion.track_time(us(99_968)).time, stopped);
    motion.resume(5, us(100_032), us(99_968)).unwrap();
    beat(&mut clock, 100_032, 101_056);
    motion.stop(6, us(0), us(101_056)).unwrap();
    // the resume is whole, then the stop: half a duration each
    let end = beat(&mut clock, 101_120, 640_000 + 64_000);
    assert_eq!(end, stopped + fixed_math::time::Span::from_us(DURATION / 2 + DURATION / 2));
}

/// A system time that steps back leaves track time running, off the network's; one that is back by a little waits.
#[test]
fn a_step_back_of_system_time_does_not_stop_track_time_dead() {
    let mut rings = ClockRings::new();
    let (mut motion, mut clock) = rings.split(Warp::new(10).unwrap());
    assert_eq!(beat(&mut clock, 0, 64_000), us(64_000));
    assert_eq!(clock.advance(us(63_990)).time, us(64_000), "a little");
    assert_eq!(clock.advance(us(32_000)).time, us(64_000));
    assert_eq!(clock.advance(us(32_064)).time, us(64_064), "and on");
    motion.run();
    assert_eq!((motion.steps_back(), motion.track_time(us(32_064)).time), (1, us(64_064)));
    motion.stop(1, us(32_128), us(32_064)).unwrap();
    let track = beat(&mut clock, 32_128, 64_000);
    assert_eq!(track, us(64_128 + DURATION / 2));
    assert_eq!(clock.advance(us(1_024)).time, track, "a step back of what stands is none");
    assert_eq!(clock.state(), MotionState::Stopped);
}

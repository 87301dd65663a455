//! A whole device without its board: what its highest task does where the task below falls silent, and readings in a window.
//! `[MOT-07]`, `[MOT-11]`, `[MOT-14]`.

use fixed_math::clock::SlewedMap;
use fixed_math::limits::{Curve, Limits};
use fixed_math::logic::{Node, Source};
use fixed_math::spline::IntervalLog2;
use fixed_math::time::{LocalTicks, NetTime, Span};
use fixed_math::warp::Warp;
use osap_maxl::axis::{AxisConfig, Point, StarvedPolicy};
use osap_maxl::device::{BeatTraits, DeviceRings, Drive, Interpolator, Motion, TIME_AGE_MAX};
use osap_maxl::player::PlayerState;
use osap_maxl::triggers::Trigger;
use osap_maxl::watch::ClockHealth;

const BEAT: BeatTraits = BeatTraits { period_log2: 6, nominal_cycles: 8_000 };
const BEAT_US: u64 = 64;
const INTERVAL_US: u64 = 4_096;
/// LSB an interval, and what acceleration and jerk may be.
const VELOCITY: i32 = 6_000;
const ACCELERATION: i32 = 1_000;
const JERK: i32 = 300;

const SURE: ClockHealth = ClockHealth { is_settled: true, is_linked: true, bound: Some(Span::from_us(5)) };

fn us(us: u64) -> NetTime {
    NetTime::from_us(us)
}

fn config(policy: StarvedPolicy) -> AxisConfig {
    let interval = IntervalLog2::new(12).unwrap();
    let range = (-10_000_000, 10_000_000);
    let limits = Limits::new(range, VELOCITY, Curve::flat(ACCELERATION), Curve::flat(JERK)).unwrap();
    let warp = Warp::new(17).unwrap();
    AxisConfig { interval, limits, warp, policy, missing_max: 1, rebuilt_max: 10, lead: Span::from_us(2_000) }
}

/// Beats from one time to another by a counter that is system time; the task below runs every 20 ms where it does.
fn pass(
    (motion, interpolator): (&mut Motion<'_>, &mut Interpolator<'_>),
    (from_us, to_us): (u64, u64),
    is_told: bool,
    mut look: impl FnMut(u64, i32, PlayerState, bool),
) {
    for beat in from_us / BEAT_US..to_us / BEAT_US {
        let at = beat * BEAT_US;
        if is_told && beat.is_multiple_of(312) {
            assert_eq!(motion.run(&SlewedMap::default(), &SURE, us(at)), None);
        }
        let out = interpolator.beat(LocalTicks::from_us(at), |channel| i32::from(channel) + 40);
        // what came out is for the next beat
        look(at + BEAT_US, out.first.position, out.first.state, out.is_enabled);
    }
}

/// The task below says no more what time it is: half a second later the axis leaves its points, comes to rest within its limits and, as it was
/// told to, lets go of its motor.
#[test]
fn an_axis_without_a_clock_stops_within_its_limits_and_lets_go() {
    let mut rings = DeviceRings::new();
    let (mut motion, mut interpolator) = rings.split(BEAT);
    motion.configure(0, &config(StarvedPolicy::Relax), Drive::Steps { step_log2: 6 }).unwrap();
    motion.arm(0, 0).unwrap();
    // speeds up by 200 an interval² to 4,000 an interval and stays at that: half of each limit is the stop's
    let (mut position, mut velocity) = (0, 0);
    let mut points = (0..).map(|_| {
        velocity = (velocity + 200).min(4_000);
        position += velocity;
        position
    });
    let first_us = 25 * INTERVAL_US;
    let silent_us = 100 * BEAT_US * 32;
    // as many as there is room for, and behind the silence's beginning more, so that points last longer than the patience with the task
    for (range, now_us) in [(0..100, 0), (100..152, silent_us)] {
        pass((&mut motion, &mut interpolator), (now_us.saturating_sub(silent_us), now_us), true, |_, _, _, _| ());
        for (index, position) in range.zip(&mut points) {
            motion.offer(0, Point { time: us(first_us + index * INTERVAL_US), position }, us(now_us)).unwrap();
        }
    }
    let (mut knots, mut left_at, mut end) = (Vec::new(), None, (PlayerState::Idle, true));
    pass(
        (&mut motion, &mut interpolator),
        (silent_us, silent_us + 1_500_000),
        false,
        |at, position, state, enabled| {
            if at.is_multiple_of(INTERVAL_US) {
                knots.push(position);
            }
            if state == PlayerState::Stopping && left_at.is_none() {
                left_at = Some(at);
            }
            end = (state, enabled);
        },
    );
    // the last word was spoken at most 20 ms before the silence, and is heard a beat later
    let left_us = left_at.expect("it leaves its points") - silent_us;
    let age_us = TIME_AGE_MAX.as_us_ceil();
    assert!((age_us - 20_000..=age_us + 2 * BEAT_US).contains(&left_us), "{left_us}");
    assert_eq!(end, (PlayerState::Released, false));
    let differences = |of: &[i32]| of.windows(2).map(|pair| pair[1] - pair[0]).collect::<Vec<_>>();
    let velocities = differences(&knots);
    let (accelerations, jerks) = (differences(&velocities), differences(&differences(&velocities)));
    // a knot is a mean of three points, so its differences keep their limits; and is off by less than one: by 2, 4 and 8 in differences
    let most = |of: &[i32]| of.iter().map(|it| it.abs()).max().unwrap();
    assert!(most(&velocities) > 3_900, "it moved");
    assert!(most(&velocities) <= VELOCITY + 2 && most(&accelerations) <= ACCELERATION + 4, "{}", most(&accelerations));
    assert!(most(&jerks) <= JERK + 8, "{}", most(&jerks));
}

/// A channel is read every fourth beat while the axis is between two positions, and at no other time; each reading has its beat's time.
#[test]
fn a_channel_is_read_while_a_track_is_in_a_window() {
    let mut rings = DeviceRings::new();
    let (mut motion, mut interpolator) = rings.split(BEAT);
    motion.configure(0, &config(StarvedPolicy::Stop), Drive::Steps { step_log2: 6 }).unwrap();
    motion.arm(0, 0).unwrap();
    let window = (2_000, 3_000);
    let inside = Node::Inside { a: Source::input(0).unwrap(), low: window.0, high: window.1 };
    motion.set_node(0, inside).unwrap();
    motion.set_trigger(1, 2, 0, Trigger::window(1, 1, us(0), Span::from_us(4 * BEAT_US))).unwrap();
    let first_us = 25 * INTERVAL_US;
    for index in 0..60 {
        // 100 LSB an interval: the window is passed in ten intervals, 640 beats
        let point = Point { time: us(first_us + index * INTERVAL_US), position: i32::try_from(index).unwrap() * 100 };
        motion.offer(0, point, us(0)).unwrap();
    }
    let mut positions = Vec::new();
    let mut readings = Vec::new();
    // so often that there is room for all
    for part in 0..32 {
        let span = (part * 9_984, (part + 1) * 9_984);
        pass((&mut motion, &mut interpolator), span, true, |at, position, _, _| positions.push((at, position)));
        while let Some(reading) = motion.take_reading() {
            assert_eq!((reading.channel, reading.value), (2, 42));
            readings.push(reading.time.as_us());
        }
    }
    let expected: Vec<u64> = positions
        .iter()
        .filter(|(at, position)| at.is_multiple_of(4 * BEAT_US) && (window.0..=window.1).contains(position))
        .map(|(at, _)| *at)
        .collect();
    assert!(expected.len() > 100, "{}", expected.len());
    assert_eq!(readings, expected);
    assert_eq!(motion.readings_lost(), 0);
}

//! One axis at 1.024 ms with round limits.

use fixed_math::limits::{Curve, Limits};
use fixed_math::spline::IntervalLog2;
use fixed_math::time::{NetTime, Span};
use fixed_math::warp::Warp;
use osap_maxl::axis::AxisConfig;
use osap_maxl::{Feeder, Output, Player, Point, StarvedPolicy};

pub(crate) const QUEUE: usize = 16;
pub(crate) const HISTORY: usize = 32;
/// An interval, µs.
pub(crate) const H: u64 = 1_024;

pub(crate) type TestFeeder<'a> = Feeder<'a, QUEUE, HISTORY>;
pub(crate) type TestPlayer<'a> = Player<'a, QUEUE>;

/// ±1,000,000 LSB, 1,000 LSB an interval, 100 an interval², 20 an interval³; a stop of 3·2^17 µs leaves 94 and 18 of the last two.
pub(crate) fn config() -> AxisConfig {
    let limits = Limits::new((-1_000_000, 1_000_000), 1_000, Curve::flat(100), Curve::flat(20)).unwrap();
    AxisConfig {
        interval: IntervalLog2::new(10).unwrap(),
        limits,
        warp: Warp::new(17).unwrap(),
        policy: StarvedPolicy::Stop,
        missing_max: 2,
        rebuilt_max: 100,
        lead: Span::ZERO,
    }
}

/// The instant of `intervals` of H.
pub(crate) fn at(intervals: u64) -> NetTime {
    NetTime::from_us(intervals * H)
}

pub(crate) fn point(index: u64, position: i32) -> Point {
    Point { time: at(index), position }
}

/// Plays from `from` up to, not including, `to`, in beats of 64 µs; the last output.
pub(crate) fn play(player: &mut TestPlayer<'_>, from: NetTime, to: NetTime) -> Output {
    let mut now = from;
    let mut output = player.beat(now);
    while now + Span::from_us(64) < to {
        now = now + Span::from_us(64);
        output = player.beat(now);
    }
    output
}

/// Speeds up by 10 an interval² from rest: positions of the points after 0.
pub(crate) fn ramp(index: u64) -> i32 {
    let index = i32::try_from(index).unwrap();
    10 * index * (index + 1) / 2
}

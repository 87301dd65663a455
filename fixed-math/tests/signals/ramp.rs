//! Ramps against the line in 128 bits.

use fixed_math::ramp::{RAMP_STEPS_MAX, Ramp, RampError, RampSegment};
use fixed_math::time::{NetTime, Span};
use proptest::prelude::*;

/// Any length, each of its bit counts as likely as the others, and those at either side of a power of two.
fn length() -> impl Strategy<Value = u64> {
    let any_of = |bits: u32| (1u64 << bits)..=((2 << bits) - 1);
    let near = (0u32..48, -1i64..=1).prop_map(|(bits, by)| (1u64 << bits).saturating_add_signed(by).max(1));
    prop_oneof![(0u32..48).prop_flat_map(any_of), near]
}

/// Any value, and the ends of the range.
fn value() -> impl Strategy<Value = i32> {
    prop_oneof![any::<i32>(), -1_000..1_000, Just(i32::MIN), Just(i32::MAX)]
}

/// A ramp and an instant of it, in steps from its start.
fn ramp() -> impl Strategy<Value = (RampSegment, u64, u64)> {
    (0u64..1 << 62, length(), value(), value(), any::<prop::sample::Index>()).prop_map(
        |(start, length, from, to, at)| {
            let start = NetTime::from_steps(start);
            let ramp = RampSegment::new(start, start + Span::from_steps(length), from, to).unwrap();
            let at = (u128::from(length) * at.index(1 << 30) as u128) >> 30;
            (ramp, length, at as u64)
        },
    )
}

/// Twice the distance from the exact line, of its length: 1 is half an LSB.
fn twice_off(ramp: &RampSegment, length: u64, at: u64) -> (i128, i128) {
    let value = ramp.value(ramp.start() + Span::from_steps(at));
    let (from, to) = (i128::from(ramp.start_value()), i128::from(ramp.end_value()));
    let exact = from * i128::from(length) + (to - from) * i128::from(at);
    (2 * (i128::from(value) * i128::from(length) - exact).abs(), i128::from(length))
}

/// Hand-worked: 10 to 20 in 4 µs is 2.5 a µs; halves go away from the start.
#[test]
fn a_hand_worked_ramp() {
    let us = NetTime::from_us;
    let up = RampSegment::new(us(10), us(14), 10, 20).unwrap();
    assert_eq!([9, 10, 11, 12, 13, 14, 15].map(|at| up.value(us(at))), [10, 10, 13, 15, 18, 20, 20]);
    let down = RampSegment::new(us(10), us(14), 20, 10).unwrap();
    assert_eq!([9, 10, 11, 12, 13, 14, 15].map(|at| down.value(us(at))), [20, 20, 17, 15, 12, 10, 10]);
}

/// The whole range in a microsecond, in an hour and in twelve days.
#[test]
fn the_whole_range_at_any_length() {
    for length in [256, 3_600_000_000 * 256, RAMP_STEPS_MAX] {
        let end = NetTime::from_steps(length);
        let ramp = RampSegment::new(NetTime::ZERO, end, i32::MIN, i32::MAX).unwrap();
        let quarter = i64::from(ramp.value(NetTime::from_steps(length / 4)));
        // length / 4 is rounded down by up to 3/4 of a step, which is worth 2^32/length
        let slack = 1 + (3 << 30) / length.cast_signed();
        assert!((quarter + (1 << 30)).abs() <= slack, "{length}: {quarter}");
        assert_eq!((ramp.value(NetTime::ZERO), ramp.value(end)), (i32::MIN, i32::MAX));
    }
}

#[test]
fn what_is_no_ramp_is_refused_with_its_operands() {
    let us = NetTime::from_us;
    let (start, end) = (us(5), us(5));
    assert_eq!(RampSegment::new(start, end, 0, 1), Err(RampError::EndNotAfterStart { start, end }));
    let end = start + Span::from_steps(RAMP_STEPS_MAX + 1);
    assert_eq!(RampSegment::new(start, end, 0, 1), Err(RampError::TooLong { start, end }));
    assert!(RampSegment::new(start, start + Span::from_steps(RAMP_STEPS_MAX), 0, 1).is_ok());

    let whole = Ramp { start: Some(us(10)), end: us(20), start_value: Some(3), end_value: 7 };
    let first = RampSegment::following(None, &whole).unwrap();
    let no_start = Ramp { start: None, ..whole };
    assert_eq!(RampSegment::following(None, &no_start), Err(RampError::NoStart { end: us(20) }));
    let no_value = Ramp { start_value: None, ..whole };
    assert_eq!(RampSegment::following(None, &no_value), Err(RampError::NoStartValue { end: us(20), end_value: 7 }));
    let early = Ramp { start: Some(us(19)), end: us(30), ..whole };
    let refused = RampError::StartBeforePreviousEnd { start: us(19), previous_end: us(20) };
    assert_eq!(RampSegment::following(Some(&first), &early), Err(refused));
    // what is taken over is refused alike
    let none = Ramp { start: None, end: us(20), start_value: None, end_value: 9 };
    let refused = RampError::EndNotAfterStart { start: us(20), end: us(20) };
    assert_eq!(RampSegment::following(Some(&first), &none), Err(refused));
    assert_eq!(
        refused.to_string(),
        "a ramp from 20 to 20 us has no length: end it later than it starts, or send a level"
    );
}

/// What is left out is the end before it; a start after a pause holds the value over it.
#[test]
fn what_is_left_out_is_taken_from_before() {
    let us = NetTime::from_us;
    let first = RampSegment::new(us(10), us(20), 3, 7).unwrap();
    let next = Ramp { start: None, end: us(22), start_value: None, end_value: 1 };
    let joined = RampSegment::following(Some(&first), &next).unwrap();
    assert_eq!(joined, RampSegment::new(us(20), us(22), 7, 1).unwrap());
    let later = Ramp { start: Some(us(25)), end: us(30), ..next };
    assert_eq!(RampSegment::following(Some(&first), &later), RampSegment::new(us(25), us(30), 7, 1));
    let jump = Ramp { start_value: Some(-4), ..next };
    assert_eq!(RampSegment::following(Some(&first), &jump), RampSegment::new(us(20), us(22), -4, 1));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4_000))]

    /// Half an LSB of rounding, and of what is left out: the slope's rounding 2^−17, two floors of 2^−15 and one of 2^−31, which is
    /// below 2^−13 in all. So twice the error is at most 1 + 2^−12 of an LSB.
    #[test]
    fn it_is_the_exact_line_rounded((ramp, length, at) in ramp()) {
        let (twice, one) = twice_off(&ramp, length, at);
        prop_assert!(twice * 4_096 <= one * 4_097, "{ramp:?} at {at} of {length}: {twice}/{one}");
    }

    /// Later is never further back, and neither end is passed.
    #[test]
    fn it_is_monotone((ramp, length, at) in ramp(), by in prop_oneof![0u64..4, 0u64..1 << 40]) {
        let read = |steps: u64| ramp.value(ramp.start() + Span::from_steps(steps));
        let (earlier, later) = (read(at), read(length.min(at + by)));
        let up = ramp.end_value() >= ramp.start_value();
        prop_assert!(if up { earlier <= later } else { earlier >= later }, "{ramp:?}: {earlier}, {later} from {at} by {by}");
        let (low, high) = (ramp.start_value().min(ramp.end_value()), ramp.start_value().max(ramp.end_value()));
        prop_assert!((low..=high).contains(&earlier));
        prop_assert_eq!(read(0), ramp.start_value());
        prop_assert_eq!(read(length), ramp.end_value());
    }

    /// Neighbouring steps, where the low bits of a long ramp carry into the high ones.
    #[test]
    fn it_is_monotone_step_by_step((ramp, length, at) in ramp()) {
        let up = ramp.end_value() >= ramp.start_value();
        let values = (at.saturating_sub(40)..length.min(at + 40)).map(|at| ramp.value(ramp.start() + Span::from_steps(at)));
        let values: Vec<i32> = values.collect();
        prop_assert!(values.windows(2).all(|pair| if up { pair[0] <= pair[1] } else { pair[0] >= pair[1] }), "{ramp:?} at {at}: {values:?}");
    }

    /// Outside it holds its ends.
    #[test]
    fn it_holds_its_ends((ramp, _, _) in ramp(), by in any::<u32>()) {
        prop_assert_eq!(ramp.value(ramp.end() + Span::from_steps(u64::from(by))), ramp.end_value());
        prop_assert_eq!(ramp.value(ramp.start().shifted(-i64::from(by))), ramp.start_value());
    }
}

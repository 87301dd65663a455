//! `Cubic`: its bounds of error over all that it takes, exhaustively where that is little, and what it refuses.

use crate::exact::{self, REACH};
use fixed_math::spline::horner::{Cubic, GUARD_BITS};
use fixed_math::spline::{IntervalLog2, Segment, TooFar};
use proptest::prelude::*;

const PARTS: i128 = 1 << 16;
const GUARD: i128 = 1 << GUARD_BITS;

/// Compares one evaluation with the exact one, by the bounds of the module's text, as integers:
/// |p − P| < 1, v − 16·V ∈ (−6, 1), a − 16·A ∈ (−1, 0], the position inside the hull.
fn check(points: [i32; 4], part: u16) -> Result<(), String> {
    let cubic = Cubic::new(points).map_err(|e| e.to_string())?;
    let (position, velocity) = cubic.position_velocity(part);
    if cubic.position(part) != position {
        return Err(format!("{points:?} at {part}: two positions, {} and {position}", cubic.position(part)));
    }
    let t = i128::from(part);
    let off = i128::from(position) * 6 * PARTS.pow(3) - exact::position(points, t, PARTS);
    if off.abs() >= 6 * PARTS.pow(3) {
        return Err(format!("{points:?} at {part}: position {position} is off by {off} / 6·2^48"));
    }
    let (least, most) = (points.into_iter().min().unwrap(), points.into_iter().max().unwrap());
    if position < least || position > most {
        return Err(format!("{points:?} at {part}: position {position} outside the hull"));
    }
    let unit = 2 * PARTS * PARTS;
    let off = i128::from(velocity) * unit - GUARD * exact::velocity(points, t, PARTS);
    if off <= -6 * unit || off >= unit {
        return Err(format!("{points:?} at {part}: velocity {velocity} is off by {off} / 2^33 guard units"));
    }
    let off = i128::from(cubic.acceleration(part)) * PARTS - GUARD * exact::acceleration(points, t, PARTS);
    if off <= -PARTS || off > 0 || (part == 0 && off != 0) {
        return Err(format!("{points:?} at {part}: acceleration is off by {off} / 2^16 guard units"));
    }
    check_whole(points, &cubic)
}

/// What does not depend on the part: jerk, which is exact, and the end.
fn check_whole(points: [i32; 4], cubic: &Cubic) -> Result<(), String> {
    let [p0, p1, p2, p3] = points.map(i128::from);
    if i128::from(cubic.jerk()) != p3 - 3 * p2 + 3 * p1 - p0 {
        return Err(format!("{points:?}: jerk {}", cubic.jerk()));
    }
    let off = 6 * i128::from(cubic.end()) - exact::position(points, 1, 1);
    if off.abs() * 16 > 6 * 15 { Err(format!("{points:?}: end {} is off by {off}/6", cubic.end())) } else { Ok(()) }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4096))]

    /// The whole allowed range: differences up to 2^25, points anywhere in 32 bits.
    #[test]
    fn bounds_hold_over_the_full_travel(points in exact::points::<4>(), part in any::<u16>(), near in 0u16..16) {
        for part in [part, near, u16::MAX - near, 0, u16::MAX, 1 << 15] {
            check(points, part).map_err(TestCaseError::fail)?;
        }
    }

    /// Against double precision, whose own error is below 2^-18 of a unit: sums of four terms below 2^34, each rounded at 2^-53.
    #[test]
    fn bounds_hold_against_floats(points in exact::points::<4>(), part in any::<u16>()) {
        let u = f64::from(part) / 65_536.0;
        let [p0, p1, p2, p3] = points.map(f64::from);
        let s = 1.0 - u;
        let near = |a: f64| 1.0 + 3.0 * a + 3.0 * a * a - 3.0 * a * a * a;
        let float = (p0 * s * s * s + p1 * near(s) + p2 * near(u) + p3 * u * u * u) / 6.0;
        let position = Cubic::new(points).unwrap().position(part);
        prop_assert!((f64::from(position) - float).abs() < 1.0 + 1.0 / 262_144.0, "{position} and {float}");
    }

    /// Against the crate's own reference, which rounds: less than one and a half away, so one at most.
    #[test]
    fn the_reference_is_one_away_at_most(points in exact::points::<4>(), log2 in 8u32..=14, steps in any::<u32>()) {
        let interval = IntervalLog2::new(log2).unwrap();
        let us = steps % interval.us();
        let reference = Segment::new(points, interval).sample(us);
        let cubic = Cubic::new(points).unwrap();
        // parts of 2^-16 hit every whole µs: 2^16 ≥ 2^14
        let position = cubic.position(interval.part(us * 256));
        prop_assert!(position.abs_diff(reference.position) <= 1);
        prop_assert!(cubic.end().abs_diff(Segment::new(points, interval).sample(interval.us()).position) <= 1);
    }

    /// No gain error: what stands still comes out as itself, and does not move.
    #[test]
    fn a_constant_comes_out_as_itself(value in any::<i32>(), part in any::<u16>()) {
        let cubic = Cubic::new([value; 4]).unwrap();
        prop_assert_eq!((cubic.position_velocity(part), cubic.acceleration(part), cubic.jerk()), ((value, 0), 0, 0));
        prop_assert_eq!(cubic.end(), value);
    }

    /// No gain error on a line either: velocity is exact, position from 3/16 below to 13/16 above.
    #[test]
    fn a_line_has_its_slope(middle in -(1i32 << 30)..1 << 30, slope in -REACH..=REACH, part in any::<u16>()) {
        let cubic = Cubic::new([middle - slope, middle, middle + slope, middle + 2 * slope]).unwrap();
        let (position, velocity) = cubic.position_velocity(part);
        prop_assert_eq!((velocity, cubic.acceleration(part), cubic.jerk()), (slope * 16, 0, 0));
        let off = (i64::from(position) - i64::from(middle)) * 65_536 - i64::from(slope) * i64::from(part);
        // ⌊(⌊16·slope·u⌋ + 13)/16⌋ less slope·u: at most 13/16, and above (−1 + 13 − 15)/16
        prop_assert!((-12_287..=53_248).contains(&off), "off by {}/65536", off);
    }

    /// Neighbours that are further apart are refused, whichever they are, with what they are.
    #[test]
    fn what_is_too_far_is_refused(points in any::<[i32; 4]>()) {
        let far = (0u8..3).map(|i| (i, i64::from(points[usize::from(i) + 1]) - i64::from(points[usize::from(i)])))
            .find(|(_, value)| value.abs() > i64::from(REACH));
        let refused = far.map(|(index, value)| TooFar { index, value, bound: REACH });
        prop_assert_eq!(Cubic::new(points).err(), refused);
    }
}

/// All points of a small range at a coarse grid of parts: 9⁴ segments at 67 parts.
#[test]
fn exhaustive_at_small_widths() {
    let parts: Vec<u16> = (0..=u16::MAX).step_by(1009).chain([u16::MAX]).collect();
    let range = -4..=4;
    let mut checked = 0u32;
    for p0 in range.clone() {
        for p1 in range.clone() {
            for p2 in range.clone() {
                for p3 in range.clone() {
                    for &part in &parts {
                        check([p0, p1, p2, p3], part).unwrap();
                        checked += 1;
                    }
                }
            }
        }
    }
    assert_eq!(checked, 9 * 9 * 9 * 9 * 66);
}

/// The corners of what is taken, at every part: all signs of the largest differences, and of ones that leave each remainder by 3.
#[test]
fn every_part_at_the_corners() {
    let sizes = [[REACH, REACH, REACH], [REACH, REACH - 1, REACH - 2], [1, 0, 2], [65_537, 40_961, 12_345]];
    for size in sizes {
        for signs in 0..8 {
            let d: [i32; 3] = core::array::from_fn(|i| if signs >> i & 1 == 0 { size[i] } else { -size[i] });
            for first in [0, if signs == 0 { i32::MAX - 3 * REACH } else { i32::MIN + 3 * REACH }] {
                let points = [first, first + d[0], first + d[0] + d[1], first + d[0] + d[1] + d[2]];
                for part in 0..=u16::MAX {
                    check(points, part).unwrap();
                }
            }
        }
    }
}

/// The limits are tight: one more is refused, and the refusal names what and how to go on.
#[test]
fn the_limit_is_where_it_says() {
    assert!(Cubic::new([0, REACH, 2 * REACH, REACH]).is_ok());
    assert!(Cubic::new([i32::MIN, i32::MIN + REACH, i32::MIN, i32::MIN + REACH]).is_ok());
    let refused = Cubic::new([0, 0, -REACH - 1, 0]).unwrap_err();
    assert_eq!(refused, TooFar { index: 1, value: -i64::from(REACH) - 1, bound: REACH });
    let text = refused.to_string();
    assert!(text.contains("points 1 and 2") && text.contains("-33554433") && text.contains("33554432"), "{text}");
}

/// A part is the interval's, whatever its length, and what is past the end stays before it.
#[test]
fn parts_of_every_interval() {
    for log2 in 8..=14 {
        let interval = IntervalLog2::new(log2).unwrap();
        assert_eq!((interval.log2(), interval.us(), interval.steps()), (log2, 1 << log2, 256 << log2));
        assert_eq!(interval.part(0), 0);
        assert_eq!(interval.part(interval.steps() / 2), 1 << 15);
        assert_eq!(interval.part(interval.steps() / 4 * 3), 3 << 14);
        for past in [interval.steps() - 1, interval.steps(), interval.steps() + 1, u32::MAX] {
            assert_eq!(interval.part(past), u16::MAX);
        }
    }
}

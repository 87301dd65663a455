//! `Differences`: every sample of every interval equals the exact numerator, over many knots and for all numbers of samples.

use crate::exact::{self, REACH};
use fixed_math::spline::differences::{Differences, KnotDue, Refusal, SAMPLES_LOG2_MAX, scale, second_difference_max};
use fixed_math::spline::{IntervalLog2, Segment, TooFar};
use proptest::prelude::*;

/// One sample against the basis functions: 6N³·(P − base), to the last bit, and the rounded position against ⌊P + ½⌋.
fn check(differences: &Differences, points: [i32; 4], t: u32, m: u32) -> Result<(), String> {
    let (t, n) = (i128::from(t), 1i128 << m);
    let exact = exact::position(points, t, n);
    let unit = 6 * n * n * n;
    if i128::from(differences.scale()) != unit {
        return Err(format!("the scale of m = {m} is {}", differences.scale()));
    }
    let base = i128::from(differences.base());
    if base != i128::from(points[1]) || i128::from(differences.scaled()) != exact - base * unit {
        return Err(format!("{points:?} at {t} of {n}: {} over {base}", differences.scaled()));
    }
    let rounded = (2 * exact + unit).div_euclid(2 * unit);
    if i128::from(differences.position()) == rounded {
        Ok(())
    } else {
        Err(format!("{points:?} at {t} of {n}: {} for {rounded}", differences.position()))
    }
}

fn four(points: &[i32], i: usize) -> [i32; 4] {
    [points[i], points[i + 1], points[i + 2], points[i + 3]]
}

/// Plays `points` at 2^m samples an interval, checking every sample.
fn play(points: &[i32], m: u32) -> Result<(), String> {
    let mut differences = Differences::new(four(points, 0), m).map_err(|e| e.to_string())?;
    for i in 0..points.len() - 3 {
        if i > 0 {
            differences.knot(points[i + 3]).map_err(|e| e.to_string())?;
            // what was carried over the knot is what would have been made afresh
            assert_eq!(differences, Differences::new(four(points, i), m).map_err(|e| e.to_string())?);
        }
        check(&differences, four(points, i), 0, m)?;
        for t in 1..=1 << m {
            differences.advance().map_err(|e| e.to_string())?;
            check(&differences, four(points, i), t, m)?;
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    /// Twenty-four knots over the full range, for every m.
    #[test]
    fn every_sample_is_exact((start, slope, turns) in exact::walks(26)) {
        for m in 0..=SAMPLES_LOG2_MAX {
            let points = exact::walk(start, slope, &turns, second_difference_max(m));
            play(&points, m).map_err(|e| TestCaseError::fail(format!("m = {m}: {e}")))?;
        }
    }

    /// Against the crate's reference at the whole µs that it knows: equal, since both round the same number alike.
    #[test]
    fn the_reference_says_the_same((start, slope, turns) in exact::walks(3), log2 in 8u32..=14, m in 0..=SAMPLES_LOG2_MAX) {
        let m = m.min(log2);
        let interval = IntervalLog2::new(log2).unwrap();
        let points = four(&exact::walk(start, slope, &turns, second_difference_max(m)), 0);
        let mut differences = Differences::new(points, m).unwrap();
        for t in 1..=1u32 << m {
            differences.advance().unwrap();
        prop_assert_eq!(differences.position(), Segment::new(points, interval).sample(t << (log2 - m)).position);
        }
    }

    /// A block is as many steps, gives each of them, and stops before the knot.
    #[test]
    fn a_block_is_so_many_steps((start, slope, turns) in exact::walks(3), m in 0u32..=6) {
        let points = exact::walk(start, slope, &turns, second_difference_max(m));
        let mut by_block = Differences::new(four(&points, 0), m).unwrap();
        let mut by_step = by_block;
        loop {
            let before = by_block;
            let mut samples = Vec::new();
            let done = by_block.block::<16>(|scaled| samples.push(scaled));
            if by_step.left() < 16 {
                prop_assert_eq!(done, Err(KnotDue { left: by_step.left() }));
                prop_assert_eq!((before, samples), (by_block, vec![]));
                break;
            }
            prop_assert_eq!(samples.len(), 16);
            for sample in samples {
                by_step.advance().unwrap();
                prop_assert_eq!(by_step.scaled(), sample);
            }
            prop_assert_eq!(by_step, by_block);
        }
    }
}

/// All points of a small range, all m up to 4.
#[test]
fn exhaustive_at_small_widths() {
    let range = -3..=3;
    for p0 in range.clone() {
        for p1 in range.clone() {
            for p2 in range.clone() {
                for p3 in range.clone() {
                    for m in 0..=4 {
                        play(&[p0, p1, p2, p3, p1], m).unwrap();
                    }
                }
            }
        }
    }
}

/// The widest values: all signs of the largest second differences, through all knots that they form, at both ends of the slopes, with overflow
/// checked. Where the slope has no room the walk clamps.
#[test]
fn the_corners_fit() {
    for m in 0..=SAMPLES_LOG2_MAX {
        for signs in 0..32 {
            let turns: Vec<i32> = (0..6).map(|i| if signs >> i & 1 == 0 { 65_536 } else { -65_536 }).collect();
            for slope in [0, REACH, -REACH, REACH - second_difference_max(m).min(2 * REACH)] {
                play(&exact::walk(0, slope, &turns, second_difference_max(m)), m).unwrap();
            }
        }
    }
}

/// The bound of second differences is where it says for each m: itself is played, one more is refused; and where 32 bits would hold it is not
/// refused needlessly: 6·bound·(N + 2) is less than one bound's step below 2^31.
#[test]
fn the_bound_of_second_differences_is_tight() {
    for m in 0..=SAMPLES_LOG2_MAX {
        let bound = second_difference_max(m);
        let worst = |bound: i32| 6 * i64::from(bound) * ((1 << m) + 2);
        assert!(worst(bound) < 1 << 31);
        if m < 2 {
            assert_eq!(bound, 2 * REACH, "neighbours that are close enough are never too curved");
            continue;
        }
        assert!(worst(bound + 1) >= 1 << 31);
        for sign in [1, -1] {
            let slope = -sign * bound / 2;
            let with = |second: i32| [0, slope, 2 * slope + sign * second, 3 * slope + sign * second];
            play(&with(bound), m).unwrap();
            assert_eq!(
                Differences::new(with(bound + 1), m),
                Err(Refusal::TooCurved { index: 0, value: sign * (bound + 1), bound })
            );
        }
    }
}

/// What is refused, and that nothing changes by it.
#[test]
fn refusals_change_nothing() {
    let far = TooFar { index: 2, value: i64::from(REACH) + 1, bound: REACH };
    assert_eq!(Differences::new([0, 0, 0, REACH + 1], 3), Err(Refusal::TooFar(far)));
    assert_eq!(Differences::new([0; 4], 12), Err(Refusal::TooManySamples { samples_log2: 12 }));
    let mut differences = Differences::new([0, 10, -20, 5], 1).unwrap();
    differences.advance().unwrap();
    let before = differences;
    assert_eq!(differences.knot(7), Err(Refusal::KnotEarly { left: 1 }));
    assert_eq!(differences, before);
    differences.advance().unwrap();
    let before = differences;
    assert_eq!(differences.advance(), Err(KnotDue { left: 0 }));
    assert_eq!(differences.knot(5 + REACH + 1), Err(Refusal::TooFar(far)));
    assert_eq!(differences, before);
    differences.knot(5 + REACH).unwrap();
    assert_eq!((differences.base(), differences.left()), (-20, 2));
    let mut differences = Differences::new([0; 4], 11).unwrap();
    differences.block::<2048>(|_| ()).unwrap();
    let before = differences;
    assert_eq!(differences.knot(-174_593), Err(Refusal::TooCurved { index: 1, value: -174_593, bound: 174_592 }));
    assert_eq!(differences, before);
    differences.knot(-174_592).unwrap();
}

/// The messages carry their operands.
#[test]
fn refusals_name_their_operands() {
    assert!(Refusal::KnotEarly { left: 3 }.to_string().contains("3 samples before"));
    let text = Refusal::TooCurved { index: 1, value: -9, bound: 8 }.to_string();
    assert!(text.contains("point 2") && text.contains("-9") && text.contains('8'), "{text}");
    assert!(Refusal::TooManySamples { samples_log2: 12 }.to_string().contains("2^12 samples"));
    assert!(KnotDue { left: 3 }.to_string().contains("3 samples ahead"));
    assert!(Refusal::from(TooFar { index: 0, value: 9, bound: 8 }).to_string().contains("9 units apart"));
}

/// The scale in all its sizes, and beyond.
#[test]
fn scales() {
    assert_eq!((scale(0), scale(1), scale(11), scale(40)), (6, 48, 6 << 33, 6 << 33));
}

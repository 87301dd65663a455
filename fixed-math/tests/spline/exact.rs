//! What the spline is, as integers over a common denominator: no rounding at all. It shares no formula with the evaluators: it sums the four
//! basis functions, where they work with differences and powers.

use proptest::prelude::*;

/// Largest difference of neighbours that the evaluators take; stated here once more, so that a change of theirs is seen.
pub(crate) const REACH: i32 = 1 << 25;

/// 6n³ times the position at `t` of `n` parts of the interval: the four basis functions of a uniform cubic B-spline.
pub(crate) fn position(points: [i32; 4], t: i128, n: i128) -> i128 {
    let [p0, p1, p2, p3] = points.map(i128::from);
    let s = n - t;
    let near = |a: i128| n * n * n + 3 * n * n * a + 3 * n * a * a - 3 * a * a * a;
    p0 * s * s * s + p1 * near(s) + p2 * near(t) + p3 * t * t * t
}

/// 2n² times the velocity an interval.
pub(crate) fn velocity(points: [i32; 4], t: i128, n: i128) -> i128 {
    let [p0, p1, p2, p3] = points.map(i128::from);
    let s = n - t;
    -p0 * s * s + p1 * (3 * t * t - 4 * n * t) - p2 * (3 * s * s - 4 * n * s) + p3 * t * t
}

/// n times the acceleration an interval².
pub(crate) fn acceleration(points: [i32; 4], t: i128, n: i128) -> i128 {
    let [p0, p1, p2, p3] = points.map(i128::from);
    let s = n - t;
    p0 * s + p1 * (3 * t - 2 * n) + p2 * (3 * s - 2 * n) + p3 * t
}

/// Points whose neighbours are as far apart as may be, or near, or anything between, anywhere in the range.
pub(crate) fn points<const COUNT: usize>() -> impl Strategy<Value = [i32; COUNT]> {
    let difference =
        prop_oneof![3 => -REACH..=REACH, 1 => -100..=100i32, 1 => Just(REACH), 1 => Just(-REACH), 1 => Just(0)];
    let start = prop_oneof![4 => any::<i32>(), 1 => Just(i32::MAX), 1 => Just(i32::MIN), 1 => -1000..1000i32];
    (start, proptest::collection::vec(difference, COUNT)).prop_map(|(start, differences)| {
        let mut at = start;
        core::array::from_fn(|i| {
            // at the ends of the range turned round, not clamped: the difference stays what it is
            at = at.checked_add(differences[i]).unwrap_or_else(|| at - differences[i]);
            at
        })
    })
}

/// A walk of points within both bounds: first differences up to 2^25, second ones up to `curvature`. `turns` are shares of that in 2^-16, so
/// that one walk serves all bounds; the whole is moved, up to the very end, where it would leave the range of 32 bits.
pub(crate) fn walk(start: i32, slope: i32, turns: &[i32], curvature: i32) -> Vec<i32> {
    let mut difference = i64::from(slope);
    let mut points = vec![i64::from(start)];
    for &turn in turns {
        points.push(points[points.len() - 1] + difference);
        let change = i64::from(curvature) * i64::from(turn) / 65_536;
        difference = (difference + change).clamp(-i64::from(REACH), i64::from(REACH));
    }
    let least = points.iter().min().unwrap().min(&i64::from(i32::MIN)) - i64::from(i32::MIN);
    let most = points.iter().max().unwrap().max(&i64::from(i32::MAX)) - i64::from(i32::MAX);
    points.into_iter().map(|point| i32::try_from(point - least - most).unwrap()).collect()
}

/// What [`walk`] takes but for the bound: starts anywhere, turns that are mostly all there may be.
pub(crate) fn walks(count: usize) -> impl Strategy<Value = (i32, i32, Vec<i32>)> {
    let turn = prop_oneof![3 => Just(65_536), 3 => Just(-65_536), 3 => -65_536..=65_536, 1 => Just(0), 1 => -8..=8i32];
    let slope = prop_oneof![Just(REACH), Just(-REACH), -REACH..=REACH, -8..=8i32];
    let start = prop_oneof![4 => any::<i32>(), 1 => Just(i32::MAX), 1 => Just(i32::MIN)];
    (start, slope, proptest::collection::vec(turn, count))
}

/// The basis functions above sum to one, and what they say at knots is the textbook's (1, 4, 1)/6.
#[test]
fn the_basis_is_the_textbook_s() {
    for n in [1, 2, 7, 64] {
        for t in 0..=n {
            assert_eq!(position([5; 4], t, n), 5 * 6 * n * n * n);
            assert_eq!((velocity([5; 4], t, n), acceleration([5; 4], t, n)), (0, 0));
            // a line of slope 3, and a parabola t² with second difference 2
            assert_eq!(position([-3, 0, 3, 6], t, n), 3 * t * 6 * n * n);
            assert_eq!(velocity([-3, 0, 3, 6], t, n), 3 * 2 * n * n);
            assert_eq!(acceleration([1, 0, 1, 4], t, n), 2 * n);
        }
        assert_eq!(position([6, 0, 0, 0], 0, n), 6 * n * n * n);
        assert_eq!(position([0, 6, 0, 0], 0, n), 24 * n * n * n);
        assert_eq!(position([0, 0, 6, 0], 0, n), 6 * n * n * n);
        assert_eq!(position([0, 0, 0, 6], 0, n), 0);
        assert_eq!(position([0, 0, 0, 6], n, n), 6 * n * n * n);
    }
}

//! An earlier evaluator of the same spline, made again from its description: what it loses is what ours must not.
//!
//! Q16.16 in 32 bits, products shifted down by 16 bits with the rest cut off, the weights 1/6, 1/2 and 2/3 as fractions of 2^16 that were cut
//! off too, and all coefficients worked out again at each call. Its weights of a constant sum up to 65,534 of 65,536.

/// 1/6, 1/2 and 2/3 in 2^-16, cut off.
const SIXTH: i32 = 10_922;
const HALF: i32 = 32_768;
const TWO_THIRDS: i32 = 43_690;

/// The product of two numbers in Q16.16, rounded down; it wraps as its C++ did.
#[expect(clippy::cast_possible_truncation, reason = "what is described does so")]
fn product(a: i32, b: i32) -> i32 {
    ((i64::from(a) * i64::from(b)) >> 16) as i32
}

/// The position at `t`, in 2^-16 of the interval, 0 to 65,536.
pub(crate) fn position(points: [i32; 4], t: u32) -> i32 {
    let t = t.min(1 << 16).cast_signed();
    let [sixth, half, third] = [SIXTH, HALF, TWO_THIRDS].map(|weight| points.map(|point| product(point, weight)));
    let coefficients = [
        sixth[0].wrapping_add(third[1]).wrapping_add(sixth[2]),
        half[2].wrapping_sub(half[0]),
        half[0].wrapping_sub(points[1]).wrapping_add(half[2]),
        half[1].wrapping_sub(sixth[0]).wrapping_sub(half[2]).wrapping_add(sixth[3]),
    ];
    let square = product(t, t);
    let powers = [t, square, product(square, t)];
    let [constant, others @ ..] = coefficients;
    others
        .into_iter()
        .zip(powers)
        .fold(constant, |sum, (coefficient, power)| sum.wrapping_add(product(coefficient, power)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use fixed_math::spline::differences::Differences;
    use fixed_math::spline::horner::Cubic;

    /// One metre at 2^-16 mm.
    const METRE: i32 = 1_000 << 16;

    /// Whether constants come out as themselves: the test that `fixed-math` puts its evaluators to.
    fn has_no_gain_error(position: impl Fn([i32; 4], u16) -> i32) -> bool {
        [METRE, -METRE, i32::MAX, i32::MIN, 1, -1].into_iter().all(|value| position([value; 4], 12_345) == value)
    }

    #[test]
    fn the_weights_lose_thirty_ppm_and_ours_none() {
        assert!(!has_no_gain_error(|points, part| super::position(points, u32::from(part))));
        assert!(has_no_gain_error(|points, part| Cubic::new(points).unwrap().position(part)));
        assert!(has_no_gain_error(|points, _| Differences::new(points, 6).unwrap().position()));
        // 65,534/65,536 of a metre, and no more: 2/65,536 are 30.5 ppm, 30.5 µm of a metre, 2,000 units
        assert_eq!(METRE - position([METRE; 4], 12_345), 2_000);
    }

    /// What is described is a spline: on a line of a few units its slope is there, less what is cut off.
    #[test]
    fn it_is_the_spline_but_for_its_rounding() {
        for t in (0..=65_536).step_by(4_096) {
            let line = position([0, 1 << 16, 2 << 16, 3 << 16], t);
            let off = line - ((1 << 16) + t.cast_signed());
            // 30.5 ppm of up to 2^17 are 4, and 7 products cut off up to one each, two of them halves that are exact
            assert!((-9..=1).contains(&off), "{off} at {t}");
        }
    }
}

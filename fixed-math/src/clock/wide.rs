//! The few operations that do not fit 64 bits, each behind one function.
//!
//! - **Walk:** [`covariance`](super::covariance) and [`link`](super::link) multiply by gains, spans and reciprocals here.
//! - **Invariants:** what does not fit saturates towards its own sign; no division by zero; no panic.
//! - **Context:** once an exchange, not in an interrupt. Made of 32-bit products for processors that have no longer ones
//!   ([`widening`](crate::widening)); on a Cortex-M0+ [`scale`] is 65 to 110 cycles, [`mul_shift`] 155, a reciprocal 230, a root 220.

use crate::widening::{product, product_signed};

/// `(a × b) / 2^shift`, rounded down, saturating. `shift` is below 127.
///
/// Of the four products of 32 × 32 bits those with an upper half of zero are left out, which is most of them.
#[inline(never)]
pub(super) const fn mul_shift(a: i64, b: i64, shift: u32) -> i64 {
    let is_negative = (a ^ b) < 0;
    let ((a_high, a_low), (b_high, b_low)) = (halves(a.unsigned_abs()), halves(b.unsigned_abs()));
    let (above_first, first) = halves(product(a_low, b_low));
    let mut middle = above_first as u64;
    if a_high != 0 {
        middle += product(a_high, b_low);
    }
    let mut upper = 0;
    if b_high != 0 {
        let (sum, carry) = middle.overflowing_add(product(a_low, b_high));
        middle = sum;
        if a_high != 0 {
            upper = product(a_high, b_high) + ((carry as u64) << 32);
        }
    }
    let (above_second, second) = halves(middle);
    let (fourth, third) = halves(upper + above_second as u64);
    // whole words first; what falls off decides how a negative one is rounded
    let (lost, low, middle, high, above) = match shift >> 5 {
        0 => (0, first, second, third, fourth),
        1 => (first, second, third, fourth, 0),
        2 => (first | second, third, fourth, 0, 0),
        _ => (first | second | third, fourth, 0, 0, 0),
    };
    let right = shift & 31;
    // one and the rest, since 32 is not a shift
    let left = 31 - right;
    let lost = lost | ((low << 1) << left);
    let low = (low >> right) | ((middle << 1) << left);
    let middle = (middle >> right) | ((high << 1) << left);
    let is_long = (above | (high >> right)) != 0 || middle.cast_signed() < 0;
    match (is_long, is_negative) {
        (false, false) => whole(middle, low).cast_signed(),
        (false, true) => -whole(middle, low).cast_signed() - (lost != 0) as i64,
        (true, false) => i64::MAX,
        (true, true) => i64::MIN,
    }
}

/// `(value × by) / 2^shift`, rounded down, saturating. `shift` is below 96. Three fifths of what [`mul_shift`] takes.
#[inline(never)]
pub(super) const fn scale(value: i64, by: u32, shift: u32) -> i64 {
    let (value_high, value_low) = halves(value.cast_unsigned());
    let (above_first, first) = halves(product(value_low, by));
    let mut upper = above_first as u64;
    if value_high != 0 {
        // a negative one is 2^64 less than its bits
        let excess = if value < 0 { by } else { 0 };
        upper = upper.wrapping_add(product(value_high, by)).wrapping_sub((excess as u64) << 32);
    }
    let (third, second) = halves(upper);
    let sign = (third.cast_signed() >> 31).cast_unsigned();
    let (low, middle, high) = match shift >> 5 {
        0 => (first, second, third),
        1 => (second, third, sign),
        _ => (third, sign, sign),
    };
    let right = shift & 31;
    // one and the rest, since 32 is not a shift
    let left = 31 - right;
    let low = (low >> right) | ((middle << 1) << left);
    let middle = (middle >> right) | ((high << 1) << left);
    let above = high.cast_signed() >> right;
    if above == middle.cast_signed() >> 31 {
        whole(middle, low).cast_signed()
    } else if above < 0 {
        i64::MIN
    } else {
        i64::MAX
    }
}

/// [`mul_shift`] where `by` is nearly always of 32 bits.
#[inline(always)]
#[expect(clippy::inline_always, reason = "two instructions before a call")]
pub(super) const fn scale_or_more(value: i64, by: i64, shift: u32) -> i64 {
    match halves(by.cast_unsigned()) {
        (0, by) => scale(value, by, shift),
        _ => mul_shift(value, by, shift),
    }
}

/// Upper and lower half.
#[expect(clippy::cast_possible_truncation, reason = "the two halves")]
const fn halves(value: u64) -> (u32, u32) {
    ((value >> 32) as u32, value as u32)
}

/// What [`halves`] took apart.
const fn whole(high: u32, low: u32) -> u64 {
    ((high as u64) << 32) | low as u64
}

/// One over a positive number, as a 32-bit mantissa and a shift: one division makes any number of quotients.
#[derive(Clone, Copy)]
pub(super) struct Reciprocal {
    /// 2^63 over the denominator's upper 32 bits, 2^31 to 2^32, of which one is taken off.
    mantissa: u32,
    /// Leading zeros of the denominator.
    zeros: u32,
}

impl Reciprocal {
    /// Of `denominator`; what is not positive counts as one.
    pub(super) const fn of(denominator: i64) -> Self {
        let denominator = if denominator < 1 { 1 } else { denominator.cast_unsigned() };
        let (upper, zeros) = normalised(denominator);
        Self { mantissa: inverse(upper), zeros }
    }

    /// `numerator / denominator` in 2^−`fraction`, at most 2^−31 of itself away from exact, and rounded down. `fraction` is 32 or less,
    /// or for a denominator of 2^16 and more 48.
    pub(super) const fn times(self, numerator: i64, fraction: u32) -> i64 {
        // 1/d = mantissa · 2^(zeros − 95), and zeros is 63 at most
        scale(numerator, self.mantissa, (95 - self.zeros).saturating_sub(fraction))
    }
}

/// The upper 32 bits of what is not zero, shifted until the uppermost is one, and by how many; a Cortex-M0+ shifts no 64 bits by itself.
const fn normalised(value: u64) -> (u32, u32) {
    let (mut high, mut low) = halves(value);
    let mut zeros = 0;
    if high == 0 {
        (high, low, zeros) = (low, 0, 32);
    }
    let step = high.leading_zeros();
    // one and the rest, since 32 is not a shift
    ((high << step) | ((low >> 1) >> (31 - step)), zeros + step)
}

/// `2^63 / denominator`, rounded down, of 2^31 and more; of 2^31 one less, to fit. It is made in steps of Newton's: a Cortex-M0+ divides 32 bits in 200 cycles, and 64 in 700.
///
/// Of the upper half, rounded to 16 bits, 48/17 − 32/17·d is one over d but for a 17th; each step squares that: 2^−8, then 2^−16. With the
/// half cut off that is 2^−15 at most, and a step of all 32 bits makes 2^−30 of 2^32 of it, which is four. Such a step ends below, or above
/// by what its own roundings are; the rest is counted off.
#[inline(never)]
const fn inverse(denominator: u32) -> u32 {
    let half = (denominator >> 16) + ((denominator >> 15) & 1);
    // in 2^−16; the distance from one, of 2^32, is what is left of the product when it wraps
    let near = 185_042 - ((half * 61_681) >> 15);
    let short = half.wrapping_mul(near).wrapping_neg().cast_signed() >> 16;
    let near = near.wrapping_add_signed((near.cast_signed() * short) >> 16);
    let short = half.wrapping_mul(near).wrapping_neg().cast_signed() >> 12;
    let near = near.wrapping_add_signed((near.cast_signed() * short) >> 20);
    // 2^48 − d·x is below 2^34
    #[expect(clippy::cast_possible_truncation, reason = "30 bits and a sign")]
    let short = (((1i64 << 48) - product(denominator, near).cast_signed()) >> 4) as i32;
    let (high, low) = halves(
        (((near as u64) << 15).cast_signed() + (product_signed(short, near.cast_signed()) >> 29)).cast_unsigned(),
    );
    let mut quotient = if high == 0 { low } else { u32::MAX };
    let mut rest = (1u64 << 63) - product(quotient, denominator);
    while rest >= denominator as u64 && quotient < u32::MAX {
        rest -= denominator as u64;
        quotient += 1;
    }
    quotient
}

/// The square root, rounded up; of what is over 32 bits by a part in 2^14 at most.
///
/// Of those the upper 31 or 32 bits count, rounded up, and their root is 2^15 at least: two units of it, one for each rounding. Bit by bit
/// takes a Cortex-M0+ half the time of the divisions that the usual way needs.
pub(super) fn root_up(square: u64) -> u64 {
    let (high, low) = halves(square);
    let excess = (33 - high.leading_zeros()) & !1;
    let (mut rest, cut) = match excess {
        0 => (low, false),
        32.. => (high, low != 0),
        _ => (high << (32 - excess) | low >> excess, low << (32 - excess) != 0),
    };
    rest = rest.saturating_add(u32::from(cut));
    let (mut root, mut bit) = (0, 1 << 30);
    while bit > rest {
        bit >>= 2;
    }
    while bit != 0 {
        let taken = root + bit;
        root >>= 1;
        if rest >= taken {
            rest -= taken;
            root += bit;
        }
        bit >>= 2;
    }
    u64::from(root + u32::from(rest != 0)) << (excess >> 1)
}

/// `√(a² + b²)`, rounded up as by [`root_up`], saturating: of two independent errors. What is longer than 2^31 steps (8 s) is added
/// instead.
pub(super) fn hypotenuse(a: u64, b: u64) -> u64 {
    match (u32::try_from(a), u32::try_from(b)) {
        (Ok(short), Ok(other)) if (short | other) >> 31 == 0 => root_up(square(short) + square(other)),
        _ => a.saturating_add(b),
    }
}

/// The same of a variance, which is below 2^63, and an error.
pub(super) fn hypotenuse_of_square(variance: u64, error: u64) -> u64 {
    match u32::try_from(error) {
        Ok(short) if short >> 31 == 0 => root_up(variance + square(short)),
        _ => root_up(variance).saturating_add(error),
    }
}

/// `value²`.
pub(super) const fn square(value: u32) -> u64 {
    product(value, value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_product_saturates_towards_its_own_sign(
            a in any::<i64>(),
            b in any::<i64>(),
            a_shift in 0u32..64,
            b_shift in 0u32..64,
            shift in 0u32..127,
        ) {
            let (a, b) = (a >> a_shift, b >> b_shift);
            let exact = (i128::from(a) * i128::from(b)) >> shift;
            prop_assert_eq!(i128::from(mul_shift(a, b, shift)), exact.clamp(i64::MIN.into(), i64::MAX.into()));
        }

        /// As `mul_shift`, for any sign and length.
        #[test]
        fn a_scaled_value_saturates_towards_its_own_sign(
            value in any::<i64>(),
            shorter in 0u32..64,
            by in any::<u32>(),
            by_shorter in 0u32..32,
            shift in 0u32..96,
        ) {
            let (value, by) = (value >> shorter, by >> by_shorter);
            let exact = ((i128::from(value) * i128::from(by)) >> shift).clamp(i64::MIN.into(), i64::MAX.into());
            prop_assert_eq!(i128::from(scale(value, by, shift)), exact);
            prop_assert_eq!(i128::from(scale_or_more(value, by.into(), shift)), exact);
        }

        /// One over a normalised number is that, rounded down, but for the one that does not fit.
        #[test]
        fn an_inverse_is_exact(denominator in 1u32 << 31.., near in 0u32..1 << 17) {
            // and where the upper halves have the most to round
            for denominator in [denominator, denominator & 0xffff_0000, denominator | 0x8000, u32::MAX - near, (1 << 31) + near] {
                let exact = (1u64 << 63) / u64::from(denominator);
                prop_assert_eq!(u64::from(inverse(denominator)), exact.min(u32::MAX.into()), "{}", denominator);
            }
        }

        /// The mantissa's upper 32 bits are short of the denominator by less than 2^−31 of it, and so the quotient is long by that; each of two roundings adds a part in 2^31 or a unit.
        #[test]
        fn a_quotient_is_near(numerator in -(1i64 << 61)..1 << 61, denominator in 1i64..1 << 62) {
            let exact = (i128::from(numerator) << 32) / i128::from(denominator);
            let found = i128::from(Reciprocal::of(denominator).times(numerator, 32));
            if exact.abs() < 1 << 62 {
                prop_assert!((found - exact).abs() <= (exact.abs() >> 30) + 2, "{found} {exact}");
            }
        }

        #[test]
        fn roots_are_rounded_up(a in 0u64..1 << 31, b in 0u64..1 << 31, square in any::<u64>(), shift in 0u32..64) {
            // exact below 2^32, a part in 2^14 above
            let near = |found: u64, exact: u128| {
                let (found, exact) = (u128::from(found), exact);
                let most = if exact >> 32 == 0 { found.saturating_sub(1) } else { found - found.div_ceil(1 << 14) - 1 };
                found * found >= exact && most * most <= exact
            };
            prop_assert!(near(root_up(square), square.into()), "{}", root_up(square));
            prop_assert!(near(root_up(square >> shift), (square >> shift).into()), "{}", root_up(square >> shift));
            let exact = u128::from(a) * u128::from(a) + u128::from(b) * u128::from(b);
            prop_assert!(near(hypotenuse(a, b), exact));
            prop_assert!(near(hypotenuse_of_square(a * a, b), exact));
        }
    }
}

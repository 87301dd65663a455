//! The few operations that do not fit 64 bits, each behind one function.
//!
//! - **Walk:** [`covariance`](super::covariance) and [`link`](super::link) multiply by gains, spans and reciprocals here.
//! - **Invariants:** what does not fit saturates towards its own sign; no division by zero; no panic.
//! - **Context:** once an exchange, not in an interrupt. [`mul_shift`] is the only 128-bit product of the crate's clock part: a processor
//!   with a wide multiplier, or a hand-written one, replaces this one body.

/// `(a × b) / 2^shift`, rounded down, saturating. `shift` is below 127.
pub(super) const fn mul_shift(a: i64, b: i64, shift: u32) -> i64 {
    saturated((a as i128 * b as i128) >> shift)
}

/// Cut to 64 bits towards its own sign.
#[expect(clippy::cast_possible_truncation, reason = "cut to 64 bits before")]
const fn saturated(wide: i128) -> i64 {
    if wide > i64::MAX as i128 {
        i64::MAX
    } else if wide < i64::MIN as i128 {
        i64::MIN
    } else {
        wide as i64
    }
}

/// One over a positive number, as a 32-bit mantissa and a shift: one 64-bit division makes any number of quotients.
#[derive(Clone, Copy)]
pub(super) struct Reciprocal {
    /// 2^63 over the denominator's upper 32 bits, 2^31 to 2^32.
    mantissa: i64,
    /// Leading zeros of the denominator.
    zeros: u32,
}

impl Reciprocal {
    /// Of `denominator`; what is not positive counts as one.
    pub(super) const fn of(denominator: i64) -> Self {
        let denominator = if denominator < 1 { 1 } else { denominator.cast_unsigned() };
        let zeros = denominator.leading_zeros();
        let upper = (denominator << zeros) >> 32;
        Self { mantissa: ((1 << 63) / upper).cast_signed(), zeros }
    }

    /// `numerator / denominator` in 2^−`fraction`, at most 2^−31 of itself away from exact, and rounded down. `fraction` is 32 or less,
    /// or for a denominator of 2^16 and more 48.
    pub(super) const fn times(self, numerator: i64, fraction: u32) -> i64 {
        // 1/d = mantissa · 2^(zeros − 95), and zeros is 63 at most
        mul_shift(numerator, self.mantissa, (95 - self.zeros).saturating_sub(fraction))
    }
}

/// The square root of what is not negative, rounded up; zero of what is.
pub(super) fn root_ceil(square: i64) -> i64 {
    let square = square.max(0).cast_unsigned();
    let root = square.isqrt();
    (root + u64::from(root * root < square)).cast_signed()
}

/// `√(a² + b²)`, rounded up, saturating: of two independent errors. What is longer than 2^31 steps (8 s) is added instead.
pub(super) fn hypotenuse(a: u64, b: u64) -> u64 {
    if a.max(b) >= 1 << 31 {
        return a.saturating_add(b);
    }
    let square = a * a + b * b;
    let root = square.isqrt();
    root + u64::from(root * root < square)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_product_saturates_towards_its_own_sign(a in any::<i64>(), b in any::<i64>(), shift in 0u32..64) {
            let exact = (i128::from(a) * i128::from(b)) >> shift;
            prop_assert_eq!(i128::from(mul_shift(a, b, shift)), exact.clamp(i64::MIN.into(), i64::MAX.into()));
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
        fn roots_are_rounded_up(a in 0u64..1 << 31, b in 0u64..1 << 31, square in 0i64..i64::MAX) {
            let root = i128::from(root_ceil(square));
            prop_assert!(root * root >= i128::from(square) && (root - 1).max(0).pow(2) <= i128::from(square));
            let found = i128::from(hypotenuse(a, b));
            let exact = i128::from(a) * i128::from(a) + i128::from(b) * i128::from(b);
            prop_assert!(found * found >= exact && (found - 1).max(0).pow(2) <= exact);
        }
    }
}

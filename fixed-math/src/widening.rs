//! Products twice as long as their factors, on processors that have none.
//!
//! - **Walk:** [`Rate::over`](crate::time::Rate::over) and the clock's arithmetic multiply here and nowhere else.
//! - **Invariants:** exact.
//! - **Context:** any. A Cortex-M0+ multiplies 32 bits by 32 to 32 in one cycle, and its library takes 57 for a 64-bit product; four
//!   products of halves, in line, take 17. Elsewhere it is one instruction.

/// `a × b`, all 64 bits.
#[inline(always)]
#[expect(clippy::inline_always, reason = "a call would cost as much as the product")]
pub(crate) const fn product(a: u32, b: u32) -> u64 {
    // the Cortex-M0+ is the one that has no atomic exchange either, which is what the language tells of a processor
    if cfg!(target_has_atomic = "32") { a as u64 * b as u64 } else { by_halves(a, b) }
}

/// `a × b`, all 64 bits, signed.
#[inline(always)]
#[expect(clippy::inline_always, reason = "a call would cost as much as the product")]
pub(crate) const fn product_signed(a: i32, b: i32) -> i64 {
    if cfg!(target_has_atomic = "32") { a as i64 * b as i64 } else { signed_by_halves(a, b) }
}

/// [`product_signed`] of one that is negative as −1 is: 2^32 less.
#[inline(always)]
#[expect(clippy::inline_always, reason = "as above")]
const fn signed_by_halves(a: i32, b: i32) -> i64 {
    let unsigned = by_halves(a.cast_unsigned(), b.cast_unsigned());
    let excess = ((a >> 31) & b).wrapping_add((b >> 31) & a).cast_unsigned();
    unsigned.wrapping_sub((excess as u64) << 32).cast_signed()
}

/// [`product`] from 16 × 16 bits.
#[inline(always)]
#[expect(clippy::inline_always, reason = "as above")]
const fn by_halves(a: u32, b: u32) -> u64 {
    let (a_low, a_high, b_low, b_high) = (a & 0xffff, a >> 16, b & 0xffff, b >> 16);
    // (2^16 − 1)^2 and 2^16 − 1 are below 2^32 together
    let middle = a_high * b_low + ((a_low * b_low) >> 16);
    let (middle, carry) = middle.overflowing_add(a_low * b_high);
    let high = a_high * b_high + (middle >> 16) + if carry { 1 << 16 } else { 0 };
    ((high as u64) << 32) | a.wrapping_mul(b) as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Any, and those at the ends of either half.
    fn factor() -> impl Strategy<Value = u32> {
        let half = prop_oneof![Just(0u32), Just(1), Just(0x7fff), Just(0x8000), Just(0xffff)];
        prop_oneof![any::<u32>(), (half.clone(), half).prop_map(|(high, low)| high << 16 | low)]
    }

    proptest! {
        /// What no host takes by itself: the halves.
        #[test]
        fn halves_make_the_product(a in factor(), b in factor()) {
            prop_assert_eq!(by_halves(a, b), u64::from(a) * u64::from(b));
            let (a, b) = (a.cast_signed(), b.cast_signed());
            prop_assert_eq!(signed_by_halves(a, b), i64::from(a) * i64::from(b));
        }
    }
}

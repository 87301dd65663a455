//! Instants and spans of time, 64 bits with 8 fractional: 1/256 µs (3.9 ns) a step, 2283 years of range.
//!
//! - **Walk:** a board makes [`LocalTicks`] in the interrupt that saw a frame's first byte; everything below boards gets them as
//!   arguments. [`NetTime`] is what the clock service makes of them.
//! - **Invariants:** the two kinds of instant never mix. A difference of two of one kind is a [`Span`], which is never negative;
//!   sums and differences saturate.
//! - **Context:** any.
//!
//! ```
//! use fixed_math::time::{LocalTicks, Span};
//!
//! let arrived = LocalTicks::from_us(1_000);
//! let deadline = arrived + Span::from_us(250);
//! assert_eq!(deadline.since(arrived).as_us_ceil(), 250);
//! assert_eq!(arrived.since(deadline), Span::ZERO); // not a wrap to 584 thousand years
//! ```
//!
//! A counter's reading is not system time, and the compiler says so:
//!
//! ```compile_fail
//! use fixed_math::time::{LocalTicks, NetTime};
//! let at: NetTime = LocalTicks::from_us(5);
//! ```
//!
//! ```compile_fail
//! use fixed_math::time::{LocalTicks, NetTime};
//! let _ = NetTime::from_us(5).since(LocalTicks::from_us(3));
//! ```

use crate::widening::{product, product_signed};
use core::ops::Add;
use fixed::types::{I0F32, U56F8};

/// Fractional bits of every time in this crate.
pub const FRACTION_BITS: u32 = 8;

/// A length of time, never negative, in steps of 1/256 µs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Span(U56F8);

impl Span {
    /// No time at all.
    pub const ZERO: Self = Self(U56F8::ZERO);
    /// The longest span there is, 2283 years; what a saturated sum ends in.
    pub const MAX: Self = Self(U56F8::MAX);

    /// `us` whole microseconds; more than 2^56 − 1 of them saturate.
    #[must_use]
    pub const fn from_us(us: u64) -> Self {
        Self(U56F8::from_bits(saturating_steps(us)))
    }

    /// `steps` of 1/256 µs.
    #[must_use]
    pub const fn from_steps(steps: u64) -> Self {
        Self(U56F8::from_bits(steps))
    }

    /// Steps of 1/256 µs.
    #[must_use]
    pub const fn steps(self) -> u64 {
        self.0.to_bits()
    }

    /// Whole microseconds, rounded up: for time that was used.
    #[must_use]
    pub const fn as_us_ceil(self) -> u64 {
        self.0.to_bits().div_ceil(1 << FRACTION_BITS)
    }

    /// Whole microseconds, rounded down: for time that is left.
    #[must_use]
    pub const fn as_us_floor(self) -> u64 {
        self.0.to_bits() >> FRACTION_BITS
    }

    /// `self − other`, or zero where `other` is longer.
    #[must_use]
    pub const fn saturating_sub(self, other: Self) -> Self {
        Self(self.0.saturating_sub(other.0))
    }

    /// `self × factor`, saturating.
    #[must_use]
    pub const fn saturating_mul(self, factor: u64) -> Self {
        Self(U56F8::from_bits(self.0.to_bits().saturating_mul(factor)))
    }
}

impl Add for Span {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }
}

/// An instant kind: `LocalTicks`, `PeerTicks` and `NetTime` have the same arithmetic and stay three types.
macro_rules! instant {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(U56F8);

        impl $name {
            /// The counter's origin.
            pub const ZERO: Self = Self(U56F8::ZERO);
            /// The last instant there is.
            pub const MAX: Self = Self(U56F8::MAX);

            /// The instant `us` microseconds after the origin; saturates past 2^56 − 1.
            #[must_use]
            pub const fn from_us(us: u64) -> Self {
                Self(U56F8::from_bits(saturating_steps(us)))
            }

            /// The instant `steps` of 1/256 µs after the origin.
            #[must_use]
            pub const fn from_steps(steps: u64) -> Self {
                Self(U56F8::from_bits(steps))
            }

            /// Steps of 1/256 µs since the origin.
            #[must_use]
            pub const fn steps(self) -> u64 {
                self.0.to_bits()
            }

            /// Whole microseconds since the origin, rounded down.
            #[must_use]
            pub const fn as_us(self) -> u64 {
                self.0.to_bits() >> FRACTION_BITS
            }

            /// Time from `earlier` to `self`; zero where `earlier` is the later of the two.
            #[must_use]
            pub const fn since(self, earlier: Self) -> Span {
                Span(self.0.saturating_sub(earlier.0))
            }

            /// `self − other` in steps, whichever is the later; what does not fit saturates.
            #[must_use]
            pub const fn steps_after(self, other: Self) -> i64 {
                let (between, is_before) = self.steps().overflowing_sub(other.steps());
                let between = between.cast_signed();
                match (is_before, between < 0) {
                    (false, true) => i64::MAX,
                    (true, false) => i64::MIN,
                    _ => between,
                }
            }

            /// The instant `steps` later, or earlier where they are negative; saturates at the origin and at the last instant.
            #[must_use]
            pub const fn shifted(self, steps: i64) -> Self {
                Self::from_steps(self.steps().saturating_add_signed(steps))
            }
        }

        impl Add<Span> for $name {
            type Output = Self;
            fn add(self, span: Span) -> Self {
                Self(self.0.saturating_add(span.0))
            }
        }
    };
}

instant! {
    /// A reading of one node's own free-running counter. Says nothing about any other node's.
    LocalTicks
}
instant! {
    /// A reading of a neighbour's own free-running counter, as it came in a message.
    PeerTicks
}
instant! {
    /// System time: what the network agreed on, since the root's epoch.
    NetTime
}

/// How much faster one time runs than another: 2^−32 a step (0.23 parts in 10⁹), within ±½.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Rate(I0F32);

impl Rate {
    /// As fast.
    pub const ZERO: Self = Self(I0F32::ZERO);

    /// `bits` in 2^−32.
    #[must_use]
    pub const fn from_bits(bits: i32) -> Self {
        Self(I0F32::from_bits(bits))
    }

    /// In 2^−32.
    #[must_use]
    pub const fn bits(self) -> i32 {
        self.0.to_bits()
    }

    /// Parts per 10⁹, rounded down; past ±½ it saturates.
    #[must_use]
    pub const fn from_ppb(ppb: i32) -> Self {
        // 2^32 / 10^9, in 2^−28
        const FACTOR_Q28: i64 = (1 << 60) / 1_000_000_000;
        let bits = (ppb as i64 * FACTOR_Q28) >> 28;
        Self::saturated(bits)
    }

    /// Parts per 10⁹, rounded down.
    #[must_use]
    pub const fn ppb(self) -> i32 {
        ((self.bits() as i64 * 1_000_000_000) >> 32) as i32
    }

    /// `bits` in 2^−32, cut to what there is.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "cut to 32 bits before")]
    pub const fn saturated(bits: i64) -> Self {
        let cut = if bits > i32::MAX as i64 {
            i32::MAX
        } else if bits < i32::MIN as i64 {
            i32::MIN
        } else {
            bits as i32
        };
        Self::from_bits(cut)
    }

    /// The sum, saturating: rates are small, so that the product of two is left out.
    #[must_use]
    pub const fn plus(self, other: Self) -> Self {
        Self::saturated(self.bits() as i64 + other.bits() as i64)
    }

    /// No faster and no slower than `limit` says, which is not negative.
    #[must_use]
    pub const fn within(self, limit: Self) -> Self {
        let (bits, limit) = (self.bits(), limit.bits());
        if bits > limit {
            Self::from_bits(limit)
        } else if bits < -limit {
            Self::from_bits(-limit)
        } else {
            self
        }
    }

    /// What a rate adds in `steps`, rounded down. No more than half of them, so it always fits.
    #[must_use]
    pub const fn over(self, steps: i64) -> i64 {
        let rate = self.bits();
        // in two parts of 32 × 32 bits, the upper with a sign; nearly always that is one of none or of less than none
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the two halves")]
        let (high, low) = ((steps >> 32) as i32, steps as u32);
        let lower = self.over_short(low);
        match high {
            0 => lower,
            -1 => lower - rate as i64,
            _ => lower + product_signed(high, rate),
        }
    }

    /// The same of what is not negative and short.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "most of what a map's reading costs in an interrupt")]
    pub(crate) const fn over_short(self, steps: u32) -> i64 {
        let rate = self.bits();
        // a negative rate is 2^32 less than its bits, and so 2^32 times `steps` too much comes of them
        let excess = (rate >> 31).cast_unsigned() & steps;
        (product(steps, rate.cast_unsigned()) >> 32).cast_signed() - excess as i64
    }
}

/// Microseconds to steps of 1/256 µs, ending at the largest instead of wrapping.
const fn saturating_steps(us: u64) -> u64 {
    if us > u64::MAX >> FRACTION_BITS { u64::MAX } else { us << FRACTION_BITS }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// An earlier implementation let a positive overflow saturate to the negative limit.
    #[test]
    fn overflow_saturates_to_the_side_it_left() {
        assert_eq!(LocalTicks::MAX + Span::from_us(1), LocalTicks::MAX);
        assert_eq!(Span::MAX + Span::MAX, Span::MAX);
        assert_eq!(Span::from_us(u64::MAX), Span::MAX);
        assert_eq!(NetTime::from_us(u64::MAX), NetTime::MAX);
        assert_eq!(Span::MAX.saturating_mul(2), Span::MAX);
    }

    #[test]
    fn rounding_goes_the_way_its_name_says() {
        let one_and_a_step = Span::from_steps(257);
        assert_eq!(one_and_a_step.as_us_ceil(), 2);
        assert_eq!(one_and_a_step.as_us_floor(), 1);
        assert_eq!(Span::from_steps(256).as_us_ceil(), 1);
    }

    /// Fifty parts in a million are 12,800 steps a second, forwards and backwards, and a year is no overflow.
    #[test]
    fn a_rate_adds_its_part() {
        let fifty = Rate::from_ppb(50_000);
        assert_eq!(fifty.ppb(), 49_999); // rounded down twice: 0.23 ppb a step
        let second = 256_000_000;
        assert!((12_799..=12_800).contains(&fifty.over(second)), "{}", fifty.over(second));
        assert!((-12_801..=-12_799).contains(&fifty.over(-second)), "{}", fifty.over(-second));
        let year = second * 31_557_600;
        let expected = i64::try_from((i128::from(year) * i128::from(fifty.bits())) >> 32).unwrap();
        assert!(fifty.over(year).abs_diff(expected) <= 1);
        assert_eq!(Rate::from_ppb(i32::MAX), Rate::from_bits(i32::MAX));
        // the longest product there is
        assert_eq!(Rate::from_bits(i32::MIN).over(i64::MIN), 1 << 62);
        assert_eq!(Rate::from_ppb(-40).within(Rate::from_ppb(10)), Rate::from_bits(-Rate::from_ppb(10).bits()));
    }

    proptest! {
        /// A rate's part is the exact product, rounded down.
        #[test]
        fn a_rates_part_is_the_product(bits in any::<i32>(), steps in any::<i64>()) {
            let exact = (i128::from(bits) * i128::from(steps)) >> 32;
            let exact = i64::try_from(exact).unwrap();
            prop_assert_eq!(Rate::from_bits(bits).over(steps), exact);
        }

        /// A difference in steps, added again, comes back to where it began.
        #[test]
        fn a_difference_leads_back(from in any::<u64>(), to in any::<u64>()) {
            let (from, to) = (PeerTicks::from_steps(from), PeerTicks::from_steps(to));
            let between = to.steps_after(from);
            if between != i64::MAX && between != i64::MIN {
                prop_assert_eq!(from.shifted(between), to);
            }
            prop_assert_eq!(between >= 0, to >= from);
        }

        /// Adding a span and asking for the time since gives the span back, unless it ran into the end.
        #[test]
        fn add_then_since_is_the_span(start in any::<u64>(), span in any::<u64>()) {
            let (start, span) = (LocalTicks::from_steps(start), Span::from_steps(span));
            let end = start + span;
            if end < LocalTicks::MAX {
                prop_assert_eq!(end.since(start), span);
            }
            prop_assert!(end >= start);
        }
    }
}

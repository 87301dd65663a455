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

use core::ops::Add;
use fixed::types::U56F8;

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

/// An instant kind: `LocalTicks` and `NetTime` have the same arithmetic and stay two types.
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
    /// System time: what the network agreed on, since the root's epoch.
    NetTime
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

    proptest! {
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

//! What an egress takes off a packet's time to live, and how long a packet stands on a wire.
//!
//! - **Walk:** the node's egress has a packet and a gateway that is clear to send → *this module* says what TTL goes into the header,
//!   or that the packet is late → the transmitter.
//! - **Invariant:** time used is only ever rounded up, so a packet that is late by any part of a step never looks punctual. Exact for
//!   all inputs; a sum past the end of [`Span`] stays at its end.
//! - **Context:** routing task. [`wire_time`] divides, which takes a Cortex-M0+ hundreds of cycles; [`WireRate`] does not.
//! - **Clause:** `[PKT-10]`.
//!
//! ```
//! use fixed_math::time::Span;
//! use osap_protocol::ttl::{ttl_after, wire_time};
//!
//! // 80 bytes of 10 bits at 3 Mbaud: 266.67 µs
//! let wire = wire_time(80, 10, 3_000_000);
//! assert_eq!(wire.as_us_ceil(), 267);
//! assert_eq!(ttl_after(1_000, Span::from_us(33), wire), Some(700));
//! assert_eq!(ttl_after(300, Span::from_us(33), wire), None); // 299.67 µs are used, of the 300th nothing is left
//! ```

use fixed_math::time::{FRACTION_BITS, Span};

/// Steps of 1/256 µs in a second.
const STEPS_A_SECOND: u64 = 1_000_000 << FRACTION_BITS;

/// The TTL that a packet leaves with: `ttl_us` less its time in this node and on the coming wire, their sum rounded up to whole µs.
/// `None` where nothing would be left, `[PKT-10]`: the packet has expired.
#[must_use]
pub fn ttl_after(ttl_us: u16, residence: Span, wire: Span) -> Option<u16> {
    let used_us = u16::try_from((residence + wire).as_us_ceil()).ok()?;
    ttl_us.checked_sub(used_us).filter(|left| *left > 0)
}

/// Time that `bytes` stand on a wire, rounded up to 1/256 µs. Zero at a rate of 0, which means that it is unknown, `[PKT-10]`.
#[must_use]
pub const fn wire_time(bytes: usize, bits_a_byte: u8, bit_rate: u32) -> Span {
    if bit_rate == 0 {
        return Span::ZERO;
    }
    let rate = bit_rate as u64;
    let bits = (bytes as u64).saturating_mul(bits_a_byte as u64);
    // whole seconds first, so that the product of what remains has at most 32 + 28 bits
    let seconds = bits / rate;
    let part = (bits % rate * STEPS_A_SECOND).div_ceil(rate);
    Span::from_steps(seconds.saturating_mul(STEPS_A_SECOND).saturating_add(part))
}

/// How long a byte stands on a wire, kept so that a packet's time takes a product and no division.
///
/// ```
/// use osap_protocol::ttl::{WireRate, wire_time};
///
/// assert_eq!(WireRate::new(10, 3_000_000).time(80), wire_time(80, 10, 3_000_000));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WireRate {
    /// Whole steps of 1/256 µs a byte.
    steps: u64,
    /// And parts of one, in 2^-[`RATE_BITS`], to the nearest.
    parts: u32,
}

/// Fractional bits of a [`WireRate`]: with 12 bits of length the product fits 32.
const RATE_BITS: u32 = 18;
/// Rounding up begins this far above a whole number: half a bit a byte for 4096 bytes, 2^-7 of a step, which is 30 ps. So whole numbers
/// of steps stay what they are, though the rate is only near.
const RATE_SLACK: u32 = 1 << (RATE_BITS - 7);

impl WireRate {
    /// The rate of a wire; 0 bits a second where it is unknown.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "less than 2^RATE_BITS, and one more where it is rounded up")]
    pub const fn new(bits_a_byte: u8, bit_rate: u32) -> Self {
        if bit_rate == 0 {
            return Self { steps: 0, parts: 0 };
        }
        let rate = bit_rate as u64;
        let whole = bits_a_byte as u64 * STEPS_A_SECOND;
        let parts = (((whole % rate) << RATE_BITS) + rate / 2) / rate;
        Self { steps: whole / rate, parts: parts as u32 }
    }

    /// As [`wire_time`] for up to 4096 bytes, but for 30 ps.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "compared before")]
    pub const fn time(self, bytes: usize) -> Span {
        // two products of 32 bits take a Cortex-M0+ two cycles, one of 64 takes it fifty
        if self.steps < 1 << 20 && bytes <= BYTES_MAX {
            let parts = bytes as u32 * self.parts;
            let carried = (parts + ((1 << RATE_BITS) - 1 - RATE_SLACK)) >> RATE_BITS;
            Span::from_steps((bytes as u32 * self.steps as u32 + carried) as u64)
        } else {
            Span::from_steps((bytes as u64).saturating_mul(self.steps + 1))
        }
    }
}

/// Longest frame that [`WireRate::time`] is exact for: longer ones, and wires below 2441 bits a second, are given a step a byte more.
const BYTES_MAX: usize = 4095;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// `[PKT-10]`: a sum that lost its carry would let late packets pass.
    #[test]
    fn the_end_of_the_scale_is_late_and_no_wrap() {
        assert_eq!(ttl_after(u16::MAX, Span::MAX, Span::from_steps(1)), None);
        assert_eq!(ttl_after(u16::MAX, Span::MAX, Span::MAX), None);
        assert_eq!(wire_time(usize::MAX, u8::MAX, 1), Span::MAX);
    }

    proptest! {
        /// `[PKT-10]`, against 128-bit integers.
        #[test]
        fn wire_time_is_exact_and_rounded_up(bytes in any::<u32>(), bits in any::<u8>(), rate in 1u32..) {
            let numerator = u128::from(bytes) * u128::from(bits) * 256_000_000;
            let expected = numerator.div_ceil(u128::from(rate));
            prop_assert_eq!(u128::from(wire_time(bytes as usize, bits, rate).steps()), expected);
        }

        /// `[PKT-10]`: the kept rate is off by half a bit of 2^18 a byte at the most, so where the exact time is further than twice that
        /// above a whole number of steps both round up to the same, and where it is less, to a step less at the most.
        #[test]
        fn a_kept_rate_gives_the_same_time(bytes in 0usize..4096, bits in 1u8..20, rate in 5_000u32..) {
            let numerator = bytes as u128 * u128::from(bits) * 256_000_000;
            let above = (numerator % u128::from(rate)) << 6;
            let exact = wire_time(bytes, bits, rate).steps();
            let kept = WireRate::new(bits, rate).time(bytes).steps();
            if above == 0 || above >= u128::from(rate) {
                prop_assert_eq!(kept, exact);
            } else {
                prop_assert!(kept == exact || kept + 1 == exact, "{} {}", kept, exact);
            }
        }

        /// `[PKT-10]`: outside of that it is never short of the exact time by more than the slack.
        #[test]
        fn a_kept_rate_is_never_short(bytes in any::<u16>(), bits in any::<u8>(), rate in 1u32..) {
            let exact = wire_time(usize::from(bytes), bits, rate).steps();
            prop_assert!(WireRate::new(bits, rate).time(usize::from(bytes)).steps() + 1 >= exact);
        }

        /// `[PKT-10]`: what is left and what was used never sum to more than there was, nor to a whole µs less.
        #[test]
        fn the_ttl_loses_what_was_used(ttl in any::<u16>(), residence in 0u64..20_000_000, wire in 0u64..20_000_000) {
            let (residence, wire) = (Span::from_steps(residence), Span::from_steps(wire));
            let used = (residence + wire).steps();
            match ttl_after(ttl, residence, wire) {
                Some(left) => {
                    let sum = u64::from(left) * 256 + used;
                    prop_assert!(left > 0 && sum <= u64::from(ttl) * 256 && sum + 256 > u64::from(ttl) * 256);
                }
                None => prop_assert!(ttl == 0 || used > (u64::from(ttl) - 1) * 256),
            }
        }
    }
}

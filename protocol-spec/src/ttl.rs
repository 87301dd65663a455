//! What an egress takes off a packet's time to live, and how long a packet stands on a wire.
//!
//! - **Walk:** the node's egress has a packet and a gateway that is clear to send → *this module* says what TTL goes into the header,
//!   or that the packet is late → the transmitter.
//! - **Invariant:** time used is only ever rounded up, so a packet that is late by any part of a step never looks punctual. Exact for
//!   all inputs; a sum past the end of [`Span`] stays at its end.
//! - **Context:** routing task. [`wire_time`] divides: a gateway without a hardware divider may keep its results by length.
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

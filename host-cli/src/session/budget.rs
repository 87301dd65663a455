//! Whether a route's wires leave time for an exchange, and which time to live to give it.
//!
//! - **Walk:** a map's links along a route → [`RouteBudget`] → a TTL, or a refusal with the sum.
//! - **Invariants:** a link of unknown rate counts as zero, `[PKT-10]`; times are rounded up. What is refused could not work.
//! - **Context:** any. **Clauses:** `[PKT-11]`, `[PKT-13]` (the way back is paid from the same TTL).

use crate::map::{Gateway, NetworkMap, RouteText};
use fixed_math::time::Span;
use osap_protocol::framing::{Check, encoded_len_max};
use osap_protocol::header::PORT_HEADER_BYTES;
use osap_protocol::transport::SequencedHeader;
use osap_protocol::ttl::wire_time;

/// Time to live where nothing asks for more, µs.
pub const TTL_DEFAULT_US: u16 = 50_000;

/// One link of a route.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Hop {
    bit_rate: u32,
    bits_a_byte: u8,
    check: Check,
}

impl Hop {
    fn wire_time(self, packet_bytes: usize) -> Span {
        wire_time(encoded_len_max(packet_bytes, self.check), self.bits_a_byte, self.bit_rate)
    }
}

/// Wires of a route.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RouteBudget {
    hops: Vec<Hop>,
    route_bytes: usize,
}

/// An exchange that no time to live allows, `[PKT-11]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "its {hops} links take {need_us} µs for {request_bytes} bytes there and {reply_bytes} back, and a packet lives at most {limit_us} µs. \
     Ask for less at once, or raise the rates of the links"
)]
pub struct RouteTooSlow {
    /// Links on the route.
    pub hops: usize,
    /// Length of the request's packet, bytes.
    pub request_bytes: usize,
    /// Length of the reply's packet, bytes.
    pub reply_bytes: usize,
    /// What the wires alone take, µs.
    pub need_us: u64,
    /// The longest time to live, µs.
    pub limit_us: u64,
}

impl RouteBudget {
    /// The wires along a route of the map; `None` where the map does not know all of it.
    #[must_use]
    pub fn along(map: &NetworkMap, route: &RouteText) -> Option<Self> {
        let (_, gateways) = map.follow(route)?;
        let mut budget = Self::default();
        for gateway in gateways {
            budget.push(gateway);
        }
        budget.route_bytes = route.as_route().bytes().len();
        Some(budget)
    }

    /// The same with one more link at the far end.
    #[must_use]
    pub fn with(&self, gateway: &Gateway) -> Self {
        let mut longer = self.clone();
        longer.push(gateway);
        longer.route_bytes += if matches!(gateway.kind, osap_protocol::discovery::GatewayKind::Link) { 1 } else { 2 };
        longer
    }

    fn push(&mut self, gateway: &Gateway) {
        let Gateway { bit_rate, bits_a_byte, check, .. } = *gateway;
        self.hops.push(Hop { bit_rate, bits_a_byte, check });
    }

    /// What the wires take for an exchange, µs; the lengths are those of the payloads behind the sequence number.
    #[must_use]
    pub fn exchange_us(&self, request_bytes: usize, reply_bytes: usize) -> u64 {
        let head = self.head();
        let both = |hop: &Hop| hop.wire_time(head + request_bytes) + hop.wire_time(head + reply_bytes);
        self.hops.iter().map(both).fold(Span::ZERO, |sum, span| sum + span).as_us_ceil()
    }

    /// A time to live for such an exchange: the default, or the longest where the wires take over half of that.
    ///
    /// # Errors
    /// [`RouteTooSlow`] with the sum.
    pub fn ttl_us(&self, request_bytes: usize, reply_bytes: usize) -> Result<u16, RouteTooSlow> {
        let need_us = self.exchange_us(request_bytes, reply_bytes);
        if need_us >= u64::from(u16::MAX) {
            return Err(RouteTooSlow {
                hops: self.hops.len(),
                request_bytes: self.head() + request_bytes,
                reply_bytes: self.head() + reply_bytes,
                need_us,
                limit_us: u64::from(u16::MAX),
            });
        }
        Ok(if need_us > u64::from(TTL_DEFAULT_US / 2) { u16::MAX } else { TTL_DEFAULT_US })
    }

    fn head(&self) -> usize {
        PORT_HEADER_BYTES + self.route_bytes + SequencedHeader::LEN
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn budget(rates: &[u32]) -> RouteBudget {
        let hops = rates.iter().map(|rate| Hop { bit_rate: *rate, bits_a_byte: 10, check: Check::Crc16 });
        RouteBudget { hops: hops.collect(), route_bytes: rates.len() }
    }

    /// `[PKT-11]`, worked by hand: 11 + 1 + 8 bytes of packet, 2 of check, 1 of stuffing and a delimiter are 24 of 10 bits. At
    /// 9600 bit/s that is 25 ms each way.
    #[test]
    fn the_sum_of_the_wires_is_told() {
        let slow = budget(&[9_600]);
        assert_eq!(slow.exchange_us(8, 8), 50_000);
        assert_eq!(slow.ttl_us(8, 8), Ok(u16::MAX));
        let error = slow.ttl_us(64, 64).unwrap_err();
        assert_eq!((error.need_us, error.request_bytes, error.limit_us), (166_667, 76, 65_535));
        assert!(error.to_string().contains("166667 µs"), "{error}");
    }

    #[test]
    fn unknown_rates_count_as_nothing_and_fast_ones_get_the_default() {
        assert_eq!(budget(&[0, 0]).exchange_us(200, 200), 0);
        assert_eq!(budget(&[3_000_000; 4]).ttl_us(64, 64), Ok(TTL_DEFAULT_US));
    }
}

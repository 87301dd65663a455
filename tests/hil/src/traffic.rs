//! Payloads that prove themselves: each has its direction, its number, a drawn length and a CRC-32 of its own.
//!
//! - **Walk:** [`Traffic::feed`] keeps both links of a host busy → packets through a hub → [`Traffic::take`] checks what came back.
//! - **Invariants:** a payload is a pure function of seed, direction and number, so that what comes is compared with what went. Each
//!   direction's link is given the next packet in the instant in which it is free.
//! - **Context:** a [`Task`](osap::network::Task) at the host's core.

use fixed_math::time::LocalTicks;
use osap::core::HostCore;
use osap_protocol::framing::Check;
use osap_protocol::header::PORT_HEADER_BYTES;
use osap_protocol::{GatewayIndex, RouteBuf};
use osap_runtime::sequenced::Destination;
use osap_sim::endpoint::Endpoint;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Begins each payload.
const MARK: [u8; 4] = *b"soak";
/// Mark, direction, number, check.
const OVERHEAD_BYTES: usize = 13;
/// The longest payload: a packet of 256 bytes over two links.
const PAYLOAD_BYTES_MAX: usize = 256 - PORT_HEADER_BYTES - 2;
/// Time to live of a packet, µs.
const TTL_US: u16 = 50_000;

/// One direction's figures.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Direction {
    /// Packets that the host's node took.
    pub sent: u32,
    /// Packets that came, once each and as they were sent.
    pub delivered: u32,
    /// Payload bytes of these.
    pub delivered_bytes: u64,
    /// Packets that came again.
    pub twice: u32,
    seen: Vec<bool>,
}

/// What goes both ways through a hub.
#[derive(Debug)]
pub struct Traffic {
    seed: u64,
    destinations: [Destination; 2],
    /// From the host's link 0 to its link 1, and the other way.
    pub directions: [Direction; 2],
    /// Payloads that are none of ours.
    pub wrong: u32,
}

impl Traffic {
    /// Traffic between links 0 and 1 of a host, both at one hub; `routes` lead from each to the other.
    #[must_use]
    pub fn new(seed: u64, routes: [RouteBuf; 2], core_port: osap_protocol::PortIndex) -> Self {
        let destinations = routes.map(|route| Destination { route, mtu_bytes: 256, ttl_us: TTL_US, port: core_port });
        Self { seed, destinations, directions: Default::default(), wrong: 0 }
    }

    /// Gives each link that has nothing to send its next packet.
    pub fn feed(&mut self, core: &mut HostCore, now: LocalTicks) {
        for way in 0..2 {
            if core.has_output(GatewayIndex::from_low_bits(way), now) {
                continue;
            }
            let direction = &mut self.directions[usize::from(way)];
            let payload = payload(self.seed, way, direction.sent);
            if core.send_datagram(&self.destinations[usize::from(way)], &payload, now).is_ok() {
                direction.sent += 1;
                direction.seen.push(false);
            }
        }
    }

    /// Takes and checks what came.
    pub fn take(&mut self, core: &mut HostCore) {
        while let Some(datagram) = core.take_datagram() {
            self.check(&datagram.payload);
        }
    }

    fn check(&mut self, came: &[u8]) {
        let Some((way, number)) = read(came).filter(|(way, number)| payload(self.seed, *way, *number) == came) else {
            self.wrong += 1;
            return;
        };
        let direction = &mut self.directions[usize::from(way)];
        match direction.seen.get_mut(usize::try_from(number).unwrap_or(usize::MAX)) {
            Some(seen) if !*seen => {
                *seen = true;
                direction.delivered += 1;
                direction.delivered_bytes += came.len() as u64;
            }
            Some(_) => direction.twice += 1,
            None => self.wrong += 1,
        }
    }
}

/// Whether a packet is one of these.
#[must_use]
pub fn is_ours(packet: &[u8]) -> bool {
    packet.get(PORT_HEADER_BYTES + 2..).is_some_and(|payload| read(payload).is_some())
}

/// Direction and number of a payload whose check is right.
fn read(payload: &[u8]) -> Option<(u8, u32)> {
    let (body, check) = payload.split_last_chunk::<4>()?;
    let is_whole = Check::Crc32.of(body) == u32::from_le_bytes(*check);
    let (mark, rest) = body.split_first_chunk::<4>()?;
    let (way, rest) = rest.split_first()?;
    let number = u32::from_le_bytes(*rest.first_chunk::<4>()?);
    (is_whole && *mark == MARK && *way < 2).then_some((*way, number))
}

/// Payload `number` of a direction.
fn payload(seed: u64, way: u8, number: u32) -> Vec<u8> {
    let mut random = Pcg64Mcg::seed_from_u64(seed ^ u64::from(number) << 8 ^ u64::from(way));
    let filling = random.random_range(0..=PAYLOAD_BYTES_MAX - OVERHEAD_BYTES);
    let mut body = [&MARK[..], &[way], &number.to_le_bytes()].concat();
    body.extend(std::iter::repeat_with(|| random.random::<u8>()).take(filling));
    body.extend(Check::Crc32.of(&body).to_le_bytes());
    body
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_payload_says_who_it_is_and_a_changed_one_is_wrong() {
        let port = osap_protocol::PortIndex::from_low_bits(2);
        let mut traffic = Traffic::new(7, [RouteBuf::new(), RouteBuf::new()], port);
        traffic.directions[1] = Direction { sent: 1, seen: vec![false], ..Direction::default() };
        let good = payload(7, 1, 0);
        assert_eq!(read(&good), Some((1, 0)));
        traffic.check(&good);
        traffic.check(&good);
        assert_eq!((traffic.directions[1].delivered, traffic.directions[1].twice, traffic.wrong), (1, 1, 0));
        for at in 0..good.len() {
            let mut bad = good.clone();
            bad[at] ^= 1;
            traffic.check(&bad);
        }
        assert_eq!(traffic.wrong as usize, good.len());
        traffic.check(&payload(8, 1, 0));
        assert_eq!(traffic.wrong as usize, good.len() + 1, "of another run");
        let longest = (0..2_000).map(|number| payload(7, 0, number).len()).max();
        assert_eq!(longest, Some(PAYLOAD_BYTES_MAX));
    }
}

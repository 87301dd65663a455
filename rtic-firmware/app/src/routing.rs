//! What every image's routing task does, whatever its links are made of.
//!
//! - **Walk:** a frame came, a frame left, a service answered or a wake-up came → [`route`] → links in, node, links out → [`Next`].
//! - **Invariants:** one call leaves nothing to do that could be done at `now`; what could not waits for an event that runs the task
//!   again, or for [`Next::wake`], which is never past.
//! - **Context:** the routing task, with the node locked; O(bytes and packets that wait). **Clauses:** `[NOD-06]`, `[NOD-12]`.
//!
//! ```
//! use firmware_app::routing::{WAKE_US_MAX, route};
//! use firmware_app::{Device, kind};
//! use fixed_math::time::LocalTicks;
//! use osap_protocol::discovery::{BuildKind, UniqueId};
//!
//! let motor = Device::<8, 256, 1, 5, 1024>::new(&kind::MOTOR, UniqueId([1; 12]), 1, BuildKind::Firmware, "a").unwrap();
//! let (mut node, _services) = motor.into_parts();
//! let next = route(&mut node, &mut (), None, LocalTicks::ZERO); // no links
//! assert_eq!((next.wake.as_us(), next.serve), (WAKE_US_MAX, false));
//! ```

use crate::link::{Link, Wire};
use fixed_math::time::{LocalTicks, Span};
use osap_protocol::PortIndex;
use osap_runtime::Node;

/// Longest time without a call, µs: a watchdog is fed by it, and a clock kept.
pub const WAKE_US_MAX: u64 = 100_000;

/// The links of an image: one, an array of one kind, or a pair of such.
pub trait Links<const SLOTS: usize, const BYTES: usize, const GATEWAYS: usize, const PORTS: usize> {
    /// [`Link::receive`] for each; whether a frame ended at any.
    fn receive(&mut self, node: &mut Node<SLOTS, BYTES, GATEWAYS, PORTS>, now: LocalTicks) -> bool;

    /// [`Link::transmit`] for each.
    fn transmit(&mut self, node: &mut Node<SLOTS, BYTES, GATEWAYS, PORTS>, now: LocalTicks);

    /// The earliest [`Link::next_wake`].
    fn next_wake(&self) -> Option<LocalTicks>;
}

impl<const SLOTS: usize, const BYTES: usize, const GATEWAYS: usize, const PORTS: usize>
    Links<SLOTS, BYTES, GATEWAYS, PORTS> for ()
{
    fn receive(&mut self, _: &mut Node<SLOTS, BYTES, GATEWAYS, PORTS>, _: LocalTicks) -> bool {
        false
    }

    fn transmit(&mut self, _: &mut Node<SLOTS, BYTES, GATEWAYS, PORTS>, _: LocalTicks) {}

    fn next_wake(&self) -> Option<LocalTicks> {
        None
    }
}

impl<W: Wire, const SLOTS: usize, const BYTES: usize, const GATEWAYS: usize, const PORTS: usize, const FRAME: usize>
    Links<SLOTS, BYTES, GATEWAYS, PORTS> for Link<W, BYTES, FRAME>
{
    fn receive(&mut self, node: &mut Node<SLOTS, BYTES, GATEWAYS, PORTS>, now: LocalTicks) -> bool {
        Self::receive(self, node, now)
    }

    fn transmit(&mut self, node: &mut Node<SLOTS, BYTES, GATEWAYS, PORTS>, now: LocalTicks) {
        Self::transmit(self, node, now);
    }

    fn next_wake(&self) -> Option<LocalTicks> {
        Self::next_wake(self)
    }
}

impl<
    L: Links<SLOTS, BYTES, GATEWAYS, PORTS>,
    const LINKS: usize,
    const SLOTS: usize,
    const BYTES: usize,
    const GATEWAYS: usize,
    const PORTS: usize,
> Links<SLOTS, BYTES, GATEWAYS, PORTS> for [L; LINKS]
{
    fn receive(&mut self, node: &mut Node<SLOTS, BYTES, GATEWAYS, PORTS>, now: LocalTicks) -> bool {
        self.iter_mut().fold(false, |ended, link| link.receive(node, now) | ended)
    }

    fn transmit(&mut self, node: &mut Node<SLOTS, BYTES, GATEWAYS, PORTS>, now: LocalTicks) {
        for link in self {
            link.transmit(node, now);
        }
    }

    fn next_wake(&self) -> Option<LocalTicks> {
        self.iter().filter_map(L::next_wake).min()
    }
}

impl<
    A: Links<SLOTS, BYTES, GATEWAYS, PORTS>,
    B: Links<SLOTS, BYTES, GATEWAYS, PORTS>,
    const SLOTS: usize,
    const BYTES: usize,
    const GATEWAYS: usize,
    const PORTS: usize,
> Links<SLOTS, BYTES, GATEWAYS, PORTS> for (A, B)
{
    fn receive(&mut self, node: &mut Node<SLOTS, BYTES, GATEWAYS, PORTS>, now: LocalTicks) -> bool {
        self.0.receive(node, now) | self.1.receive(node, now)
    }

    fn transmit(&mut self, node: &mut Node<SLOTS, BYTES, GATEWAYS, PORTS>, now: LocalTicks) {
        self.0.transmit(node, now);
        self.1.transmit(node, now);
    }

    fn next_wake(&self) -> Option<LocalTicks> {
        [self.0.next_wake(), self.1.next_wake()].into_iter().flatten().min()
    }
}

/// What follows from one turn of routing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Next {
    /// When to run again even if nothing happens; after `now`, by [`WAKE_US_MAX`] at most.
    pub wake: LocalTicks,
    /// Whether the serving task has something to do.
    pub serve: bool,
}

/// One turn: all that came goes in, all that can leave goes out. `services_wake` is what
/// [`Services::next_wake`](crate::Services::next_wake) said last.
pub fn route<const SLOTS: usize, const BYTES: usize, const GATEWAYS: usize, const PORTS: usize>(
    node: &mut Node<SLOTS, BYTES, GATEWAYS, PORTS>,
    links: &mut impl Links<SLOTS, BYTES, GATEWAYS, PORTS>,
    services_wake: Option<LocalTicks>,
    now: LocalTicks,
) -> Next {
    let _ended = links.receive(node, now);
    forward(node, links, services_wake, now)
}

/// The rest of a turn, after [`Links::receive`], for an image whose routing task is also woken by pieces of frames: it leaves this out
/// where none ended and nothing else woke it.
pub fn forward<const SLOTS: usize, const BYTES: usize, const GATEWAYS: usize, const PORTS: usize>(
    node: &mut Node<SLOTS, BYTES, GATEWAYS, PORTS>,
    links: &mut impl Links<SLOTS, BYTES, GATEWAYS, PORTS>,
    services_wake: Option<LocalTicks>,
    now: LocalTicks,
) -> Next {
    node.run(now);
    links.transmit(node, now);
    let services_due = services_wake.is_some_and(|at| at <= now) | node.take_halt_news();
    let is_waited_for = |port| PortIndex::new(port).is_some_and(|port| node.waiting(port) > 0);
    let mut services = (1..).take(PORTS - 1);
    // what is past could not be done now, for want of room on a wire or of time for a service: what frees it runs this again
    let wakes = [node.next_wake(), services_wake, links.next_wake()].into_iter().flatten().filter(|at| *at > now);
    Next {
        wake: wakes.fold(now + Span::from_us(WAKE_US_MAX), LocalTicks::min),
        serve: services_due || services.any(is_waited_for),
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::{Device, kind};
    use osap_protocol::discovery::{BuildKind, GatewayKind, UniqueId};
    use osap_protocol::framing::{Check, encode};
    use osap_protocol::header::{Terminal, emit};
    use osap_protocol::transport::Transport;
    use osap_protocol::{GatewayIndex, RouteBuf, Step};
    use osap_runtime::{GatewayConfig, Stamps};
    use std::vec::Vec;

    const CHECK: Check = Check::Crc16;

    /// A wire that keeps what it was given, and has room while `clear`.
    struct TestWire {
        came: Vec<u8>,
        left: Vec<Vec<u8>>,
        room: [u8; 80],
        clear: bool,
    }

    impl Wire for TestWire {
        fn drain(&mut self, _now: LocalTicks, mut take: impl FnMut(&[u8], LocalTicks)) {
            for byte in self.came.drain(..) {
                take(&[byte], LocalTicks::ZERO);
            }
        }

        fn take_overruns(&mut self) -> u32 {
            0
        }

        fn clear_at(&mut self, now: LocalTicks) -> Option<LocalTicks> {
            self.clear.then_some(now)
        }

        fn room(&mut self) -> &mut [u8] {
            &mut self.room
        }

        fn send(&mut self, len: usize, _at: LocalTicks) {
            self.left.push(self.room[..len].to_vec());
        }
    }

    /// What comes by one link leaves by the other within one turn; what waits for a wire or a service sets no alarm in the past.
    #[test]
    fn a_turn_does_all_that_can_be_done() {
        let device = Device::<8, 64, 2, 4, 64>::new(&kind::HUB, UniqueId([1; 12]), 1, BuildKind::Firmware, "h");
        let (mut node, _) = device.unwrap().into_parts();
        let config = GatewayConfig {
            type_name: "test",
            kind: GatewayKind::Link,
            mtu_bytes: 64,
            bit_rate: 0,
            bits_a_byte: 8,
            check: CHECK,
            packet_hold_max: 4,
            stamps: Stamps::SOFTWARE,
        };
        let mut links = [true, false].map(|clear| {
            let wire = TestWire { came: Vec::new(), left: Vec::new(), room: [0; 80], clear };
            Link::<_, 64, 66>::new(wire, config, &mut node).unwrap()
        });
        let us = LocalTicks::from_us;
        let next = route(&mut node, &mut links, None, us(1));
        assert_eq!((links[0].wire().left.len(), links[1].wire().left.len()), (1, 0), "announced where there is room");
        assert!(next.wake > us(1) && next.wake <= us(1 + WAKE_US_MAX) && !next.serve);

        links[1].wire().clear = true;
        for to_port in [false, true] {
            let mut packet = [0; 64];
            let mut route_there = RouteBuf::new();
            route_there.push(Step::Link(GatewayIndex::new(0).unwrap())).unwrap();
            if !to_port {
                route_there.push(Step::Link(GatewayIndex::new(1).unwrap())).unwrap();
            }
            let (source, destination) = (PortIndex::new(1).unwrap(), PortIndex::new(1).unwrap());
            let terminal = Terminal::Port { source, destination, transport: Transport::Datagram.key() };
            let at = emit(&mut packet, 50_000, 64, route_there.as_route(), terminal).unwrap();
            let mut framed = [0; 80];
            let len = encode(&packet[..at], CHECK, &mut framed).unwrap();
            links[0].wire().came.extend_from_slice(&framed[..len]);
        }
        let next = route(&mut node, &mut links, Some(us(5)), us(10));
        assert_eq!(links[1].wire().left.len(), 2, "an announcement, and what was forwarded");
        assert!(next.serve && next.wake > us(10));
        assert!(route(&mut node, &mut (), Some(us(20)), us(20)).serve, "a service is due");
        let mut elsewhere = [(); 0];
        assert_eq!(route(&mut node, &mut elsewhere, Some(us(40)), us(30)).wake, us(40));
    }
}

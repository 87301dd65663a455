//! A device: a node, its kind, and the services behind its ports.
//!
//! - **Walk:** link → [`Device::receive`] → [`Device::route`] (queries, expiries) → [`Device::serve`] (ports) → [`Device::transmit`] → link.
//! - **Invariants:** ports from 1 on are those of the kind's table, in its order. `route` runs no port's service, so that a service that
//!   takes its time delays no packet of others.
//! - **Context:** `route` in the routing task, `serve` in a task below it; both bounded by the packets that wait. Where those are two
//!   tasks, an image holds the two halves apart: see [`Device::into_parts`].
//! - **Clauses:** `[APP-01]`, `[DSC-05]`.
//!
//! ```
//! use firmware_app::{Device, kind};
//! use fixed_math::time::LocalTicks;
//! use osap_protocol::discovery::{BuildKind, UniqueId};
//!
//! // 16 slots of 256 bytes, 1 gateway, 5 ports, messages of up to 1024 bytes
//! let mut motor =
//!     Device::<16, 256, 1, 5, 1024>::new(&kind::MOTOR, UniqueId([1; 12]), 1, BuildKind::Firmware, "a").unwrap();
//! motor.run(LocalTicks::ZERO);
//! assert_eq!(motor.node().identity().type_name, "motor");
//! // no gateway is open and no packet waits; what is due is that it settles as the root of its own time
//! assert_eq!(motor.next_wake(), Some(LocalTicks::from_us(250_000)));
//! ```

use crate::kind::Kind;
use crate::motion::MotionService;
use crate::services::Services;
use fixed_math::time::LocalTicks;
use osap_protocol::discovery::{BuildKind, UniqueId};
use osap_protocol::header::Arrival;
use osap_protocol::{DropCause, GatewayIndex, PortIndex};
use osap_runtime::{Identity, Node, Outgoing};

/// A device whose node has `SLOTS` packets of `BYTES` bytes, up to `GATEWAYS` gateways and `PORTS` ports, and which takes messages of
/// up to `MESSAGE_BYTES` bytes.
#[derive(Debug)]
pub struct Device<
    const SLOTS: usize,
    const BYTES: usize,
    const GATEWAYS: usize,
    const PORTS: usize,
    const MESSAGE_BYTES: usize,
> {
    node: Node<SLOTS, BYTES, GATEWAYS, PORTS>,
    services: Services<BYTES, MESSAGE_BYTES>,
}

/// A kind's ports do not fit a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooManyPorts {
    /// Ports the kind needs, the netresponder included.
    pub need: usize,
    /// Ports the node can have.
    pub have: usize,
}

impl<const SLOTS: usize, const BYTES: usize, const GATEWAYS: usize, const PORTS: usize, const MESSAGE_BYTES: usize>
    Device<SLOTS, BYTES, GATEWAYS, PORTS, MESSAGE_BYTES>
{
    /// A device of `kind` with its ports and no gateways yet.
    ///
    /// # Errors
    /// [`TooManyPorts`] where the kind has more than `PORTS` less one.
    pub fn new(
        kind: &'static Kind,
        unique_id: UniqueId,
        boot_epoch: u32,
        build: BuildKind,
        name: &str,
    ) -> Result<Self, TooManyPorts> {
        let identity = Identity { type_name: kind.type_name, unique_id, boot_epoch, version: kind.version, build };
        let mut node = Node::new(identity, name);
        for port in kind.ports {
            node.add_port(port.config()).ok_or(TooManyPorts { need: kind.ports.len() + 1, have: PORTS })?;
        }
        Ok(Self { node, services: Services::new(kind) })
    }

    /// As [`Services::set_motion`].
    pub fn set_motion(&mut self, motion: MotionService) {
        self.services.set_motion(motion);
    }

    /// The node for the routing task and the services for the task below it.
    #[must_use]
    pub fn into_parts(self) -> (Node<SLOTS, BYTES, GATEWAYS, PORTS>, Services<BYTES, MESSAGE_BYTES>) {
        (self.node, self.services)
    }

    /// The node.
    #[must_use]
    pub const fn node(&self) -> &Node<SLOTS, BYTES, GATEWAYS, PORTS> {
        &self.node
    }

    /// The node, to add gateways to or to open them.
    pub const fn node_mut(&mut self) -> &mut Node<SLOTS, BYTES, GATEWAYS, PORTS> {
        &mut self.node
    }

    /// What kind of device it is.
    #[must_use]
    pub const fn kind(&self) -> &'static Kind {
        self.services.kind()
    }

    /// As [`Node::receive`].
    ///
    /// # Errors
    /// The cause of the packet's drop, already counted.
    pub fn receive(
        &mut self,
        arrival: Arrival,
        packet: &mut [u8],
        started: LocalTicks,
        now: LocalTicks,
    ) -> Result<(), DropCause> {
        self.node.receive(arrival, packet, started, now)
    }

    /// What the network itself wants done: answers queries, drops what expired, notices neighbours gone.
    pub fn route(&mut self, now: LocalTicks) {
        self.node.run(now);
    }

    /// What the ports have to do: at most as many packets as wait when it is called, then what is due.
    pub fn serve(&mut self, now: LocalTicks) {
        self.services.serve(&mut self.node, now);
    }

    /// [`Device::route`] and [`Device::serve`], where there is one task for both.
    pub fn run(&mut self, now: LocalTicks) {
        self.route(now);
        self.serve(now);
    }

    /// As [`Node::transmit`].
    pub fn transmit(&mut self, gateway: GatewayIndex, now: LocalTicks, out: &mut [u8]) -> Option<Outgoing> {
        self.node.transmit(gateway, now, out)
    }

    /// As [`Node::has_output`].
    #[must_use]
    pub fn has_output(&self, gateway: GatewayIndex, now: LocalTicks) -> bool {
        self.node.has_output(gateway, now)
    }

    /// Packets that wait for [`Device::route`] to answer them.
    #[must_use]
    pub fn queries_waiting(&self) -> usize {
        self.node.waiting(PortIndex::NETRESPONDER)
    }

    /// Packets that wait for [`Device::serve`], and one for each service that is due to send.
    #[must_use]
    pub fn services_waiting(&self, now: LocalTicks) -> usize {
        self.services.ports().map(|port| self.node.waiting(port)).sum::<usize>() + self.services.due(now)
    }

    /// When [`Device::route`] or [`Device::serve`] has something to do even if no packet comes.
    #[must_use]
    pub fn next_wake(&self) -> Option<LocalTicks> {
        [self.node.next_wake(), self.services.next_wake()].into_iter().flatten().min()
    }

    /// The new name, once after each renaming, to be written to non-volatile memory, `[DSC-05]`.
    pub fn take_new_name(&mut self) -> Option<&str> {
        self.node.take_new_name()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kind;
    use crate::stream::{BURST_MAX, StreamAnswer, StreamHead, StreamRequest};
    use osap_protocol::discovery::{GatewayKind, Query, VERSION};
    use osap_protocol::framing::Check;
    use osap_protocol::header::{PORT_HEADER_BYTES, Terminal, emit};
    use osap_protocol::transport::Transport;
    use osap_protocol::{RouteBuf, Step};
    use osap_runtime::{GatewayConfig, Stamps};

    type Motor = Device<16, 256, 1, 5, 1024>;

    const LINK: GatewayIndex = GatewayIndex::new(0).unwrap();
    const LINK_CONFIG: GatewayConfig = GatewayConfig {
        type_name: "test",
        kind: GatewayKind::Link,
        mtu_bytes: 256,
        bit_rate: 0,
        bits_a_byte: 8,
        check: Check::None,
        packet_hold_max: 8,
        stamps: Stamps::SOFTWARE,
    };

    /// An open motor that has announced itself.
    fn motor() -> Motor {
        let mut motor = Motor::new(&kind::MOTOR, UniqueId([1; 12]), 1, BuildKind::Firmware, "m").unwrap();
        motor.node_mut().add_gateway(LINK_CONFIG).unwrap();
        motor.node_mut().set_open(LINK, true, LocalTicks::ZERO);
        assert!(next_out(&mut motor, LocalTicks::ZERO).is_some());
        motor
    }

    /// What the motor sends next: length and bytes.
    fn next_out(motor: &mut Motor, now: LocalTicks) -> Option<([u8; 256], usize)> {
        let mut out = [0; 256];
        let outgoing = motor.transmit(LINK, now, &mut out)?;
        Some((out, outgoing.len))
    }

    fn give(motor: &mut Motor, port: u16, transport: Transport, payload: &[u8], now: LocalTicks) {
        let mut packet = [0; 256];
        let mut route = RouteBuf::new();
        route.push(Step::Link(LINK)).unwrap();
        let (source, destination) = (PortIndex::new(9).unwrap(), PortIndex::new(port).unwrap());
        let terminal = Terminal::Port { source, destination, transport: transport.key() };
        let at = emit(&mut packet, 50_000, 256, route.as_route(), terminal).unwrap();
        packet[at..at + payload.len()].copy_from_slice(payload);
        motor.receive(Arrival::Link(LINK), &mut packet[..at + payload.len()], now, now).unwrap();
    }

    /// Routing answers the network's queries and leaves ports to the task below it.
    #[test]
    fn route_serves_no_port() {
        let mut motor = motor();
        let now = LocalTicks::from_us(100);
        give(&mut motor, 1, Transport::Datagram, b"echo", now);
        give(&mut motor, 0, Transport::Sequenced, &[1, 0, Query::TypeName.key(), VERSION], now);
        assert_eq!((motor.queries_waiting(), motor.services_waiting(now)), (1, 1));
        motor.route(now);
        assert_eq!((motor.queries_waiting(), motor.services_waiting(now)), (0, 1));
        let (answer, len) = next_out(&mut motor, now).unwrap();
        assert_eq!(answer[len - 6..len], *b"\x05motor");
        assert!(next_out(&mut motor, now).is_none());
        motor.serve(now);
        let (echo, len) = next_out(&mut motor, now).unwrap();
        assert_eq!(echo[len - 4..len], *b"echo");
        assert_eq!(motor.node().free_slots(), 16);
    }

    /// `[APP-05]`, `[APP-09]`, `[NOD-12]`: a call that comes twenty intervals late makes a burst, sheds the rest, and the next datagram is
    /// due where it always was.
    #[test]
    fn a_late_call_sheds_what_it_missed() {
        let mut motor = motor();
        let us = |us| LocalTicks::from_us(us);
        let request = StreamRequest { interval_us: 1_000, payload_bytes: 12, count: 100, ttl_us: 9_000 };
        give(&mut motor, 2, Transport::Sequenced, &asked(7, &request), us(100));
        motor.serve(us(100));
        assert_eq!(motor.next_wake(), Some(us(1_100)));
        assert_eq!(numbers(&mut motor, us(100)), [Some(0), None, None, None, None]);

        motor.serve(us(20_150)); // due were 1,100 to 20,100: numbers 1 to 20
        assert_eq!(motor.services.next_wake(), Some(us(21_100)));
        assert_eq!(BURST_MAX, 4);
        assert_eq!(numbers(&mut motor, us(20_150)), [Some(1), Some(2), Some(3), Some(4), None]);
        motor.serve(us(21_100));
        assert_eq!(numbers(&mut motor, us(21_100)), [Some(21), None, None, None, None]);

        let stop = StreamRequest { count: 0, ..request };
        give(&mut motor, 2, Transport::Sequenced, &asked(8, &stop), us(21_200));
        motor.serve(us(21_200));
        let (answer, len) = next_out(&mut motor, us(21_200)).unwrap();
        let answer = StreamAnswer::decode(&answer[len - StreamAnswer::LEN..len]);
        assert_eq!(answer, Some(StreamAnswer { sent: 6, shed: 16 }));
        assert_eq!(motor.services.next_wake(), None);
    }

    /// Numbers of the datagrams that leave now; replies are passed over.
    fn numbers(motor: &mut Motor, now: LocalTicks) -> [Option<u32>; 5] {
        let mut numbers = [None; 5];
        let mut count = 0;
        while let Some((packet, len)) = next_out(motor, now) {
            let head = PORT_HEADER_BYTES + 1;
            if packet[head - 1] == Transport::Datagram.key() {
                numbers[count] = StreamHead::decode(&packet[head..len]).map(|head| head.number);
                count += 1;
            }
        }
        numbers
    }

    /// A request behind its sequence number.
    fn asked(sequence: u8, request: &StreamRequest) -> [u8; 14] {
        let mut out = [0; 14];
        out[0] = sequence;
        out[2..].copy_from_slice(&request.encode());
        out
    }
}

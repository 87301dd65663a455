//! Commands beside telemetry at 120 % of a 300 kB/s link, in virtual time, against the same commands on an idle link.
//!
//! A source node has a telemetry port and a command port. Both go over one fast link into a hub and on over a UART of 3 Mbaud (300 kB/s) to
//! a device, so that they share the hub's hold as well as the wire. Each command is a sequenced request that the device answers; its round
//! trip is taken at the source. Processing takes no time here: what is measured is what waiting for the link and the holds costs.

use fixed_math::time::{LocalTicks, Span};
use osap_protocol::discovery::{BuildKind, GatewayKind, UniqueId};
use osap_protocol::framing::Check;
use osap_protocol::header::Arrival;
use osap_protocol::transport::{Sequence, SequencedHeader, SequencedKind, Transport};
use osap_protocol::{DropCause, GatewayIndex, PortIndex, RouteBuf, Step};
use osap_runtime::{GatewayConfig, Identity, Mailbox, Node, Outbound, PortConfig, SendError, Stamps};

type OverloadNode = Node<24, 256, 2, 4>;

/// Bytes of a telemetry packet's payload: with header 10 or 11, CRC 2, COBS 1 and delimiter 1 it takes 64 bytes on the UART.
const TELEMETRY_BYTES: usize = 49;
const TELEMETRY_FRAME_BYTES: u64 = 64;
/// The link under test carries 300 kB/s.
const LINK_BYTES_A_SECOND: u64 = 300_000;
/// Commands a second.
const COMMANDS_A_SECOND: u64 = 500;
const COMMAND_BYTES: usize = 12;
const COMMAND_TTL_US: u16 = 5_000;
const TELEMETRY_TTL_US: u16 = 50_000;

/// What came of one case.
#[derive(Default)]
struct Outcome {
    commands: u64,
    answered: u64,
    telemetry_offered: u64,
    telemetry_arrived: u64,
    displaced: u32,
    round_trips_us: Vec<u64>,
}

/// Prints idle and overloaded rows.
pub(crate) fn run(seconds: u64) {
    println!(
        "commands ({COMMANDS_A_SECOND}/s, {COMMAND_BYTES} B, answered) beside telemetry on a 300 kB/s link behind a hub, {seconds} virtual seconds a row"
    );
    println!(
        "{:<16}{:>10}{:>8}{:>9}{:>9}{:>9}{:>12}{:>10}{:>11}",
        "telemetry", "commands", "lost", "p50 µs", "p99 µs", "max µs", "arrived/s", "shed/s", "displaced"
    );
    for percent in [0, 50, 90, 120, 200] {
        let mut it = Cell::new().run(seconds, percent);
        it.round_trips_us.sort_unstable();
        let last = it.round_trips_us.len().saturating_sub(1);
        let quantile = |q: usize| it.round_trips_us.get(last * q / 100).copied().unwrap_or(0);
        println!(
            "{:<16}{:>10}{:>8}{:>9}{:>9}{:>9}{:>12}{:>10}{:>11}",
            format!("{percent} % of link"),
            it.commands,
            it.commands - it.answered,
            quantile(50),
            quantile(99),
            quantile(100),
            it.telemetry_arrived / seconds,
            (it.telemetry_offered - it.telemetry_arrived) / seconds,
            it.displaced,
        );
    }
    println!("one telemetry frame takes {} µs on the wire", TELEMETRY_FRAME_BYTES * 1_000_000 / LINK_BYTES_A_SECOND);
}

/// A frame on its way.
struct Flight {
    packet: Vec<u8>,
    started: LocalTicks,
    ends_us: u64,
}

/// Source, hub, device and the two links between them.
struct Cell {
    nodes: Box<[OverloadNode]>,
    /// Frames under way, one a wire: source→hub, hub→source, hub→device, device→hub.
    wires: [Option<Flight>; 4],
    to_device: RouteBuf,
}

/// From node and gateway, to node and gateway, of each wire.
const WIRES: [(usize, u8, usize, u8); 4] = [(0, 0, 1, 0), (1, 0, 0, 0), (1, 1, 2, 0), (2, 0, 1, 1)];
const TELEMETRY: PortIndex = PortIndex::from_low_bits(1);
const COMMANDS: PortIndex = PortIndex::from_low_bits(2);

impl Cell {
    fn new() -> Self {
        let uart = GatewayConfig {
            type_name: "uart",
            kind: GatewayKind::Link,
            mtu_bytes: 256,
            bit_rate: 3_000_000,
            bits_a_byte: 10,
            check: Check::Crc16,
            packet_hold_max: 4,
            stamps: Stamps::SOFTWARE,
        };
        let usb =
            GatewayConfig { type_name: "usb-cdc", bit_rate: 480_000_000, bits_a_byte: 8, check: Check::None, ..uart };
        let mut to_device = RouteBuf::new();
        for gateway in [0, 1] {
            let _fits = to_device.push(Step::Link(GatewayIndex::from_low_bits(gateway)));
        }
        let nodes = vec![node(1, &[usb]), node(2, &[usb, uart]), node(3, &[uart])].into_boxed_slice();
        Self { nodes, wires: [const { None }; 4], to_device }
    }

    fn run(mut self, seconds: u64, telemetry_percent: u64) -> Outcome {
        let mut it = Outcome::default();
        let command_every = 1_000_000 / COMMANDS_A_SECOND;
        // telemetry owed, in bytes · 10⁸: exact, so that 120 % is 120 %
        let frame = TELEMETRY_FRAME_BYTES * 100_000_000;
        let mut owed = 0;
        // the last commands get time to be answered
        let last_command = (seconds * 1_000_000).saturating_sub(20_000);
        for now_us in 1..=seconds * 1_000_000 {
            owed += LINK_BYTES_A_SECOND * telemetry_percent;
            if owed >= frame {
                owed -= frame;
                it.telemetry_offered += 1;
                // what is not taken never arrives, and is counted by that
                let _shed =
                    self.send(TELEMETRY, Transport::Datagram, TELEMETRY_TTL_US, &[&[0; TELEMETRY_BYTES]], now_us);
            }
            // drifts through the telemetry's phase, so that every wait there can be is met
            let phase = (now_us / command_every * 7) % command_every;
            if now_us % command_every == phase && now_us < last_command {
                self.command(now_us, &mut it);
            }
            self.step(now_us, &mut it);
        }
        it.displaced = self.nodes.iter().map(|node| node.counters().of(DropCause::Displaced)).sum();
        it
    }

    fn command(&mut self, now_us: u64, it: &mut Outcome) {
        let sequence = Sequence::new(u16::try_from(it.commands & 0x3fff).unwrap_or(0));
        let header = SequencedHeader { kind: SequencedKind::Request, sequence }.encode();
        let parts: [&[u8]; 3] = [&header, &now_us.to_le_bytes(), &[0; COMMAND_BYTES - 8]];
        // a command that was not even taken is lost like any other: it is never answered
        let _lost = self.send(COMMANDS, Transport::Sequenced, COMMAND_TTL_US, &parts, now_us);
        it.commands += 1;
    }

    fn send(
        &mut self,
        port: PortIndex,
        transport: Transport,
        ttl_us: u16,
        parts: &[&[u8]],
        now_us: u64,
    ) -> Result<(), SendError> {
        let to = Outbound { route: self.to_device.as_route(), mtu_bytes: 256, ttl_us, destination: port, transport };
        self.nodes[0].send(port, to, parts, LocalTicks::from_us(now_us))
    }

    /// Ends flights, begins flights, serves ports.
    fn step(&mut self, now_us: u64, it: &mut Outcome) {
        let now = LocalTicks::from_us(now_us);
        for (wire, (from, gateway, to, arrival)) in self.wires.iter_mut().zip(WIRES) {
            if let Some(mut flight) = wire.take_if(|flight| flight.ends_us <= now_us) {
                let arrival = Arrival::Link(GatewayIndex::from_low_bits(arrival));
                // a packet that is dropped here shows as a command lost or telemetry shed
                let _counted = self.nodes[to].receive(arrival, &mut flight.packet, flight.started, now);
            }
            if wire.is_none() {
                *wire = depart(&mut self.nodes[from], GatewayIndex::from_low_bits(gateway), now_us);
            }
        }
        let [source, _, device] = &mut *self.nodes else { return };
        while let Some(delivery) = device.take(TELEMETRY, now) {
            device.release(delivery, None, now);
            it.telemetry_arrived += 1;
        }
        while let Some(delivery) = device.take(COMMANDS, now) {
            let stamp: [u8; 8] = device.payload(&delivery)[..8].try_into().unwrap_or_default();
            let _counted = device.reply(delivery, &[&stamp], now);
        }
        while let Some(delivery) = source.take(COMMANDS, now) {
            let sent = u64::from_le_bytes(source.payload(&delivery).try_into().unwrap_or_default());
            source.release(delivery, None, now);
            it.answered += 1;
            it.round_trips_us.push(now_us - sent);
        }
    }
}

/// The next frame of a gateway that is clear to send.
fn depart(node: &mut OverloadNode, gateway: GatewayIndex, now_us: u64) -> Option<Flight> {
    let mut packet = [0; 256];
    let started = LocalTicks::from_us(now_us);
    let out = node.transmit(gateway, started, &mut packet)?;
    let wire = node.gateway(gateway).map_or(Span::ZERO, |gateway| gateway.config().wire_time(out.len));
    Some(Flight { packet: packet[..out.len].to_vec(), started, ends_us: now_us + wire.as_us_ceil().max(1) })
}

fn node(number: u8, gateways: &[GatewayConfig]) -> OverloadNode {
    let identity = Identity {
        type_name: "overload",
        unique_id: UniqueId([number; 12]),
        boot_epoch: 1,
        version: [0, 1, 0],
        build: BuildKind::Simulated,
    };
    let mut node = OverloadNode::new(identity, "overload");
    for type_name in ["telemetry", "commands"] {
        node.add_port(PortConfig { type_name, name: "", packet_hold_max: 4 });
    }
    for config in gateways {
        if let Some(index) = node.add_gateway(*config) {
            node.set_open(index, true, LocalTicks::ZERO);
        }
    }
    node
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The overload case as a test, in virtual time: no command is lost at 120 %, and none waits longer than its own idle round trip plus,
    /// each way, one telemetry or announcement frame that had begun and the announcement that then goes first.
    #[test]
    fn no_command_is_lost_beside_120_percent_of_telemetry() {
        let idle = Cell::new().run(1, 0);
        let busy = Cell::new().run(1, 120);
        assert!(busy.commands >= 480);
        assert_eq!((busy.answered, idle.answered), (busy.commands, idle.commands));
        let max = |it: &Outcome| it.round_trips_us.iter().max().copied().unwrap_or(0);
        let frame_us = TELEMETRY_FRAME_BYTES * 1_000_000 / LINK_BYTES_A_SECOND;
        assert!(max(&busy) <= max(&idle) + 2 * frame_us, "{} against {} idle", max(&busy), max(&idle));
        assert!(busy.displaced > 0, "the overload was one");
    }
}

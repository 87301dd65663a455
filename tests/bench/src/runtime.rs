//! CPU time of a message: made at one port, carried over links, taken and released at another.
//!
//! One thread, so wall time of a busy loop is CPU time; each row is the median of batches, so that a batch in which the machine did
//! something else does not count.

use fixed_math::time::LocalTicks;
use osap_protocol::discovery::{BuildKind, GatewayKind, UniqueId};
use osap_protocol::framing::{Check, decode, encode};
use osap_protocol::header::Arrival;
use osap_protocol::transport::Transport;
use osap_protocol::{GatewayIndex, PortIndex, RouteBuf, Step};
use osap_runtime::{GatewayConfig, Identity, Mailbox, Node, Outbound, PortConfig, Stamps};
use std::hint::black_box;
use std::time::Instant;

type BenchNode = Node<32, 256, 2, 2>;

/// Messages in a batch; the median is taken over batches.
const BATCH: u32 = 1_000;
/// What Table 2.6 counts for a control point: a `u64` time and an `f32` value.
const PAYLOAD_BYTES: usize = 12;

/// How packets cross a link.
#[derive(Clone, Copy)]
enum Wire {
    /// Packet to packet, as between threads or in datagrams.
    Packets,
    /// Check, stuffing, unstuffing, check, as on a UART.
    Framed(Check),
}

/// Prints the table.
pub(crate) fn run(messages: u32) {
    println!(
        "CPU time of a message of {PAYLOAD_BYTES} bytes, one thread, median of batches of {BATCH}, {messages} messages a row"
    );
    println!("{:<28}{:>12}{:>12}{:>16}", "wire", "links", "µs/message", "µs more a link");
    for (name, wire) in [
        ("packets in memory", Wire::Packets),
        ("COBS + CRC-16 both ends", Wire::Framed(Check::Crc16)),
        ("COBS + CRC-32 both ends", Wire::Framed(Check::Crc32)),
    ] {
        let mut before = None;
        for links in 0..=3 {
            let us = measure(links, wire, messages);
            let more = before.map_or_else(String::new, |before: f64| format!("{:.3}", us - before));
            println!("{name:<28}{links:>12}{us:>12.3}{more:>16}");
            before = Some(us);
        }
    }
}

/// Median µs a message over `links` links.
fn measure(links: usize, wire: Wire, messages: u32) -> f64 {
    let mut line = Line::new(links, wire);
    let mut batches: Vec<f64> = (0..messages.div_ceil(BATCH))
        .map(|_| {
            let started = Instant::now();
            for _ in 0..BATCH {
                line.message();
            }
            started.elapsed().as_secs_f64() * 1e6 / f64::from(BATCH)
        })
        .collect();
    batches.sort_by(f64::total_cmp);
    batches[batches.len() / 2]
}

/// Nodes in a row; each one's gateway 1 leads to the next one's gateway 0.
struct Line {
    nodes: Vec<BenchNode>,
    route: RouteBuf,
    wire: Wire,
    now_us: u64,
}

impl Line {
    fn new(links: usize, wire: Wire) -> Self {
        let gateway = GatewayConfig {
            type_name: "bench",
            kind: GatewayKind::Link,
            mtu_bytes: 256,
            bit_rate: 0,
            bits_a_byte: 8,
            check: Check::None,
            packet_hold_max: 8,
            stamps: Stamps::SOFTWARE,
        };
        let node = |_| {
            let identity = Identity {
                type_name: "bench",
                unique_id: UniqueId([1; 12]),
                boot_epoch: 1,
                version: [0, 1, 0],
                build: BuildKind::Host,
            };
            let mut node = BenchNode::new(identity, "bench");
            node.add_port(PortConfig { type_name: "bench", name: "", packet_hold_max: 8 });
            for _ in 0..2 {
                if let Some(index) = node.add_gateway(gateway) {
                    node.set_open(index, true, LocalTicks::ZERO);
                }
            }
            node
        };
        let mut route = RouteBuf::new();
        for _ in 0..links {
            let _fits = route.push(Step::Link(GatewayIndex::from_low_bits(1)));
        }
        Self { nodes: (0..=links).map(node).collect(), route, wire, now_us: 1 }
    }

    /// One message from the first node's port 1 to the last one's.
    fn message(&mut self) {
        // a microsecond of virtual time a message: announcements come as often as at a million messages a second
        self.now_us += 1;
        let now = LocalTicks::from_us(self.now_us);
        let port = PortIndex::from_low_bits(1);
        let to = Outbound {
            route: self.route.as_route(),
            mtu_bytes: 256,
            ttl_us: 10_000,
            destination: port,
            transport: Transport::Datagram,
        };
        let payload = black_box([0x5a; PAYLOAD_BYTES]);
        self.nodes[0].send(port, to, &[&payload], now).expect("room");
        let mut packet = [0; 256];
        let mut frame = [0; 300];
        for hop in 1..self.nodes.len() {
            let (before, after) = self.nodes.split_at_mut(hop);
            let (from, into) = (&mut before[hop - 1], &mut after[0]);
            while let Some(out) = from.transmit(GatewayIndex::from_low_bits(1), now, &mut packet) {
                let mut len = out.len;
                if let Wire::Framed(check) = self.wire {
                    let framed = encode(&packet[..len], check, &mut frame).expect("room");
                    len = decode(black_box(&frame[..framed]), check, &mut packet).expect("an undamaged frame");
                }
                let arrival = Arrival::Link(GatewayIndex::from_low_bits(0));
                into.receive(arrival, &mut packet[..len], now, now).expect("room");
            }
        }
        let last = self.nodes.last_mut().expect("at least one node");
        let delivery = last.take(port, now).expect("it arrived");
        black_box(last.payload(&delivery));
        last.release(delivery, None, now);
    }
}

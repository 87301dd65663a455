//! Two or more nodes on ideal wires: what one transmits, the other receives after its wire time, in virtual microseconds.

#![allow(dead_code, reason = "each test binary uses its own part of this")]

use fixed_math::time::LocalTicks;
use osap_protocol::discovery::{BuildKind, GatewayKind, Message, Query, UniqueId, decode, encode};
use osap_protocol::framing::Check;
use osap_protocol::header::Arrival;
use osap_protocol::transport::{Sequence, SequencedHeader, SequencedKind, Transport};
use osap_protocol::{BusDrop, DropCause, GatewayIndex, PortIndex, RouteBuf, Step};
use osap_runtime::{Delivery, GatewayConfig, Identity, Mailbox, Node, Outbound, PortConfig, Stamps};
use serde::{Serialize, de::DeserializeOwned};

pub(crate) const SLOTS: usize = 8;
pub(crate) const BYTES: usize = 256;
pub(crate) type TestNode = Node<SLOTS, BYTES, 4, 4>;

/// The user port that every test node has.
pub(crate) const USER: u16 = 1;

pub(crate) fn us(us: u64) -> LocalTicks {
    LocalTicks::from_us(us)
}

pub(crate) fn gateway(index: u8) -> GatewayIndex {
    GatewayIndex::new(index).expect("below 64")
}

pub(crate) fn port(index: u16) -> PortIndex {
    PortIndex::new(index).expect("below 2048")
}

pub(crate) fn link(index: u8) -> Step {
    Step::Link(gateway(index))
}

pub(crate) fn bus(index: u8, drop: u8) -> Step {
    Step::Bus { gateway: gateway(index), drop: BusDrop(drop) }
}

pub(crate) fn route(steps: &[Step]) -> RouteBuf {
    let mut route = RouteBuf::new();
    for step in steps {
        route.push(*step).expect("short");
    }
    route
}

/// 3 Mbaud UART, CRC-16: an 80-byte frame takes 266.67 µs.
pub(crate) const UART: GatewayConfig = GatewayConfig {
    type_name: "uart",
    kind: GatewayKind::Link,
    mtu_bytes: 256,
    bit_rate: 3_000_000,
    bits_a_byte: 10,
    check: Check::Crc16,
    packet_hold_max: 4,
    stamps: Stamps::SOFTWARE,
};

/// A link of unknown rate.
pub(crate) const FAST: GatewayConfig = GatewayConfig { bit_rate: 0, bits_a_byte: 8, check: Check::None, ..UART };

pub(crate) fn identity(number: u8) -> Identity {
    Identity {
        type_name: "test",
        unique_id: UniqueId([number; 12]),
        boot_epoch: 1,
        version: [1, 2, 3],
        build: BuildKind::Simulated,
    }
}

/// A node with these gateways, all open at time 0, whose first announcements have gone nowhere.
pub(crate) fn node(number: u8, gateways: &[GatewayConfig]) -> TestNode {
    let mut node = TestNode::new(identity(number), &format!("node{number}"));
    assert_eq!(node.add_port(PortConfig { type_name: "user", name: "", packet_hold_max: 4 }), Some(port(USER)));
    for config in gateways {
        let index = node.add_gateway(*config).expect("room");
        node.set_open(index, true, us(0));
        let announced = node.transmit(index, us(0), &mut [0; BYTES]);
        assert!(announced.is_some(), "an announcement comes first");
    }
    node
}

#[expect(clippy::needless_pass_by_value, reason = "a node and its gateway read as one thing")]
/// Moves one packet from `from`'s gateway to `to`'s, with no time on the wire; says whether there was one.
pub(crate) fn carry(
    from: (&mut TestNode, u8),
    to: (&mut TestNode, u8),
    now: LocalTicks,
) -> Option<Result<(), DropCause>> {
    let mut packet = [0; BYTES];
    let out = from.0.transmit(gateway(from.1), now, &mut packet)?;
    Some(to.0.receive(Arrival::Link(gateway(to.1)), &mut packet[..out.len], now, now))
}

/// Sends a datagram from the user port.
pub(crate) fn datagram(
    node: &mut TestNode,
    steps: &[Step],
    to: u16,
    ttl_us: u16,
    data: &[u8],
    now: LocalTicks,
) -> Result<(), osap_runtime::SendError> {
    let route = route(steps);
    let to = Outbound {
        route: route.as_route(),
        mtu_bytes: 256,
        ttl_us,
        destination: port(to),
        transport: Transport::Datagram,
    };
    node.send(port(USER), to, &[data], now)
}

/// A query from the node's own user port to its own port 0, and its answer.
pub(crate) fn ask<Q: Serialize, A: DeserializeOwned>(
    node: &mut TestNode,
    query: Query,
    body: &Q,
    now: LocalTicks,
) -> Result<A, u8> {
    let mut bytes = [0; 128];
    let len = encode(query.key(), body, &mut bytes).expect("fits");
    ask_raw(node, &bytes[..len], now).map(|payload| {
        let Message { key, body } = decode(&payload).expect("an answer");
        assert_eq!(key, query.key());
        body.read().map_err(|_| 0).expect("a body")
    })
}

/// As [`ask`], with any bytes; the error is the refusal's code.
pub(crate) fn ask_raw(node: &mut TestNode, bytes: &[u8], now: LocalTicks) -> Result<Vec<u8>, u8> {
    let route = RouteBuf::new();
    let to = Outbound {
        route: route.as_route(),
        mtu_bytes: 256,
        ttl_us: 1000,
        destination: PortIndex::NETRESPONDER,
        transport: Transport::Sequenced,
    };
    let header = SequencedHeader { kind: SequencedKind::Request, sequence: Sequence::new(77) }.encode();
    node.send(port(USER), to, &[&header, bytes], now).expect("sent");
    node.run(now);
    let delivery = node.take(port(USER), now).expect("answered");
    let header = delivery.sequenced.expect("sequenced");
    assert_eq!(header.sequence, Sequence::new(77));
    let payload = node.payload(&delivery).to_vec();
    node.release(delivery, None, now);
    match header.kind {
        SequencedKind::Reply => Ok(payload),
        SequencedKind::Refusal => Err(payload[2]),
        SequencedKind::Request => panic!("a request came back"),
    }
}

/// Payload of a delivery, which is then released.
pub(crate) fn read(node: &mut TestNode, delivery: Delivery, now: LocalTicks) -> Vec<u8> {
    let payload = node.payload(&delivery).to_vec();
    node.release(delivery, None, now);
    payload
}

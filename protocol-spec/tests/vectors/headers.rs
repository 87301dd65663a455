//! Headers, instructions, routes, time to live and MTU: `[PKT-01]` to `[PKT-15]`.

use crate::{Clauses, Hex, each, vector_file, vectors};
use fixed_math::time::Span;
use osap_protocol::header::{Arrival, Terminal, emit};
use osap_protocol::route::{NotARoute, Route, RouteBuf, Step};
use osap_protocol::ttl::{ttl_after, wire_time};
use osap_protocol::{BusDrop, DropCause, GatewayIndex, Instruction, Packet, PortIndex};
use serde::Deserialize;

pub(crate) const HEADER: &str = "header.toml";
pub(crate) const INSTRUCTIONS: &str = "instructions.toml";
pub(crate) const ROUTES: &str = "routes.toml";
pub(crate) const TTL: &str = "ttl.toml";
pub(crate) const MTU: &str = "mtu.toml";

/// An instruction as the vectors write it.
#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub(crate) enum Said {
    System(u8),
    Link(u8),
    Bus { gateway: u8, drop: u8 },
    Port { source: u16, destination: u16 },
}

impl Said {
    pub(crate) fn instruction(self) -> Instruction {
        match self {
            Self::System(key) => Instruction::System(key),
            Self::Link(index) => Instruction::Link(gateway(index)),
            Self::Bus { gateway: index, drop } => Instruction::Bus { gateway: gateway(index), drop: BusDrop(drop) },
            Self::Port { source, destination } => {
                Instruction::Port { source: port(source), destination: port(destination) }
            }
        }
    }

    pub(crate) fn step(self) -> Step {
        match self.instruction() {
            Instruction::Link(gateway) => Step::Link(gateway),
            Instruction::Bus { gateway, drop } => Step::Bus { gateway, drop },
            other => panic!("{other:?} is no forwarding step"),
        }
    }
}

/// An arrival as the vectors write it.
#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
enum Came {
    Link(u8),
    Bus { gateway: u8, from: u8 },
}

impl Came {
    fn arrival(self) -> Arrival {
        match self {
            Self::Link(index) => Arrival::Link(gateway(index)),
            Self::Bus { gateway: index, from } => Arrival::Bus { gateway: gateway(index), from: BusDrop(from) },
        }
    }
}

fn gateway(index: u8) -> GatewayIndex {
    GatewayIndex::new(index).expect("a gateway index has six bits")
}

fn port(index: u16) -> PortIndex {
    PortIndex::new(index).expect("a port index has eleven bits")
}

pub(crate) fn route(steps: &[Said]) -> RouteBuf {
    let mut route = RouteBuf::new();
    for step in steps {
        route.push(step.step()).expect("the vectors' routes are short");
    }
    route
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct HeaderFile {
    packet: Vec<Header>,
    refused: Vec<Refused>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    name: String,
    clause: Clauses,
    bytes: Hex,
    pointer: u8,
    ttl_us: u16,
    mtu_bytes: u16,
    instruction: Said,
    transport: Option<u8>,
    payload: Option<Hex>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Refused {
    name: String,
    clause: Clauses,
    bytes: Hex,
    cause: String,
}

#[test]
fn headers() {
    let file: HeaderFile = vector_file(HEADER);
    each(HEADER, &file.packet, |at, v| {
        let packet = Packet::check(&v.bytes.0[..]).unwrap_or_else(|error| panic!("{at}: {error}"));
        assert_eq!(packet.pointer(), v.pointer, "{at}: pointer");
        assert_eq!(packet.ttl_us(), v.ttl_us, "{at}: TTL");
        assert_eq!(packet.mtu_bytes(), v.mtu_bytes, "{at}: MTU");
        assert_eq!(packet.instruction(), v.instruction.instruction(), "{at}: instruction");
        let behind = v.transport.zip(v.payload.as_ref().map(|payload| &payload.0[..]));
        assert_eq!(packet.transport(), behind, "{at}: transport key and payload");
    });
    each(HEADER, &file.refused, |at, v| {
        let error = Packet::check(&v.bytes.0[..]).expect_err(&at.to_string());
        assert_eq!(DropCause::from(error).name(), v.cause, "{at}");
    });
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct InstructionFile {
    instruction: Vec<OneInstruction>,
    cut: Vec<Cut>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct OneInstruction {
    name: String,
    clause: Clauses,
    bytes: Hex,
    instruction: Said,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Cut {
    name: String,
    clause: Clauses,
    bytes: Hex,
}

#[test]
fn instructions() {
    let file: InstructionFile = vector_file(INSTRUCTIONS);
    each(INSTRUCTIONS, &file.instruction, |at, v| {
        let instruction = v.instruction.instruction();
        assert_eq!(Instruction::decode(&v.bytes.0), Some(instruction), "{at}: read");
        let mut out = [0; 3];
        let width = instruction.encode(&mut out);
        assert_eq!(&out[..width], v.bytes.0, "{at}: written");
    });
    each(INSTRUCTIONS, &file.cut, |at, v| assert_eq!(Instruction::decode(&v.bytes.0), None, "{at}"));
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RouteFile {
    route: Vec<Walk>,
    refused: Vec<RefusedArrival>,
    stays: Vec<Cut>,
    not_a_route: Vec<NoRoute>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Walk {
    name: String,
    clause: Clauses,
    steps: Vec<Said>,
    terminal: Said,
    bytes: Hex,
    hops: Vec<Hop>,
    back: Option<Hex>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Hop {
    arrival: Came,
    bytes: Hex,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RefusedArrival {
    name: String,
    clause: Clauses,
    bytes: Hex,
    arrival: Came,
    cause: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NoRoute {
    name: String,
    clause: Clauses,
    bytes: Hex,
    at: usize,
}

/// What the origin sends: the header of all these vectors, and a datagram of one byte where it goes to a port.
fn as_sent(steps: &[Said], terminal: Said) -> Vec<u8> {
    let (terminal, payload): (_, &[u8]) = match terminal.instruction() {
        Instruction::Port { source, destination } => (Terminal::Port { source, destination, transport: 0 }, &[0x2a]),
        Instruction::System(key) => (Terminal::System { key }, &[]),
        other => panic!("{other:?} is no end of a route"),
    };
    let mut out = [0; 64];
    let len = emit(&mut out, 1000, 64, route(steps).as_route(), terminal).expect("the vectors' headers are short");
    [&out[..len], payload].concat()
}

#[test]
fn routes() {
    let file: RouteFile = vector_file(ROUTES);
    each(ROUTES, &file.route, |at, v| {
        let mut bytes = as_sent(&v.steps, v.terminal);
        assert_eq!(bytes, v.bytes.0, "{at}: as sent");
        for (n, hop) in v.hops.iter().enumerate() {
            let mut packet = Packet::check(&mut bytes[..]).unwrap_or_else(|error| panic!("{at}: hop {n}: {error}"));
            packet.advance(hop.arrival.arrival()).unwrap_or_else(|error| panic!("{at}: hop {n}: {error}"));
            assert_eq!(bytes, hop.bytes.0, "{at}: after hop {n}");
        }
        let mut packet = Packet::check(&mut bytes[..]).unwrap_or_else(|error| panic!("{at}: {error}"));
        let turned = packet.turn_back();
        assert_eq!(turned.is_some(), v.back.is_some(), "{at}: whether it turns back");
        if let Some(back) = &v.back {
            assert_eq!(bytes, back.0, "{at}: turned back");
        }
    });
    each(ROUTES, &file.refused, |at, v| {
        let mut bytes = v.bytes.0.clone();
        let mut packet = Packet::check(&mut bytes[..]).unwrap_or_else(|error| panic!("{at}: {error}"));
        let error = packet.advance(v.arrival.arrival()).expect_err(&at.to_string());
        assert_eq!(DropCause::from(error).name(), v.cause, "{at}");
        assert_eq!(bytes, v.bytes.0, "{at}: was changed");
    });
    each(ROUTES, &file.stays, |at, v| {
        let mut bytes = v.bytes.0.clone();
        let mut packet = Packet::check(&mut bytes[..]).unwrap_or_else(|error| panic!("{at}: {error}"));
        assert_eq!(packet.turn_back(), None, "{at}");
        assert_eq!(bytes, v.bytes.0, "{at}: was changed");
    });
    each(ROUTES, &file.not_a_route, |at, v| assert_eq!(Route::check(&v.bytes.0), Err(NotARoute { at: v.at }), "{at}"));
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TtlFile {
    egress: Vec<Egress>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Egress {
    name: String,
    clause: Clauses,
    ttl_in: u16,
    residence_steps: u64,
    wire_bytes: usize,
    bits_a_byte: u8,
    wire_bits: usize,
    bit_rate: u32,
    wire_steps: u64,
    ttl_out: TtlOut,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(untagged)]
enum TtlOut {
    Left(u16),
    Word(Expired),
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Expired {
    Expired,
}

#[test]
fn times_to_live() {
    let file: TtlFile = vector_file(TTL);
    each(TTL, &file.egress, |at, v| {
        assert_eq!(v.wire_bytes * usize::from(v.bits_a_byte), v.wire_bits, "{at}: bits on the wire");
        let wire = wire_time(v.wire_bytes, v.bits_a_byte, v.bit_rate);
        assert_eq!(wire.steps(), v.wire_steps, "{at}: time on the wire");
        let left = match v.ttl_out {
            TtlOut::Left(left) => Some(left),
            TtlOut::Word(Expired::Expired) => None,
        };
        assert_eq!(ttl_after(v.ttl_in, Span::from_steps(v.residence_steps), wire), left, "{at}: TTL left");
    });
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MtuFile {
    packet: Vec<Fit>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Fit {
    name: String,
    clause: Clauses,
    bytes: Hex,
    mtu_bytes: u16,
    gateway_mtu: u16,
    cause: Option<String>,
}

/// The rule itself is the node's; here the field it reads, also in a reply.
#[test]
fn mtus() {
    let file: MtuFile = vector_file(MTU);
    each(MTU, &file.packet, |at, v| {
        let mut bytes = v.bytes.0.clone();
        let mut packet = Packet::check(&mut bytes[..]).unwrap_or_else(|error| panic!("{at}: {error}"));
        let may = usize::from(packet.mtu_bytes().min(v.gateway_mtu));
        let cause = (packet.bytes().len() > may).then_some(DropCause::OverMtu.name());
        assert_eq!(cause, v.cause.as_deref(), "{at}");
        packet.advance(Came::Link(0).arrival()).unwrap_or_else(|error| panic!("{at}: {error}"));
        assert!(packet.turn_back().is_some(), "{at}: no reply");
        assert_eq!(packet.mtu_bytes(), v.mtu_bytes, "{at}: the reply's field");
    });
}

vectors!(Header, Refused, OneInstruction, Cut, Walk, RefusedArrival, NoRoute, Egress, Fit);

//! A node's end of a link or bus: what it is, whether it can carry packets, who is at the other end.
//!
//! - **Walk:** ingress names the gateway a packet came by; routing names the one it leaves by.
//! - **Clauses:** `[LNK-02]` description, `[NOD-01]` hold, `[SYS-04]` neighbour.

use crate::halt::Telling;
use crate::peer::Peer;
use fixed_math::time::{LocalTicks, Span};
use osap_protocol::discovery::{GatewayKind, LinkInfo, Neighbour};
use osap_protocol::framing::{Check, encoded_len_max};
use osap_protocol::ttl::{WireRate, wire_time};

/// How good a link's stamps are, `[TIM-09]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamps {
    /// A tick of the counter they are made of.
    pub tick: Span,
    /// The least time from a departure's stamp to its arrival's stamp at the other end; zero where it is not known.
    pub wire: Span,
    /// How late a departure's stamp may be read after its byte left; zero where the counter is read first.
    pub late: Span,
}

impl Stamps {
    /// Made by software from a counter of microseconds, which is read before a frame leaves.
    pub const SOFTWARE: Self = Self { tick: Span::from_us(1), wire: Span::ZERO, late: Span::ZERO };
}

/// What does not change about a gateway.
#[derive(Clone, Copy, Debug)]
pub struct GatewayConfig {
    /// Kind of hardware, such as `uart` or `usb-cdc`; cut to `NAME_BYTES_MAX`.
    pub type_name: &'static str,
    /// Link or bus.
    pub kind: GatewayKind,
    /// Largest packet, bytes.
    pub mtu_bytes: u16,
    /// Bits a second on the wire; 0 where unknown.
    pub bit_rate: u32,
    /// Bits each byte takes on the wire.
    pub bits_a_byte: u8,
    /// Guard of its frames.
    pub check: Check,
    /// Packets it may hold in the pool at once.
    pub packet_hold_max: u8,
    /// Its stamps.
    pub stamps: Stamps,
}

impl GatewayConfig {
    /// Time a packet of `packet_len` bytes takes on the wire, framing and a bus's addresses included; zero where the rate is unknown.
    #[must_use]
    pub fn wire_time(&self, packet_len: usize) -> Span {
        wire_time(self.frame_bytes_max(packet_len), self.bits_a_byte, self.bit_rate)
    }

    /// Most bytes that the frame of a packet of `packet_len` bytes has.
    #[must_use]
    pub const fn frame_bytes_max(&self, packet_len: usize) -> usize {
        let addresses = match self.kind {
            GatewayKind::Link => 0,
            GatewayKind::Bus { .. } => 2, // destination and source drop, `[FRM-10]`
        };
        encoded_len_max(packet_len + addresses, self.check)
    }
}

/// A neighbour and when it was last heard.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Heard {
    pub(crate) neighbour: Neighbour,
    pub(crate) at: LocalTicks,
}

/// One gateway of a node.
#[derive(Debug)]
pub struct Gateway {
    pub(crate) config: GatewayConfig,
    rate: WireRate,
    pub(crate) open: bool,
    /// Slots it owns.
    pub(crate) held: u8,
    /// Packets in the stack that leave by it.
    pub(crate) waiting: u16,
    pub(crate) received: u32,
    pub(crate) sent: u32,
    pub(crate) dropped: u32,
    pub(crate) heard: Option<Heard>,
    /// When to announce ourselves next; `None` while closed, or on a bus after it was done.
    pub(crate) announce_at: Option<LocalTicks>,
    /// The last packet sent was the node's own: an announcement, or about time.
    pub(crate) announced_last: bool,
    /// Latest change of neighbour that nobody has asked for yet.
    pub(crate) change: Option<osap_protocol::discovery::NeighbourChange>,
    /// The clock at the other end.
    pub(crate) peer: Peer,
    /// The halt that is still to be told there.
    pub(crate) telling: Telling,
}

impl Gateway {
    pub(crate) const fn new(config: GatewayConfig) -> Self {
        Self {
            rate: WireRate::new(config.bits_a_byte, config.bit_rate),
            config,
            open: false,
            held: 0,
            waiting: 0,
            received: 0,
            sent: 0,
            dropped: 0,
            heard: None,
            announce_at: None,
            announced_last: false,
            change: None,
            peer: Peer::new(config.stamps),
            telling: Telling::NONE,
        }
    }

    /// What does not change about it.
    #[must_use]
    pub const fn config(&self) -> &GatewayConfig {
        &self.config
    }

    /// As [`GatewayConfig::wire_time`], without its division; where the rate is unknown, what was measured, `[TIM-16]`.
    #[must_use]
    pub fn wire_time(&self, packet_len: usize) -> Span {
        if self.config.bit_rate == 0 {
            return self.peer.one_way().unwrap_or(Span::ZERO);
        }
        self.rate.time(self.config.frame_bytes_max(packet_len))
    }

    /// One message of the node's own goes between two packets at the most, however often a neighbour asks.
    pub(crate) const fn yields(&self) -> bool {
        self.announced_last && self.waiting > 0
    }

    /// Whether an announcement is due.
    pub(crate) fn announces(&self, now: LocalTicks) -> bool {
        self.announce_at.is_some_and(|at| at <= now)
    }

    /// Whether it can carry packets.
    #[must_use]
    pub const fn is_open(&self) -> bool {
        self.open
    }

    /// Who announced itself last, on a link.
    #[must_use]
    pub fn neighbour(&self) -> Option<Neighbour> {
        self.heard.map(|heard| heard.neighbour)
    }

    /// Answer to query 5.
    #[must_use]
    pub fn info(&self) -> LinkInfo {
        LinkInfo {
            type_name: crate::port::name_of(self.config.type_name),
            kind: self.config.kind,
            open: self.open,
            mtu_bytes: self.config.mtu_bytes,
            bit_rate: self.config.bit_rate,
            bits_a_byte: self.config.bits_a_byte,
            check: self.config.check,
            neighbour: self.neighbour(),
            packet_hold_max: self.config.packet_hold_max,
            received: self.received,
            sent: self.sent,
            dropped: self.dropped,
        }
    }
}

//! How software reaches the network: take what came to a port, answer it, send something new.
//!
//! - **Walk:** stack → [`Mailbox::take`] → handler → [`Mailbox::reply`] → the same slot, turned back, → stack.
//! - **Invariants:** a [`Delivery`] is one held slot; it ends in exactly one reply, refusal or release. A reply needs no new memory.
//! - **Context:** whoever holds the node; a handler may run elsewhere in between, holding only the `Delivery`. Where tasks share a node,
//!   [`Mailbox`] is implemented over a lock that is held for one call at a time, so that no handler's own work keeps packets waiting.
//! - **Clauses:** `[PKT-11]`, `[PKT-13]`, `[TRN-03]`, `[NOD-06]`, `[NOD-07]`, `[NOD-11]`.

use crate::clock::SystemTime;
use crate::node::Node;
use crate::pool::{Owner, Pool, SlotId, Tag, Taker};
use fixed_math::clock::SlewedMap;
use fixed_math::time::{LocalTicks, NetTime, Span};
use osap_protocol::discovery::Stage;
use osap_protocol::halt::{Action, Halt};
use osap_protocol::header::{PORT_HEADER_BYTES, Terminal, emit};
use osap_protocol::transport::{SequencedHeader, SequencedKind, Transport};
use osap_protocol::{DropCause, Instruction, Packet, PortIndex, Route};

/// A packet that its port has taken and not yet answered.
#[derive(Debug)]
#[must_use = "a delivery holds a slot until it is replied to, refused or released"]
pub struct Delivery {
    slot: SlotId,
    /// The port that took it.
    pub port: PortIndex,
    /// The sender's port.
    pub source: PortIndex,
    /// How it was sent.
    pub transport: Transport,
    /// Header of a sequenced packet.
    pub sequenced: Option<SequencedHeader>,
    /// When its frame ended.
    pub arrived: LocalTicks,
    /// Smallest packet size of the links on its route, bytes.
    pub mtu_bytes: u16,
    /// Offset of the payload behind the transport's header (a segmented packet's is part of the payload).
    payload: usize,
}

impl Delivery {
    /// The slot from the payload on, for an answer to be written in its place.
    pub(crate) fn room<'p, const SLOTS: usize, const BYTES: usize>(
        &self,
        pool: &'p mut Pool<SLOTS, BYTES>,
    ) -> &'p mut [u8] {
        pool.room_mut(&self.slot).get_mut(self.payload..).unwrap_or_default()
    }
}

/// A packet to be made.
#[derive(Clone, Copy, Debug)]
pub struct Outbound<'a> {
    /// Steps to the receiving node; none for this one.
    pub route: Route<'a>,
    /// Smallest packet size of the links on the route, bytes.
    pub mtu_bytes: u16,
    /// Time to live of the packet and of any reply to it, µs.
    pub ttl_us: u16,
    /// The receiver's port.
    pub destination: PortIndex,
    /// How it is sent.
    pub transport: Transport,
}

/// Why nothing was sent, `[NOD-11]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SendError {
    /// The sending port does not exist.
    NoSuchPort(PortIndex),
    /// The packet would be longer than the route's, the pool's or the gateway's packets.
    TooLong {
        /// Its length, bytes.
        len: usize,
        /// The most there may be.
        limit: usize,
    },
    /// The time to live is used up by the first wire alone, `[PKT-11]`.
    TtlTooShort {
        /// The least that could work, µs.
        need_us: u64,
        /// What was asked for, µs.
        ttl_us: u16,
    },
    /// The first step leads nowhere, or the hold or pool is full: see the cause.
    Refused(DropCause),
}

impl core::fmt::Display for SendError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NoSuchPort(port) => write!(f, "this node has no port {}", port.get()),
            Self::TooLong { len, limit } => write!(f, "the packet has {len} bytes; the route carries {limit}"),
            Self::TtlTooShort { need_us, ttl_us } => {
                write!(f, "a time to live of {ttl_us} µs is used up on the way; it takes at least {need_us} µs")
            }
            Self::Refused(cause) => write!(f, "{}: {}", cause.name(), cause.meaning()),
        }
    }
}

impl core::error::Error for SendError {}

/// What ports may do with a node, whatever its sizes.
pub trait Mailbox {
    /// The earliest packet for `port`, as soon as it is clear to receive.
    fn take(&mut self, port: PortIndex, now: LocalTicks) -> Option<Delivery>;

    /// Packets that wait for `port`.
    fn waiting(&mut self, port: PortIndex) -> usize;

    /// Gives the payload of a delivery to `read`, which should be short: where tasks share the node, it runs while others wait for it.
    fn with_payload<R>(&mut self, delivery: &Delivery, read: impl FnOnce(&[u8]) -> R) -> R;

    /// As [`Mailbox::with_payload`], the steps that lead back to the sender, in the order they were taken.
    fn with_taken_steps<R>(&mut self, delivery: &Delivery, read: impl FnOnce(&[u8]) -> R) -> R;

    /// Sends `parts`, put together, back to the sender in the delivery's own slot: a datagram for a datagram, a reply for a request.
    ///
    /// # Errors
    /// [`SendError`]; the delivery is released then.
    fn reply(&mut self, delivery: Delivery, parts: &[&[u8]], now: LocalTicks) -> Result<(), SendError>;

    /// As [`Mailbox::reply`], as a refusal of a sequenced request.
    ///
    /// # Errors
    /// [`SendError`]; the delivery is released then.
    fn refuse(&mut self, delivery: Delivery, parts: &[&[u8]], now: LocalTicks) -> Result<(), SendError>;

    /// Gives the slot back without an answer; with a cause, the packet is counted as dropped.
    fn release(&mut self, delivery: Delivery, cause: Option<DropCause>, now: LocalTicks);

    /// Counts what was dropped although its packet was answered.
    fn count_drop(&mut self, cause: DropCause, now: LocalTicks);

    /// Sends a new packet whose payload, transport header included, is `parts` put together.
    ///
    /// # Errors
    /// [`SendError`], counted as `send-refused` or under its own cause; nothing is held then.
    fn send(&mut self, port: PortIndex, to: Outbound<'_>, parts: &[&[u8]], now: LocalTicks) -> Result<(), SendError>;

    /// System time now, and the map from the counter to it, for who plays tracks by it.
    fn system_time(&mut self, now: LocalTicks) -> (SystemTime, SlewedMap);

    /// Says whether something follows system time, so that it is slewed and never set.
    fn set_live(&mut self, live: bool);

    /// The latest halt.
    fn halt(&mut self) -> Option<Halt>;

    /// As [`Node::raise_halt`].
    fn raise_halt(&mut self, action: Action, epoch: NetTime, now: LocalTicks) -> Halt;
}

impl<const SLOTS: usize, const BYTES: usize, const GATEWAYS: usize, const PORTS: usize> Mailbox
    for Node<SLOTS, BYTES, GATEWAYS, PORTS>
{
    fn take(&mut self, port: PortIndex, now: LocalTicks) -> Option<Delivery> {
        self.expire(now);
        if self.ports.get(port.at())?.waiting == 0 {
            return None;
        }
        let slot = self.stack.take_for(&mut self.pool, Taker::Port(port))?;
        self.leave_stack(&slot);
        let arrived = self.pool.tag(&slot).arrived;
        let bytes = self.pool.bytes(&slot);
        // checked at ingress, or made here; were it not so, it is still a counted drop and no lost slot
        let Some(Opened { source, transport, sequenced, mtu_bytes, payload }) = open(bytes) else {
            self.discard(slot, DropCause::TransportMalformed, now);
            return None;
        };
        let entry = &mut self.ports[port.at()];
        entry.received = entry.received.wrapping_add(1);
        self.stage(Stage::Deliver, Taker::Port(port), now);
        Some(Delivery { slot, port, source, transport, sequenced, arrived, mtu_bytes, payload })
    }

    fn waiting(&mut self, port: PortIndex) -> usize {
        Self::waiting(self, port)
    }

    fn with_payload<R>(&mut self, delivery: &Delivery, read: impl FnOnce(&[u8]) -> R) -> R {
        read(self.payload(delivery))
    }

    fn with_taken_steps<R>(&mut self, delivery: &Delivery, read: impl FnOnce(&[u8]) -> R) -> R {
        read(self.taken_steps(delivery))
    }

    fn reply(&mut self, delivery: Delivery, parts: &[&[u8]], now: LocalTicks) -> Result<(), SendError> {
        self.turn_back(delivery, SequencedKind::Reply, parts, now)
    }

    fn refuse(&mut self, delivery: Delivery, parts: &[&[u8]], now: LocalTicks) -> Result<(), SendError> {
        self.turn_back(delivery, SequencedKind::Refusal, parts, now)
    }

    fn release(&mut self, delivery: Delivery, cause: Option<DropCause>, now: LocalTicks) {
        match cause {
            Some(cause) => self.discard(delivery.slot, cause, now),
            None => self.relinquish(delivery.slot),
        }
    }

    fn count_drop(&mut self, cause: DropCause, now: LocalTicks) {
        self.count(cause, None, now);
    }

    fn send(&mut self, port: PortIndex, to: Outbound<'_>, parts: &[&[u8]], now: LocalTicks) -> Result<(), SendError> {
        let result = self.make(port, &to, parts, now);
        match &result {
            Ok(()) => {}
            Err(SendError::Refused(cause)) => self.count(*cause, None, now),
            Err(_) => self.count(DropCause::SendRefused, None, now),
        }
        result
    }

    fn system_time(&mut self, now: LocalTicks) -> (SystemTime, SlewedMap) {
        (self.clock.system_time(now), *self.clock.map())
    }

    fn set_live(&mut self, live: bool) {
        self.clock.set_live(live);
    }

    fn halt(&mut self) -> Option<Halt> {
        self.halt
    }

    fn raise_halt(&mut self, action: Action, epoch: NetTime, now: LocalTicks) -> Halt {
        Self::raise_halt(self, action, epoch, now)
    }
}

impl<const SLOTS: usize, const BYTES: usize, const GATEWAYS: usize, const PORTS: usize>
    Node<SLOTS, BYTES, GATEWAYS, PORTS>
{
    /// The payload of a delivery.
    #[must_use]
    pub fn payload(&self, delivery: &Delivery) -> &[u8] {
        self.pool.bytes(&delivery.slot).get(delivery.payload..).unwrap_or_default()
    }

    /// The steps that lead back to a delivery's sender, in the order they were taken.
    #[must_use]
    pub fn taken_steps(&self, delivery: &Delivery) -> &[u8] {
        let bytes = self.pool.bytes(&delivery.slot);
        let pointer = bytes.first().copied().map_or(0, usize::from);
        bytes.get(osap_protocol::header::ROUTE_OFFSET..pointer).unwrap_or_default()
    }

    /// Makes a packet in a slot of `port`'s, `[NOD-11]`.
    fn make(&mut self, port: PortIndex, to: &Outbound<'_>, parts: &[&[u8]], now: LocalTicks) -> Result<(), SendError> {
        if port.at() >= self.ports.len() {
            return Err(SendError::NoSuchPort(port));
        }
        let len = PORT_HEADER_BYTES + to.route.bytes().len() + parts.iter().map(|part| part.len()).sum::<usize>();
        let limit = usize::from(to.mtu_bytes).min(BYTES);
        if len > limit {
            return Err(SendError::TooLong { len, limit });
        }
        let first = to.route.steps().next();
        let wire = first
            .and_then(|step| self.gateways.get(step.gateway().at()))
            .map_or(Span::ZERO, |gateway| gateway.wire_time(len));
        let need_us = wire.as_us_ceil() + 1;
        if u64::from(to.ttl_us) < need_us {
            return Err(SendError::TtlTooShort { need_us, ttl_us: to.ttl_us });
        }
        let instruction = first
            .map_or(Instruction::Port { source: port, destination: to.destination }, osap_protocol::Step::instruction);
        let taker = self.decide(instruction, len).map_err(SendError::Refused)?;

        let deadline = now + Span::from_us(u64::from(to.ttl_us));
        let tag = Tag { owner: Owner::Port(port), taker, arrived: now, ttl_us: to.ttl_us, deadline };
        self.expire(now);
        let id = self.admit(tag, now).map_err(SendError::Refused)?;
        let room = self.pool.room_mut(&id);
        let terminal = Terminal::Port { source: port, destination: to.destination, transport: to.transport.key() };
        let start = emit(room, to.ttl_us, to.mtu_bytes, to.route, terminal).unwrap_or(len);
        put(&mut room[start.min(len)..len], parts);
        self.pool.set_len(&id, len);
        let entry = &mut self.ports[port.at()];
        entry.sent = entry.sent.wrapping_add(1);
        self.stack_up(id, now);
        Ok(())
    }

    /// Rewrites a delivery in its own slot as its answer, `[NOD-07]`; its TTL and deadline go on, `[PKT-13]`.
    fn turn_back(
        &mut self,
        delivery: Delivery,
        kind: SequencedKind,
        parts: &[&[u8]],
        now: LocalTicks,
    ) -> Result<(), SendError> {
        let Delivery { payload, .. } = delivery;
        let len = parts.iter().map(|part| part.len()).sum::<usize>();
        let limit = BYTES.saturating_sub(payload);
        if let Some(room) = self.pool.room_mut(&delivery.slot).get_mut(payload..payload + len.min(limit))
            && len <= limit
        {
            put(room, parts);
        }
        self.turn_back_in_place(delivery, kind, len, now)
    }

    /// As a reply whose `len` bytes stand in the slot already, [`Delivery::room`].
    pub(crate) fn reply_in_place(&mut self, delivery: Delivery, len: usize, now: LocalTicks) -> Result<(), SendError> {
        self.turn_back_in_place(delivery, SequencedKind::Reply, len, now)
    }

    fn turn_back_in_place(
        &mut self,
        delivery: Delivery,
        kind: SequencedKind,
        len: usize,
        now: LocalTicks,
    ) -> Result<(), SendError> {
        let Delivery { slot, port, sequenced, payload, .. } = delivery;
        let header = sequenced.map(|header| SequencedHeader { kind, ..header });
        let result = self.rewrite(&slot, payload + len, header);
        match result {
            Ok(taker) => {
                self.pool.tag_mut(&slot).taker = taker;
                let entry = &mut self.ports[port.at()];
                entry.sent = entry.sent.wrapping_add(1);
                self.stage(Stage::Reply, Taker::Port(port), now);
                self.stack_up(slot, now);
                Ok(())
            }
            Err(error) => {
                let cause = if let SendError::Refused(cause) = error { cause } else { DropCause::SendRefused };
                self.discard(slot, cause, now);
                Err(error)
            }
        }
    }

    /// Makes a packet that arrived at a port one of `len` bytes that goes back.
    fn rewrite(&mut self, slot: &SlotId, len: usize, sequenced: Option<SequencedHeader>) -> Result<Taker, SendError> {
        let mut packet = Packet::check(self.pool.bytes_mut(slot)).map_err(|error| SendError::Refused(error.into()))?;
        let limit = usize::from(packet.mtu_bytes()).min(BYTES);
        if len > limit {
            return Err(SendError::TooLong { len, limit });
        }
        let transport = packet.turn_back().ok_or(SendError::Refused(DropCause::NotForwarding))?;
        let instruction = packet.instruction();
        if let Some(header) = sequenced {
            let room = self.pool.room_mut(slot);
            room[transport + 1..transport + 1 + SequencedHeader::LEN].copy_from_slice(&header.encode());
        }
        self.pool.set_len(slot, len);
        self.decide(instruction, len).map_err(SendError::Refused)
    }
}

/// What a delivery tells of its packet.
struct Opened {
    source: PortIndex,
    transport: Transport,
    sequenced: Option<SequencedHeader>,
    mtu_bytes: u16,
    payload: usize,
}

/// Reads a packet whose pointer is on a port instruction.
fn open(bytes: &[u8]) -> Option<Opened> {
    let packet = Packet::check(bytes).ok()?;
    let Instruction::Port { source, .. } = packet.instruction() else { return None };
    let (key, rest) = packet.transport()?;
    let at = packet.after_instruction() + 1;
    let transport = Transport::from_key(key).ok()?;
    let (sequenced, payload) = match transport {
        Transport::Sequenced => (Some(SequencedHeader::parse(rest).ok()?.0), at + SequencedHeader::LEN),
        Transport::Datagram | Transport::Segmented => (None, at),
    };
    Some(Opened { source, transport, sequenced, mtu_bytes: packet.mtu_bytes(), payload })
}

/// Copies `parts` one behind the other into `room`, which is exactly as long.
fn put(room: &mut [u8], parts: &[&[u8]]) {
    let mut rest = room;
    for part in parts {
        let (place, after) = rest.split_at_mut(part.len());
        place.copy_from_slice(part);
        rest = after;
    }
}

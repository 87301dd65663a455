//! Ingress: a packet that came whole by a gateway is made ours, or dropped under one name.
//!
//! - **Walk:** link → *here* → `route` → `stack`. **Context:** the node's; O(route) for nothing, O(stack) for the insertion.
//! - **Clauses:** `[PKT-02]`, `[PKT-07]`, `[PKT-08]`, `[PKT-10]`, `[PKT-12]`, `[PKT-15]`, `[NOD-05]`, `[NOD-08]`, `[TRN-01]`.

use crate::node::Node;
use crate::pool::{Owner, Tag, Taker};
use fixed_math::time::{LocalTicks, Span};
use osap_protocol::discovery::Stage;
use osap_protocol::header::Arrival;
use osap_protocol::system::SystemKey;
use osap_protocol::transport::{SegmentHeader, SequencedHeader, Transport};
use osap_protocol::ttl::ttl_after;
use osap_protocol::{BusDrop, DropCause, GatewayIndex, Instruction, Packet, Route};

impl<const SLOTS: usize, const BYTES: usize, const GATEWAYS: usize, const PORTS: usize>
    Node<SLOTS, BYTES, GATEWAYS, PORTS>
{
    /// Whether a packet from `gateway` would find room without displacing another: what a link with flow control of its own asks
    /// before it reads on.
    #[must_use]
    pub fn clear_to_receive(&self, gateway: GatewayIndex) -> bool {
        self.pool.free_count() > 0
            && self.gateways.get(gateway.at()).is_some_and(|it| it.open && it.held < it.config.packet_hold_max)
    }

    /// Takes in a packet that came by `arrival`; `started` is the stamp of its first byte. The packet's bytes are rewritten.
    ///
    /// # Errors
    /// The cause of its drop, already counted.
    pub fn receive(
        &mut self,
        arrival: Arrival,
        packet: &mut [u8],
        started: LocalTicks,
        now: LocalTicks,
    ) -> Result<(), DropCause> {
        let index = arrival.gateway();
        self.expire(now);
        let result = self.take_in(arrival, packet, started, now);
        match (&result, self.gateways.get_mut(index.at())) {
            (Ok(()), Some(gateway)) => gateway.received = gateway.received.wrapping_add(1),
            (Err(cause), _) => self.count(*cause, Some(index), now),
            (Ok(()), None) => {}
        }
        result
    }

    fn take_in(
        &mut self,
        arrival: Arrival,
        packet: &mut [u8],
        started: LocalTicks,
        now: LocalTicks,
    ) -> Result<(), DropCause> {
        let index = arrival.gateway();
        let gateway = self.gateways.get(index.at()).ok_or(DropCause::NoSuchGateway)?;
        if !gateway.open {
            return Err(DropCause::GatewayClosed);
        }
        if matches!(arrival, Arrival::Bus { from: BusDrop::BROADCAST, .. }) {
            return Err(DropCause::FrameMalformed); // `[PKT-15]`: nobody's own address, so nobody could be answered
        }
        let (len, wire) = (packet.len(), gateway.wire_time(packet.len()));
        let mut view = Packet::check(&mut *packet)?;
        let (ttl_us, mtu_bytes) = (view.ttl_us(), usize::from(view.mtu_bytes()));
        if len > mtu_bytes.min(BYTES) {
            return Err(DropCause::OverMtu);
        }
        if ttl_us == 0 {
            return Err(DropCause::Expired);
        }
        let sent_by = match view.instruction() {
            Instruction::Link(theirs) => Some(theirs),
            _ => None,
        };
        view.advance(arrival)?;
        // read once: what is decided below is decided by this one instruction
        let instruction = view.instruction();
        self.stage(Stage::Ingress, Taker::Gateway(index), now);

        if let Instruction::System(_) | Instruction::Port { .. } = instruction {
            // the way ends here: what was taken must be a way, or nothing could go back by it
            Route::check(view.taken()).map_err(|_| DropCause::PointerOutside)?;
        }
        if let Instruction::System(key) = instruction {
            return match SystemKey::from_key(key) {
                // one step and no more, `[SYS-02]`: what was forwarded here tells nothing of who is at the other end of this link
                Some(SystemKey::Announcement | SystemKey::TimeRequest | SystemKey::TimeReply | SystemKey::Halt)
                    if view.taken().len() > Instruction::width(view.taken()[0]) =>
                {
                    Err(DropCause::SystemMalformed)
                }
                Some(SystemKey::Announcement) => {
                    self.hear_announcement(arrival, sent_by, &view.bytes()[view.after_instruction()..], now)
                }
                Some(key @ (SystemKey::TimeRequest | SystemKey::TimeReply)) => {
                    self.hear_time(key, arrival, &view.bytes()[view.after_instruction()..], started, now)
                }
                Some(SystemKey::Halt) => self.hear_halt(arrival, &view.bytes()[view.after_instruction()..], now),
                _ => Err(DropCause::UnknownSystemKey),
            };
        }
        if let Instruction::Port { .. } = instruction
            && let Some((key, payload)) = view.bytes()[view.after_instruction()..].split_first()
        {
            check_transport(*key, payload)?;
        }
        let taker = self.decide(instruction, len)?;
        self.stage(Stage::Route, taker, now);

        self.keep(packet, Held { owner: Owner::Gateway(index), taker, arrived: (started + wire).min(now), ttl_us }, now)
    }

    /// Gives a packet its place in the pool and in the stack, if it can still be in time.
    fn keep(&mut self, packet: &[u8], held: Held, now: LocalTicks) -> Result<(), DropCause> {
        let (Held { owner, taker, arrived, ttl_us }, len) = (held, packet.len());
        // the sender has taken the wire time off already: time in this node begins at the frame's end, which cannot be after `now`
        let deadline = arrived + Span::from_us(u64::from(ttl_us));
        // what could only be dropped takes no memory, and displaces nothing that could still be in time
        let left = match taker {
            Taker::Port(_) => ttl_after(ttl_us, now.since(arrived), Span::ZERO),
            Taker::Gateway(out) => ttl_after(ttl_us, now.since(arrived), self.gateways[out.at()].wire_time(len)),
        };
        left.ok_or(DropCause::Expired)?;
        let id = self.admit(Tag { owner, taker, arrived, ttl_us, deadline }, now)?;
        self.pool.room_mut(&id)[..len].copy_from_slice(packet);
        self.pool.set_len(&id, len);
        self.stack_up(id, now);
        Ok(())
    }
}

/// Whose a packet is, and since when.
struct Held {
    owner: Owner,
    taker: Taker,
    /// When its frame ended.
    arrived: LocalTicks,
    ttl_us: u16,
}

/// A transport's own header must be whole before a packet may take up memory, `[TRN-01]`, `[TRN-03]`, `[TRN-07]`.
fn check_transport(key: u8, payload: &[u8]) -> Result<(), DropCause> {
    match Transport::from_key(key)? {
        Transport::Datagram => Ok(()),
        Transport::Sequenced => SequencedHeader::parse(payload).map(|_| ()),
        Transport::Segmented => SegmentHeader::parse(payload).map(|_| ()),
    }
}

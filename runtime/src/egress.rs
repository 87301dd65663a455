//! Egress: the earliest packet for a gateway that is clear to send, with its TTL brought up to date.
//!
//! - **Walk:** stack → *here* → framing → the wire. **Context:** the node's; O(stack).
//! - **Invariant:** what leaves still has time to live when its last byte arrives.
//! - **Clauses:** `[PKT-10]`, `[PKT-12]`, `[SYS-03]`, `[NOD-06]`.

use crate::exchange::TIME_BYTES_MAX;
use crate::halt::HALT_BYTES_MAX;
use crate::node::{MTU_BYTES_MIN, Node};
use crate::pool::Taker;
use fixed_math::time::LocalTicks;
use osap_protocol::discovery::Stage;
use osap_protocol::ttl::ttl_after;
use osap_protocol::{BusDrop, DropCause, GatewayIndex, Instruction, Packet};

/// A packet to be sent now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outgoing {
    /// Bytes of it in the caller's buffer.
    pub len: usize,
    /// On a bus, the drop that shall take it, 255 for all.
    pub to: Option<BusDrop>,
    /// It ends in a stamp slot, `[TIM-03]`, with the instant it was made for: who knows better when its first byte leaves writes that.
    pub is_stamped: bool,
}

/// A packet that is about to leave.
#[derive(Debug)]
pub struct Departure<'a> {
    /// All of it.
    pub packet: &'a mut [u8],
    /// As [`Outgoing::to`].
    pub to: Option<BusDrop>,
    /// As [`Outgoing::is_stamped`].
    pub is_stamped: bool,
}

impl<const SLOTS: usize, const BYTES: usize, const GATEWAYS: usize, const PORTS: usize>
    Node<SLOTS, BYTES, GATEWAYS, PORTS>
{
    /// Whether [`Node::transmit`] would find something for `gateway`, but for packets that expire before.
    #[must_use]
    pub fn has_output(&self, gateway: GatewayIndex, now: LocalTicks) -> bool {
        self.gateways
            .get(gateway.at())
            .is_some_and(|it| it.open && (it.waiting > 0 || it.announce_at.is_some_and(|at| at <= now)))
            || self.has_time_message(gateway, now)
            || self.has_halt(gateway, now)
    }

    /// Copies the next packet for `gateway` into `out`, to be called when the gateway is clear to send. `out` holds the gateway's
    /// MTU; a packet that it cannot hold is dropped, `over-mtu`.
    pub fn transmit(&mut self, index: GatewayIndex, now: LocalTicks, out: &mut [u8]) -> Option<Outgoing> {
        self.transmit_with(index, now, out.len(), |Departure { packet, to, is_stamped }| {
            out[..packet.len()].copy_from_slice(packet);
            Outgoing { len: packet.len(), to, is_stamped }
        })
    }

    /// Gives the next packet for `gateway`, of up to `limit_bytes`, to `send`, to be called when the gateway is clear to send: as
    /// [`Node::transmit`] without its copy. A longer one is dropped, `over-mtu`.
    pub fn transmit_with<R>(
        &mut self,
        index: GatewayIndex,
        now: LocalTicks,
        limit_bytes: usize,
        send: impl FnOnce(Departure<'_>) -> R,
    ) -> Option<R> {
        if self.has_halt(index, now) {
            let mut message = [0; HALT_BYTES_MAX];
            if let Some(Outgoing { len, to, is_stamped }) = self.halt_message(index, now, &mut message) {
                return Some(send(Departure { packet: message.get_mut(..len.min(limit_bytes))?, to, is_stamped }));
            }
        }
        let gateway = self.gateways.get(index.at()).filter(|gateway| gateway.open)?;
        if gateway.announces(now) && !gateway.yields() {
            let mut announcement = [0; MTU_BYTES_MIN as usize];
            if let Some(Outgoing { len, to, is_stamped }) = self.announce(index, now, &mut announcement) {
                return Some(send(Departure { packet: announcement.get_mut(..len.min(limit_bytes))?, to, is_stamped }));
            }
        }
        if self.has_time_message(index, now) {
            let mut message = [0; TIME_BYTES_MAX];
            if let Some(Outgoing { len, to, is_stamped }) = self.time_message(index, now, &mut message) {
                return Some(send(Departure { packet: message.get_mut(..len.min(limit_bytes))?, to, is_stamped }));
            }
        }
        self.expire(now);
        while self.gateways[index.at()].waiting > 0 {
            let id = self.stack.take_for(&mut self.pool, Taker::Gateway(index))?;
            self.leave_stack(&id);
            let tag = *self.pool.tag(&id);
            let len = self.pool.bytes(&id).len();
            let wire = self.gateways[index.at()].wire_time(len);
            let Some(ttl_us) = ttl_after(tag.ttl_us, now.since(tag.arrived), wire) else {
                self.discard(id, DropCause::Expired, now);
                continue;
            };
            let (true, Ok(mut packet)) = (len <= limit_bytes, Packet::check(self.pool.bytes_mut(&id))) else {
                self.discard(id, DropCause::OverMtu, now);
                continue;
            };
            packet.set_ttl_us(ttl_us);
            let to = match packet.instruction() {
                Instruction::Bus { drop, .. } => Some(drop),
                _ => None,
            };
            let result = send(Departure { packet: self.pool.bytes_mut(&id), to, is_stamped: false });
            self.relinquish(id);
            let gateway = &mut self.gateways[index.at()];
            gateway.announced_last = false;
            gateway.sent = gateway.sent.wrapping_add(1);
            self.stage(Stage::Egress, Taker::Gateway(index), now);
            return Some(result);
        }
        None
    }
}

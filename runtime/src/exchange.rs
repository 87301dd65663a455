//! The exchange of time with a neighbour, `osap_protocol::time`.
//!
//! - **Walk:** [`Node::time_message`] is made by the egress when a gateway is free; requests and replies end at the next ingress, here.
//! - **Invariants:** a request is answered in the routing context whatever runs below; a reply is believed after all its checks.
//! - **Context:** the node's. **Clauses:** `[TIM-01]` to `[TIM-06]`.

use crate::clock::Changes;
use crate::egress::Outgoing;
use crate::node::Node;
use crate::peer::Owed;
use fixed_math::time::{LocalTicks, Rate, Span};
use osap_protocol::discovery::{ClockChange, Event, GatewayKind, KeptTime, Verbosity};
use osap_protocol::header::{Arrival, SYSTEM_HEADER_BYTES, Terminal, emit};
use osap_protocol::system::{ANNOUNCE_TTL_US, SystemKey};
use osap_protocol::time::{TimeReply, TimeRequest, stamp};
use osap_protocol::{DropCause, GatewayIndex, RouteBuf, Step};

/// Bytes of the longest message about time: header, one step, a reply.
pub(crate) const TIME_BYTES_MAX: usize = SYSTEM_HEADER_BYTES + 1 + TimeReply::LEN;

impl<const SLOTS: usize, const BYTES: usize, const GATEWAYS: usize, const PORTS: usize>
    Node<SLOTS, BYTES, GATEWAYS, PORTS>
{
    /// Whether the next packet that [`Node::transmit`] gives for `gateway` is about time, and so wants its stamp: a link whose transmitter
    /// is not idle lets it wait until it is, `[TIM-03]`.
    #[must_use]
    #[inline]
    pub fn has_time_message(&self, index: GatewayIndex, now: LocalTicks) -> bool {
        self.gateways.get(index.at()).is_some_and(|gateway| {
            let yields = gateway.announced_last && gateway.waiting > 0;
            // an announcement goes first, or a neighbour that asks without end would never hear of this node
            let announces = gateway.announce_at.is_some_and(|at| at <= now);
            now >= gateway.peer.due_at() && gateway.open && !yields && !announces
        })
    }

    /// Writes the reply that is owed, or else the request that is due, with its stamp as if it left at `now`.
    #[cold]
    pub(crate) fn time_message(&mut self, index: GatewayIndex, now: LocalTicks, out: &mut [u8]) -> Option<Outgoing> {
        let dither = self.clock.draw();
        let gateway = self.gateways.get_mut(index.at())?;
        let mut route = RouteBuf::new();
        route.push(Step::Link(index)).ok()?;
        let owed = gateway.peer.take_owed();
        let key = if owed.is_some() { SystemKey::TimeReply } else { SystemKey::TimeRequest };
        let terminal = Terminal::System { key: key.key() };
        let at = emit(out, ANNOUNCE_TTL_US, gateway.config.mtu_bytes, route.as_route(), terminal).ok()?;
        let room = out.get_mut(at..)?;
        let len = if let Some(owed) = owed {
            self.clock.reply(owed, index, gateway.config.stamps.tick).encode(room)?
        } else {
            let is_near = self.clock.is_near_source(gateway);
            gateway.peer.request(now, self.clock.interval_us(), is_near, dither).encode(room)?
        };
        let packet = out.get_mut(..at + len)?;
        stamp(packet, now);
        gateway.announced_last = true;
        gateway.sent = gateway.sent.wrapping_add(1);
        Some(Outgoing { len: packet.len(), to: None, is_stamped: true })
    }

    /// Takes a message about time that came whole by one step.
    #[cold]
    pub(crate) fn hear_time(
        &mut self,
        key: SystemKey,
        arrival: Arrival,
        payload: &[u8],
        started: LocalTicks,
        now: LocalTicks,
    ) -> Result<(), DropCause> {
        let Arrival::Link(index) = arrival else { return Err(DropCause::UnknownSystemKey) };
        if key == SystemKey::TimeRequest {
            let (TimeRequest { sequence }, asked_slot) = TimeRequest::decode(payload)?;
            let gateway = self.gateways.get_mut(index.at()).ok_or(DropCause::NoSuchGateway)?;
            if usize::from(gateway.config.mtu_bytes) < TIME_BYTES_MAX {
                return Err(DropCause::OverMtu);
            }
            gateway.peer.owe(Owed { sequence, asked_slot, heard: started });
            return Ok(());
        }
        let reply = TimeReply::decode(payload)?;
        let result = self.hear_reply(&reply, index, started, now);
        if let (Err(_), Some(gateway)) = (&result, self.gateways.get_mut(index.at())) {
            gateway.peer.refused = gateway.peer.refused.saturating_add(1);
        }
        result
    }

    fn hear_reply(
        &mut self,
        reply: &TimeReply,
        index: GatewayIndex,
        started: LocalTicks,
        now: LocalTicks,
    ) -> Result<(), DropCause> {
        let me = self.identity.unique_id;
        let gateway = self.gateways.get_mut(index.at()).ok_or(DropCause::NoSuchGateway)?;
        let stamps = gateway.config.stamps;
        gateway.peer.hear(reply, started, stamps, me)?;
        if let Some(estimate) = gateway.peer.estimate() {
            let offset = estimate.line.system_at(started).steps_after(self.clock.map().system_at(started));
            if self.clock.is_absurd(offset, reply.root.unique_id) {
                gateway.peer.said = None;
                gateway.peer.outlier(stamps, Span::from_steps(reply.tick_steps.into()));
                return Err(DropCause::TimeAbsurd);
            }
            gateway.peer.average(offset, self.clock.settings().filter_q16);
        }
        self.keep_time(now);
        Ok(())
    }

    /// Chooses whom to follow, and does it.
    pub(crate) fn keep_time(&mut self, now: LocalTicks) {
        let was_settled = self.clock.is_settled();
        let Changes { root, stepped, lost } = self.clock.follow(&self.gateways, now);
        if lost || stepped.is_some() {
            for gateway in &mut self.gateways {
                gateway.peer.hurry(now);
            }
        }
        let settled = self.clock.is_settled() && !was_settled;
        let changes = [
            (root, ClockChange::Root),
            (stepped.is_some(), ClockChange::SetAnew),
            (lost, ClockChange::RootLost),
            (settled, ClockChange::Settled),
        ];
        let tier = self.clock.tier();
        for (_, change) in changes.iter().filter(|(is_so, _)| *is_so) {
            self.debug.record(Verbosity::Events, now, || Event::Clock { change: *change, tier });
        }
    }

    /// What of the clock is to outlast a reset, where it has changed since it was last taken, `[TIM-17]`: for the application to keep.
    pub fn take_time_to_keep(&mut self, now: LocalTicks) -> Option<KeptTime> {
        self.clock.take_to_keep(&mut self.gateways, now)
    }

    /// Begins with what a former run kept, before any gateway opens, `[TIM-17]`.
    pub fn restore_time(&mut self, kept: &KeptTime) {
        let _in_range = self.clock.set(kept.settings);
        self.clock.is_changed = false;
        for (gateway, link) in self.gateways.iter_mut().zip(&kept.links) {
            gateway.peer.kept = link.peer.map(|(of, ppb)| (of, Rate::from_ppb(ppb)));
            gateway.peer.calibrate(link.asymmetry_steps, gateway.config.stamps);
        }
    }

    /// Begins to ask a neighbour that has appeared, or ends it.
    pub(crate) fn time_of_neighbour(&mut self, index: GatewayIndex, now: LocalTicks) {
        let Some(gateway) = self.gateways.get_mut(index.at()) else { return };
        match gateway.heard {
            // what could not be answered is not asked either
            Some(heard)
                if gateway.config.kind == GatewayKind::Link
                    && usize::from(gateway.config.mtu_bytes) >= TIME_BYTES_MAX =>
            {
                gateway.peer.appeared(heard.neighbour.unique_id, heard.neighbour.boot_epoch, now);
            }
            _ => gateway.peer.lost(),
        }
    }
}

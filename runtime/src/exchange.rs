//! The exchange of time with a neighbour, `osap_protocol::time`.
//!
//! - **Walk:** [`Node::time_message`] is made by the egress when a gateway is free; requests and replies end at the next ingress, here.
//! - **Invariants:** a request is answered in the routing context whatever runs below; a reply is believed after all its checks.
//! - **Context:** the node's. **Clauses:** `[TIM-01]` to `[TIM-06]`.

use crate::clock::Changes;
use crate::egress::Outgoing;
use crate::gateway::GatewayConfig;
use crate::node::Node;
use crate::peer::Owed;
use fixed_math::time::{LocalTicks, Rate, Span};
use osap_protocol::discovery::{ClockChange, Event, GatewayKind, KeptTime, Verbosity};
use osap_protocol::header::{Arrival, SYSTEM_HEADER_BYTES, Terminal, emit};
use osap_protocol::system::{ANNOUNCE_TTL_US, SystemKey};
use osap_protocol::time::{ANYBODY, TIER_MAX, TimeReply, TimeRequest, stamp};
use osap_protocol::{BusDrop, DropCause, GatewayIndex, RouteBuf, Step};

/// Bytes of the longest message about time: header, one step over a bus, a reply.
pub(crate) const TIME_BYTES_MAX: usize = SYSTEM_HEADER_BYTES + 2 + TimeReply::LEN;

/// Whether a gateway can carry a reply: who could not be answered is not asked either.
fn can_carry(config: &GatewayConfig) -> bool {
    let step = match config.kind {
        GatewayKind::Link => 1,
        GatewayKind::Bus { .. } => 2,
    };
    usize::from(config.mtu_bytes) >= SYSTEM_HEADER_BYTES + step + TimeReply::LEN
}

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
        let message = if let Some(owed) = gateway.peer.take_owed() {
            let by_partner = gateway.peer.is_partner(owed.by);
            Message::Reply(owed.by, self.clock.reply(owed, index, by_partner, gateway.config.stamps.tick))
        } else {
            let (is_near, tier) = (self.clock.is_near_source(gateway), self.clock.tier());
            let (request, to) = gateway.peer.request(now, self.clock.interval_us(), is_near, tier, dither);
            Message::Request(to, request)
        };
        let (key, to) = match &message {
            Message::Reply(to, _) => (SystemKey::TimeReply, *to),
            Message::Request(to, _) => (SystemKey::TimeRequest, *to),
        };
        let mut route = RouteBuf::new();
        route.push(to.map_or(Step::Link(index), |drop| Step::Bus { gateway: index, drop })).ok()?;
        let terminal = Terminal::System { key: key.key() };
        let at = emit(out, ANNOUNCE_TTL_US, gateway.config.mtu_bytes, route.as_route(), terminal).ok()?;
        let room = out.get_mut(at..)?;
        let len = match message {
            Message::Reply(_, reply) => reply.encode(room)?,
            Message::Request(_, request) => request.encode(room)?,
        };
        let packet = out.get_mut(..at + len)?;
        stamp(packet, now);
        gateway.announced_last = true;
        gateway.sent = gateway.sent.wrapping_add(1);
        Some(Outgoing { len: packet.len(), to, is_stamped: true })
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
        let (index, by) = match arrival {
            Arrival::Link(index) => (index, None),
            Arrival::Bus { gateway, from } => (gateway, Some(from)),
        };
        if key == SystemKey::TimeRequest {
            let (TimeRequest { sequence, below }, asked_slot) = TimeRequest::decode(payload)?;
            let gateway = self.gateways.get_mut(index.at()).ok_or(DropCause::NoSuchGateway)?;
            if !can_carry(&gateway.config) {
                return Err(DropCause::OverMtu);
            }
            // who asks for what is nearer to the root than this node is answered by others
            if below != ANYBODY && self.clock.tier() >= below {
                return Ok(());
            }
            return gateway.peer.owe(Owed { sequence, asked_slot, heard: started, by });
        }
        let reply = TimeReply::decode(payload)?;
        let result = match by {
            Some(drop) if self.gateways.get(index.at()).is_some_and(|it| it.peer.is_offer(by)) => {
                self.hear_offer(&reply, index, drop, started, now)
            }
            _ => self.hear_reply(&reply, index, started, now),
        };
        if let (Err(_), Some(gateway)) = (&result, self.gateways.get_mut(index.at())) {
            gateway.peer.refused = gateway.peer.refused.saturating_add(1);
        }
        result
    }

    /// An answer to a search on a bus: its sender becomes the partner where its time is better than the node's own, `[TIM-18]`.
    fn hear_offer(
        &mut self,
        reply: &TimeReply,
        index: GatewayIndex,
        drop: BusDrop,
        started: LocalTicks,
        now: LocalTicks,
    ) -> Result<(), DropCause> {
        let gateway = self.gateways.get_mut(index.at()).ok_or(DropCause::NoSuchGateway)?;
        let sent = gateway.peer.asked(reply, started, gateway.config.stamps)?;
        // when the request came there, by this node's counter
        let turn = reply.answered().since(reply.heard);
        let heard = sent + Span::from_steps(started.since(sent).saturating_sub(turn).steps() / 2);
        if let Some(offer) = self.clock.offered(reply, heard) {
            gateway.peer.partner_with(drop, offer, now);
        }
        Ok(())
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
        gateway.peer.hear(reply, started, stamps, me, self.clock.is_rc())?;
        if let Some(estimate) = gateway.peer.estimate() {
            let offset = estimate.line.system_at(started).steps_after(self.clock.map().system_at(started));
            if self.clock.is_absurd(estimate.line.system_at(started), started, reply.root.unique_id) {
                gateway.peer.strange_time();
                return Err(DropCause::TimeAbsurd);
            }
            gateway.peer.average(offset, self.clock.settings().filter_q16);
        }
        // a partner that has its time from here, or has none, is no partner
        if reply.is_yours || reply.root.unique_id == me || reply.tier > TIER_MAX {
            gateway.peer.part();
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
        let can_ask = gateway.open && can_carry(&gateway.config);
        match (gateway.config.kind, gateway.heard) {
            (GatewayKind::Link, Some(heard)) if can_ask => {
                gateway.peer.appeared(heard.neighbour.unique_id, heard.neighbour.boot_epoch, now);
            }
            // whoever comes to a bus, the search goes on
            (GatewayKind::Bus { .. }, _) if can_ask => {}
            _ => gateway.peer.lost(),
        }
    }

    /// A gateway has opened or closed: on a bus a partner is looked for.
    pub(crate) fn time_of_gateway(&mut self, index: GatewayIndex, now: LocalTicks) {
        let dither = self.clock.draw();
        let Some(gateway) = self.gateways.get_mut(index.at()) else { return };
        gateway.peer.lost();
        let is_bus = matches!(gateway.config.kind, GatewayKind::Bus { .. });
        if is_bus && gateway.open && can_carry(&gateway.config) {
            gateway.peer.on_bus(now, dither);
        }
    }
}

/// What is to be sent, and on a bus to whom.
enum Message {
    Reply(Option<BusDrop>, TimeReply),
    Request(Option<BusDrop>, TimeRequest),
}

//! Who is at the other end: announcements sent and heard.
//!
//! - **Walk:** beside it: an announcement is made by the egress and ends at the next ingress.
//! - **Clauses:** `[SYS-02]` to `[SYS-06]`.

use crate::egress::Outgoing;
use crate::gateway::Heard;
use crate::node::Node;
use fixed_math::time::{LocalTicks, Span};
use osap_protocol::discovery::{Event, GatewayKind, Neighbour, NeighbourChange, Verbosity};
use osap_protocol::header::{Arrival, Terminal, emit};
use osap_protocol::system::{
    ANNOUNCE_INTERVAL_US, ANNOUNCE_TTL_US, ANNOUNCEMENT_VERSION, Announcement, NEIGHBOUR_TIMEOUT_US, SystemKey,
};
use osap_protocol::{BusDrop, DropCause, GatewayIndex, RouteBuf, Step};

impl<const SLOTS: usize, const BYTES: usize, const GATEWAYS: usize, const PORTS: usize>
    Node<SLOTS, BYTES, GATEWAYS, PORTS>
{
    /// Writes an announcement into `out`, `[SYS-03]`; `None`, tried again later, where it does not fit.
    #[cold]
    pub(crate) fn announce(&mut self, index: GatewayIndex, now: LocalTicks, out: &mut [u8]) -> Option<Outgoing> {
        let gateway = self.gateways.get_mut(index.at())?;
        let (step, drop, to, next) = match gateway.config.kind {
            GatewayKind::Link => (Step::Link(index), None, None, Some(now + Span::from_us(ANNOUNCE_INTERVAL_US))),
            GatewayKind::Bus { drop } => {
                let to = BusDrop::BROADCAST;
                (Step::Bus { gateway: index, drop: to }, Some(drop), Some(to), None)
            }
        };
        gateway.announce_at = next;
        let announcement = Announcement {
            version: ANNOUNCEMENT_VERSION,
            unique_id: self.identity.unique_id,
            boot_epoch: self.identity.boot_epoch,
            wants_answer: gateway.heard.is_none(),
            drop,
        };
        let mut route = RouteBuf::new();
        route.push(step).ok()?;
        let terminal = Terminal::System { key: SystemKey::Announcement.key() };
        let at = emit(out, ANNOUNCE_TTL_US, gateway.config.mtu_bytes, route.as_route(), terminal).ok()?;
        let len = at + announcement.encode(out.get_mut(at..)?).ok()?;
        gateway.announced_last = true;
        gateway.sent = gateway.sent.wrapping_add(1);
        Some(Outgoing { len, to, is_stamped: false })
    }

    /// Takes a neighbour's announcement; `theirs` is its own gateway index, which stood in the step it used, `[SYS-04]`.
    #[cold]
    pub(crate) fn hear_announcement(
        &mut self,
        arrival: Arrival,
        theirs: Option<GatewayIndex>,
        payload: &[u8],
        now: LocalTicks,
    ) -> Result<(), DropCause> {
        let Announcement { unique_id, boot_epoch, wants_answer, .. } = Announcement::decode(payload)?;
        let index = arrival.gateway();
        let gateway = self.gateways.get_mut(index.at()).ok_or(DropCause::NoSuchGateway)?;
        let (Arrival::Link(_), Some(theirs)) = (arrival, theirs) else {
            // on a bus there is no one neighbour to keep: that somebody came is all there is to say, `[SYS-06]`, and whom to ask for the time
            if let Arrival::Bus { from, .. } = arrival {
                gateway.peer.heard_on_bus(from, unique_id, self.identity.unique_id);
            }
            self.note_change(index, NeighbourChange::Appeared, now);
            return Ok(());
        };
        let change = match gateway.heard.map(|heard| heard.neighbour) {
            None => Some(NeighbourChange::Appeared),
            Some(known) if known.unique_id != unique_id => Some(NeighbourChange::Swapped),
            Some(known) if known.boot_epoch != boot_epoch => Some(NeighbourChange::Rebooted),
            Some(_) => None,
        };
        let neighbour = Neighbour { unique_id, boot_epoch, gateway: theirs.get() };
        gateway.heard = Some(Heard { neighbour, at: now });
        self.silence_at = self.silence_at.min(now + Span::from_us(NEIGHBOUR_TIMEOUT_US) + Span::from_steps(1));
        if wants_answer || change.is_some() {
            gateway.announce_at = Some(now);
        }
        if let Some(change) = change {
            self.note_change(index, change, now);
        }
        Ok(())
    }

    /// Forgets the neighbour of a gateway, if it had one.
    pub(crate) fn neighbour_lost(&mut self, index: GatewayIndex, now: LocalTicks) {
        if self.gateways[index.at()].heard.take().is_some() {
            self.note_change(index, NeighbourChange::Lost, now);
        }
    }

    fn note_change(&mut self, index: GatewayIndex, change: NeighbourChange, now: LocalTicks) {
        self.topology_generation = self.topology_generation.wrapping_add(1);
        self.gateways[index.at()].change = Some(change);
        self.time_of_neighbour(index, now);
        if change != NeighbourChange::Lost {
            self.halt_for_neighbour(index, now);
        }
        self.debug.record(Verbosity::Events, now, || Event::Neighbour { gateway: index.get(), change });
    }
}

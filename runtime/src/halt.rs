//! The halt's way through the network: heard once, told to every other neighbour, `osap_protocol::halt`.
//!
//! - **Walk:** [`Node::raise_halt`] or a neighbour's message → [`Node::halt`] for the application → the egress of every open gateway,
//!   before packets and announcements.
//! - **Invariants:** a node tells each neighbour the latest halt it knows a bounded number of times, and nobody an older one, so that a
//!   ring carries no message for ever.
//! - **Context:** the node's. **Clauses:** `[MOT-20]` to `[MOT-23]`.

use crate::egress::Outgoing;
use crate::node::Node;
use fixed_math::time::{LocalTicks, NetTime, Span};
use osap_protocol::discovery::GatewayKind;
use osap_protocol::halt::{Action, HALT_REPEAT_US, HALT_REPEATS, Halt};
use osap_protocol::header::{Arrival, SYSTEM_HEADER_BYTES, Terminal, emit};
use osap_protocol::system::{ANNOUNCE_TTL_US, SystemKey};
use osap_protocol::{BusDrop, DropCause, GatewayIndex, RouteBuf, Step};

/// Bytes of the longest halt: header, one step over a bus, the message.
pub(crate) const HALT_BYTES_MAX: usize = SYSTEM_HEADER_BYTES + 2 + Halt::LEN;

/// What a gateway still has to tell.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Telling {
    left: u8,
    at: LocalTicks,
}

impl Telling {
    /// Nothing.
    pub(crate) const NONE: Self = Self { left: 0, at: LocalTicks::ZERO };

    /// From the beginning.
    fn begin(&mut self, now: LocalTicks) {
        *self = Self { left: HALT_REPEATS, at: now };
    }

    /// When it is due, if it is.
    pub(crate) const fn due_at(self) -> Option<LocalTicks> {
        if self.left > 0 { Some(self.at) } else { None }
    }
}

impl<const SLOTS: usize, const BYTES: usize, const GATEWAYS: usize, const PORTS: usize>
    Node<SLOTS, BYTES, GATEWAYS, PORTS>
{
    /// The latest halt that this node knows of.
    #[must_use]
    pub const fn halt(&self) -> Option<Halt> {
        self.halt
    }

    /// Makes a halt that overrules every one known here, and tells all neighbours, `[MOT-21]`.
    pub fn raise_halt(&mut self, action: Action, epoch: NetTime, now: LocalTicks) -> Halt {
        let sequence = self.halt.map_or(1, |known| known.sequence.saturating_add(1));
        let halt = Halt { action, sequence, epoch, origin: self.identity.unique_id };
        self.halt = Some(halt);
        self.halt_is_new = true;
        self.tell_halt(None, now);
        halt
    }

    /// Whether there is another halt than when this was asked last: who plays tracks has something to do.
    pub const fn take_halt_news(&mut self) -> bool {
        core::mem::replace(&mut self.halt_is_new, false)
    }

    /// Has all open gateways but `except` tell the latest halt.
    fn tell_halt(&mut self, except: Option<GatewayIndex>, now: LocalTicks) {
        for index in self.gateway_indices() {
            let gateway = &mut self.gateways[index.at()];
            if gateway.open && Some(index) != except {
                gateway.telling.begin(now);
            }
        }
    }

    /// A neighbour that has come is told what holds, `[MOT-23]`.
    pub(crate) fn halt_for_neighbour(&mut self, index: GatewayIndex, now: LocalTicks) {
        if self.halt.is_some()
            && let Some(gateway) = self.gateways.get_mut(index.at())
        {
            gateway.telling.begin(now);
        }
    }

    /// Whether `gateway` has a halt to tell.
    pub(crate) fn has_halt(&self, index: GatewayIndex, now: LocalTicks) -> bool {
        let telling = self.gateways.get(index.at()).filter(|it| it.open).and_then(|it| it.telling.due_at());
        telling.is_some_and(|at| at <= now)
    }

    /// Writes the latest halt for one gateway.
    #[cold]
    pub(crate) fn halt_message(&mut self, index: GatewayIndex, now: LocalTicks, out: &mut [u8]) -> Option<Outgoing> {
        let halt = self.halt?;
        let gateway = self.gateways.get_mut(index.at())?;
        let (step, to) = match gateway.config.kind {
            GatewayKind::Link => (Step::Link(index), None),
            GatewayKind::Bus { .. } => {
                (Step::Bus { gateway: index, drop: BusDrop::BROADCAST }, Some(BusDrop::BROADCAST))
            }
        };
        gateway.telling.left -= 1;
        gateway.telling.at = now + Span::from_us(HALT_REPEAT_US);
        let mut route = RouteBuf::new();
        route.push(step).ok()?;
        let terminal = Terminal::System { key: SystemKey::Halt.key() };
        let at = emit(out, ANNOUNCE_TTL_US, gateway.config.mtu_bytes, route.as_route(), terminal).ok()?;
        out.get_mut(at..at + Halt::LEN)?.copy_from_slice(&halt.encode());
        gateway.sent = gateway.sent.wrapping_add(1);
        Some(Outgoing { len: at + Halt::LEN, to, is_stamped: false })
    }

    /// Takes a halt that came whole by one step: a later one is kept and told on; an older one's sender is told what holds.
    #[cold]
    pub(crate) fn hear_halt(&mut self, arrival: Arrival, payload: &[u8], now: LocalTicks) -> Result<(), DropCause> {
        let heard = Halt::decode(payload)?;
        let from = arrival.gateway();
        match self.halt {
            Some(known) if known == heard => {}
            Some(known) if !heard.is_later_than(&known) => {
                if self.gateways.get(from.at()).is_some_and(|it| it.telling.left == 0) {
                    self.halt_for_neighbour(from, now);
                }
            }
            _ => {
                self.halt = Some(heard);
                self.halt_is_new = true;
                // the drops of a bus heard it by the same broadcast, and a neighbour knows what it told
                self.tell_halt(Some(from), now);
            }
        }
        Ok(())
    }
}

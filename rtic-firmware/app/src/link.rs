//! A link of an image: a board's wire on one side, the node on the other, framing in between.
//!
//! - **Walk:** receive interrupt or DMA → [`Wire::drain`] → deframer → [`Link::receive`] → ingress; egress → [`Link::transmit`] → frame →
//!   [`Wire::send`].
//! - **Invariants:** what fails its check is counted under its gateway; a packet is taken off the stack only once its wire has room for
//!   its frame, so that the earliest deadline is chosen as late as the wire allows.
//! - **Context:** the routing task; O(bytes) a call. **Clauses:** `[LNK-01]`, `[FRM-08]`, `[NOD-08]`, `[TIM-03]`.

use fixed_math::time::LocalTicks;
use osap_protocol::framing::{Deframer, Frame, FrameError, Framer};
use osap_protocol::header::Arrival;
use osap_protocol::time::{SLOT_BYTES, stamp};
use osap_protocol::{DropCause, GatewayIndex};
use osap_runtime::ring::HandOver;
use osap_runtime::{Departure, GatewayConfig, Node};

/// Bytes of a packet that are framed before the first of them may leave: some zero stands among them, so that a run has ended.
const HEAD_BYTES: usize = 12;

/// What an image needs of one link's hardware. Boards implement it.
pub trait Wire {
    /// Whether bytes can be carried at all: a UART always, USB once it is configured.
    fn is_up(&self) -> bool {
        true
    }

    /// Gives what has come since the last call to `take`, oldest first, in runs of at least one byte. A delimiter ends its run, and the
    /// stamp is that of the run's first byte. It is `now`.
    fn drain(&mut self, now: LocalTicks, take: impl FnMut(&[u8], LocalTicks));

    /// Frames lost for want of room since last asked.
    fn take_overruns(&mut self) -> u32;

    /// When all that it was given will have left, which is `now` where it is idle; `None` while it has no room for a frame.
    fn clear_at(&mut self, now: LocalTicks) -> Option<LocalTicks>;

    /// Room for the next frame, to be filled before [`Wire::send`]; never shorter than the longest frame while [`Wire::clear_at`] is some.
    fn room(&mut self) -> &mut [u8];

    /// The first `len` bytes of the room will not change: they may leave at once, while the rest is being made. A wire that is not idle, or
    /// that sends whole frames, lets them wait.
    fn send_head(&mut self, len: usize) {
        let _: usize = len;
    }

    /// As [`Wire::send_head`], for a frame that wants the stamp of its departure: when its first byte left, `[TIM-03]`. `None`, and nothing has
    /// left, where the wire is not idle or sends whole frames; then the frame carries the instant it is sent `at`.
    fn send_head_stamped(&mut self, len: usize) -> Option<LocalTicks> {
        let _: usize = len;
        None
    }

    /// Sends the first `len` bytes of the room, or what of them has not left yet, from `at` on or, where that is past, at once.
    fn send(&mut self, len: usize, at: LocalTicks);
}

/// A wire, its gateway and its framing. `FRAME` is the longest packet and its check, bytes; `BYTES` the longest packet. The
/// wire's room holds the frame of the longest packet.
pub struct Link<W, const BYTES: usize, const FRAME: usize> {
    wire: W,
    gateway: GatewayIndex,
    config: GatewayConfig,
    deframer: Deframer<FRAME>,
    /// When a frame that wants its stamp can leave: it waits for an idle wire.
    stamped_at: Option<LocalTicks>,
}

impl<W: Wire, const BYTES: usize, const FRAME: usize> Link<W, BYTES, FRAME> {
    /// The link of `node`'s next gateway; `None` where it has no place for another.
    pub fn new<const SLOTS: usize, const GATEWAYS: usize, const PORTS: usize>(
        wire: W,
        config: GatewayConfig,
        node: &mut Node<SLOTS, BYTES, GATEWAYS, PORTS>,
    ) -> Option<Self> {
        let gateway = node.add_gateway(config)?;
        Some(Self { wire, gateway, config, deframer: Deframer::new(config.check), stamped_at: None })
    }

    /// The wire, for what its interrupts need of it.
    pub const fn wire(&mut self) -> &mut W {
        &mut self.wire
    }

    /// When [`Link::transmit`] can go on though nothing happens until then.
    pub const fn next_wake(&self) -> Option<LocalTicks> {
        self.stamped_at
    }

    /// Takes in what has come; says whether a frame ended, so that there is something to route.
    pub fn receive<const SLOTS: usize, const GATEWAYS: usize, const PORTS: usize>(
        &mut self,
        node: &mut Node<SLOTS, BYTES, GATEWAYS, PORTS>,
        now: LocalTicks,
    ) -> bool {
        let Self { wire, gateway, deframer, .. } = self;
        let up = wire.is_up();
        if !up {
            deframer.reset();
        }
        node.set_open(*gateway, up, now);
        let mut ended = false;
        wire.drain(now, |run, at| {
            if let Some(frame) = deframer.push_run(run, at) {
                accept(node, *gateway, frame, now);
                ended = true;
            }
        });
        for _ in 0..wire.take_overruns() {
            node.count(DropCause::RxOverrun, Some(*gateway), now);
        }
        ended
    }

    /// Sends what the node has for this link, as long as the wire has room.
    pub fn transmit<const SLOTS: usize, const GATEWAYS: usize, const PORTS: usize>(
        &mut self,
        node: &mut Node<SLOTS, BYTES, GATEWAYS, PORTS>,
        now: LocalTicks,
    ) {
        self.stamped_at = None;
        while node.has_output(self.gateway, now)
            && let Some(at) = self.wire.clear_at(now)
        {
            if at > now && node.has_time_message(self.gateway, now) {
                self.stamped_at = Some(at);
                break;
            }
            // what waits for the bytes before it has that much less time to live
            let Self { wire, config, .. } = self;
            let sent = node.transmit_with(self.gateway, at, BYTES, |Departure { packet, is_stamped, .. }| {
                let mut framer = Framer::new(config.check);
                // the slot is not known before the head has left
                let settled = if is_stamped { packet.len().saturating_sub(SLOT_BYTES) } else { packet.len() };
                let head_len = settled.min(HEAD_BYTES);
                framer.push_head(&packet[..head_len], wire.room());
                if !is_stamped {
                    wire.send_head(framer.settled());
                } else if let Some(departed) = wire.send_head_stamped(framer.settled()) {
                    stamp(packet, departed);
                }
                let (head, rest) = packet.split_at(head_len);
                framer.digest(head);
                framer.push(rest, wire.room());
                let len = framer.finish(wire.room());
                wire.send(len, at);
            });
            if sent.is_none() {
                break;
            }
        }
    }
}

/// One frame to the node, or its failure to the counters.
fn accept<const SLOTS: usize, const BYTES: usize, const GATEWAYS: usize, const PORTS: usize>(
    node: &mut Node<SLOTS, BYTES, GATEWAYS, PORTS>,
    gateway: GatewayIndex,
    frame: Result<Frame<'_>, FrameError>,
    now: LocalTicks,
) {
    match frame {
        Ok(Frame { packet, started }) => {
            let _counted = node.receive(Arrival::Link(gateway), packet, started, now);
        }
        Err(error) => node.count(error.into(), Some(gateway), now),
    }
}

/// Gives what an interrupt captured in a ring to `take`, as [`Wire::drain`] wants it.
pub fn drain_ring(ring: &mut HandOver<'_>, mut take: impl FnMut(&[u8], LocalTicks)) {
    ring.bytes(|byte, started| take(&[byte], started));
}

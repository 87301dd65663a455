//! What a node's processor takes its time for.
//!
//! - **Walk:** captured frame → `receive` → packets for ports → `handle`, packets for gateways → `forward` → the wire.
//! - **Invariant:** a single server: one job at a time, none is interrupted.
//! - **Context:** the world's. **Clause:** `[NOD-08]`: capturing itself is an interrupt's work and takes none of this time.

use fixed_math::time::Span;

/// Frames that each gateway's ring holds, the one in work included; more are `rx-overrun`.
pub const RING_FRAMES: usize = 8;

/// A processor, as service times a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Processor {
    /// Which one, for people.
    pub name: &'static str,
    /// Clock frequency, for people.
    pub clock_hz: u32,
    /// From the hand-over of a captured frame to the packet in the deadline stack: deframe, check, ingress, route.
    pub receive: Span,
    /// Delivery to a port, the port's work, and the reply back in the stack.
    pub handle: Span,
    /// From the stack to the first byte on the wire: egress, framing.
    pub forward: Span,
}

impl Processor {
    /// Takes no time for anything: for tests of the protocol alone.
    pub const INSTANT: Self =
        Self { name: "instant", clock_hz: 0, receive: Span::ZERO, handle: Span::ZERO, forward: Span::ZERO };

    /// A processor that takes `total` to receive, handle and answer a packet, of which receiving and handling have two fifths each and
    /// forwarding one. Nobody measured the parts: receiving touches each byte three times (unstuff, check, copy), answering a query
    /// about as often, sending twice.
    #[must_use]
    pub const fn with_total(name: &'static str, clock_hz: u32, total: Span) -> Self {
        let fifth = Span::from_steps(total.steps() / 5);
        let two = fifth.saturating_mul(2);
        Self { name, clock_hz, receive: two, handle: two, forward: fifth }
    }

    /// The whole time a packet takes to be received, handled and answered.
    #[must_use]
    pub fn total(&self) -> Span {
        self.receive + self.handle + self.forward
    }
}

//! Links over what an operating system offers: USB and other serial ports, TCP, UDP, pseudo-terminals, channels.
//!
//! - **Walk:** bytes of a peer → a link's reader thread (`stream` or a datagram; fault layer; check) → [`LinkEvent::Packet`] → the
//!   node's thread → [`LinkHandle::send`] → the link's writer thread → bytes to the peer.
//! - **Invariants:** two threads a link, bounded channels only: a slow node makes readers wait, and then the peer. No input panics.
//! - **Clauses:** `[LNK-01]`, `[LNK-02]`, `[LNK-04]` to `[LNK-07]`, `[FRM-08]`, `[FRM-09]`.

mod clock;
mod handle;

pub use clock::Clock;
pub use handle::{LinkDescription, LinkEvent, LinkFaults, LinkGone, LinkHandle};

//! What the world needs of a node: the sans-IO calls of a runtime with its application, behind one object-safe trait.
//!
//! - **Walk:** a captured frame → [`Endpoint::receive`] → [`Endpoint::run`] → [`Endpoint::transmit`] → the wire.
//! - **Invariants:** an endpoint has no clock and starts nothing by itself: it acts only when called, on the local time it is given.
//! - **Context:** the thread that steps the world. **Clauses:** `[NOD-12]`, `[LNK-01]`.
//!
//! The trait is a subtrait of [`Any`], so that the world can give back the type that went in.

use fixed_math::time::LocalTicks;
use osap_protocol::header::Arrival;
use osap_protocol::{DropCause, GatewayIndex};
use osap_runtime::debug::DebugRing;
use osap_runtime::{GatewayConfig, Outgoing};
use std::any::Any;

/// A node with what runs on it. All times are its own counter's.
pub trait Endpoint: Any + Send {
    /// Takes in a packet that came whole by `arrival`; `started` is the stamp of its first byte. The packet's bytes may be rewritten.
    /// What cannot be taken is dropped and counted inside.
    fn receive(&mut self, arrival: Arrival, packet: &mut [u8], started: LocalTicks, now: LocalTicks);

    /// Serves the packets that wait for ports and does whatever else is due at `now`. Called where [`Endpoint::waiting`] is not zero,
    /// and when [`Endpoint::next_wake`] has come.
    fn run(&mut self, now: LocalTicks);

    /// Packets that the next [`Endpoint::run`] has to serve or make: each takes the processor for its `handle` time.
    fn waiting(&self, now: LocalTicks) -> usize;

    /// Copies the next packet for `gateway`, which is clear to send, into `out`.
    fn transmit(&mut self, gateway: GatewayIndex, now: LocalTicks, out: &mut [u8]) -> Option<Outgoing>;

    /// Whether [`Endpoint::transmit`] would find something.
    fn has_output(&self, gateway: GatewayIndex, now: LocalTicks) -> bool;

    /// When there is something to do even if no packet comes.
    fn next_wake(&self) -> Option<LocalTicks>;

    /// Says whether a gateway can carry packets.
    fn set_open(&mut self, gateway: GatewayIndex, open: bool, now: LocalTicks);

    /// Counts a drop that happened outside the node.
    fn count(&mut self, cause: DropCause, gateway: Option<GatewayIndex>, now: LocalTicks);

    /// A gateway's fixed properties, where there is such a gateway; its MTU as the node cut it.
    fn gateway_config(&self, gateway: GatewayIndex) -> Option<GatewayConfig>;

    /// What happened last in the node.
    fn debug(&self) -> &DebugRing;

    /// As [`Endpoint::debug`], to set the verbosity.
    fn debug_mut(&mut self) -> &mut DebugRing;

    /// Packet slots nobody holds.
    fn free_slots(&self) -> usize;

    /// A new name, once, to be kept over a reset, `[DSC-05]`. Endpoints that cannot be renamed have none.
    fn take_new_name(&mut self) -> Option<&str> {
        None
    }
}

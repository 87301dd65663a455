//! The host as a node of a simulated world: the very core that runs over real links.
//!
//! - **Walk:** the world's events → these calls → [`HostCore`]. The node's thread over real links makes the same calls.
//! - **Context:** the thread that steps the world.

use super::HostCore;
use fixed_math::time::LocalTicks;
use osap_protocol::header::Arrival;
use osap_protocol::{DropCause, GatewayIndex, PortIndex};
use osap_runtime::debug::DebugRing;
use osap_runtime::gateway::Gateway;
use osap_runtime::{GatewayConfig, Outgoing};
use osap_sim::endpoint::Endpoint;

impl Endpoint for HostCore {
    fn receive(&mut self, arrival: Arrival, packet: &mut [u8], started: LocalTicks, now: LocalTicks) {
        self.turn = self.turn.wrapping_add(1);
        // a drop is counted in the node
        let _counted = self.node.receive(arrival, packet, started, now);
    }

    fn run(&mut self, now: LocalTicks) {
        HostCore::run(self, now);
    }

    fn waiting(&self, _now: LocalTicks) -> usize {
        [PortIndex::NETRESPONDER, self.netrunner, self.stream].into_iter().map(|port| self.node.waiting(port)).sum()
    }

    fn transmit(&mut self, gateway: GatewayIndex, now: LocalTicks, out: &mut [u8]) -> Option<Outgoing> {
        self.node.transmit(gateway, now, out)
    }

    fn has_output(&self, gateway: GatewayIndex, now: LocalTicks) -> bool {
        self.node.has_output(gateway, now)
    }

    fn next_wake(&self) -> Option<LocalTicks> {
        HostCore::next_wake(self)
    }

    fn set_open(&mut self, gateway: GatewayIndex, open: bool, now: LocalTicks) {
        let down = (!open).then(|| "the link was closed".to_owned());
        self.set_link(gateway, down, now);
    }

    fn count(&mut self, cause: DropCause, gateway: Option<GatewayIndex>, now: LocalTicks) {
        self.node.count(cause, gateway, now);
    }

    fn gateway_config(&self, gateway: GatewayIndex) -> Option<GatewayConfig> {
        self.node.gateway(gateway).map(Gateway::config).copied()
    }

    fn debug(&self) -> &DebugRing {
        self.node.debug()
    }

    fn debug_mut(&mut self) -> &mut DebugRing {
        self.node.debug_mut()
    }

    fn free_slots(&self) -> usize {
        self.node.free_slots()
    }
}

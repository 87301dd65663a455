//! The workstation's place in a simulated machine, left open: packets go through unchanged to links of the operating system.
//!
//! - **Walk:** the machine's wires → [`Bridge`]'s `receive` → [`Bridge::leaving`] → a link; a link → [`Bridge::enter`] → `transmit` → the wires.
//! - **Invariants:** no byte is changed: to the machine and to the workstation it is one link. Queues are bounded; where one is full the
//!   oldest packet makes way, since its deadline is the first to pass.
//! - **Context:** the thread that steps the world. **Clause:** `[LNK-01]`.

use fixed_math::time::LocalTicks;
use osap_protocol::header::Arrival;
use osap_protocol::{DropCause, GatewayIndex};
use osap_runtime::debug::DebugRing;
use osap_runtime::{GatewayConfig, Outgoing};
use osap_sim::endpoint::Endpoint;
use std::collections::VecDeque;

/// Packets that wait for one direction of one link.
const QUEUE_PACKETS: usize = 64;

/// One link and what waits for it.
#[derive(Debug)]
struct Lane {
    config: GatewayConfig,
    entering: VecDeque<Vec<u8>>,
    leaving: VecDeque<Vec<u8>>,
}

/// A node that is none.
#[derive(Debug)]
pub(super) struct Bridge {
    lanes: Vec<Lane>,
    debug: DebugRing,
}

impl Bridge {
    /// A bridge with these gateways.
    pub(super) fn new(gateways: &[GatewayConfig]) -> Self {
        let lane =
            |config: &GatewayConfig| Lane { config: *config, entering: VecDeque::new(), leaving: VecDeque::new() };
        Self { lanes: gateways.iter().map(lane).collect(), debug: DebugRing::new() }
    }

    /// Brings a packet in. The world is to be told by `poke`.
    pub(super) fn enter(&mut self, gateway: GatewayIndex, packet: Vec<u8>) {
        if let Some(lane) = self.lane(gateway) {
            push(&mut lane.entering, packet);
        }
    }

    /// The next packet that leaves the machine.
    pub(super) fn leaving(&mut self, gateway: GatewayIndex) -> Option<Vec<u8>> {
        self.lane(gateway)?.leaving.pop_front()
    }

    /// Forgets what waits: the other side is gone.
    pub(super) fn clear(&mut self, gateway: GatewayIndex) {
        if let Some(lane) = self.lane(gateway) {
            lane.entering.clear();
            lane.leaving.clear();
        }
    }

    fn lane(&mut self, gateway: GatewayIndex) -> Option<&mut Lane> {
        self.lanes.get_mut(gateway.at())
    }
}

fn push(queue: &mut VecDeque<Vec<u8>>, packet: Vec<u8>) {
    if queue.len() == QUEUE_PACKETS {
        queue.pop_front();
    }
    queue.push_back(packet);
}

impl Endpoint for Bridge {
    fn receive(&mut self, arrival: Arrival, packet: &mut [u8], _started: LocalTicks, _now: LocalTicks) {
        if let Some(lane) = self.lane(arrival.gateway()) {
            push(&mut lane.leaving, packet.to_vec());
        }
    }

    fn run(&mut self, _now: LocalTicks) {}

    fn waiting(&self, _now: LocalTicks) -> usize {
        0
    }

    fn transmit(&mut self, gateway: GatewayIndex, _now: LocalTicks, out: &mut [u8]) -> Option<Outgoing> {
        let packet = self.lane(gateway)?.entering.pop_front()?;
        // Longer than the machine's link carries: as on hardware it gets nowhere.
        let room = out.get_mut(..packet.len())?;
        room.copy_from_slice(&packet);
        Some(Outgoing { len: packet.len(), to: None, is_stamped: false })
    }

    fn has_output(&self, gateway: GatewayIndex, _now: LocalTicks) -> bool {
        self.lanes.get(gateway.at()).is_some_and(|lane| !lane.entering.is_empty())
    }

    fn next_wake(&self) -> Option<LocalTicks> {
        None
    }

    fn set_open(&mut self, gateway: GatewayIndex, open: bool, _now: LocalTicks) {
        if !open {
            self.clear(gateway);
        }
    }

    fn count(&mut self, _cause: DropCause, _gateway: Option<GatewayIndex>, _now: LocalTicks) {}

    fn gateway_config(&self, gateway: GatewayIndex) -> Option<GatewayConfig> {
        self.lanes.get(gateway.at()).map(|lane| lane.config)
    }

    fn debug(&self) -> &DebugRing {
        &self.debug
    }

    fn debug_mut(&mut self) -> &mut DebugRing {
        &mut self.debug
    }

    fn free_slots(&self) -> usize {
        QUEUE_PACKETS
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osap_sim::machines::UART;

    const FIRST: GatewayIndex = GatewayIndex::from_low_bits(0);

    #[test]
    fn packets_go_through_as_they_are_and_the_oldest_makes_way() {
        let mut bridge = Bridge::new(&[UART]);
        for n in 0..=QUEUE_PACKETS {
            let packet = vec![u8::try_from(n).unwrap(); 3];
            bridge.enter(FIRST, packet.clone());
            bridge.receive(Arrival::Link(FIRST), &mut packet.clone(), LocalTicks::ZERO, LocalTicks::ZERO);
        }
        let mut out = [0; 256];
        let sent = bridge.transmit(FIRST, LocalTicks::ZERO, &mut out).unwrap();
        assert_eq!((&out[..sent.len], bridge.leaving(FIRST)), (&[1; 3][..], Some(vec![1; 3])));
        bridge.clear(FIRST);
        assert!(!bridge.has_output(FIRST, LocalTicks::ZERO) && bridge.leaving(FIRST).is_none());
    }

    #[test]
    fn a_packet_too_long_for_the_machine_and_a_gateway_that_is_not_there_are_no_fault_of_ours() {
        let mut bridge = Bridge::new(&[UART]);
        bridge.enter(FIRST, vec![0; 300]);
        bridge.enter(GatewayIndex::from_low_bits(9), vec![0; 3]);
        assert_eq!(bridge.transmit(FIRST, LocalTicks::ZERO, &mut [0; 256]), None);
        assert!(!bridge.has_output(FIRST, LocalTicks::ZERO));
    }
}

//! A shared medium: one member speaks, all others hear its bytes, and each decides for itself what was for it.
//!
//! - **Walk:** a member asks → the lowest drop is granted → egress → real framing → wire time → (faults) → latency → every other
//!   member's deframer and address filter.
//! - **Invariants:** one frame at a time is on the medium, and who asks waits for its last bit, in the fault layer's bandwidth too. What
//!   arrives was heard by each listener once: taken, passed over, found damaged, or missed in a reset.
//! - **Context:** the thread that steps the world. **Clauses:** `[FRM-10]`, `[PKT-15]`, `[LNK-03]`, `[LNK-07]`.
//!
//! Addresses are bytes like all others: a flipped bit may make a frame one for somebody else. So nobody but a listener's own check
//! and filter decides who gets a frame, and a damaged one is counted by each who heard it.

use super::queue::What;
use super::station::Attachment;
use super::wire::encode_frame;
use super::{BusId, NodeId, Tap, TapEvent, World, is_the_links_own};
use crate::faults::{FaultConfig, FaultCounts, FaultLayer};
use crate::time::TrueTime;
use fixed_math::time::{LocalTicks, Span};
use osap_protocol::discovery::GatewayKind;
use osap_protocol::{BusDrop, GatewayIndex};
use osap_runtime::Outgoing;
use std::collections::{BTreeSet, VecDeque};

/// The first stream of random numbers that is a bus's; links count theirs from zero and never come so far.
const BUS_STREAMS: u64 = 1 << 40;

/// What a bus adds to its gateways' wire time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BusModel {
    /// From a byte's leaving to its arrival.
    pub latency: Span,
    /// Faults of the medium: what they do to a frame, they do to it for all who listen.
    pub faults: Option<FaultConfig>,
}

/// What a bus carried. `arrived × (members − 1)` frames were heard; where no bit was flipped that is `taken + passed_over + missed`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BusStats {
    /// Frames that were spoken.
    pub frames: u64,
    /// Their bytes: addresses, stuffing, check and delimiter included.
    pub bytes: u64,
    /// Frames that reached those who listen; a fault layer makes them fewer or more than were spoken.
    pub arrived: u64,
    /// Frames that a listener took as its own or as one for all: one count each listener.
    pub taken: u64,
    /// Frames that a listener found to be for another drop.
    pub passed_over: u64,
    /// Runs of bytes in which a listener found no frame; it counted them by their cause.
    pub damaged: u64,
    /// Frames that a listener did not hear whole, since it was reset in their midst.
    pub missed: u64,
    /// Frames that arrived and that nobody took or counted: to a drop that nobody has, or that was being reset.
    pub lost: u64,
}

/// What one listener made of the bytes of a frame.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Heard {
    pub(super) taken: u64,
    /// Those of them that found its ring full.
    pub(super) overrun: u64,
    pub(super) passed_over: u64,
    pub(super) damaged: u64,
    pub(super) missed: u64,
}

/// A frame between its speaker's first byte and the listeners.
struct Airborne {
    from: BusDrop,
    /// When its first byte reaches them.
    began: TrueTime,
    bytes: Vec<u8>,
}

/// A shared medium.
pub(super) struct Bus {
    latency: Span,
    members: Vec<(BusDrop, NodeId, GatewayIndex)>,
    /// Who wants to send, in order of their drops: the lowest is served first.
    requests: BTreeSet<BusDrop>,
    /// Who is sending.
    speaker: Option<(NodeId, GatewayIndex, u32)>,
    faults: Option<FaultLayer>,
    /// When the fault layer's next frame is planned.
    faults_at: TrueTime,
    /// What leaves and is not yet in the fault layer.
    leaving: Option<(BusDrop, Vec<u8>)>,
    /// What is to be heard, in order: the delay is one for all.
    air: VecDeque<Airborne>,
    /// When the last frame so far has arrived.
    arrived: TrueTime,
    stats: BusStats,
    tap: Option<Tap>,
}

impl World {
    /// Wires gateways to one shared medium and opens them; each has its drop from its configuration.
    ///
    /// # Panics
    /// Where a gateway does not exist, is wired already, is not one for a bus, or has a drop that another has.
    pub fn bus(&mut self, members: &[(NodeId, GatewayIndex)], model: BusModel) -> BusId {
        let bus = u32::try_from(self.buses.len()).expect("fewer than 2^32 buses");
        let mut drops: Vec<(BusDrop, NodeId, GatewayIndex)> = Vec::new();
        for (node, gateway) in members {
            let config = self.node(*node).gateway_config(*gateway).expect("the gateway exists");
            let GatewayKind::Bus { drop } = config.kind else { panic!("gateway {} is no bus gateway", gateway.get()) };
            assert!(drops.iter().all(|other| other.0 != BusDrop(drop)), "drop {drop} is there twice");
            drops.push((BusDrop(drop), *node, *gateway));
        }
        self.buses.push(Bus {
            latency: model.latency,
            members: drops.clone(),
            requests: BTreeSet::new(),
            speaker: None,
            faults: self.fault_layer(model.faults, BUS_STREAMS + u64::from(bus)),
            faults_at: TrueTime::MAX,
            leaving: None,
            air: VecDeque::new(),
            arrived: TrueTime::ZERO,
            stats: BusStats::default(),
            tap: None,
        });
        for (drop, node, gateway) in &drops {
            self.wire(*node, *gateway, Attachment::Bus { bus, drop: *drop });
        }
        for (_, node, gateway) in drops {
            self.set_open(node, gateway, true);
        }
        BusId(bus)
    }

    /// What a bus carried.
    #[must_use]
    pub fn bus_stats(&self, id: BusId) -> BusStats {
        self.buses[id.0 as usize].stats
    }

    /// What a bus's fault layer did.
    #[must_use]
    pub fn bus_faults(&self, id: BusId) -> Option<FaultCounts> {
        self.buses[id.0 as usize].faults.as_ref().map(FaultLayer::counts)
    }

    /// Lets `tap` see every packet of a bus from now on, before its faults; addresses are framing, and the packet's route has them.
    pub fn tap_bus(&mut self, id: BusId, tap: Tap) {
        self.buses[id.0 as usize].tap = Some(tap);
    }

    /// A member asks for the bus.
    pub(super) fn request(&mut self, bus: u32, drop: BusDrop) {
        self.buses[bus as usize].requests.insert(drop);
        self.grant(bus);
    }

    /// A node was reset: it asks for no bus any more. What it was sending goes on to its end, so that the bus stays in step.
    pub(super) fn withdraw(&mut self, bus: u32, drop: BusDrop) {
        self.buses[bus as usize].requests.remove(&drop);
    }

    /// Gives a free bus to the lowest drop that asks for it and has something to send.
    fn grant(&mut self, bus: u32) {
        while self.buses[bus as usize].speaker.is_none() {
            let it = &mut self.buses[bus as usize];
            let Some(drop) = it.requests.pop_first() else { return };
            let (_, node, gateway) = *it.members.iter().find(|member| member.0 == drop).expect("members ask");
            let gate = self.stations[node.at()].gate(gateway).expect("members are wired");
            let mut packet = std::mem::take(&mut self.packet);
            match self.take_output(node, gate, &mut packet) {
                Some(Outgoing { len, to, .. }) => {
                    self.speak(bus, drop, node, gate, to.unwrap_or(BusDrop::BROADCAST), &packet[..len]);
                }
                None => self.stations[node.at()].gates[gate].busy = false,
            }
            self.packet = packet;
        }
    }

    /// Puts a frame on a bus.
    fn speak(&mut self, bus: u32, from: BusDrop, node: NodeId, at: usize, to: BusDrop, packet: &[u8]) {
        let now = self.now;
        let mut frame = self.flights.buffer();
        let gate = &mut self.stations[node.at()].gates[at];
        encode_frame(&[&[to.0, from.0], packet], gate, &mut frame);
        let takes = gate.wire_time(frame.len());
        gate.token = gate.token.wrapping_add(1);
        gate.quiet = is_the_links_own(packet);
        let (gateway, token) = (gate.index, gate.token);
        self.count_frame(&frame);
        let it = &mut self.buses[bus as usize];
        if let Some(tap) = &mut it.tap {
            tap(&TapEvent { at: now, from: node, way: 0, packet });
        }
        it.stats.frames += 1;
        it.stats.bytes += frame.len() as u64;
        it.speaker = Some((node, gateway, token));
        if it.faults.is_some() {
            it.leaving = Some((from, frame));
        } else {
            self.spread(bus, from, now, takes, frame);
        }
        self.queue.plan(now + takes, What::BusFree { bus });
    }

    /// Lets a frame whose first byte leaves at `left` be heard.
    fn spread(&mut self, bus: u32, from: BusDrop, left: TrueTime, takes: Span, bytes: Vec<u8>) {
        let it = &mut self.buses[bus as usize];
        let began = (left + it.latency).max(it.arrived);
        it.arrived = began + takes;
        it.air.push_back(Airborne { from, began, bytes });
        self.queue.plan(began + takes, What::Hear { bus });
    }

    /// The last byte of a frame has reached all who listen: everybody but its speaker.
    pub(super) fn heard(&mut self, bus: u32) {
        let Airborne { from, began, bytes } = self.buses[bus as usize].air.pop_front().expect("one a plan");
        let mut all = Heard::default();
        let mut listeners = 0;
        for n in 0..self.buses[bus as usize].members.len() {
            let (drop, node, gateway) = self.buses[bus as usize].members[n];
            if drop == from {
                continue;
            }
            listeners += 1;
            let one = self.hear(node, gateway, drop, began, &bytes);
            all.taken += one.taken;
            all.overrun += one.overrun;
            all.passed_over += one.passed_over;
            all.damaged += one.damaged;
            all.missed += one.missed;
        }
        self.flights.recycle(bytes);
        // where nobody found anything yet, a delimiter was hit: the frame waits in their deframers and spoils the next
        let is_lost = all.taken + all.damaged == 0 && (all.passed_over > 0 || all.missed == listeners);
        let stats = &mut self.buses[bus as usize].stats;
        stats.arrived += 1;
        stats.taken += all.taken;
        stats.passed_over += all.passed_over;
        stats.damaged += all.damaged;
        stats.missed += all.missed;
        stats.lost += u64::from(is_lost);
        self.stats.frames_seen += all.taken + all.passed_over + all.damaged;
        self.stats.passed_over += all.passed_over;
        self.stats.frame_errors += all.damaged;
        self.stats.overruns += all.overrun;
        self.stats.lost += u64::from(is_lost);
    }

    /// The last byte has left. A fault layer with less bandwidth than the wire still holds the medium; then its speaker may ask again,
    /// and the next one speaks.
    pub(super) fn bus_free(&mut self, bus: u32) {
        if let Some(free_at) = self.enter_bus_faults(bus)
            && free_at > self.now
        {
            self.queue.plan(free_at, What::BusFree { bus });
            return;
        }
        if let Some((node, gateway, token)) = self.buses[bus as usize].speaker.take() {
            self.sent(node, gateway, token);
        }
        self.grant(bus);
    }

    /// Hands what has left to the bus's fault layer; tells when that takes the next frame.
    fn enter_bus_faults(&mut self, bus: u32) -> Option<TrueTime> {
        let now = LocalTicks::from_steps(self.now.steps());
        let it = &mut self.buses[bus as usize];
        let layer = it.faults.as_mut()?;
        let (from, frame) = it.leaving.take()?;
        // the speaker does not hear itself, and its address in the frame may come out changed
        layer.offer_tagged(now, u32::from(from.0), &frame);
        let free_at = TrueTime::from_steps(layer.free_at().steps());
        self.flights.recycle(frame);
        self.plan_bus_faults(bus);
        Some(free_at)
    }

    fn plan_bus_faults(&mut self, bus: u32) {
        let it = &mut self.buses[bus as usize];
        let next = it.faults.as_ref().and_then(FaultLayer::next_at);
        let next = next.map_or(TrueTime::MAX, |at| TrueTime::from_steps(at.steps())).max(self.now);
        if next < it.faults_at {
            it.faults_at = next;
            self.queue.plan(next, What::BusFaults { bus });
        }
    }

    /// The fault layer gives out what is due.
    pub(super) fn leave_bus_faults(&mut self, bus: u32) {
        let now = self.now;
        self.buses[bus as usize].faults_at = TrueTime::MAX;
        loop {
            let it = &mut self.buses[bus as usize];
            let due = it.faults.as_mut().and_then(|layer| layer.poll_tagged(LocalTicks::from_steps(now.steps())));
            let Some((tag, bytes)) = due else { break };
            let is_from = |member: &&(BusDrop, NodeId, GatewayIndex)| u32::from(member.0.0) == tag;
            let (from, node, gateway) = *it.members.iter().find(is_from).expect("members speak");
            let station = &self.stations[node.at()];
            let takes = station.gates[station.gate(gateway).expect("members are wired")].wire_time(bytes.len());
            self.spread(bus, from, now.before(takes), takes, bytes);
        }
        self.plan_bus_faults(bus);
    }
}

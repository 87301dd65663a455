//! From a gateway that is clear to send to a frame at its receiver: links and the world outside; buses are [`super::bus`]'s.
//!
//! - **Walk:** egress → real framing → wire time → (faults) → latency → arrival.
//! - **Invariants:** one frame at a time in each direction of a link; frames of a link arrive in the order in which they entered it,
//!   unless its fault layer reorders them.
//! - **Context:** the thread that steps the world. **Clauses:** `[FRM-01]`, `[LNK-01]`, `[LNK-07]`.

use super::flights::{Flight, Over};
use super::queue::What;
use super::station::{Attachment, Gate, Station};
use super::{FRAME_BYTES_MAX, NodeId, TapEvent, World, is_the_links_own};
use crate::faults::FaultLayer;
use crate::time::TrueTime;
use crate::walk::WalkStage;
use fixed_math::time::{LocalTicks, Span};
use osap_protocol::GatewayIndex;
use osap_protocol::discovery::GatewayKind;
use osap_protocol::framing::encode_parts;
use osap_protocol::ttl::wire_time;
use osap_runtime::Outgoing;
use rand::RngExt;

/// One direction of a link.
pub(super) struct Way {
    pub(super) to: (NodeId, GatewayIndex),
    pub(super) faults: Option<FaultLayer>,
    /// When the fault layer's next frame is planned.
    faults_at: TrueTime,
    /// What leaves and is not yet in the fault layer.
    leaving: Option<Vec<u8>>,
    /// When the last frame so far has arrived.
    arrived: TrueTime,
    pub(super) stats: WayStats,
}

impl Way {
    pub(super) fn new(to: (NodeId, GatewayIndex), faults: Option<FaultLayer>) -> Self {
        Self {
            to,
            faults,
            faults_at: TrueTime::MAX,
            leaving: None,
            arrived: TrueTime::ZERO,
            stats: WayStats::default(),
        }
    }
}

/// What one direction of a link carried.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WayStats {
    /// Frames that left the sender.
    pub frames: u64,
    /// Their bytes, stuffing, check and delimiter included.
    pub bytes: u64,
    /// Frames lost in a cut cable or a reset node; what a fault layer lost is in its own counts.
    pub lost: u64,
}

/// A point-to-point link.
pub(super) struct Link {
    /// From the first end, from the second.
    pub(super) latency: [Span; 2],
    pub(super) jitter: Span,
    /// Bytes get through.
    pub(super) whole: bool,
    /// Another number each time it is cut.
    pub(super) epoch: u32,
    pub(super) ways: [Way; 2],
    pub(super) tap: Option<super::Tap>,
}

/// What is wired to a gateway from outside the world.
#[derive(Debug)]
pub(super) struct Outside {
    pub(super) to: (NodeId, GatewayIndex),
    /// When the last packet from outside has arrived.
    arrived: TrueTime,
    leaving: Option<Vec<u8>>,
    pub(super) received: std::collections::VecDeque<Vec<u8>>,
}

impl Outside {
    pub(super) fn new(to: (NodeId, GatewayIndex)) -> Self {
        Self { to, arrived: TrueTime::ZERO, leaving: None, received: std::collections::VecDeque::new() }
    }
}

impl Gate {
    /// Time a frame of `len` bytes stands on this gate's wire.
    pub(super) fn wire_time(&self, len: usize) -> Span {
        wire_time(len, self.config.bits_a_byte, self.config.bit_rate)
    }
}

impl World {
    /// The processor has prepared a gate to send: a bus is asked for, any other wire is taken at once.
    pub(super) fn clear_to_send(&mut self, node: NodeId, gate: usize) {
        if let Attachment::Bus { bus, drop } = self.stations[node.at()].gates[gate].attachment {
            self.stations[node.at()].gates[gate].busy = true;
            self.request(bus, drop);
        } else {
            let mut packet = std::mem::take(&mut self.packet);
            if let Some(Outgoing { len, is_stamped, .. }) = self.take_output(node, gate, &mut packet) {
                let held_up = if is_stamped { self.stamp(node, gate, &mut packet[..len]) } else { Span::ZERO };
                self.send(node, gate, &packet[..len], held_up);
            }
            self.packet = packet;
        }
    }

    /// What the endpoint has for a gate now.
    pub(super) fn take_output(&mut self, node: NodeId, gate: usize, packet: &mut [u8]) -> Option<Outgoing> {
        let station = &mut self.stations[node.at()];
        let local = station.clock.local(self.now);
        let outgoing = station.endpoint.transmit(station.gates[gate].index, local, packet);
        self.gather_stages(node, false);
        outgoing
    }

    /// Writes the stamp of its departure into a packet that ends in a slot for it, `[TIM-03]`; tells by how much its first byte is later
    /// than now.
    fn stamp(&mut self, node: NodeId, gate: usize, packet: &mut [u8]) -> Span {
        let Station { clock, stamps, gates, .. } = &mut self.stations[node.at()];
        let takes = gates[gate].wire_time(packet.len());
        let (departed, held_up) = stamps.departure(clock, self.now, takes);
        osap_protocol::time::stamp(packet, departed);
        held_up
    }

    /// Frames a packet and puts its first byte, `held_up` from now, on a link, or hands it outside.
    fn send(&mut self, node: NodeId, at: usize, packet: &[u8], held_up: Span) {
        let left = self.now + held_up;
        let mut frame = self.flights.buffer();
        let gate = &mut self.stations[node.at()].gates[at];
        encode_frame(&[packet], gate, &mut frame);
        let takes = gate.wire_time(frame.len());
        gate.busy = true;
        gate.token = gate.token.wrapping_add(1);
        gate.quiet = is_the_links_own(packet);
        let (index, token, quiet) = (gate.index, gate.token, gate.quiet);
        let attachment = gate.attachment;
        self.count_frame(&frame);
        match attachment {
            Attachment::Link { link, way } => {
                self.tap(link, way, node, left, packet);
                let it = &mut self.links[link as usize];
                let stats = &mut it.ways[usize::from(way)].stats;
                stats.frames += 1;
                stats.bytes += frame.len() as u64;
                if !it.whole {
                    stats.lost += 1;
                    self.flights.recycle(frame);
                } else if it.ways[usize::from(way)].faults.is_some() {
                    it.ways[usize::from(way)].leaving = Some(frame);
                } else {
                    let flight = self.fly(link, way, left, takes, frame, quiet);
                    self.stations[node.at()].gates[at].leaving = Some(flight);
                }
            }
            Attachment::Outside { outside } => {
                self.outsides[outside as usize].leaving = Some(packet.to_vec());
                self.flights.recycle(frame);
            }
            Attachment::Bus { .. } => unreachable!("a bus is granted"),
        }
        self.queue.plan(left + takes, What::Sent { node, gateway: index, token });
    }

    /// Lets a frame whose first byte leaves at `left` arrive over a link.
    fn fly(&mut self, link: u32, way: u8, left: TrueTime, takes: Span, bytes: Vec<u8>, quiet: bool) -> u32 {
        let it = &mut self.links[link as usize];
        let jitter = if it.jitter == Span::ZERO {
            Span::ZERO
        } else {
            Span::from_steps(self.rng.random_range(0..=it.jitter.steps()))
        };
        let lane = &mut it.ways[usize::from(way)];
        let started = (left + it.latency[usize::from(way)] + jitter).max(lane.arrived);
        lane.arrived = started + takes;
        let (to, gateway) = lane.to;
        let over = Over::Link { link, way, epoch: it.epoch };
        let flight = self.flights.launch(Flight { to, gateway, over, started, cut: false, quiet, bytes });
        self.queue.plan(started + takes, What::Arrive { flight });
        flight
    }

    /// A frame's last byte has left its sender.
    pub(super) fn sent(&mut self, node: NodeId, gateway: GatewayIndex, token: u32) {
        let now = self.now;
        let station = &mut self.stations[node.at()];
        let Some(at) = station.gate(gateway).filter(|at| station.gates[*at].token == token) else { return };
        let gate = &mut station.gates[at];
        gate.leaving = None;
        let (attachment, quiet) = (gate.attachment, gate.quiet);
        match attachment {
            Attachment::Link { link, way } => {
                if let Some(free_at) = self.enter_faults(link, way)
                    && free_at > now
                {
                    // a fault layer with less bandwidth than the wire holds the sender back
                    self.queue.plan(free_at, What::Sent { node, gateway, token });
                    return;
                }
            }
            Attachment::Outside { outside } => {
                let outside = &mut self.outsides[outside as usize];
                outside.received.extend(outside.leaving.take());
            }
            Attachment::Bus { .. } => {}
        }
        self.note(node, WalkStage::Sent, gateway, quiet);
        self.stations[node.at()].gates[at].busy = false;
        self.attend(node);
    }

    /// Hands what has left to the link's fault layer; tells when that takes the next frame.
    fn enter_faults(&mut self, link: u32, way: u8) -> Option<TrueTime> {
        let now = LocalTicks::from_steps(self.now.steps());
        let lane = &mut self.links[link as usize].ways[usize::from(way)];
        let layer = lane.faults.as_mut()?;
        let frame = lane.leaving.take()?;
        layer.offer(now, &frame);
        let free_at = TrueTime::from_steps(layer.free_at().steps());
        self.flights.recycle(frame);
        self.plan_faults(link, way);
        Some(free_at)
    }

    fn plan_faults(&mut self, link: u32, way: u8) {
        let lane = &mut self.links[link as usize].ways[usize::from(way)];
        let next = lane.faults.as_ref().and_then(FaultLayer::next_at);
        let next = next.map_or(TrueTime::MAX, |at| TrueTime::from_steps(at.steps())).max(self.now);
        if next < lane.faults_at {
            lane.faults_at = next;
            self.queue.plan(next, What::Faults { link, way });
        }
    }

    /// A fault layer gives out what is due.
    pub(super) fn leave_faults(&mut self, link: u32, way: u8) {
        let now = self.now;
        self.links[link as usize].ways[usize::from(way)].faults_at = TrueTime::MAX;
        loop {
            let it = &mut self.links[link as usize];
            let lane = &mut it.ways[usize::from(way)];
            let due = lane.faults.as_mut().and_then(|layer| layer.poll(LocalTicks::from_steps(now.steps())));
            let Some(bytes) = due else { break };
            if !it.whole {
                lane.stats.lost += 1;
                continue;
            }
            let (node, gateway) = it.ways[usize::from(way)].to;
            let station = &self.stations[node.at()];
            let at = station.gate(gateway).expect("links end at wired gateways");
            let takes = station.gates[at].wire_time(bytes.len());
            let quiet = self.walk.is_some() && frame_is_the_links_own(&bytes, &station.gates[at]);
            self.fly(link, way, now.before(takes), takes, bytes, quiet);
        }
        self.plan_faults(link, way);
    }

    /// Puts a packet from outside on a gateway's wire, behind those that are on it; tells when it will have arrived.
    pub(super) fn enter_from_outside(&mut self, outside: u32, packet: &[u8]) -> TrueTime {
        let (to, gateway) = self.outsides[outside as usize].to;
        let mut bytes = self.flights.buffer();
        let station = &self.stations[to.at()];
        let gate = &station.gates[station.gate(gateway).expect("attached gateways are wired")];
        let from_us: &[&[u8]] = match gate.config.kind {
            GatewayKind::Link => &[packet],
            GatewayKind::Bus { drop } => &[&[drop, OUTSIDE_DROP], packet],
        };
        encode_frame(from_us, gate, &mut bytes);
        let takes = gate.wire_time(bytes.len());
        let it = &mut self.outsides[outside as usize];
        let started = it.arrived.max(self.now);
        it.arrived = started + takes;
        let quiet = is_the_links_own(packet);
        let flight = Flight { to, gateway, over: Over::Outside, started, cut: false, quiet, bytes };
        let flight = self.flights.launch(flight);
        self.queue.plan(started + takes, What::Arrive { flight });
        started + takes
    }

    /// Loses a frame for good, and counts it where it was.
    pub(super) fn lose(&mut self, id: u32) {
        self.stats.lost += 1;
        if let Over::Link { link, way, .. } = self.flights.get(id).over {
            self.links[link as usize].ways[usize::from(way)].stats.lost += 1;
        }
        self.release(id);
    }

    /// Forgets a frame that was counted.
    pub(super) fn release(&mut self, id: u32) {
        let flight = self.flights.land(id);
        self.flights.recycle(flight.bytes);
    }

    pub(super) fn count_frame(&mut self, frame: &[u8]) {
        self.stats.frames += 1;
        self.stats.bytes += frame.len() as u64;
        self.digest_bytes(frame);
    }

    fn tap(&mut self, link: u32, way: u8, from: NodeId, at: TrueTime, packet: &[u8]) {
        if let Some(tap) = &mut self.links[link as usize].tap {
            tap(&TapEvent { at, from, way: usize::from(way), packet });
        }
    }
}

/// The drop that packets from outside come from, where they come in over a bus.
const OUTSIDE_DROP: u8 = 254;

/// Whether a frame that came out of a fault layer still is the link's own.
fn frame_is_the_links_own(bytes: &[u8], gate: &Gate) -> bool {
    let mut packet = [0; FRAME_BYTES_MAX];
    osap_protocol::framing::decode(bytes, gate.config.check, &mut packet)
        .is_ok_and(|len| is_the_links_own(&packet[..len]))
}

/// Writes the real frame of a packet in `parts` into `frame`.
pub(super) fn encode_frame(parts: &[&[u8]], gate: &Gate, frame: &mut Vec<u8>) {
    frame.resize(FRAME_BYTES_MAX, 0);
    let len = encode_parts(parts, gate.config.check, frame).expect("a packet of at most PACKET_BYTES_MAX bytes");
    frame.truncate(len);
}

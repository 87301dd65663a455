//! A node's place in the world: its processor, its ring of captured frames, its gateways' wires.
//!
//! - **Walk:** captured → ring → job → the endpoint → its gateways. On a bus the interrupt unstuffs, checks and filters by address before
//!   the ring, so that what is for others takes neither room nor the processor.
//! - **Invariants:** one job at a time. What is ready to leave goes first (it frees memory); frames that came in and packets for ports
//!   take turns, so that neither starves the other.
//! - **Context:** the thread that steps the world. **Clauses:** `[NOD-06]`, `[NOD-08]`, `[FRM-07]`, `[FRM-08]`, `[FRM-10]`.

use super::bus::Heard;
use super::flights::{Flight, Over};
use super::queue::What;
use super::stamps::Stamps;
use super::{FRAME_BYTES_MAX, NodeId, World, is_the_links_own};
use crate::endpoint::Endpoint;
use crate::processor::{Processor, RING_FRAMES};
use crate::time::{Clock, TrueTime};
use crate::walk::WalkStage;
use fixed_math::time::{LocalTicks, Span};
use osap_protocol::discovery::{Event, GatewayKind, Verbosity};
use osap_protocol::framing::{Deframer, Frame, FrameError};
use osap_protocol::header::Arrival;
use osap_protocol::{BusDrop, DropCause, GatewayIndex};
use osap_runtime::GatewayConfig;
use std::collections::VecDeque;

/// What a device finds when it boots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Boot<'a> {
    /// Counts its boots, from the world's first epoch.
    pub epoch: u32,
    /// The name kept in its non-volatile memory, where it was ever renamed.
    pub name: Option<&'a str>,
}

/// Makes a device as it is after a boot.
pub type Factory = Box<dyn FnMut(Boot<'_>) -> Box<dyn Endpoint> + Send>;

/// What a gateway is wired to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Attachment {
    Link { link: u32, way: u8 },
    Bus { bus: u32, drop: BusDrop },
    Outside { outside: u32 },
}

/// A gateway's hardware.
pub(super) struct Gate {
    pub(super) index: GatewayIndex,
    pub(super) config: GatewayConfig,
    pub(super) attachment: Attachment,
    /// A frame is on its way out, or the bus was asked for.
    pub(super) busy: bool,
    /// Another number after each frame and each reset.
    pub(super) token: u32,
    /// The frame on its way out, while it can still be cut.
    pub(super) leaving: Option<u32>,
    /// What leaves is the link's own.
    pub(super) quiet: bool,
    ring_frames: usize,
    deframer: Box<Deframer<FRAME_BYTES_MAX>>,
}

impl Gate {
    pub(super) fn new(index: GatewayIndex, config: GatewayConfig, attachment: Attachment) -> Self {
        Self {
            index,
            config,
            attachment,
            busy: false,
            token: 0,
            leaving: None,
            quiet: false,
            ring_frames: 0,
            deframer: Box::new(Deframer::new(config.check)),
        }
    }

    /// As after a boot, or when a cable was pulled.
    pub(super) fn reset(&mut self) {
        self.busy = false;
        self.token = self.token.wrapping_add(1);
        self.leaving = None;
        self.deframer.reset();
    }
}

/// A job of the processor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Job {
    Receive { flight: u32 },
    Forward { gate: usize },
    Handle,
}

/// A node and what is around it.
pub(super) struct Station {
    pub(super) endpoint: Box<dyn Endpoint>,
    pub(super) processor: Processor,
    pub(super) clock: Clock,
    pub(super) stamps: Stamps,
    pub(super) factory: Option<Factory>,
    pub(super) epoch: u32,
    pub(super) name: Option<String>,
    pub(super) booted: TrueTime,
    pub(super) gates: Vec<Gate>,
    ring: VecDeque<u32>,
    job: Option<Job>,
    job_token: u32,
    /// When the wake that counts is planned.
    wake_at: TrueTime,
    /// When the endpoint last ran: what it left undone then, it cannot do at the same instant.
    ran_at: Option<TrueTime>,
    /// Which gate may send next: they take turns.
    turn: usize,
    /// The last job was for ports: a frame that came in is next.
    handled_last: bool,
    debug_cursor: u32,
}

impl Station {
    pub(super) fn new(
        endpoint: Box<dyn Endpoint>,
        processor: Processor,
        clock: Clock,
        stamps: Stamps,
        booted: TrueTime,
    ) -> Self {
        Self {
            endpoint,
            processor,
            clock,
            stamps,
            factory: None,
            epoch: 1,
            name: None,
            booted,
            gates: Vec::new(),
            ring: VecDeque::new(),
            job: None,
            job_token: 0,
            wake_at: TrueTime::MAX,
            ran_at: None,
            turn: 0,
            handled_last: false,
            debug_cursor: 0,
        }
    }

    pub(super) fn gate(&self, gateway: GatewayIndex) -> Option<usize> {
        self.gates.iter().position(|gate| gate.index == gateway)
    }

    /// The next gate that is clear to send and has something, in turn.
    fn next_output(&self, local: LocalTicks) -> Option<usize> {
        let count = self.gates.len();
        (0..count).map(|n| (self.turn + n) % count).find(|at| {
            let gate = &self.gates[*at];
            !gate.busy && self.endpoint.has_output(gate.index, local)
        })
    }

    /// What the processor does next, and how long that takes.
    fn next_job(&mut self, now: TrueTime, local: LocalTicks) -> Option<(Job, Span)> {
        if let Some(gate) = self.next_output(local) {
            return Some((Job::Forward { gate }, self.processor.forward));
        }
        let waiting = self.endpoint.waiting(local);
        let takes_turn = waiting > 0 && !self.handled_last;
        if !takes_turn && let Some(flight) = self.ring.pop_front() {
            return Some((Job::Receive { flight }, self.processor.receive));
        }
        let due = waiting > 0 || self.endpoint.next_wake().is_some_and(|wake| wake <= local);
        (due && self.ran_at != Some(now)).then(|| {
            let takes = self.processor.handle.saturating_mul(waiting as u64);
            (Job::Handle, takes)
        })
    }

    /// Forgets everything that a reset interrupts; gives the frames that were waiting.
    pub(super) fn interrupt(&mut self) -> VecDeque<u32> {
        self.job = None;
        self.job_token = self.job_token.wrapping_add(1);
        self.wake_at = TrueTime::MAX;
        self.ran_at = None;
        self.debug_cursor = 0;
        for gate in &mut self.gates {
            gate.reset();
            gate.ring_frames = 0;
        }
        std::mem::take(&mut self.ring)
    }

    /// The caller has changed the endpoint: what it could not do at this instant it may be able to do now.
    pub(super) const fn forget_run(&mut self) {
        self.ran_at = None;
    }

    /// The frame in work, if it is one.
    pub(super) fn frame_in_work(&self) -> Option<u32> {
        match self.job {
            Some(Job::Receive { flight }) => Some(flight),
            _ => None,
        }
    }
}

impl World {
    /// Gives a node's processor something to do, if it is free and there is something.
    pub(super) fn attend(&mut self, node: NodeId) {
        loop {
            let now = self.now;
            let station = &mut self.stations[node.at()];
            if station.job.is_some() {
                return;
            }
            if now < station.booted {
                let booted = station.booted;
                self.wake_at(node, booted);
                return;
            }
            let local = station.clock.local(now);
            let Some((job, takes)) = station.next_job(now, local) else {
                self.plan_wake(node, local);
                return;
            };
            station.handled_last = job == Job::Handle;
            station.job = Some(job);
            if let Job::Receive { flight } = job {
                let Flight { gateway, quiet, .. } = *self.flights.get(flight);
                self.note(node, WalkStage::HandedOver, gateway, quiet);
            }
            let takes = takes + self.stations[node.at()].stamps.job();
            if takes > Span::ZERO {
                let token = self.stations[node.at()].job_token;
                self.queue.plan(now + takes, What::Job { node, token });
                return;
            }
            self.finish(node);
        }
    }

    /// The processor's time for a job is over.
    pub(super) fn job_done(&mut self, node: NodeId, token: u32) {
        if self.stations[node.at()].job_token == token {
            self.finish(node);
            self.attend(node);
        }
    }

    /// A node's own time has come, unless another wake was planned since.
    pub(super) fn wake(&mut self, node: NodeId) {
        let station = &mut self.stations[node.at()];
        if station.wake_at == self.now {
            station.wake_at = TrueTime::MAX;
            self.attend(node);
        }
    }

    /// A frame's last byte has reached its receiver: an interrupt keeps it for the processor.
    pub(super) fn arrive(&mut self, id: u32) {
        let Flight { to, gateway, over, started, cut, quiet, .. } = *self.flights.get(id);
        let broken = match over {
            Over::Link { link, epoch, .. } => self.links[link as usize].epoch != epoch,
            Over::Bus { .. } | Over::Outside => false,
        };
        if broken || cut || started < self.stations[to.at()].booted {
            self.lose(id);
            return;
        }
        self.note(to, WalkStage::Captured, gateway, quiet);
        let station = &mut self.stations[to.at()];
        let at = station.gate(gateway).expect("frames fly only to wired gateways");
        let gate = &mut station.gates[at];
        if gate.ring_frames == RING_FRAMES {
            let local = station.clock.local(self.now);
            station.endpoint.count(DropCause::RxOverrun, Some(gateway), local);
            self.stats.overruns += 1;
            self.release(id);
            return;
        }
        gate.ring_frames += 1;
        station.ring.push_back(id);
        self.attend(to);
    }

    /// The bytes of a frame on a bus have reached one of those who listen: its interrupt unstuffs and checks them, and keeps what is for
    /// `own` or for all, `[FRM-10]`.
    pub(super) fn hear(
        &mut self,
        node: NodeId,
        gateway: GatewayIndex,
        own: BusDrop,
        began: TrueTime,
        bytes: &[u8],
    ) -> Heard {
        let mut heard = Heard::default();
        let Station { endpoint, clock, stamps, gates, ring, booted, .. } = &mut self.stations[node.at()];
        if began < *booted {
            heard.missed = 1;
            return heard;
        }
        let gate = gates.iter_mut().find(|gate| gate.index == gateway).expect("members are wired");
        let takes = gate.wire_time(bytes.len());
        let (local, first_new) = (clock.local(self.now), ring.len());
        let (flights, ring_frames) = (&mut self.flights, &mut gate.ring_frames);
        unstuff(&mut gate.deframer, bytes, stamps.arrival(clock, began, self.now), takes, |result| {
            match addressed(result) {
                Ok((to, from, packet, stamp)) if to == own || to == BusDrop::BROADCAST => {
                    heard.taken += 1;
                    if *ring_frames == RING_FRAMES {
                        heard.overrun += 1;
                        endpoint.count(DropCause::RxOverrun, Some(gateway), local);
                        return;
                    }
                    *ring_frames += 1;
                    let mut bytes = flights.buffer();
                    bytes.extend_from_slice(packet);
                    let (over, quiet) = (Over::Bus { from, stamp }, is_the_links_own(packet));
                    let flight = Flight { to: node, gateway, over, started: began, cut: false, quiet, bytes };
                    ring.push_back(flights.launch(flight));
                }
                Ok(_) => heard.passed_over += 1,
                Err(cause) => {
                    heard.damaged += 1;
                    endpoint.count(cause, Some(gateway), local);
                }
            }
        });
        for at in first_new..self.stations[node.at()].ring.len() {
            let quiet = self.flights.get(self.stations[node.at()].ring[at]).quiet;
            self.note(node, WalkStage::Captured, gateway, quiet);
        }
        if heard.taken + heard.damaged > 0 {
            self.attend(node);
        }
        heard
    }

    fn finish(&mut self, node: NodeId) {
        let Some(job) = self.stations[node.at()].job.take() else { return };
        match job {
            Job::Receive { flight } => self.deframe(node, flight),
            Job::Forward { gate } => {
                self.stations[node.at()].turn = gate + 1;
                self.clear_to_send(node, gate);
            }
            Job::Handle => {
                let station = &mut self.stations[node.at()];
                station.ran_at = Some(self.now);
                let local = station.clock.local(self.now);
                station.endpoint.run(local);
                if let Some(name) = station.endpoint.take_new_name() {
                    station.name = Some(name.to_owned());
                }
                self.gather_stages(node, false);
            }
        }
    }

    /// Hands a captured frame to the real deframer, and what it finds to the node.
    fn deframe(&mut self, node: NodeId, id: u32) {
        let mut flight = self.flights.land(id);
        let now = self.now;
        let Station { endpoint, clock, stamps, gates, .. } = &mut self.stations[node.at()];
        let at = gates.iter().position(|gate| gate.index == flight.gateway).expect("captured by this gate");
        let gate = &mut gates[at];
        gate.ring_frames -= 1;
        let local = clock.local(now);
        let len = flight.bytes.len();
        let takes = gate.wire_time(len);
        let mut whole = 0u16;
        if let Over::Bus { from, stamp } = flight.over {
            whole += 1;
            endpoint.receive(Arrival::Bus { gateway: flight.gateway, from }, &mut flight.bytes, stamp, local);
        } else {
            let started = stamps.arrival(clock, flight.started, now);
            unstuff(&mut gate.deframer, &flight.bytes, started, takes, |result| {
                self.stats.frames_seen += 1;
                match opened(result, gate.index, gate.config.kind) {
                    Ok((arrival, packet, started)) => {
                        whole += 1;
                        endpoint.receive(arrival, packet, started, local);
                    }
                    Err(cause) => {
                        self.stats.frame_errors += 1;
                        endpoint.count(cause, Some(gate.index), local);
                    }
                }
            });
        }
        self.stats.packets += u64::from(whole);
        if whole > 0 {
            self.note(node, WalkStage::Deframed, flight.gateway, flight.quiet);
        }
        self.gather_stages(node, flight.quiet);
        self.flights.recycle(std::mem::take(&mut flight.bytes));
    }

    /// Plans the wake of a node that has nothing to do now. One that left packets undone is asked again a step later.
    fn plan_wake(&mut self, node: NodeId, local: LocalTicks) {
        let station = &self.stations[node.at()];
        if station.endpoint.waiting(local) > 0 {
            self.wake_at(node, self.now + Span::from_steps(1));
        } else if let Some(wake) = station.endpoint.next_wake()
            && wake > local
        {
            // what was due and is not done waits for a gateway; the gateway will ask
            self.wake_at(node, station.clock.truth(wake));
        }
    }

    /// Plans a wake, unless an earlier one is planned: that will find nothing, and plan this one.
    fn wake_at(&mut self, node: NodeId, at: TrueTime) {
        let station = &mut self.stations[node.at()];
        if at < station.wake_at {
            station.wake_at = at;
            self.queue.plan(at, What::Wake { node });
        }
    }

    /// Lets a node look after itself at this instant, but not within this call.
    pub(super) fn wake_now(&mut self, node: NodeId) {
        self.stations[node.at()].ran_at = None;
        self.wake_at(node, self.now);
    }

    /// Writes a stage down, where a walk is recorded and it is a packet's.
    pub(super) fn note(&mut self, node: NodeId, stage: WalkStage, gateway: GatewayIndex, quiet: bool) {
        if !quiet {
            self.record(node, stage, u16::from(gateway.get()));
        }
    }

    /// Takes the stages that the node wrote into its debug ring since the last call.
    pub(super) fn gather_stages(&mut self, node: NodeId, quiet: bool) {
        if self.walk.is_none() {
            return;
        }
        loop {
            let station = &mut self.stations[node.at()];
            let page = station.endpoint.debug().page(station.debug_cursor, None);
            station.debug_cursor = page.next;
            if page.events.is_empty() {
                return;
            }
            for event in &page.events {
                if let (Event::Stage { stage, index }, false) = (&event.event, quiet) {
                    self.record(node, WalkStage::Node(*stage), *index);
                }
            }
        }
    }

    /// Makes a node write its stages down, and passes over those it wrote before.
    pub(super) fn listen_to_stages(&mut self, node: NodeId) {
        let station = &mut self.stations[node.at()];
        station.endpoint.debug_mut().set_verbosity(Verbosity::Packets);
        station.debug_cursor = station.endpoint.debug().end();
    }
}

/// Feeds bytes, of which the first came at `started` and which took `takes` in all, to a deframer, and `each` with what it finds.
fn unstuff(
    deframer: &mut Deframer<FRAME_BYTES_MAX>,
    bytes: &[u8],
    started: LocalTicks,
    takes: Span,
    mut each: impl FnMut(Result<Frame<'_>, FrameError>),
) {
    let byte_steps = takes.steps() / (bytes.len() as u64).max(1);
    for (n, byte) in (0u64..).zip(bytes) {
        // the first byte's stamp is exact; a later one matters only where a flipped bit began another frame with it
        if let Some(result) = deframer.push(*byte, started + Span::from_steps(n * byte_steps)) {
            each(result);
        }
    }
}

/// A deframed packet with the addresses that stood before it on a bus, `[FRM-10]`: for whom, from whom.
fn addressed(result: Result<Frame<'_>, FrameError>) -> Result<(BusDrop, BusDrop, &mut [u8], LocalTicks), DropCause> {
    let Frame { packet, started } = result?;
    match packet {
        [to, from, packet @ ..] => Ok((BusDrop(*to), BusDrop(*from), packet, started)),
        _ => Err(DropCause::FrameTooShort),
    }
}

/// A deframed packet with how it arrived; on a bus the addresses before it are taken off, `[FRM-10]`.
fn opened(
    result: Result<Frame<'_>, FrameError>,
    gateway: GatewayIndex,
    kind: GatewayKind,
) -> Result<(Arrival, &mut [u8], LocalTicks), DropCause> {
    match kind {
        GatewayKind::Link => {
            let Frame { packet, started } = result?;
            Ok((Arrival::Link(gateway), packet, started))
        }
        GatewayKind::Bus { .. } => {
            let (_to, from, packet, started) = addressed(result)?;
            Ok((Arrival::Bus { gateway, from }, packet, started))
        }
    }
}

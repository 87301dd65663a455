//! The world: nodes, wires and true time.
//!
//! - **Walk:** one packet, whole: endpoint → wire → ring → processor → endpoint.
//! - **Invariants:** the same seed and the same calls give the same events, byte for byte ([`World::digest`]); no wall clock; every
//!   frame arrives, is counted by its receiver, or is counted as lost.
//! - **Context:** one thread; [`World::step`] carries out one event.
//! - **Clauses:** `[NOD-12]`, `[LNK-01]`, `[LNK-02]`, `[LNK-07]`.
//!
//! ```
//! use fixed_math::time::Span;
//! use firmware_app::kind;
//! use osap_protocol::discovery::UniqueId;
//! use osap_protocol::GatewayIndex;
//! use osap_sim::device::{SimDevice, sim_device};
//! use osap_sim::machines::UART;
//! use osap_sim::processor::Processor;
//! use osap_sim::time::ClockModel;
//! use osap_sim::world::{LinkModel, World};
//!
//! let mut world = World::new(1);
//! let motor = sim_device(&kind::MOTOR, UniqueId([1; 12]), 1, "a", &[UART]);
//! let heater = sim_device(&kind::HEATER, UniqueId([2; 12]), 1, "b", &[UART]);
//! let a = world.add_node(motor, Processor::INSTANT, ClockModel::PERFECT);
//! let b = world.add_node(heater, Processor::INSTANT, ClockModel { offset_us: 5, ..ClockModel::off_by(20.0) });
//! let first = GatewayIndex::new(0).unwrap();
//! world.connect((a, first), (b, first), LinkModel::WIRE);
//! world.run_for(Span::from_us(1_000));
//! let neighbour = world.endpoint::<SimDevice>(a).unwrap().node().gateway(first).unwrap().neighbour();
//! assert_eq!(neighbour.unwrap().unique_id, UniqueId([2; 12]));
//! ```

mod bus;
mod digest;
mod flights;
mod measure;
mod queue;
mod stamps;
mod station;
mod wire;

pub use bus::{BusModel, BusStats};
pub use stamps::{Departure, StampModel};
pub use station::{Boot, Factory};
pub use wire::WayStats;

use crate::endpoint::Endpoint;
use crate::faults::{FaultConfig, FaultCounts, FaultLayer};
use crate::processor::Processor;
use crate::time::{Clock, ClockModel, TrueTime};
use crate::walk::{WalkEvent, WalkStage};
use bus::Bus;
use fixed_math::time::Span;
use flights::Flights;
use osap_protocol::discovery::GatewayKind;
use osap_protocol::{GatewayIndex, Packet};
use queue::{Queue, What};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use stamps::Stamps;
use station::{Attachment, Gate, Station};
use std::any::Any;
use wire::{Link, Outside, Way};

/// Longest frame between its delimiters, unstuffed, check included: what a gateway's deframer holds.
pub const FRAME_BYTES_MAX: usize = 2048;
/// Longest packet that fits such a frame on a bus with the longest check.
pub const PACKET_BYTES_MAX: usize = FRAME_BYTES_MAX - 32;

/// Names a node of one world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeId(u32);

impl NodeId {
    /// Its place in the order in which nodes were added.
    #[must_use]
    pub const fn at(self) -> usize {
        self.0 as usize
    }
}

/// Names a link of one world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LinkId(u32);

/// Names a bus of one world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BusId(u32);

/// Names a gateway whose other end is outside the world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ExternalId(u32);

/// What a link adds to its gateways' wire time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinkModel {
    /// From a byte's leaving to its arrival.
    pub latency: Span,
    /// What comes on top of it from the link's first end to its second, and back.
    pub extra: [Span; 2],
    /// Most that is added to the latency of a frame; uniform.
    pub jitter: Span,
    /// Faults of both directions, drawn apart.
    pub faults: Option<FaultConfig>,
}

impl LinkModel {
    /// A cable.
    pub const WIRE: Self = Self { latency: Span::ZERO, extra: [Span::ZERO; 2], jitter: Span::ZERO, faults: None };
}

/// What happened so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stats {
    /// Events carried out.
    pub events: u64,
    /// Frames that left a sender.
    pub frames: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Delimited runs of bytes that receivers' deframers saw: packets or errors.
    pub frames_seen: u64,
    /// Packets handed to nodes.
    pub packets: u64,
    /// Frames on buses that were for another drop.
    pub passed_over: u64,
    /// Frames that gave no packet.
    pub frame_errors: u64,
    /// Frames that found their receiver's ring full.
    pub overruns: u64,
    /// Frames lost in cut cables, in resets and to absent drops.
    pub lost: u64,
}

/// A packet that begins to leave on a tapped link or bus.
#[derive(Clone, Copy, Debug)]
pub struct TapEvent<'a> {
    /// When its first byte leaves.
    pub at: TrueTime,
    /// Its sender.
    pub from: NodeId,
    /// 0 from the link's first end, 1 from its second; 0 on a bus.
    pub way: usize,
    /// The packet, without framing.
    pub packet: &'a [u8],
}

/// Sees every packet of a link or bus.
pub type Tap = Box<dyn FnMut(&TapEvent<'_>) + Send>;

/// Real nodes in virtual time.
pub struct World {
    now: TrueTime,
    queue: Queue,
    stations: Vec<Station>,
    links: Vec<Link>,
    buses: Vec<Bus>,
    outsides: Vec<Outside>,
    flights: Flights,
    rng: Pcg64,
    seed: u64,
    ambient_faults: Option<FaultConfig>,
    first_epoch: u32,
    stats: Stats,
    digest: u64,
    walk: Option<Vec<WalkEvent>>,
    /// Room for the packet that is leaving.
    packet: Box<[u8]>,
}

impl World {
    /// An empty world at time zero.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self {
            now: TrueTime::ZERO,
            queue: Queue::default(),
            stations: Vec::new(),
            links: Vec::new(),
            buses: Vec::new(),
            outsides: Vec::new(),
            flights: Flights::default(),
            rng: Pcg64::seed_from_u64(seed),
            seed,
            ambient_faults: None,
            first_epoch: 1,
            stats: Stats::default(),
            digest: seed,
            walk: None,
            packet: vec![0; PACKET_BYTES_MAX].into_boxed_slice(),
        }
    }

    /// Faults of every link and bus made from now on that brings none of its own: a whole machine on bad cables.
    pub const fn set_ambient_faults(&mut self, faults: Option<FaultConfig>) {
        self.ambient_faults = faults;
    }

    /// The boot epoch of the first boot of all devices added or swapped in from now on; 1 where nobody says. A world that stands for
    /// a machine that ran before says another one, or nobody could see that it was off in between.
    pub const fn set_first_epoch(&mut self, epoch: u32) {
        self.first_epoch = epoch;
    }

    /// Adds a node that cannot be reset.
    ///
    /// # Panics
    /// Beyond 2^32 nodes.
    pub fn add_node(&mut self, endpoint: Box<dyn Endpoint>, processor: Processor, clock: ClockModel) -> NodeId {
        self.add_node_at(self.now, endpoint, processor, clock)
    }

    fn add_node_at(
        &mut self,
        boots: TrueTime,
        endpoint: Box<dyn Endpoint>,
        processor: Processor,
        clock: ClockModel,
    ) -> NodeId {
        let number = u32::try_from(self.stations.len()).expect("fewer than 2^32 nodes");
        let stamps = Stamps::new(StampModel::EXACT, self.seed, number);
        self.stations.push(Station::new(endpoint, processor, Clock::new(clock, boots), stamps, boots));
        let node = NodeId(number);
        if self.walk.is_some() {
            self.listen_to_stages(node);
        }
        node
    }

    /// Adds a device and boots it for the first time; [`World::reset`] boots it again.
    pub fn add_device(&mut self, factory: Factory, processor: Processor, clock: ClockModel) -> NodeId {
        self.add_device_at(self.now, factory, processor, clock)
    }

    /// As [`World::add_device`], but it boots at `boots` or now, whichever is later: until then it does nothing, and what comes to it is
    /// lost.
    pub fn add_device_at(
        &mut self,
        boots: TrueTime,
        mut factory: Factory,
        processor: Processor,
        clock: ClockModel,
    ) -> NodeId {
        let epoch = self.first_epoch;
        let endpoint = factory(Boot { epoch, name: None });
        let node = self.add_node_at(boots.max(self.now), endpoint, processor, clock);
        let station = &mut self.stations[node.at()];
        (station.factory, station.epoch) = (Some(factory), epoch);
        node
    }

    /// A rate within ±`limit_ppm`, drawn from the world's seed, for a clock that reads zero now.
    pub fn draw_clock(&mut self, limit_ppm: f64) -> ClockModel {
        ClockModel::off_by(self.rng.random_range(-limit_ppm..=limit_ppm))
    }

    /// A span up to `limit`, drawn from the world's seed.
    pub(crate) fn draw_span(&mut self, limit: Span) -> Span {
        Span::from_steps(self.rng.random_range(0..=limit.steps()))
    }

    /// A number below `limit`, drawn from the world's seed.
    pub(crate) fn draw_below(&mut self, limit: usize) -> usize {
        self.rng.random_range(0..limit)
    }

    /// Says how well a node stamps from now on; exactly where nobody says.
    pub fn set_stamps(&mut self, node: NodeId, model: StampModel) {
        let it = &mut self.stations[node.at()].stamps;
        let job_spread = it.job_spread;
        *it = Stamps::new(model, self.seed, node.0);
        it.job_spread = job_spread;
    }

    /// Says how much longer than its processor's times a job of a node takes from now on: up to so much, uniform. Without it all that a
    /// node does follows its timer's ticks at a fixed distance, and so do the remainders that are lost where its stamps are cut to ticks.
    pub fn set_job_spread(&mut self, node: NodeId, spread: Span) {
        self.stations[node.at()].stamps.job_spread = spread;
    }

    /// Wires two gateways together and opens them.
    ///
    /// # Panics
    /// Where a gateway does not exist, is wired already, or is one for a bus: faults of the machine's builder.
    pub fn connect(&mut self, a: (NodeId, GatewayIndex), b: (NodeId, GatewayIndex), model: LinkModel) -> LinkId {
        let link = u32::try_from(self.links.len()).expect("fewer than 2^32 links");
        let stream = u64::from(link) * 2;
        let faults = |way: u64| self.fault_layer(model.faults, stream + way);
        let ways = [Way::new(b, faults(0)), Way::new(a, faults(1))];
        let LinkModel { latency, extra, jitter, .. } = model;
        let latency = extra.map(|extra| latency + extra);
        self.links.push(Link { latency, jitter, whole: true, epoch: 0, ways, tap: None });
        for (way, (node, gateway)) in [(0, a), (1, b)] {
            self.wire(node, gateway, Attachment::Link { link, way });
            self.set_open(node, gateway, true);
        }
        LinkId(link)
    }

    /// Makes a gateway's other end one outside the world, for a caller with a socket; closed until [`World::external_open`].
    ///
    /// # Panics
    /// As [`World::connect`].
    pub fn attach_external(&mut self, node: NodeId, gateway: GatewayIndex) -> ExternalId {
        let outside = u32::try_from(self.outsides.len()).expect("fewer than 2^32 gateways to the outside");
        self.outsides.push(Outside::new((node, gateway)));
        self.wire(node, gateway, Attachment::Outside { outside });
        ExternalId(outside)
    }

    /// Says whether somebody is at the other end outside.
    pub fn external_open(&mut self, id: ExternalId, open: bool) {
        let outside = &mut self.outsides[id.0 as usize];
        outside.received.clear();
        let (node, gateway) = outside.to;
        self.set_open(node, gateway, open);
    }

    /// Brings a packet in from outside: its first byte comes now, or behind the packets that are coming in. Tells when its last byte
    /// will be in.
    pub fn external_send(&mut self, id: ExternalId, packet: &[u8]) -> TrueTime {
        self.enter_from_outside(id.0, packet)
    }

    /// The next packet that has left to the outside.
    pub fn external_receive(&mut self, id: ExternalId) -> Option<Vec<u8>> {
        self.outsides[id.0 as usize].received.pop_front()
    }

    /// Pulls a cable that both ends notice: the gateways close, what is under way is lost.
    pub fn unplug(&mut self, id: LinkId) {
        self.cut(id);
        for (node, gateway) in self.ends(id) {
            self.set_open(node, gateway, false);
        }
    }

    /// Cuts a cable without either end noticing, as on a UART: bytes leave and get nowhere.
    pub fn cut(&mut self, id: LinkId) {
        let link = &mut self.links[id.0 as usize];
        link.whole = false;
        link.epoch = link.epoch.wrapping_add(1);
    }

    /// Makes a link whole again and opens both its gateways.
    pub fn replug(&mut self, id: LinkId) {
        self.links[id.0 as usize].whole = true;
        for (node, gateway) in self.ends(id) {
            self.set_open(node, gateway, true);
        }
    }

    /// Reboots a device: its memory is gone, its counter begins at zero, its boot epoch is the next; its name is kept. Says whether
    /// the node can be rebooted.
    pub fn reset(&mut self, node: NodeId) -> bool {
        let station = &mut self.stations[node.at()];
        let Some(mut factory) = station.factory.take() else { return false };
        station.epoch = station.epoch.wrapping_add(1);
        let endpoint = factory(Boot { epoch: station.epoch, name: station.name.as_deref() });
        station.factory = Some(factory);
        self.replace(node, endpoint);
        true
    }

    /// Puts another device in a node's place, on the same wires.
    ///
    /// # Panics
    /// Where the new device lacks a gateway that is wired.
    pub fn swap(&mut self, node: NodeId, mut factory: Factory) {
        let epoch = self.first_epoch;
        let endpoint = factory(Boot { epoch, name: None });
        let station = &mut self.stations[node.at()];
        station.epoch = epoch;
        station.name = None;
        station.factory = Some(factory);
        self.replace(node, endpoint);
    }

    /// Carries out the next event; `false` where there is none.
    pub fn step(&mut self) -> bool {
        let Some((at, what)) = self.queue.pop() else { return false };
        self.now = at;
        self.stats.events += 1;
        self.digest_event(at, what);
        match what {
            What::Arrive { flight } => self.arrive(flight),
            What::Sent { node, gateway, token } => self.sent(node, gateway, token),
            What::Job { node, token } => self.job_done(node, token),
            What::Wake { node } => self.wake(node),
            What::Faults { link, way } => self.leave_faults(link, way),
            What::BusFree { bus } => self.bus_free(bus),
            What::BusFaults { bus } => self.leave_bus_faults(bus),
            What::Hear { bus } => self.heard(bus),
        }
        true
    }

    /// Carries out all events up to and at `at`, and lets it be `at`.
    pub fn run_until(&mut self, at: TrueTime) {
        while self.queue.next_at().is_some_and(|next| next <= at) {
            self.step();
        }
        self.now = self.now.max(at);
    }

    /// As [`World::run_until`], `span` from now.
    pub fn run_for(&mut self, span: Span) {
        self.run_until(self.now + span);
    }

    /// True time now.
    #[must_use]
    pub const fn now(&self) -> TrueTime {
        self.now
    }

    /// When the next event is.
    #[must_use]
    pub fn next_event_at(&self) -> Option<TrueTime> {
        self.queue.next_at()
    }

    /// A node's endpoint, as the type it was made as.
    #[must_use]
    pub fn endpoint<T: Endpoint>(&self, node: NodeId) -> Option<&T> {
        let any: &dyn Any = &*self.stations[node.at()].endpoint;
        any.downcast_ref()
    }

    /// As [`World::endpoint`], to change it; [`World::poke`] it afterwards.
    pub fn endpoint_mut<T: Endpoint>(&mut self, node: NodeId) -> Option<&mut T> {
        let any: &mut dyn Any = &mut *self.stations[node.at()].endpoint;
        any.downcast_mut()
    }

    /// A node's endpoint, whatever it is.
    #[must_use]
    pub fn node(&self, node: NodeId) -> &dyn Endpoint {
        &*self.stations[node.at()].endpoint
    }

    /// All nodes.
    pub fn nodes(&self) -> impl Iterator<Item = NodeId> + use<> {
        (0..u32::try_from(self.stations.len()).unwrap_or(u32::MAX)).map(NodeId)
    }

    /// Looks after a node whose endpoint the caller has changed.
    pub fn poke(&mut self, node: NodeId) {
        self.stations[node.at()].forget_run();
        self.gather_stages(node, false);
        self.attend(node);
    }

    /// What happened so far.
    #[must_use]
    pub const fn stats(&self) -> Stats {
        self.stats
    }

    /// What a link carried: from its first end, from its second.
    #[must_use]
    pub fn link_stats(&self, id: LinkId) -> [WayStats; 2] {
        self.links[id.0 as usize].ways.each_ref().map(|way| way.stats)
    }

    /// What a link's fault layers did: from its first end, from its second.
    #[must_use]
    pub fn link_faults(&self, id: LinkId) -> [Option<FaultCounts>; 2] {
        self.links[id.0 as usize].ways.each_ref().map(|way| way.faults.as_ref().map(FaultLayer::counts))
    }

    /// A link's ends: first, second.
    #[must_use]
    pub fn ends(&self, id: LinkId) -> [(NodeId, GatewayIndex); 2] {
        let [to_second, to_first] = &self.links[id.0 as usize].ways;
        [to_first.to, to_second.to]
    }

    /// Lets `tap` see every packet of a link from now on.
    pub fn tap_link(&mut self, id: LinkId, tap: Tap) {
        self.links[id.0 as usize].tap = Some(tap);
    }

    /// Begins to record the stages that packets pass, or ends it. Nodes write their stages down while it is recorded.
    pub fn record_walk(&mut self, on: bool) {
        self.walk = on.then(Vec::new);
        if on {
            for node in self.nodes() {
                self.listen_to_stages(node);
            }
        }
    }

    /// The stages recorded, in order.
    #[must_use]
    pub fn walk(&self) -> &[WalkEvent] {
        self.walk.as_deref().unwrap_or_default()
    }

    fn record(&mut self, node: NodeId, stage: WalkStage, index: u16) {
        if let Some(walk) = &mut self.walk {
            walk.push(WalkEvent { at: self.now, node, stage, index });
        }
    }

    /// A fault layer that draws from the world's seed, the configuration's and the number of the wire, `[LNK-07]`.
    fn fault_layer(&self, config: Option<FaultConfig>, stream: u64) -> Option<FaultLayer> {
        let config = config.or(self.ambient_faults)?.for_stream(stream);
        Some(FaultLayer::new(FaultConfig { seed: config.seed ^ self.seed.rotate_left(32), ..config }))
    }

    fn wire(&mut self, node: NodeId, gateway: GatewayIndex, attachment: Attachment) {
        let station = &mut self.stations[node.at()];
        assert!(station.gate(gateway).is_none(), "gateway {} is wired already", gateway.get());
        let config = station.endpoint.gateway_config(gateway).expect("the gateway exists");
        let on_bus = matches!(config.kind, GatewayKind::Bus { .. });
        let wanted = matches!(attachment, Attachment::Bus { .. });
        assert!(
            on_bus == wanted || matches!(attachment, Attachment::Outside { .. }),
            "a link gateway goes to a link, a bus gateway to a bus"
        );
        assert!(usize::from(config.mtu_bytes) <= PACKET_BYTES_MAX, "an MTU of at most {PACKET_BYTES_MAX} bytes");
        station.gates.push(Gate::new(gateway, config, attachment));
    }

    fn set_open(&mut self, node: NodeId, gateway: GatewayIndex, open: bool) {
        let station = &mut self.stations[node.at()];
        if !open && let Some(at) = station.gate(gateway) {
            station.gates[at].reset();
        }
        let local = station.clock.local(self.now);
        station.endpoint.set_open(gateway, open, local);
        // at the next step, so that a builder can still tap what it wires
        self.wake_now(node);
    }

    /// Another endpoint in a node's place: what was under way in the old one is lost.
    fn replace(&mut self, node: NodeId, endpoint: Box<dyn Endpoint>) {
        let station = &mut self.stations[node.at()];
        let in_work = station.frame_in_work();
        let leaving: Vec<u32> = station.gates.iter().filter_map(|gate| gate.leaving).collect();
        let waiting = station.interrupt();
        station.endpoint = endpoint;
        station.clock = station.clock.restarted(self.now);
        station.booted = self.now;
        let wired: Vec<(GatewayIndex, Attachment)> =
            station.gates.iter().map(|gate| (gate.index, gate.attachment)).collect();
        for flight in leaving {
            self.flights.get_mut(flight).cut = true;
        }
        for flight in waiting.into_iter().chain(in_work) {
            self.lose(flight);
        }
        if self.walk.is_some() {
            self.listen_to_stages(node);
        }
        for (gateway, attachment) in wired {
            let open = match attachment {
                Attachment::Link { link, .. } => self.links[link as usize].whole,
                Attachment::Bus { bus, drop } => {
                    self.withdraw(bus, drop);
                    true
                }
                Attachment::Outside { .. } => true,
            };
            assert!(self.node(node).gateway_config(gateway).is_some(), "the new device has every wired gateway");
            self.set_open(node, gateway, open);
        }
    }
}

impl std::fmt::Debug for World {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("World")
            .field("now", &self.now)
            .field("nodes", &self.stations.len())
            .field("links", &self.links.len())
            .field("buses", &self.buses.len())
            .field("stats", &self.stats)
            .finish_non_exhaustive()
    }
}

/// Whether a packet on a wire is the link's own, an announcement or about time: one step, then a system message.
fn is_the_links_own(packet: &[u8]) -> bool {
    Packet::check(packet).is_ok_and(|view| {
        view.pointer() == 5 && packet.get(view.after_instruction()).is_some_and(|instruction| instruction >> 6 == 0)
    })
}

//! A simulated machine as a network: the host's core is one node of the world, and waiting is stepping it.
//!
//! - **Walk:** [`Network::drive`] → the task looks at the core → the world's next event → the task again.
//! - **Invariants:** time is virtual: nothing waits, and one seed gives one run. The core is the one that runs over real links.
//! - **Context:** the caller's thread.
//!
//! ```
//! use osap::network::{Network, SimNetwork};
//!
//! let mut printer = SimNetwork::printer(7);
//! let local = printer.local()?;
//! assert!(local.links.iter().all(|link| link.neighbour.is_some()));
//! # Ok::<(), osap::error::NetworkError>(())
//! ```

use super::capture::LinkCapture;
use super::{Network, SimKind, SimSpec, Task};
use crate::core::{HostCore, HostIdentity};
use crate::error::{NetworkError, OpenError};
use crate::session::OpenOptions;
use fixed_math::time::{LocalTicks, Span};
use osap_protocol::GatewayIndex;
use osap_protocol::discovery::UniqueId;
use osap_runtime::GatewayConfig;
use osap_sim::capture::Direction;
use osap_sim::faults::FaultConfig;
use osap_sim::machines::{UART, printer, shapes};
use osap_sim::processor::Processor;
use osap_sim::time::ClockModel;
use osap_sim::world::{LinkId, LinkModel, NodeId, World};
use std::fmt::{self, Debug, Formatter};

/// Time after power-on at which a simulated machine is handed over: all have announced themselves.
const BOOT: Span = Span::from_us(300_000);

/// Something done to the world at a time.
type Action = Box<dyn FnOnce(&mut World) + Send>;

/// A simulated machine as a network.
pub struct SimNetwork {
    world: World,
    host: NodeId,
    links: Vec<LinkId>,
    names: Vec<String>,
    /// What is to be done, latest first.
    actions: Vec<(LocalTicks, Action)>,
    capture: Option<LinkCapture>,
}

impl Debug for SimNetwork {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.debug_struct("SimNetwork").field("links", &self.names).field("now", &self.now()).finish_non_exhaustive()
    }
}

impl SimNetwork {
    /// The machine that `spec` names.
    ///
    /// # Errors
    /// [`OpenError`] for options that a simulated machine does not have, and for a capture that cannot be written.
    pub fn open(spec: &SimSpec, options: &OpenOptions) -> Result<Self, OpenError> {
        let refuse = |option, instead| Err(OpenError::Option { option, spec: spec.to_string(), instead });
        if options.link.key.is_some() {
            return refuse("a key", "a simulated machine has no links that could be listened to; leave it out");
        }
        let seed = spec.seed.unwrap_or(options.seed);
        let model = LinkModel { faults: options.link.faults, ..LinkModel::WIRE };
        let mut network = match spec.kind {
            SimKind::Printer => Self::faulty_printer(seed, model.faults),
            SimKind::Line { devices } => Self::line(devices, model, seed),
            SimKind::Ring { devices } => Self::ring(devices, model, seed),
            SimKind::Bus { devices } => Self::bus(devices, model, seed),
            SimKind::Random { devices, extra_links } => Self::network(devices, extra_links, model, seed),
        };
        if let Some(priority) = options.root
            && let Some(core) = network.world.endpoint_mut::<HostCore>(network.host)
        {
            core.set_root(priority);
        }
        if let Some(path) = &options.capture {
            network.capture(LinkCapture::create(path)?);
        }
        Ok(network)
    }

    /// The printer of `osap_sim::machines::printer`.
    #[must_use]
    pub fn printer(seed: u64) -> Self {
        Self::faulty_printer(seed, None)
    }

    fn faulty_printer(seed: u64, faults: Option<FaultConfig>) -> Self {
        let mut world = World::new(seed);
        world.set_ambient_faults(faults);
        let core = host(&printer::HOST_GATEWAYS, seed);
        let printer = printer::build(&mut world, Box::new(core), Processor::INSTANT);
        Self::of(world, printer.host, printer.links)
    }

    /// Devices one behind the other, the host before the first.
    #[must_use]
    pub fn line(devices: usize, model: LinkModel, seed: u64) -> Self {
        Self::shape(seed, model, 1, |world| {
            let shape = shapes::line(world, devices, model);
            (shape.nodes.first().map(|node| (*node, 0)), shape.links)
        })
    }

    /// Devices in a ring, the host at the first.
    #[must_use]
    pub fn ring(devices: usize, model: LinkModel, seed: u64) -> Self {
        Self::shape(seed, model, 1, |world| {
            let shape = shapes::ring(world, devices, model);
            (shape.nodes.first().map(|node| (*node, 2)), shape.links)
        })
    }

    /// A hub with devices on one bus.
    #[must_use]
    pub fn bus(devices: usize, model: LinkModel, seed: u64) -> Self {
        Self::shape(seed, model, 1, |world| (Some((shapes::bus_cell(world, devices).hub, 0)), Vec::new()))
    }

    /// A random network with loops, the host at its first device.
    #[must_use]
    pub fn network(devices: usize, extra_links: usize, model: LinkModel, seed: u64) -> Self {
        Self::shape(seed, model, 1, |world| {
            let shape = shapes::network(world, devices, extra_links);
            (shape.nodes.first().map(|node| (*node, 0)), shape.links)
        })
    }

    /// A host with `gateways` UARTs in a world that `build` fills, with the model's faults on all its links and buses; the host's first
    /// gateway is wired, by the model, to the one that `build` names.
    pub fn shape(
        seed: u64,
        model: LinkModel,
        gateways: usize,
        build: impl FnOnce(&mut World) -> (Option<(NodeId, u8)>, Vec<LinkId>),
    ) -> Self {
        let mut world = World::new(seed);
        world.set_ambient_faults(model.faults);
        let core = host(&vec![UART; gateways], seed);
        let host = world.add_node(Box::new(core), Processor::INSTANT, ClockModel::PERFECT);
        let (first, mut links) = build(&mut world);
        let gateway = GatewayIndex::from_low_bits;
        if let Some((node, index)) = first {
            links.insert(0, world.connect((host, gateway(0)), (node, gateway(index)), model));
        }
        Self::of(world, host, links)
    }

    /// A world whose node `host` is a [`HostCore`]; `links` are those that a capture shows. It is booted.
    #[must_use]
    pub fn of(mut world: World, host: NodeId, links: Vec<LinkId>) -> Self {
        world.run_for(BOOT);
        let count = world.endpoint::<HostCore>(host).map_or(0, |core| core.links().len());
        let names = (0..count).map(|index| format!("sim:{index}")).collect();
        Self { world, host, links, names, actions: Vec::new(), capture: None }
    }

    /// The world, to look at or to change between calls.
    pub fn world(&mut self) -> &mut World {
        &mut self.world
    }

    /// The links between nodes, in the order of their making.
    #[must_use]
    pub fn links(&self) -> &[LinkId] {
        &self.links
    }

    /// Does something to the world `after` from now, in the midst of whatever is under way then.
    pub fn schedule(&mut self, after: Span, action: impl FnOnce(&mut World) + Send + 'static) {
        let at = self.now() + after;
        let place = self.actions.partition_point(|(other, _)| *other > at);
        self.actions.insert(place, (at, Box::new(action)));
    }

    fn capture(&mut self, capture: LinkCapture) {
        for (number, link) in self.links.clone().into_iter().enumerate() {
            let ends = self.world.ends(link).map(|(node, gateway)| format!("{}:{}", node.at(), gateway.get()));
            capture.add(&ends.join("-"), UART.bit_rate);
            let capture = capture.clone();
            let tap = move |event: &osap_sim::world::TapEvent<'_>| {
                let direction = if event.way == 0 { Direction::Sent } else { Direction::Received };
                capture.packet(number, LocalTicks::from_steps(event.at.steps()), direction, event.packet);
            };
            self.world.tap_link(link, Box::new(tap));
        }
        self.capture = Some(capture);
    }

    /// Whether the core did anything since it was at `turn`.
    fn core_turn(&self) -> Option<u64> {
        self.world.endpoint::<HostCore>(self.host).map(HostCore::turn)
    }
}

impl Network for SimNetwork {
    fn drive(&mut self, until: LocalTicks, mut task: Task) -> Result<(), NetworkError> {
        let end = self.world.truth(self.host, until);
        loop {
            let now = self.now();
            let core = self.world.endpoint_mut::<HostCore>(self.host).ok_or(NetworkError::Stopped)?;
            let is_done = task(core, now);
            self.world.poke(self.host);
            if is_done || now >= until {
                return Ok(());
            }
            let turn = self.core_turn();
            while self.core_turn() == turn && self.world.now() < end {
                let next = self.actions.last().map(|(at, _)| self.world.truth(self.host, *at));
                match (self.world.next_event_at(), next) {
                    (event, Some(action)) if action <= end && event.is_none_or(|event| event > action) => {
                        self.world.run_until(action);
                        if let Some((_, act)) = self.actions.pop() {
                            act(&mut self.world);
                        }
                    }
                    (Some(event), _) if event <= end => {
                        self.world.step();
                    }
                    _ => self.world.run_until(end),
                }
            }
        }
    }

    fn now(&self) -> LocalTicks {
        self.world.local_now(self.host)
    }

    fn link_names(&self) -> Vec<String> {
        self.names.clone()
    }

    fn is_simulated(&self) -> bool {
        true
    }

    fn capture_fault(&self) -> Option<String> {
        self.capture.as_ref().and_then(LinkCapture::fault)
    }
}

/// A host's core with these links; the same in each run of a seed.
fn host(gateways: &[GatewayConfig], seed: u64) -> HostCore {
    let mut unique_id = *b"host\0\0\0\0\0\0\0\0";
    unique_id[4..].copy_from_slice(&seed.to_be_bytes());
    let mut core =
        HostCore::new(&HostIdentity { unique_id: UniqueId(unique_id), boot_epoch: 1, name: "host".to_owned() });
    for config in gateways {
        core.add_link(*config);
    }
    core
}

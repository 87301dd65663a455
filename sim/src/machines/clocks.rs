//! Networks in which clocks are measured: a line of hubs, a tree, each node with a crystal, a timer and stamps of its own.
//!
//! - **Walk:** [`line()`] or [`tree`] → the nodes' clock service → [`World::exact`] at one instant, and what each node makes of it.
//! - **Invariants:** links are 3 Mbaud UARTs; processors are [`PICO_125_MHZ`]. Rates and boot times are drawn from the world's seed. The first
//!   node boots first.
//! - **Context:** before the world's first step. **Clause:** `[NOD-12]`.

use super::{CRYSTAL_PPM, UART, gateway, micros, sim_factory};
use crate::device::{SIM_GATEWAYS, SimDevice};
use crate::processor::Processor;
use crate::time::{ClockModel, Ramp, TrueTime, Wander};
use crate::world::{Factory, LinkId, LinkModel, NodeId, StampModel, World};
use firmware_app::kind;
use fixed_math::time::Span;
use std::any::Any;

/// Our own image on a Raspberry Pi Pico at 125 MHz: 52 µs for a packet received, handled and answered, of which the images' measured round
/// trips see 50.2, and forwarding a packet takes it 32, where they see 34 to 38.
pub const PICO_125_MHZ: Processor = Processor {
    name: "RP2040, our image at 125 MHz",
    clock_hz: 125_000_000,
    receive: micros(20, 0),
    handle: micros(20, 0),
    forward: micros(12, 0),
};

/// How far an RC oscillator may be off, ppm.
pub const RC_PPM: f64 = 10_000.0;

/// An RC oscillator in a room: its rate goes by 17 ppm a second at most, where the three ramps go the same way (10.06 times
/// `ppm_max / period_s`). That is within what estimators are told of such oscillators, 20 ppm a second.
pub const RC_SLOW: Wander = Wander { ppm_max: 100.0, period_s: 60.0, seed: 0 };

/// What the nodes and links are like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockWorld {
    /// Each crystal is off by up to this, evenly distributed, ppm.
    pub crystal_ppm: f64,
    /// What each crystal's rate does over time; every other node's goes downwards first.
    pub ramp: Ramp,
    /// All nodes but the first run on RC oscillators instead, which are off by up to [`RC_PPM`] and wander like this, each by itself.
    pub rc: Option<Wander>,
    /// What the first node's counter reads when it boots, and by how much less each next one's reads, µs.
    pub counts_from_us: [u64; 2],
    /// What each timer counts in.
    pub tick: Span,
    /// How well each node stamps.
    pub stamps: StampModel,
    /// How much longer than its processor's time each job may take.
    pub job_spread: Span,
    /// Nodes boot within this time, evenly distributed; the first one at its beginning.
    pub boots_within: Span,
    /// What each link adds to its wire time.
    pub link: LinkModel,
}

impl ClockWorld {
    /// The conditions of the figures to beat: ±50 ppm, a ramp of 0.01 ppm a second, timers of 1 µs, 30 % of stamps delayed by 8 µs in the
    /// mean; boots within 50 ms.
    pub const FIGURES: Self = Self {
        crystal_ppm: CRYSTAL_PPM,
        ramp: Ramp { ppm_per_s: 0.01, ppm_max: 2.0 },
        rc: None,
        counts_from_us: [0; 2],
        tick: Span::from_us(1),
        stamps: StampModel { delayed_part: 0.3, delay_mean: Span::from_us(8), ..StampModel::EXACT },
        // the images' round trips spread over 2.6 µs in three jobs
        job_spread: Span::from_us(1),
        boots_within: Span::from_us(50_000),
        link: LinkModel::WIRE,
    };
}

/// A network without loops; the first node is its root.
#[derive(Clone, Debug, Default)]
pub struct ClockTree {
    /// Nodes, each after the one it hangs on. Gateway 0 leads up, gateways from 1 on lead down; that of the first node is free.
    pub nodes: Vec<NodeId>,
    /// How many links lie between each node and the first.
    pub hops: Vec<usize>,
    /// The node that each hangs on, but for the first: link `n` leads from `parents[n]` to node `n + 1`.
    pub parents: Vec<usize>,
    /// Links; the first end is the upper one.
    pub links: Vec<LinkId>,
}

impl ClockTree {
    /// The nodes on the way from a node up to the first, both included.
    pub fn path(&self, at: usize) -> impl Iterator<Item = usize> {
        std::iter::successors(Some(at), |at| at.checked_sub(1).map(|link| self.parents[link]))
    }

    /// When the last node on the way from the first to a node has booted: the earliest instant at which it could know the time.
    #[must_use]
    pub fn joined(&self, world: &World, at: usize) -> TrueTime {
        self.path(at).map(|at| world.booted(self.nodes[at])).max().unwrap_or_default()
    }
}

/// `hops` hubs in a row with a device at the end.
pub fn line(world: &mut World, hops: usize, model: &ClockWorld) -> ClockTree {
    build(world, hops + 1, 1, model)
}

/// `nodes` nodes, of which each has `fan_out` others below it until they are used up: levels are filled one by one.
///
/// # Panics
/// Where a hub would need more than `SIM_GATEWAYS` gateways, or none.
pub fn tree(world: &mut World, nodes: usize, fan_out: usize, model: &ClockWorld) -> ClockTree {
    assert!((1..SIM_GATEWAYS).contains(&fan_out), "a hub has one gateway up and up to {} down", SIM_GATEWAYS - 1);
    build(world, nodes, fan_out, model)
}

/// The counter of the `at`-th node.
fn clock(world: &mut World, at: usize, model: &ClockWorld) -> ClockModel {
    let [from_us, less_us] = model.counts_from_us;
    let offset_us = from_us.saturating_sub(less_us.saturating_mul(at as u64));
    let rc = model.rc.filter(|_| at > 0);
    let drawn = world.draw_clock(if rc.is_some() { RC_PPM } else { model.crystal_ppm });
    let clock = ClockModel { tick: model.tick, offset_us, ..drawn };
    if let Some(wander) = rc {
        // a seed of its own for each node of each drawing
        let seed = drawn.rate_ppm.to_bits() ^ wander.seed;
        return ClockModel { wander: Wander { seed, ..wander }, ..clock };
    }
    let turn = if at.is_multiple_of(2) { 1.0 } else { -1.0 };
    ClockModel { ramp: Ramp { ppm_per_s: model.ramp.ppm_per_s * turn, ..model.ramp }, ..clock }
}

/// The same device, which knows that its counter runs on no crystal and says so.
fn declares_rc(mut factory: Factory) -> Factory {
    Box::new(move |boot| {
        let mut endpoint = factory(boot);
        if let Some(device) = (&mut *endpoint as &mut dyn Any).downcast_mut::<SimDevice>() {
            device.node_mut().clock_mut().set_rc(true);
        }
        endpoint
    })
}

fn build(world: &mut World, nodes: usize, fan_out: usize, model: &ClockWorld) -> ClockTree {
    let mut it = ClockTree::default();
    let begins = world.now();
    for at in 0..nodes {
        let below = nodes.saturating_sub(at * fan_out + 1).min(fan_out);
        let clock = clock(world, at, model);
        let after = if at == 0 { Span::ZERO } else { world.draw_span(model.boots_within) };
        let kind = if below == 0 { &kind::MOTOR } else { &kind::HUB };
        let name = format!("{}-{at}", kind.type_name);
        let factory = sim_factory(world, kind, &name, vec![UART; 1 + below]);
        let factory = if model.rc.is_some() && at > 0 { declares_rc(factory) } else { factory };
        let node = world.add_device_at(begins + after, factory, PICO_125_MHZ, clock);
        world.set_stamps(node, model.stamps);
        world.set_job_spread(node, model.job_spread);
        it.nodes.push(node);
        if let Some(place) = at.checked_sub(1) {
            let (parent, way_down) = (place / fan_out, place % fan_out);
            let upper = (it.nodes[parent], gateway(1 + way_down));
            it.links.push(world.connect(upper, (node, gateway(0)), model.link));
            it.parents.push(parent);
        }
        it.hops.push(it.path(at).count() - 1);
    }
    it
}

//! One simulated network, what happens to it, and what its clocks did.

use super::reference::Reference;
use fixed_math::time::{NetTime, Span};
use osap_protocol::discovery::{KeptLink, KeptTime, ServoKind, TimeSettings};
use osap_sim::device::SimDevice;
use osap_sim::machines::clocks::{self, ClockTree, ClockWorld};
use osap_sim::world::{NodeId, World};

/// Between two samples: no multiple or part of any period in the network.
const SAMPLE_EVERY: Span = Span::from_us(1_009);

/// How the nodes are wired.
#[derive(Clone, Copy, Debug)]
pub(super) enum Shape {
    /// In a row.
    Line { hops: usize },
    /// Each hub with so many below it.
    Tree { nodes: usize, fan_out: usize },
}

/// What happens to a network.
#[derive(Clone, Copy, Debug)]
pub(super) enum Act {
    /// A cable is cut, and neither end notices: by the number of its lower node.
    Cut(usize),
    /// It is whole again.
    Mend(usize),
    /// Something runs by system time from now on, everywhere.
    Live,
}

/// A network, how its clocks are steered, what happens to it, and for how long.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scene {
    pub(super) shape: Shape,
    pub(super) servo: ServoKind,
    pub(super) world: ClockWorld,
    /// Virtual seconds.
    pub(super) seconds: u64,
    /// What happens after how many ms, in order. With it errors are against the root that each node itself names, and times count from the
    /// last of it.
    pub(super) script: &'static [(u64, Act)],
    /// How much longer the way up is than the way down, as each node is told beforehand, steps.
    pub(super) asymmetry_steps: i32,
    /// Figures of the steady state are of what comes so long after joining, or after the last of the script where `is_after_script`.
    pub(super) settled_after: Span,
    pub(super) is_after_script: bool,
}

/// A node's clock at one instant.
#[expect(clippy::struct_field_names, reason = "units stand last in every name")]
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// Since the node joined, µs.
    pub(super) after_us: u32,
    /// Its system time less the root's, µs.
    pub(super) error_us: f32,
    /// The bound it publishes, where it follows the root.
    pub(super) bound_us: Option<f32>,
}

/// A node's clock over a run, from when it and all nodes up to the root had booted.
#[derive(Clone, Debug)]
pub(super) struct Series {
    pub(super) node: usize,
    pub(super) hops: usize,
    /// From when on times are counted, and from when on is the steady state, µs since joining.
    pub(super) counts_from_us: u32,
    pub(super) settled_from_us: u32,
    pub(super) samples: Vec<Sample>,
    /// Its counter and its time at the last sample, while it was settled and live.
    pub(super) last: Option<(u64, NetTime)>,
    /// How much faster or slower than its counter its time went at most from one sample to the next while it was settled and live, ppm;
    /// where its time was set anew, that is in it.
    pub(super) rate_max_ppm: f64,
    /// How far the settled nodes of the same root were apart at most once its time was settled, µs: of the first node's series only.
    pub(super) apart_max_us: f64,
}

/// What a node makes of its counter's exact phase now.
#[derive(Clone, Copy, Debug)]
struct Reading {
    local_steps: u64,
    at: NetTime,
    bound: Option<Span>,
    is_settled: bool,
    tier: u8,
}

impl Scene {
    /// Runs it; a series for each node but the first.
    pub(super) fn run(&self, seed: u64) -> Vec<Series> {
        let mut world = World::new(seed);
        let tree = match self.shape {
            Shape::Line { hops } => clocks::line(&mut world, hops, &self.world),
            Shape::Tree { nodes, fan_out } => clocks::tree(&mut world, nodes, fan_out, &self.world),
        };
        self.prepare(&mut world, &tree);
        let mut reference = Reference::new(&tree);
        let mut series: Vec<Series> = (1..tree.nodes.len()).map(|node| self.series(&world, &tree, node)).collect();
        let (mut acts, mut is_live) = (self.script.iter().peekable(), false);
        for _ in 0..Span::from_us(self.seconds * 1_000_000).steps() / SAMPLE_EVERY.steps() {
            while let Some((_, act)) = acts.next_if(|(ms, _)| ms * 1_000 <= world.now().as_us()) {
                is_live |= matches!(act, Act::Live);
                perform(*act, &mut world, &tree);
            }
            if self.script.is_empty() {
                world.run_for(SAMPLE_EVERY);
                sample(&world, &tree, &mut series);
            } else {
                let until = world.now() + SAMPLE_EVERY;
                // after each event, as a node may be root for less than a sample
                while world.next_event_at().is_some_and(|at| at <= until) {
                    world.step();
                    reference.note(&world, &tree);
                }
                world.run_until(until);
                sample_each(&world, &tree, &reference, is_live, &mut series);
            }
        }
        series
    }

    /// Gives each node its servo and the calibration of its links.
    fn prepare(&self, world: &mut World, tree: &ClockTree) {
        for (place, node) in tree.nodes.iter().enumerate() {
            let Some(device) = world.endpoint_mut::<SimDevice>(*node) else { continue };
            let it = device.node_mut();
            let settings = TimeSettings { servo: self.servo, ..it.clock().settings() };
            let up = KeptLink { peer: None, asymmetry_steps: if place > 0 { self.asymmetry_steps } else { 0 } };
            let down = KeptLink { peer: None, asymmetry_steps: -self.asymmetry_steps };
            // what a former run kept is how a node knows its calibrations from the first exchange on
            it.restore_time(&KeptTime { settings, links: [up, down, down, down].into_iter().collect() });
        }
    }

    fn series(&self, world: &World, tree: &ClockTree, node: usize) -> Series {
        let joined_us = tree.joined(world, node).as_us();
        let last_us = self.script.last().map_or(0, |(ms, _)| ms * 1_000);
        let us = |us: u64| u32::try_from(us).unwrap_or(u32::MAX);
        let counts_from_us = us(last_us.saturating_sub(joined_us));
        let settled_from_us = us(self.settled_after.as_us_floor());
        Series {
            node,
            hops: tree.hops[node],
            counts_from_us,
            settled_from_us: if self.is_after_script { settled_from_us + counts_from_us } else { settled_from_us },
            samples: Vec::new(),
            rate_max_ppm: 0.0,
            apart_max_us: 0.0,
            last: None,
        }
    }
}

fn perform(act: Act, world: &mut World, tree: &ClockTree) {
    match act {
        Act::Cut(lower) => world.cut(tree.links[lower - 1]),
        Act::Mend(lower) => world.replug(tree.links[lower - 1]),
        Act::Live => {
            for node in &tree.nodes {
                if let Some(device) = world.endpoint_mut::<SimDevice>(*node) {
                    device.node_mut().clock_mut().set_live(true);
                }
            }
        }
    }
}

fn reading(world: &World, node: NodeId) -> Option<Reading> {
    let node_of = world.endpoint::<SimDevice>(node)?.node();
    let local = world.exact(node, world.now());
    let time = node_of.system_time(local);
    let tier = node_of.clock().tier();
    Some(Reading { local_steps: local.steps(), at: time.at, bound: time.bound, is_settled: time.is_settled, tier })
}

/// Errors against the first node.
fn sample(world: &World, tree: &ClockTree, series: &mut [Series]) {
    let readings: Vec<_> = tree.nodes.iter().map(|node| reading(world, *node)).collect();
    let Some(Some(Reading { at: root, .. })) = readings.first() else { return };
    for it in series {
        let joined = tree.joined(world, it.node);
        let Some(read) = readings[it.node].filter(|_| world.now() >= joined) else { continue };
        let follows = tree
            .path(it.node)
            .all(|at| readings[at].is_some_and(|Reading { tier, .. }| usize::from(tier) == tree.hops[at]));
        it.push(world, tree, read.at.steps_after(*root), read.bound.filter(|_| follows));
    }
}

/// Errors against whom each node names as its root.
fn sample_each(world: &World, tree: &ClockTree, reference: &Reference, is_live: bool, series: &mut [Series]) {
    let mut of_roots = std::collections::BTreeMap::<usize, (NetTime, NetTime)>::new();
    let mut apart_max_us = 0.0f64;
    for it in series.iter_mut().filter(|it| world.now() >= tree.joined(world, it.node)) {
        let Some(read) = reading(world, tree.nodes[it.node]) else { continue };
        let Some((root, time)) = reference.of(world, tree, it.node) else { continue };
        it.push(world, tree, read.at.steps_after(time), read.bound);
        it.note_rate(&read, is_live);
        let is_steady = it.samples.last().is_some_and(|sample| sample.after_us >= it.settled_from_us);
        if read.is_settled && is_steady {
            let (low, high) = of_roots.entry(root).or_insert((read.at, read.at));
            (*low, *high) = ((*low).min(read.at), (*high).max(read.at));
            apart_max_us = apart_max_us.max(f64::from(us(high.steps_after(*low))));
        }
    }
    if let Some(first) = series.first_mut() {
        first.apart_max_us = first.apart_max_us.max(apart_max_us);
    }
}

impl Series {
    fn push(&mut self, world: &World, tree: &ClockTree, error_steps: i64, bound: Option<Span>) {
        let joined = tree.joined(world, self.node);
        self.samples.push(Sample {
            after_us: u32::try_from(world.now().since(joined).as_us_floor()).unwrap_or(u32::MAX),
            error_us: us(error_steps),
            bound_us: bound.map(|bound| us(bound.steps().cast_signed())),
        });
    }

    fn note_rate(&mut self, read: &Reading, is_live: bool) {
        let is_held = read.is_settled && is_live;
        if let Some((was_local, was)) = self.last.filter(|_| is_held) {
            let own = read.local_steps.saturating_sub(was_local).cast_signed();
            let gained = read.at.steps_after(was) - own;
            let ppm = f64::from(us(gained)).abs() / f64::from(us(own)).max(1.0) * 1e6;
            self.rate_max_ppm = self.rate_max_ppm.max(ppm);
        }
        self.last = is_held.then_some((read.local_steps, read.at));
    }
}

/// Microseconds of steps.
#[expect(clippy::cast_precision_loss, reason = "what is looked at closely is far below 2^24 steps, 65 ms")]
fn us(steps: i64) -> f32 {
    steps as f32 / 256.0
}

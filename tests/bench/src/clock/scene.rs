//! One simulated network and what its clocks did.

use fixed_math::time::Span;
use osap_protocol::discovery::{ServoKind, TimeSettings};
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

/// A network, how its clocks are steered, and for how long.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scene {
    pub(super) shape: Shape,
    pub(super) servo: ServoKind,
    pub(super) world: ClockWorld,
    /// Virtual seconds.
    pub(super) seconds: u64,
}

/// A node's clock at one instant.
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
    pub(super) samples: Vec<Sample>,
}

impl Scene {
    /// Runs it; a series for each node but the root.
    pub(super) fn run(&self, seed: u64) -> Vec<Series> {
        let mut world = World::new(seed);
        let tree = match self.shape {
            Shape::Line { hops } => clocks::line(&mut world, hops, &self.world),
            Shape::Tree { nodes, fan_out } => clocks::tree(&mut world, nodes, fan_out, &self.world),
        };
        for node in &tree.nodes {
            let Some(device) = world.endpoint_mut::<SimDevice>(*node) else { continue };
            let clock = device.node_mut().clock_mut();
            let settings = TimeSettings { servo: self.servo, ..clock.settings() };
            clock.set(settings).expect("the settings of a new node but for its servo");
        }
        let all = tree.hops.iter().enumerate().skip(1);
        let mut series: Vec<Series> =
            all.map(|(node, hops)| Series { node, hops: *hops, samples: Vec::new() }).collect();
        for _ in 0..Span::from_us(self.seconds * 1_000_000).steps() / SAMPLE_EVERY.steps() {
            world.run_for(SAMPLE_EVERY);
            sample(&world, &tree, &mut series);
        }
        series
    }
}

/// What a node makes of its counter's exact phase now, 1/256 µs, its bound, and its tier.
fn reading(world: &World, node: NodeId) -> Option<(fixed_math::time::NetTime, Option<Span>, u8)> {
    let node_of = world.endpoint::<SimDevice>(node)?.node();
    let time = node_of.system_time(world.exact(node, world.now()));
    Some((time.at, time.bound, node_of.clock().tier()))
}

fn sample(world: &World, tree: &ClockTree, series: &mut [Series]) {
    let readings: Vec<_> = tree.nodes.iter().map(|node| reading(world, *node)).collect();
    let Some(Some((root, _, _))) = readings.first() else { return };
    for it in series {
        let joined = tree.joined(world, it.node);
        let Some((at, bound, _)) = readings[it.node].filter(|_| world.now() >= joined) else { continue };
        let follows =
            tree.path(it.node).all(|at| readings[at].is_some_and(|(_, _, tier)| usize::from(tier) == tree.hops[at]));
        it.samples.push(Sample {
            after_us: u32::try_from(world.now().since(joined).as_us_floor()).unwrap_or(u32::MAX),
            error_us: us(at.steps_after(*root)),
            bound_us: bound.filter(|_| follows).map(|bound| us(bound.steps().cast_signed())),
        });
    }
}

/// Microseconds of steps.
#[expect(clippy::cast_precision_loss, reason = "what is looked at closely is far below 2^24 steps, 65 ms")]
fn us(steps: i64) -> f32 {
    steps as f32 / 256.0
}

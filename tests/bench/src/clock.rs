//! How well clocks agree in the simulator, where the truth is known: the estimator, the thesis's servo and the disclosure's rule on the same
//! seeds; four hops, twenty, and a tree of a hundred nodes.
//!
//! An error is a node's system time less the root's at one true instant, both of the exact phase of their counters: what reading a timer of
//! 1 µs adds is not in it. A node follows the root once every node up to it has the tier that its place says. Figures of the steady state are
//! of all that comes `SETTLED_AFTER` after a node joined; a limit is kept from the first instant on after which no error was above it for
//! `KEPT_FOR`.

mod report;
mod scene;

use scene::{Scene, Series, Shape};

pub(crate) use report::Output;

use fixed_math::time::Span;
use osap_protocol::discovery::ServoKind;
use osap_sim::machines::clocks::ClockWorld;
use osap_sim::world::{Departure, StampModel};

/// What comes later than this after joining is the steady state.
pub(crate) const SETTLED_AFTER: Span = Span::from_us(2_000_000);
/// For how long no error may be above a limit that is kept.
pub(crate) const KEPT_FOR: Span = Span::from_us(1_000_000);
/// Limits whose times are told, µs.
pub(crate) const LIMITS_US: [f64; 2] = [10.0, 1.0];

/// The first case of the issue: 4 hops.
fn four_hops(servo: ServoKind) -> Scene {
    Scene { shape: Shape::Line { hops: 4 }, servo, world: ClockWorld::FIGURES, seconds: 20 }
}

/// Measures everything and prints it.
pub(crate) fn run(seeds: u64, output: &Output) {
    let estimator = four_hops(ServoKind::Estimator);
    let exact = ClockWorld { stamps: StampModel::EXACT, ..ClockWorld::FIGURES };
    let late = StampModel { departure: Departure::StampedAfter, ..ClockWorld::FIGURES.stamps };
    let late = ClockWorld { stamps: late, ..ClockWorld::FIGURES };
    let locked = ClockWorld { job_spread: Span::ZERO, ..ClockWorld::FIGURES };
    let rows = [
        ("4 hops", estimator, seeds),
        ("4 hops, no stamp delayed", Scene { world: exact, ..estimator }, seeds),
        ("4 hops, departures stamped late", Scene { world: late, ..estimator }, seeds),
        ("4 hops, jobs last whole ticks", Scene { world: locked, ..estimator }, seeds),
        ("4 hops", four_hops(ServoKind::Diffusion), seeds),
        ("4 hops", four_hops(ServoKind::Oldest), seeds),
        ("20 hops in a line", Scene { shape: Shape::Line { hops: 20 }, ..estimator }, seeds.min(10)),
        ("100 nodes in a tree", Scene { shape: Shape::Tree { nodes: 100, fan_out: 3 }, ..estimator }, seeds.min(5)),
    ];
    output.begin(seeds);
    for (name, scene, seeds) in rows {
        let of_seeds: Vec<Vec<Series>> = (1..=seeds).map(|seed| scene.run(seed)).collect();
        output.scene(name, &scene, &of_seeds);
    }
    output.end();
}

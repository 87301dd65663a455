//! How well clocks agree in the simulator, where the truth is known: the estimator, the thesis's servo and the disclosure's rule on the same
//! seeds; four hops, twenty, and a tree of a hundred nodes; and what else a network may meet.
//!
//! An error is a node's system time less the root's at one true instant, both of the exact phase of their counters: what reading a timer of
//! 1 µs adds is not in it. A node follows the root once every node up to it has the tier that its place says. Figures of the steady state are
//! of all that comes `SETTLED_AFTER` after a node joined; a limit is kept from the first instant on after which no error was above it for
//! `KEPT_FOR`. Where something happens to the network, errors are against whom each node names as its root, and times count from the last
//! thing that happens.

mod reference;
mod report;
mod scene;

use scene::{Act, Scene, Series, Shape};

pub(crate) use report::Output;

use fixed_math::time::Span;
use osap_protocol::discovery::ServoKind;
use osap_sim::machines::clocks::{ClockWorld, RC_SLOW};
use osap_sim::world::{Departure, LinkModel, StampModel};

/// What comes later than this after joining is the steady state.
pub(crate) const SETTLED_AFTER: Span = Span::from_us(2_000_000);
/// For how long no error may be above a limit that is kept.
pub(crate) const KEPT_FOR: Span = Span::from_us(1_000_000);
/// Limits whose times are told, µs.
pub(crate) const LIMITS_US: [f64; 2] = [10.0, 1.0];
/// Most seeds of a case that is not one of the goals'.
const SEEDS_BESIDE: u64 = 10;
/// How much longer one way is where links are unequal.
const UNEQUAL_US: u64 = 20;

/// What a row is there for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// The goals of the issue are about it.
    Goal,
    /// Its figures stand beside; no error may be above its bound.
    Beside,
    /// As that, but it breaks what a bound rests on: told is what becomes of it.
    Unpromised,
}

/// The first case of the issue: 4 hops.
fn hops(hops: usize) -> Scene {
    Scene {
        shape: Shape::Line { hops },
        servo: ServoKind::Estimator,
        world: ClockWorld::FIGURES,
        seconds: 20,
        script: &[],
        asymmetry_steps: 0,
        settled_after: SETTLED_AFTER,
        is_after_script: false,
    }
}

/// One case: its name, what it is, how many seeds at most, what for.
type Case = (&'static str, Scene, u64, Purpose);

/// The networks of the goals, the servos of others, and what tells why figures are as they are.
fn at_rest(seeds: u64) -> Vec<Case> {
    let estimator = hops(4);
    let figures = ClockWorld::FIGURES;
    let exact = ClockWorld { stamps: StampModel::EXACT, ..figures };
    let late = StampModel { departure: Departure::StampedAfter, ..figures.stamps };
    let late = ClockWorld { stamps: late, ..figures };
    let locked = ClockWorld { job_spread: Span::ZERO, ..figures };
    let tree = Scene { shape: Shape::Tree { nodes: 100, fan_out: 3 }, ..estimator };
    vec![
        ("4 hops", estimator, seeds, Purpose::Goal),
        ("4 hops, no stamp delayed", Scene { world: exact, ..estimator }, seeds, Purpose::Beside),
        ("4 hops, departures stamped late", Scene { world: late, ..estimator }, seeds, Purpose::Unpromised),
        ("4 hops, jobs last whole ticks", Scene { world: locked, ..estimator }, seeds, Purpose::Beside),
        ("4 hops", Scene { servo: ServoKind::Diffusion, ..estimator }, seeds, Purpose::Beside),
        ("4 hops", Scene { servo: ServoKind::Oldest, ..estimator }, seeds, Purpose::Beside),
        ("20 hops in a line", hops(20), seeds.min(10), Purpose::Goal),
        ("100 nodes in a tree", tree, seeds.min(5), Purpose::Goal),
    ]
}

/// Oscillators, links and counters as they also are.
fn unlike(seeds: u64) -> Vec<Case> {
    let beside = seeds.min(SEEDS_BESIDE);
    let (two, four, figures) = (hops(2), hops(4), ClockWorld::FIGURES);
    let rc = ClockWorld { rc: Some(RC_SLOW), ..figures };
    let link = LinkModel { extra: [Span::from_us(UNEQUAL_US), Span::ZERO], ..figures.link };
    let unequal = Scene { world: ClockWorld { link, ..figures }, ..two };
    // from the first node's end of a link to its second is down
    let longer_steps = i32::try_from(Span::from_us(UNEQUAL_US).steps()).unwrap_or(i32::MAX);
    let calibrated = Scene { asymmetry_steps: -longer_steps, ..unequal };
    // slots wrap every 2^32 steps, which are 2^24 µs: each node's between 1 and 5 s after its boot
    let wraps = ClockWorld { counts_from_us: [(7 << 24) - 1_000_000, 1_000_000], ..figures };
    // 2^63 steps are 2^55 µs, 1141 years: what lies between two times has 63 bits
    let top = ClockWorld { counts_from_us: [(1 << 55) - 60_000_000, 1_000_000], ..figures };
    vec![
        ("2 hops, RC oscillators of ±1 %", Scene { world: rc, ..two }, seeds, Purpose::Beside),
        ("2 hops, 20 µs longer down", unequal, beside, Purpose::Beside),
        ("2 hops, the same, calibrated", calibrated, beside, Purpose::Beside),
        ("4 hops, slots wrap early", Scene { world: wraps, ..four }, beside, Purpose::Beside),
        ("4 hops, counters near 2^63", Scene { world: top, ..four }, beside, Purpose::Beside),
    ]
}

/// Networks that change.
fn changing(seeds: u64) -> Vec<Case> {
    const OUTAGE: &[(u64, Act)] = &[(0, Act::Live), (5_000, Act::Cut(2)), (7_000, Act::Mend(2))];
    const ROOT_LOST: &[(u64, Act)] = &[(5_000, Act::Live), (5_000, Act::Cut(1))];
    const MERGE: &[(u64, Act)] = &[(0, Act::Cut(3)), (5_000, Act::Live), (5_000, Act::Mend(3))];
    let beside = seeds.min(SEEDS_BESIDE);
    let four = hops(4);
    // counters that are 1 ms apart from node to node: the younger network's root has 3 ms less, 6 s of slewing at 500 ppm
    let apart = ClockWorld { counts_from_us: [10_000, 1_000], boots_within: Span::ZERO, ..four.world };
    let slewed = Span::from_us(8_000_000);
    let merge =
        Scene { world: apart, script: MERGE, settled_after: slewed, is_after_script: true, seconds: 25, ..four };
    vec![
        ("4 hops, a link away for 2 s", Scene { script: OUTAGE, ..four }, beside, Purpose::Beside),
        ("4 hops, the root is lost", Scene { script: ROOT_LOST, ..four }, beside, Purpose::Beside),
        ("4 hops, two networks become one", merge, beside, Purpose::Beside),
    ]
}

/// Measures everything and prints it.
pub(crate) fn run(seeds: u64, output: &Output) {
    output.begin(seeds);
    for (name, scene, seeds, purpose) in at_rest(seeds).into_iter().chain(unlike(seeds)).chain(changing(seeds)) {
        let of_seeds: Vec<Vec<Series>> = (1..=seeds).map(|seed| scene.run(seed)).collect();
        output.scene(name, &scene, purpose, &of_seeds);
    }
    output.end();
}

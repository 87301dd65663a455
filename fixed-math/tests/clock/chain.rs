//! Five nodes in a line, the first of them the root: estimates composed down the line, and maps slewed to them.

use crate::UART;
use crate::world::{Conditions, Counter, World, pace_us, us};
use fixed_math::clock::{Estimate, Follow, Gains, LinkClock, Neighbour, PeerEstimate, Servo, SlewedMap, TimeLine};
use fixed_math::time::{LocalTicks, NetTime, PeerTicks, Rate, Span};
use rand::SeedableRng;
use rand_pcg::Pcg32;

const HOPS: usize = 4;
/// A second at 200 Hz: what four hops need to be below a microsecond then.
const BURST: u32 = 200;
const GAINS: Gains = Gains {
    interval: Span::from_us(50_000),
    filter_q16: 0,
    proportional_q16: 0,
    integral_q16: 0,
    limit: Rate::from_ppb(500_000),
    adopt_steps: 0,
};

/// A node under the root.
struct Node {
    link: LinkClock,
    world: World,
    estimate: Option<Estimate>,
    map: Option<SlewedMap>,
    next_us: f64,
    exchanges: u32,
}

/// Errors of a node, µs: of what it passes on, and of what its programs see.
#[derive(Default)]
struct Errors {
    line: Vec<f64>,
    map: Vec<f64>,
    below_1us_at_us: f64,
    of_bound: f64,
}

fn counters(seed: u64) -> Vec<Counter> {
    let mut random = Pcg32::seed_from_u64(seed ^ 0xc4a1);
    (0..=HOPS as u64)
        .map(|node| Counter { ramp_per_s: if node % 2 == 0 { 0.01e-6 } else { 0.0 }, ..Counter::crystal(&mut random) })
        .collect()
}

/// What a reply of node `index − 1` says of its counter at `heard`; the root's system time is its counter.
fn told(above: Option<&Node>, heard: PeerTicks) -> Option<PeerEstimate> {
    let local = LocalTicks::from_steps(heard.steps());
    let Some(node) = above else {
        return Some(PeerEstimate { at: heard, system: NetTime::from_steps(heard.steps()), ..PeerEstimate::default() });
    };
    let estimate = node.estimate?;
    Some(PeerEstimate {
        at: heard,
        system: estimate.line.system_at(local),
        rate: estimate.line.rate,
        error: estimate.error,
        bound: estimate.bound_at(local),
        drift: estimate.drift,
    })
}

impl Node {
    /// One exchange with the node above; `told` is what that says.
    fn exchange(&mut self, above: Option<&Self>) {
        self.world.now_us = self.next_us;
        let exchange = self.world.exchange();
        let _ = self.link.observe(&exchange);
        self.next_us += pace_us(self.exchanges, BURST) + 3.7;
        self.exchanges += 1;
        let Some(peer) = told(above, exchange.heard) else { return };
        let now = exchange.received;
        let estimate = self.link.compose(&peer, now);
        self.estimate = Some(estimate);
        let Some(map) = &mut self.map else {
            self.map = Some(SlewedMap::new(estimate.line));
            return;
        };
        let neighbour = Neighbour { estimate, ..Neighbour::default() };
        Follow.steer(now, &[neighbour], &GAINS, map);
    }

    /// Looks at the node at true time `at_us`.
    fn look(&self, root: &Counter, at_us: f64, errors: &mut Errors) {
        let own = self.world.conditions.own;
        let reading = own.steps(at_us);
        let local = LocalTicks::from_us(own.origin_us) + Span::from_steps(reading);
        let truth = root.since_origin(own.time_of(reading));
        let origin = NetTime::from_us(root.origin_us);
        let error = |system: NetTime| system.steps_after(origin) as f64 / 256.0 - truth;
        let (Some(estimate), Some(map)) = (self.estimate, self.map) else { return };
        let line = error(estimate.line.system_at(local));
        let seen = error(map.system_at(local));
        errors.of_bound = errors.of_bound.max(line.abs() / us(estimate.bound_at(local)));
        let behind = map.behind_steps(local).unsigned_abs() as f64 / 256.0;
        // what is seen is off by what is left to slew more, and the rounding of that
        errors.of_bound = errors.of_bound.max(seen.abs() / (us(estimate.bound_at(local)) + behind + 1.0 / 256.0));
        if seen.abs() >= 1.0 {
            errors.below_1us_at_us = at_us;
        }
        if at_us > 5e6 {
            errors.line.push(line.abs());
            errors.map.push(seen.abs());
        }
    }
}

fn rms(errors: &[f64]) -> f64 {
    (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt()
}

fn run(seed: u64, seconds: f64) -> Vec<Errors> {
    let counters = counters(seed);
    let mut nodes: Vec<Node> = (0..HOPS)
        .map(|index| {
            let conditions = Conditions { own: counters[index + 1], peer: counters[index], ..Conditions::issue(seed) };
            Node {
                link: LinkClock::new(UART),
                world: World::new(conditions, seed * 16 + index as u64),
                estimate: None,
                map: None,
                next_us: 100.0 * (index + 1) as f64,
                exchanges: 0,
            }
        })
        .collect();
    let mut errors: Vec<Errors> = (0..HOPS).map(|_| Errors::default()).collect();
    let mut look_us = 0.0;
    loop {
        let index = (0..HOPS).min_by(|a, b| nodes[*a].next_us.total_cmp(&nodes[*b].next_us)).unwrap();
        let at = nodes[index].next_us;
        while look_us < at {
            for (node, errors) in nodes.iter().zip(&mut errors) {
                node.look(&counters[0], look_us, errors);
            }
            look_us += 3_000.0;
        }
        if at > seconds * 1e6 {
            return errors;
        }
        let (above, below) = nodes.split_at_mut(index);
        below[0].exchange(above.last());
    }
}

/// Four hops of the issue: the goal's figures, at every hop, of what programs see; the bound of every hop holds at every instant.
#[test]
fn four_hops_of_the_issue() {
    let runs: Vec<Vec<Errors>> = (0..30).map(|seed| run(seed, 40.0)).collect();
    for hop in 0..HOPS {
        let all = |of: fn(&Errors) -> &Vec<f64>| {
            let mut all: Vec<f64> = runs.iter().flat_map(|run| of(&run[hop]).iter().copied()).collect();
            all.sort_by(f64::total_cmp);
            all
        };
        let (line, map) = (all(|errors| &errors.line), all(|errors| &errors.map));
        let worst = |of: fn(&Errors) -> f64| runs.iter().map(|run| of(&run[hop])).fold(0.0, f64::max);
        let (p999, max) = (map[map.len() * 999 / 1000], map[map.len() - 1]);
        let (below_s, of_bound) = (worst(|errors| errors.below_1us_at_us) / 1e6, worst(|errors| errors.of_bound));
        let mut below: Vec<f64> = runs.iter().map(|run| run[hop].below_1us_at_us / 1e6).collect();
        below.sort_by(f64::total_cmp);
        let median_s = below[below.len() / 2];
        let (line_us, map_us) = (rms(&line), rms(&map));
        println!(
            "hop {}: line rms {line_us:.3} us; map rms {map_us:.3}, p99.9 {p999:.2}, max {max:.2}; < 1 us after {median_s:.2} s median, {below_s:.2} s worst; error over bound {of_bound:.2} worst",
            hop + 1
        );
        assert!(map_us <= 0.5 && p999 <= 1.5 && of_bound <= 1.0);
        assert!(below_s <= 1.0 && line_us <= map_us + 0.05);
    }
}

/// The root's own line, as one that is followed: its counter.
#[test]
fn a_root_follows_itself() {
    let line = TimeLine { at: LocalTicks::from_us(5), system: NetTime::from_us(5), rate: Rate::ZERO };
    let map = SlewedMap::new(line);
    assert_eq!(map.system_at(LocalTicks::from_us(1 << 50)), NetTime::from_us(1 << 50));
}

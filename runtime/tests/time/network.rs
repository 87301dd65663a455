//! Nodes with counters of their own on wires with latencies, in true time: who is followed, `[TIM-07]`, `[TIM-08]`, `[TIM-10]`, `[TIM-14]`.

use crate::common::{BYTES, TestNode, UART, ask, gateway, node, us};
use fixed_math::time::{LocalTicks, Span};
use osap_protocol::discovery::{Query, TimeLink, TimeSettings, TimeStatus, UniqueId};
use osap_protocol::header::Arrival;
use osap_runtime::SLOW_FACTOR;
use osap_runtime::clock::{AGE_MAX_US, DEFAULT_SETTINGS};

/// From one look at a wire's end to the next; more than any latency here, so that each node's time only goes on.
const STEP_US: u64 = 100;

/// A node and its counter.
pub(crate) struct Seat {
    pub(crate) node: TestNode,
    offset_us: u64,
    ppm: i64,
    gateways: u8,
}

/// Two ends of a wire, and how long it takes from the first to the second and back, µs.
pub(crate) struct Wire {
    pub(crate) ends: [(usize, u8); 2],
    pub(crate) latency_us: [u64; 2],
    pub(crate) is_whole: bool,
}

#[derive(Default)]
pub(crate) struct Network {
    pub(crate) seats: Vec<Seat>,
    pub(crate) wires: Vec<Wire>,
    pub(crate) at_us: u64,
}

impl Network {
    /// Nodes 1, 2, …, whose counters read so many µs at first and are so many ppm fast, wired in `pairs`.
    pub(crate) fn new(clocks: &[(u64, i64)], pairs: &[(usize, usize)]) -> Self {
        let mut net = Self::default();
        for (number, (offset_us, ppm)) in (1..).zip(clocks) {
            let node = node(number, &[UART; 4]);
            net.seats.push(Seat { node, offset_us: *offset_us, ppm: *ppm, gateways: 0 });
        }
        for (a, b) in pairs {
            let ends = [*a, *b].map(|at| {
                net.seats[at].gateways += 1;
                (at, net.seats[at].gateways - 1)
            });
            net.wires.push(Wire { ends, latency_us: [10, 10], is_whole: true });
        }
        net
    }

    /// What a node's counter reads `later_us` from now.
    fn local_in(&self, at: usize, later_us: u64) -> LocalTicks {
        let Seat { offset_us, ppm, .. } = self.seats[at];
        let true_steps = (self.at_us + later_us) << 8;
        let gained = i64::try_from(true_steps).unwrap() / 1_000_000 * ppm;
        us(offset_us) + Span::from_steps(true_steps.checked_add_signed(gained).unwrap())
    }

    pub(crate) fn local(&self, at: usize) -> LocalTicks {
        self.local_in(at, 0)
    }

    pub(crate) fn run_for(&mut self, span_us: u64) {
        let until = self.at_us + span_us;
        while self.at_us < until {
            for (wire, way) in (0..self.wires.len()).flat_map(|wire| [(wire, 0), (wire, 1)]) {
                self.carry(wire, way);
                self.at_us += STEP_US;
            }
            for at in 0..self.seats.len() {
                let now = self.local(at);
                self.seats[at].node.run(now);
            }
        }
    }

    fn carry(&mut self, wire: usize, way: usize) {
        let Wire { ends, latency_us, is_whole } = self.wires[wire];
        let ((from, out), (to, by)) = (ends[way], ends[1 - way]);
        let (left, arrived) = (self.local(from), self.local_in(to, latency_us[way]));
        let mut packet = [0; BYTES];
        if let Some(sent) = self.seats[from].node.transmit(gateway(out), left, &mut packet)
            && is_whole
        {
            let arrival = Arrival::Link(gateway(by));
            let _counted = self.seats[to].node.receive(arrival, &mut packet[..sent.len], arrived, arrived);
        }
    }

    /// System time of a node now, steps.
    pub(crate) fn system(&self, at: usize) -> i64 {
        self.seats[at].node.system_time(self.local(at)).at.steps().cast_signed()
    }

    /// How far node `at` is ahead of node `of`, µs, rounded to nearest.
    pub(crate) fn ahead_us(&self, at: usize, of: usize) -> i64 {
        (self.system(at) - self.system(of) + 128) >> 8
    }

    pub(crate) fn status(&mut self, at: usize) -> TimeStatus {
        let now = self.local(at);
        ask(&mut self.seats[at].node, Query::TimeStatus, &(), now).unwrap()
    }

    pub(crate) fn link(&mut self, at: usize, gateway: u8) -> TimeLink {
        let now = self.local(at);
        ask(&mut self.seats[at].node, Query::TimeLink, &gateway, now).unwrap()
    }

    pub(crate) fn set(&mut self, at: usize, change: impl FnOnce(&mut TimeSettings)) {
        let mut settings = self.seats[at].node.clock().settings();
        change(&mut settings);
        self.seats[at].node.clock_mut().set(settings).unwrap();
    }

    /// The number of the node that each follows, and how many steps away.
    fn roots(&self) -> Vec<(u8, u8)> {
        self.seats.iter().map(|seat| (seat.node.clock().root().unique_id.0[0], seat.node.clock().tier())).collect()
    }

    fn assert_within_bounds(&self, root: usize, of: &[usize]) {
        for at in of {
            let time = self.seats[*at].node.system_time(self.local(*at));
            assert!(time.is_settled, "node {at}");
            let apart = (self.system(*at) - self.system(root)).unsigned_abs();
            let bound = time.bound.unwrap().steps();
            // ticks of 1 µs, and 10 µs each way of which nothing is known: 11 µs a step at the least, and drift
            assert!(apart <= bound + 2 && bound < 40 << 8, "node {at} is off {apart}, bound {bound}");
        }
    }
}

/// `[TIM-07]`: the older time goes before, whatever the ids; within the margin the lower id, and the lower priority before all.
#[test]
fn the_root_is_the_lowest_priority_then_the_oldest_then_the_lowest_id() {
    // (offsets, priorities, root)
    for (offsets, priorities, root) in [
        ([500_000, 900_000], [128, 128], 2),
        ([900_000, 500_000], [128, 128], 1),
        ([500_000, 501_500], [128, 128], 2),
        ([500_000, 500_500], [128, 128], 1),
        ([500_500, 500_000], [128, 128], 1),
        ([900_000, 500_000], [128, 127], 2),
        ([500_000, 900_000], [127, 128], 1),
        ([900_000, 500_000], [255, 254], 2),
    ] {
        let mut net = Network::new(&[(offsets[0], 20), (offsets[1], -20)], &[(0, 1)]);
        for (at, priority) in priorities.into_iter().enumerate() {
            net.set(at, |it| it.priority = priority);
        }
        net.run_for(2_000_000);
        let follower = usize::from(root == 1);
        let mut expected = [(root, 0), (root, 0)];
        expected[follower].1 = 1;
        assert_eq!(net.roots(), expected, "{offsets:?} {priorities:?}");
        net.assert_within_bounds(1 - follower, &[follower]);
    }
}

/// `[TIM-07]`: two nodes that may not be root run free, without a bound; who follows takes over by a lower priority only.
#[test]
fn priorities_may_change() {
    let mut net = Network::new(&[(900_000, 0), (500_000, 0)], &[(0, 1)]);
    net.set(0, |it| it.priority = 255);
    net.set(1, |it| it.priority = 255);
    net.run_for(1_000_000);
    assert_eq!(net.roots().map_tiers(), [255, 255]);
    let time = net.seats[0].node.system_time(net.local(0));
    assert_eq!((time.bound, time.is_settled), (None, false));

    net.set(0, |it| it.priority = 128);
    net.run_for(1_000_000);
    assert_eq!(net.roots(), [(1, 0), (1, 1)]);
    // as low as the root's is not lower
    net.set(1, |it| it.priority = 128);
    net.run_for(1_000_000);
    assert_eq!(net.roots(), [(1, 0), (1, 1)]);
    net.set(1, |it| it.priority = 127);
    net.run_for(1_000_000);
    assert_eq!(net.roots(), [(2, 1), (2, 0)]);
    net.assert_within_bounds(1, &[0]);
}

trait Tiers {
    fn map_tiers(&self) -> Vec<u8>;
}

impl Tiers for Vec<(u8, u8)> {
    fn map_tiers(&self) -> Vec<u8> {
        self.iter().map(|(_, tier)| *tier).collect()
    }
}

/// `[TIM-08]`: both ways to the root of a diamond are sources and its time is within both bounds; who is as far as oneself is none.
#[test]
fn equal_ways_are_averaged() {
    let mut net = Network::new(&[(900_000, 0), (0, 30), (0, -30), (0, 5)], &[(0, 1), (0, 2), (1, 3), (2, 3), (1, 2)]);
    // one way is 8 µs longer there, the other 8 µs longer back: the mean of both is right
    net.wires[2].latency_us = [18, 10];
    net.wires[3].latency_us = [10, 18];
    net.run_for(3_000_000);
    assert_eq!(net.roots(), [(1, 0), (1, 1), (1, 1), (1, 2)]);
    assert_eq!(net.status(3).sources, 0b11);
    for at in [1, 2] {
        assert_eq!(net.status(at).sources, 0b1, "their equals at gateway 2 are no sources");
    }
    net.assert_within_bounds(0, &[1, 2, 3]);
    // either alone would be 4 µs off, as below
    assert!(net.ahead_us(3, 0).abs() <= 1, "{}", net.ahead_us(3, 0));
    net.wires[3].is_whole = false;
    net.run_for(5_000_000);
    assert_eq!(net.status(3).sources, 0b1);
    assert!((3..=5).contains(&net.ahead_us(3, 0).abs()), "{}", net.ahead_us(3, 0));
}

/// `[TIM-08]`, `[TIM-10]`: the root of a ring vanishes; within the age limit and some intervals there is one root, and at no time a step.
#[test]
fn a_ring_whose_root_vanishes_finds_another() {
    let mut net = Network::new(&[(900_000, 40), (0, -40), (0, 10), (0, 0)], &[(0, 1), (1, 2), (2, 3), (3, 1)]);
    net.run_for(2_000_000);
    assert_eq!(net.roots(), [(1, 0), (1, 1), (1, 2), (1, 2)]);
    (1..4).for_each(|at| net.seats[at].node.clock_mut().set_live(true));
    net.wires[0].is_whole = false;
    let mut last: Vec<i64> = (1..4).map(|at| net.system(at)).collect();
    let vanished = net.at_us;
    while net.at_us < vanished + AGE_MAX_US + 10 * u64::from(DEFAULT_SETTINGS.interval_us) {
        let before = net.at_us;
        net.run_for(1_000);
        let passed = i64::try_from(net.at_us - before).unwrap() << 8;
        for at in 1..4 {
            let gained = net.system(at) - last[at - 1];
            // the slew's 500 ppm and the crystals' 80; and two steps where pieces of the map meet
            let most = passed * 580 / 1_000_000 + 2;
            assert!((gained - passed).abs() <= most, "node {at} went {gained} steps in {passed}");
            last[at - 1] += gained;
        }
    }
    let roots = net.roots();
    assert!(roots[1].0 != 1 && roots[1..].iter().all(|(root, _)| *root == roots[1].0), "{roots:?}");
    let root = usize::from(roots[1].0) - 1;
    net.assert_within_bounds(root, &[1, 2, 3]);
    assert_eq!(net.status(1).root_changes, if root == 1 { 2 } else { net.status(1).root_changes });
}

/// `[TIM-10]`: a node that loses its root goes on from where it is, at the rate it had: as if the root were still there.
#[test]
fn who_loses_its_root_goes_on_at_its_rate() {
    let mut net = Network::new(&[(900_000, 40), (0, -40)], &[(0, 1)]);
    net.run_for(5_000_000);
    assert_eq!(net.roots(), [(1, 0), (1, 1)]);
    let before = net.ahead_us(1, 0);
    net.wires[0].is_whole = false;
    net.run_for(20_000_000);
    assert_eq!(net.roots(), [(1, 0), (2, 0)]);
    // 80 ppm would be 1600 µs; after 5 s a rate is known to 0.1 ppm, which makes 2 µs
    assert!((net.ahead_us(1, 0) - before).abs() <= 3, "{} {before}", net.ahead_us(1, 0));
    assert!(net.status(1).is_settled);
    assert_eq!(net.status(1).steps, 1, "the first one, at joining");
}

/// `[TIM-08]`: ages add up along the way, and when the news are too old everywhere, there is another root.
#[test]
fn ages_add_up() {
    let mut net = Network::new(&[(900_000, 0), (0, 0), (0, 0)], &[(0, 1), (1, 2)]);
    net.run_for(2_000_000);
    assert_eq!(net.roots(), [(1, 0), (1, 1), (1, 2)]);
    net.wires[0].is_whole = false;
    net.run_for(500_000);
    for at in [1, 2] {
        // its last news are up to an interval and an eighth older than the cut
        let age_us = net.status(at).age_us;
        assert!((500_000..560_000).contains(&age_us), "node {at}: {age_us} µs");
    }
    net.run_for(AGE_MAX_US - 550_000);
    assert_eq!(net.roots(), [(1, 0), (1, 1), (1, 2)], "not before");
    net.run_for(100_000 + u64::from(DEFAULT_SETTINGS.interval_us * SLOW_FACTOR) * 5 / 4);
    assert_eq!(net.roots(), [(1, 0), (2, 0), (2, 1)]);
}

/// `[TIM-14]`: an offer spreads by the fewest steps, follows updates, and is forgotten where system time is set anew.
#[test]
fn unix_time_spreads() {
    let mut net = Network::new(&[(900_000, 0), (0, 20), (0, 0)], &[(0, 1), (1, 2)]);
    net.run_for(2_000_000);
    let unix_us = 1_790_000_000_000_000;
    for offer_us in [unix_us, unix_us + 5_000_000] {
        let now = net.local(2);
        net.seats[2].node.clock_mut().offer_unix(offer_us, now);
        let expected = offer_us - (net.system(2) >> 8);
        net.run_for(1_000_000);
        for at in 0..3 {
            let offset = net.status(at).unix_offset_us.unwrap();
            assert!((offset - expected).abs() <= 1, "node {at}: {offset} {expected}");
        }
    }
    // another root, 100 s older: all are set anew
    net.wires[0].is_whole = false;
    net.wires[1].is_whole = false;
    net.seats[2].offset_us += 100_000_000;
    net.seats[2].node = node(3, &[UART; 4]);
    net.run_for(4_000_000);
    net.wires[1].is_whole = true;
    net.run_for(2_000_000);
    assert_eq!(net.roots()[1..], [(3, 1), (3, 0)]);
    assert_eq!(net.status(1).unix_offset_us, None);
    assert_eq!(net.status(0).root, UniqueId([1; 12]));
    assert!(net.status(0).unix_offset_us.is_some());
}

/// `[TIM-14]`: of two hosts' offers each node takes that of the nearer one.
#[test]
fn the_nearer_hosts_unix_time_is_taken() {
    let mut net = Network::new(&[(900_000, 0), (0, 0), (0, 0), (0, 0)], &[(0, 1), (1, 2), (2, 3)]);
    net.run_for(2_000_000);
    for (at, unix_us) in [(0, 1_790_000_000_000_000), (3, 1_790_000_100_000_000)] {
        let now = net.local(at);
        net.seats[at].node.clock_mut().offer_unix(unix_us, now);
    }
    net.run_for(3_000_000);
    let offsets: Vec<i64> = (0..4).map(|at| net.status(at).unix_offset_us.unwrap()).collect();
    assert_eq!(offsets[0], offsets[1]);
    assert_eq!(offsets[2], offsets[3]);
    assert_eq!((offsets[2] - offsets[1] + 500_000) / 1_000_000, 100);
}

/// `[TIM-13]`: what is longer there than back moves the estimate by half of that, unless it is calibrated, which all links of the type
/// keep; `[TIM-12]` tells it.
#[test]
fn asymmetry_is_calibrated() {
    use osap_protocol::discovery::TimeAsymmetry;
    let mut net = Network::new(&[(900_000, 0), (0, 0)], &[(0, 1)]);
    net.wires[0].latency_us = [10, 70]; // to the follower, and back
    net.run_for(3_000_000);
    // the follower's way there is the 70
    assert!((net.ahead_us(1, 0) + 30).abs() <= 1 || (net.ahead_us(1, 0) - 30).abs() <= 1, "{}", net.ahead_us(1, 0));
    let calibration = |type_name: &str, asymmetry_steps| TimeAsymmetry {
        type_name: heapless::String::try_from(type_name).unwrap(),
        asymmetry_steps,
    };
    let now = net.local(1);
    let node = &mut net.seats[1].node;
    assert_eq!(ask::<_, ()>(node, Query::SetTimeAsymmetry, &calibration("can", 1), now), Err(4), "no such link");
    ask::<_, ()>(node, Query::SetTimeAsymmetry, &calibration("uart", 60 << 8), now).unwrap();
    net.run_for(3_000_000);
    assert!(net.ahead_us(1, 0).abs() <= 1, "{}", net.ahead_us(1, 0));
    for gateway in 0..4 {
        assert_eq!(net.link(1, gateway).asymmetry_steps, 60 << 8);
    }
}

/// `[TIM-08]`, `[TIM-17]`: a link that closes and opens again with the same device of the same boot behind it has kept its estimate.
#[test]
fn a_link_that_returns_is_still_known() {
    let mut net = Network::new(&[(900_000, 40), (0, -40)], &[(0, 1)]);
    net.run_for(2_000_000);
    let before = net.link(1, 0);
    assert!(before.exchanges > 64);
    assert!((79_900..80_100).contains(&before.rate_ppb), "{}", before.rate_ppb);
    for open in [false, true] {
        let now = net.local(1);
        net.seats[1].node.set_open(gateway(0), open, now);
        net.run_for(100_000);
    }
    net.run_for(500_000);
    let after = net.link(1, 0);
    assert!(after.exchanges > before.exchanges, "{} {}", after.exchanges, before.exchanges);
    assert_eq!(net.roots(), [(1, 0), (1, 1)]);
    assert_eq!(net.status(1).steps, 1);
}

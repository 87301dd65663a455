//! What clocks are measured with: boots spread in time, stamps, links that are longer one way, and networks to do it in.

mod common;

use common::{Probe, add_probe, assert_all_slots_home, gateway, over, probe, us, with_probe};
use firmware_app::kind;
use fixed_math::time::LocalTicks;
use osap_protocol::header::SYSTEM_HEADER_BYTES;
use osap_protocol::time::{TimeReply, TimeRequest, unwrap_stamp};
use osap_runtime::BURST;
use osap_sim::device::{SimDevice, sim_device};
use osap_sim::machines::clocks::{self, ClockTree, ClockWorld, PICO_125_MHZ};
use osap_sim::machines::{UART, unique_id};
use osap_sim::processor::Processor;
use osap_sim::time::{ClockModel, TrueTime};
use osap_sim::world::{Departure, LinkModel, NodeId, StampModel, World};
use std::sync::{Arc, Mutex};

/// What passed over a cable: when its first byte left, from which end, and the packet.
type Seen = Arc<Mutex<Vec<(TrueTime, usize, Vec<u8>)>>>;

/// Two probes on a cable, of which the second has `clock` and `stamps`, after their first announcements.
fn pair(seed: u64, clock: ClockModel, stamps: StampModel, model: LinkModel) -> (World, [NodeId; 2], Seen) {
    let mut world = World::new(seed);
    let first = add_probe(&mut world, &[UART]);
    let second = world.add_node(Probe::numbered(1, &[UART]), Processor::INSTANT, clock);
    world.set_stamps(second, stamps);
    let link = world.connect((first, gateway(0)), (second, gateway(0)), model);
    let packets = Seen::default();
    let tapped = Arc::clone(&packets);
    world.tap_link(
        link,
        Box::new(move |event| tapped.lock().unwrap().push((event.at, event.way, event.packet.to_vec()))),
    );
    world.run_for(us(10_000));
    (world, [first, second], packets)
}

/// Sends 20 bytes from one to the other; tells when their first byte left, for nodes ask each other for the time as well.
fn send(world: &mut World, from: NodeId, seen: &Seen) -> TrueTime {
    with_probe(world, from, |it, now| it.datagram(&over(&[0], 1, 20_000), &[7; 20], now).unwrap());
    world.run_for(us(1_003));
    let seen = seen.lock().unwrap();
    seen.iter().rev().find(|(_, _, packet)| packet.ends_with(&[7; 20])).unwrap().0
}

/// `[FRM-07]`: without delays a stamp is what the counter reads at the first byte, in whole ticks of its timer.
#[test]
fn a_stamp_is_the_counters_reading_at_the_first_byte() {
    let clock = ClockModel { tick: us(1), offset_us: 77, ..ClockModel::off_by(40.0) };
    let (mut world, [first, second], seen) = pair(1, clock, StampModel::EXACT, LinkModel::WIRE);
    let mut between_ticks = 0;
    for n in 0..50 {
        let left = send(&mut world, first, &seen);
        let (started, handed_over) = probe(&world, second).stamps[n];
        assert_eq!(started, world.local(second, left));
        assert_eq!(started.steps() % 256, 0);
        let exact = world.exact(second, left);
        assert!(exact.since(started) < us(1) && started <= exact);
        between_ticks += usize::from(exact != started);
        assert!(handed_over > started);
        assert!(world.truth(second, started) <= left);
    }
    assert!(between_ticks > 40, "a clock that is off meets all phases of its ticks");
}

/// Delayed stamps are late, never early, and no later than the hand-over; how often and by how much is tested beside the model.
#[test]
fn delayed_stamps_are_late_and_seeded() {
    let stamps = StampModel { delayed_part: 0.5, delay_mean: us(40), ..StampModel::EXACT };
    let run = |seed| {
        let (mut world, [first, second], seen) = pair(seed, ClockModel::PERFECT, stamps, LinkModel::WIRE);
        let late: Vec<u64> = (0..200)
            .map(|n| {
                let left = LocalTicks::from_steps(send(&mut world, first, &seen).steps());
                let (started, handed_over) = probe(&world, second).stamps[n];
                assert!((left..=handed_over).contains(&started));
                started.since(left).steps()
            })
            .collect();
        assert_eq!(probe(&world, first).stamps.len(), 0);
        late
    };
    let late = run(1);
    let delayed = late.iter().filter(|steps| **steps > 0).count();
    assert!(
        (65..=135).contains(&delayed),
        "{delayed}: 200 draws of one half are within five standard deviations, 35, of 100"
    );
    assert_eq!(late, run(1));
    assert_ne!(late, run(2));
}

/// Departures of the second node's time messages: when their first byte left, and the stamp that they carry.
fn departures(stamps: StampModel) -> Vec<(LocalTicks, LocalTicks)> {
    let clock = ClockModel { tick: us(1), ..ClockModel::PERFECT };
    let (mut world, _, seen) = pair(9, clock, stamps, LinkModel::WIRE);
    world.run_for(us(2_000_000));
    let seen = seen.lock().unwrap();
    let from_second = seen.iter().filter(|(_, way, _)| *way == 1);
    from_second
        .filter_map(|(left, _, packet)| {
            let left = LocalTicks::from_steps(left.steps());
            let payload = packet.get(SYSTEM_HEADER_BYTES + 1..)?;
            let slot = TimeRequest::decode(payload).map(|(_, slot)| slot);
            let slot = slot.or_else(|_| TimeReply::decode(payload).map(|reply| reply.answered_slot)).ok()?;
            // a late stamp may be after the departure
            Some((left, unwrap_stamp(slot, left + us(10_000))))
        })
        .collect()
}

/// `[TIM-03]`: what a time message says of its departure is the counter's reading there. Where it is delayed, the first byte leaves
/// after its stamp or the stamp is read after the byte left, as the model has it; never otherwise.
#[test]
fn time_messages_carry_their_departure() {
    let exact = departures(StampModel::EXACT);
    assert!(exact.len() >= 2 * usize::from(BURST), "{} messages: at joining, each asks so often", exact.len());
    for (left, stamp) in &exact {
        assert_eq!(stamp.steps(), left.steps() / 256 * 256);
    }
    let half = StampModel { delayed_part: 0.5, delay_mean: us(20), departure: Departure::StampedBefore };
    for departure in [Departure::StampedBefore, Departure::StampedAfter] {
        let late = departures(StampModel { departure, ..half });
        let is_before = departure == Departure::StampedBefore;
        let by = |(left, stamp): &(LocalTicks, LocalTicks)| {
            if is_before { left.steps_after(*stamp) } else { stamp.steps_after(*left) }
        };
        // but for the tick, which rounds down
        assert!(late.iter().map(by).all(|steps| steps > -256), "{departure:?}");
        let delayed = late.iter().filter(|it| by(it) >= 256).count();
        assert!(delayed * 10 > late.len() * 3 && delayed * 10 < late.len() * 7, "{delayed} of {}", late.len());
    }
}

/// A link that takes 30 µs longer one way than back delays what goes that way by so much, and nothing else.
#[test]
fn a_link_can_be_longer_one_way() {
    let model = LinkModel { latency: us(5), extra: [us(30), us(2)], ..LinkModel::WIRE };
    let (mut world, [first, second], seen) = pair(1, ClockModel::PERFECT, StampModel::EXACT, model);
    for (from, to, latency_us) in [(first, second, 35), (second, first, 7)] {
        let left = send(&mut world, from, &seen);
        assert_eq!(probe(&world, to).stamps[0].0.as_us(), left.as_us() + latency_us);
    }
}

/// Before its boot a device reads nothing, says nothing and hears nothing; after it all is as for any other.
#[test]
fn a_device_may_boot_later() {
    let mut world = World::new(1);
    let host = add_probe(&mut world, &[UART]);
    let boots = TrueTime::from_us(300_000);
    let factory = Box::new(|boot: osap_sim::world::Boot<'_>| -> Box<dyn osap_sim::endpoint::Endpoint> {
        sim_device(&kind::MOTOR, unique_id(5), boot.epoch, "late", &[UART])
    });
    let late =
        world.add_device_at(boots, factory, PICO_125_MHZ, ClockModel { offset_us: 9, ..ClockModel::off_by(50.0) });
    let link = world.connect((host, gateway(0)), (late, gateway(0)), LinkModel::WIRE);
    world.run_until(TrueTime::from_us(299_999));
    assert_eq!(world.local_now(late).as_us(), 9);
    let [to_late, from_late] = world.link_stats(link);
    assert!(to_late.frames > 0, "the host announces itself");
    assert_eq!((to_late.lost, from_late.frames), (to_late.frames, 0));
    assert!(probe(&world, host).node.gateway(gateway(0)).unwrap().neighbour().is_none());

    world.run_until(TrueTime::from_us(400_000));
    assert_eq!(world.booted(late), boots);
    assert_eq!(world.local_now(late).as_us(), 9 + 100_000 + 5); // 50 ppm of 100 ms are 5 µs
    let neighbour = probe(&world, host).node.gateway(gateway(0)).unwrap().neighbour().unwrap();
    assert_eq!((neighbour.unique_id, neighbour.boot_epoch), (unique_id(5), 1));
    assert!(world.reset(late));
    assert_eq!(world.local_now(late), LocalTicks::ZERO);
    world.run_for(us(20_000));
    assert_all_slots_home(&world);
}

/// Every link leads where the tree says it leads: the neighbours know each other.
fn assert_whole(world: &World, tree: &ClockTree) {
    assert_eq!(tree.links.len() + 1, tree.nodes.len());
    for (below, parent) in (1..).zip(&tree.parents) {
        let node = world.endpoint::<SimDevice>(tree.nodes[below]).unwrap().node();
        let up = node.gateway(gateway(0)).unwrap().neighbour().unwrap();
        assert_eq!(up.unique_id, unique_id(tree.nodes[*parent].at()));
        assert_eq!(tree.hops[below], tree.hops[*parent] + 1);
    }
}

/// A hundred nodes with three below each hub: levels of 1, 3, 9, 27 and the last 60.
#[test]
fn a_tree_fills_its_levels() {
    let mut world = World::new(1);
    let tree = clocks::tree(&mut world, 100, 3, &ClockWorld::FIGURES);
    world.run_for(us(700_000));
    assert_whole(&world, &tree);
    let level = |hops: usize| tree.hops.iter().filter(|it| **it == hops).count();
    assert_eq!([0, 1, 2, 3, 4, 5].map(level), [1, 3, 9, 27, 60, 0]);
    assert_eq!(tree.path(99).collect::<Vec<_>>(), [99, 32, 10, 3, 0]);
}

/// A line is a tree without branches. Its nodes' clocks are all off, differently, within the crystals' 50 ppm and the ramp's 2; they boot
/// within 50 ms, the first one first.
#[test]
fn a_lines_clocks_differ_within_their_bounds() {
    let mut world = World::new(3);
    let line = clocks::line(&mut world, 20, &ClockWorld::FIGURES);
    assert_eq!(line.hops, (0..=20).collect::<Vec<_>>());
    let boots: Vec<u64> = line.nodes.iter().map(|node| world.booted(*node).as_us()).collect();
    assert!(
        boots[0] == 0 && boots.iter().all(|us| *us <= 50_000) && boots[1..].iter().min() != boots[1..].iter().max()
    );
    assert_eq!(line.joined(&world, 20).as_us(), *boots.iter().max().unwrap());
    assert_eq!(line.joined(&world, 0), TrueTime::ZERO);
    world.run_for(us(1_050_000));
    assert_whole(&world, &line);
    let [from, to] = [50_000, 1_050_000].map(TrueTime::from_us);
    let gained = |node: &NodeId| world.exact(*node, to).steps_after(world.exact(*node, from)) - (1_000_000 << 8);
    let gained: Vec<i64> = line.nodes.iter().map(gained).collect();
    assert!(gained.iter().all(|steps| steps.abs() <= 52 << 8), "{gained:?}");
    // 21 draws from 100 ppm: all within a half of it with a chance of 22 · 2^−21
    assert!(gained.iter().max().unwrap() - gained.iter().min().unwrap() > 50 << 8, "{gained:?}");
}

/// Without a spread of its jobs a node's departures lie at fixed places between its timer's ticks; with one of a tick, anywhere.
#[test]
fn a_spread_of_jobs_frees_departures_from_the_ticks() {
    let places = |job_spread| {
        let mut world = World::new(2);
        let model = ClockWorld { job_spread, stamps: StampModel::EXACT, boots_within: us(0), ..ClockWorld::FIGURES };
        let line = clocks::line(&mut world, 1, &model);
        let seen = Arc::new(Mutex::new(Vec::new()));
        let tapped = Arc::clone(&seen);
        world.tap_link(
            line.links[0],
            Box::new(move |event| {
                let is_request =
                    event.packet.get(SYSTEM_HEADER_BYTES + 1..).is_some_and(|it| TimeRequest::decode(it).is_ok());
                if event.way == 0 && is_request {
                    tapped.lock().unwrap().push(event.at);
                }
            }),
        );
        world.run_for(us(300_000));
        let seen = seen.lock().unwrap();
        // how many lie in each quarter of a tick
        let mut quarters = [0; 4];
        for at in seen.iter() {
            quarters[usize::try_from(world.exact(line.nodes[0], *at).steps() % 256 / 64).unwrap()] += 1;
        }
        quarters
    };
    let most = |quarters: [usize; 4]| (quarters.into_iter().max().unwrap(), quarters.into_iter().sum::<usize>());
    let spread = places(us(1));
    // of some 60 that may lie anywhere, half in one quarter has a chance of 1 in 10^4
    let (largest, all) = most(spread);
    assert!(spread.iter().all(|count| *count > 0) && 2 * largest < all, "{spread:?}");
    // but for those that waited for another frame on the wire, whose ends lie anywhere
    let (largest, all) = most(places(us(0)));
    assert!(3 * largest > 2 * all, "{largest} of {all}");
}

//! Faulty buses: everybody hears, each decides for itself, nothing wrong is delivered, and everything that is not delivered is counted.

mod common;

use common::{Probe, add_probe, assert_all_slots_home, gateway, port, probe, query, timeless, us, with_probe};
use firmware_app::kind;
use fixed_math::time::LocalTicks;
use osap_protocol::discovery::Query;
use osap_protocol::framing::{Check, FrameError, decode, encode_parts};
use osap_protocol::{BusDrop, DropCause, Instruction, Packet, RouteBuf, Step};
use osap_runtime::GatewayConfig;
use osap_runtime::sequenced::Destination;
use osap_sim::faults::{FaultConfig, FaultLayer};
use osap_sim::machines::shapes::bus_gateway;
use osap_sim::machines::{RP2040_200_MHZ, add_device};
use osap_sim::processor::Processor;
use osap_sim::time::{ClockModel, TrueTime};
use osap_sim::world::{BusId, BusModel, NodeId, World};
use std::sync::{Arc, Mutex};

/// The first bus's random numbers.
const BUS_STREAM: u64 = 1 << 40;
const MEMBERS: u8 = 5;

/// A packet as a tap saw it.
#[derive(Clone)]
struct Spoken {
    at: TrueTime,
    from: NodeId,
    packet: Vec<u8>,
}

/// Probes on one bus, their drops from zero, and what they said on it.
struct Cell {
    world: World,
    nodes: Vec<NodeId>,
    bus: BusId,
    spoken: Arc<Mutex<Vec<Spoken>>>,
}

fn model(faults: &str) -> BusModel {
    BusModel { faults: Some(faults.parse().unwrap()), ..BusModel::default() }
}

fn cell(seed: u64, check: Check, model: BusModel) -> Cell {
    let mut world = World::new(seed);
    let nodes: Vec<NodeId> = (0..MEMBERS)
        .map(|drop| add_probe(&mut world, &[GatewayConfig { check, ..timeless(bus_gateway(drop)) }]))
        .collect();
    let members: Vec<_> = nodes.iter().map(|node| (*node, gateway(0))).collect();
    let bus = world.bus(&members, model);
    let spoken = Arc::new(Mutex::new(Vec::new()));
    let tapped = Arc::clone(&spoken);
    world.tap_bus(
        bus,
        Box::new(move |event| {
            let packet = event.packet.to_vec();
            tapped.lock().unwrap().push(Spoken { at: event.at, from: event.from, packet });
        }),
    );
    Cell { world, nodes, bus, spoken }
}

impl Cell {
    /// Each in turn sends numbered datagrams to `to(number)`, one each 2 ms; then all is let come home.
    fn send_numbered(&mut self, count: u32, to: impl Fn(u32) -> BusDrop) {
        for number in 0..count {
            let from = self.nodes[number as usize % self.nodes.len()];
            let destination = over_bus(to(number), 1, 60_000);
            with_probe(&mut self.world, from, |it, now| {
                // where the hold is full the node counts it
                let _counted = it.datagram(&destination, &numbered(number), now);
            });
            self.world.run_for(us(2_000));
        }
        self.world.run_for(us(200_000));
        assert_eq!(self.spoken().len() as u64, self.world.bus_stats(self.bus).frames, "the tap sees every packet");
        assert_all_slots_home(&self.world);
    }

    fn spoken(&self) -> Vec<Spoken> {
        self.spoken.lock().unwrap().clone()
    }

    /// Numbers of the datagrams that a member received, in order.
    fn numbers(&self, drop: usize) -> Vec<u32> {
        numbers(probe(&self.world, self.nodes[drop]))
    }

    fn dropped(&self, drop: usize, cause: DropCause) -> u32 {
        probe(&self.world, self.nodes[drop]).node.counters().of(cause)
    }

    fn received(&self, drop: usize) -> u64 {
        u64::from(probe(&self.world, self.nodes[drop]).node.gateway(gateway(0)).unwrap().info().received)
    }
}

fn numbered(number: u32) -> Vec<u8> {
    (0..8u32).flat_map(|n| (number.wrapping_mul(0x9e37_79b9) ^ n).to_le_bytes()).chain(number.to_le_bytes()).collect()
}

/// The numbers a probe received; each payload is as it was sent.
fn numbers(probe: &Probe) -> Vec<u32> {
    let number = |payload: &Vec<u8>| {
        let number = u32::from_le_bytes(*payload.last_chunk().unwrap());
        assert_eq!(*payload, numbered(number));
        number
    };
    probe.datagrams.iter().map(|(_, payload)| number(payload)).collect()
}

fn over_bus(drop: BusDrop, port_index: u16, ttl_us: u16) -> Destination {
    let mut route = RouteBuf::new();
    route.push(Step::Bus { gateway: gateway(0), drop }).unwrap();
    Destination { route, mtu_bytes: 256, ttl_us, port: port(port_index) }
}

/// Somebody else than the sender of a number.
fn another(number: u32) -> BusDrop {
    let members = u32::from(MEMBERS);
    BusDrop(u8::try_from((number + 1 + number / members % (members - 1)) % members).unwrap())
}

/// `[FRM-10]`: a frame for another drop is heard, and is neither delivered nor a drop; it takes no room in the ring and no time of the
/// processor, busy as that is.
#[test]
fn a_frame_for_another_drop_is_passed_over() {
    let mut world = World::new(1);
    let nodes: Vec<NodeId> = [1, 2].map(|drop| add_probe(&mut world, &[timeless(bus_gateway(drop))])).to_vec();
    let slow = Processor { receive: us(20_000), ..RP2040_200_MHZ };
    let third = add_device(&mut world, &kind::MOTOR, "slow", vec![timeless(bus_gateway(3))], slow, ClockModel::PERFECT);
    let bus = world.bus(&[nodes[0], nodes[1], third].map(|node| (node, gateway(0))), BusModel::default());
    world.run_for(us(200_000));
    let before = world.bus_stats(bus);
    world.record_walk(true);
    for number in 0..14 {
        let to = over_bus(BusDrop(2), 1, 60_000);
        with_probe(&mut world, nodes[0], |it, now| it.datagram(&to, &numbered(number), now).unwrap());
    }
    world.run_for(us(100_000));
    assert_eq!(numbers(probe(&world, nodes[1])).len(), 14);
    let after = world.bus_stats(bus);
    assert_eq!((after.passed_over - before.passed_over, after.taken - before.taken), (14, 14));
    assert_eq!((world.stats().overruns, world.stats().frame_errors, world.stats().lost), (0, 0, 0));
    let device = world.endpoint::<osap_sim::device::SimDevice>(third).unwrap().node();
    assert_eq!(device.counters().total(), 0);
    assert!(world.walk().iter().all(|event| event.node != third));
    assert_all_slots_home(&world);
}

/// `[LNK-07]`: of every frame that was spoken it is known whether the layer lost it, and what each listener made of it.
#[test]
fn losses_add_up() {
    let mut it = cell(3, Check::Crc32, model("loss=0.1,seed=5"));
    it.send_numbered(1_000, another);
    let (stats, faults) = (it.world.bus_stats(it.bus), it.world.bus_faults(it.bus).unwrap());
    assert!(faults.lost > 70, "{faults:?}");
    assert_eq!(faults.offered, stats.frames);
    assert_eq!(stats.arrived, stats.frames - faults.lost);
    assert_eq!(stats.arrived * u64::from(MEMBERS - 1), stats.taken + stats.passed_over);
    assert_eq!((stats.damaged, stats.missed, stats.lost), (0, 0, 0));
    let all: u64 = (0..5).map(|drop| it.received(drop)).sum();
    assert_eq!(all, stats.taken, "what was taken reached the nodes");
    let mut arrived = 0;
    for drop in 0..MEMBERS {
        let numbers = it.numbers(usize::from(drop));
        assert!(numbers.is_sorted_by(|a, b| a < b));
        assert!(numbers.iter().all(|number| another(*number) == BusDrop(drop)));
        assert_eq!(probe(&it.world, it.nodes[usize::from(drop)]).node.counters().total(), 0);
        arrived += numbers.len() as u64;
    }
    let datagrams = it.spoken().iter().filter(|spoken| is_datagram(&spoken.packet)).count() as u64;
    let announced_lost = faults.lost - (datagrams - arrived);
    assert!(datagrams == 1_000 && announced_lost <= stats.frames - datagrams, "{announced_lost} {stats:?}");
}

fn is_datagram(packet: &[u8]) -> bool {
    packet.len() == 9 + 2 + numbered(0).len()
}

/// What one listener is to make of what came out of a fault layer: whole frames for it, those for others, and what is damaged.
#[derive(Debug, Default, PartialEq, Eq)]
struct Expected {
    taken: u64,
    passed_over: u64,
    malformed: u32,
    check: u32,
    short: u32,
    numbers: Vec<u32>,
}

/// A stream of bytes, cut at its zeros, each piece decoded by itself; what follows the last zero is still under way.
fn listen(stream: &[u8], own: u8) -> Expected {
    let mut it = Expected::default();
    let end = stream.iter().rposition(|byte| *byte == 0).unwrap();
    for piece in stream[..end].split(|byte| *byte == 0).filter(|piece| !piece.is_empty()) {
        let mut frame = [0; 4096];
        match decode(piece, Check::Crc32, &mut frame) {
            Ok(len) if [own, 255].contains(&frame[0]) => {
                it.taken += 1;
                if is_datagram(&frame[2..len]) {
                    it.numbers.push(u32::from_le_bytes(*frame[..len].last_chunk().unwrap()));
                }
            }
            Ok(_) => it.passed_over += 1,
            Err(FrameError::Malformed) => it.malformed += 1,
            Err(FrameError::Check { .. }) => it.check += 1,
            Err(FrameError::TooShort { .. }) => it.short += 1,
            Err(error) => panic!("{error}"),
        }
    }
    it
}

/// `[FRM-07]`, `[FRM-10]`, `[LNK-07]`: with flipped bits, what each listener takes, passes over and counts is what an independent model
/// makes of the same faulty bytes. A damaged frame is counted by all who heard it, and by nobody else.
#[test]
fn bit_errors_are_caught_and_counted_by_each_who_heard_them() {
    let faults = "ber=0.0003,seed=11";
    let mut it = cell(0, Check::Crc32, model(faults));
    it.send_numbered(1_000, |number| if number % 10 == 9 { BusDrop::BROADCAST } else { another(number) });
    let mut layer = FaultLayer::new(faults.parse::<FaultConfig>().unwrap().for_stream(BUS_STREAM));
    let mut streams = vec![Vec::new(); usize::from(MEMBERS)];
    for Spoken { from, packet, .. } in it.spoken() {
        let Instruction::Bus { drop, .. } = Packet::check(&packet[..]).unwrap().instruction() else { panic!("no bus") };
        let from = it.nodes.iter().position(|node| *node == from).unwrap();
        let mut frame = [0; 512];
        let addresses = [drop.0, u8::try_from(from).unwrap()];
        let len = encode_parts(&[&addresses, &packet], Check::Crc32, &mut frame).unwrap();
        layer.offer(LocalTicks::ZERO, &frame[..len]);
        let bytes = layer.poll(LocalTicks::MAX).unwrap();
        for (listener, stream) in streams.iter_mut().enumerate() {
            stream.extend_from_slice(if listener == from { &[] } else { &bytes });
        }
    }
    let stats = it.world.bus_stats(it.bus);
    assert_eq!(it.world.bus_faults(it.bus).unwrap().bits_flipped, layer.counts().bits_flipped);
    let mut all = [0; 3];
    for (drop, stream) in streams.iter().enumerate() {
        let found = Expected {
            taken: it.received(drop),
            malformed: it.dropped(drop, DropCause::FrameMalformed),
            check: it.dropped(drop, DropCause::FrameCheck),
            short: it.dropped(drop, DropCause::FrameTooShort),
            numbers: it.numbers(drop),
            ..Expected::default()
        };
        let expected = listen(stream, u8::try_from(drop).unwrap());
        let damaged = expected.malformed + expected.check + expected.short;
        all = [all[0] + expected.taken, all[1] + expected.passed_over, all[2] + u64::from(damaged)];
        assert_eq!(probe(&it.world, it.nodes[drop]).node.counters().total(), u64::from(damaged), "no other drop");
        assert_eq!(found, Expected { passed_over: 0, ..expected }, "drop {drop}");
    }
    assert_eq!([stats.taken, stats.passed_over, stats.damaged], all);
    assert!(stats.damaged > 400 && stats.passed_over > 1_500, "{stats:?}");
    assert_eq!((stats.missed, stats.lost), (0, 0));
}

/// Why the check covers the addresses, `[FRM-10]`: without one, a flipped bit delivers to somebody else.
#[test]
fn without_a_check_a_flipped_address_misleads() {
    let mut it = cell(1, Check::None, model("ber=0.001,seed=3"));
    for _ in 0..2_000 {
        with_probe(&mut it.world, it.nodes[0], |probe, now| {
            probe.datagram(&over_bus(BusDrop(1), 1, 60_000), &[1; 4], now).unwrap();
        });
        it.world.run_for(us(1_000));
    }
    it.world.run_for(us(200_000));
    let misled: usize = [2, 3, 4].map(|drop| probe(&it.world, it.nodes[drop]).datagrams.len()).iter().sum();
    assert!(misled > 0);
    assert!(it.world.bus_stats(it.bus).lost > 0, "and some went to drops that nobody has");
    assert_all_slots_home(&it.world);
}

/// `[TRN-05]`: what is lost or damaged is asked again until it is answered.
#[test]
fn requests_over_a_faulty_bus_are_tried_again_and_answered() {
    let mut world = World::new(7);
    let with_check = |drop| GatewayConfig { check: Check::Crc32, ..bus_gateway(drop) };
    let host = add_probe(&mut world, &[with_check(0)]);
    let mut members = vec![(host, gateway(0))];
    for drop in 1..=6 {
        let name = format!("m{drop}");
        let node =
            add_device(&mut world, &kind::MOTOR, &name, vec![with_check(drop)], RP2040_200_MHZ, ClockModel::PERFECT);
        members.push((node, gateway(0)));
    }
    let bus = world.bus(&members, model("loss=0.05,dup=0.05,reorder=0.02,ber=0.00005,jitter=200us,seed=2"));
    world.run_for(us(50_000));
    let mut again = 0;
    for number in 0..120u8 {
        let drop = 1 + number % 6;
        let name = query(Query::RuntimeName);
        with_probe(&mut world, host, |it, now| it.ask(over_bus(BusDrop(drop), 0, 20_000), &name, now));
        world.run_for(us(150_000));
        let answer = probe(&world, host).answers.last().unwrap();
        assert_eq!(answer.payload[2..], [2, b'm', b'0' + drop]);
        again += usize::from(answer.tries > 1);
    }
    assert_eq!((probe(&world, host).answers.len(), probe(&world, host).failed), (120, 0));
    assert!(again > 5, "{again}");
    let (stats, faults) = (world.bus_stats(bus), world.bus_faults(bus).unwrap());
    assert_eq!(stats.arrived, faults.offered + faults.duplicated - faults.lost);
    assert_all_slots_home(&world);
}

/// `[PKT-15]`: a broadcast that the medium loses is lost for all, and one that it carries reaches each.
#[test]
fn a_broadcast_reaches_all_or_nobody() {
    let mut it = cell(2, Check::Crc32, model("loss=0.2,seed=9"));
    it.send_numbered(400, |_| BusDrop::BROADCAST);
    let heard: Vec<Vec<u32>> = (0..usize::from(MEMBERS)).map(|drop| it.numbers(drop)).collect();
    for number in 0..400u32 {
        let by = heard.iter().filter(|numbers| numbers.contains(&number)).count();
        assert!(by == 0 || by == usize::from(MEMBERS) - 1, "{number} was heard by {by}");
    }
    let (stats, faults) = (it.world.bus_stats(it.bus), it.world.bus_faults(it.bus).unwrap());
    assert!(faults.lost > 50);
    assert_eq!(stats.taken, (faults.offered - faults.lost) * u64::from(MEMBERS - 1));
    assert_eq!(stats.passed_over, 0);
}

/// `[LNK-07]`: copies and late frames reach whom they are for, and never their speaker.
#[test]
fn copies_and_late_frames_reach_the_members() {
    let mut it = cell(4, Check::Crc32, model("dup=0.3,reorder=0.1,delay=3ms,seed=6"));
    it.send_numbered(500, another);
    let (stats, faults) = (it.world.bus_stats(it.bus), it.world.bus_faults(it.bus).unwrap());
    assert!(faults.duplicated > 100 && faults.reordered > 30, "{faults:?}");
    assert_eq!(stats.arrived, faults.offered + faults.duplicated);
    assert_eq!(stats.arrived * u64::from(MEMBERS - 1), stats.taken + stats.passed_over);
    let mut all = Vec::new();
    let mut late = 0;
    for drop in 0..MEMBERS {
        let numbers = it.numbers(usize::from(drop));
        assert!(numbers.iter().all(|number| another(*number) == BusDrop(drop)));
        late += numbers.windows(2).filter(|pair| pair[1] < pair[0]).count();
        all.extend(numbers);
    }
    let mut once = all.clone();
    once.sort_unstable();
    once.dedup();
    assert_eq!(once, (0..500).collect::<Vec<u32>>());
    assert!(all.len() > 600 && late > 3, "{} {late}", all.len());
    let first = it.spoken().into_iter().find(|spoken| is_datagram(&spoken.packet)).unwrap();
    let to = probe(&it.world, it.nodes[usize::from(another(0).0)]);
    let arrived = to.datagrams.iter().find(|(_, payload)| *payload == numbered(0)).unwrap().0;
    let wire = bus_gateway(0).wire_time(first.packet.len());
    assert!(arrived.steps() >= (first.at + wire + us(3_000)).steps());
}

/// `[LNK-07]`: bandwidth is the medium's: nobody speaks before the last bit of the frame in front is out.
#[test]
fn a_narrow_fault_layer_holds_the_medium() {
    let mut it = cell(5, Check::Crc32, model("bandwidth=200k,seed=1"));
    it.send_numbered(200, another);
    assert_eq!(it.world.bus_faults(it.bus).unwrap().overflowed, 0);
    let spoken = it.spoken();
    for pair in spoken.windows(2) {
        // at least the addresses, the packet, the check, one byte of stuffing and the delimiter
        let bits = (pair[0].packet.len() as u64 + 2 + 4 + 2) * 8;
        let gap = pair[1].at.steps() - pair[0].at.steps();
        assert!(gap >= us(bits * 5).steps(), "{gap} after {bits} bits at 200 kbit/s");
    }
    // some 52 bytes: 0.55 ms of wire and 2.2 ms of bandwidth each, one made each 2 ms: what waits too long is counted by its sender
    let arrived: usize = (0..5).map(|drop| it.numbers(drop).len()).sum();
    let held: u64 = it.nodes.iter().map(|node| probe(&it.world, *node).node.counters().total()).sum();
    assert_eq!(arrived as u64 + held, 200);
}

/// `[LNK-07]`: one seed gives one run; another seed of the faults, of the world, or another bus gives other faults.
#[test]
fn faults_are_drawn_from_their_seeds() {
    let run = |seed, faults| {
        let mut it = cell(seed, Check::Crc16, model(faults));
        it.send_numbered(300, another);
        let heard: Vec<Vec<u32>> = (0..5).map(|drop| it.numbers(drop)).collect();
        (it.world.digest(), it.world.stats(), it.world.bus_stats(it.bus), it.world.bus_faults(it.bus), heard)
    };
    let first = run(1, "loss=0.1,ber=0.0001,dup=0.1,seed=1");
    assert_eq!(first, run(1, "loss=0.1,ber=0.0001,dup=0.1,seed=1"));
    assert_ne!(first.3, run(1, "loss=0.1,ber=0.0001,dup=0.1,seed=2").3);
    assert_ne!(first.3, run(2, "loss=0.1,ber=0.0001,dup=0.1,seed=1").3);

    let mut world = World::new(1);
    let buses = [0, 1].map(|_| {
        let nodes = [1, 2].map(|drop| add_probe(&mut world, &[bus_gateway(drop)]));
        let bus = world.bus(&nodes.map(|node| (node, gateway(0))), model("loss=0.5,seed=1"));
        (nodes, bus)
    });
    for number in 0..100 {
        for ([from, _], _) in buses {
            with_probe(&mut world, from, |it, now| {
                it.datagram(&over_bus(BusDrop(2), 1, 9_000), &numbered(number), now)
            })
            .unwrap();
        }
        world.run_for(us(2_000));
    }
    let [one, other] = buses.map(|([_, to], _)| numbers(probe(&world, to)));
    assert_ne!(one, other);
}

/// A member that is reset in the midst of a frame misses it: lost if it was for it alone, heard by the others if not.
#[test]
fn a_reset_in_the_midst_of_a_frame_misses_it() {
    let mut world = World::new(1);
    let nodes = [1, 2].map(|drop| add_probe(&mut world, &[bus_gateway(drop)]));
    let device = add_device(&mut world, &kind::MOTOR, "m", vec![bus_gateway(3)], RP2040_200_MHZ, ClockModel::PERFECT);
    let bus = world.bus(&[nodes[0], nodes[1], device].map(|node| (node, gateway(0))), BusModel::default());
    world.run_for(us(20_000));
    for (to, lost) in [(BusDrop(3), 1), (BusDrop::BROADCAST, 1), (BusDrop(2), 1)] {
        with_probe(&mut world, nodes[0], |it, now| it.datagram(&over_bus(to, 1, 9_000), &numbered(1), now).unwrap());
        world.run_for(us(100));
        world.reset(device);
        world.run_for(us(20_000));
        assert_eq!((world.bus_stats(bus).lost, world.stats().lost), (lost, lost), "to {to:?}");
    }
    assert_eq!(world.bus_stats(bus).missed, 3);
    assert_eq!(numbers(probe(&world, nodes[1])), [1, 1]);
    assert_all_slots_home(&world);
}

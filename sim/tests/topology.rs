//! Cables pulled, nodes reset and swapped, buses, the world outside, and the walk of a packet.

mod common;

use common::{
    HUSH, Probe, add_probe, assert_all_slots_home, gateway, hush, over, port, probe, query, timeless, us, with_probe,
};
use firmware_app::kind;
use osap_protocol::discovery::{NeighbourChange, Query};
use osap_protocol::transport::SequencedKind;
use osap_protocol::{BusDrop, DropCause, RouteBuf, Step};
use osap_runtime::GatewayConfig;
use osap_runtime::sequenced::Destination;
use osap_sim::device::{SimDevice, sim_device};
use osap_sim::machines::shapes::{self, bus_gateway};
use osap_sim::machines::{RP2040_200_MHZ, UART, add_device, unique_id};
use osap_sim::processor::{Processor, RING_FRAMES};
use osap_sim::time::{ClockModel, TrueTime};
use osap_sim::world::{BusModel, LinkModel, NodeId, World};
use std::collections::BTreeSet;

const PERFECT: ClockModel = ClockModel::PERFECT;

fn motor(world: &mut World, gateways: Vec<GatewayConfig>) -> NodeId {
    add_device(world, &kind::MOTOR, "motor", gateways, RP2040_200_MHZ, PERFECT)
}

/// The latest change of the probe's neighbour on gateway 0.
fn change(world: &mut World, id: NodeId) -> Option<NeighbourChange> {
    let probe = world.endpoint_mut::<Probe>(id).unwrap();
    probe.node.take_neighbour_change().map(|(_, change)| change)
}

fn pings(world: &mut World, shape: &[NodeId], host: NodeId) {
    for n in 0..40u8 {
        let hops: Vec<u8> = std::iter::once(0).chain(std::iter::repeat_n(1, usize::from(n) % shape.len())).collect();
        with_probe(world, host, |it, now| it.ask(over(&hops, 0, 60_000), &query(Query::TypeName), now));
        world.run_for(us(1_500));
    }
    world.run_for(us(300_000));
}

/// A world repeats itself, event by event and byte by byte; another seed is another world.
#[test]
fn the_same_seed_gives_the_same_world() {
    let run = |seed| {
        let mut world = World::new(seed);
        let model = LinkModel {
            jitter: us(20),
            latency: us(1),
            faults: Some("loss=0.02,seed=4".parse().unwrap()),
            ..LinkModel::WIRE
        };
        let line = shapes::line(&mut world, 8, model);
        let host = add_probe(&mut world, &[UART]);
        world.connect((host, gateway(0)), (line.nodes[0], gateway(0)), LinkModel::WIRE);
        world.run_for(us(20_000));
        pings(&mut world, &line.nodes, host);
        let answers = probe(&world, host).answers.clone();
        (world.digest(), world.stats(), answers)
    };
    let first = run(1);
    assert_eq!(first, run(1));
    assert_ne!(first.0, run(2).0);
    assert!(first.2.len() > 30);
}

/// `[SYS-04]`: appeared, rebooted, swapped and lost, each told once and in time.
#[test]
fn neighbours_appear_reboot_are_swapped_and_lost() {
    let mut world = World::new(1);
    let host = add_probe(&mut world, &[UART]);
    let device = motor(&mut world, vec![UART]);
    let link = world.connect((host, gateway(0)), (device, gateway(0)), LinkModel::WIRE);
    world.run_for(us(2_000));
    assert_eq!(change(&mut world, host), Some(NeighbourChange::Appeared));
    world.run_for(us(600_000));
    assert_eq!(change(&mut world, host), None);

    assert!(world.reset(device));
    world.run_for(us(2_000));
    assert_eq!(change(&mut world, host), Some(NeighbourChange::Rebooted));

    world.swap(device, Box::new(|boot| sim_device(&kind::HEATER, unique_id(99), boot.epoch, "new", &[UART])));
    world.run_for(us(2_000));
    assert_eq!(change(&mut world, host), Some(NeighbourChange::Swapped));
    let neighbour = probe(&world, host).node.gateway(gateway(0)).unwrap().neighbour().unwrap();
    assert_eq!(neighbour.unique_id, unique_id(99));

    world.cut(link); // as a UART's cable: nobody notices but by silence
    world.run_for(us(500_000));
    assert_eq!(change(&mut world, host), None);
    world.run_for(us(600_000));
    assert_eq!(change(&mut world, host), Some(NeighbourChange::Lost));
    world.replug(link);
    world.run_for(us(600_000));
    assert_eq!(change(&mut world, host), Some(NeighbourChange::Appeared));

    world.unplug(link); // as a USB cable: both ends notice
    assert_eq!(change(&mut world, host), Some(NeighbourChange::Lost));
    assert_all_slots_home(&world);
}

/// `[NOD-02]`: a cable pulled while a frame is on it loses that frame, and no slot.
#[test]
fn unplugging_in_mid_flight_loses_the_frame_and_nothing_else() {
    let mut world = World::new(1);
    let host = add_probe(&mut world, &[UART]);
    let far = add_probe(&mut world, &[UART]);
    let link = world.connect((host, gateway(0)), (far, gateway(0)), LinkModel::WIRE);
    world.run_for(us(10_000));
    let there = over(&[0], 1, 20_000);
    with_probe(&mut world, host, |it, now| it.datagram(&there, &[1; 200], now).unwrap()); // 713 µs of wire
    with_probe(&mut world, host, |it, now| it.datagram(&there, &[2; 200], now).unwrap());
    world.run_for(us(300));
    world.unplug(link);
    world.run_for(us(50_000));
    assert!(probe(&world, far).datagrams.is_empty());
    assert_eq!(world.link_stats(link)[0].lost, 1);
    assert_eq!(probe(&world, host).node.counters().of(DropCause::GatewayClosed), 1, "the one that still waited");
    world.replug(link);
    world.run_for(us(10_000));
    with_probe(&mut world, host, |it, now| it.datagram(&there, &[3; 20], now).unwrap());
    world.run_for(us(10_000));
    assert_eq!(probe(&world, far).datagrams.len(), 1);
    assert_all_slots_home(&world);
}

/// `[TRN-05]`, `[DSC-05]`: a device reset while it answers: the request is tried again and answered by the next boot, under the name that
/// the first one was given.
#[test]
fn a_reset_in_mid_exchange_costs_a_retry() {
    let mut world = World::new(1);
    let host = add_probe(&mut world, &[UART]);
    let device = motor(&mut world, vec![UART]);
    world.connect((host, gateway(0)), (device, gateway(0)), LinkModel::WIRE);
    hush(&mut world);
    let rename = [&query(Query::SetRuntimeName)[..], &[5], b"third"].concat();
    with_probe(&mut world, host, |it, now| it.ask(over(&[0], 0, 20_000), &rename, now));
    world.run_for(us(10_000));
    for reset_after in [30, 62, 75, 100, 150] {
        let before = probe(&world, host).answers.len();
        with_probe(&mut world, host, |it, now| it.ask(over(&[0], 0, 20_000), &query(Query::RuntimeName), now));
        world.run_for(us(reset_after));
        world.reset(device);
        hush(&mut world);
        let answer = &probe(&world, host).answers[before];
        assert_eq!((answer.kind, answer.tries), (SequencedKind::Reply, 2), "reset after {reset_after} µs");
        assert_eq!(answer.payload[2..], [&[5][..], b"third"].concat());
    }
    assert_eq!(world.endpoint::<SimDevice>(device).unwrap().node().identity().boot_epoch, 6);
    assert_eq!(world.local_now(device).steps(), HUSH.steps(), "its counter began again");
    assert_all_slots_home(&world);
}

fn over_bus(drop: BusDrop, ttl_us: u16) -> Destination {
    let mut route = RouteBuf::new();
    route.push(Step::Bus { gateway: gateway(0), drop }).unwrap();
    Destination { route, mtu_bytes: 256, ttl_us, port: port(0) }
}

/// `[FRM-10]`, `[PKT-15]`: a query to one drop is answered by it alone, one to all by each, and answers find their way back.
#[test]
fn a_bus_carries_unicast_broadcast_and_replies() {
    let mut world = World::new(1);
    let host = add_probe(&mut world, &[bus_gateway(0)]);
    let mut members = vec![(host, gateway(0))];
    for drop in 1..=6 {
        let name = format!("m{drop}");
        let node = add_device(&mut world, &kind::MOTOR, &name, vec![bus_gateway(drop)], RP2040_200_MHZ, PERFECT);
        members.push((node, gateway(0)));
    }
    world.bus(&members, BusModel::default());
    world.run_for(us(50_000));
    let name = query(Query::RuntimeName);
    with_probe(&mut world, host, |it, now| it.ask(over_bus(BusDrop(4), 20_000), &name, now));
    world.run_for(us(30_000));
    let one = &probe(&world, host).answers;
    assert_eq!(one.len(), 1);
    assert_eq!(one[0].payload[2..], *b"\x02m4");

    with_probe(&mut world, host, |it, now| it.ask_all(over_bus(BusDrop::BROADCAST, 50_000), &name, now));
    world.run_for(us(60_000));
    let names: BTreeSet<Vec<u8>> = probe(&world, host).answers[1..].iter().map(|it| it.payload[2..].to_vec()).collect();
    assert_eq!(names.len(), 6);

    let lost = world.stats().lost;
    with_probe(&mut world, host, |it, now| it.ask_all(over_bus(BusDrop(77), 20_000), &name, now));
    world.run_for(us(60_000));
    assert_eq!(world.stats().lost, lost + 1, "nobody has that drop");
    assert_eq!(probe(&world, host).answers.len(), 7);
    assert_all_slots_home(&world);
}

/// On a bus that two want, the lower drop speaks first, whoever asked first of those that wait.
#[test]
fn the_lowest_drop_wins_the_bus() {
    let mut world = World::new(1);
    let nodes: Vec<NodeId> = [9, 5, 7, 1].map(|drop| add_probe(&mut world, &[bus_gateway(drop)])).to_vec();
    let members: Vec<_> = nodes.iter().map(|node| (*node, gateway(0))).collect();
    world.bus(&members, BusModel::default());
    world.run_for(us(50_000));
    let to_1 = Destination { port: port(1), ..over_bus(BusDrop(1), 20_000) };
    for (node, drop) in [(nodes[0], 9u8), (nodes[2], 7), (nodes[1], 5)] {
        with_probe(&mut world, node, |it, now| it.datagram(&to_1, &[drop; 100], now).unwrap());
    }
    world.run_for(us(20_000));
    let order: Vec<u8> = probe(&world, nodes[3]).datagrams.iter().map(|(_, payload)| payload[0]).collect();
    assert_eq!(order, [9, 5, 7]); // 9 had the free bus; then by drop
    assert_all_slots_home(&world);
}

/// `[LNK-01]`: a packet from outside the world comes in, and what goes out is handed out.
#[test]
fn the_world_outside_takes_part() {
    let mut world = World::new(1);
    let device = motor(&mut world, vec![UART]);
    let outside = world.attach_external(device, gateway(0));
    world.run_for(us(10_000));
    assert_eq!(world.external_receive(outside), None);
    world.external_open(outside, true);
    world.run_for(us(10_000));
    assert!(world.external_receive(outside).is_some(), "it announces itself");
    // pointer 5, 10 ms, MTU 256, link(3), port(9 → 1), datagram, "hi"
    let packet = [5, 0x10, 0x27, 0, 1, 0x43, 0xc0, 0x48, 0x01, 0, b'h', b'i'];
    let arrives = world.external_send(outside, &packet);
    assert_eq!(arrives, world.now() + UART.wire_time(packet.len()));
    world.run_for(us(10_000));
    let reply = world.external_receive(outside).unwrap();
    assert_eq!(reply[5..], [0x40, 0xc0, 0x08, 0x09, 0, b'h', b'i']); // the step it took is our gateway now
    assert_eq!(world.external_receive(outside), None);
}

/// A processor that is slower than its wire loses frames to its ring's bound, and counts each.
#[test]
fn a_slow_processor_overruns_and_counts() {
    let mut world = World::new(1);
    let uart = timeless(UART); // questions for the time would overrun it too
    let host = add_probe(&mut world, &[uart]);
    let slow = Processor { receive: us(5_000), ..RP2040_200_MHZ };
    let device = add_device(&mut world, &kind::MOTOR, "slow", vec![uart], slow, PERFECT);
    world.connect((host, gateway(0)), (device, gateway(0)), LinkModel::WIRE);
    world.run_for(us(20_000));
    let counted = |world: &World| {
        let node = world.endpoint::<SimDevice>(device).unwrap().node();
        (node.counters().of(DropCause::RxOverrun) as usize, world.stats().overruns)
    };
    let before = counted(&world);
    for _ in 0..16 {
        with_probe(&mut world, host, |it, now| it.datagram(&over(&[0], 1, 60_000), &[7; 8], now).unwrap());
    }
    world.run_for(us(200_000));
    let after = counted(&world);
    // a ring full is taken, the others are overrun
    let overrun = 16 - RING_FRAMES;
    assert_eq!(after.0 - before.0, overrun);
    assert_eq!(probe(&world, host).datagrams.len(), 16 - overrun);
    assert_eq!(after.1 - before.1, 8);
    assert_all_slots_home(&world);
}

/// The README's walk: through a hub to a device's query port and back. Each stage is passed in this order, node by node.
#[test]
fn the_walk_of_a_packet_passes_its_stages_in_order() {
    let mut world = World::new(1);
    let host = add_probe(&mut world, &[UART]);
    let hub = add_device(&mut world, &kind::HUB, "hub", vec![UART; 2], RP2040_200_MHZ, PERFECT);
    let device = motor(&mut world, vec![UART]);
    world.connect((host, gateway(0)), (hub, gateway(0)), LinkModel::WIRE);
    world.connect((hub, gateway(1)), (device, gateway(0)), LinkModel::WIRE);
    world.run_for(us(10_000));
    world.record_walk(true);
    with_probe(&mut world, host, |it, now| it.ask(over(&[0, 1], 0, 20_000), &query(Query::TypeName), now));
    world.run_for(us(10_000));
    let at = |world: &World, node: NodeId| -> Vec<&'static str> {
        world.walk().iter().filter(|event| event.node == node).map(|event| event.stage.name()).collect()
    };
    let in_to_stack = ["captured", "handed-over", "deframed", "ingress", "route", "stack"];
    let out = ["egress", "sent"];
    assert_eq!(at(&world, host)[..3], ["stack", "egress", "sent"]);
    assert_eq!(at(&world, hub), [&in_to_stack[..], &out, &in_to_stack, &out].concat());
    assert_eq!(at(&world, device), [&in_to_stack[..], &["deliver", "reply", "stack"], &out].concat());
    assert!(world.walk().is_sorted_by_key(|event| event.at));
    world.run_until(TrueTime::from_us(2_000_000));
    assert_eq!(at(&world, device).len(), 11, "announcements are no packets");
    world.record_walk(false);
    assert!(world.walk().is_empty());
}

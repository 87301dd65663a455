//! The built machines: whole, reachable, and with the times that their parts give.

mod common;

use common::{Probe, add_probe, assert_all_slots_home, gateway, hush, over, probe, query, us, with_probe};
use osap_protocol::discovery::Query;
use osap_protocol::{BusDrop, RouteBuf, Step};
use osap_runtime::sequenced::Destination;
use osap_sim::device::SimDevice;
use osap_sim::machines::printer::{self, HOST_GATEWAYS, HUB_PROCESSOR, Printer, TABLE_2_7};
use osap_sim::machines::shapes::{self, Shape};
use osap_sim::machines::{RP2040_200_MHZ, UART, USB_HIGH_SPEED};
use osap_sim::processor::Processor;
use osap_sim::world::{LinkModel, NodeId, World};
use std::collections::{BTreeMap, BTreeSet};

fn printer(seed: u64) -> (World, Printer) {
    let mut world = World::new(seed);
    let printer = printer::build(&mut world, Probe::new(&HOST_GATEWAYS), Processor::INSTANT);
    hush(&mut world);
    (world, printer)
}

/// Links from the workstation to a device of the table.
const ROUTES: [(&str, &[u8]); 12] = [
    ("Message Hub A", &[0]),
    ("Message Hub B", &[1]),
    ("Microbolometer", &[2]),
    ("Bed Heater", &[1, 1]),
    ("Extruder Motor", &[0, 1]),
    ("B Motor", &[0, 3]),
    ("A Motor", &[0, 2]),
    ("Z Motor (Rear)", &[1, 2]),
    ("Z Motor (Right)", &[1, 3]),
    ("Z Motor (Left)", &[1, 4]),
    ("Extruder Heater", &[0, 4]),
    ("Load Cell", &[0, 5]),
];

/// Every device of Table 2.7 is where the table has it, and calls itself so.
#[test]
fn the_printer_has_the_tables_devices_on_the_tables_links() {
    let (mut world, printer) = printer(1);
    for (row, (name, route)) in TABLE_2_7.iter().zip(ROUTES) {
        assert_eq!(row.device, name);
        let behind = if row.route.starts_with("Hub") { 2 } else { 1 };
        assert_eq!(route.len(), behind, "{name}");
        let before = probe(&world, printer.host).answers.len();
        with_probe(&mut world, printer.host, |it, now| it.ask(over(route, 0, 20_000), &query(Query::RuntimeName), now));
        world.run_for(us(10_000));
        let answer = &probe(&world, printer.host).answers[before];
        assert_eq!(&answer.payload[3..], name.as_bytes());
        let node = printer.node(name).unwrap();
        assert_eq!(world.endpoint::<SimDevice>(node).unwrap().node().name(), name);
        assert!(printer.link(name).is_some());
    }
    world.run_for(us(100_000));
    assert_all_slots_home(&world);
}

/// A round trip is never shorter than wires and processors make it, nor longer than the two waits for USB add; the mean of the waits is
/// one microframe. Bed heater: hub B twice, UART twice, 24.2 µs of its own.
#[test]
fn a_round_trip_of_the_printer_is_the_sum_of_its_parts() {
    let (mut world, printer) = printer(1);
    for _ in 0..400 {
        with_probe(&mut world, printer.host, |it, now| {
            it.ask(over(&[1, 1], 0, 20_000), &query(Query::TimeControl), now)
        });
        world.run_for(us(2_037)); // no multiple of a microframe
    }
    // query 15 bytes, answer 76, as in the table
    let wires = UART.wire_time(15) + UART.wire_time(76) + USB_HIGH_SPEED.wire_time(15) + USB_HIGH_SPEED.wire_time(76);
    let hub = HUB_PROCESSOR.receive + HUB_PROCESSOR.forward;
    let least = wires + RP2040_200_MHZ.total() + hub + hub;
    let trips: Vec<u64> = probe(&world, printer.host).answers.iter().map(|it| it.round_trip.steps()).collect();
    assert_eq!(trips.len(), 400);
    assert!(trips.iter().all(|trip| (least.steps()..=(least + us(250)).steps()).contains(trip)));
    let mean = trips.iter().sum::<u64>() / 400 - least.steps();
    // the mean of 400 sums of two uniform waits: 125 µs, σ = 51 µs / 20; five of those
    assert!(mean.abs_diff(125 << 8) < 13 << 8, "{mean}");
}

/// Nodes that links join to the first one.
fn reachable(world: &World, shape: &Shape) -> usize {
    let mut wired: BTreeMap<NodeId, Vec<NodeId>> = BTreeMap::new();
    for link in &shape.links {
        let [a, b] = world.ends(*link);
        wired.entry(a.0).or_default().push(b.0);
        wired.entry(b.0).or_default().push(a.0);
    }
    let mut known = BTreeSet::from([shape.nodes[0]]);
    let mut frontier = vec![shape.nodes[0]];
    while let Some(node) = frontier.pop() {
        frontier.extend(wired.get(&node).into_iter().flatten().copied().filter(|other| known.insert(*other)));
    }
    known.len()
}

/// Without extra links a network is a tree: one link less than nodes, and all joined.
#[test]
fn a_random_network_without_extra_links_is_a_tree() {
    let mut world = World::new(6);
    let shape = shapes::network(&mut world, 300, 0);
    assert_eq!((shape.links.len(), reachable(&world, &shape)), (299, 300));
}

/// With extra links it has loops; gateway 0 of its first node stays free; neighbours find each other.
#[test]
fn a_random_network_is_connected_and_has_loops() {
    let mut world = World::new(5);
    let shape = shapes::network(&mut world, 1_000, 300);
    assert!(shape.links.len() > 1_200 && shape.links.len() <= 1_299);
    assert_eq!(reachable(&world, &shape), 1_000);
    world.run_for(us(50_000));
    for link in &shape.links {
        let [(node, at), (other, back)] = world.ends(*link);
        assert_ne!(node, other);
        assert!([(node, at), (other, back)].iter().all(|end| *end != (shape.nodes[0], gateway(0))));
        let neighbour = world.endpoint::<SimDevice>(node).unwrap().node().gateway(at).unwrap().neighbour();
        let id = world.endpoint::<SimDevice>(other).unwrap().node().identity().unique_id;
        assert_eq!(neighbour.unwrap().unique_id, id);
    }
}

/// A ring can be walked all the way round: the packet comes back to the node it began behind.
#[test]
fn a_ring_leads_round() {
    let mut world = World::new(1);
    let ring = shapes::ring(&mut world, 5, LinkModel::WIRE);
    let host = add_probe(&mut world, &[UART]);
    world.connect((host, gateway(0)), (ring.nodes[0], gateway(2)), LinkModel::WIRE);
    world.run_for(us(20_000));
    let around = over(&[0, 1, 1, 1, 1, 1], 0, 30_000);
    with_probe(&mut world, host, |it, now| it.ask(around, &query(Query::RuntimeName), now));
    world.run_for(us(20_000));
    assert_eq!(&probe(&world, host).answers[0].payload[3..], b"hub-0");
    world.run_for(us(100_000));
    assert_all_slots_home(&world);
}

/// A hub leads from a link onto a bus and back.
#[test]
fn a_cells_devices_are_reached_through_its_hub() {
    let mut world = World::new(1);
    let cell = shapes::bus_cell(&mut world, 12);
    let host = add_probe(&mut world, &[UART]);
    world.connect((host, gateway(0)), (cell.hub, gateway(0)), LinkModel::WIRE);
    // until its members know whose time they follow: 13 searches with up to 12 answers of 0.94 ms each, in which the highest drops wait
    // longest, then 16 requests of each, 50 ms apart and ±1/8, `[TIM-18]`
    world.run_for(us(1_260_000));
    let mut route = RouteBuf::new();
    route.push(Step::Link(gateway(0))).unwrap();
    route.push(Step::Bus { gateway: gateway(1), drop: BusDrop::BROADCAST }).unwrap();
    let all = Destination { route, ..over(&[], 0, 60_000) };
    with_probe(&mut world, host, |it, now| it.ask_all(all, &query(Query::RuntimeName), now));
    world.run_for(us(100_000));
    let names: BTreeSet<&[u8]> = probe(&world, host).answers.iter().map(|it| &it.payload[3..]).collect();
    // the hub holds four of the replies at a time, and the UART is faster than the bus: none is dropped
    assert_eq!(names.len(), 12);
    assert_all_slots_home(&world);
}

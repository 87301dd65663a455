//! Networks at rest: all is found, nothing twice.

use super::support::{found_ids, found_links, ids, scan, scan_again, true_links};
use osap::map::{LeadsTo, diff};
use osap::network::SimNetwork;
use osap::session::Session;
use osap_sim::machines::printer;
use osap_sim::world::LinkModel;

const SEED: u64 = 11;

/// The printer's whole map, as people see it.
#[test]
fn the_printer_is_found_as_it_was_built() {
    let report = scan(SimNetwork::printer(SEED));
    let expected = "\
host  osap-host  686f…000b
├─0─ Message Hub A  hub  7369…0001
│  ├─1─ Extruder Motor  motor  7369…0004
│  ├─2─ A Motor  motor  7369…0005
│  ├─3─ B Motor  motor  7369…0006
│  ├─4─ Extruder Heater  heater  7369…0007
│  └─5─ Load Cell  loadcell  7369…0008
├─1─ Message Hub B  hub  7369…0002
│  ├─1─ Bed Heater  heater  7369…0009
│  ├─2─ Z Motor (Rear)  motor  7369…000a
│  ├─3─ Z Motor (Right)  motor  7369…000b
│  └─4─ Z Motor (Left)  motor  7369…000c
└─2─ Microbolometer  camera  7369…0003
";
    assert_eq!(report.map.tree(), expected);
    assert_eq!(report.map.findings, []);
    assert_eq!(report.map.silent, []);
    // branches of a device whose links were not read are shown all the same
    let mut unread = report.map.clone();
    unread.devices.iter_mut().for_each(|device| device.gateways.clear());
    assert_eq!(unread.tree(), expected);
    assert_eq!((report.cost.retries, report.cost.timeouts), (0, 0));
    for row in printer::TABLE_2_7 {
        let device = report.map.resolve(row.device).unwrap();
        let ports = if device.type_name == "motor" { 5 } else { 4 };
        assert!(device.ports.len() == ports && device.ports[1].type_name == "echo", "{device:?}");
    }
}

/// `[DSC-08]`: a line of 20; the last one is 20 steps away.
#[test]
fn a_line_is_found_to_its_end() {
    let mut network = SimNetwork::line(20, LinkModel::WIRE, SEED);
    let links = true_links(&mut network);
    let map = scan(network).map;
    assert_eq!(found_ids(&map), ids(20));
    assert_eq!(found_links(&map), links);
    assert_eq!(map.devices.last().unwrap().route().steps(), 20);
}

/// `[DSC-04]`: in a ring of 7 the first device has two ways to each other, and all seven links are found, one of them outside
/// the tree.
#[test]
fn a_ring_is_a_loop_and_not_an_endless_line() {
    let mut network = SimNetwork::ring(7, LinkModel::WIRE, SEED);
    let links = true_links(&mut network);
    let map = scan(network).map;
    assert_eq!(found_ids(&map), ids(7));
    assert_eq!(found_links(&map), links);
    assert_eq!(map.links.iter().filter(|link| !link.in_tree).count(), 1);
    // the two in the middle, where both ways meet
    let far: Vec<_> = map.devices.iter().filter(|device| device.routes.len() == 2).collect();
    assert_eq!(far.len(), 2, "{}", map.tree());
    assert!(map.tree().contains('═'), "{}", map.tree());
    assert_eq!(map.findings, []);
}

/// `[DSC-08]`, `[PKT-15]`: every drop of a bus.
#[test]
fn every_drop_of_a_bus_is_found() {
    // on the longest ones not all answers to a broadcast come in time
    for devices in [1, 6, 24, 120, 254] {
        let map = scan(SimNetwork::bus(devices, LinkModel::WIRE, SEED)).map;
        assert_eq!(found_ids(&map), ids(devices + 1), "{devices} devices");
        assert_eq!((map.buses.len(), map.buses[0].members.len()), (1, devices + 1));
        let drops: Vec<u8> = map.buses[0].members.iter().map(|member| member.drop).collect();
        assert!(drops.iter().map(|drop| usize::from(*drop)).eq(0..=devices));
        assert!(map.devices[2..].iter().all(|device| device.gateways[0].leads_to == Some(LeadsTo::Bus { bus: 0 })));
        assert_eq!(map.findings, []);
    }
}

/// `[DSC-04]`, `[DSC-08]`: 200 nodes and 40 loops are those that the generator made, for several seeds.
#[test]
fn random_networks_are_found_as_they_were_built() {
    for seed in 1..=4 {
        let mut network = SimNetwork::network(200, 40, LinkModel::WIRE, seed);
        let links = true_links(&mut network);
        let report = scan(network);
        assert_eq!(found_ids(&report.map), ids(200), "seed {seed}");
        assert_eq!(found_links(&report.map), links, "seed {seed}");
        assert_eq!(report.map.findings, [], "seed {seed}");
        assert_eq!(report.map.silent, [], "seed {seed}");
    }
}

/// A second scan of a machine at rest finds the same, whatever the first left behind in the nodes.
#[test]
fn a_second_scan_finds_the_same() {
    let mut session = Session::over(SimNetwork::network(60, 12, LinkModel::WIRE, SEED));
    let (first, second) = (scan_again(&mut session).map, scan_again(&mut session).map);
    assert_eq!(diff(&first, &second), []);
    assert_eq!(first.links, second.links);
}

/// One seed gives one scan, to the packet.
#[test]
fn a_scan_repeats_itself() {
    let [one, other] = [(), ()].map(|()| scan(SimNetwork::network(40, 8, LinkModel::WIRE, SEED)));
    assert_eq!(one.map.to_json(), other.map.to_json());
    assert_eq!(one.cost, other.cost);
}

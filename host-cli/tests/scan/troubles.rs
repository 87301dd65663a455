//! Networks in trouble: resets, swaps, doubles, cut cables, losses. Every scan ends, and tells what was odd.

use super::support::{findings, found_ids, ids, scan, scan_again};
use firmware_app::kind;
use fixed_math::time::Span;
use osap::link::LinkOptions;
use osap::map::{Change, Finding, LeadsTo, NetworkMap, ResolveError, diff};
use osap::network::SimNetwork;
use osap::session::{OpenOptions, Session};
use osap_protocol::GatewayIndex;
use osap_protocol::discovery::UniqueId;
use osap_sim::device::sim_device;
use osap_sim::endpoint::Endpoint;
use osap_sim::faults::FaultConfig;
use osap_sim::machines::{UART, unique_id};
use osap_sim::world::{Boot, Factory, LinkModel, NodeId, World};

const SEED: u64 = 23;

/// A quarter, a half and three quarters of the time that an undisturbed scan takes.
fn midst(network: SimNetwork) -> [Span; 3] {
    let elapsed_us = scan(network).cost.elapsed_us;
    [1, 2, 3].map(|quarters| Span::from_us(elapsed_us * quarters / 4))
}

fn node(network: &mut SimNetwork, at: usize) -> NodeId {
    network.world().nodes().nth(at).unwrap()
}

/// A device with three UARTs.
fn factory(id: UniqueId, name: &'static str) -> Factory {
    Box::new(move |boot: Boot<'_>| -> Box<dyn Endpoint> {
        sim_device(&kind::MOTOR, id, boot.epoch, boot.name.unwrap_or(name), &[UART; 3])
    })
}

/// `[DSC-09]`: a device that restarts in the midst is read again, is in the map once, with its new boot epoch, and is reported.
#[test]
fn a_restart_in_the_midst_is_seen_and_told() {
    let ring = || SimNetwork::ring(6, LinkModel::WIRE, SEED);
    for after in midst(ring()) {
        let mut network = ring();
        let third = node(&mut network, 3);
        network.schedule(after, move |world| assert!(world.reset(third)));
        let map = scan(network).map;
        assert_eq!(found_ids(&map), ids(6), "after {after:?}");
        let device = map.devices.iter().position(|device| device.unique_id == unique_id(3)).unwrap();
        assert_eq!(map.devices[device].boot_epoch, 2, "after {after:?}");
        let is_told = |finding: &Finding| matches!(finding, Finding::Restarted { device: it, .. } if *it == device);
        // in the first quarter nobody had met the device before it restarted
        let is_met = after > midst(ring())[0];
        assert_eq!(map.findings.iter().any(is_told), is_met, "after {after:?}: {:?}", findings(&map));
    }
}

/// Another device in the place of one: two maps tell it, and nothing else of the machine.
#[test]
fn a_swap_is_told_as_one() {
    let mut network = SimNetwork::line(4, LinkModel::WIRE, SEED);
    let last = node(&mut network, 4);
    let swapped = UniqueId([0xee; 12]);
    network.schedule(Span::from_us(5_000_000), move |world| world.swap(last, factory(swapped, "spare")));
    let mut session = Session::over(network);
    let before = scan_again(&mut session).map;
    session.network().pause(Span::from_us(7_000_000)).unwrap();
    let after = scan_again(&mut session).map;
    let changes = diff(&before, &after);
    assert!(
        matches!(&changes[..], [Change::Swapped { before, after, .. }] if before.starts_with("hub-4 ") && after.starts_with("spare ")),
        "{changes:?}"
    );
    assert_eq!(diff(&after, &after), []);
}

/// The same in the midst of a line: whoever hangs behind the one that was swapped has not moved.
#[test]
fn what_is_behind_a_swap_has_not_moved() {
    let before = scan(SimNetwork::line(4, LinkModel::WIRE, SEED)).map;
    let mut network = SimNetwork::line(4, LinkModel::WIRE, SEED);
    // the last one is known by nobody but this one
    let third = node(&mut network, 3);
    network.world().swap(third, factory(UniqueId([0xee; 12]), "spare"));
    network.world().run_for(Span::from_us(2_000_000));
    let mut after = scan(network).map;
    let told = |changes: &[Change]| changes.iter().map(ToString::to_string).collect::<Vec<_>>();
    let changes = told(&diff(&before, &after));
    assert!(changes.len() == 1 && changes[0].starts_with("swapped: spare "), "{changes:?}");

    // a name that was not read is no other name
    after.devices[4].name.clear();
    assert_eq!(told(&diff(&before, &after)), changes);
    assert_eq!(told(&diff(&after, &before)).len(), 1);
}

/// A branch that is lost is lost whole; a rename and a restart are told as such.
#[test]
fn losses_renames_and_restarts_are_told() {
    let mut network = SimNetwork::line(5, LinkModel::WIRE, SEED);
    let (second, cable) = (node(&mut network, 2), network.links()[4]);
    network.schedule(Span::from_us(5_000_000), move |world| {
        assert!(world.reset(second));
        world.unplug(cable);
    });
    let mut session = Session::over(network);
    let before = scan_again(&mut session).map;
    let first = session.destination_of(before.resolve("hub-1").unwrap());
    session.set_name(&first, "left foot").unwrap();
    session.network().pause(Span::from_us(7_000_000)).unwrap();
    let after = scan_again(&mut session).map;
    let told: Vec<String> = diff(&before, &after).iter().map(ToString::to_string).collect();
    assert_eq!(
        told,
        ["renamed: hub-1 is left foot now, at /0", "rebooted: hub-2 at /0/1", "lost: hub-5, which was at /0/1/1/1/1"]
    );
}

/// Two devices of one name are both kept; the name alone is refused with both listed.
#[test]
fn one_name_on_two_devices_is_told_and_refused() {
    let mut network = SimNetwork::line(3, LinkModel::WIRE, SEED);
    for (at, id) in [(2, 2), (3, 3)] {
        let it = node(&mut network, at);
        network.world().swap(it, factory(unique_id(id), "twin"));
    }
    network.world().run_for(Span::from_us(2_000_000));
    let map = scan(network).map;
    assert_eq!(map.findings.len(), 1, "{:?}", findings(&map));
    assert!(
        matches!(&map.findings[0], Finding::DuplicateName { name, devices } if name == "twin" && devices.len() == 2)
    );
    let Err(ResolveError::Ambiguous { candidates, .. }) = map.resolve("twin") else { panic!("one of two was chosen") };
    assert_eq!(candidates.iter().map(|it| it.route.to_string()).collect::<Vec<_>>(), ["/0/1", "/0/1/1"]);
    assert_eq!(map.resolve("/0/1/1").unwrap().unique_id, unique_id(3));
    assert_eq!(map.resolve(&unique_id(2).to_string()).unwrap().name, "twin");
}

/// `[DSC-04]`: two devices that carry one unique id, and one boot epoch, are two.
#[test]
fn one_unique_id_on_two_devices_is_two_devices() {
    let mut network = SimNetwork::ring(6, LinkModel::WIRE, SEED);
    let fifth = node(&mut network, 5);
    network.world().swap(fifth, factory(unique_id(3), "impostor"));
    network.world().run_for(Span::from_us(2_000_000));
    let map = scan(network).map;
    let carriers: Vec<&str> = map
        .devices
        .iter()
        .filter(|device| device.unique_id == unique_id(3))
        .map(|device| device.name.as_str())
        .collect();
    assert_eq!(carriers.len(), 2, "{}", map.tree());
    assert!(carriers.contains(&"impostor") && carriers.contains(&"hub-3"), "{carriers:?}");
    assert!(
        matches!(&map.findings[..], [Finding::DuplicateUniqueId { devices, .. }] if devices.len() == 2),
        "{:?}",
        findings(&map)
    );
}

/// A cable that is cut in the midst, unseen by either end: what was found stays, what was not is a silent place, and the scan ends.
#[test]
fn a_cable_cut_in_the_midst_leaves_a_silent_place() {
    let mut network = SimNetwork::printer(SEED);
    let hub_b = network.links()[1];
    network.schedule(Span::from_us(100), move |world| world.cut(hub_b));
    let map = scan(network).map;
    assert_eq!(map.silent.len(), 1, "{}", map.tree());
    let place = &map.silent[0];
    assert_eq!((place.device, place.gateway, place.neighbour), (0, 1, Some(unique_id(2))));
    assert_eq!(place.tries, 12);
    assert_eq!(map.devices[0].gateways[1].leads_to, Some(LeadsTo::Silent { silent: 0 }));
    assert_eq!(map.devices.len(), 1 + 1 + 5 + 1, "{}", map.tree());

    for after in midst(SimNetwork::printer(SEED)) {
        let mut network = SimNetwork::printer(SEED);
        let hub_b = network.links()[1];
        network.schedule(after, move |world| world.unplug(hub_b));
        let map = scan(network).map;
        let silenced = map.findings.iter().filter(|finding| matches!(finding, Finding::FellSilent { .. })).count();
        assert!(silenced > 0, "after {after:?}: {}\n{:?}", map.tree(), findings(&map));
    }
}

/// Links that lose 2 % of their frames and flip bits: everything is found all the same, at the price of retries.
#[test]
fn losses_and_bit_errors_cost_retries_and_no_devices() {
    for seed in 1..=5 {
        let faults = FaultConfig { loss: 0.02, bit_error_rate: 2e-5, seed, ..FaultConfig::default() };
        let report = scan(SimNetwork::ring(8, LinkModel { faults: Some(faults), ..LinkModel::WIRE }, seed));
        assert_eq!(found_ids(&report.map), ids(8), "seed {seed}");
        assert!(report.cost.retries > 0, "seed {seed}");
        assert!(!report.map.findings.iter().any(|it| matches!(it, Finding::Incomplete { .. })), "seed {seed}");
    }
}

/// `[LNK-07]`: the same on every machine there is: a network with loops, a bus whose one medium loses for all, the printer.
#[test]
fn every_simulated_machine_is_found_on_bad_cables() {
    for seed in 1..=3 {
        let faults = FaultConfig { loss: 0.01, bit_error_rate: 1e-5, seed, ..FaultConfig::default() };
        let model = LinkModel { faults: Some(faults), ..LinkModel::WIRE };
        let options = OpenOptions {
            link: LinkOptions { faults: Some(faults), ..LinkOptions::default() },
            ..OpenOptions::default()
        };
        let printer = SimNetwork::open(&"sim:printer".parse().unwrap(), &options).unwrap();
        let machines =
            [(SimNetwork::network(60, 12, model, seed), 60), (SimNetwork::bus(12, model, seed), 13), (printer, 12)];
        for (network, devices) in machines {
            let report = scan(network);
            assert_eq!(found_ids(&report.map), ids(devices), "seed {seed}, {devices} devices");
            assert!(report.cost.retries > 0, "seed {seed}, {devices} devices: the cables were good");
        }
    }
}

/// On cables that lose every third frame a scan may miss devices, but what it found it does not forget: neither the host's own name
/// when it reads it anew, nor that of a device whose answers were lost the first time.
#[test]
fn what_was_read_is_not_forgotten() {
    for (seed, loss) in [(1, 0.3), (2, 0.3), (3, 0.3), (4, 0.25), (5, 0.2), (6, 0.2)] {
        let faults = FaultConfig { loss, seed, ..FaultConfig::default() };
        let link = LinkOptions { faults: Some(faults), ..LinkOptions::default() };
        let options = OpenOptions { link, ..OpenOptions::default() };
        let network = SimNetwork::open(&"sim:printer".parse().unwrap(), &options).unwrap();
        assert_all_read(&scan(network).map, &format!("loss {loss}, seed {seed}"));
    }
    for seed in 1..=4 {
        let faults = FaultConfig { loss: 0.05, seed, ..FaultConfig::default() };
        let model = LinkModel { faults: Some(faults), ..LinkModel::WIRE };
        let map = scan(SimNetwork::network(100, 10, model, seed)).map;
        assert!(map.devices.len() > 50, "seed {seed}: {}", map.tree());
        assert_all_read(&map, &format!("network, seed {seed}"));
    }
}

/// Every device has told its names and links, unless it fell silent, which is told.
fn assert_all_read(map: &NetworkMap, what: &str) {
    let host = map.root();
    assert!(host.name == "host" && host.type_name == "osap-host" && !host.gateways.is_empty(), "{what}: {host:?}");
    for (index, device) in map.devices.iter().enumerate() {
        let is_told = map.findings.contains(&Finding::FellSilent { device: index });
        let is_read = !device.name.is_empty() && !device.type_name.is_empty() && !device.gateways.is_empty();
        assert!(is_read || is_told, "{what}: {}\n{}\n{:?}", device.route(), map.tree(), findings(map));
    }
    let is_incomplete = |finding: &Finding| matches!(finding, Finding::Incomplete { device, .. } if !map.findings.contains(&Finding::FellSilent { device: *device }));
    assert!(!map.findings.iter().any(is_incomplete), "{what}: {:?}", findings(map));
}

/// A link of the host that leads nowhere is told, with why: closed, or open and nobody there.
#[test]
fn a_link_that_leads_nowhere_is_told() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let spec = format!("tcp:{}", listener.local_addr().unwrap());
    let map_now = || {
        let mut session = Session::open(&[spec.parse().unwrap()], &OpenOptions::default()).unwrap();
        scan_again(&mut session).map
    };
    // the system takes the connection, and nobody ever reads from it
    let text =
        format!("{spec} is open and nobody answers: another program may be using it, or its key or check differs");
    assert_eq!(findings(&map_now()), [text]);

    drop(listener);
    let map = map_now();
    let [Finding::SilentLink { link, reason: Some(reason) }] = &map.findings[..] else { panic!("{:?}", map.findings) };
    assert_eq!(*link, spec);
    assert!(reason.to_lowercase().contains("refused"), "{reason}");
    assert_eq!(findings(&map), [format!("{spec} is closed: {reason}")]);
}

/// `[DSC-03]`: frames that come twice and late repeat visits after later ones; that is neither a loop nor a second device.
#[test]
fn repeated_visits_are_neither_loops_nor_doubles() {
    for seed in 1..=5 {
        let faults = FaultConfig { duplication: 0.2, reorder: 0.1, loss: 0.05, seed, ..FaultConfig::default() };
        let map = scan(SimNetwork::ring(6, LinkModel { faults: Some(faults), ..LinkModel::WIRE }, seed)).map;
        assert_eq!(found_ids(&map), ids(6), "seed {seed}");
        let expected = 7; // six of the ring, one to the host
        assert_eq!(map.links.len(), expected, "seed {seed}: {}", map.tree());
    }
}

/// `[PKT-11]`: a wire so slow that no time to live could do is told with its sum, and nothing is sent over it.
#[test]
fn a_wire_that_is_too_slow_is_told_with_its_sum() {
    let slow = osap_runtime::GatewayConfig { bit_rate: 9_600, ..UART };
    let build = |world: &mut World| {
        let far: Factory = Box::new(move |boot: Boot<'_>| -> Box<dyn Endpoint> {
            sim_device(&kind::MOTOR, unique_id(1), boot.epoch, "far", &[slow])
        });
        let near: Factory = Box::new(move |boot: Boot<'_>| -> Box<dyn Endpoint> {
            sim_device(&kind::HUB, unique_id(2), boot.epoch, "near", &[UART, slow])
        });
        let clock = osap_sim::time::ClockModel::PERFECT;
        let instant = osap_sim::processor::Processor::INSTANT;
        let [far, near] = [far, near].map(|factory| world.add_device(factory, instant, clock));
        let gateway = GatewayIndex::from_low_bits;
        let link = world.connect((near, gateway(1)), (far, gateway(0)), LinkModel::WIRE);
        (Some((near, 0)), vec![link])
    };
    let map = scan(SimNetwork::shape(SEED, LinkModel::WIRE, 1, build)).map;
    assert_eq!(map.devices.len(), 2);
    let [Finding::TooSlow { route, need_us, .. }] = &map.findings[..] else { panic!("{:?}", findings(&map)) };
    assert_eq!(route.to_string(), "/0/1");
    // 23 and 105 bytes of packet, with check, stuffing and delimiter, of ten bits at 9600 bit/s
    assert!((130_000..150_000).contains(need_us), "{need_us}");
}

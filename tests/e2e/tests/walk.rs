//! The README's walk of one packet, compared with what the simulator saw a packet do.

use firmware_app::kind;
use fixed_math::time::Span;
use osap_protocol::header::Arrival;
use osap_protocol::transport::{Sequence, SequencedHeader, SequencedKind, Transport};
use osap_protocol::{GatewayIndex, PortIndex, RouteBuf, Step};
use osap_runtime::{Mailbox, Outbound};
use osap_sim::device::SimDevice;
use osap_sim::machines::{RP2040_200_MHZ, UART, add_device};
use osap_sim::time::ClockModel;
use osap_sim::world::{LinkModel, NodeId, World};
use std::path::Path;

fn gateway(index: u8) -> GatewayIndex {
    GatewayIndex::new(index).expect("below 64")
}

/// A sender, a hub and a device in a row, settled.
fn line(world: &mut World) -> [NodeId; 3] {
    let mut add = |kind, name, gateways: &[_]| {
        add_device(world, kind, name, gateways.to_vec(), RP2040_200_MHZ, ClockModel::PERFECT)
    };
    let sender = add(&kind::MOTOR, "sender", &[UART]);
    let hub = add(&kind::HUB, "hub", &[UART, UART]);
    let device = add(&kind::MOTOR, "device", &[UART]);
    // a microsecond of cable and level shifters, so that a frame has left before it has arrived
    let cable = LinkModel { latency: Span::from_us(1), ..LinkModel::WIRE };
    world.connect((sender, gateway(0)), (hub, gateway(0)), cable);
    world.connect((hub, gateway(1)), (device, gateway(0)), cable);
    world.run_for(Span::from_us(10_000));
    [sender, hub, device]
}

/// Sends one request from the sender's port 1 to the device's echo port.
fn ask(world: &mut World, sender: NodeId) {
    let mut route = RouteBuf::new();
    for index in [0, 1] {
        route.push(Step::Link(gateway(index))).expect("short");
    }
    let port = PortIndex::new(1).expect("below 2048");
    let to = Outbound {
        route: route.as_route(),
        mtu_bytes: 256,
        ttl_us: 20_000,
        destination: port,
        transport: Transport::Sequenced,
    };
    let header = SequencedHeader { kind: SequencedKind::Request, sequence: Sequence::new(1) }.encode();
    let now = world.local_now(sender);
    let device = world.endpoint_mut::<SimDevice>(sender).expect("a device");
    device.node_mut().send(port, to, &[&header, b"walk"], now).expect("sent");
    world.poke(sender);
}

/// Every stage the README names, in its order, is one that a request passes on its way to its reply; and no stage is left out.
#[test]
fn the_readme_tells_the_walk_that_the_simulator_saw() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let told = tidy::readme_walk(&root).expect("the README tells the walk");

    let mut world = World::new(1);
    let [sender, hub, device] = line(&mut world);
    world.record_walk(true);
    ask(&mut world, sender);
    world.run_for(Span::from_us(5_000));

    let walk = world.walk();
    let mut distinct: Vec<&str> = Vec::new();
    for event in walk {
        if !distinct.contains(&event.stage.name()) {
            distinct.push(event.stage.name());
        }
    }
    assert_eq!(distinct, told, "the README on the right");

    // and the whole of it, node by node: there through the hub, and back by the same way
    let forward = ["captured", "handed-over", "deframed", "ingress", "route", "stack", "egress", "sent"];
    let mut expected: Vec<(NodeId, &str)> = ["stack", "egress", "sent"].map(|stage| (sender, stage)).to_vec();
    expected.extend(forward.map(|stage| (hub, stage)));
    expected.extend(
        [
            "captured",
            "handed-over",
            "deframed",
            "ingress",
            "route",
            "stack",
            "deliver",
            "reply",
            "stack",
            "egress",
            "sent",
        ]
        .map(|stage| (device, stage)),
    );
    expected.extend(forward.map(|stage| (hub, stage)));
    let seen: Vec<(NodeId, &str)> =
        walk.iter().map(|event| (event.node, event.stage.name())).take(expected.len()).collect();
    assert_eq!(seen, expected);
}

/// The same walk for a packet that never gets there says where it ended: after its last stage there is a drop, and its name is a counter.
#[test]
fn a_walk_that_ends_early_ends_in_a_counter() {
    let mut world = World::new(1);
    let [_, hub, device] = line(&mut world);
    world.record_walk(true);
    let now = world.local_now(hub);
    let node = world.endpoint_mut::<SimDevice>(hub).expect("a device").node_mut();
    let mut packet = [5, 0xff, 0xff, 64, 0, 0x40, 0x49, 0xc0, 0x08, 1, 0];
    let dropped = node.receive(Arrival::Link(gateway(0)), &mut packet, now, now).expect_err("gateway 9 is not there");
    assert_eq!(node.counters().of(dropped), 1);
    world.poke(hub);
    world.run_for(Span::from_us(1_000));
    assert!(world.walk().iter().all(|event| event.node != device));
    assert_eq!(world.walk().last().map(|event| event.stage.name()), Some("ingress"));
}

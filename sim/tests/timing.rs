//! Time in the world: wires, processors, clocks, and what they take off a packet's time to live.

mod common;

use common::{add_probe, assert_all_slots_home, gateway, hush, over, probe, query, timeless, us, with_probe};
use firmware_app::kind;
use fixed_math::time::LocalTicks;
use osap_protocol::discovery::Query;
use osap_protocol::{BusDrop, Packet, RouteBuf, Step};
use osap_runtime::GatewayConfig;
use osap_runtime::sequenced::Destination;
use osap_sim::capture::{Capture, Direction};
use osap_sim::machines::shapes::bus_gateway;
use osap_sim::machines::{UART, USB_HIGH_SPEED, add_device};
use osap_sim::processor::Processor;
use osap_sim::time::{ClockModel, TrueTime};
use osap_sim::world::{BusModel, LinkModel, World};
use std::sync::{Arc, Mutex};

const SLOW: Processor = Processor { name: "slow", clock_hz: 0, receive: us(30), handle: us(50), forward: us(20) };

/// `[PKT-10]`, `[DSC-07]`: a time query over one link is 13 bytes there and 75 back; each takes its framed bytes at 10/3 µs, and the
/// device's processor what it was given.
#[test]
fn a_round_trip_is_wire_time_and_processing_to_the_step() {
    let mut world = World::new(1);
    let host = add_probe(&mut world, &[UART]);
    let device = add_device(&mut world, &kind::MOTOR, "m", vec![UART], SLOW, ClockModel::PERFECT);
    world.connect((host, gateway(0)), (device, gateway(0)), LinkModel::WIRE);
    hush(&mut world);
    with_probe(&mut world, host, |it, now| it.ask(over(&[0], 0, 20_000), &query(Query::TimeControl), now));
    world.run_for(us(5_000));
    let answer = &probe(&world, host).answers[0];
    // header 9, step 1, sequence 2, key and version 2; the answer's 65 bytes instead of the last four; framing adds 4
    let query_wire = UART.wire_time(14);
    let answer_wire = UART.wire_time(75);
    assert_eq!(query_wire.steps(), (18 * 10 * 256u64).div_ceil(3));
    assert_eq!(answer_wire.steps(), (79 * 10 * 256u64).div_ceil(3));
    assert_eq!(answer.payload.len(), 63);
    assert_eq!(answer.round_trip, query_wire + answer_wire + SLOW.total());
    world.run_for(us(100_000));
    assert_all_slots_home(&world);
}

/// The thesis's 76-byte reply at 3 Mbaud: 80 bytes framed, 266.67 µs.
#[test]
fn seventy_six_bytes_take_266_67_microseconds() {
    let wire = UART.wire_time(76);
    assert_eq!(wire.steps(), (80 * 10 * 256u64).div_ceil(3)); // 68266.67 of 1/256 µs, rounded up
    let mut world = World::new(1);
    let host = add_probe(&mut world, &[UART]);
    let other = add_probe(&mut world, &[UART]);
    let link = world.connect((host, gateway(0)), (other, gateway(0)), LinkModel::WIRE);
    hush(&mut world);
    let sent_at = world.now();
    with_probe(&mut world, host, |it, now| it.datagram(&over(&[0], 1, 20_000), &[0; 66], now).unwrap()); // 9 + 1 + 66
    let bytes_before = world.link_stats(link)[0].bytes - 80;
    world.run_for(us(1_000));
    assert_eq!(world.link_stats(link)[0].bytes, bytes_before + 80);
    let (arrived, _) = probe(&world, other).datagrams[0];
    assert_eq!(arrived.steps(), sent_at.steps() + wire.steps());
}

/// `[NOD-12]`: a node 50 ppm fast sees 50 µs more a second; its neighbour does not.
#[test]
fn clocks_drift_as_they_are_told() {
    let mut world = World::new(1);
    let fast = ClockModel::off_by(50.0);
    let a = add_device(&mut world, &kind::MOTOR, "fast", vec![UART], SLOW, fast);
    let b = add_device(&mut world, &kind::MOTOR, "true", vec![UART], SLOW, ClockModel::PERFECT);
    world.connect((a, gateway(0)), (b, gateway(0)), LinkModel::WIRE);
    world.run_until(TrueTime::from_us(1_000_000));
    assert_eq!(world.local_now(a).as_us(), 1_000_050);
    assert_eq!(world.local_now(b).as_us(), 1_000_000);
}

/// `[PKT-10]`: what each egress takes off is residence and coming wire, rounded up together: read off the wire at three hops, and
/// worked out here from the processors' times alone.
#[test]
fn the_ttl_loses_residence_and_wire_at_every_hop() {
    let mut world = World::new(1);
    let host = add_probe(&mut world, &[UART]);
    let uarts: Vec<GatewayConfig> = vec![UART, UART];
    let mut last = (host, gateway(0));
    let seen = Arc::new(Mutex::new(Vec::new()));
    for _ in 0..3 {
        let hub = add_device(&mut world, &kind::HUB, "hub", uarts.clone(), SLOW, ClockModel::PERFECT);
        let link = world.connect(last, (hub, gateway(0)), LinkModel::WIRE);
        let seen = Arc::clone(&seen);
        world.tap_link(
            link,
            Box::new(move |event| {
                let packet = Packet::check(event.packet).unwrap();
                if event.way == 0 && event.packet.len() == 32 {
                    seen.lock().unwrap().push(packet.ttl_us());
                }
            }),
        );
        last = (hub, gateway(1));
    }
    hush(&mut world);
    // 9 bytes of header, 3 steps, 20 of payload: 32 bytes; 36 framed: exactly 120 µs
    with_probe(&mut world, host, |it, now| it.datagram(&over(&[0, 1, 1], 1, 5_000), &[0; 20], now).unwrap());
    world.run_for(us(3_000));
    let wire = UART.wire_time(32);
    assert_eq!(wire, us(120));
    let hop = (SLOW.receive + SLOW.forward + wire).as_us_ceil();
    assert_eq!(hop, 170);
    assert_eq!(*seen.lock().unwrap(), [5_000 - 120, 5_000 - 120 - 170, 5_000 - 120 - 340]);
    world.run_for(us(100_000));
    assert_all_slots_home(&world);
}

/// `[PKT-10]`: a node whose clock is 5 % slow takes off 5 % less for residence, and the same for the wire.
#[test]
fn residence_is_measured_by_the_nodes_own_clock() {
    let slow = ClockModel::off_by(-50_000.0);
    let mut world = World::new(1);
    // questions for the time would wait for this processor too, and packets behind them
    let uart = timeless(UART);
    let host = add_probe(&mut world, &[uart]);
    let resting = Processor { receive: us(1_000), forward: us(1_000), ..SLOW };
    let hub = add_device(&mut world, &kind::HUB, "hub", vec![uart, uart], resting, slow);
    let far = add_probe(&mut world, &[uart]);
    world.connect((host, gateway(0)), (hub, gateway(0)), LinkModel::WIRE);
    let link = world.connect((hub, gateway(1)), (far, gateway(0)), LinkModel::WIRE);
    world.run_for(us(10_000));
    let seen = Arc::new(Mutex::new(Vec::new()));
    let tapped = Arc::clone(&seen);
    world.tap_link(
        link,
        Box::new(move |event| tapped.lock().unwrap().push(Packet::check(event.packet).unwrap().ttl_us())),
    );
    with_probe(&mut world, host, |it, now| it.datagram(&over(&[0, 1], 1, 9_000), &[0; 21], now).unwrap());
    world.run_for(us(5_000));
    // 32 bytes: 120 µs on each wire; 2000 µs of residence read as 1900; the first wire's 120 µs were not lengthened by the slow clock,
    // but the node takes the nominal 120 µs off its 114 µs: 6 µs of residence are not seen
    let left = seen.lock().unwrap()[0];
    assert_eq!(left, 9_000 - 120 - (1_900 - 6) - 120);
}

/// `[PKT-10]`, `[FRM-10]`: on a bus the wire's time includes the two addresses.
#[test]
fn the_ttl_loses_a_buss_addresses_too() {
    let mut world = World::new(1);
    let nodes = [1, 2].map(|drop| add_probe(&mut world, &[bus_gateway(drop)]));
    world.bus(&nodes.map(|node| (node, gateway(0))), BusModel::default());
    world.run_for(us(20_000));
    let mut route = RouteBuf::new();
    route.push(Step::Bus { gateway: gateway(0), drop: BusDrop(2) }).unwrap();
    let there = Destination { route, ..over(&[], 1, 5_000) };
    let sent_at = world.now();
    with_probe(&mut world, nodes[0], |it, now| it.datagram(&there, &[0; 29], now).unwrap());
    world.run_for(us(2_000));
    // 9 bytes of header, 2 of route, 29 of payload; addresses 2, check 2, stuffing and delimiter 2: 46 bytes of 10 µs
    let far = probe(&world, nodes[1]);
    assert_eq!(far.datagrams[0].0.as_us(), sent_at.as_us() + 460);
    assert_eq!(far.ttls_us, [5_000 - 460]);
}

/// Jitter delays frames; it does not reorder those of one link, and none is on the wire before the one in front has left it.
#[test]
fn jitter_alone_keeps_the_order() {
    let mut world = World::new(4);
    let nodes = [1, 2].map(|_| add_probe(&mut world, &[USB_HIGH_SPEED]));
    let model = LinkModel { jitter: us(500), latency: us(10), ..LinkModel::WIRE };
    world.connect((nodes[0], gateway(0)), (nodes[1], gateway(0)), model);
    hush(&mut world);
    for number in 0..200u8 {
        with_probe(&mut world, nodes[0], |it, now| it.datagram(&over(&[0], 1, 9_000), &[number], now).unwrap());
        world.run_for(us(50));
    }
    world.run_for(us(2_000));
    let order: Vec<u8> = probe(&world, nodes[1]).datagrams.iter().map(|(_, payload)| payload[0]).collect();
    assert_eq!(order, (0..200).collect::<Vec<u8>>());
}

/// A capture of a link, by its tap: each packet once, with its direction, in order of time.
#[test]
fn a_link_can_be_captured() {
    let mut world = World::new(1);
    let nodes = [1, 2].map(|_| add_probe(&mut world, &[UART]));
    let link = world.connect((nodes[0], gateway(0)), (nodes[1], gateway(0)), LinkModel::WIRE);
    let mut capture = Capture::new(Vec::new()).unwrap();
    let interface = capture.add_interface("uart", UART.bit_rate).unwrap();
    let capture = Arc::new(Mutex::new(capture));
    let shared = Arc::clone(&capture);
    world.tap_link(
        link,
        Box::new(move |event| {
            let direction = if event.way == 0 { Direction::Sent } else { Direction::Received };
            let at = LocalTicks::from_steps(event.at.steps());
            shared.lock().unwrap().packet(interface, at, direction, event.packet).unwrap();
        }),
    );
    world.run_for(us(20_000));
    let marker = b"seen on the wire";
    with_probe(&mut world, nodes[0], |it, now| it.datagram(&over(&[0], 1, 9_000), marker, now).unwrap());
    drop(world);
    let bytes = Arc::into_inner(capture).unwrap().into_inner().unwrap().into_inner();
    let found = bytes.windows(marker.len()).filter(|window| window == marker).count();
    assert_eq!(found, 1);
}

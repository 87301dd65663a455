//! A packet's way through nodes: forwarding, time to live, MTU, holds, displacement, every drop under its name.

mod common;

use common::{BYTES, FAST, SLOTS, TestNode, UART, USER, carry, datagram, gateway, link, node, port, read, us};
use osap_protocol::discovery::GatewayKind;
use osap_protocol::framing::{Check, Deframer, encode};
use osap_protocol::header::Arrival;
use osap_protocol::{BusDrop, DropCause, Packet};
use osap_runtime::ring::RxRing;
use osap_runtime::{GatewayConfig, Mailbox, SendError};

/// Three nodes in a line, 0 –(0:0)– 1 –(1:0)– 2.
#[expect(clippy::large_stack_arrays, reason = "three nodes, on the stack of a test")]
fn line(config: GatewayConfig) -> [TestNode; 3] {
    [node(0, &[config]), node(1, &[config, config]), node(2, &[config])]
}

/// `[PKT-07]`, `[PKT-09]`, `[NOD-07]`: there by two links, and back in the same slot by the reversed route.
#[test]
fn a_datagram_and_its_reply_cross_two_links() {
    let [mut a, mut b, mut c] = line(FAST);
    let now = us(5);
    datagram(&mut a, &[link(0), link(1)], USER, 1000, b"there", now).unwrap();
    assert_eq!(carry((&mut a, 0), (&mut b, 0), now), Some(Ok(())));
    assert_eq!(carry((&mut b, 1), (&mut c, 0), now), Some(Ok(())));
    let delivery = c.take(port(USER), now).unwrap();
    assert_eq!(c.payload(&delivery), b"there");
    c.reply(delivery, &[b"and ", b"back"], now).unwrap();
    assert_eq!(carry((&mut c, 0), (&mut b, 1), now), Some(Ok(())));
    assert_eq!(carry((&mut b, 0), (&mut a, 0), now), Some(Ok(())));
    let delivery = a.take(port(USER), now).unwrap();
    assert_eq!(delivery.source, port(USER));
    assert_eq!(read(&mut a, delivery, now), b"and back");
    for node in [&a, &b, &c] {
        assert_eq!((node.free_slots(), node.counters().total()), (SLOTS, 0));
    }
}

/// `[PKT-10]`: worked by hand. 20 bytes of packet at 3 Mbaud: 20 + 2 CRC + 1 COBS + 1 delimiter = 24 bytes, 80 µs. Made at 0 with 1000 µs, it
/// leaves at 10 µs with 1000 − 10 − 80 = 910. Its frame ends at 90 µs; b forwards it at 150 µs: 910 − 60 − 80 = 770.
#[test]
fn ttl_counts_residence_and_wire_time_once_each() {
    let [mut a, mut b, _] = line(UART);
    let mut packet = [0; BYTES];
    datagram(&mut a, &[link(0), link(1)], USER, 1000, &[0; 9], us(0)).unwrap();
    let out = a.transmit(gateway(0), us(10), &mut packet).unwrap();
    assert_eq!(out.len, 20);
    assert_eq!(Packet::check(&packet[..20]).unwrap().ttl_us(), 910);
    b.receive(Arrival::Link(gateway(0)), &mut packet[..20], us(10), us(95)).unwrap();
    let out = b.transmit(gateway(1), us(150), &mut packet).unwrap();
    assert_eq!(Packet::check(&packet[..out.len]).unwrap().ttl_us(), 770);
}

/// `[PKT-13]`: the deadline belongs to the exchange. 200 µs after a request of 1000 µs arrived, its reply leaves with 800, and 800 µs later it is too late.
#[test]
fn a_reply_has_what_is_left_of_its_request() {
    for (waits_us, left) in [(200, Some(800)), (999, Some(1)), (1_000, None)] {
        let [mut a, mut b, _] = line(FAST);
        datagram(&mut a, &[link(0)], USER, 1000, b"?", us(0)).unwrap();
        assert_eq!(carry((&mut a, 0), (&mut b, 0), us(0)), Some(Ok(())));
        let delivery = b.take(port(USER), us(0)).unwrap();
        b.reply(delivery, &[b"!"], us(waits_us)).unwrap();
        let mut packet = [0; BYTES];
        let out = b.transmit(gateway(0), us(waits_us), &mut packet);
        assert_eq!(out.map(|out| Packet::check(&packet[..out.len]).unwrap().ttl_us()), left);
        assert_eq!(b.counters().of(DropCause::Expired), u32::from(left.is_none()));
    }
}

/// `[PKT-10]`, `[NOD-04]`, `[NOD-12]`: what could only arrive late is dropped, also when the loop stalls for seconds.
#[test]
fn late_packets_are_dropped_and_counted() {
    let [mut a, mut b, _] = line(UART);
    datagram(&mut a, &[link(0)], USER, 100, &[0; 9], us(0)).unwrap();
    // 97.3 µs later nothing is left after 76.7 µs of wire
    assert_eq!(carry((&mut a, 0), (&mut b, 0), us(30)), None);
    assert_eq!(a.counters().of(DropCause::Expired), 1);

    datagram(&mut a, &[link(0)], USER, 60_000, b"x", us(100)).unwrap();
    a.run(us(100 + 59_999));
    assert_eq!(a.stacked(), 1);
    let stalled = us(5_000_100); // five seconds: an earlier implementation lost time past one
    a.run(stalled);
    assert_eq!((a.stacked(), a.counters().of(DropCause::Expired)), (0, 2));
    assert_eq!(a.free_slots(), SLOTS);
    let info: osap_protocol::discovery::RuntimeInfo = common::ask(
        &mut a,
        osap_protocol::discovery::Query::RuntimeInfo,
        &osap_protocol::discovery::ScanId::default(),
        stalled,
    )
    .unwrap();
    assert_eq!(info.uptime_us, 5_000_100);
}

/// `[NOD-03]`, `[NOD-06]`: earliest deadline first, equal ones in order.
#[test]
fn the_earliest_deadline_leaves_first() {
    let [mut a, ..] = line(FAST);
    for (ttl_us, name) in [(9000, b"c"), (3000, b"a"), (9000, b"d"), (5000, b"b")] {
        datagram(&mut a, &[link(0)], USER, ttl_us, name, us(0)).unwrap();
    }
    let mut packet = [0; BYTES];
    let mut order = Vec::new();
    while let Some(out) = a.transmit(gateway(0), us(1), &mut packet) {
        order.push(packet[out.len - 1]);
    }
    assert_eq!(order, b"abcd");
}

/// `[NOD-01]`, `[NOD-05]`: a full hold keeps the earliest deadlines; each refusal and displacement is counted.
#[test]
fn a_full_hold_gives_way_to_earlier_deadlines_only() {
    let [mut a, mut b, _] = line(FAST);
    let now = us(1);
    for ttl in [8000, 7000, 6000, 5000] {
        datagram(&mut a, &[link(0), link(1)], USER, ttl, b"telemetry", now).unwrap();
        assert_eq!(carry((&mut a, 0), (&mut b, 0), now), Some(Ok(())));
    }
    assert!(!b.clear_to_receive(gateway(0)));
    datagram(&mut a, &[link(0), link(1)], USER, 9000, b"later", now).unwrap();
    assert_eq!(carry((&mut a, 0), (&mut b, 0), now), Some(Err(DropCause::HoldFull)));
    datagram(&mut a, &[link(0), link(1)], USER, 1000, b"command", now).unwrap();
    assert_eq!(carry((&mut a, 0), (&mut b, 0), now), Some(Ok(())));
    assert_eq!((b.counters().of(DropCause::HoldFull), b.counters().of(DropCause::Displaced)), (1, 1));
    let mut packet = [0; BYTES];
    let out = b.transmit(gateway(1), now, &mut packet).unwrap();
    assert!(packet[..out.len].ends_with(b"command"));
    let mut left = 0;
    while b.transmit(gateway(1), now, &mut packet).is_some() {
        left += 1;
    }
    assert_eq!((left, b.free_slots()), (3, SLOTS));
}

/// `[NOD-05]`: the pool may be smaller than the sum of the holds. Then `pool-full` says so to what is due last, and an owner within its hold
/// gets a slot for what is due earlier, whoever has the later packets.
#[test]
fn a_full_pool_keeps_nobody_out() {
    let mut b = node(1, &[FAST, FAST, FAST]);
    let mut a = node(0, &[FAST]);
    let now = us(1);
    let mut send = |b: &mut TestNode, into, ttl_us, data: &[u8]| {
        datagram(&mut a, &[link(0), link(2)], USER, ttl_us, data, now).unwrap();
        carry((&mut a, 0), (b, into), now)
    };
    for into in [0, 1] {
        for _ in 0..4 {
            assert_eq!(send(&mut b, into, 60_000, b"telemetry"), Some(Ok(())));
        }
    }
    assert!(!b.clear_to_receive(gateway(2)));
    assert_eq!(send(&mut b, 2, 60_000, b"no earlier"), Some(Err(DropCause::PoolFull)));
    assert_eq!(send(&mut b, 2, 1_000, b"command"), Some(Ok(())));
    assert_eq!((b.counters().of(DropCause::PoolFull), b.counters().of(DropCause::Displaced)), (1, 1));
    let mut packet = [0; BYTES];
    let out = b.transmit(gateway(2), now, &mut packet).unwrap();
    assert!(packet[..out.len].ends_with(b"command"));
}

/// `[NOD-05]`, `[NOD-04]`: what was late when it was read, or cannot be in time on the coming wire, displaces nothing.
#[test]
fn hopeless_packets_displace_nothing() {
    let mut b = node(1, &[FAST, UART]);
    let make = |ttl_us: u16, len: usize| {
        let [low, high] = ttl_us.to_le_bytes();
        let mut packet = vec![5, low, high, 0, 1, 0x40, 0x41, 0xc0, 0x28, 1, 0];
        packet.resize(packet.len() + len, 1);
        packet
    };
    for _ in 0..4 {
        assert_eq!(b.receive(Arrival::Link(gateway(0)), &mut make(60_000, 9), us(9_000), us(9_000)), Ok(()));
    }
    // stamped at 1 ms with 1 ms to live, read at 10 ms; and 20 µs to live where the wire takes 300 µs
    for (ttl_us, len, started) in [(1_000, 9, 1_000), (20, 80, 10_000)] {
        let received = b.receive(Arrival::Link(gateway(0)), &mut make(ttl_us, len), us(started), us(10_000));
        assert_eq!(received, Err(DropCause::Expired));
    }
    assert_eq!((b.stacked(), b.counters().of(DropCause::Displaced), b.counters().of(DropCause::Expired)), (4, 0, 2));
}

/// `[NOD-08]`: where a route ends, what stands before the pointer must be a way back, or nothing could be answered.
#[test]
fn a_way_that_is_none_is_refused_before_anything_is_done() {
    let mut c = node(2, &[FAST]);
    // byte 5 is a port instruction's first; then a step, port 1 → 0, request 7, set runtime name "bad"
    let mut packet = [6, 0xff, 0xff, 64, 0, 0xc0, 0x40, 0xc0, 0x08, 0x00, 1, 7, 0, 4, 1, 3, b'b', b'a', b'd'];
    let received = c.receive(Arrival::Link(gateway(0)), &mut packet, us(1), us(1));
    assert_eq!(received, Err(DropCause::PointerOutside));
    c.run(us(1));
    assert_eq!(c.name(), "node2");
}

/// `[PKT-12]`: a reply keeps within the request's MTU field, which may be less than a slot.
#[test]
fn a_reply_keeps_within_the_requests_mtu() {
    for (reply, fits) in [(54, true), (55, false)] {
        let mut a = node(0, &[FAST]);
        let mut packet = [5, 0xff, 0xff, 64, 0, 0x40, 0xc0, 0x28, 1, 0, 7];
        a.receive(Arrival::Link(gateway(0)), &mut packet, us(0), us(0)).unwrap();
        let delivery = a.take(port(USER), us(0)).unwrap();
        let result = a.reply(delivery, &[&vec![7; reply]], us(0));
        assert_eq!(result, if fits { Ok(()) } else { Err(SendError::TooLong { len: 65, limit: 64 }) });
    }
}

/// `[NOD-04]`: a port never gets what is late, also when nothing else was done since.
#[test]
fn a_port_never_gets_a_late_packet() {
    let mut a = node(0, &[]);
    datagram(&mut a, &[], USER, 100, b"late", us(0)).unwrap();
    assert!(a.take(port(USER), us(100)).is_none());
    assert_eq!(a.counters().of(DropCause::Expired), 1);
}

/// `[SYS-03]`: a gateway that could not carry an announcement is none.
#[test]
fn a_gateway_carries_at_least_an_announcement() {
    let mut a = TestNode::new(common::identity(1), "a");
    assert_eq!(a.add_gateway(GatewayConfig { mtu_bytes: 31, ..FAST }), None);
    let index = a.add_gateway(GatewayConfig { mtu_bytes: 32, ..FAST }).unwrap();
    a.set_open(index, true, us(0));
    assert!(a.transmit(index, us(0), &mut [0; BYTES]).is_some_and(|out| out.len <= 32));
}

/// `[NOD-11]`, `[PKT-11]`, `[PKT-12]`, `[PKT-08]`: what cannot work is refused before anything is held.
#[test]
fn what_cannot_be_sent_is_refused_typed() {
    let mut a = node(0, &[UART, GatewayConfig { mtu_bytes: 64, ..FAST }]);
    a.set_open(gateway(1), false, us(0));
    let now = us(1);
    let mut send = |steps: &[_], ttl, len: usize| datagram(&mut a, steps, USER, ttl, &vec![0; len], now);
    assert_eq!(send(&[link(0)], 1000, 300), Err(SendError::TooLong { len: 310, limit: 256 }));
    // 20 bytes: 80 µs on the wire, and one more to arrive with
    assert_eq!(send(&[link(0)], 80, 10), Err(SendError::TtlTooShort { need_us: 81, ttl_us: 80 }));
    assert_eq!(send(&[link(0)], 0, 10), Err(SendError::TtlTooShort { need_us: 81, ttl_us: 0 }));
    assert_eq!(send(&[link(1)], 1000, 10), Err(SendError::Refused(DropCause::GatewayClosed)));
    assert_eq!(send(&[link(3)], 1000, 10), Err(SendError::Refused(DropCause::NoSuchGateway)));
    assert_eq!(send(&[common::bus(0, 4)], 1000, 10), Err(SendError::Refused(DropCause::WrongGatewayKind)));
    a.set_open(gateway(1), true, now);
    assert_eq!(datagram(&mut a, &[link(1)], USER, 1000, &[0; 60], now), Err(SendError::Refused(DropCause::OverMtu)));
    assert_eq!(a.free_slots(), SLOTS);
    assert_eq!((a.counters().of(DropCause::SendRefused), a.counters().total()), (3, 7));
}

/// `[PKT-14]`: a route without steps stays in the node.
#[test]
fn a_local_packet_is_delivered_and_answered_here() {
    let mut a = node(0, &[]);
    datagram(&mut a, &[], USER, 1000, b"me", us(0)).unwrap();
    let delivery = a.take(port(USER), us(1)).unwrap();
    assert_eq!((a.payload(&delivery), a.taken_steps(&delivery).len()), (&b"me"[..], 0));
    a.reply(delivery, &[b"myself"], us(1)).unwrap();
    let delivery = a.take(port(USER), us(2)).unwrap();
    assert_eq!(read(&mut a, delivery, us(2)), b"myself");
    assert_eq!(a.free_slots(), SLOTS);
}

/// Every ingress drop, each by a packet made for it, each under its name and nothing left held.
#[test]
fn bad_packets_are_dropped_under_their_names() {
    let mut b = node(1, &[FAST, GatewayConfig { kind: GatewayKind::Bus { drop: 3 }, ..FAST }]);
    let by_link = Arrival::Link(gateway(0));
    let by_bus = Arrival::Bus { gateway: gateway(1), from: BusDrop(8) };
    let long = {
        let mut long = vec![5, 0xff, 0xff, 0xff, 0xff, 0x40, 0xc0, 0, 1, 0];
        long.resize(300, 0);
        long
    };
    let cases: &[(DropCause, Arrival, &[u8])] = &[
        (DropCause::Short, by_link, &[5, 1, 0, 64, 0]),
        (DropCause::PointerOutside, by_link, &[4, 1, 0, 64, 0, 0x40, 0x02]),
        (DropCause::PointerOutside, by_link, &[7, 1, 0, 64, 0, 0x40, 0x02]),
        (DropCause::PointerOutside, by_link, &[5, 1, 0, 64, 0, 0x40]),
        (DropCause::InstructionCut, by_link, &[5, 1, 0, 64, 0, 0x40, 0xc0, 0]),
        (DropCause::TransportMissing, by_link, &[5, 1, 0, 64, 0, 0x40, 0xc0, 0, 1]),
        (DropCause::NotForwarding, by_link, &[5, 1, 0, 64, 0, 0x80, 1, 0xc0, 0, 1, 0]),
        (DropCause::NotForwarding, by_bus, &[5, 1, 0, 64, 0, 0x40, 0xc0, 0, 1, 0]),
        (DropCause::NotForwarding, by_link, &[5, 1, 0, 64, 0, 0xc0, 0, 1, 0]),
        (DropCause::NoSuchGateway, by_link, &[5, 1, 0, 64, 0, 0x40, 0x47, 0xc0, 0, 1, 0]),
        (DropCause::WrongGatewayKind, by_link, &[5, 1, 0, 64, 0, 0x40, 0x41, 0xc0, 0, 1, 0]),
        (DropCause::NoSuchPort, by_link, &[5, 1, 0, 64, 0, 0x40, 0xc0, 0x07, 0xff, 0]),
        (DropCause::OverMtu, by_link, &[5, 1, 0, 9, 0, 0x40, 0xc0, 0, 1, 0]),
        (DropCause::OverMtu, by_link, &long),
        (DropCause::Expired, by_link, &[5, 0, 0, 64, 0, 0x40, 0xc0, 0, 1, 0]),
        (DropCause::UnknownTransport, by_link, &[5, 1, 0, 64, 0, 0x40, 0xc0, 0, 1, 3]),
        (DropCause::TransportMalformed, by_link, &[5, 1, 0, 64, 0, 0x40, 0xc0, 0, 1, 1, 0]),
        (DropCause::TransportMalformed, by_link, &[5, 1, 0, 64, 0, 0x40, 0xc0, 0, 1, 2, 1, 1, 1]),
        (DropCause::SegmentInvalid, by_link, &[5, 1, 0, 64, 0, 0x40, 0xc0, 0, 1, 2, 0, 1, 2, 0, 2, 0, 9]),
        (DropCause::UnknownSystemKey, by_link, &[5, 1, 0, 64, 0, 0x40, 0x09]),
        (DropCause::SystemMalformed, by_link, &[5, 1, 0, 64, 0, 0x40, 0x02, 1, 2, 3]),
    ];
    for (cause, arrival, bytes) in cases {
        let before = b.counters().of(*cause);
        let mut packet = bytes.to_vec();
        assert_eq!(b.receive(*arrival, &mut packet, us(1), us(1)), Err(*cause), "{bytes:?}");
        assert_eq!(b.counters().of(*cause), before + 1);
        assert_eq!(b.free_slots(), SLOTS);
    }
    b.set_open(gateway(0), false, us(1));
    let mut packet = [5, 1, 0, 64, 0, 0x40, 0xc0, 0, 1, 0];
    assert_eq!(b.receive(by_link, &mut packet, us(1), us(1)), Err(DropCause::GatewayClosed));
}

/// A packet that goes round between two nodes does so as often as its route says, and no longer than its TTL: 500 µs in a node, and on a UART
/// some 380 µs on the wire, use up 60 ms in 68 hops; the 68th sees that it cannot go on.
#[test]
fn a_looping_route_ends() {
    for (config, expected_hops, expired) in [(FAST, 100, 0), (UART, 67, 1)] {
        let (mut a, mut b) = (node(0, &[config]), node(1, &[config]));
        datagram(&mut a, &vec![link(0); 100], USER, 60_000, b"", us(0)).unwrap();
        let mut now = 0;
        let mut hops = 0;
        for _ in 0..55 {
            for outward in [true, false] {
                now += 500;
                let [from, to] = if outward { [&mut a, &mut b] } else { [&mut b, &mut a] };
                let mut packet = [0; BYTES];
                while let Some(out) = from.transmit(gateway(0), us(now), &mut packet) {
                    let routed = Packet::check(&packet[..out.len])
                        .is_ok_and(|packet| packet.transport().is_none() && out.len > 40);
                    let taken = to.receive(Arrival::Link(gateway(0)), &mut packet[..out.len], us(now), us(now));
                    assert!(taken == Ok(()) || taken == Err(DropCause::Expired), "{taken:?}");
                    hops += i32::from(routed && taken == Ok(()));
                }
            }
        }
        assert_eq!(hops, expected_hops);
        assert_eq!(a.take(port(USER), us(now)).is_some(), expired == 0, "an even number of hops ends where it began");
        assert_eq!(a.counters().total() + b.counters().total(), expired);
    }
}

/// `gateway-closed`: what waits for a link that is unplugged is dropped, and its slots come home.
#[test]
fn unplugging_drops_what_waits() {
    let [mut a, ..] = line(FAST);
    for _ in 0..3 {
        datagram(&mut a, &[link(0)], USER, 1000, b"x", us(0)).unwrap();
    }
    a.set_open(gateway(0), false, us(1));
    assert_eq!((a.counters().of(DropCause::GatewayClosed), a.free_slots(), a.stacked()), (3, SLOTS, 0));
    assert!(a.transmit(gateway(0), us(1), &mut [0; BYTES]).is_none());
}

/// A reply that does not fit is a typed error and a counted drop, not a lost slot; it was once one byte short instead.
#[test]
fn a_reply_has_exactly_its_length_or_none() {
    let mut a = node(0, &[]);
    for (reply, fits) in [(BYTES - 9, true), (BYTES - 8, false)] {
        datagram(&mut a, &[], USER, 1000, b"q", us(0)).unwrap();
        let delivery = a.take(port(USER), us(0)).unwrap();
        let data = vec![7; reply];
        let result = a.reply(delivery, &[&data], us(0));
        if fits {
            result.unwrap();
            let delivery = a.take(port(USER), us(0)).unwrap();
            assert_eq!(read(&mut a, delivery, us(0)), data);
        } else {
            assert_eq!(result, Err(SendError::TooLong { len: BYTES + 1, limit: BYTES }));
            assert_eq!(a.counters().of(DropCause::SendRefused), 1);
        }
        assert_eq!(a.free_slots(), SLOTS);
    }
}

/// `[NOD-08]`: an earlier implementation walked the list of packets inside the interrupt. Here a frame that has come whole is still nothing to
/// the node, whose stack is full, until the node's own context takes it over.
#[test]
fn an_interrupt_leaves_the_stack_alone() {
    let [mut a, ..] = line(UART);
    for ttl_us in [4000, 3000, 2000, 1000] {
        datagram(&mut a, &[link(0)], USER, ttl_us, b"waits", us(0)).unwrap();
    }
    let mut ring = RxRing::<64, 4>::new();
    let (mut interrupt, mut task) = ring.split();
    let packet = [5, 0x10, 0x00, 64, 0, 0x40, 0xc0, 0x28, USER.to_le_bytes()[0], 0, 7];
    let mut frame = [0; 32];
    let len = encode(&packet, Check::Crc16, &mut frame).unwrap();
    for byte in &frame[..len] {
        interrupt.push(*byte, us(1));
        assert_eq!((a.stacked(), a.free_slots()), (4, SLOTS - 4));
    }
    let mut deframer = Deframer::<64>::new(Check::Crc16);
    task.drain(&mut deframer, |frame| {
        let frame = frame.unwrap();
        assert_eq!(a.receive(Arrival::Link(gateway(0)), frame.packet, frame.started, us(2)), Ok(()));
    });
    assert_eq!(a.stacked(), 5);
}

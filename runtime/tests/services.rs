//! What a node answers and notices by itself: the ten queries and the eleventh, scan ids, neighbours, buses.

mod common;

use common::{FAST, TestNode, UART, ask, ask_raw, bus, carry, gateway, identity, node, port, read, us};
use osap_protocol::discovery::{
    CounterPage, DebugPage, Event, GatewayKind, LinkInfo, Name, NeighbourChange, PortInfo, Query, Refusal, RuntimeInfo,
    ScanId, TimeControl, TimeSettings, UniqueId, VERSION, Verbosity,
};
use osap_protocol::header::{Arrival, Terminal, emit};
use osap_protocol::system::{ANNOUNCEMENT_VERSION, Announcement, NEIGHBOUR_TIMEOUT_US, SystemKey};
use osap_protocol::transport::Transport;
use osap_protocol::{BusDrop, DropCause, PortIndex, RouteBuf};
use osap_runtime::{GatewayConfig, Identity, Mailbox, Outbound};

/// `[DSC-01]`: each query has its answer.
#[test]
fn every_query_is_answered() {
    let mut a = node(4, &[UART]);
    let now = us(1_000);
    let info: RuntimeInfo = ask(&mut a, Query::RuntimeInfo, &ScanId { scan: 1, visit: 1 }, now).unwrap();
    assert_eq!((info.unique_id, info.boot_epoch, info.version), (UniqueId([4; 12]), 1, [1, 2, 3]));
    assert_eq!((info.gateways, info.ports, info.packet_bytes_max, info.slots, info.uptime_us), (1, 2, 256, 8, 1_000));
    assert_eq!(ask::<_, Name>(&mut a, Query::TypeName, &(), now).unwrap(), "test");
    assert_eq!(ask::<_, Name>(&mut a, Query::RuntimeName, &(), now).unwrap(), "node4");
    let link: LinkInfo = ask(&mut a, Query::LinkInfo, &0u8, now).unwrap();
    assert_eq!((link.type_name.as_str(), link.open, link.bit_rate, link.neighbour), ("uart", true, 3_000_000, None));
    let ports: PortInfo = ask(&mut a, Query::PortInfo, &1u16, now).unwrap();
    assert_eq!((ports.type_name.as_str(), ports.packet_hold_max), ("user", 4));
    ask::<_, ()>(&mut a, Query::SetDebugVerbosity, &Verbosity::Packets, now).unwrap();
    let page: DebugPage = ask(&mut a, Query::DebugMessages, &0u32, now).unwrap();
    assert_eq!(page.verbosity, Verbosity::Packets);
    assert!(matches!(page.events[0].event, Event::Gateway { gateway: 0, open: true }));
    let time: TimeControl = ask(&mut a, Query::TimeControl, &(), now).unwrap();
    // nobody else is there: it is its own root
    assert_eq!((time.tier, time.interval_us, time.local_ticks_steps), (0, 50_000, 256_000));
    let settings = TimeSettings { interval_us: 20_000, ..osap_runtime::clock::DEFAULT_SETTINGS };
    ask::<_, ()>(&mut a, Query::SetTimeControl, &settings, now).unwrap();
    assert_eq!(ask::<_, TimeControl>(&mut a, Query::TimeControl, &(), now).unwrap().interval_us, 20_000);
    a.count(DropCause::FrameCheck, Some(gateway(0)), now);
    let page: CounterPage = ask(&mut a, Query::Counters, &0u8, now).unwrap();
    assert_eq!((usize::from(page.total), page.values[DropCause::FrameCheck.index()]), (DropCause::COUNT, 1));
}

/// `[DSC-02]`: what cannot be answered is refused with its reason and changes nothing.
#[test]
fn bad_queries_are_refused_with_a_reason() {
    let mut a = node(4, &[UART]);
    let now = us(1);
    let refused = |a: &mut TestNode, bytes: &[u8]| ask_raw(a, bytes, now).unwrap_err();
    assert_eq!(refused(&mut a, &[99, VERSION]), Refusal::UnknownKey.code());
    assert_eq!(refused(&mut a, &[0, VERSION]), Refusal::UnknownKey.code());
    assert_eq!(refused(&mut a, &[3, VERSION + 1]), Refusal::Version.code());
    assert_eq!(refused(&mut a, &[3, VERSION, 9]), Refusal::Body.code());
    assert_eq!(refused(&mut a, &[5, VERSION, 1]), Refusal::Index.code());
    assert_eq!(refused(&mut a, &[6, VERSION, 2]), Refusal::Index.code());
    let mut long_name = vec![4, VERSION, 33];
    long_name.extend([b'x'; 33]);
    assert_eq!(refused(&mut a, &long_name), Refusal::Body.code());
    assert_eq!(refused(&mut a, &[4, VERSION, 2, 0xff, 0xfe]), Refusal::Body.code());
    let mut longer_than_any = vec![3, VERSION];
    longer_than_any.resize(100, 0);
    assert_eq!(refused(&mut a, &longer_than_any), Refusal::Body.code());
    longer_than_any[1] = VERSION + 1;
    assert_eq!(refused(&mut a, &longer_than_any), Refusal::Version.code());
    let settings = TimeSettings { interval_us: 1, ..osap_runtime::clock::DEFAULT_SETTINGS };
    assert_eq!(ask::<_, ()>(&mut a, Query::SetTimeControl, &settings, now), Err(Refusal::Range.code()));
    assert_eq!(a.name(), "node4");
    assert_eq!(a.take_new_name(), None);
}

/// `[DSC-02]`: a datagram to port 0, a reply nobody waits for and a request without a key are drops.
#[test]
fn what_is_no_query_is_dropped() {
    let mut a = node(4, &[]);
    let route = RouteBuf::new();
    let to = |transport| Outbound {
        route: route.as_route(),
        mtu_bytes: 64,
        ttl_us: 100,
        destination: PortIndex::NETRESPONDER,
        transport,
    };
    for (transport, bytes, cause) in [
        (Transport::Datagram, &[1, 2, 3][..], DropCause::QueryMalformed),
        (Transport::Sequenced, &[0, 0x40, 1, 1], DropCause::ReplyUnmatched),
        (Transport::Sequenced, &[0, 0, 1], DropCause::QueryMalformed),
    ] {
        let before = a.counters().of(cause);
        a.send(port(1), to(transport), &[bytes], us(1)).unwrap();
        a.run(us(1));
        assert_eq!((a.counters().of(cause), a.free_slots()), (before + 1, common::SLOTS));
    }
}

/// `[DSC-05]`: a new name holds at once and is handed over once.
#[test]
fn a_new_name_is_kept() {
    let mut a = node(4, &[]);
    let name: Name = "Z Motor".try_into().unwrap();
    ask::<_, ()>(&mut a, Query::SetRuntimeName, &name, us(1)).unwrap();
    assert_eq!(a.name(), "Z Motor");
    assert_eq!(a.take_new_name(), Some("Z Motor"));
    assert_eq!(a.take_new_name(), None);
}

/// `[DSC-03]`: the id before comes back, and a retry gets what the first try got.
#[test]
fn a_repeated_scan_id_gets_the_same_answer() {
    let mut a = node(4, &[]);
    let visit = |visit| ScanId { scan: 9, visit };
    let mut previous = |id| ask::<_, RuntimeInfo>(&mut a, Query::RuntimeInfo, &id, us(1)).unwrap().previous;
    assert_eq!(previous(visit(1)), ScanId::default());
    assert_eq!(previous(visit(1)), ScanId::default());
    assert_eq!(previous(visit(5)), visit(1));
    assert_eq!(previous(visit(5)), visit(1));
    assert_eq!(previous(ScanId { scan: 10, visit: 1 }), visit(5));
}

/// The page that a query for the oldest entries gets over a route of packets of `mtu_bytes`.
fn page<T: serde::de::DeserializeOwned>(node: &mut TestNode, query: Query, mtu_bytes: u16) -> T {
    let route = RouteBuf::new();
    let destination = PortIndex::NETRESPONDER;
    let to = Outbound { route: route.as_route(), mtu_bytes, ttl_us: 100, destination, transport: Transport::Sequenced };
    node.send(port(1), to, &[&[1, 0, query.key(), VERSION, 0]], us(9)).unwrap();
    node.run(us(9));
    let delivery = node.take(port(1), us(9)).unwrap();
    let answer = read(node, delivery, us(9));
    osap_protocol::discovery::decode(&answer).unwrap().body.read().unwrap()
}

/// `[DSC-06]`: a page that would not fit a small MTU is shortened, not refused.
#[test]
fn debug_pages_shrink_to_the_mtu() {
    let mut a = node(4, &[]);
    for n in 0..4 {
        let text = "forty bytes of text, or nearly so many".try_into().unwrap();
        a.debug_mut().record(Verbosity::Events, us(n), || Event::Text(text));
    }
    let page: DebugPage = page(&mut a, Query::DebugMessages, 128);
    assert_eq!((page.first, page.next, page.end, page.events.len()), (0, 2, 4, 2));
}

/// `[DSC-06]`: so are the counters', whose numbers grow longer with time.
#[test]
fn counter_pages_shrink_to_the_mtu() {
    let mut a = node(4, &[]);
    for cause in DropCause::ALL {
        for _ in 0..17_000 {
            a.count(*cause, None, us(0)); // three bytes each
        }
    }
    let page: CounterPage = page(&mut a, Query::Counters, 50);
    assert_eq!((page.first, page.values.len()), (0, 11)); // 50 less 9, 2, 2 and 3 of page: 34 bytes, three each
}

/// Announcements between two nodes until neither has more to say.
fn settle(a: &mut TestNode, b: &mut TestNode, at: u64) {
    for _ in 0..8 {
        let moved = [carry((a, 0), (b, 0), us(at)).is_some(), carry((b, 0), (a, 0), us(at)).is_some()];
        if moved == [false, false] {
            return;
        }
    }
    panic!("announcements never end");
}

/// `[SYS-02]` to `[SYS-04]`: appeared, rebooted, swapped, lost: each an event, once.
#[test]
fn neighbours_come_and_go_as_events() {
    let mut a = node(1, &[UART]);
    let fresh = |number, epoch| {
        let mut b = TestNode::new(Identity { boot_epoch: epoch, ..identity(number) }, "b");
        let index = b.add_gateway(UART).unwrap();
        b.set_open(index, true, us(0));
        b
    };
    let mut change = |b: &mut TestNode, at| {
        settle(&mut a, b, at);
        let change = a.take_neighbour_change().map(|(_, change)| change);
        (
            change,
            a.topology_generation(),
            a.gateway(gateway(0)).unwrap().neighbour().map(|n| (n.unique_id, n.boot_epoch, n.gateway)),
        )
    };
    let mut b = fresh(2, 1);
    assert_eq!(change(&mut b, 10), (Some(NeighbourChange::Appeared), 1, Some((UniqueId([2; 12]), 1, 0))));
    assert_eq!(b.take_neighbour_change(), Some((gateway(0), NeighbourChange::Appeared)));
    assert_eq!(change(&mut b, 250_010).0, None);
    assert_eq!(
        change(&mut fresh(2, 2), 300_000),
        (Some(NeighbourChange::Rebooted), 2, Some((UniqueId([2; 12]), 2, 0)))
    );
    assert_eq!(change(&mut fresh(3, 1), 400_000), (Some(NeighbourChange::Swapped), 3, Some((UniqueId([3; 12]), 1, 0))));
    let silent_at = 400_000 + NEIGHBOUR_TIMEOUT_US;
    a.run(us(silent_at));
    assert_eq!(a.take_neighbour_change(), None);
    a.run(us(silent_at + 1));
    assert_eq!(a.take_neighbour_change(), Some((gateway(0), NeighbourChange::Lost)));
    assert_eq!(a.gateway(gateway(0)).unwrap().neighbour(), None);
}

/// `[SYS-02]`: an announcement that came by more than one step is somebody else's neighbour's.
#[test]
fn a_forwarded_announcement_is_not_believed() {
    let mut a = node(1, &[UART]);
    let announcement = Announcement {
        version: ANNOUNCEMENT_VERSION,
        unique_id: UniqueId([9; 12]),
        boot_epoch: 1,
        wants_answer: true,
        drop: None,
    };
    for (steps, expected) in [(1, Ok(())), (2, Err(DropCause::SystemMalformed))] {
        let mut packet = [0; 64];
        let route = common::route(&vec![common::link(0); steps]);
        let terminal = Terminal::System { key: SystemKey::Announcement.key() };
        let at = emit(&mut packet, 1000, 64, route.as_route(), terminal).unwrap();
        let len = at + announcement.encode(&mut packet[at..]).unwrap();
        packet[0] += u8::try_from(steps - 1).unwrap(); // as it stands after the steps before
        assert_eq!(a.receive(Arrival::Link(gateway(0)), &mut packet[..len], us(1), us(1)), expected);
        assert!(a.gateway(gateway(0)).unwrap().neighbour().is_some());
    }
    assert_eq!(a.topology_generation(), 1);
}

/// `[SYS-04]`: a gateway that closes loses its neighbour at once.
#[test]
fn closing_a_gateway_loses_its_neighbour() {
    let (mut a, mut b) = (node(1, &[UART]), node(2, &[UART]));
    a.set_open(gateway(0), false, us(5));
    a.set_open(gateway(0), true, us(5));
    settle(&mut a, &mut b, 10);
    assert_eq!(a.take_neighbour_change().map(|(_, change)| change), Some(NeighbourChange::Appeared));
    a.set_open(gateway(0), false, us(20));
    assert_eq!(a.take_neighbour_change(), Some((gateway(0), NeighbourChange::Lost)));
}

/// `[SYS-03]`: who asks is answered at once, not at the next interval; and however often it asks, packets get every other turn.
#[test]
fn an_asking_neighbour_is_answered_and_starves_nobody() {
    let mut a = node(1, &[FAST]);
    for n in 0..3 {
        common::datagram(&mut a, &[common::link(0)], 1, 50_000, &[n], us(0)).unwrap();
    }
    let announcement = Announcement {
        version: ANNOUNCEMENT_VERSION,
        unique_id: UniqueId([9; 12]),
        boot_epoch: 1,
        wants_answer: true,
        drop: None,
    };
    let mut order = Vec::new();
    for at in 1..7 {
        let mut packet = [0; 64];
        let terminal = Terminal::System { key: SystemKey::Announcement.key() };
        let start = emit(&mut packet, 1000, 64, common::route(&[common::link(0)]).as_route(), terminal).unwrap();
        let len = start + announcement.encode(&mut packet[start..]).unwrap();
        a.receive(Arrival::Link(gateway(0)), &mut packet[..len], us(at), us(at)).unwrap();
        let mut out = [0; 256];
        let sent = a.transmit(gateway(0), us(at), &mut out).unwrap();
        order.push(if sent.len == 11 { 'p' } else { 'a' });
    }
    assert_eq!(order, ['p', 'a', 'p', 'a', 'p', 'a'], "the node's first announcement went before");
}

/// `[SYS-03]`, `[NOD-12]`: announcements come every interval, once for a loop that stalled, and `next_wake` tells when.
#[test]
fn announcements_keep_their_interval() {
    let mut a = node(1, &[UART]);
    let mut out = [0; 256];
    assert_eq!(a.next_wake(), Some(us(250_000)));
    assert!(a.transmit(gateway(0), us(249_999), &mut out).is_none());
    assert!(!a.has_output(gateway(0), us(249_999)) && a.has_output(gateway(0), us(250_000)));
    assert!(a.transmit(gateway(0), us(3_000_000), &mut out).is_some());
    assert!(a.transmit(gateway(0), us(3_000_000), &mut out).is_none());
    // and what else was due: a root is settled by now, `[TIM-07]`
    a.run(us(3_000_000));
    assert_eq!(a.next_wake(), Some(us(3_250_000)));
}

/// `[PKT-15]`, `[SYS-06]`, `[LNK-03]`: a broadcast query reaches every node of a bus, and each answers by unicast to its asker.
#[test]
fn a_bus_carries_broadcasts_and_unicast_replies() {
    let on_bus = |drop| GatewayConfig { kind: GatewayKind::Bus { drop }, ..FAST };
    let mut a = node(1, &[on_bus(10)]);
    let mut others = [node(2, &[on_bus(20)]), node(3, &[on_bus(30)])];
    let now = us(3);
    let route = common::route(&[bus(0, 255)]);
    let to = Outbound {
        route: route.as_route(),
        mtu_bytes: 200,
        ttl_us: 1000,
        destination: PortIndex::NETRESPONDER,
        transport: Transport::Sequenced,
    };
    a.send(port(1), to, &[&[5, 0, Query::RuntimeName.key(), VERSION]], now).unwrap();
    let mut packet = [0; 256];
    let out = a.transmit(gateway(0), now, &mut packet).unwrap();
    assert_eq!(out.to, Some(BusDrop::BROADCAST));
    for (other, drop) in others.iter_mut().zip([20, 30]) {
        let mut copy = packet;
        other.receive(Arrival::Bus { gateway: gateway(0), from: BusDrop(10) }, &mut copy[..out.len], now, now).unwrap();
        other.run(now);
        let mut back = [0; 256];
        let out = other.transmit(gateway(0), now, &mut back).unwrap();
        assert_eq!(out.to, Some(BusDrop(10)));
        a.receive(Arrival::Bus { gateway: gateway(0), from: BusDrop(drop) }, &mut back[..out.len], now, now).unwrap();
        let delivery = a.take(port(1), now).unwrap();
        assert_eq!(a.taken_steps(&delivery), [0x80, drop]);
        assert!(read(&mut a, delivery, now).ends_with(if drop == 20 { b"node2" } else { b"node3" }));
    }
}

/// `[PKT-15]`: a frame that says it comes from everybody could not be answered.
#[test]
fn nobody_sends_from_the_broadcast_address() {
    let mut a = node(1, &[GatewayConfig { kind: GatewayKind::Bus { drop: 10 }, ..FAST }]);
    let mut packet = [5, 0xff, 0xff, 64, 0, 0x80, 10, 0xc0, 0, 1, 0];
    let arrival = Arrival::Bus { gateway: gateway(0), from: BusDrop::BROADCAST };
    assert_eq!(a.receive(arrival, &mut packet, us(1), us(1)), Err(DropCause::FrameMalformed));
}

/// `[SYS-06]`: who comes to a bus says so once, and nobody answers.
#[test]
fn an_announcement_on_a_bus_is_an_event_without_an_answer() {
    let on_bus = |drop| GatewayConfig { kind: GatewayKind::Bus { drop }, ..FAST };
    let mut a = node(1, &[on_bus(10)]);
    let mut b = TestNode::new(identity(2), "b");
    let index = b.add_gateway(on_bus(20)).unwrap();
    b.set_open(index, true, us(7));
    let mut packet = [0; 256];
    let out = b.transmit(index, us(7), &mut packet).unwrap();
    assert_eq!(out.to, Some(BusDrop::BROADCAST));
    a.receive(Arrival::Bus { gateway: gateway(0), from: BusDrop(20) }, &mut packet[..out.len], us(8), us(8)).unwrap();
    assert_eq!(a.take_neighbour_change(), Some((gateway(0), NeighbourChange::Appeared)));
    // they look for a better time, `[TIM-18]`, and say no more of themselves
    for node in [&mut a, &mut b] {
        while let Some(out) = node.transmit(gateway(0), us(900_000), &mut packet) {
            assert!(out.is_stamped);
        }
    }
}

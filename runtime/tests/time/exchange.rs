//! The two messages, and when they are sent: `[TIM-01]` to `[TIM-05]`, `[TIM-16]`.

use crate::common::{BYTES, FAST, TestNode, UART, ask, carry, datagram, gateway, link, node, us};
use crate::network::Network;
use fixed_math::time::{LocalTicks, PeerTicks, Span};
use osap_protocol::DropCause;
use osap_protocol::discovery::{Query, TimeLink, UniqueId};
use osap_protocol::header::{Arrival, SYSTEM_HEADER_BYTES, Terminal, emit};
use osap_protocol::system::SystemKey;
use osap_protocol::time::{ANYBODY, Root, TimeReply, TimeRequest, unwrap_stamp};
use osap_runtime::clock::DEFAULT_SETTINGS;
use osap_runtime::{BURST_INTERVAL_US, BURST_MISSES_MAX, GatewayConfig, Outgoing, SLOW_FACTOR};

/// What a gateway sends now, where it is about time.
fn time_message(node: &mut TestNode, index: u8, now: LocalTicks) -> Option<(Outgoing, Vec<u8>)> {
    let mut packet = [0; BYTES];
    let expected = node.has_time_message(gateway(index), now);
    let out = node.transmit(gateway(index), now, &mut packet);
    assert_eq!(out.is_some_and(|out| out.is_stamped), expected, "has_time_message tells what transmit gives");
    out.filter(|out| out.is_stamped).map(|out| (out, packet[..out.len].to_vec()))
}

/// Two nodes on a link that know each other, at 1 ms.
fn pair(config: GatewayConfig) -> (TestNode, TestNode) {
    let (mut a, mut b) = (node(1, &[config]), node(2, &[config]));
    for at in [&mut a, &mut b] {
        at.set_open(gateway(0), false, us(1_000));
        at.set_open(gateway(0), true, us(1_000));
    }
    carry((&mut a, 0), (&mut b, 0), us(1_000)).unwrap().unwrap();
    carry((&mut b, 0), (&mut a, 0), us(1_000)).unwrap().unwrap();
    // each has been asked to say who it is, and goes on to time
    for at in [&mut a, &mut b] {
        while at.has_output(gateway(0), us(1_000)) && !at.has_time_message(gateway(0), us(1_000)) {
            at.transmit(gateway(0), us(1_000), &mut [0; BYTES]).unwrap();
        }
    }
    (a, b)
}

fn payload(packet: &[u8]) -> &[u8] {
    &packet[SYSTEM_HEADER_BYTES + 1..]
}

/// `[TIM-01]` to `[TIM-04]`: stamps are those of first bytes, whenever a packet is looked at and however long it waits.
#[test]
fn a_request_and_its_reply() {
    let (mut a, mut b) = pair(UART);
    let (out, mut request) = time_message(&mut a, 0, us(2_000)).expect("a neighbour has appeared");
    assert_eq!((out.len, out.to), (SYSTEM_HEADER_BYTES + 1 + TimeRequest::LEN, None));
    let (read, slot) = TimeRequest::decode(payload(&request)).unwrap();
    assert_eq!((read.sequence, unwrap_stamp(slot, us(2_000))), (1, us(2_000)));
    assert!(time_message(&mut a, 0, us(2_001)).is_none(), "one at a time");

    // its first byte came 300 µs before anybody looked, and the answer leaves after 500 more
    b.receive(Arrival::Link(gateway(0)), &mut request, us(2_100), us(2_400)).unwrap();
    let (out, mut reply) = time_message(&mut b, 0, us(2_900)).unwrap();
    assert_eq!((out.len, out.to), (SYSTEM_HEADER_BYTES + 1 + TimeReply::LEN, None));
    let read = TimeReply::decode(payload(&reply)).unwrap();
    let expected = TimeReply {
        sequence: 1,
        asked_slot: 2_000 << 8,
        heard: PeerTicks::from_us(2_100),
        system: fixed_math::time::NetTime::from_us(2_100),
        bound_steps: u32::MAX,
        tick_steps: 256,
        root: Root { priority: 128, unique_id: UniqueId([2; 12]) },
        answered_slot: 2_900 << 8,
        ..TimeReply::default()
    };
    assert_eq!(read, expected, "a root that is not settled yet");
    assert_eq!(read.answered(), PeerTicks::from_us(2_900));
    // 100 µs there, 100 back, however long it lay about
    a.receive(Arrival::Link(gateway(0)), &mut reply, us(3_000), us(3_777)).unwrap();
    let known: TimeLink = ask(&mut a, Query::TimeLink, &0u8, us(3_800)).unwrap();
    assert_eq!((known.exchanges, known.round_trip_steps, known.refused), (1, 200 << 8, 0));
    assert_eq!((known.tier, known.root), (0, UniqueId([2; 12])));
    assert_eq!(known.offset_steps, 0, "both counters are the same");
}

/// `[TIM-01]`: a new request replaces the open one, which counts as unanswered.
#[test]
fn one_request_is_open() {
    let (mut a, mut b) = pair(UART);
    let replies: Vec<Vec<u8>> = [2_000, 9_000]
        .iter()
        .map(|at| {
            let (_, mut request) = time_message(&mut a, 0, us(*at)).unwrap();
            b.receive(Arrival::Link(gateway(0)), &mut request, us(at + 10), us(at + 10)).unwrap();
            loop {
                // its own requests go between
                let (_, packet) = time_message(&mut b, 0, us(at + 20)).unwrap();
                if TimeReply::decode(payload(&packet)).is_ok() {
                    return packet;
                }
            }
        })
        .collect();
    let mut hear = |n: usize| a.receive(Arrival::Link(gateway(0)), &mut replies[n].clone(), us(9_030), us(9_030));
    assert_eq!(hear(0), Err(DropCause::TimeUnasked));
    assert_eq!(hear(1), Ok(()));
    assert_eq!(hear(1), Err(DropCause::TimeUnasked), "answered already");
    let known: TimeLink = ask(&mut a, Query::TimeLink, &0u8, us(9_100)).unwrap();
    assert_eq!((known.exchanges, known.unanswered, known.refused), (1, 1, 2));
    assert_eq!(a.counters().of(DropCause::TimeUnasked), 2);
}

/// From one look at a node to the next, µs.
const LOOK_US: u64 = 50;

/// `[TIM-05]`: a burst ends where nobody answers, and from then on there is one request an interval; the times between are drawn.
#[test]
fn neighbours_that_do_not_answer_are_asked_seldom() {
    let (mut a, mut b) = pair(UART);
    let mut times = Vec::new();
    for at in (1..400_000).map(|n| 1_000 + n * LOOK_US) {
        // the other one lives and says so, but its answers get nowhere
        let mut packet = [0; BYTES];
        if let Some(out) = b.transmit(gateway(0), us(at), &mut packet)
            && !out.is_stamped
        {
            a.receive(Arrival::Link(gateway(0)), &mut packet[..out.len], us(at), us(at)).unwrap();
        }
        times.extend(time_message(&mut a, 0, us(at)).map(|_| at));
    }
    let pauses: Vec<u64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    // nobody was heard, so nobody is nearer to the root than this node is
    let interval_us = u64::from(DEFAULT_SETTINGS.interval_us) * u64::from(SLOW_FACTOR);
    let (burst, rest) = pauses.split_at(BURST_MISSES_MAX.into());
    assert!(rest.len() >= 40, "{} requests", times.len());
    for (of, interval_us) in [(burst, BURST_INTERVAL_US), (rest, interval_us)] {
        let (least, most) = (of.iter().min().unwrap(), of.iter().max().unwrap());
        assert!(*least >= interval_us * 7 / 8 && *most <= interval_us * 9 / 8 + LOOK_US, "{least} to {most}");
    }
    let (least, most) = (rest.iter().min().unwrap(), rest.iter().max().unwrap());
    // 40 draws of a quarter: that all lie within half of it has a chance of 40 in 2^39
    assert!(most - least > interval_us / 8, "{least} to {most}");
}

/// `[TIM-05]`: who is nearer to the root is asked once an interval, who is not so many times less often.
#[test]
fn sources_are_asked_more_often_than_others() {
    let mut net = Network::new(&[(900_000, 0), (0, 0)], &[(0, 1)]);
    net.run_for(2_000_000);
    let before = [net.link(0, 0).exchanges, net.link(1, 0).exchanges];
    net.run_for(8_000_000);
    let [slow, fast] = [net.link(0, 0).exchanges - before[0], net.link(1, 0).exchanges - before[1]];
    // 160 intervals; their mean is off by a standard deviation of 7 % over the root of their number
    assert!((155..=165).contains(&fast) && (18..=22).contains(&slow), "{fast} {slow}");
}

/// `[TIM-02]`, `[SYS-02]`: nobody's time is taken from further away than a step.
#[test]
fn time_is_a_neighbours() {
    let mut a = node(1, &[UART, UART]);
    let mut packet = [0; 64];
    let at = emit(
        &mut packet,
        1_000,
        64,
        crate::common::route(&[link(0), link(1)]).as_route(),
        Terminal::System { key: SystemKey::TimeRequest.key() },
    )
    .unwrap();
    let len = at + TimeRequest { sequence: 1, below: ANYBODY }.encode(&mut packet[at..]).unwrap();
    let mut b = node(2, &[UART, UART]);
    // forwarded by b, then at its end in a
    b.receive(Arrival::Link(gateway(0)), &mut packet[..len], us(10), us(10)).unwrap();
    let result = loop {
        match carry((&mut b, 1), (&mut a, 0), us(20)) {
            Some(Err(cause)) => break cause,
            Some(Ok(())) => {}
            None => panic!("nothing was forwarded"),
        }
    };
    assert_eq!(result, DropCause::SystemMalformed);
}

/// `[TIM-03]`: a gateway that could not carry a reply neither asks nor answers, and wakes nobody up for it.
#[test]
fn a_gateway_too_small_for_a_reply_is_left_alone() {
    let needed = u16::try_from(SYSTEM_HEADER_BYTES + 1 + TimeReply::LEN).unwrap();
    for (mtu_bytes, asks) in [(needed, true), (needed - 1, false)] {
        let (mut a, mut b) = pair(GatewayConfig { mtu_bytes, ..UART });
        assert_eq!(time_message(&mut a, 0, us(2_000)).is_some(), asks);
        let mut request = [0; 64];
        let route = crate::common::route(&[link(0)]);
        let terminal = Terminal::System { key: SystemKey::TimeRequest.key() };
        let at = emit(&mut request, 1_000, 64, route.as_route(), terminal).unwrap();
        let len = at + TimeRequest { sequence: 1, below: ANYBODY }.encode(&mut request[at..]).unwrap();
        let heard = b.receive(Arrival::Link(gateway(0)), &mut request[..len], us(2_000), us(2_000));
        assert_eq!(heard, if asks { Ok(()) } else { Err(DropCause::OverMtu) });
        assert_eq!(time_message(&mut b, 0, us(2_000)).is_some(), asks);
        // after all that is due was done, nothing is due any more
        for at in [&mut a, &mut b] {
            at.run(us(400_000));
            while at.transmit(gateway(0), us(400_000), &mut [0; BYTES]).is_some() {}
            let wake = at.next_wake().unwrap();
            assert!(wake > us(400_000), "mtu {mtu_bytes}: would wake at {wake:?} for ever");
        }
    }
}

/// `[TIM-02]`: a neighbour that asks without end delays a packet by one answer at the most, and does not keep this node from announcing
/// itself.
#[test]
fn questions_without_end_starve_nobody() {
    let (mut a, _) = pair(UART);
    let mut request = [0; 64];
    let route = crate::common::route(&[link(0)]);
    let terminal = Terminal::System { key: SystemKey::TimeRequest.key() };
    let mut order = String::new();
    for n in 0u8..200 {
        let now = us(2_000 + u64::from(n) * 5_000);
        let at = emit(&mut request, 1_000, 64, route.as_route(), terminal).unwrap();
        let len = at + TimeRequest { sequence: n, below: ANYBODY }.encode(&mut request[at..]).unwrap();
        a.receive(Arrival::Link(gateway(0)), &mut request[..len], now, now).unwrap();
        if n < 20 && n % 4 == 0 {
            for _ in 0..2 {
                datagram(&mut a, &[link(0)], 1, 60_000, &[9; 9], now).unwrap();
            }
        }
        let mut packet = [0; BYTES];
        let out = a.transmit(gateway(0), now, &mut packet).expect("there is always something");
        let key = packet[SYSTEM_HEADER_BYTES];
        order.push(match (out.is_stamped, key == SystemKey::Announcement.key()) {
            (true, _) => 't',
            (false, true) => 'a',
            (false, false) => 'p',
        });
    }
    assert_eq!(order.chars().filter(|it| *it == 'p').count(), 10, "{order}");
    let packets = &order[..24];
    assert!(!packets.trim_start_matches('t').split('p').take(9).any(|between| between.len() > 3), "{order}");
    // a second has four announcements; each may wait for an answer or a packet, not for all
    assert!(order.chars().filter(|it| *it == 'a').count() >= 3, "{order}");
}

/// `[TIM-16]`: on a link of unknown rate a packet's time to live is shortened by half the least round trip, once there is one.
#[test]
fn the_wire_time_of_an_unknown_link_is_measured() {
    let (mut a, mut b) = pair(FAST);
    let sent_ttl = |a: &mut TestNode, now: LocalTicks| {
        datagram(a, &[link(0)], 1, 5_000, &[1], now).unwrap();
        let mut packet = [0; BYTES];
        loop {
            let out = a.transmit(gateway(0), now, &mut packet).unwrap();
            if !out.is_stamped && packet[SYSTEM_HEADER_BYTES] != SystemKey::Announcement.key() {
                return u16::from_le_bytes([packet[1], packet[2]]);
            }
        }
    };
    assert_eq!(sent_ttl(&mut a, us(1_500)), 5_000);
    let (_, mut request) = time_message(&mut a, 0, us(2_000)).unwrap();
    b.receive(Arrival::Link(gateway(0)), &mut request, us(2_100), us(2_400)).unwrap();
    let (_, mut reply) = time_message(&mut b, 0, us(2_900)).unwrap();
    a.receive(Arrival::Link(gateway(0)), &mut reply, us(3_200), us(3_200)).unwrap();
    // 100 there and 300 back
    assert_eq!(a.gateway(gateway(0)).unwrap().wire_time(10), Span::from_us(200));
    assert_eq!(sent_ttl(&mut a, us(3_300)), 4_800);
}

//! Requests that are answered, repeated or given up, and messages longer than a packet, over a wire that loses what it is told to.

mod common;

use common::{BYTES, FAST, TestNode, USER, gateway, link, node, port, route, us};
use fixed_math::time::LocalTicks;
use osap_protocol::discovery::{Query, VERSION};
use osap_protocol::header::Arrival;
use osap_protocol::transport::{
    RETRIES_MAX, SEGMENT_IDLE_US, SEGMENT_WINDOW, SegmentHeader, SegmentRefusal, Sequence, SequencedKind, Transport,
};
use osap_protocol::{DropCause, PortIndex, RouteBuf};
use osap_runtime::segmented::{MessageError, Progress, Received, Receiver, Sender};
use osap_runtime::sequenced::{Accepted, Client, Destination, Expect, RequestError};
use osap_runtime::{Mailbox, Outbound};
use proptest::prelude::*;

type TestClient = Client<2, 32>;

fn netresponder_of_b() -> Destination {
    Destination { route: route(&[link(0)]), mtu_bytes: 256, ttl_us: 1_000, port: PortIndex::NETRESPONDER }
}

/// Carries everything both ways at `now`, but for the packets that `lost` says, counted from 0 over both directions.
fn exchange(a: &mut TestNode, b: &mut TestNode, now: LocalTicks, count: &mut usize, lost: &dyn Fn(usize) -> bool) {
    loop {
        let mut moved = false;
        for outward in [true, false] {
            let [from, to] = if outward { [&mut *a, &mut *b] } else { [&mut *b, &mut *a] };
            let mut packet = [0; BYTES];
            while let Some(out) = from.transmit(gateway(0), now, &mut packet) {
                if !lost(*count) {
                    let _counted = to.receive(Arrival::Link(gateway(0)), &mut packet[..out.len], now, now);
                }
                *count += 1;
                moved = true;
            }
            to.run(now);
        }
        if !moved {
            return;
        }
    }
}

/// `[TRN-04]`, `[TRN-05]`: a lost request and a lost reply are repeated under one number, and the third try is answered once.
#[test]
fn a_lost_request_and_a_lost_reply_are_repeated() {
    let (mut a, mut b) = (node(1, &[FAST]), node(2, &[FAST]));
    let mut client = TestClient::new(port(USER), Sequence::new(9));
    let ticket =
        client.request(&mut a, netresponder_of_b(), Expect::One, &[Query::RuntimeName.key(), VERSION], us(0)).unwrap();
    let mut count = 0;
    let lost = |n| n == 0 || n == 2; // the request, then the reply to its repetition
    for now in [0, 1_000, 2_000] {
        assert_eq!(client.next_wake(), Some(us(1_000.max(now))));
        assert!(client.poll(&mut a, us(now)).is_none());
        exchange(&mut a, &mut b, us(now), &mut count, &lost);
    }
    let delivery = a.take(port(USER), us(2_300)).unwrap();
    let Accepted::Answer { ticket: answered, kind, round_trip, tries, delivery } =
        client.accept(&mut a, delivery, us(2_300))
    else {
        panic!("it is ours")
    };
    assert_eq!((answered, kind, round_trip.as_us_ceil(), tries), (ticket, SequencedKind::Reply, 300, 3));
    assert!(common::read(&mut a, delivery, us(2_300)).ends_with(b"node2"));
    assert_eq!(client.open(), 0);
}

/// `[TRN-05]`: after its last try a request fails, by the clock and not by the number of calls, `[NOD-12]`.
#[test]
fn a_request_that_nobody_answers_fails() {
    let mut a = node(1, &[FAST]);
    let mut client = TestClient::new(port(USER), Sequence::new(0));
    let ticket = client.request(&mut a, netresponder_of_b(), Expect::One, &[1], us(0)).unwrap();
    let mut sent = 1;
    for now in (0..20).map(|n| n * 500) {
        while a.transmit(gateway(0), us(now), &mut [0; BYTES]).is_some() {}
        if let Some(ended) = client.poll(&mut a, us(now)) {
            assert_eq!((ended.ticket, ended.tries, ended.expect), (ticket, RETRIES_MAX + 1, Expect::One));
            assert_eq!(now, 1_000 * u64::from(RETRIES_MAX + 1));
            sent = 0;
            break;
        }
    }
    assert_eq!(sent, 0, "it ended");
}

/// `[TRN-04]`: replies of another number or from another port are dropped, also a second reply to one request.
#[test]
fn replies_that_match_nothing_are_counted() {
    let (mut a, mut b) = (node(1, &[FAST]), node(2, &[FAST]));
    let mut client = TestClient::new(port(USER), Sequence::new(0));
    client.request(&mut a, netresponder_of_b(), Expect::One, &[Query::TypeName.key(), VERSION], us(0)).unwrap();
    let mut packet = [0; BYTES];
    let out = a.transmit(gateway(0), us(0), &mut packet).unwrap();
    for _ in 0..2 {
        let mut copy = packet; // the network duplicates the request
        b.receive(Arrival::Link(gateway(0)), &mut copy[..out.len], us(0), us(0)).unwrap();
    }
    b.run(us(0));
    exchange(&mut a, &mut b, us(0), &mut 0, &|_| false);
    let first = a.take(port(USER), us(1)).unwrap();
    let Accepted::Answer { delivery, .. } = client.accept(&mut a, first, us(1)) else { panic!("it is ours") };
    a.release(delivery, None, us(1));
    let second = a.take(port(USER), us(1)).unwrap();
    assert!(matches!(client.accept(&mut a, second, us(1)), Accepted::Unmatched));
    assert_eq!((a.counters().of(DropCause::ReplyUnmatched), a.free_slots()), (1, common::SLOTS));
}

#[test]
fn a_client_refuses_what_it_cannot_keep() {
    let mut a = node(1, &[FAST]);
    let mut client = TestClient::new(port(USER), Sequence::new(0));
    let mut ask =
        |len: usize| client.request(&mut a, netresponder_of_b(), Expect::One, &vec![1; len], us(0)).map(|_| ());
    assert_eq!(ask(33), Err(RequestError::TooLong { len: 33, limit: 32 }));
    assert_eq!((ask(32), ask(1)), (Ok(()), Ok(())));
    assert_eq!(ask(1), Err(RequestError::Busy { limit: 2 }));
}

/// `[TRN-04]`: an answer must come from the port that was asked, and under the number that is open.
#[test]
fn an_answer_must_have_port_and_number_of_its_request() {
    for (source, sequence, ours) in [(0, 5, true), (2, 5, false), (0, 6, false)] {
        let mut a = node(1, &[FAST]);
        let mut client = TestClient::new(port(USER), Sequence::new(5));
        client.request(&mut a, netresponder_of_b(), Expect::One, &[1], us(0)).unwrap();
        let [high, low] = [0xc0 | u8::try_from(source >> 5).unwrap(), u8::try_from((source & 31) << 3).unwrap()];
        let mut packet = [5, 0xff, 0xff, 64, 0, 0x40, high, low, USER.to_le_bytes()[0], 1, sequence, 0x40, 9];
        a.receive(Arrival::Link(gateway(0)), &mut packet, us(1), us(1)).unwrap();
        let delivery = a.take(port(USER), us(1)).unwrap();
        let accepted = client.accept(&mut a, delivery, us(1));
        assert_eq!(matches!(accepted, Accepted::Answer { .. }), ours, "source {source}, sequence {sequence}");
        assert_eq!(a.counters().of(DropCause::ReplyUnmatched), u32::from(!ours));
    }
}

/// `[TRN-10]`: a sender never has more than its window unacknowledged, however much its port may hold.
#[test]
fn a_window_is_a_window() {
    let mut a = node(1, &[FAST]);
    let steps = route(&[link(0)]);
    let message = [7; 900];
    let mut sender = Sender::new(port(USER), &to_b(64, &steps), 3, message.len(), us(0)).unwrap();
    let mut sent = 0;
    for _ in 0..10 {
        sender.poll(&mut a, &message, us(0));
        while a.transmit(gateway(0), us(0), &mut [0; BYTES]).is_some() {
            sent += 1;
        }
    }
    assert_eq!(sent, SEGMENT_WINDOW);
    assert!(sender.accept(SegmentHeader::Acknowledge { message: 3, next: 1 }, us(0)));
    sender.poll(&mut a, &message, us(0));
    assert!(a.transmit(gateway(0), us(0), &mut [0; BYTES]).is_some());
    assert!(a.transmit(gateway(0), us(0), &mut [0; BYTES]).is_none());
}

fn to_b(mtu_bytes: u16, route: &RouteBuf) -> Outbound<'_> {
    Outbound {
        route: route.as_route(),
        mtu_bytes,
        ttl_us: 5_000,
        destination: port(USER),
        transport: Transport::Segmented,
    }
}

/// Sends `message` from a to b with the losses given; what b got, if it got it whole, and how a's side ended.
fn send_message(message: &[u8], mtu_bytes: u16, lost: &dyn Fn(usize) -> bool) -> (Option<Vec<u8>>, Progress) {
    let (mut a, mut b) = (node(1, &[FAST]), node(2, &[FAST]));
    let steps = route(&[link(0)]);
    let mut sender = Sender::new(port(USER), &to_b(mtu_bytes, &steps), 3, message.len(), us(0)).unwrap();
    let mut receiver = Receiver::<2_000>::new();
    let (mut got, mut count) = (None, 0);
    for step in 0..2_000 {
        let now = us(step * 500);
        if !matches!(sender.poll(&mut a, message, now), Progress::Sending { .. }) {
            break;
        }
        exchange(&mut a, &mut b, now, &mut count, lost);
        while let Some(delivery) = b.take(port(USER), now) {
            if receiver.accept(&mut b, delivery, now) == Received::Whole {
                assert!(got.is_none(), "once only");
                got = Some(receiver.message().to_vec());
            }
        }
        exchange(&mut a, &mut b, now, &mut count, lost);
        while let Some(delivery) = a.take(port(USER), now) {
            let (header, _) = SegmentHeader::parse(a.payload(&delivery)).unwrap();
            a.release(delivery, None, now);
            assert!(sender.accept(header, now));
        }
    }
    assert_eq!((a.free_slots(), b.free_slots()), (common::SLOTS, common::SLOTS));
    (got, sender.progress())
}

proptest! {
    /// `[TRN-08]` to `[TRN-10]`: any message arrives as it was, whole and once, whichever packets are lost, as long as they are no more
    /// than the retries that one window has.
    #[test]
    fn messages_survive_losses(len in 1usize..1_500, mtu in 40u16..256, lost in proptest::collection::vec(0usize..120, 0..=usize::from(RETRIES_MAX))) {
        let message: Vec<u8> = (0..len).map(|n| u8::try_from(n % 251).unwrap()).collect();
        let (got, progress) = send_message(&message, mtu, &|n| lost.contains(&n));
        prop_assert_eq!(progress, Progress::Done);
        prop_assert_eq!(got, Some(message));
    }
}

/// `[TRN-10]`: the last window sent again is acknowledged twice; the second acknowledgement is of the same message, if of no more use.
#[test]
fn a_window_repeated_is_acknowledged_twice() {
    let message: Vec<u8> = (0..453).map(|n| u8::try_from(n % 251).unwrap()).collect();
    let (got, progress) = send_message(&message, 167, &|n| [0, 9, 10].contains(&n));
    assert_eq!((got, progress), (Some(message), Progress::Done));
}

/// `[TRN-10]`: where nothing gets through, the sender gives up and says how far it was.
#[test]
fn a_message_into_nothing_fails() {
    let (got, progress) = send_message(&[1; 900], 64, &|n| n > 12);
    assert_eq!(got, None);
    assert!(matches!(progress, Progress::Failed { done, count: 19 } if done > 0), "{progress:?}");
}

/// `[TRN-09]`: too long for the receiver is refused, and the sender knows why.
#[test]
fn a_message_too_long_is_refused() {
    let (got, progress) = send_message(&[1; 2_100], 256, &|_| false);
    assert_eq!((got, progress), (None, Progress::Refused(SegmentRefusal::TooLong)));
}

#[test]
fn a_message_needs_bytes_and_room() {
    let steps = route(&[link(0)]);
    let new = |mtu, len| Sender::new(port(USER), &to_b(mtu, &steps), 0, len, us(0)).map(|_| ());
    assert_eq!(new(64, 0), Err(MessageError::Empty));
    assert_eq!(new(16, 5), Err(MessageError::NoRoom { mtu_bytes: 16 }));
    assert_eq!(new(17, 65_536), Err(MessageError::TooLong { len: 65_536, limit: 65_535 }));
    assert_eq!(new(17, 65_535), Ok(()));
}

/// `[TRN-08]`, `[TRN-09]`: a second sender is refused as busy until the first has been silent long enough; a changed count is invalid.
#[test]
fn one_message_at_a_time() {
    let mut b = node(2, &[]);
    let mut receiver = Receiver::<64>::new();
    let none = RouteBuf::new();
    let mut data = |message, index, count, at| {
        let mut head = [0; 6];
        SegmentHeader::Data { message, index, count }.encode(&mut head);
        let to = Outbound {
            route: none.as_route(),
            mtu_bytes: 256,
            ttl_us: 100,
            destination: port(USER),
            transport: Transport::Segmented,
        };
        b.send(port(USER), to, &[&head, b"data"], us(at)).unwrap();
        let delivery = b.take(port(USER), us(at)).unwrap();
        let verdict = receiver.accept(&mut b, delivery, us(at));
        let answer = b.take(port(USER), us(at)).map(|delivery| {
            let header = SegmentHeader::parse(b.payload(&delivery)).unwrap().0;
            b.release(delivery, None, us(at));
            header
        });
        (verdict, answer, b.counters().clone())
    };
    assert_eq!(data(1, 0, 3, 0).0, Received::Partial);
    let (verdict, answer, _) = data(2, 0, 1, 10);
    assert_eq!(
        (verdict, answer),
        (Received::Dropped, Some(SegmentHeader::Refuse { message: 2, reason: SegmentRefusal::Busy }))
    );
    let (verdict, answer, counters) = data(1, 2, 3, 20);
    assert_eq!((verdict, answer), (Received::Dropped, Some(SegmentHeader::Acknowledge { message: 1, next: 1 })));
    assert_eq!(counters.of(DropCause::SegmentOutOfOrder), 1);
    let (verdict, answer, counters) = data(1, 1, 4, 30);
    assert_eq!((verdict, answer, counters.of(DropCause::SegmentInvalid)), (Received::Dropped, None, 1));
    assert_eq!(data(2, 0, 1, 20 + SEGMENT_IDLE_US).0, Received::Whole); // its last acknowledgement may have been lost: repeated, it is acknowledged again and not delivered twice
    let (verdict, answer, _) = data(2, 0, 1, 30 + SEGMENT_IDLE_US);
    assert_eq!((verdict, answer), (Received::Dropped, Some(SegmentHeader::Acknowledge { message: 2, next: 1 })));
    // long after, the same number is a new message
    assert_eq!(data(2, 0, 1, 30 + 2 * SEGMENT_IDLE_US).0, Received::Whole);
}

/// One data segment to a receiver in the same node, and what was answered.
fn segment(
    b: &mut TestNode,
    receiver: &mut Receiver<64>,
    (message, index, count): (u8, u16, u16),
    data: &[u8],
    at: u64,
) -> (Received, Option<SegmentHeader>) {
    let none = RouteBuf::new();
    let mut head = [0; 6];
    SegmentHeader::Data { message, index, count }.encode(&mut head);
    b.send(port(USER), Outbound { route: none.as_route(), ..to_b(256, &none) }, &[&head, data], us(at)).unwrap();
    let delivery = b.take(port(USER), us(at)).unwrap();
    let verdict = receiver.accept(b, delivery, us(at));
    let answer = b.take(port(USER), us(at)).map(|delivery| {
        let header = SegmentHeader::parse(b.payload(&delivery)).unwrap().0;
        b.release(delivery, None, us(at));
        header
    });
    (verdict, answer)
}

/// `[TRN-09]`: what is left of a message refused as too long, and what comes late of one that was whole, claims the receiver for nobody.
#[test]
fn stray_segments_claim_nothing() {
    let mut b = node(2, &[]);
    let mut receiver = Receiver::<64>::new();
    for index in 0..4 {
        let (verdict, _) = segment(&mut b, &mut receiver, (1, index, 4), &[7; 40], 1_000);
        assert_eq!(verdict, Received::Dropped);
    }
    assert_eq!(segment(&mut b, &mut receiver, (2, 0, 2), b"aa", 1_100).0, Received::Partial);
    assert_eq!(segment(&mut b, &mut receiver, (2, 1, 2), b"bb", 1_100).0, Received::Whole);
    assert_eq!(segment(&mut b, &mut receiver, (3, 0, 1), b"cc", 1_100).0, Received::Whole);
    assert_eq!(segment(&mut b, &mut receiver, (2, 1, 2), b"bb", 1_200).0, Received::Dropped);
    assert_eq!(segment(&mut b, &mut receiver, (2, 0, 1), b"replayed", 1_200).0, Received::Dropped);
    assert_eq!(segment(&mut b, &mut receiver, (4, 0, 1), b"dd", 1_300).0, Received::Whole);
    assert_eq!(receiver.message(), b"dd");
}

/// `[TRN-09]`: another length under the number of a message already whole is another message, not a repetition to be acknowledged.
#[test]
fn another_length_is_another_message() {
    let mut b = node(2, &[]);
    let mut receiver = Receiver::<64>::new();
    assert_eq!(segment(&mut b, &mut receiver, (0, 0, 1), b"one", 1_000).0, Received::Whole);
    let (verdict, answer) = segment(&mut b, &mut receiver, (0, 0, 2), b"two", 1_100);
    assert_eq!((verdict, answer), (Received::Partial, Some(SegmentHeader::Acknowledge { message: 0, next: 1 })));
}

/// `[TRN-08]`: all segments but the last have one length, and the last no more.
#[test]
fn segments_have_one_length() {
    for (second, third, expected) in
        [(&b"22"[..], &b"3"[..], Received::Whole), (b"2", b"3", Received::Dropped), (b"22", b"333", Received::Dropped)]
    {
        let mut b = node(2, &[]);
        let mut receiver = Receiver::<64>::new();
        segment(&mut b, &mut receiver, (1, 0, 3), b"11", 1_000);
        segment(&mut b, &mut receiver, (1, 1, 3), second, 1_000);
        let (verdict, _) = segment(&mut b, &mut receiver, (1, 2, 3), third, 1_000);
        assert_eq!(verdict, expected);
        assert_eq!(b.counters().of(DropCause::SegmentInvalid) > 0, expected == Received::Dropped);
    }
}

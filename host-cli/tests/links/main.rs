//! Links over real sockets of 127.0.0.1, real pseudo-terminals and channels.
//!
//! - **Walk:** one side's [`LinkHandle::send`] → the system → the other side's [`LinkEvent::Packet`].
//! - **Invariants:** every wait is for an event and bounded by [`support::PATIENCE`]; nothing asserts how long something took.
//! - **Clauses:** `[LNK-01]`, `[LNK-04]` to `[LNK-07]`, `[FRM-05]` to `[FRM-09]`, `[TIM-03]`.

mod keyed;
mod stamps;
mod support;
#[cfg(unix)]
mod terminals;

use fixed_math::time::Span;
use osap::link::{self, Clock, LinkDescription, LinkError, LinkEvent, LinkGone, LinkOptions};
use osap_protocol::DropCause;
use osap_protocol::framing::Check;
use std::io::Write;
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;
use support::{Side, address, exchange, frame, free_port, gateway, pair, plain, tcp_pair, with_faults, with_key};

#[test]
fn tcp_carries_packets_both_ways() {
    for tail in ["", ",check=crc32"] {
        let (listener, dialler) = tcp_pair(tail, &plain(), &plain());
        exchange(&dialler, &listener);
    }
}

/// `[LNK-02]`.
#[test]
fn a_link_says_what_it_is() {
    let listener = Side::listen("tcp:127.0.0.1:0,check=crc16", &plain());
    let LinkDescription { name, type_name, mtu_bytes, bits_a_byte, check, .. } = listener.handle.description.clone();
    assert_eq!((&type_name[..], mtu_bytes, bits_a_byte, check), ("tcp", 1024, 8, Check::Crc16));
    assert!(name.starts_with("tcp:127.0.0.1:") && !name.ends_with(":0"), "{name}");
}

/// A dialler may come first, and comes back by itself; so does a listener.
#[test]
fn tcp_opens_again_after_the_other_side_went() {
    let spec = format!("tcp:127.0.0.1:{}", free_port());
    let dialler = Side::open(&spec, &plain());
    let reason = dialler.expect_down();
    assert!(reason.to_lowercase().contains("refused"), "{reason}");
    for _ in 0..2 {
        let listener = Side::listen(&spec, &plain());
        dialler.expect(&LinkEvent::Up);
        listener.expect(&LinkEvent::Up);
        exchange(&dialler, &listener);
        drop(listener);
        dialler.expect_down();
    }
    let listener = Side::listen(&spec, &plain());
    dialler.expect(&LinkEvent::Up);
    listener.expect(&LinkEvent::Up);
    drop(dialler);
    listener.expect_down();
    let again = Side::open(&spec, &plain());
    listener.expect(&LinkEvent::Up);
    again.expect(&LinkEvent::Up);
    exchange(&again, &listener);
}

#[test]
fn a_second_peer_is_served_when_the_first_has_left() {
    let (listener, first) = tcp_pair("", &plain(), &plain());
    let second = Side::open(listener.name(), &plain());
    second.expect(&LinkEvent::Up); // the system takes the connection; nobody reads it yet
    second.send(&[2]);
    first.send(&[1]);
    listener.expect_packet(&[1]);
    drop(first);
    listener.expect_down();
    listener.expect(&LinkEvent::Up);
    listener.expect_packet(&[2]);
}

/// `[LNK-04]`: refused before a socket is bound. The port is taken, so that binding first would give another error.
#[test]
fn beyond_loopback_needs_a_key() {
    let start = |listen: bool, spec: &str, options: &LinkOptions| {
        let spec = spec.parse().unwrap();
        let (events, _inbox): (SyncSender<_>, Receiver<_>) = sync_channel(1);
        let start = if listen { link::listen } else { link::open };
        start(&spec, gateway(), events, &Clock::new(), options).map(drop)
    };
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    for (listen, host) in [(true, "0.0.0.0"), (true, "[::]"), (false, "192.0.2.1")] {
        let error = start(listen, &format!("tcp:{host}:{port}"), &plain()).unwrap_err();
        assert!(matches!(error, LinkError::KeyNeeded { .. }) && error.to_string().contains("--key FILE"), "{error}");
        let error = start(listen, &format!("udp:{host}:{port}"), &plain()).unwrap_err();
        assert!(matches!(error, LinkError::UdpBeyondLoopback { .. }), "{error}");
    }
    let error = start(true, &format!("tcp:127.0.0.1:{port}"), &plain()).unwrap_err();
    assert!(matches!(error, LinkError::Bind { .. }), "{error}");
    // A key that would protect nothing, and a check that would guard nothing, are refused rather than ignored.
    let error = start(true, "udp:127.0.0.1:0", &with_key(1)).unwrap_err();
    assert!(matches!(error, LinkError::KeyUnused { .. }), "{error}");
    let error = start(true, "tcp:127.0.0.1:0,check=crc32", &with_key(1)).unwrap_err();
    assert!(matches!(error, LinkError::CheckUnused { .. }), "{error}");
}

#[test]
fn what_cannot_be_listened_on_or_opened_says_so() {
    let (events, _inbox) = sync_channel(1);
    let (clock, options) = (Clock::new(), plain());
    let pty = link::open(&"pty".parse().unwrap(), gateway(), events.clone(), &clock, &options).map(drop);
    assert!(matches!(pty, Err(LinkError::ListenOnly { .. })));
    let serial = link::listen(&"serial".parse().unwrap(), gateway(), events.clone(), &clock, &options).map(drop);
    assert!(matches!(serial, Err(LinkError::OpenOnly { .. })));
    let none = LinkOptions { mtu_bytes: 0, ..plain() };
    let mtu = link::open(&"tcp:127.0.0.1:1".parse().unwrap(), gateway(), events, &clock, &none).map(drop);
    assert!(matches!(mtu, Err(LinkError::Mtu { mtu_bytes: 0 })));
}

/// `[FRM-09]`, and what is no packet is counted. A dialler that starts again is followed.
#[test]
fn udp_carries_one_packet_a_datagram() {
    let listener = Side::listen("udp:127.0.0.1:0", &plain());
    for first in [1, 2] {
        let dialler = Side::open(listener.name(), &plain());
        dialler.expect(&LinkEvent::Up);
        dialler.send(&[first]);
        if first == 1 {
            listener.expect(&LinkEvent::Up);
        }
        listener.expect_packet(&[first]);
        exchange(&dialler, &listener);
    }
    let raw = UdpSocket::bind("127.0.0.1:0").unwrap();
    for (bytes, cause) in
        [(0, DropCause::FrameTooShort), (1025, DropCause::FrameTooLong), (9000, DropCause::FrameTooLong)]
    {
        raw.send_to(&vec![7; bytes], address(&listener)).unwrap();
        listener.expect_drop(cause);
    }
}

/// `[FRM-06]`, `[FRM-07]`: garbage is counted and does not spoil what follows.
#[test]
fn garbage_is_counted_and_the_next_frame_is_whole() {
    let listener = Side::listen("tcp:127.0.0.1:0,check=crc16", &plain());
    let mut raw = TcpStream::connect(address(&listener)).unwrap();
    listener.expect(&LinkEvent::Up);
    let good = frame(&[5, 0, 7], Check::Crc16);
    let mut wrong_check = good.clone();
    wrong_check[1] ^= 1;
    let cases: [(&[u8], DropCause); 5] = [
        (b"hello, is this http?\0", DropCause::FrameMalformed),
        (&wrong_check, DropCause::FrameCheck),
        (&[2, 9, 0], DropCause::FrameTooShort),
        (&frame(&[1; 1025], Check::Crc16), DropCause::FrameTooLong),
        (&frame(&vec![1; 20_000], Check::Crc16), DropCause::FrameTooLong),
    ];
    for (bytes, cause) in cases {
        raw.write_all(&[0, 0]).unwrap();
        raw.write_all(bytes).unwrap();
        raw.write_all(&good).unwrap();
        listener.expect_drop(cause);
        listener.expect_packet(&[5, 0, 7]);
    }
}

/// `[LNK-01]`: a packet that cannot leave is counted, and the link stays as clear to send as it was.
#[test]
fn what_cannot_leave_is_counted() {
    let (listener, dialler) = tcp_pair("", &plain(), &plain());
    dialler.handle.send(vec![1; 1025]).unwrap();
    dialler.expect_drop(DropCause::OverMtu);
    dialler.expect(&LinkEvent::Sent);
    drop(listener);
    dialler.expect_down();
    dialler.handle.send(vec![1]).unwrap();
    dialler.expect_drop(DropCause::GatewayClosed);
}

/// A node that takes events one by one slows its peer down, and loses nothing.
#[test]
fn a_slow_node_makes_its_peer_wait() {
    let listener = Side::listen_with_room("tcp:127.0.0.1:0", &plain(), 1);
    let dialler = Side::open(listener.name(), &plain());
    dialler.expect(&LinkEvent::Up);
    let sender = std::thread::spawn(move || {
        for n in 0..2_000_u32 {
            dialler.send(&[&n.to_le_bytes()[..], &[7; 1000]].concat());
        }
        dialler
    });
    listener.expect(&LinkEvent::Up);
    for n in 0..2_000_u32 {
        let LinkEvent::Packet { bytes, .. } = listener.next() else { panic!("no packet {n}") };
        assert_eq!(bytes[..4], n.to_le_bytes());
    }
    drop(sender.join().unwrap());
}

#[test]
fn a_dropped_handle_joins_its_threads() {
    let (listener, dialler) = tcp_pair("", &plain(), &plain());
    dialler.drop_and_see_threads_end();
    listener.drop_and_see_threads_end();
    Side::open(&format!("tcp:127.0.0.1:{}", free_port()), &plain()).drop_and_see_threads_end();
    Side::open("serial:usb=ffff:ffff", &plain()).drop_and_see_threads_end();
    Side::listen("tcp:127.0.0.1:0", &with_key(1)).drop_and_see_threads_end();
    Side::listen("udp:127.0.0.1:0", &plain()).drop_and_see_threads_end();
}

/// A reader that waits for a full channel, and a writer that waits for a peer that does not read, end as well.
#[test]
fn a_dropped_handle_ends_threads_that_wait() {
    let listener = Side::listen_with_room("tcp:127.0.0.1:0", &plain(), 1);
    let mut raw = TcpStream::connect(address(&listener)).unwrap();
    raw.write_all(&frame(&[1], Check::None)).unwrap();
    listener.expect(&LinkEvent::Up);
    for _ in 0..3 {
        raw.write_all(&frame(&[1], Check::None)).unwrap();
    }
    listener.drop_and_see_threads_end();

    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let dialler = Side::open(&format!("tcp:{}", silent.local_addr().unwrap()), &plain());
    dialler.expect(&LinkEvent::Up);
    // More than the system's buffers hold: at some packet there is no `Sent` any more.
    loop {
        dialler.handle.send(vec![1; 1024]).unwrap();
        match dialler.inbox.recv_timeout(Duration::from_secs(1)) {
            Ok((_, LinkEvent::Sent)) => {}
            Ok(other) => panic!("{other:?}"),
            Err(_) => break,
        }
    }
    dialler.drop_and_see_threads_end();
}

#[test]
fn an_in_process_link_ends_for_good_with_its_other_side() {
    let (left, right) = pair(&plain(), &Clock::new());
    exchange(&left, &right);
    right.drop_and_see_threads_end();
    left.expect_down();
    let gone = std::iter::repeat_with(|| left.handle.send(vec![1])).find(Result::is_err);
    assert_eq!(gone, Some(Err(LinkGone)));
}

/// `[LNK-07]`: with all lost nothing arrives, and it is known why; the sender is clear to send again as ever.
#[test]
fn a_lossy_link_loses_and_counts() {
    let (left, right) = pair(&with_faults("loss=1"), &Clock::new());
    for _ in 0..10 {
        left.send(&[1, 2, 3]);
    }
    drop(left.handle);
    assert!(right.expect_down().contains("gone"), "a packet came through");
    assert_eq!(right.handle.faults().unwrap().outgoing.offered, 0);

    let (listener, dialler) = tcp_pair("", &plain(), &with_faults("loss=1"));
    for _ in 0..10 {
        dialler.send(&[1, 2, 3]);
        listener.send(&[4, 5, 6]);
    }
    let outgoing = dialler.handle.faults().unwrap().outgoing;
    assert_eq!((outgoing.offered, outgoing.lost, outgoing.delivered), (10, 10, 0));
    assert_eq!(listener.handle.faults(), None);
    drop(dialler);
    listener.expect_down();
}

/// `[LNK-07]`: flipped bits are in the framed bytes, so the check finds them: what arrives is what was sent.
#[test]
fn flipped_bits_are_caught_by_the_check() {
    let (listener, dialler) = tcp_pair(",check=crc32", &plain(), &with_faults("ber=0.002,seed=11"));
    let packet: Vec<u8> = (0..32).collect();
    for _ in 0..200 {
        dialler.send(&packet);
    }
    drop(dialler);
    let (mut whole, mut dropped) = (0, 0);
    loop {
        match listener.next() {
            LinkEvent::Packet { bytes, .. } => {
                assert_eq!(bytes, packet);
                whole += 1;
            }
            LinkEvent::Dropped(_) => dropped += 1,
            LinkEvent::Down { .. } => break,
            other => panic!("{other:?}"),
        }
    }
    // 38 bytes a frame, so 0.998^304 = 0.54 of 200 arrive: 109 ± 7.
    assert!(dropped > 0 && (60..160).contains(&whole), "{whole} whole, {dropped} dropped");
}

/// `[LNK-07]`: delay in both directions, by the link's own clock; never shorter than asked for.
#[test]
fn a_delayed_packet_is_stamped_when_it_comes_out() {
    let clock = Clock::new();
    let (left, right) = pair(&with_faults("delay=20ms"), &clock);
    let sent = clock.now();
    left.send(&[1, 2, 3]);
    let LinkEvent::Packet { started, .. } = right.next() else { panic!("no packet") };
    assert!(started >= sent + Span::from_us(40_000), "after {} µs", started.since(sent).as_us_floor());
}

/// With a bandwidth the link is clear to send when the packet is out, not before.
#[test]
fn a_narrow_link_is_clear_to_send_when_the_packet_is_out() {
    let clock = Clock::new();
    let (left, right) = pair(&with_faults("bandwidth=8k"), &clock);
    let start = clock.now();
    for _ in 0..2 {
        left.send(&[1; 20]); // 160 bits at 8 kbit/s: 20 ms
    }
    assert!(clock.now() >= start + Span::from_us(40_000));
    right.expect_packet(&[1; 20]);
}

//! Links over real sockets of 127.0.0.1, real pseudo-terminals and channels.
//!
//! - **Walk:** one side's [`LinkHandle::send`] → the system → the other side's [`LinkEvent::Packet`].
//! - **Invariants:** every wait is for an event and bounded by [`PATIENCE`]; nothing asserts how long something took.
//! - **Clauses:** `[LNK-01]`, `[LNK-04]` to `[LNK-07]`, `[FRM-05]` to `[FRM-09]`.

use fixed_math::time::Span;
use osap::link::{
    self, Clock, Key, LinkDescription, LinkError, LinkEvent, LinkGone, LinkHandle, LinkOptions, in_process,
};
use osap_protocol::framing::{self, Check};
use osap_protocol::{DropCause, GatewayIndex};
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::time::Duration;

/// Longest wait for an event: far longer than any should take, so that only a fault reaches it.
const PATIENCE: Duration = Duration::from_secs(20);

/// One side of a link under test, with a channel of its own for what it says.
struct Side {
    handle: LinkHandle,
    inbox: Receiver<(GatewayIndex, LinkEvent)>,
}

fn gateway() -> GatewayIndex {
    GatewayIndex::new(3).unwrap()
}

fn plain() -> LinkOptions {
    LinkOptions::default()
}

fn with_key(byte: u8) -> LinkOptions {
    LinkOptions { key: Some(Key::from_bytes([byte; Key::LEN])), ..plain() }
}

fn with_faults(text: &str) -> LinkOptions {
    LinkOptions { faults: Some(text.parse().unwrap()), ..plain() }
}

impl Side {
    fn open(spec: &str, options: &LinkOptions) -> Self {
        let (events, inbox) = sync_channel(64);
        let handle = link::open(&spec.parse().unwrap(), gateway(), events, &Clock::new(), options).unwrap();
        Self { handle, inbox }
    }

    fn listen(spec: &str, options: &LinkOptions) -> Self {
        Self::listen_with_room(spec, options, 64)
    }

    /// `room`: events that wait for this side at most.
    fn listen_with_room(spec: &str, options: &LinkOptions, room: usize) -> Self {
        let (events, inbox) = sync_channel(room);
        let handle = link::listen(&spec.parse().unwrap(), gateway(), events, &Clock::new(), options).unwrap();
        Self { handle, inbox }
    }

    fn name(&self) -> &str {
        &self.handle.description.name
    }

    fn next(&self) -> LinkEvent {
        let (from, event) = self.inbox.recv_timeout(PATIENCE).expect("an event");
        assert_eq!(from, gateway());
        event
    }

    /// Waits for `wanted`, past failed attempts to open but nothing else.
    fn expect(&self, wanted: &LinkEvent) {
        loop {
            match self.next() {
                event if event == *wanted => return,
                LinkEvent::Down { .. } => {}
                other => panic!("{other:?} instead of {wanted:?}"),
            }
        }
    }

    fn expect_down(&self) -> String {
        match self.next() {
            LinkEvent::Down { reason } => reason,
            other => panic!("{other:?} instead of Down"),
        }
    }

    fn expect_packet(&self, wanted: &[u8]) {
        match self.next() {
            LinkEvent::Packet { bytes, .. } => assert_eq!(bytes, wanted),
            other => panic!("{other:?} instead of a packet"),
        }
    }

    fn expect_drop(&self, cause: DropCause) {
        self.expect(&LinkEvent::Dropped(cause));
    }

    fn send(&self, packet: &[u8]) {
        self.handle.send(packet.to_vec()).unwrap();
        self.expect(&LinkEvent::Sent);
    }

    /// `[LNK-01]`: the threads hold the only senders of the channel, so it is closed exactly when all of them have ended.
    fn drop_and_see_threads_end(self) {
        drop(self.handle);
        let end = std::iter::repeat_with(|| self.inbox.try_recv()).find(Result::is_err);
        assert_eq!(end, Some(Err(TryRecvError::Disconnected)));
    }
}

/// A packet each way, of every byte there is.
fn exchange(one: &Side, other: &Side) {
    let there: Vec<u8> = (0..=255).collect();
    let back: Vec<u8> = there.iter().rev().copied().collect();
    one.send(&there);
    other.expect_packet(&there);
    other.send(&back);
    one.expect_packet(&back);
}

fn frame(packet: &[u8], check: Check) -> Vec<u8> {
    let mut out = vec![0; framing::encoded_len_max(packet.len(), check)];
    let len = framing::encode(packet, check, &mut out).unwrap();
    out.truncate(len);
    out
}

/// The address behind `tcp:` or `udp:`.
fn address(side: &Side) -> &str {
    &side.name()[4..]
}

/// A port that nobody listens on.
fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn pair(options: &LinkOptions, clock: &Clock) -> (Side, Side) {
    let ((left_events, left_inbox), (right_events, right_inbox)) = (sync_channel(64), sync_channel(64));
    let ends = [(gateway(), left_events), (gateway(), right_events)];
    let (left, right) = in_process::pair("test", ends, clock, options).unwrap();
    let (left, right) = (Side { handle: left, inbox: left_inbox }, Side { handle: right, inbox: right_inbox });
    left.expect(&LinkEvent::Up);
    right.expect(&LinkEvent::Up);
    (left, right)
}

/// Two connected sides over TCP.
fn tcp_pair(spec_tail: &str, listener: &LinkOptions, dialler: &LinkOptions) -> (Side, Side) {
    let listener = Side::listen(&format!("tcp:127.0.0.1:0{spec_tail}"), listener);
    let dialler = Side::open(&format!("{}{spec_tail}", listener.name()), dialler);
    dialler.expect(&LinkEvent::Up);
    listener.expect(&LinkEvent::Up);
    (listener, dialler)
}

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

/// `[LNK-05]`.
#[test]
fn with_the_key_packets_pass_and_without_it_nobody_does() {
    let (listener, dialler) = tcp_pair("", &with_key(1), &with_key(1));
    exchange(&dialler, &listener);
    drop(dialler);
    listener.expect_down();

    let stranger = Side::open(listener.name(), &with_key(2));
    stranger.expect_drop(DropCause::PeerRefused);
    listener.expect_drop(DropCause::PeerRefused);
    drop(stranger);

    let mut keyless = TcpStream::connect(address(&listener)).unwrap();
    keyless.write_all(&frame(&[5, 0, 7], Check::None)).unwrap();
    keyless.write_all(&[0xff; 64]).unwrap();
    listener.expect_drop(DropCause::PeerRefused);
}

/// `[LNK-05]`: who connects and says nothing does not keep the place.
#[test]
fn a_silent_peer_is_refused_and_the_next_one_served() {
    let listener = Side::listen("tcp:127.0.0.1:0", &with_key(1));
    let _silent = TcpStream::connect(address(&listener)).unwrap();
    let dialler = Side::open(listener.name(), &with_key(1));
    listener.expect_drop(DropCause::PeerRefused);
    listener.expect(&LinkEvent::Up);
    exchange_when_up(&dialler, &listener);
}

fn exchange_when_up(dialler: &Side, listener: &Side) {
    loop {
        match dialler.next() {
            LinkEvent::Up => return exchange(dialler, listener),
            LinkEvent::Down { .. } | LinkEvent::Dropped(DropCause::PeerRefused) => {}
            other => panic!("{other:?}"),
        }
    }
}

/// Both messages of a dialler's handshake with their lengths: 2 + 48 and 2 + 16 bytes.
const HANDSHAKE_BYTES: usize = 68;

/// Passes one connection on to `target`, the dialler's bytes through `change` by their offset, and gives them back as they came.
fn man_in_the_middle(target: String, change: fn(usize, u8) -> u8) -> (String, std::thread::JoinHandle<Vec<u8>>) {
    let proxy = TcpListener::bind("127.0.0.1:0").unwrap();
    let spec = format!("tcp:{}", proxy.local_addr().unwrap());
    let thread = std::thread::spawn(move || {
        let (mut dialler, _) = proxy.accept().unwrap();
        let mut listener = TcpStream::connect(target).unwrap();
        let (mut replies, mut back) = (listener.try_clone().unwrap(), dialler.try_clone().unwrap());
        let answers = std::thread::spawn(move || std::io::copy(&mut replies, &mut back));
        let (mut seen, mut chunk) = (Vec::new(), [0; 256]);
        while let Ok(len @ 1..) = dialler.read(&mut chunk) {
            let changed: Vec<u8> = chunk[..len].iter().enumerate().map(|(n, b)| change(seen.len() + n, *b)).collect();
            seen.extend_from_slice(&chunk[..len]);
            if listener.write_all(&changed).is_err() {
                break;
            }
        }
        let _ = dialler.shutdown(std::net::Shutdown::Both);
        let _ = listener.shutdown(std::net::Shutdown::Both);
        let _ = answers.join();
        seen
    });
    (spec, thread)
}

/// `[LNK-05]`: one bit of a message changed on its way ends the link, and the packet is not handed over.
#[test]
fn a_changed_message_closes_the_link() {
    let listener = Side::listen("tcp:127.0.0.1:0", &with_key(1));
    let flip = |at, byte| if at == HANDSHAKE_BYTES + 2 + 1 { byte ^ 1 } else { byte };
    let (spec, proxy) = man_in_the_middle(address(&listener).to_owned(), flip);
    let dialler = Side::open(&spec, &with_key(1));
    dialler.expect(&LinkEvent::Up);
    listener.expect(&LinkEvent::Up);
    dialler.send(&[5, 0, 7]);
    listener.expect_drop(DropCause::FrameCheck);
    listener.expect_down();
    drop(dialler);
    proxy.join().unwrap();
}

/// `[LNK-05]`: what was recorded of a good handshake opens nothing, and the packet in it is never seen.
#[test]
fn a_replayed_connection_is_refused() {
    let listener = Side::listen("tcp:127.0.0.1:0", &with_key(1));
    let (spec, proxy) = man_in_the_middle(address(&listener).to_owned(), |_, byte| byte);
    let dialler = Side::open(&spec, &with_key(1));
    dialler.expect(&LinkEvent::Up);
    listener.expect(&LinkEvent::Up);
    dialler.send(&[5, 0, 7]);
    listener.expect_packet(&[5, 0, 7]);
    drop(dialler);
    let recorded = proxy.join().unwrap();
    assert_eq!(recorded.len(), HANDSHAKE_BYTES + 2 + 3 + 16, "length, packet and tag: nothing is in the clear");
    assert!(!recorded.windows(3).any(|bytes| bytes == [5, 0, 7]));
    listener.expect_down();

    let mut replay = TcpStream::connect(address(&listener)).unwrap();
    replay.write_all(&recorded).unwrap();
    listener.expect_drop(DropCause::PeerRefused);
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
    // Counts are noted before the next packet is taken, so one more makes the first ten visible.
    dialler.send(&[1]);
    let outgoing = dialler.handle.faults().unwrap().outgoing;
    assert!((10..=11).contains(&outgoing.lost) && outgoing.delivered == 0, "{outgoing:?}");
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

#[cfg(unix)]
mod terminals {
    use super::*;
    use std::os::unix::fs::symlink;
    use std::path::PathBuf;

    /// The device a listening pseudo-terminal offers.
    fn device(side: &Side) -> &str {
        side.name().strip_prefix("pty:").unwrap()
    }

    #[test]
    fn a_pseudo_terminal_is_a_serial_port() {
        for tail in ["", ",check=none", ",check=crc32"] {
            let terminal = Side::listen(&format!("pty{tail}"), &plain());
            terminal.expect(&LinkEvent::Up);
            for _ in 0..2 {
                let port = Side::open(&format!("serial:{}@3000000{tail}", device(&terminal)), &plain());
                port.expect(&LinkEvent::Up);
                assert_eq!((port.handle.description.bit_rate, port.handle.description.bits_a_byte), (3_000_000, 10));
                exchange(&port, &terminal);
                port.drop_and_see_threads_end();
            }
            terminal.drop_and_see_threads_end();
        }
    }

    /// Nobody reads the terminal: its writer waits, and still ends with its handle.
    #[test]
    fn a_terminal_that_nobody_reads_ends() {
        let terminal = Side::listen("pty", &plain());
        terminal.expect(&LinkEvent::Up);
        loop {
            terminal.handle.send(vec![1; 1024]).unwrap();
            match terminal.inbox.recv_timeout(Duration::from_secs(1)) {
                Ok((_, LinkEvent::Sent)) => {}
                Ok(other) => panic!("{other:?}"),
                Err(_) => break,
            }
        }
        terminal.drop_and_see_threads_end();
    }

    /// A folder of its own, gone with the test.
    struct Folder(PathBuf);

    impl Drop for Folder {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }

    /// `[LNK-06]`: a device that is unplugged and comes back, as another pseudo-terminal under the same name.
    #[test]
    fn a_device_that_comes_back_is_opened_again() {
        let folder = Folder(std::env::temp_dir().join(format!("osap-links-{}", std::process::id())));
        std::fs::create_dir_all(&folder.0).unwrap();
        let name = folder.0.join("port");
        let plug = || {
            let terminal = Side::listen("pty", &plain());
            terminal.expect(&LinkEvent::Up);
            symlink(device(&terminal), &name).unwrap();
            terminal
        };
        let port = Side::open(&format!("serial:{}", name.display()), &plain());
        assert!(port.expect_down().contains("port"), "the reason names the device");
        for _ in 0..2 {
            let terminal = plug();
            port.expect(&LinkEvent::Up);
            exchange(&port, &terminal);
            std::fs::remove_file(&name).unwrap();
            drop(terminal);
            port.expect_down();
        }
    }
}

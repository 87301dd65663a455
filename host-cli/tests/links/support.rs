//! One side of a link under test, and waits for what it says.
//!
//! - **Walk:** every test here.
//! - **Invariant:** no wait is without end, and none says how long something may take.

use osap::link::{self, Clock, Key, LinkEvent, LinkHandle, LinkOptions, in_process};
use osap_protocol::framing::{self, Check};
use osap_protocol::{DropCause, GatewayIndex};
use std::net::TcpListener;
use std::sync::mpsc::{Receiver, TryRecvError, sync_channel};
use std::time::Duration;

/// Longest wait for an event: far longer than any should take, so that only a fault reaches it.
pub(crate) const PATIENCE: Duration = Duration::from_secs(20);

/// One side of a link under test, with a channel of its own for what it says.
pub(crate) struct Side {
    pub(crate) handle: LinkHandle,
    pub(crate) inbox: Receiver<(GatewayIndex, LinkEvent)>,
}

pub(crate) fn gateway() -> GatewayIndex {
    GatewayIndex::new(3).unwrap()
}

pub(crate) fn plain() -> LinkOptions {
    LinkOptions::default()
}

pub(crate) fn with_key(byte: u8) -> LinkOptions {
    LinkOptions { key: Some(Key::from_bytes([byte; Key::LEN])), ..plain() }
}

pub(crate) fn with_faults(text: &str) -> LinkOptions {
    LinkOptions { faults: Some(text.parse().unwrap()), ..plain() }
}

impl Side {
    pub(crate) fn open(spec: &str, options: &LinkOptions) -> Self {
        let (events, inbox) = sync_channel(64);
        let handle = link::open(&spec.parse().unwrap(), gateway(), events, &Clock::new(), options).unwrap();
        Self { handle, inbox }
    }

    pub(crate) fn listen(spec: &str, options: &LinkOptions) -> Self {
        Self::listen_with_room(spec, options, 64)
    }

    /// `room`: events that wait for this side at most.
    pub(crate) fn listen_with_room(spec: &str, options: &LinkOptions, room: usize) -> Self {
        let (events, inbox) = sync_channel(room);
        let handle = link::listen(&spec.parse().unwrap(), gateway(), events, &Clock::new(), options).unwrap();
        Self { handle, inbox }
    }

    pub(crate) fn name(&self) -> &str {
        &self.handle.description.name
    }

    pub(crate) fn next(&self) -> LinkEvent {
        let (from, event) = self.inbox.recv_timeout(PATIENCE).expect("an event");
        assert_eq!(from, gateway());
        event
    }

    /// Waits for `wanted`, past failed attempts to open but nothing else.
    pub(crate) fn expect(&self, wanted: &LinkEvent) {
        loop {
            match self.next() {
                event if event == *wanted => return,
                LinkEvent::Down { .. } => {}
                other => panic!("{other:?} instead of {wanted:?}"),
            }
        }
    }

    pub(crate) fn expect_down(&self) -> String {
        match self.next() {
            LinkEvent::Down { reason } => reason,
            other => panic!("{other:?} instead of Down"),
        }
    }

    pub(crate) fn expect_packet(&self, wanted: &[u8]) {
        match self.next() {
            LinkEvent::Packet { bytes, .. } => assert_eq!(bytes, wanted),
            other => panic!("{other:?} instead of a packet"),
        }
    }

    pub(crate) fn expect_drop(&self, cause: DropCause) {
        self.expect(&LinkEvent::Dropped(cause));
    }

    pub(crate) fn send(&self, packet: &[u8]) {
        self.handle.send(packet.to_vec()).unwrap();
        self.expect(&LinkEvent::Sent);
    }

    /// `[LNK-01]`: the threads hold the only senders of the channel, so it is closed exactly when all of them have ended.
    pub(crate) fn drop_and_see_threads_end(self) {
        drop(self.handle);
        let end = std::iter::repeat_with(|| self.inbox.try_recv()).find(Result::is_err);
        assert_eq!(end, Some(Err(TryRecvError::Disconnected)));
    }
}

/// A packet each way, of every byte there is.
pub(crate) fn exchange(one: &Side, other: &Side) {
    let there: Vec<u8> = (0..=255).collect();
    let back: Vec<u8> = there.iter().rev().copied().collect();
    one.send(&there);
    other.expect_packet(&there);
    other.send(&back);
    one.expect_packet(&back);
}

pub(crate) fn frame(packet: &[u8], check: Check) -> Vec<u8> {
    let mut out = vec![0; framing::encoded_len_max(packet.len(), check)];
    let len = framing::encode(packet, check, &mut out).unwrap();
    out.truncate(len);
    out
}

/// The address behind `tcp:` or `udp:`.
pub(crate) fn address(side: &Side) -> &str {
    &side.name()[4..]
}

/// A port that nobody listens on.
pub(crate) fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

pub(crate) fn pair(options: &LinkOptions, clock: &Clock) -> (Side, Side) {
    let ((left_events, left_inbox), (right_events, right_inbox)) = (sync_channel(64), sync_channel(64));
    let ends = [(gateway(), left_events), (gateway(), right_events)];
    let (left, right) = in_process::pair("test", ends, clock, options).unwrap();
    let (left, right) = (Side { handle: left, inbox: left_inbox }, Side { handle: right, inbox: right_inbox });
    left.expect(&LinkEvent::Up);
    right.expect(&LinkEvent::Up);
    (left, right)
}

/// Two connected sides over TCP.
pub(crate) fn tcp_pair(spec_tail: &str, listener: &LinkOptions, dialler: &LinkOptions) -> (Side, Side) {
    let listener = Side::listen(&format!("tcp:127.0.0.1:0{spec_tail}"), listener);
    let dialler = Side::open(&format!("{}{spec_tail}", listener.name()), dialler);
    dialler.expect(&LinkEvent::Up);
    listener.expect(&LinkEvent::Up);
    (listener, dialler)
}

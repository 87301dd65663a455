//! TCP with a key: who has it gets through, and nobody else, not even with a recording.
//!
//! - **Walk:** dialler → handshake → listener; in two of them past a man in the middle.
//! - **Clause:** `[LNK-05]`.

use crate::support::{Side, address, exchange, frame, tcp_pair, with_key};
use osap::link::LinkEvent;
use osap_protocol::DropCause;
use osap_protocol::framing::Check;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};

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

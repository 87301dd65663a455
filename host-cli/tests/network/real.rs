//! Over TCP to a device in real time. Nothing here depends on how long anything takes, but that it ends.

use super::support::{Responder, alone, gateway};
use osap::core::EventKind;
use osap::error::AskError;
use osap::link::{self, Clock, LinkOptions};
use osap::map::RouteText;
use osap::network::NetworkSpec;
use osap::scan::ScanOptions;
use osap::session::{OpenOptions, Session};
use osap_protocol::PortIndex;
use osap_protocol::transport::Transport;
use std::sync::mpsc::sync_channel;

/// A motor that listens, and the text of the link to it.
fn motor(name: &'static str) -> (Responder, NetworkSpec) {
    let (events, inbox) = sync_channel(64);
    let clock = Clock::new();
    let listener =
        link::listen(&"tcp:127.0.0.1:0".parse().unwrap(), gateway(), events, &clock, &LinkOptions::default()).unwrap();
    let spec = listener.description.name.parse().unwrap();
    (Responder::start(listener, inbox, clock, name), spec)
}

#[test]
fn a_device_behind_tcp_is_found_asked_and_echoes() {
    let _turn = alone();
    let (_motor, spec) = motor("axis-x");
    let mut session = Session::open(&[spec], &OpenOptions::default()).unwrap();
    let map = session.scan(&ScanOptions::default(), &mut |_| {}).unwrap().map;
    assert_eq!(map.devices.len(), 2, "{}", map.tree());
    let device = map.resolve("axis-x").unwrap();
    assert_eq!((device.route().to_string(), &*device.type_name), ("/0".to_owned(), "motor"));

    let to = session.destination_of(device);
    session.set_name(&to, "axis-y").unwrap();
    assert_eq!(session.name(&to).unwrap().value.as_str(), "axis-y");
    for transport in [Transport::Datagram, Transport::Sequenced] {
        assert_eq!(session.echo(&to, transport, b"hello").unwrap().payload, b"hello");
    }
    let long: Vec<u8> = (0..=255).cycle().take(3_000).collect();
    assert_eq!(session.echo(&to, Transport::Segmented, &long).unwrap().payload, long);
    assert!(session.counters(&to).unwrap().iter().all(|counter| counter.cause.is_some()));
    let events = session.network().events().unwrap();
    assert!(matches!(events[0].kind, EventKind::Up), "{events:?}");
}

/// A device that goes away is an event and a typed error that names it; no call hangs.
#[test]
fn a_device_that_goes_away_is_an_event_and_a_typed_error() {
    let _turn = alone();
    let (motor, spec) = motor("axis-x");
    let mut session = Session::open(&[spec], &OpenOptions::default()).unwrap();
    let map = session.scan(&ScanOptions::default(), &mut |_| {}).unwrap().map;
    let to = session.destination_of(map.resolve("axis-x").unwrap());
    drop(motor);
    let error = loop {
        // the link notices in its own time
        match session.type_name(&to) {
            Ok(_) => {}
            Err(error) => break error,
        }
    };
    let said = error.to_string();
    assert!(matches!(error, AskError::Send { .. } | AskError::Timeout { .. }), "{said}");
    assert!(said.contains("axis-x (/0)"), "{said}");
    let mut seen = Vec::new();
    while !seen.iter().any(|kind| matches!(kind, EventKind::Down(_))) {
        session.network().pause(fixed_math::time::Span::from_us(1_000)).unwrap();
        seen.extend(session.network().events().unwrap().into_iter().map(|event| event.kind));
    }
}

/// A link that nobody listens on: the host is found alone, questions are refused at once.
#[test]
fn a_link_to_nobody_is_no_hang() {
    let _turn = alone();
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let spec = format!("tcp:{}", free.local_addr().unwrap()).parse().unwrap();
    drop(free);
    let mut session = Session::open(&[spec], &OpenOptions::default()).unwrap();
    let map = session.scan(&ScanOptions::default(), &mut |_| {}).unwrap().map;
    assert_eq!((map.devices.len(), map.silent.len()), (1, 0), "{}", map.tree());
    let there = session.destination(&"/0".parse::<RouteText>().unwrap());
    let error = session.name(&there).unwrap_err();
    assert!(matches!(error, AskError::Send { .. }), "{error}");
    assert_eq!(there.port, PortIndex::NETRESPONDER);
}

/// What stands in a capture are the packets of the link.
#[test]
fn a_capture_holds_what_went_over_the_link() {
    let _turn = alone();
    let (_motor, spec) = motor("axis-x");
    let path = std::env::temp_dir().join(format!("osap-capture-{}.pcapng", std::process::id()));
    let options = OpenOptions { capture: Some(path.clone()), ..OpenOptions::default() };
    let mut session = Session::open(&[spec], &options).unwrap();
    session.scan(&ScanOptions::default(), &mut |_| {}).unwrap();
    assert_eq!(session.network().capture_fault(), None);
    drop(session);
    let bytes = std::fs::read(&path).unwrap();
    std::fs::remove_file(&path).unwrap();
    // a name is asked for and answered in clear
    assert!(bytes.windows(6).any(|window| window == b"axis-x"), "{} bytes", bytes.len());
}

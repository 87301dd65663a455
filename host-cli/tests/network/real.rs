//! Over TCP to a device in real time. Nothing here depends on how long anything takes, but that it ends.

use super::support::{Responder, alone, gateway};
use fixed_math::time::Span;
use osap::clocks::Clocks;
use osap::core::EventKind;
use osap::error::AskError;
use osap::link::{self, Clock, LinkOptions};
use osap::map::RouteText;
use osap::network::NetworkSpec;
use osap::scan::ScanOptions;
use osap::session::{OpenOptions, Session};
use osap_protocol::PortIndex;
use osap_protocol::discovery::UniqueId;
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

/// Clocks of the host and the motor, once both are settled on one root; the tries are there to end a failure.
fn settled(session: &mut Session) -> Clocks {
    let map = session.scan(&ScanOptions::default(), &mut |_| {}).unwrap().map;
    for _ in 0..1_000 {
        let clocks = session.read_clocks(&map).unwrap();
        if clocks.unsettled(Span::MAX).is_empty() {
            return clocks;
        }
        session.network().pause(Span::from_us(20_000)).unwrap();
    }
    panic!("the clocks did not settle: {:?}", session.read_clocks(&map).unwrap())
}

/// `[TIM-07]`, `[TIM-09]`: nobody told the host to lead, so it follows, and what it measures itself is within both bounds and the round trip.
#[test]
fn a_host_follows_the_devices_time() {
    let _turn = alone();
    let (_motor, spec) = motor("axis-x");
    let mut session = Session::open(&[spec], &OpenOptions::default()).unwrap();
    let clocks = settled(&mut session);
    let [host, motor] = [0, 1].map(|number| clocks.devices[number].as_ref().unwrap());
    assert_eq!((host.status.tier, motor.status.tier), (1, 0));
    assert_eq!(host.status.root, UniqueId([3; 12]));
    let measured = motor.measured.unwrap();
    let within = measured.within_steps + [host, motor].map(|clock| clock.bound().unwrap().steps()).iter().sum::<u64>();
    // between the two readings lie a few milliseconds, in which a map is slewed by 500 ppm at most
    let slewed = Span::from_us(100).steps();
    assert!(measured.offset_steps.unsigned_abs() <= within + slewed, "{measured:?}, {within}");
    assert_eq!(motor.refused.total() + host.refused.total(), 0);
}

/// `[TIM-07]`, `[TIM-14]`: a host that was told to lead is followed, and tells the time of day.
#[test]
fn a_host_that_was_told_to_leads() {
    let _turn = alone();
    let (_motor, spec) = motor("axis-x");
    let mut session = Session::open(&[spec], &OpenOptions { root: Some(0), ..OpenOptions::default() }).unwrap();
    let to = session.destination(&"/0".parse::<RouteText>().unwrap());
    settled(&mut session);
    let told = (0..1_000).find_map(|_| {
        session.network().pause(Span::from_us(20_000)).unwrap();
        let status = session.time_status(&to).unwrap().value;
        status.unix_offset_us.map(|offset_us| (status, offset_us))
    });
    let (status, offset_us) = told.expect("the motor heard the time of day");
    assert_eq!((status.tier, status.root_priority), (1, 0));
    let system = session.time_control(&to).unwrap().value.system_time_steps / 256;
    let unix_s = (i64::try_from(system).unwrap() + offset_us) / 1_000_000;
    // of this century: that it is the computer's own time is not this test's to judge
    assert!((946_684_800..4_102_444_800).contains(&unix_s), "{unix_s}");
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

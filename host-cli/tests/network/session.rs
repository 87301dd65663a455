//! Questions, echoes, pings and loads in simulated networks.

use fixed_math::time::Span;
use osap::bench::BenchOptions;
use osap::error::{AskError, OpenError};
use osap::map::NetworkMap;
use osap::network::{Network, SimNetwork};
use osap::ping::{PingOptions, PingResult};
use osap::scan::ScanOptions;
use osap::session::{OpenOptions, Session};
use osap_protocol::discovery::{Query, Refusal, Verbosity};
use osap_protocol::transport::Transport;
use osap_protocol::{DropCause, PortIndex};
use osap_runtime::sequenced::Destination;
use osap_sim::faults::FaultConfig;
use osap_sim::world::LinkModel;

const SEED: u64 = 5;

fn scanned(network: SimNetwork) -> (Session, NetworkMap) {
    let mut session = Session::over(network);
    let map = session.scan(&ScanOptions::default(), &mut |_| {}).unwrap().map;
    (session, map)
}

#[test]
fn every_query_has_a_call() {
    let (mut session, map) = scanned(SimNetwork::printer(SEED));
    let to = session.destination_of(map.resolve("Load Cell").unwrap());
    assert_eq!(session.type_name(&to).unwrap().value.as_str(), "loadcell");
    assert_eq!(session.name(&to).unwrap().value.as_str(), "Load Cell");
    assert_eq!(session.runtime_info(&to).unwrap().value.gateways, 1);
    assert_eq!(session.link_info(&to, 0).unwrap().value.type_name.as_str(), "uart");
    assert_eq!(session.port_info(&to, 1).unwrap().value.type_name.as_str(), "echo");
    let mut settings = osap_runtime::clock::DEFAULT_SETTINGS;
    settings.interval_us = 77_000;
    session.set_time_control(&to, &settings).unwrap();
    assert_eq!(session.time_control(&to).unwrap().value.interval_us, 77_000);
    let counters = session.counters(&to).unwrap();
    assert!(counters.iter().map(|counter| counter.cause).eq(DropCause::ALL.iter().copied().map(Some)));

    session.set_verbosity(&to, Verbosity::Packets).unwrap();
    for _ in 0..4 {
        session.name(&to).unwrap();
    }
    let log = session.debug_log(&to, 0).unwrap();
    // each question that reads the log is written down in it as well, so that some of what it was to read is gone
    assert_eq!(log.verbosity, Verbosity::Packets);
    assert!(log.events.len() >= 4 && log.missed > 0, "{log:?}");
    assert_eq!(log.next - log.first - log.missed, u32::try_from(log.events.len()).unwrap(), "{log:?}");
    session.set_verbosity(&to, Verbosity::Events).unwrap();
    let log = session.debug_log(&to, 0).unwrap();
    assert_eq!((log.missed, log.events.len()), (0, osap_runtime::debug::DEBUG_EVENTS));
}

#[test]
fn refusals_and_silence_say_who_and_what_to_do() {
    let (mut session, map) = scanned(SimNetwork::line(2, LinkModel::WIRE, SEED));
    let to = session.destination_of(map.resolve("hub-2").unwrap());
    let error = session.link_info(&to, 9).unwrap_err();
    assert!(matches!(error, AskError::Refused { refusal: Refusal::Index, .. }));
    assert_eq!(
        error.to_string(),
        "hub-2 (/0/1) refused link information: the device has no gateway or port of this index. \
         Scan again: the map may be older than its firmware"
    );
    let error = session.set_name(&to, &"n".repeat(33)).unwrap_err();
    assert!(matches!(error, AskError::Refused { refusal: Refusal::Range, .. }), "{error}");
    let nowhere = session.destination(&"/0/1/1".parse().unwrap());
    let error = session.name(&nowhere).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the device at /0/1/1 did not answer runtime name: 4 tries of 50000 µs each. \
         Check that it is powered and plugged in; a new scan shows what is reachable"
    );
    let error =
        session.request(&Destination { port: PortIndex::NETRESPONDER, ..to }, "a long one", &[1; 513]).unwrap_err();
    assert!(matches!(error, AskError::Send { .. }), "{error}");
}

/// More questions than the window and the core hold: each has its answer in its own place.
#[test]
fn many_questions_are_answered_in_order() {
    let (mut session, map) = scanned(SimNetwork::printer(SEED));
    let devices: Vec<_> = map.devices.iter().cycle().take(200).collect();
    let questions: Vec<_> = devices.iter().map(|device| (session.destination_of(device), ())).collect();
    let answers = session.ask_many::<(), osap_protocol::discovery::Name>(Query::RuntimeName, &questions).unwrap();
    let names: Vec<String> = answers.into_iter().map(|answer| answer.unwrap().value.as_str().to_owned()).collect();
    assert!(names.iter().eq(devices.iter().map(|device| &device.name)));
}

#[test]
fn echoes_come_back_over_every_transport() {
    let (mut session, map) = scanned(SimNetwork::line(3, LinkModel::WIRE, SEED));
    let to = session.destination_of(map.resolve("hub-3").unwrap());
    for len in [1, 60, 200] {
        let payload: Vec<u8> = (0..=255).take(len).collect();
        for transport in [Transport::Datagram, Transport::Sequenced, Transport::Segmented] {
            assert_eq!(session.echo(&to, transport, &payload).unwrap().payload, payload, "{transport:?}, {len}");
        }
    }
    let long: Vec<u8> = (0..=255).cycle().take(4_000).collect();
    assert_eq!(session.echo(&to, Transport::Segmented, &long).unwrap().payload, long);
    let error = session.echo(&to, Transport::Segmented, &[7; 5_000]).unwrap_err();
    assert!(matches!(error, AskError::MessageRefused { .. }), "{error}");
}

/// Over a perfect wire each round trip is the same; over a lossy one, what was lost is counted and in no average.
#[test]
fn pings_count_what_was_lost_apart() {
    let options = PingOptions { count: 50, interval: Span::from_us(10_000), ..PingOptions::default() };
    let (mut session, map) = scanned(SimNetwork::line(2, LinkModel::WIRE, SEED));
    let to = session.destination_of(map.resolve("hub-2").unwrap());
    let clean = session.ping(&to, &options, &mut |_, _| {}).unwrap();
    assert_eq!((clean.sent, clean.answered, clean.late, clean.lost), (50, 50, 0, 0));
    assert!(clean.min_us > 0.0 && clean.max_us < 5_000.0, "{clean:?}");

    let faults = FaultConfig { loss: 0.2, seed: SEED, ..FaultConfig::default() };
    let mut session = Session::over(SimNetwork::line(2, LinkModel { faults: Some(faults), ..LinkModel::WIRE }, SEED));
    let mut results = Vec::new();
    let lossy = session.ping(&to, &options, &mut |_, result| results.push(result)).unwrap();
    let answered = results.iter().filter(|result| matches!(result, PingResult::Answered(_))).count();
    assert_eq!(usize::try_from(lossy.answered).unwrap(), answered);
    assert_eq!(lossy.answered + lossy.late + lossy.lost, 50);
    assert!(lossy.late > 5 && lossy.max_us < 50_000.0, "{lossy:?}");
}

/// A wider window carries more, and nothing comes back as something else.
#[test]
fn a_wider_window_carries_more() {
    let (mut session, map) = scanned(SimNetwork::line(3, LinkModel::WIRE, SEED));
    let to = session.destination_of(map.resolve("hub-3").unwrap());
    let [narrow, wide] = [1, 4].map(|window| {
        let options = BenchOptions { window, count: 300, ..BenchOptions::default() };
        session.bench(&to, &options).unwrap()
    });
    for report in [narrow, wide] {
        assert_eq!((report.answered, report.late, report.lost, report.corrupt), (300, 0, 0, 0));
    }
    assert!(wide.messages_s > 1.5 * narrow.messages_s, "{narrow:?} {wide:?}");
}

#[test]
fn waiting_for_nothing_is_an_error_and_not_a_wait() {
    let mut network = SimNetwork::line(1, LinkModel::WIRE, SEED);
    assert_eq!(network.wait(), Err(osap::error::NetworkError::Idle));
    assert!(matches!(Session::open(&[], &OpenOptions::default()), Err(OpenError::NoLink)));
    let two = ["sim:printer".parse().unwrap(), "tcp:127.0.0.1:1".parse().unwrap()];
    assert!(matches!(Session::open(&two, &OpenOptions::default()), Err(OpenError::SimulationNotAlone { .. })));
}

//! The services of a device, end to end through a hub.

mod common;

use common::{add_probe, assert_all_slots_home, gateway, over, probe, us, with_probe};
use firmware_app::kind;
use firmware_app::stream::{StreamAnswer, StreamHead, StreamRefusal, StreamRequest};
use osap_protocol::transport::{SegmentRefusal, SequencedKind};
use osap_runtime::segmented::Progress;
use osap_sim::device::SimDevice;
use osap_sim::machines::{RP2040_200_MHZ, UART, add_device};
use osap_sim::time::ClockModel;
use osap_sim::world::{LinkModel, NodeId, World};

const ECHO: u16 = 1;
const STREAM: u16 = 2;

/// probe — hub — motor, and a second probe on the hub.
struct Bench {
    world: World,
    host: NodeId,
    other: NodeId,
    motor: NodeId,
}

fn bench(seed: u64, faults: &str) -> Bench {
    let mut world = World::new(seed);
    let host = add_probe(&mut world, &[UART]);
    let other = add_probe(&mut world, &[UART]);
    let perfect = ClockModel::PERFECT;
    let hub = add_device(&mut world, &kind::HUB, "hub", vec![UART; 3], RP2040_200_MHZ, perfect);
    let motor = add_device(&mut world, &kind::MOTOR, "motor", vec![UART], RP2040_200_MHZ, perfect);
    let model = LinkModel { faults: Some(faults.parse().unwrap()), ..LinkModel::WIRE };
    world.connect((host, gateway(0)), (hub, gateway(0)), model);
    world.connect((hub, gateway(1)), (motor, gateway(0)), model);
    world.connect((other, gateway(0)), (hub, gateway(2)), LinkModel::WIRE);
    world.run_for(us(10_000));
    Bench { world, host, other, motor }
}

fn pattern(len: usize) -> Vec<u8> {
    (0..len).map(|n| u8::try_from(n * 7 % 251).unwrap()).collect()
}

/// `[APP-02]`
#[test]
fn datagrams_and_requests_come_back_unchanged() {
    let Bench { mut world, host, .. } = bench(1, "");
    let there = over(&[0, 1], ECHO, 20_000);
    with_probe(&mut world, host, |it, now| {
        it.datagram(&there, &pattern(100), now).unwrap();
        it.datagram(&there, &[], now).unwrap();
        it.ask(there.clone(), &pattern(64), now);
    });
    world.run_for(us(100_000));
    let probe = probe(&world, host);
    let came: Vec<&[u8]> = probe.datagrams.iter().map(|(_, payload)| payload.as_slice()).collect();
    assert_eq!(came, [&pattern(100)[..], &[]]);
    assert_eq!((probe.answers[0].kind, &probe.answers[0].payload), (SequencedKind::Reply, &pattern(64)));
    assert_eq!(probe.answers[0].tries, 1);
    assert_all_slots_home(&world);
}

/// `[APP-03]`, `[TRN-09]`, `[TRN-10]`: 4000 bytes there and back whole, with one frame in twenty lost on each of two links.
#[test]
fn a_message_comes_back_whole_over_lossy_links() {
    for seed in 1..=5 {
        let Bench { mut world, host, .. } = bench(seed, "loss=0.05,seed=9");
        let message = pattern(4_000);
        with_probe(&mut world, host, |it, now| it.message(&over(&[0, 1], ECHO, 20_000), 1, message.clone(), now));
        world.run_for(us(3_000_000));
        let probe = probe(&world, host);
        assert_eq!(probe.progress, Some(Progress::Done), "seed {seed}");
        assert_eq!(probe.messages, [message], "seed {seed}");
        assert_all_slots_home(&world);
    }
}

/// `[APP-03]`: a message longer than the device takes is refused, not cut.
#[test]
fn a_message_over_the_limit_is_refused() {
    let Bench { mut world, host, .. } = bench(1, "");
    with_probe(&mut world, host, |it, now| it.message(&over(&[0, 1], ECHO, 20_000), 1, pattern(4_097), now));
    world.run_for(us(500_000));
    assert_eq!(probe(&world, host).progress, Some(Progress::Refused(SegmentRefusal::TooLong)));
    assert!(probe(&world, host).messages.is_empty());
    assert_all_slots_home(&world);
}

/// `[APP-04]`, `[TRN-09]`: while a message comes in and while it goes back another sender is told that the port is busy, and the message
/// stays whole; then the other is served.
#[test]
fn a_second_sender_is_told_that_the_port_is_busy() {
    for while_it_goes_back in [false, true] {
        let Bench { mut world, host, other, .. } = bench(1, "");
        let there = over(&[0, 1], ECHO, 20_000);
        with_probe(&mut world, host, |it, now| it.message(&there, 1, pattern(4_000), now));
        world.run_for(us(5_000));
        while while_it_goes_back && probe(&world, host).progress != Some(Progress::Done) {
            world.run_for(us(100));
        }
        assert!(probe(&world, host).messages.is_empty());
        with_probe(&mut world, other, |it, now| it.message(&there, 1, pattern(300), now));
        world.run_for(us(500_000));
        assert_eq!(probe(&world, other).progress, Some(Progress::Refused(SegmentRefusal::Busy)));
        assert!(probe(&world, other).messages.is_empty());
        assert_eq!(probe(&world, host).messages, [pattern(4_000)]);
        with_probe(&mut world, other, |it, now| it.message(&there, 2, pattern(300), now));
        world.run_for(us(500_000));
        assert_eq!(probe(&world, other).messages, [pattern(300)]);
        assert_all_slots_home(&world);
    }
}

fn ask_stream(bench: &mut Bench, request: StreamRequest) -> Result<StreamAnswer, u8> {
    let before = probe(&bench.world, bench.host).answers.len();
    with_probe(&mut bench.world, bench.host, |it, now| it.ask(over(&[0, 1], STREAM, 20_000), &request.encode(), now));
    bench.world.run_for(us(5_000));
    let answer = &probe(&bench.world, bench.host).answers[before];
    match answer.kind {
        SequencedKind::Reply => Ok(StreamAnswer::decode(&answer.payload).unwrap()),
        _ => Err(answer.payload[0]),
    }
}

const STOP: StreamRequest = StreamRequest { interval_us: 0, payload_bytes: 0, count: 0, ttl_us: 0 };

/// `[APP-05]`, `[APP-07]`: the datagrams come, one an interval, numbered and stamped.
#[test]
fn a_stream_comes_at_its_interval() {
    let mut bench = bench(1, "");
    let request = StreamRequest { interval_us: 2_000, payload_bytes: 20, count: 5, ttl_us: 10_000 };
    assert_eq!(ask_stream(&mut bench, request), Ok(StreamAnswer::default()));
    bench.world.run_for(us(100_000));
    let datagrams = &probe(&bench.world, bench.host).datagrams;
    let heads: Vec<StreamHead> = datagrams.iter().map(|(_, payload)| StreamHead::decode(payload).unwrap()).collect();
    assert_eq!(heads.iter().map(|head| head.number).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
    assert!(datagrams.iter().all(|(_, payload)| payload.len() == 20 && payload[12..] == [0; 8]));
    for pair in heads.windows(2) {
        // due at the interval; made when the processor was free, one packet's handling after it became due
        let apart = pair[1].made.since(pair[0].made);
        assert!(apart.as_us_floor().abs_diff(2_000) <= 30, "{apart:?}");
    }
    assert_eq!(ask_stream(&mut bench, STOP), Ok(StreamAnswer { sent: 5, shed: 0 }));
    bench.world.run_for(us(100_000));
    assert_all_slots_home(&bench.world);
}

/// `[APP-09]`, `[NOD-05]`: asked for seven times what its wire carries, a stream sheds, counts, and leaves queries alone.
#[test]
fn an_overloaded_stream_sheds_and_counts() {
    let mut bench = bench(1, "");
    let request = StreamRequest { interval_us: 100, payload_bytes: 200, count: 5_000, ttl_us: 20_000 };
    assert_eq!(ask_stream(&mut bench, request), Ok(StreamAnswer::default()));
    for _ in 0..50 {
        let key = common::query(osap_protocol::discovery::Query::TimeControl);
        with_probe(&mut bench.world, bench.host, |it, now| it.ask(over(&[0, 1], 0, 20_000), &key, now));
        bench.world.run_for(us(9_000));
    }
    bench.world.run_for(us(200_000));
    let answer = ask_stream(&mut bench, STOP).unwrap();
    assert_eq!(answer.sent + answer.shed, 5_000);
    assert!(answer.shed > 3_500 && answer.sent > 500, "{answer:?}");
    let host = probe(&bench.world, bench.host);
    assert_eq!(host.failed, 0);
    assert_eq!(host.answers.iter().filter(|answer| answer.tries == 1).count(), 52, "each query was answered at once");
    assert_eq!(host.datagrams.len(), answer.sent as usize, "what was sent arrived");
    bench.world.run_for(us(100_000));
    assert_all_slots_home(&bench.world);
}

/// `[APP-06]`: what is out of range is refused, with its reason, and the running stream goes on.
#[test]
fn requests_out_of_range_are_refused() {
    let mut bench = bench(1, "");
    let good = StreamRequest { interval_us: 10_000, payload_bytes: 12, count: 4, ttl_us: 5_000 };
    ask_stream(&mut bench, good).unwrap();
    let range = Err(StreamRefusal::Range as u8);
    // the way back has two steps: 256 − 9 − 2 bytes of payload
    for bad in [
        StreamRequest { interval_us: 49, ..good },
        StreamRequest { interval_us: 10_000_001, ..good },
        StreamRequest { payload_bytes: 11, ..good },
        StreamRequest { payload_bytes: 246, ..good },
        StreamRequest { ttl_us: 0, ..good },
    ] {
        assert_eq!(ask_stream(&mut bench, bad), range, "{bad:?}");
    }
    bench.world.run_for(us(100_000));
    assert_eq!(probe(&bench.world, bench.host).datagrams.len(), 4);
    let longest = StreamRequest { payload_bytes: 245, count: 1, ..good };
    assert_eq!(ask_stream(&mut bench, longest), Ok(StreamAnswer { sent: 4, shed: 0 }));
    with_probe(&mut bench.world, bench.host, |it, now| it.ask(over(&[0, 1], STREAM, 20_000), &[1, 2, 3], now));
    bench.world.run_for(us(10_000));
    let last = probe(&bench.world, bench.host).answers.last().unwrap();
    assert_eq!((last.kind, &last.payload[..]), (SequencedKind::Refusal, &[StreamRefusal::Malformed as u8][..]));
}

/// `[APP-06]`: a request that claims larger packets than the device has is held to the device's own; it once read past its memory.
#[test]
fn a_claimed_packet_size_is_not_believed() {
    let mut bench = bench(1, "");
    let request = StreamRequest { interval_us: 1_000, payload_bytes: 1_000, count: 3, ttl_us: 5_000 };
    with_probe(&mut bench.world, bench.host, |it, now| {
        let there = osap_runtime::sequenced::Destination { mtu_bytes: 60_000, ..over(&[0, 1], STREAM, 20_000) };
        it.ask(there, &request.encode(), now)
    });
    bench.world.run_for(us(20_000));
    let host = probe(&bench.world, bench.host);
    assert_eq!((host.answers[0].kind, host.answers[0].payload[0]), (SequencedKind::Refusal, 2));
    assert!(host.datagrams.is_empty());
}

/// `[APP-08]`, `[TRN-06]`: with every frame there twice, each request comes twice, and the stream still begins once.
#[test]
fn a_repeated_request_changes_nothing() {
    let mut bench = bench(1, "dup=1,seed=1");
    let request = StreamRequest { interval_us: 1_000, payload_bytes: 12, count: 10, ttl_us: 5_000 };
    ask_stream(&mut bench, request).unwrap();
    bench.world.run_for(us(50_000));
    let motor = bench.world.endpoint::<SimDevice>(bench.motor).unwrap();
    assert_eq!(motor.next_wake(), motor.node().next_wake(), "no stream is left");
    // ten datagrams, doubled on each of two links
    assert_eq!(probe(&bench.world, bench.host).datagrams.len(), 40);
    assert_eq!(ask_stream(&mut bench, STOP), Ok(StreamAnswer { sent: 10, shed: 0 }));
}

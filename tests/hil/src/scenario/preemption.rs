//! A user port that spins for 50 ms, and the hub still forwards.
//!
//! - **Walk:** a request to the hub's spin port; meanwhile a stream of the device behind it and pings to that device pass through the hub
//!   → forwarding latencies from the wires' stamps, waits of bytes and interrupts from the processor's profile.
//! - **Invariants:** a packet is found again by its bytes behind the route. Virtual time. The Cortex-M7's part, by counting, is in
//!   `preemption_m7`.
//! - **Clauses:** `[APP-10]`, `[NOD-08]`.

use super::Context;
use crate::cosim::{NS_PER_MS, Ns, Profile};
use crate::network::{FrameRecord, PACKET_BYTES};
use crate::pico::{Bench, cycles_us, route, us};
use crate::report::{Failure, Report, table};
use firmware_app::stream::StreamRequest;
use fixed_math::time::{LocalTicks, Span};
use osap::core::{Completion, HostCore, Outcome};
use osap::network::Network;
use osap_protocol::PortIndex;
use osap_protocol::framing::{Check, Deframer};
use osap_protocol::header::PORT_HEADER_BYTES;
use osap_protocol::transport::Transport;
use osap_runtime::sequenced::{Destination, Expect};
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};

/// Ports of every device, `[APP-01]`.
const STREAM: PortIndex = PortIndex::from_low_bits(2);
const SPIN: PortIndex = PortIndex::from_low_bits(3);
/// The spin lasts at least so long.
const SPIN_NS: Ns = 50 * NS_PER_MS;
/// Turns of the first spin, whose time tells what a turn takes.
const TRIAL_TURNS: u32 = 100_000;
/// The device's stream: one packet in two milliseconds. What is forwarded makes the spin longer, and its answer has 65 ms.
const STREAM_INTERVAL_US: u32 = 2_000;
/// From one ping to the next.
const PING_INTERVAL: Span = Span::from_us(4_130);
/// Its packets in one measurement, a little longer than the spin.
const STREAM_COUNT: u32 = 35;
/// Payload of a stream's packet.
const STREAM_BYTES: u16 = 40;
/// The longest frame on a wire of 3 Mbaud, ns: what has begun to leave is not taken back.
const LONGEST_FRAME_NS: Ns = 262 * 10 * 1_000 / 3;

/// What was seen of one measurement.
struct Seen {
    latencies_ns: Vec<Ns>,
    stream_came: u32,
    pings_lost: u32,
    spun_ns: Ns,
    profile: Profile,
}

pub(super) fn run(context: &Context) -> Result<Report, Failure> {
    let mut bench = Bench::hub_and_device(&context.places, context.seed, None)?;
    let hub = bench.session.destination(&route("/0"));
    let trial_ns = spin(&mut bench, &hub, TRIAL_TURNS)?;
    // what is forwarded meanwhile makes it longer still; a packet lives 65 ms at most, and so must the answer
    let turns = u64::from(TRIAL_TURNS) * SPIN_NS / trial_ns.max(1);
    let turns = u32::try_from(turns * 9 / 10).unwrap_or(u32::MAX);
    let without = measure(&mut bench, None)?;
    let with = measure(&mut bench, Some(turns))?;
    let mut report = Report::new();
    report.line(format!(
        "Forwarding through a Pico hub while its user port spins for {:.1} ms ({turns} turns), seed {}: virtual time, µs",
        us(with.spun_ns) / 1_000.0,
        context.seed
    ));
    describe(&mut report, &without, &with);
    report.check(with.spun_ns >= SPIN_NS, format!("the user port spun for {:.1} ms", us(with.spun_ns) / 1_000.0));
    for (name, seen) in [("without", &without), ("with", &with)] {
        let (came, lost) = (seen.stream_came, seen.pings_lost);
        report.check(
            came == STREAM_COUNT && lost == 0,
            format!("{name} the spin: {came} of {STREAM_COUNT} stream packets, {lost} pings lost"),
        );
    }
    let [worst_without, worst_with] = [&without, &with].map(|seen| seen.latencies_ns.last().copied().unwrap_or(0));
    report.check(
        worst_with <= worst_without + LONGEST_FRAME_NS,
        format!(
            "forwarding takes {:.1} µs at worst with the spin, {:.1} without: within one frame's time",
            us(worst_with),
            us(worst_without)
        ),
    );
    match super::preemption_m7::run(context) {
        Ok(counted) => report.add(counted),
        Err(Failure::NotRun(why)) => report.not_run("the same on a Cortex-M7, by counting", why),
        Err(failed @ Failure::Failed(_)) => return Err(failed),
    }
    Ok(report)
}

/// Has a device spin, and says how long it took.
pub(super) fn spin(bench: &mut Bench, to: &Destination, turns: u32) -> Result<Ns, Failure> {
    let to = Destination { port: SPIN, ttl_us: u16::MAX, ..to.clone() };
    let began = bench.now_ns();
    bench.session.request(&to, "spin", &turns.to_le_bytes())?;
    Ok(bench.now_ns() - began)
}

/// Streams and pings through the hub, for as long as the stream goes on.
fn measure(bench: &mut Bench, turns: Option<u32>) -> Result<Seen, Failure> {
    let hub = bench.session.destination(&route("/0"));
    let device = bench.session.destination(&route("/0/1"));
    let stream = Destination { port: STREAM, ..device.clone() };
    let request = StreamRequest {
        interval_us: STREAM_INTERVAL_US,
        payload_bytes: STREAM_BYTES,
        count: STREAM_COUNT,
        ttl_us: 20_000,
    };
    bench.cosim.borrow_mut().profile("hub", true)?;
    bench.keep_frames(true);
    let began = bench.now_ns();
    let mut spinning = None;
    if let Some(turns) = turns {
        let to = Destination { port: SPIN, ttl_us: u16::MAX, ..hub };
        let sent = bench.session.network().submit(to, Expect::One, &turns.to_le_bytes());
        spinning = Some(sent.map_err(|error| Failure::Failed(format!("the spin was not sent: {error:?}")))?);
    }
    let network = bench.session.network();
    let send = |network: &mut dyn Network, to: &Destination, payload: &[u8]| {
        network
            .submit(to.clone(), Expect::One, payload)
            .map_err(|error| Failure::Failed(format!("not sent: {error:?}")))
    };
    let asked = send(network, &stream, &request.encode())?;
    let (mut spun_ns, mut pings_lost) = (0, 0);
    let end = network.now() + Span::from_us(u64::from(STREAM_INTERVAL_US * (STREAM_COUNT + 4)));
    let mut open = vec![asked];
    let mut ping_at = network.now();
    while network.now() < end || spinning.is_some() {
        let now = network.now();
        if open.is_empty() && now >= ping_at && now < end {
            open.push(send(network, &Destination { port: PortIndex::NETRESPONDER, ..device.clone() }, &question())?);
            ping_at = now + PING_INTERVAL;
        }
        let is_waiting = open.is_empty() && now < end;
        let Some(completion) = next(network, if is_waiting { ping_at.min(end) } else { LocalTicks::MAX })? else {
            continue;
        };
        if Some(completion.ticket) == spinning {
            spinning = None;
            spun_ns = crate::network::first_ns(network.now()) - began;
            if !matches!(&completion.outcome, Outcome::Reply(reply) if reply.tries == 1) {
                return Err(Failure::Failed(format!("the spin was not answered: {:?}", completion.outcome)));
            }
        } else {
            open.retain(|ticket| *ticket != completion.ticket);
            let once = matches!(&completion.outcome, Outcome::Reply(reply) if reply.tries == 1);
            pings_lost += u32::from(!once);
        }
    }
    let profile = bench.cosim.borrow_mut().profile("hub", false)?;
    let frames = bench.keep_frames(false);
    let mut latencies_ns = latencies(&frames);
    latencies_ns.sort_unstable();
    let numbers: BTreeSet<u32> =
        frames.iter().filter(|frame| frame.place == "host").filter_map(stream_number).collect();
    let stream_came = u32::try_from(numbers.len()).unwrap_or(0);
    Ok(Seen { latencies_ns, stream_came, pings_lost, spun_ns, profile })
}

/// The next answer, if it comes before `until`.
fn next(network: &mut dyn Network, until: LocalTicks) -> Result<Option<Completion>, Failure> {
    let (found, result) = std::sync::mpsc::sync_channel(1);
    // one message: the task is called no more after it said so
    let task = move |core: &mut HostCore, _| {
        core.take_completion().is_some_and(|completion| found.try_send(completion).is_ok())
    };
    network.drive(until, Box::new(task))?;
    Ok(result.try_recv().ok())
}

/// The 76-byte question, `[DSC-07]`.
fn question() -> Vec<u8> {
    vec![osap_protocol::discovery::Query::TimeControl.key(), osap_protocol::discovery::VERSION]
}

/// From a frame's last stop bit into the hub to its first start bit out of it, for every packet that was seen on both sides.
fn latencies(frames: &[FrameRecord]) -> Vec<Ns> {
    let mut came: BTreeMap<(bool, Vec<u8>), Ns> = BTreeMap::new();
    let mut all = Vec::new();
    let ordered = |place: &str| match place {
        ">host" => Some((true, true)),
        "inner:ab" => Some((true, false)),
        "inner:ba" => Some((false, true)),
        "host" => Some((false, false)),
        _ => None,
    };
    let mut frames: Vec<&FrameRecord> = frames.iter().collect();
    frames.sort_by_key(|frame| frame.end_ns);
    for frame in frames {
        let Some((is_outward, is_in)) = ordered(&frame.place) else { continue };
        let Some(body) = body(&frame.bytes) else { continue };
        if is_in {
            came.insert((is_outward, body), frame.end_ns);
        } else if let Some(end_ns) = came.remove(&(is_outward, body)) {
            all.push(frame.start_ns.saturating_sub(end_ns));
        }
    }
    all
}

/// What stays the same along the way: everything behind a route of two steps.
fn body(bytes: &[u8]) -> Option<Vec<u8>> {
    let mut deframer = Deframer::<{ PACKET_BYTES + 2 }>::new(Check::Crc16);
    let packet = bytes
        .iter()
        .find_map(|byte| deframer.push(*byte, LocalTicks::ZERO)?.ok().map(|frame| frame.packet.to_vec()))?;
    // the transport's key and what follows; announcements are shorter or differ on both sides
    packet.get(PORT_HEADER_BYTES + 1..).map(<[u8]>::to_vec)
}

/// The number of a datagram of the stream, `[APP-07]`.
fn stream_number(frame: &FrameRecord) -> Option<u32> {
    let body = body(&frame.bytes)?;
    let (key, payload) = body.split_first()?;
    let is_stream = *key == Transport::Datagram.key() && payload.len() == usize::from(STREAM_BYTES);
    payload.first_chunk().filter(|_| is_stream).map(|number| u32::from_le_bytes(*number))
}

fn describe(report: &mut Report, without: &Seen, with: &Seen) {
    let rank = |times: &[Ns], percent: usize| {
        times.get((times.len() * percent).div_ceil(100).max(1) - 1).copied().unwrap_or(0)
    };
    let row = |name: &str, seen: &Seen| {
        let times = &seen.latencies_ns;
        let waits = seen.profile.uarts.iter().map(|uart| uart.rx_wait_ns_max).fold(0.0, f64::max);
        let figures = [
            us(rank(times, 50)),
            us(rank(times, 99)),
            us(rank(times, 100)),
            waits / 1_000.0,
            cycles_us(seen.profile.irq(11).latency_cycles_max),
            cycles_us(seen.profile.irq(26).latency_cycles_max),
            cycles_us(seen.profile.primask_cycles_max),
        ];
        let cells = figures.map(|figure| format!("{figure:.2}"));
        [name.to_owned(), times.len().to_string()].into_iter().chain(cells).collect::<Vec<String>>()
    };
    let head =
        ["user port", "forwarded", "median", "p99", "max", "byte waits", "interrupt waits", "route waits", "masked"];
    report.line(table(&head, &[row("idle", without), row("spinning", with)]));
    report.line("Byte waits: from its arrival in the UART to the DMA. Interrupt waits: from pending to the receive interrupt's first instruction.");
    for (name, seen) in [("idle", without), ("spinning", with)] {
        report.datum(name, json!({ "max_us": us(rank(&seen.latencies_ns, 100)), "p99_us": us(rank(&seen.latencies_ns, 99)), "forwarded": seen.latencies_ns.len() }));
    }
}

//! Full load both ways through a Pico hub with byte errors on both links: nothing delivered wrong, every loss accounted for.
//!
//! - **Walk:** the host's link `a` → hub → its link `b`, and back; every byte of all four legs is noted as it went and as it came → [`Leg`]
//!   says what each receiver must have counted → the hub's and the host's own counters say what they did count.
//! - **Invariants:** the account is exact, packet by packet: sent = delivered + each named loss. Virtual time: one seed, one run.
//! - **Clauses:** `[NOD-09]`, `[FRM-05]` to `[FRM-08]`.

use super::Context;
use crate::account::Leg;
use crate::cosim::WireFaults;
use crate::pico::{Bench, route};
use crate::report::{Failure, Report, real, table};
use crate::traffic::{Traffic, is_ours};
use fixed_math::time::Span;
use osap_protocol::{DropCause, PortIndex};
use serde_json::json;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// The host's port that datagrams leave from and come to.
const STREAM_PORT: PortIndex = PortIndex::from_low_bits(2);
/// Virtual time between two looks at what was noted.
const STRETCH_MS: u64 = 50;
/// What is under way has come, or has expired, after so long.
const DRAIN_MS: u64 = 200;
/// Bytes a second on a wire of 3 Mbaud.
const WIRE_BYTES_S: f64 = 300_000.0;

/// A leg and our packets on it.
#[derive(Default)]
struct Watched {
    leg: Leg,
    ours_sent: u64,
    ours_came: u64,
}

/// The four legs: a to the hub, the hub to b, b to the hub, the hub to a.
#[derive(Default)]
struct Legs {
    all: [Watched; 4],
    /// Reads our packets among those that were sent.
    readers: [Leg; 4],
}

const NAMES: [&str; 4] = ["a to hub", "hub to b", "b to hub", "hub to a"];
/// Where each leg's bytes are noted as they were sent, and as they came.
const PLACES: [(&str, &str); 4] = [(">a", "a:ab"), ("b:ba", "b"), (">b", "b:ab"), ("a:ba", "a")];

impl Legs {
    fn note(&mut self, bench: &mut Bench) {
        for frame in bench.keep_frames(true) {
            for (number, (sent, came)) in PLACES.iter().enumerate() {
                let Watched { leg, ours_sent, ours_came } = &mut self.all[number];
                if frame.place == *sent {
                    leg.sent(&frame.bytes);
                    self.readers[number].came(&frame.bytes, |packet| *ours_sent += u64::from(is_ours(packet)));
                } else if frame.place == *came {
                    leg.came(&frame.bytes, |packet| *ours_came += u64::from(is_ours(packet)));
                }
            }
        }
    }

    /// What a receiver of two of the legs must have counted.
    fn predicted(&self, legs: [usize; 2]) -> BTreeMap<DropCause, u64> {
        let mut sum = BTreeMap::new();
        for leg in legs {
            for (cause, count) in &self.all[leg].leg.bad {
                *sum.entry(*cause).or_default() += count;
            }
        }
        sum
    }
}

/// Legs that end at the hub, and at the host.
const AT_HUB: [usize; 2] = [0, 2];
const AT_HOST: [usize; 2] = [1, 3];

pub(super) fn run(context: &Context, ms: u64, errors: f64) -> Result<Report, Failure> {
    let began = Instant::now();
    let faults = WireFaults { seed: context.seed, byte_error: errors, byte_loss: 0.0 };
    let mut bench = Bench::loop_through_hub(&context.places, context.seed, Some(faults))?;
    let routes = ["/0/1", "/1/0"].map(|text| route(text).to_buf());
    let traffic = Arc::new(Mutex::new(Traffic::new(context.seed, routes, STREAM_PORT)));
    let mut legs = Legs::default();
    legs.note(&mut bench);
    let bytes_before = legs.all.each_ref().map(|watched| watched.leg.bytes);
    let started_ns = bench.now_ns();
    for stretch in 0..ms.div_ceil(STRETCH_MS) {
        let left_ms = (ms - stretch * STRETCH_MS).min(STRETCH_MS);
        drive(&mut bench, &traffic, left_ms, true)?;
        legs.note(&mut bench);
        if (stretch * STRETCH_MS).is_multiple_of(5_000) && ms > 5_000 {
            eprintln!("hil: soak: {} of {ms} ms, {:.0} s", stretch * STRETCH_MS, began.elapsed().as_secs_f64());
        }
    }
    let bytes = [0, 1, 2, 3].map(|leg| legs.all[leg].leg.bytes - bytes_before[leg]);
    let seconds = real(bench.now_ns() - started_ns) / 1e9;
    drive(&mut bench, &traffic, DRAIN_MS, false)?;
    legs.note(&mut bench);
    let profile = bench.cosim.borrow_mut().profile("hub", false)?;
    let (hub, host) = counters(&mut bench, &traffic, &mut legs)?;
    let traffic = traffic.lock().unwrap_or_else(PoisonError::into_inner);
    let mut report = Report::new();
    report.line(format!(
        "Soak: {ms} virtual ms at full load through a Pico hub, byte errors {errors:e}, seed {}; {:.0} s of wall time",
        context.seed,
        began.elapsed().as_secs_f64()
    ));
    describe(&mut report, &legs, &traffic, bytes, seconds);
    let busy = 1.0 - real(profile.sleep_cycles) / real(profile.cycles.max(1));
    report.line(format!("Hub: {:.0} % of its processor busy since power-on", busy * 100.0));
    verdicts(&mut report, &legs, &traffic, &hub, &host);
    Ok(report)
}

/// Lets time pass; while `feeding` both links are kept full.
fn drive(bench: &mut Bench, traffic: &Arc<Mutex<Traffic>>, ms: u64, feeding: bool) -> Result<(), Failure> {
    let until = bench.session.network().now() + Span::from_us(ms * 1_000);
    let traffic = Arc::clone(traffic);
    let task = move |core: &mut osap::core::HostCore, now| {
        let mut traffic = traffic.lock().unwrap_or_else(PoisonError::into_inner);
        traffic.take(core);
        if feeding {
            traffic.feed(core, now);
        }
        false
    };
    Ok(bench.session.network().drive(until, Box::new(task))?)
}

type Counts = BTreeMap<DropCause, u64>;

/// Reads what hub and host counted, at an instant at which nothing more was on its way to be counted.
fn counters(bench: &mut Bench, traffic: &Arc<Mutex<Traffic>>, legs: &mut Legs) -> Result<(Counts, Counts), Failure> {
    loop {
        drive(bench, traffic, 1, false)?;
        legs.note(bench);
        let (before, bad) = (legs.predicted(AT_HUB), legs.predicted(AT_HOST));
        let to = bench.session.destination(&route("/0"));
        let all = bench.session.counters(&to)?;
        let dropped = bench.session.network().statistics()?.dropped;
        drive(bench, traffic, 1, false)?;
        legs.note(bench);
        // an error in the questions themselves, or in an announcement: once more
        if (before, bad) == (legs.predicted(AT_HUB), legs.predicted(AT_HOST)) {
            let hub = all.iter().filter(|counter| counter.value > 0);
            let hub = hub.filter_map(|counter| Some((counter.cause?, u64::from(counter.value)))).collect();
            return Ok((hub, dropped.into_iter().map(|(cause, count)| (cause, u64::from(count))).collect()));
        }
    }
}

fn describe(report: &mut Report, legs: &Legs, traffic: &Traffic, bytes: [u64; 4], seconds: f64) {
    let mut rows = Vec::new();
    for (number, name) in NAMES.iter().enumerate() {
        let Watched { leg, ours_sent, ours_came } = &legs.all[number];
        let used = real(bytes[number]) / seconds / WIRE_BYTES_S * 100.0;
        let cells = [
            leg.bytes,
            leg.changed,
            *ours_sent,
            *ours_came,
            leg.lost(),
            leg.bad_all(),
            leg.destroyed,
            leg.made,
            leg.empty,
        ];
        rows.push(
            [(*name).to_owned(), format!("{used:.1} %")]
                .into_iter()
                .chain(cells.map(|cell| cell.to_string()))
                .collect(),
        );
        let figures = json!({ "bytes": leg.bytes, "changed": leg.changed, "sent": ours_sent, "came": ours_came, "used_percent": used });
        report.datum(name, figures);
    }
    let head = ["leg", "used", "bytes", "changed", "packets", "came", "frames lost", "drops", "joined", "cut", "empty"];
    report.line(table(&head, &rows));
    for (way, direction) in ["a to b", "b to a"].into_iter().zip(&traffic.directions) {
        let rate = real(direction.delivered_bytes) / seconds / 1_000.0;
        report.line(format!(
            "{way}: {} sent, {} delivered, {rate:.1} kB/s of payload",
            direction.sent, direction.delivered
        ));
        report.datum(way, json!({ "sent": direction.sent, "delivered": direction.delivered, "payload_kb_s": rate }));
    }
}

/// The account: each line is an equality.
fn verdicts(report: &mut Report, legs: &Legs, traffic: &Traffic, hub: &Counts, host: &Counts) {
    let names = |counts: &Counts| {
        let text: Vec<String> = counts.iter().map(|(cause, count)| format!("{} {count}", cause.name())).collect();
        if text.is_empty() { "none".to_owned() } else { text.join(", ") }
    };
    report.line(format!("Counted by the hub: {}\nCounted by the host: {}", names(hub), names(host)));
    let twice: u32 = traffic.directions.iter().map(|direction| direction.twice).sum();
    report.check(traffic.wrong == 0 && twice == 0, format!("{} wrong, {twice} twice", traffic.wrong));
    for (name, watched) in NAMES.iter().zip(&legs.all) {
        let leg = &watched.leg;
        let (lost, bad) = (leg.lost(), leg.bad_all());
        let sum = format!(
            "{lost} frames lost = {bad} drops + {} empty + {} joined - {} cut",
            leg.empty, leg.destroyed, leg.made
        );
        report.check(leg.balances(), format!("{name}: {sum}"));
    }
    let split = |counts: &Counts| -> (Counts, u64) {
        let (frames, others): (Counts, Counts) = counts.iter().partition(|(cause, _)| FRAME_CAUSES.contains(cause));
        (frames, others.values().sum())
    };
    let (hub_frames, hub_others) = split(hub);
    let (host_frames, host_others) = split(host);
    report
        .check(hub_frames == legs.predicted(AT_HUB), format!("the hub counted each bad frame: {}", names(&hub_frames)));
    report.check(
        host_frames == legs.predicted(AT_HOST),
        format!("the host counted each bad frame: {}", names(&host_frames)),
    );
    let [a, to_b, b, to_a] = &legs.all;
    let missing = (a.ours_came + b.ours_came).checked_sub(to_b.ours_sent + to_a.ours_sent);
    report.check(
        missing == Some(hub_others),
        format!("{hub_others} packets that reached the hub and did not leave it, all counted"),
    );
    let [there, back] = &traffic.directions;
    let accepted = u64::from(there.sent + back.sent);
    let delivered = u64::from(there.delivered + back.delivered);
    let unsent = accepted - (a.ours_sent + b.ours_sent);
    let untaken = (to_b.ours_came + to_a.ours_came).checked_sub(delivered);
    report.check(
        untaken.map(|count| count + unsent) == Some(host_others),
        format!("{host_others} packets dropped by the host, all counted"),
    );
    let on_wires: u64 = legs.all.iter().map(|watched| watched.ours_sent - watched.ours_came).sum();
    report.check(
        accepted == delivered + on_wires + hub_others + host_others,
        format!("{accepted} sent = {delivered} delivered + {on_wires} spoilt on wires + {hub_others} dropped by the hub + {host_others} by the host"),
    );
}

/// Causes that are counted before a packet is known.
const FRAME_CAUSES: [DropCause; 4] =
    [DropCause::FrameMalformed, DropCause::FrameTooShort, DropCause::FrameCheck, DropCause::FrameTooLong];

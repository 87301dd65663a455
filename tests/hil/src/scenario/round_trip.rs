//! Table 2.7 for our devices: round trips of the 76-byte answer at 3 Mbaud, on real images, in virtual time.
//!
//! - **Walk:** the host's question → hub → device → the answer → hub → host; each leg's first start bit and last stop bit are stamped by
//!   the wires. Processing is the time between a leg's end and the next one's beginning; wire time is the sum of the legs.
//! - **Invariants:** announcements go over the same wires, and what they delay is in the figures. Questions come at drawn distances, so
//!   that no phase is left out.
//! - **Clauses:** `[DSC-07]` the question, `[FRM-08]` the stamps.

use super::Context;
use crate::network::FrameRecord;
use crate::pico::{Bench, route, us};
use crate::report::{Failure, Report, table};
use fixed_math::time::Span;
use osap::ping::{PingOptions, PingResult};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde_json::json;

/// The thesis's processing time of its RP2040, µs.
const THESIS_BEST_US: f64 = 24.2;
/// What one device may take, µs.
const GOAL_US: f64 = 20.0;
/// Framing around a packet: two bytes of check, one of stuffing, the delimiter.
const FRAMING_BYTES: usize = 4;
/// The question over one link; each link more adds a byte to both.
const QUESTION_BYTES: usize = 14;
/// The answer over one link.
const ANSWER_BYTES: usize = 75;

/// Virtual nanoseconds of one exchange, by leg and device.
#[derive(Clone, Debug, Default)]
struct Exchange {
    wire: u64,
    /// The hub on the way there, the device, the hub on the way back; the device alone where there is no hub.
    processing: Vec<u64>,
    total: u64,
}

pub(super) fn run(context: &Context, count: u32, goal_us: Option<f64>) -> Result<Report, Failure> {
    let mut report = Report::new();
    report.line(format!(
        "Round trips of the 76-byte answer, {count} each, seed {}: virtual time of real images, 3 Mbaud, RP2040 at 125 MHz; µs",
        context.seed
    ));
    let alone = measure(Bench::device(&context.places, context.seed)?, "/0", &["host"], context.seed, count)?;
    describe(&mut report, "a device at the host", &alone, &["device"]);
    let behind = measure(
        Bench::hub_and_device(&context.places, context.seed, None)?,
        "/0/1",
        &["host", "inner"],
        context.seed,
        count,
    )?;
    describe(&mut report, "a device behind a hub", &behind, &["hub, there", "device", "hub, back"]);
    report.line(format!("Wire: sum of all legs, both ways. Thesis, Table 2.7: {THESIS_BEST_US} µs of processing for its fastest, an RP2040 at 200 MHz."));
    let device = |all: &[Exchange], place: usize| sorted(all.iter().map(|it| it.processing[place]));
    let (alone_ns, behind_ns) = (device(&alone, 0), device(&behind, 1));
    for (name, times, exchanges, links) in [("alone", &alone_ns, &alone, 1), ("behind a hub", &behind_ns, &behind, 2)] {
        let median = us(rank(times, 50));
        let word = if median <= GOAL_US { "met" } else { "missed" };
        report.line(format!("Goal of {GOAL_US} µs for a device {name}: {word}, {median:.1} µs (median)"));
        if let Some(goal_us) = goal_us {
            report.check(
                median <= goal_us,
                format!("a device {name} takes {median:.1} µs (median) of at most {goal_us}"),
            );
        }
        let least_ns = wire_ns(links);
        let slowest = exchanges.iter().map(|it| it.wire).max().unwrap_or(0);
        let is_wire = exchanges.iter().all(|it| it.wire >= least_ns);
        report.check(
            is_wire,
            format!(
                "{name}: wire time is that of the bytes, {:.1} µs, at least; {:.1} at most",
                us(least_ns),
                us(slowest)
            ),
        );
        report.check(exchanges.len() == count as usize, format!("{name}: {count} questions answered at the first try"));
    }
    Ok(report)
}

/// What the bits of question and answer take over `links` links at 3 Mbaud.
fn wire_ns(links: usize) -> u64 {
    let bytes = (QUESTION_BYTES + ANSWER_BYTES + 2 * (links - 1) + 2 * FRAMING_BYTES) * links;
    bytes as u64 * 10_000 / 3
}

/// Asks `count` times, one question at a time; `places` are the host's port and the wires on the way, from the host on.
fn measure(mut bench: Bench, to: &str, places: &[&str], seed: u64, count: u32) -> Result<Vec<Exchange>, Failure> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let to = bench.session.destination(&route(to));
    let mut all = Vec::new();
    for number in 0..count {
        let wait_us: u64 = random.random_range(1..1_500);
        bench.run_for(wait_us * 1_000)?;
        bench.keep_frames(true);
        let mut answered = false;
        let once = PingOptions { count: 1, interval: Span::ZERO, ..PingOptions::default() };
        bench.session.ping(&to, &once, &mut |_, result| answered = matches!(result, PingResult::Answered(_)))?;
        let frames = bench.keep_frames(false);
        let exchange = legs(&frames, places).filter(|_| answered);
        let missing = || {
            Failure::Failed(format!(
                "question {number} (seed {seed}) was not answered at once: {} frames",
                frames.len()
            ))
        };
        all.push(exchange.ok_or_else(missing)?);
    }
    Ok(all)
}

/// Finds the legs of one exchange among the frames.
fn legs(frames: &[FrameRecord], places: &[&str]) -> Option<Exchange> {
    let links = places.len();
    let question = QUESTION_BYTES + links - 1 + FRAMING_BYTES;
    let answer = ANSWER_BYTES + links - 1 + FRAMING_BYTES;
    let find = |place: String, len: usize| frames.iter().find(|frame| frame.place == place && frame.bytes.len() == len);
    let (port, wires) = places.split_first()?;
    let mut legs = vec![find(format!(">{port}"), question)?];
    for wire in wires {
        legs.push(find(format!("{wire}:ab"), question)?);
    }
    for wire in wires.iter().rev() {
        legs.push(find(format!("{wire}:ba"), answer)?);
    }
    legs.push(find((*port).to_owned(), answer)?);
    let between = |pair: &[&FrameRecord]| pair[1].start_ns.checked_sub(pair[0].end_ns);
    Some(Exchange {
        wire: legs.iter().map(|leg| leg.end_ns - leg.start_ns).sum(),
        processing: legs.windows(2).map(between).collect::<Option<_>>()?,
        total: legs.last()?.end_ns.checked_sub(legs.first()?.start_ns)?,
    })
}

fn describe(report: &mut Report, what: &str, all: &[Exchange], devices: &[&str]) {
    let mut parts: Vec<(String, Vec<u64>)> = vec![
        ("round trip".to_owned(), sorted(all.iter().map(|it| it.total))),
        ("wire".to_owned(), sorted(all.iter().map(|it| it.wire))),
    ];
    for (place, device) in devices.iter().enumerate() {
        parts.push(((*device).to_owned(), sorted(all.iter().map(|it| it.processing[place]))));
    }
    if devices.len() > 1 {
        parts.push(("processing, all".to_owned(), sorted(all.iter().map(|it| it.processing.iter().sum()))));
    }
    let ranks = [0, 50, 99, 100];
    let row = |(name, times): &(String, Vec<u64>)| {
        std::iter::once(name.clone()).chain(ranks.map(|percent| format!("{:.2}", us(rank(times, percent))))).collect()
    };
    report.line(format!("\n{what}"));
    let head = ["part", "best", "median", "p99", "worst"];
    report.line(table(&head, &parts.iter().map(row).collect::<Vec<Vec<String>>>()));
    let data = parts.iter().map(|(name, times)| {
        let [best, median, p99, worst] = ranks.map(|percent| us(rank(times, percent)));
        json!({ "part": name, "best_us": best, "median_us": median, "p99_us": p99, "worst_us": worst })
    });
    report.datum(what, data.collect());
}

fn sorted(times: impl Iterator<Item = u64>) -> Vec<u64> {
    let mut times: Vec<u64> = times.collect();
    times.sort_unstable();
    times
}

/// The smallest of sorted `times` that `percent` of them do not exceed; 0 of none.
fn rank(times: &[u64], percent: usize) -> u64 {
    times.get((times.len() * percent).div_ceil(100).max(1) - 1).copied().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(place: &str, len: usize, start_ns: u64, end_ns: u64) -> FrameRecord {
        FrameRecord { place: place.to_owned(), bytes: vec![1; len], start_ns, end_ns }
    }

    /// Worked by hand: legs of 60, 61, 260 and 262 with 10, 20 and 30 between them. An announcement of 27 bytes is no leg.
    #[test]
    fn processing_is_what_lies_between_the_legs() {
        let frames = [
            frame(">host", 19, 100, 160),
            frame("inner:ba", 27, 120, 150),
            frame("inner:ab", 19, 170, 231),
            frame("inner:ba", 80, 251, 511),
            frame("host", 80, 541, 803),
        ];
        let exchange = legs(&frames, &["host", "inner"]).unwrap();
        assert_eq!(exchange.processing, [10, 20, 30]);
        assert_eq!((exchange.wire, exchange.total), (643, 703));
        assert!(legs(&frames[..4], &["host", "inner"]).is_none(), "no answer came");
        assert_eq!([0, 50, 99, 100].map(|percent| rank(&[1, 2, 3, 4], percent)), [1, 2, 4, 4]);
    }
}

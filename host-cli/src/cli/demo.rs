//! `osap demo`: the main job without hardware. The printer of the thesis, simulated in this process: found, drawn, pinged, and its round
//! trips beside the published ones.

use super::devices::Scanned;
use super::links::LinkArgs;
use super::output::{FAINT, STRONG};
use super::progress::Progress;
use super::scan::tree;
use super::table::{Align, Table};
use super::{CliError, Exit, Output};
use crate::map::{NetworkMap, RouteText};
use crate::network::{NetworkSpec, SimKind, SimSpec};
use crate::ping::{PingOptions, PingReport};
use crate::scan::ScanCost;
use crate::session::RouteBudget;
use clap::Args;
use fixed_math::time::Span;
use osap_protocol::discovery::Query;
use osap_protocol::header::PORT_HEADER_BYTES;
use osap_protocol::transport::SequencedHeader;
use osap_sim::machines::printer::{TABLE_2_7, TableRow};
use serde::Serialize;
use std::path::PathBuf;

/// From one question to the next, virtual µs: no multiple of any period in the machine, so that questions meet all phases.
const INTERVAL: Span = Span::from_us(1_037);

/// Key and version: the question behind its sequence number.
const QUESTION_BYTES: usize = 2;
/// The same and 61 bytes of time controller, `[DSC-07]`.
const ANSWER_BYTES: usize = 63;

/// Shows the main job on a simulated machine: scan, tree, round trips beside the thesis's
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  osap demo\n  osap demo --seed 7 -n 10000\n  osap demo --capture demo.pcapng")]
pub struct DemoArgs {
    /// Seed of all that is drawn at random
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Round trips to each device
    #[arg(short = 'n', long, value_name = "N", default_value_t = 1_000, value_parser = clap::value_parser!(u32).range(2..=1_000_000))]
    count: u32,
    /// File to write every packet of the workstation's links to, for Wireshark (pcapng)
    #[arg(long, value_name = "FILE")]
    capture: Option<PathBuf>,
}

/// One device: ours and the thesis's.
#[derive(Serialize)]
struct Row {
    device: &'static str,
    route: RouteText,
    links: &'static str,
    /// Time of question and answer on all wires of the route together, µs.
    wire_us: u64,
    ours: PingReport,
    thesis: Thesis,
}

/// Published figures.
#[derive(Serialize)]
#[expect(clippy::struct_field_names, reason = "units stand last in names, and all are µs")]
struct Thesis {
    wire_us: f64,
    mean_us: f64,
    sigma_us: f64,
    max_us: f64,
    processing_us: f64,
}

#[derive(Serialize)]
struct Document<'a> {
    seed: u64,
    map: &'a NetworkMap,
    cost: &'a ScanCost,
    rows: &'a [Row],
}

pub(super) fn run(args: &DemoArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    let spec = NetworkSpec::Sim(SimSpec { kind: SimKind::Printer, seed: Some(args.seed) });
    let links = LinkArgs::simulated(spec, args.capture.clone());
    let mut scanned = Scanned::open(&links, output)?;
    if !output.json() {
        output.line(format!("{STRONG}A simulated printer, found by questions alone{STRONG:#}"))?;
        tree(&scanned.map, &scanned.cost, true, output)?;
        output.flush()?;
    }
    let progress = Progress::bar(output, "pinging", u64::try_from(TABLE_2_7.len()).unwrap_or(u64::MAX));
    let mut rows = Vec::new();
    for row in &TABLE_2_7 {
        rows.push(measure(row, args.count, &mut scanned)?);
        progress.step();
    }
    drop(progress);
    if output.json() {
        let Scanned { map, cost, .. } = &scanned;
        output.document("demo", &Document { seed: args.seed, map, cost, rows: &rows })?;
        return scanned.finish(Exit::Ok);
    }
    output.line(format!("\n{STRONG}Round trips of the 76-byte answer, µs, beside the thesis's Table 2.7{STRONG:#}"))?;
    output.text(table(&rows))?;
    explain(args.count, output)?;
    scanned.finish(Exit::Ok)
}

fn measure(row: &TableRow, count: u32, scanned: &mut Scanned<'_>) -> Result<Row, CliError> {
    let device = scanned.device(row.device, "demo")?.clone();
    let to = scanned.session.destination_of(&device);
    let options = PingOptions { count, interval: INTERVAL, query: Query::TimeControl };
    let ours = scanned.session.ping(&to, &options, &mut |_, _| {}).map_err(|error| scanned.failed(&error))?;
    let TableRow { device: name, route: links, .. } = *row;
    let budget = RouteBudget::along(&scanned.map, device.route()).unwrap_or_default();
    let wire_us = budget.exchange_us(QUESTION_BYTES, ANSWER_BYTES);
    let thesis = Thesis {
        wire_us: row.wire_us,
        mean_us: row.rtt_mean_us,
        sigma_us: row.rtt_sigma_us,
        max_us: row.rtt_max_us,
        processing_us: row.processing_us,
    };
    Ok(Row { device: name, route: device.route().clone(), links, wire_us, ours, thesis })
}

fn table(rows: &[Row]) -> Table {
    let left = ["device", "route"].map(|head| (head, Align::Left));
    let right = ["ours: wire", "mean", "σ", "max", "thesis: wire", "mean", "σ", "max", "processing"];
    let mut table = Table::new(left.into_iter().chain(right.map(|head| (head, Align::Right))));
    for row in rows {
        let Row { ours, thesis, .. } = row;
        let ours = [ours.mean_us, ours.sigma_us, ours.max_us];
        let thesis = [thesis.wire_us, thesis.mean_us, thesis.sigma_us, thesis.max_us, thesis.processing_us];
        let words = [row.device.to_owned(), format!("{} {}", row.route, row.links), row.wire_us.to_string()];
        let times = ours.into_iter().chain(thesis).map(|us| format!("{us:.1}"));
        table.row(words.into_iter().chain(times));
    }
    table
}

fn explain(count: u32, output: &mut Output<'_>) -> Result<(), CliError> {
    output.line(format!(
        "{FAINT}Ours: virtual time, {count} round trips each, longest of all; the processors take the thesis's processing times.\n\
         Why ours are shorter: our question has {} bytes, where 534 µs counts 76 each way, and there is no Python on the way.{FAINT:#}",
        QUESTION_BYTES + SequencedHeader::LEN + PORT_HEADER_BYTES + 2
    ))?;
    output.say("Next: `osap sim printer --listen tcp:127.0.0.1:4100` offers the same machine to other programs.");
    Ok(())
}

//! `osap bench DEVICE`: echoes of several sizes, one and several at a time.

use super::devices::{DeviceId, Scanned};
use super::links::LinkArgs;
use super::output::printable;
use super::progress::Progress;
use super::table::{Align, Table};
use super::{CliError, Exit, Output};
use crate::bench::{BenchOptions, BenchReport, LOST_IN_A_ROW_MAX};
use crate::core::REQUEST_BYTES_MAX;
use crate::map::{Device, RouteText};
use crate::session::ECHO_PORT;
use clap::Args;
use osap_protocol::header::PORT_HEADER_BYTES;
use osap_protocol::transport::SequencedHeader;
use osap_runtime::sequenced::Destination;
use serde::Serialize;

/// What a device calls the port that sends back what it gets.
const ECHO_TYPE: &str = "echo";
/// Sizes measured where none are given, bytes; those that do not fit the route are left out.
const SIZES: [usize; 4] = [8, 32, 128, 224];

/// Measures latency and throughput to a device's echo, by size and by how many are under way
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  osap bench 'Load Cell'\n  osap bench /0/3 --sizes 12,64 --windows 1,2,4 -n 1000")]
pub struct BenchArgs {
    /// Device: its name, the head of its unique id, or a route such as /0/3, which is then the way that is measured
    device: String,
    /// Payloads, bytes [default: 8,32,128,224, as far as they fit]
    #[arg(long, value_name = "BYTES", value_delimiter = ',')]
    sizes: Vec<usize>,
    /// How many are under way at once
    #[arg(long, value_name = "N", value_delimiter = ',', default_value = "1,4", value_parser = clap::value_parser!(u16).range(1..=48))]
    windows: Vec<u16>,
    /// Echoes for each line of the table
    #[arg(short = 'n', long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    count: u32,
    #[command(flatten)]
    links: LinkArgs,
}

#[derive(Serialize)]
struct Document<'a> {
    #[serde(flatten)]
    device: DeviceId,
    reports: &'a [BenchReport],
}

pub(super) fn run(args: &BenchArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    let mut scanned = Scanned::open(&args.links, output)?;
    let (device, to) = scanned.target(&args.device, "bench")?;
    has_echo(&device, &to, args)?;
    let sizes = sizes(args, &to)?;
    let steps = u64::try_from(sizes.len() * args.windows.len()).unwrap_or(u64::MAX);
    let progress = Progress::bar(output, &printable(&device.label()), steps);
    let mut reports = Vec::new();
    for (payload_bytes, window) in sizes.into_iter().flat_map(|size| args.windows.iter().map(move |n| (size, *n))) {
        let options = BenchOptions { payload_bytes, count: args.count, window: usize::from(window) };
        reports.push(scanned.session.bench(&to, &options).map_err(|error| scanned.failed(&error))?);
        progress.step();
        if is_given_up(&reports, args) {
            break;
        }
    }
    drop(progress);
    if output.json() {
        let device = DeviceId { route: to.route.clone().into(), ..DeviceId::from(&device) };
        output.document("bench", &Document { device, reports: &reports })?;
    } else {
        output.text(table(&reports))?;
    }
    if is_given_up(&reports, args) {
        let what = format!("{} lost {LOST_IN_A_ROW_MAX} echoes in a row and was given up", printable(&device.label()));
        let next = format!("see why packets are dropped: `{}`", scanned.counters_hint());
        return Err(CliError::new(Exit::NoAnswer, what, place(&to, args), next));
    }
    let is_whole = reports.iter().all(|report| report.lost == 0 && report.corrupt == 0);
    scanned.finish(if is_whole { Exit::Ok } else { Exit::Differs })
}

/// Whether the last of them ended early.
fn is_given_up(reports: &[BenchReport], args: &BenchArgs) -> bool {
    reports.last().is_some_and(|report| report.sent < args.count)
}

fn place(to: &Destination, args: &BenchArgs) -> String {
    format!("{} over {}", RouteText::from(to.route.clone()), args.links.place())
}

/// Asks the map, since a port that is not there is as silent as a device that is gone.
fn has_echo(device: &Device, to: &Destination, args: &BenchArgs) -> Result<(), CliError> {
    let echo = device.ports.iter().find(|port| port.index == ECHO_PORT.get());
    // A device that told none of its ports may have one all the same.
    if device.ports.is_empty() || echo.is_some_and(|port| port.type_name == ECHO_TYPE) {
        return Ok(());
    }
    let route = RouteText::from(to.route.clone());
    let next = format!("`{}` shows its ports", args.links.command(&format!("info {route}")));
    Err(CliError::new(Exit::Refused, format!("{} has no echo port", printable(&device.label())), place(to, args), next))
}

/// The sizes asked for, where each fits a packet of the route.
fn sizes(args: &BenchArgs, to: &Destination) -> Result<Vec<usize>, CliError> {
    let head = PORT_HEADER_BYTES + to.route.as_route().bytes().len() + SequencedHeader::LEN;
    let most = usize::from(to.mtu_bytes).saturating_sub(head).min(REQUEST_BYTES_MAX);
    if args.sizes.is_empty() {
        return Ok(SIZES.into_iter().filter(|size| *size <= most).collect());
    }
    match args.sizes.iter().find(|size| **size > most) {
        None => Ok(args.sizes.clone()),
        Some(size) => {
            let place = format!("{}, with packets of {} bytes", args.device, to.mtu_bytes);
            let next = args.links.command(&format!("bench {} --sizes {most}", super::links::quoted(&args.device)));
            let what = format!("a payload of {size} bytes does not fit a packet; {most} do");
            Err(CliError::new(Exit::Usage, what, place, format!("try `{next}`")))
        }
    }
}

fn table(reports: &[BenchReport]) -> Table {
    let heads = [
        "bytes",
        "under way",
        "answered",
        "late",
        "lost",
        "corrupt",
        "p50 µs",
        "p99 µs",
        "max µs",
        "messages/s",
        "kB/s",
    ];
    let mut table = Table::new(heads.map(|head| (head, Align::Right)));
    for report in reports {
        table.row([
            report.payload_bytes.to_string(),
            report.window.to_string(),
            report.answered.to_string(),
            report.late.to_string(),
            report.lost.to_string(),
            report.corrupt.to_string(),
            format!("{:.1}", report.p50_us),
            format!("{:.1}", report.p99_us),
            format!("{:.1}", report.max_us),
            format!("{:.0}", report.messages_s),
            format!("{:.1}", report.bytes_s / 1e3),
        ]);
    }
    table
}

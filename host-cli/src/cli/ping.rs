//! `osap ping DEVICE`: round trips of the 76-byte answer of Table 2.7, `[DSC-07]`.

use super::devices::{DeviceId, Scanned};
use super::links::LinkArgs;
use super::output::{BAD, FAINT, printable};
use super::progress::Progress;
use super::{CliError, Exit, Output};
use crate::error::RequestText;
use crate::map::{Device, RouteText};
use crate::ping::{PingOptions, PingReport, PingResult};
use clap::Args;
use fixed_math::time::Span;
use osap_protocol::discovery::Query;
use osap_runtime::sequenced::{Destination, RequestError};
use serde::Serialize;

/// Measures round trips to a device
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  osap ping 'Load Cell'\n  osap ping /0/3 -n 1000 --interval-ms 1 --json")]
pub struct PingArgs {
    /// Device: its name, the head of its unique id, or a route such as /0/3, which is then the way that is measured
    device: String,
    /// How often to ask
    #[arg(short = 'n', long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    count: u32,
    /// Time from one question to the next, ms
    #[arg(long, value_name = "MS", default_value_t = 100)]
    interval_ms: u32,
    /// Time that a question and its answer may take together, µs
    #[arg(long, value_name = "US", value_parser = clap::value_parser!(u16).range(1..))]
    ttl_us: Option<u16>,
    #[command(flatten)]
    links: LinkArgs,
}

#[derive(Serialize)]
struct Document<'a> {
    #[serde(flatten)]
    device: DeviceId,
    /// Of each question, in order; `null` where it was not answered at the first try.
    round_trips_us: &'a [Option<f64>],
    #[serde(flatten)]
    report: &'a PingReport,
}

pub(super) fn run(args: &PingArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    let mut scanned = Scanned::open(&args.links, output)?;
    let (device, mut to) = scanned.target(&args.device, "ping")?;
    to.ttl_us = args.ttl_us.unwrap_or(to.ttl_us);
    let interval = Span::from_us(u64::from(args.interval_ms) * 1_000);
    let options = PingOptions { count: args.count, interval, query: Query::TimeControl };
    let mut round_trips = Vec::new();
    let mut written = Ok(());
    // Lines of text are progress enough.
    let progress = output.json().then(|| Progress::bar(output, "pinging", u64::from(args.count)));
    let report = scanned.session.ping(&to, &options, &mut |number, result| {
        progress.iter().for_each(Progress::step);
        round_trips.push(micros(result));
        if !output.json() && written.is_ok() {
            written = output.line(line(number, result)).and_then(|()| output.flush());
        }
    });
    drop(progress);
    written?;
    let report = report.map_err(|error| scanned.failed(&error))?;
    if output.json() {
        let device = DeviceId { route: to.route.clone().into(), ..DeviceId::from(&device) };
        let document = Document { device, round_trips_us: &round_trips, report: &report };
        output.document("ping", &document)?;
    } else {
        summary(&by(&device, &to), &report, output)?;
    }
    ended(&report, (&device, &to), args, &mut scanned)
}

fn micros(result: PingResult) -> Option<f64> {
    match result {
        PingResult::Answered(span) => Some(crate::ping::us(span)),
        PingResult::Late { .. } | PingResult::Lost { .. } | PingResult::Unsent { .. } => None,
    }
}

fn line(number: u32, result: PingResult) -> String {
    let number = u64::from(number) + 1;
    match (result, micros(result)) {
        (_, Some(us)) => format!("{number:>4}  {us:>9.1} µs"),
        (PingResult::Lost { tries }, None) => format!("{BAD}{number:>4}  lost: no answer to {tries} tries{BAD:#}"),
        (PingResult::Late { tries }, None) => format!("{BAD}{number:>4}  late: answered at try {tries}{BAD:#}"),
        (PingResult::Unsent { error }, None) => {
            let why = RequestError::Send(error);
            format!("{BAD}{number:>4}  lost: not sent: {}{BAD:#}", RequestText(&why))
        }
        (PingResult::Answered(_), None) => String::new(),
    }
}

fn summary(label: &str, report: &PingReport, output: &mut Output<'_>) -> Result<(), CliError> {
    let PingReport { sent, answered, late, lost, min_us, mean_us, sigma_us, p50_us, p99_us, max_us } = report;
    output.line(format!("{label}: {sent} sent, {answered} answered at once, {late} late, {lost} lost"))?;
    if *answered > 0 {
        output.line(format!(
            "{FAINT}µs:{FAINT:#} min {min_us:.1}, mean {mean_us:.1}, σ {sigma_us:.1}, \
             p50 {p50_us:.1}, p99 {p99_us:.1}, max {max_us:.1}"
        ))?;
    }
    Ok(())
}

/// What is called how, and by which way where that is not its first.
fn by(device: &Device, to: &Destination) -> String {
    let (label, route) = (printable(&device.label()), RouteText::from(to.route.clone()));
    if route == *device.route() { label } else { format!("{label} by {route}") }
}

/// Silence throughout is a failure, silence at times a finding.
fn ended(
    report: &PingReport,
    (device, to): (&Device, &Destination),
    args: &PingArgs,
    scanned: &mut Scanned<'_>,
) -> Result<Exit, CliError> {
    if report.lost == report.sent {
        let what = format!("{} answered none of {} questions", printable(&device.label()), report.sent);
        let place = format!("{} over {}", RouteText::from(to.route.clone()), args.links.place());
        let next = match args.ttl_us {
            Some(ttl_us) => format!("leave out --ttl-us: {ttl_us} µs may be too short for its wires"),
            None => format!("see why packets are dropped: `{}`", scanned.counters_hint()),
        };
        return Err(CliError::new(Exit::NoAnswer, what, place, next));
    }
    scanned.finish(if report.lost > 0 { Exit::Differs } else { Exit::Ok })
}

//! `osap clock wait`: the gate before a machine starts, `[TIM-09]`: returns once every device is settled, on one root, within a bound.

use super::units::{parse_seconds, parse_span};
use super::{documents, read, root_name, seconds};
use crate::cli::devices::Scanned;
use crate::cli::links::LinkArgs;
use crate::cli::output::{count, printable};
use crate::cli::progress::Progress;
use crate::cli::wait::Until;
use crate::cli::{CliError, Exit, Output};
use crate::clocks::{Clocks, micros, steps_of};
use crate::map::NetworkMap;
use clap::Args;
use fixed_math::time::Span;
use serde::Serialize;
use std::time::Duration;

/// Between two looks at all clocks.
const LOOK_EVERY: Span = Span::from_us(50_000);

/// Waits until every device is settled, on one root, with its error bounded
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  osap clock wait --within 5us\n  osap clock wait --within 50us --timeout 30s && start-job"
)]
pub(super) struct WaitArgs {
    /// Widest bound that will do, with its unit: 5us, 0.5ms
    #[arg(long, value_name = "TIME", value_parser = parse_span)]
    within: Span,
    /// How long to wait at most; a bare number is seconds
    #[arg(long, value_name = "TIME", default_value = "10s", value_parser = parse_seconds)]
    timeout: Span,
    #[command(flatten)]
    links: LinkArgs,
}

#[derive(Serialize)]
struct Document<'a> {
    /// What was asked for, 1/256 µs.
    within_steps: u64,
    /// How long it took, µs.
    waited_us: u64,
    root: Option<String>,
    devices: Vec<super::DeviceDocument<'a>>,
}

pub(super) fn run(args: &WaitArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    let mut scanned = Scanned::open(&args.links, output)?;
    let progress = Progress::spinner(output, "waiting for clocks");
    let until = Until::new(None);
    let start = scanned.session.network().now();
    let clocks = loop {
        let clocks = read(&mut scanned, &args.links)?;
        let left = clocks.unsettled(args.within);
        if left.is_empty() {
            break clocks;
        }
        let waited = scanned.session.network().now().since(start);
        if waited >= args.timeout || !until.pause(Duration::ZERO) {
            return Err(timed_out(args, &scanned.map, &clocks, waited));
        }
        let of = scanned.map.devices.len();
        progress.tell(format!("{} of {of} clocks are within {}", of - left.len(), micros(steps_of(args.within))));
        let pause = scanned.session.network().pause(LOOK_EVERY.min(args.timeout));
        pause.map_err(|error| args.links.stopped(&error))?;
    };
    drop(progress);
    let waited = clocks.at.since(start);
    if output.json() {
        let document = Document {
            within_steps: args.within.steps(),
            waited_us: waited.steps() / 256,
            root: clocks.root().map(|root| root.to_string()),
            devices: documents(&scanned.map, &clocks),
        };
        output.document("clock-wait", &document)?;
    } else {
        told(&scanned.map, &clocks, args.within, waited, output)?;
    }
    scanned.finish(Exit::Ok)
}

fn told(
    map: &NetworkMap,
    clocks: &Clocks,
    within: Span,
    waited: Span,
    output: &mut Output<'_>,
) -> Result<(), CliError> {
    let all = count(map.devices.len(), "device has", "devices have");
    let root = clocks.root().map_or_else(|| "nobody".to_owned(), |root| root_name(map, root));
    output.line(format!("{all} the time of {root} within {}, after {}", micros(steps_of(within)), seconds(waited)))?;
    if let Some((number, bound)) = clocks.widest() {
        let label = map.devices.get(number).map(|device| printable(&device.label())).unwrap_or_default();
        output.line(format!("widest bound: {}, {label}", micros(steps_of(bound))))?;
    }
    Ok(())
}

/// Who is not there yet, and why.
fn timed_out(args: &WaitArgs, map: &NetworkMap, clocks: &Clocks, waited: Span) -> CliError {
    let left = clocks.unsettled(args.within);
    let all = map.devices.len();
    let what = format!(
        "after {} the clocks of {} of {} are not within {}",
        seconds(waited),
        left.len(),
        count(all, "device", "devices"),
        micros(steps_of(args.within))
    );
    let each = left.iter().map(|(number, why)| {
        let label = map.devices.get(*number).map(|device| printable(&device.label())).unwrap_or_default();
        format!("{label}: {why}")
    });
    let next = format!(
        "`{}` shows what they follow; a wider --within or a longer --timeout may do, or a root: `--root`",
        args.links.command("clock watch")
    );
    CliError::new(Exit::NotSettled, what, each.collect::<Vec<_>>().join("; "), next)
}

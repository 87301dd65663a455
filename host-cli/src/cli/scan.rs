//! `osap scan`: finds every device and draws the tree; with `--watch` it goes on to tell what changes.

use super::devices::{Scanned, shown};
use super::links::LinkArgs;
use super::output::{FAINT, HINT, count, printable};
use super::wait::{Until, parse_seconds};
use super::{CliError, Exit, Output};
use crate::error::AskError;
use crate::map::{Change, Device, Finding, NetworkMap, diff};
use crate::scan::ScanCost;
use crate::session::Answer;
use clap::Args;
use fixed_math::time::Span;
use osap_protocol::discovery::{GatewayKind, Query, RuntimeInfo, ScanId};
use serde::Serialize;
use std::time::Duration;

/// Between two looks at the network while watching: each asks every device one question.
const LOOK_EVERY: Duration = Duration::from_millis(500);

/// Finds every device and draws the tree
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  osap scan\n  osap scan --link tcp:127.0.0.1:4100\n  osap scan --link sim:printer --json\n  \
                        osap scan --watch --for 60"
)]
pub struct ScanArgs {
    /// Goes on to tell what is plugged in, unplugged, swapped or rebooted, until Ctrl-C
    #[arg(long)]
    watch: bool,
    /// Ends the watch after so many seconds
    #[arg(long = "for", value_name = "SECONDS", requires = "watch", value_parser = parse_seconds)]
    watch_for: Option<Duration>,
    #[command(flatten)]
    links: LinkArgs,
}

#[derive(Serialize)]
struct Document<'a> {
    map: &'a NetworkMap,
    cost: &'a ScanCost,
}

#[derive(Serialize)]
struct Changes<'a> {
    changes: &'a [Change],
}

pub(super) fn run(args: &ScanArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    let mut scanned = Scanned::open(&args.links, output)?;
    if output.json() {
        output.document("scan", &Document { map: &scanned.map, cost: &scanned.cost })?;
    } else {
        tree(&scanned.map, &scanned.cost, scanned.session.network().is_simulated(), output)?;
    }
    if args.watch {
        // Whoever watches waits for what is not there yet.
        watch(args, &mut scanned, output)?;
        return scanned.finish(Exit::Ok);
    }
    let exit = wholeness(&scanned, &args.links)?;
    scanned.finish(exit)
}

/// Whether the map shows all there is: a script shall not take a part for the whole.
pub(super) fn wholeness(scanned: &Scanned<'_>, links: &LinkArgs) -> Result<Exit, CliError> {
    let map = &scanned.map;
    if map.devices.len() == 1 && map.root().gateways.iter().any(|gateway| gateway.kind == GatewayKind::Link) {
        let next =
            "check that the device is powered, and that the link, its rate and its check are those of its firmware";
        return Err(CliError::new(Exit::NoAnswer, "nobody answers on any link", links.place(), next));
    }
    Ok(if map.silent.is_empty() && !map.findings.iter().any(is_loss) { Exit::Ok } else { Exit::Differs })
}

/// Whether something is missing from the map. The others tell of what is there, and was read.
fn is_loss(finding: &Finding) -> bool {
    !matches!(
        finding,
        Finding::DuplicateName { .. }
            | Finding::DuplicateUniqueId { .. }
            | Finding::PacketSizes { .. }
            | Finding::Restarted { .. }
    )
}

/// The tree, what it took to find it, and what was odd.
pub(super) fn tree(
    map: &NetworkMap,
    cost: &ScanCost,
    simulated: bool,
    output: &mut Output<'_>,
) -> Result<(), CliError> {
    let map = shown(map);
    output.text(map.tree())?;
    let time = if simulated { "of virtual time" } else { "of time" };
    output.line(format!(
        "{FAINT}{}, {}, {}: {} questions, {} retries, {}.{} ms {time}{FAINT:#}",
        count(map.devices.len(), "device", "devices"),
        count(map.links.len(), "link", "links"),
        count(map.buses.len(), "bus", "buses"),
        cost.requests,
        cost.retries,
        cost.elapsed_us / 1_000,
        cost.elapsed_us / 100 % 10,
    ))?;
    findings(&map, output);
    Ok(())
}

/// What was odd, as talk.
pub(super) fn findings(map: &NetworkMap, output: &mut Output<'_>) {
    let label = |device: usize| {
        map.devices.get(device).map_or_else(String::new, |device| format!("{} ({})", device.label(), device.route()))
    };
    for finding in &map.findings {
        output.say(format!("{HINT}note:{HINT:#} {}", printable(&finding.text(label).to_string())));
    }
}

/// Tells changes until there is no time left.
fn watch(args: &ScanArgs, scanned: &mut Scanned<'_>, output: &mut Output<'_>) -> Result<(), CliError> {
    let simulated = scanned.session.network().is_simulated();
    // In virtual time `--for` is virtual too; what is left for real time is Ctrl-C.
    let until = Until::new(args.watch_for.filter(|_| !simulated));
    output.say("Watching; Ctrl-C ends it.");
    output.flush()?;
    let end = args.watch_for.filter(|_| simulated).map(|time| scanned.session.network().now() + span(time));
    loop {
        let is_over = match end {
            Some(end) => {
                scanned.session.network().pause(span(LOOK_EVERY)).map_err(|error| args.links.stopped(&error))?;
                scanned.session.network().now() >= end || !until.pause(Duration::ZERO)
            }
            None => !until.pause(LOOK_EVERY),
        };
        if is_over {
            return Ok(());
        }
        if !has_changed(scanned, &args.links)? {
            continue;
        }
        let before = scanned.map.clone();
        scanned.again()?;
        let changes = diff(&before, &scanned.map);
        if changes.is_empty() {
            continue;
        }
        if output.json() {
            output.document("scan-changes", &Changes { changes: &changes })?;
        } else {
            for change in &changes {
                output.line(printable(&change.to_string()))?;
            }
            output.flush()?;
        }
    }
}

/// Whether anybody is silent, booted again, or has seen a neighbour come or go: one question to each device, and only then a scan.
fn has_changed(scanned: &mut Scanned<'_>, links: &LinkArgs) -> Result<bool, CliError> {
    let stopped = |error| links.stopped(&error);
    let is_event = !scanned.session.network().events().map_err(stopped)?.is_empty();
    let ask = |device| (scanned.session.destination_of(device), ScanId::default());
    let questions: Vec<_> = scanned.map.devices.iter().map(ask).collect();
    let answers = scanned.session.ask_many::<_, RuntimeInfo>(Query::RuntimeInfo, &questions).map_err(stopped)?;
    let is_as_known = |(device, answer): (&Device, &Result<Answer<RuntimeInfo>, AskError>)| {
        answer.as_ref().is_ok_and(|answer| {
            let RuntimeInfo { boot_epoch, topology_generation, .. } = answer.value;
            (boot_epoch, topology_generation) == (device.boot_epoch, device.topology_generation)
        })
    };
    Ok(is_event || !scanned.map.devices.iter().zip(&answers).all(is_as_known))
}

fn span(duration: Duration) -> Span {
    Span::from_us(u64::try_from(duration.as_micros()).unwrap_or(u64::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_from_a_map_is_a_loss_and_what_was_read_is_none() {
        let missing = vec!["ports".to_owned()];
        let losses = [
            Finding::Changed { device: 1 },
            Finding::FellSilent { device: 1 },
            Finding::Incomplete { device: 1, missing },
            Finding::Limit { what: "too many".to_owned() },
        ];
        assert!(losses.iter().all(is_loss));
        let notes = [
            Finding::DuplicateName { name: "fan".to_owned(), devices: vec![1, 2] },
            Finding::PacketSizes { devices: [0, 1], mtu_bytes: [256, 128] },
            Finding::Restarted { device: 1, times: 1 },
        ];
        assert!(!notes.iter().any(is_loss));
    }
}

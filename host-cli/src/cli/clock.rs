//! `osap clock`: how well the devices agree on the time, waiting until they do, and what steers them.
//!
//! - **Walk:** `watch` and `wait` → [`Session::read_clocks`](crate::session::Session::read_clocks) → `table`, `plot`, `html`;
//!   `tune` → queries 10, 12 and 14.
//! - **Clauses:** `[TIM-09]` to `[TIM-13]`.

mod html;
mod plot;
mod table;
mod tune;
mod units;
mod wait;
mod watch;

use super::devices::{DeviceId, Scanned};
use super::output::printable;
use super::{CliError, Exit, Output};
use crate::clocks::{Clocks, DeviceClock};
use crate::map::NetworkMap;
use clap::{Args, Subcommand};
use fixed_math::time::Span;
use osap_protocol::discovery::UniqueId;
use serde::Serialize;

/// Shows, awaits and tunes the time that the devices share
#[derive(Debug, Args)]
#[command(arg_required_else_help = true)]
pub struct ClockArgs {
    #[command(subcommand)]
    command: ClockCommand,
}

#[derive(Debug, Subcommand)]
enum ClockCommand {
    Watch(watch::WatchArgs),
    Wait(wait::WaitArgs),
    Tune(tune::TuneArgs),
}

pub(super) fn run(args: &ClockArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    match &args.command {
        ClockCommand::Watch(args) => watch::run(args, output),
        ClockCommand::Wait(args) => wait::run(args, output),
        ClockCommand::Tune(args) => tune::run(args, output),
    }
}

/// One device of a document.
#[derive(Serialize)]
struct DeviceDocument<'a> {
    #[serde(flatten)]
    device: DeviceId,
    /// Whom it follows, as digits.
    root: Option<String>,
    /// `None` where it did not answer; `error` says why.
    clock: Option<&'a DeviceClock>,
    error: Option<String>,
}

fn documents<'a>(map: &NetworkMap, clocks: &'a Clocks) -> Vec<DeviceDocument<'a>> {
    let each = |(device, clock): (&crate::map::Device, &'a Result<DeviceClock, _>)| DeviceDocument {
        device: DeviceId::from(device),
        root: clock.as_ref().ok().map(|clock| clock.status.root.to_string()),
        clock: clock.as_ref().ok(),
        error: clock.as_ref().err().map(ToString::to_string),
    };
    map.devices.iter().zip(&clocks.devices).map(each).collect()
}

/// A root's name, or its id where it is none of the map's.
fn root_name(map: &NetworkMap, root: UniqueId) -> String {
    let known = map.devices.iter().find(|device| device.unique_id == root);
    known.map_or_else(|| root.to_string(), |device| printable(&device.label()))
}

/// Asks everybody, over this network.
fn read(scanned: &mut Scanned<'_>, links: &super::links::LinkArgs) -> Result<Clocks, CliError> {
    let Scanned { session, map, .. } = scanned;
    session.read_clocks(map).map_err(|error| links.stopped(&error))
}

/// Seconds with three digits behind the point.
fn seconds(span: Span) -> String {
    let ms = span.steps() / 256_000;
    format!("{}.{:03} s", ms / 1_000, ms % 1_000)
}

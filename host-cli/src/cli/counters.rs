//! `osap counters`: how often each cause of a drop happened in a device, `[NOD-09]`.

use super::devices::{DeviceId, Scanned};
use super::links::LinkArgs;
use super::output::printable;
use super::table::{Align, Table};
use super::{CliError, Exit, Output};
use crate::map::Device;
use crate::session::Counter;
use clap::Args;
use serde::Serialize;

/// Shows why devices dropped packets, and how many
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  osap counters 'Load Cell'\n  osap counters --all --nonzero\n  osap counters /0/3 --json"
)]
pub struct CountersArgs {
    /// Device: its name, the head of its unique id, or its route such as /0/3
    #[arg(required_unless_present = "all")]
    device: Option<String>,
    /// Every device there is
    #[arg(long, conflicts_with = "device")]
    all: bool,
    /// Only causes that happened
    #[arg(long)]
    nonzero: bool,
    #[command(flatten)]
    links: LinkArgs,
}

#[derive(Serialize)]
struct Document {
    devices: Vec<DeviceCounters>,
}

#[derive(Serialize)]
struct DeviceCounters {
    #[serde(flatten)]
    device: DeviceId,
    counters: Vec<Row>,
}

#[derive(Serialize)]
struct Row {
    index: u8,
    /// Empty where the device is newer than this program.
    name: &'static str,
    count: u32,
}

impl From<&Counter> for Row {
    fn from(counter: &Counter) -> Self {
        Self { index: counter.index, name: counter.cause.map_or("", |cause| cause.name()), count: counter.value }
    }
}

pub(super) fn run(args: &CountersArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    let mut scanned = Scanned::open(&args.links, output)?;
    let devices: Vec<Device> = match &args.device {
        Some(text) => vec![scanned.device(text, "counters")?.clone()],
        None => scanned.map.devices.clone(),
    };
    let mut read = Vec::new();
    for device in &devices {
        let to = scanned.session.destination_of(device);
        let counters = scanned.session.counters(&to).map_err(|error| scanned.failed(&error))?;
        let wanted = counters.into_iter().filter(|counter| !args.nonzero || counter.value > 0).collect();
        read.push((device, wanted));
    }
    if output.json() {
        let each = |(device, counters): &(&Device, Vec<Counter>)| DeviceCounters {
            device: DeviceId::from(*device),
            counters: counters.iter().map(Row::from).collect(),
        };
        output.document("counters", &Document { devices: read.iter().map(each).collect() })?;
    } else {
        show(&read, args.all, output)?;
    }
    scanned.finish(Exit::Ok)
}

fn show(read: &[(&Device, Vec<Counter>)], all: bool, output: &mut Output<'_>) -> Result<(), CliError> {
    let columns = [("counter", Align::Left), ("count", Align::Right), ("what happened", Align::Left)];
    let device = all.then_some(("device", Align::Left));
    let mut table = Table::new(device.into_iter().chain(columns));
    for (device, counters) in read {
        for counter in counters {
            let (name, meaning) = match counter.cause {
                Some(cause) => (cause.name().to_owned(), cause.meaning().trim_end_matches('.')),
                None => (format!("#{}", counter.index), "the device is newer than this program and did not say"),
            };
            let device = all.then(|| printable(&device.label()));
            table.row(device.into_iter().chain([name, counter.value.to_string(), meaning.to_owned()]));
        }
    }
    if table.is_empty() {
        output.say("Nothing was dropped.");
        return Ok(());
    }
    output.text(table)
}

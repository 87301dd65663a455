//! `osap info DEVICE`: all that a device tells about itself.

use super::devices::Scanned;
use super::links::LinkArgs;
use super::output::{STRONG, count, printable};
use super::table::{Align, Table};
use super::{CliError, Exit, Output};
use crate::clocks::micros;
use crate::map::{Device, Gateway, LeadsTo, NetworkMap};
use clap::Args;
use osap_protocol::discovery::{BuildKind, GatewayKind, TIER_FREE_RUNNING, TimeControl, TimeStatus};
use osap_protocol::framing::Check;
use serde::Serialize;

/// Shows all that a device tells: runtime, links, ports, clock
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  osap info 'Message Hub A'\n  osap info /0/3 --json")]
pub struct InfoArgs {
    /// Device: its name, the head of its unique id, or its route such as /0/3
    device: String,
    #[command(flatten)]
    links: LinkArgs,
}

#[derive(Serialize)]
struct Document<'a> {
    device: &'a Device,
    time_control: &'a TimeControl,
    time_status: &'a TimeStatus,
}

pub(super) fn run(args: &InfoArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    let mut scanned = Scanned::open(&args.links, output)?;
    let device = scanned.device(&args.device, "info")?.clone();
    let to = scanned.session.destination_of(&device);
    let time = scanned.session.time_control(&to).map_err(|error| scanned.failed(&error))?.value;
    let status = scanned.session.time_status(&to).map_err(|error| scanned.failed(&error))?.value;
    if output.json() {
        output.document("info", &Document { device: &device, time_control: &time, time_status: &status })?;
        return scanned.finish(Exit::Ok);
    }
    output.line(format!("{STRONG}{}{STRONG:#}", printable(&device.label())))?;
    output.text(facts(&device).plain_body())?;
    output.line("")?;
    output.text(gateways(&scanned.map, &device))?;
    output.line("")?;
    output.text(ports(&device))?;
    output.line("")?;
    output.line(format!("{STRONG}clock{STRONG:#}"))?;
    output.text(clock(&scanned.map, &time, &status).plain_body())?;
    scanned.finish(Exit::Ok)
}

/// Lines of a name and a value.
fn pairs<const N: usize>(rows: [(&str, String); N]) -> Table {
    let mut table = Table::new([("", Align::Left), ("", Align::Left)]);
    for (name, value) in rows {
        table.row([format!("  {name}"), value]);
    }
    table
}

fn facts(device: &Device) -> Table {
    let [major, minor, patch] = device.version;
    let build = match device.build {
        BuildKind::Firmware => "firmware",
        BuildKind::Host => "a workstation's process",
        BuildKind::Simulated => "simulated",
    };
    let routes = device.routes.iter().map(|way| format!("{} (packets of {} bytes)", way.route, way.mtu_bytes));
    pairs([
        ("type", printable(&device.type_name)),
        ("unique id", device.unique_id.to_string()),
        ("boot epoch", device.boot_epoch.to_string()),
        ("runtime", format!("{major}.{minor}.{patch}, {build}")),
        ("up for", seconds(device.uptime_us)),
        ("memory", format!("{} packets of {} bytes", device.slots, device.packet_bytes_max)),
        ("routes", routes.collect::<Vec<_>>().join(", ")),
    ])
}

fn seconds(us: u64) -> String {
    format!("{}.{:06} s", us / 1_000_000, us % 1_000_000)
}

fn gateways(map: &NetworkMap, device: &Device) -> Table {
    let mut table = Table::new([
        ("gateway", Align::Right),
        ("type", Align::Left),
        ("leads to", Align::Left),
        ("packet", Align::Right),
        ("bit/s", Align::Right),
        ("check", Align::Left),
        ("hold", Align::Right),
        ("received", Align::Right),
        ("sent", Align::Right),
        ("dropped", Align::Right),
    ]);
    for gateway in &device.gateways {
        let check = match gateway.check {
            Check::None => "-",
            Check::Crc16 => "crc16",
            Check::Crc32 => "crc32",
        };
        table.row([
            gateway.index.to_string(),
            match gateway.kind {
                GatewayKind::Link => printable(&gateway.type_name),
                GatewayKind::Bus { drop } => format!("{}, drop {drop}", printable(&gateway.type_name)),
            },
            leads_to(map, gateway),
            gateway.mtu_bytes.to_string(),
            if gateway.bit_rate == 0 { "-".to_owned() } else { gateway.bit_rate.to_string() },
            check.to_owned(),
            gateway.packet_hold_max.to_string(),
            gateway.received.to_string(),
            gateway.sent.to_string(),
            gateway.dropped.to_string(),
        ]);
    }
    table
}

fn leads_to(map: &NetworkMap, gateway: &Gateway) -> String {
    let label = |device: usize| map.devices.get(device).map_or_else(String::new, |device| printable(&device.label()));
    match gateway.leads_to {
        _ if !gateway.open => "closed".to_owned(),
        Some(LeadsTo::Device { device, .. }) => label(device),
        Some(LeadsTo::Bus { bus }) => {
            let members = map.buses.get(bus).map_or(0, |bus| bus.members.len());
            format!("a bus of {members}")
        }
        Some(LeadsTo::Silent { .. }) => "somebody silent".to_owned(),
        None => "-".to_owned(),
    }
}

fn ports(device: &Device) -> Table {
    let mut table = Table::new([
        ("port", Align::Right),
        ("type", Align::Left),
        ("name", Align::Left),
        ("hold", Align::Right),
        ("received", Align::Right),
        ("sent", Align::Right),
    ]);
    for port in &device.ports {
        table.row([
            port.index.to_string(),
            printable(&port.type_name),
            printable(&port.name),
            port.packet_hold_max.to_string(),
            port.received.to_string(),
            port.sent.to_string(),
        ]);
    }
    table
}

fn clock(map: &NetworkMap, time: &TimeControl, status: &TimeStatus) -> Table {
    let tier = match time.tier {
        TIER_FREE_RUNNING => "free running".to_owned(),
        0 => "the root".to_owned(),
        steps => {
            let root = map.devices.iter().find(|device| device.unique_id == status.root);
            let root = root.map_or_else(|| status.root.to_string(), |device| printable(&device.label()));
            format!("{} from {root}", count(steps.into(), "step", "steps"))
        }
    };
    let unix = status.unix_offset_us.map(|offset_us| {
        let system_us = i64::try_from(time.system_time_steps / 256).unwrap_or(i64::MAX);
        let unix_us = system_us.saturating_add(offset_us);
        format!("{}.{:06} s since 1970", unix_us.div_euclid(1_000_000), unix_us.rem_euclid(1_000_000))
    });
    let bound = if time.bound_steps < 0 { "none can be given".to_owned() } else { micros(i64::from(time.bound_steps)) };
    pairs([
        ("synchronised", tier),
        ("settled", if status.is_settled { "yes" } else { "no" }.to_owned()),
        ("steered by", status.settings.servo.name().to_owned()),
        ("system time", seconds(time.system_time_steps / 256)),
        ("UNIX time", unix.unwrap_or_else(|| "nobody offers it".to_owned())),
        ("own counter", seconds(time.local_ticks_steps / 256)),
        ("error at most", bound),
        ("rate", format!("{} ppb", time.skew_ppb)),
        ("offset", micros(i64::from(time.offset_steps))),
        (
            "round trip",
            format!("{}, least {}", micros(time.round_trip_steps.into()), micros(time.round_trip_min_steps.into())),
        ),
        ("exchange every", format!("{} µs", time.interval_us)),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_have_all_their_microseconds() {
        assert_eq!(seconds(1_000_001), "1.000001 s");
    }
}

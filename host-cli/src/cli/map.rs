//! `osap map`: every way to every device, links and buses; kept in files and compared with them.

use super::devices::{Scanned, shown};
use super::links::LinkArgs;
use super::output::{BAD, GOOD, printable};
use super::scan::{findings, wholeness};
use super::table::{Align, Table};
use super::{CliError, Exit, Output};
use crate::map::{Change, LinkEnd, NetworkMap, diff};
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Shows all ways, links and buses; saves the map or compares it with one saved before
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  osap map --save machine.json\n  osap map --compare machine.json || echo 'something moved'\n  \
                        osap map --dot | dot -Tsvg > machine.svg"
)]
pub struct MapArgs {
    /// Draws a graph for Graphviz instead
    #[arg(long, conflicts_with = "compare")]
    dot: bool,
    /// Writes the map to a file, to compare with later
    #[arg(long, value_name = "FILE")]
    save: Option<PathBuf>,
    /// Tells what is swapped, rebooted, moved, renamed, lost or new since the map of this file, and ends with code 1 where anything is
    #[arg(long, value_name = "FILE")]
    compare: Option<PathBuf>,
    #[command(flatten)]
    links: LinkArgs,
}

#[derive(Serialize)]
struct Comparison<'a> {
    differs: bool,
    changes: &'a [Change],
}

pub(super) fn run(args: &MapArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    if args.dot && output.json() {
        let next = "leave out one of them; the document of `osap --json map` has all that the graph shows";
        return Err(CliError::new(Exit::Usage, "--dot and --json exclude each other", "the command line", next));
    }
    // Read first: who gave a wrong file need not wait for a scan.
    let before = args.compare.as_deref().map(load).transpose()?;
    let mut scanned = Scanned::open(&args.links, output)?;
    let exit = if let Some(before) = &before {
        compare(before, &scanned.map, output)?
    } else {
        show(&scanned.map, args.dot, output)?;
        Exit::Ok
    };
    // What is kept is worth comparing with, be it whole or not.
    if let Some(file) = &args.save {
        let text = scanned.map.to_json() + "\n";
        std::fs::write(file, text).map_err(|error| CliError::file(file, "write the map", &error))?;
        output.say(format!("The map is in {}.", file.display()));
    }
    let exit = if before.is_some() { exit } else { wholeness(&scanned, &args.links)? };
    scanned.finish(exit)
}

/// A map that was saved, by itself or within the document of a scan.
fn load(file: &Path) -> Result<NetworkMap, CliError> {
    let text = std::fs::read_to_string(file).map_err(|error| CliError::file(file, "read the map", &error))?;
    let whole = serde_json::from_str::<serde_json::Value>(&text).unwrap_or_default();
    let text = whole.get("map").map_or(text, ToString::to_string);
    NetworkMap::from_json(&text).map_err(|error| {
        let next = "save one with `osap map --save FILE` and compare with that";
        CliError::new(Exit::Io, error.to_string(), file.display().to_string(), next)
    })
}

fn compare(before: &NetworkMap, now: &NetworkMap, output: &mut Output<'_>) -> Result<Exit, CliError> {
    let changes = diff(before, now);
    let differs = !changes.is_empty();
    if output.json() {
        output.document("map-compare", &Comparison { differs, changes: &changes })?;
    } else if differs {
        for change in &changes {
            output.line(format!("{BAD}{}{BAD:#}", printable(&change.to_string())))?;
        }
    } else {
        output.line(format!("{GOOD}as it was: {} devices{GOOD:#}", now.devices.len()))?;
    }
    Ok(if differs { Exit::Differs } else { Exit::Ok })
}

fn show(map: &NetworkMap, dot: bool, output: &mut Output<'_>) -> Result<(), CliError> {
    if output.json() {
        // A map names its own schema.
        let text = serde_json::to_string(map).map_err(std::io::Error::from)?;
        return output.line(text);
    }
    if dot {
        return output.text(map.dot());
    }
    let map = shown(map);
    output.text(devices(&map))?;
    output.line("")?;
    output.text(links(&map))?;
    if !map.buses.is_empty() {
        output.line("")?;
        output.text(buses(&map))?;
    }
    findings(&map, output);
    for place in &map.silent {
        let tries = place.tries;
        output.say(format!("note: nobody answered at {} in {tries} tries; check its power and cable", place.route));
    }
    Ok(())
}

fn devices(map: &NetworkMap) -> Table {
    let mut table = Table::new(["device", "type", "unique id", "routes"].map(|head| (head, Align::Left)));
    for device in &map.devices {
        let routes: Vec<String> = device.routes.iter().map(|way| way.route.to_string()).collect();
        table.row([device.label(), device.type_name.clone(), device.unique_id.to_string(), routes.join("  ")]);
    }
    table
}

fn links(map: &NetworkMap) -> Table {
    let mut table = Table::new([
        ("link", Align::Left),
        ("type", Align::Left),
        ("bit/s", Align::Right),
        ("packet", Align::Right),
        ("", Align::Left),
    ]);
    for link in &map.links {
        let gateway = map
            .devices
            .get(link.near.device)
            .and_then(|device| device.gateways.iter().find(|gateway| Some(gateway.index) == link.near.gateway));
        table.row([
            format!("{} - {}", end(map, link.near), end(map, link.far)),
            gateway.map_or_else(String::new, |gateway| printable(&gateway.type_name)),
            gateway.map_or_else(String::new, |gateway| gateway.bit_rate.to_string()),
            gateway.map_or_else(String::new, |gateway| gateway.mtu_bytes.to_string()),
            if link.in_tree { String::new() } else { "closes a loop".to_owned() },
        ]);
    }
    table
}

/// `device:gateway`.
fn end(map: &NetworkMap, end: LinkEnd) -> String {
    let label = map.devices.get(end.device).map_or_else(|| "?".to_owned(), crate::map::Device::label);
    end.gateway.map_or_else(|| label.clone(), |gateway| format!("{label}:{gateway}"))
}

fn buses(map: &NetworkMap) -> Table {
    let mut table = Table::new([("bus", Align::Right), ("drop", Align::Right), ("device", Align::Left)]);
    for (number, bus) in map.buses.iter().enumerate() {
        for member in &bus.members {
            let end = end(map, LinkEnd { device: member.device, gateway: member.gateway });
            table.row([number.to_string(), member.drop.to_string(), end]);
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_map_says_how_to_make_one() {
        let file = std::env::temp_dir().join(format!("osap-no-map-{}", std::process::id()));
        let exit = |text: &str| {
            std::fs::write(&file, text).unwrap();
            let error = load(&file).unwrap_err();
            assert!(error.to_string().contains("osap map --save"), "{error}");
            error.exit()
        };
        assert_eq!(exit("{}"), Exit::Io);
        assert_eq!(exit("no JSON"), Exit::Io);
        std::fs::remove_file(&file).unwrap();
        assert_eq!(load(&file).unwrap_err().exit(), Exit::Io);
    }
}

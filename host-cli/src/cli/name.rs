//! `osap name`: tells what a device is called, or calls it something else, `[DSC-05]`.

use super::devices::{DeviceId, Scanned};
use super::links::{LinkArgs, quoted};
use super::output::{is_unseen, printable};
use super::{CliError, Exit, Output};
use clap::Args;
use osap_protocol::discovery::NAME_BYTES_MAX;
use serde::Serialize;

/// Shows a device's name, or gives it a new one
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  osap name /0/3\n  osap name /0/3 'Extruder Heater'")]
pub struct NameArgs {
    /// Device: its name, the head of its unique id, or its route such as /0/3
    device: String,
    /// What to call it from now on; at most 32 bytes
    #[arg(value_name = "NEWNAME", value_parser = parse_name)]
    new: Option<String>,
    #[command(flatten)]
    links: LinkArgs,
}

#[derive(Serialize)]
struct Document {
    #[serde(flatten)]
    device: DeviceId,
    /// What it was called, where that was changed.
    before: Option<String>,
}

/// A name that a device can keep.
fn parse_name(text: &str) -> Result<String, String> {
    match text.len() {
        _ if text.chars().all(|c| c.is_whitespace() || is_unseen(c)) => {
            Err("a name has at least one character that can be seen".to_owned())
        }
        len if len > NAME_BYTES_MAX => Err(format!("this has {len} bytes of UTF-8, a name at most {NAME_BYTES_MAX}")),
        _ if text.starts_with('/') => Err("a name that begins with a slash would be taken for a route".to_owned()),
        _ if text.chars().any(char::is_control) => Err("a name has no control characters".to_owned()),
        _ => Ok(text.to_owned()),
    }
}

pub(super) fn run(args: &NameArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    let mut scanned = Scanned::open(&args.links, output)?;
    let device = scanned.device(&args.device, "name")?.clone();
    let to = scanned.session.destination_of(&device);
    if let Some(new) = &args.new {
        scanned.session.set_name(&to, new).map_err(|error| scanned.failed(&error))?;
    }
    // What it says now, not what we believe to have told it.
    let now = scanned.session.name(&to).map_err(|error| scanned.failed(&error))?.value.as_str().to_owned();
    if output.json() {
        let before = args.new.is_some().then(|| device.name.clone());
        output.document("name", &Document { device: DeviceId { name: now, ..DeviceId::from(&device) }, before })?;
        return scanned.finish(Exit::Ok);
    }
    match &args.new {
        None => output.line(printable(&now))?,
        Some(_) => output.line(format!("{} is called {} now", printable(&device.label()), printable(&now)))?,
    }
    let namesakes = scanned.map.devices.iter().filter(|other| other.name == now && other.unique_id != device.unique_id);
    for other in namesakes {
        output.say(format!(
            "note: the device at {} has this name too; tell them apart by route, or rename one: {}",
            other.route(),
            args.links.command(&format!("name {} {}", other.route(), quoted(&format!("{now} 2"))))
        ));
    }
    scanned.finish(Exit::Ok)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_fits_and_cannot_be_taken_for_something_else() {
        assert_eq!(parse_name("Z (left) ü"), Ok("Z (left) ü".to_owned()));
        assert!(parse_name(&"ü".repeat(16)).is_ok());
        for wrong in ["", "  ", "\u{a0}\u{200b}", "/0/3", "a\nb", &"ü".repeat(17)] {
            assert!(parse_name(wrong).is_err(), "{wrong}");
        }
    }
}

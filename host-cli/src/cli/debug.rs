//! `osap debug`: what happened last in a device, and how much it writes down.

use super::devices::{DeviceId, Scanned};
use super::links::LinkArgs;
use super::output::{BAD, printable};
use super::wait::{Until, parse_seconds};
use super::{CliError, Exit, Output};
use crate::map::Device;
use crate::session::DebugLog;
use clap::{Args, ValueEnum};
use osap_protocol::discovery::{DebugEvent, Event, NeighbourChange, Stage, Verbosity};
use osap_runtime::sequenced::Destination;
use serde::Serialize;
use std::time::Duration;

/// Between two questions while following: a device keeps only its last few events.
const ASK_EVERY: Duration = Duration::from_millis(50);

/// Shows a device's last events; sets how much it writes down
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  osap debug 'Load Cell'\n  osap debug /0/3 --verbosity packets --follow --for 10")]
pub struct DebugArgs {
    /// Device: its name, the head of its unique id, or its route such as /0/3
    device: String,
    /// Sets what it writes down from now on
    #[arg(long, value_enum, value_name = "LEVEL")]
    verbosity: Option<Level>,
    /// Goes on to show what happens, until Ctrl-C
    #[arg(long)]
    follow: bool,
    /// Ends following after so many seconds
    #[arg(long = "for", value_name = "SECONDS", requires = "follow", value_parser = parse_seconds)]
    follow_for: Option<Duration>,
    #[command(flatten)]
    links: LinkArgs,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Level {
    /// Nothing
    Silent,
    /// Drops
    Drops,
    /// And what happens to links, neighbours and names, and the application's lines
    Events,
    /// And each stage of each packet
    Packets,
}

impl Level {
    const fn verbosity(self) -> Verbosity {
        match self {
            Self::Silent => Verbosity::Silent,
            Self::Drops => Verbosity::Drops,
            Self::Events => Verbosity::Events,
            Self::Packets => Verbosity::Packets,
        }
    }
}

#[derive(Serialize)]
struct Document<'a> {
    #[serde(flatten)]
    device: &'a DeviceId,
    verbosity: Verbosity,
    /// Number of the first event here.
    first: u32,
    /// Events that made way for newer ones before they were read.
    missed: u32,
    events: &'a [DebugEvent],
}

/// What is read from whom, and how far.
struct Reader<'a, 'b> {
    scanned: &'b mut Scanned<'a>,
    id: DeviceId,
    to: Destination,
    cursor: u32,
}

pub(super) fn run(args: &DebugArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    let mut scanned = Scanned::open(&args.links, output)?;
    let device: Device = scanned.device(&args.device, "debug")?.clone();
    let to = scanned.session.destination_of(&device);
    if let Some(level) = args.verbosity {
        scanned.session.set_verbosity(&to, level.verbosity()).map_err(|error| scanned.failed(&error))?;
    }
    let mut reader = Reader { scanned: &mut scanned, id: DeviceId::from(&device), to, cursor: 0 };
    let log = reader.read()?;
    reader.show(&log, 0, output)?;
    if log.events.is_empty() && !output.json() {
        output.say(format!("Nothing was written down; its verbosity is {}.", name_of(log.verbosity)));
    }
    let until = args.follow.then(|| Until::new(args.follow_for));
    while until.as_ref().is_some_and(|until| until.pause(ASK_EVERY)) {
        let from = reader.cursor;
        let log = reader.read()?;
        if !log.events.is_empty() {
            // The numbers go round.
            reader.show(&log, log.first.wrapping_sub(from), output)?;
        }
    }
    scanned.finish(Exit::Ok)
}

impl Reader<'_, '_> {
    fn read(&mut self) -> Result<DebugLog, CliError> {
        let log = self.scanned.session.debug_log(&self.to, self.cursor).map_err(|error| self.scanned.failed(&error))?;
        self.cursor = log.next;
        Ok(log)
    }

    fn show(&self, log: &DebugLog, missed: u32, output: &mut Output<'_>) -> Result<(), CliError> {
        if output.json() {
            let DebugLog { verbosity, first, ref events, .. } = *log;
            return output.document("debug", &Document { device: &self.id, verbosity, first, missed, events });
        }
        if missed > 0 {
            output.say(format!("{missed} events made way for newer ones before they were read"));
        }
        for event in &log.events {
            let at = event.at_us;
            let text = text(&event.event);
            let line = format!("{:>6}.{:06} s  {text}", at / 1_000_000, at % 1_000_000);
            match event.event {
                Event::Dropped { .. } => output.line(format!("{BAD}{line}{BAD:#}"))?,
                _ => output.line(line)?,
            }
        }
        output.flush()
    }
}

/// One event, for people.
fn text(event: &Event) -> String {
    let by =
        |gateway: &Option<u8>| gateway.map_or_else(String::new, |gateway| format!(", came in by gateway {gateway}"));
    match event {
        Event::Dropped { cause, gateway } => {
            let meaning = cause.meaning().trim_end_matches('.');
            format!("dropped, {}: {meaning}{}", cause.name(), by(gateway))
        }
        Event::Gateway { gateway, open } => {
            format!("gateway {gateway} {}", if *open { "opened" } else { "closed" })
        }
        Event::Neighbour { gateway, change } => {
            let change = match change {
                NeighbourChange::Appeared => "a neighbour appeared",
                NeighbourChange::Swapped => "another neighbour is there now",
                NeighbourChange::Rebooted => "the neighbour booted again",
                NeighbourChange::Lost => "the neighbour is lost",
            };
            format!("gateway {gateway}: {change}")
        }
        Event::Renamed => "the device was given a new name".to_owned(),
        Event::Stage { stage, index } => stage_text(*stage, *index),
        Event::Text(text) => printable(text),
        Event::Clock { change, tier } => format!("clock: {}, tier {tier}", change.name()),
    }
}

fn stage_text(stage: Stage, index: u16) -> String {
    match stage {
        Stage::Ingress => format!("packet: ingress by gateway {index}"),
        Stage::Route => format!("packet: route found, to {index}"),
        Stage::Stack => format!("packet: in the stack, for {index}"),
        Stage::Egress => format!("packet: egress by gateway {index}"),
        Stage::Deliver => format!("packet: delivered to port {index}"),
        Stage::Reply => format!("packet: turned back as a reply by port {index}"),
    }
}

const fn name_of(verbosity: Verbosity) -> &'static str {
    match verbosity {
        Verbosity::Silent => "silent",
        Verbosity::Drops => "drops",
        Verbosity::Events => "events",
        Verbosity::Packets => "packets",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osap_protocol::DropCause;

    #[test]
    fn an_event_says_what_where_and_why() {
        let dropped = Event::Dropped { cause: DropCause::Expired, gateway: Some(2) };
        assert_eq!(text(&dropped), "dropped, expired: The packet's time to live ran out, came in by gateway 2");
        let hostile = Event::Text("\u{1b}[2J".try_into().unwrap());
        assert_eq!(text(&hostile), "\\u{1b}[2J");
    }
}

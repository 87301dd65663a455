//! `osap debug`: what happened last in a device, and how much it writes down.

use super::devices::{DeviceId, Scanned};
use super::links::LinkArgs;
use super::output::{BAD, printable};
use super::wait::{Until, parse_seconds};
use super::{CliError, Exit, Output};
use crate::clocks::micros;
use crate::map::Device;
use crate::session::DebugLog;
use clap::{Args, ValueEnum};
use osap_protocol::discovery::{ClockChange, ClockMark, DebugEvent, Event, NeighbourChange, Stage, Verbosity};
use osap_runtime::clock::DEFAULT_SETTINGS;
use osap_runtime::sequenced::Destination;
use serde::Serialize;
use std::time::Duration;

/// Between two questions while following: a device keeps only its last few events.
const ASK_EVERY: Duration = Duration::from_millis(50);

/// Most that the rate of a clock is shimmed, parts per 10⁹, where nobody allowed it more.
const SLEW_MAX_PPB: u128 = DEFAULT_SETTINGS.skew_limit_ppb.unsigned_abs() as u128;

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
    /// Both clocks at one instant, where the device's time is settled.
    clock: Option<ClockMark>,
    events: Vec<EventDocument<'a>>,
}

#[derive(Serialize)]
struct EventDocument<'a> {
    #[serde(flatten)]
    event: &'a DebugEvent,
    /// The same in system time, 1/256 µs; `None` where only the device's own clock is known.
    system: Option<SystemStamp>,
}

/// An instant in system time, 1/256 µs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
struct SystemStamp {
    system_steps: u64,
    bound_steps: u64,
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
            let DebugLog { verbosity, first, clock, ref events, .. } = *log;
            let events =
                events.iter().zip(stamps(log)).map(|(event, system)| EventDocument { event, system }).collect();
            return output.document("debug", &Document { device: &self.id, verbosity, first, missed, clock, events });
        }
        if missed > 0 {
            output.say(format!("{missed} events made way for newer ones before they were read"));
        }
        for (event, system) in log.events.iter().zip(stamps(log)) {
            let text = text(&event.event);
            let seconds = |us: u64| format!("{:>6}.{:06} s", us / 1_000_000, us % 1_000_000);
            let line = match system {
                Some(SystemStamp { system_steps, bound_steps }) => {
                    let bound = micros(i64::try_from(bound_steps).unwrap_or(i64::MAX));
                    format!("{} ± {bound}  {text}", seconds(system_steps / 256))
                }
                None => format!("{} local clock  {text}", seconds(event.at_us)),
            };
            match event.event {
                Event::Dropped { .. } => output.line(format!("{BAD}{line}{BAD:#}"))?,
                _ => output.line(line)?,
            }
        }
        output.flush()
    }
}

/// The events of a log in system time, `[TIM-15]`: `None` for those that the mark says nothing of, which are all before the clock was set
/// anew or followed another root.
fn stamps(log: &DebugLog) -> impl Iterator<Item = Option<SystemStamp>> {
    let is_break = |event: &DebugEvent| {
        matches!(event.event, Event::Clock { change: ClockChange::Root | ClockChange::SetAnew, .. })
    };
    let valid_from = log.events.iter().rposition(is_break).map_or(0, |last| last + 1);
    let each = move |(number, event): (usize, &DebugEvent)| {
        let mark = log.clock.filter(|_| number >= valid_from)?;
        Some(system_stamp(mark, event.at_us))
    };
    log.events.iter().enumerate().map(each)
}

/// An instant of a device's own clock in system time, from a mark near it. Between the two the map was slewed by at most what a device's
/// settings allow, which widens the bound.
fn system_stamp(mark: ClockMark, at_us: u64) -> SystemStamp {
    let ahead = i128::from(at_us) * 256 - i128::from(mark.local_steps);
    let system = i128::from(mark.system_steps) + ahead + ahead * i128::from(mark.rate_ppb) / 1_000_000_000;
    let slewed = ahead.unsigned_abs() * SLEW_MAX_PPB / 1_000_000_000;
    // the event's stamp was cut to a microsecond
    let bound = u128::from(mark.bound_steps) + slewed + 256;
    SystemStamp {
        system_steps: u64::try_from(system.max(0)).unwrap_or(u64::MAX),
        bound_steps: u64::try_from(bound).unwrap_or(u64::MAX),
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

    /// `[TIM-15]`: back and forth from the mark by its rate, and wider the further from it.
    #[test]
    fn an_event_is_told_in_system_time_with_its_bound() {
        let mark = ClockMark { local_steps: 256_000_000, system_steps: 512_000_000, rate_ppb: 1_000, bound_steps: 512 };
        let at_mark = system_stamp(mark, 1_000_000);
        assert_eq!(at_mark, SystemStamp { system_steps: 512_000_000, bound_steps: 768 });
        // a second before: by 1 ppm of it less, and what 500 ppm can have slewed
        let before = system_stamp(mark, 0);
        assert_eq!(before, SystemStamp { system_steps: 256_000_000 - 256, bound_steps: 768 + 128_000 });
    }

    #[test]
    fn before_a_clock_was_set_anew_it_is_only_local() {
        let event = |event| DebugEvent { at_us: 5, event };
        let set_anew = Event::Clock { change: ClockChange::SetAnew, tier: 1 };
        let mark = ClockMark { local_steps: 0, system_steps: 0, rate_ppb: 0, bound_steps: 0 };
        let events = vec![event(Event::Renamed), event(set_anew), event(Event::Renamed)];
        let log = DebugLog { first: 0, next: 3, missed: 0, verbosity: Verbosity::Events, clock: Some(mark), events };
        assert_eq!(stamps(&log).map(|stamp| stamp.is_some()).collect::<Vec<_>>(), [false, false, true]);
        let without = DebugLog { clock: None, ..log };
        assert!(stamps(&without).all(|stamp| stamp.is_none()));
    }

    #[test]
    fn an_event_says_what_where_and_why() {
        let dropped = Event::Dropped { cause: DropCause::Expired, gateway: Some(2) };
        assert_eq!(text(&dropped), "dropped, expired: The packet's time to live ran out, came in by gateway 2");
        let hostile = Event::Text("\u{1b}[2J".try_into().unwrap());
        assert_eq!(text(&hostile), "\\u{1b}[2J");
    }
}

//! `osap clock tune`: reads and writes what steers a device's clock, `[TIM-11]`, `[TIM-13]`.
//!
//! - **Invariant:** only what is named is changed: the rest is written back as it was read.

use super::table::ppm;
use super::units::{parse_ppb, parse_q16, parse_signed_steps, parse_span};
use crate::cli::devices::{DeviceId, Scanned};
use crate::cli::links::LinkArgs;
use crate::cli::output::{STRONG, printable};
use crate::cli::table::{Align, Table};
use crate::cli::{CliError, Exit, Output};
use crate::clocks::micros;
use crate::map::Device;
use clap::{Args, ValueEnum};
use fixed_math::time::Span;
use osap_protocol::discovery::{Name, ServoKind, TimeAsymmetry, TimeSettings};
use osap_runtime::sequenced::Destination;
use serde::Serialize;

/// Shows what steers a clock, or changes what is named
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  osap clock tune 'A Motor'\n  osap clock tune --all --servo diffusion --interval 20ms\n  \
                        osap clock tune /0 --priority 10 --asymmetry usb-cdc=12us"
)]
pub(super) struct TuneArgs {
    /// Device: its name, the head of its unique id, or its route such as /0/3
    #[arg(required_unless_present = "all", conflicts_with = "all")]
    device: Option<String>,
    /// All devices, the host among them
    #[arg(long)]
    all: bool,
    #[command(flatten)]
    change: Change,
    #[command(flatten)]
    links: LinkArgs,
}

/// What shall be otherwise.
#[derive(Args, Clone, Debug, Default)]
struct Change {
    /// What steers the clock
    #[arg(long, value_enum, value_name = "SERVO")]
    servo: Option<Servo>,
    /// Time between exchanges with a neighbour: 1ms to 10s
    #[arg(long, value_name = "TIME", value_parser = parse_span)]
    interval: Option<Span>,
    /// Weight of a new offset in the average: up to 1
    #[arg(long, value_name = "FACTOR", value_parser = parse_q16)]
    filter: Option<i32>,
    /// Proportional gain: 0 to 256
    #[arg(long, value_name = "FACTOR", value_parser = parse_q16)]
    proportional: Option<i32>,
    /// Integral gain: 0 to 256
    #[arg(long, value_name = "FACTOR", value_parser = parse_q16)]
    integral: Option<i32>,
    /// Most that the rate may be shimmed: up to 20000ppm
    #[arg(long, value_name = "RATE", value_parser = parse_ppb)]
    limit: Option<i32>,
    /// Offsets further off than this are not believed once the clock is settled
    #[arg(long, value_name = "TIME", allow_hyphen_values = true, value_parser = parse_signed_steps)]
    gate: Option<i32>,
    /// Whose time is the network's: the lowest; 255 is never root
    #[arg(long, value_name = "NUMBER")]
    priority: Option<u8>,
    /// By how much the way there is longer than the way back, for all links of a type: usb-cdc=12us; given again for more
    #[arg(long, value_name = "TYPE=TIME", value_parser = parse_asymmetry)]
    asymmetry: Vec<Asymmetry>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Servo {
    /// Follows the root's time as estimated over the links
    Estimator,
    /// Averaged offsets to the best neighbours, a PI controller on the rate
    Diffusion,
    /// An older clock is adopted, else the mean of all offsets shims the rate
    Oldest,
}

#[derive(Clone, Debug)]
struct Asymmetry {
    type_name: Name,
    steps: i32,
}

fn parse_asymmetry(text: &str) -> Result<Asymmetry, String> {
    let (type_name, time) = text.split_once('=').ok_or("expected a type of link and a time, such as usb-cdc=12us")?;
    let type_name = Name::try_from(type_name).map_err(|_| format!("{type_name:?} is too long for a type of link"))?;
    Ok(Asymmetry { type_name, steps: parse_signed_steps(time)? })
}

impl Change {
    const fn changes_settings(&self) -> bool {
        self.servo.is_some()
            || self.interval.is_some()
            || self.filter.is_some()
            || self.proportional.is_some()
            || self.integral.is_some()
            || self.limit.is_some()
            || self.gate.is_some()
            || self.priority.is_some()
    }

    /// What `was`, with what is named changed.
    fn applied_to(&self, was: TimeSettings) -> TimeSettings {
        let servo = self.servo.map(|servo| match servo {
            Servo::Estimator => ServoKind::Estimator,
            Servo::Diffusion => ServoKind::Diffusion,
            Servo::Oldest => ServoKind::Oldest,
        });
        let interval_us = self.interval.map(|interval| u32::try_from(interval.steps() / 256).unwrap_or(u32::MAX));
        TimeSettings {
            interval_us: interval_us.unwrap_or(was.interval_us),
            filter_q16: self.filter.unwrap_or(was.filter_q16),
            proportional_q16: self.proportional.unwrap_or(was.proportional_q16),
            integral_q16: self.integral.unwrap_or(was.integral_q16),
            skew_limit_ppb: self.limit.unwrap_or(was.skew_limit_ppb),
            gate_steps: self.gate.unwrap_or(was.gate_steps),
            servo: servo.unwrap_or(was.servo),
            priority: self.priority.unwrap_or(was.priority),
        }
    }
}

#[derive(Serialize)]
struct Document<'a> {
    #[serde(flatten)]
    device: DeviceId,
    before: TimeSettings,
    after: TimeSettings,
    asymmetries: &'a [Set],
}

/// An asymmetry that was set.
#[derive(Serialize)]
struct Set {
    type_name: String,
    asymmetry_steps: i32,
}

pub(super) fn run(args: &TuneArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    let mut scanned = Scanned::open(&args.links, output)?;
    let devices: Vec<Device> = match &args.device {
        Some(text) => vec![scanned.device(text, "clock tune")?.clone()],
        None => scanned.map.devices.clone(),
    };
    for device in devices {
        let to = scanned.session.destination_of(&device);
        let before = read(&mut scanned, &to)?;
        if args.change.changes_settings() {
            let wanted = args.change.applied_to(before);
            scanned.session.set_time_control(&to, &wanted).map_err(|error| scanned.failed(&error))?;
        }
        for asymmetry in &args.change.asymmetry {
            calibrate(&mut scanned, &to, asymmetry)?;
        }
        // what it says now, not what we believe to have told it
        let after = read(&mut scanned, &to)?;
        show(&device, before, after, &args.change, output)?;
    }
    scanned.finish(Exit::Ok)
}

fn read(scanned: &mut Scanned<'_>, to: &Destination) -> Result<TimeSettings, CliError> {
    let status = scanned.session.time_status(to).map_err(|error| scanned.failed(&error))?;
    Ok(status.value.settings)
}

fn calibrate(scanned: &mut Scanned<'_>, to: &Destination, asymmetry: &Asymmetry) -> Result<(), CliError> {
    let Asymmetry { type_name, steps } = asymmetry.clone();
    let set = scanned.session.set_time_asymmetry(to, &TimeAsymmetry { type_name, asymmetry_steps: steps });
    set.map_err(|error| scanned.failed(&error)).map(|_| ())
}

fn show(
    device: &Device,
    before: TimeSettings,
    after: TimeSettings,
    change: &Change,
    output: &mut Output<'_>,
) -> Result<(), CliError> {
    let set = |it: &Asymmetry| Set { type_name: it.type_name.as_str().to_owned(), asymmetry_steps: it.steps };
    let asymmetries: Vec<Set> = change.asymmetry.iter().map(set).collect();
    if output.json() {
        let document = Document { device: DeviceId::from(device), before, after, asymmetries: &asymmetries };
        return output.document("clock-tune", &document);
    }
    output.line(format!("{STRONG}{}{STRONG:#}", printable(&device.label())))?;
    let mut table = Table::new([("", Align::Left), ("", Align::Left)]);
    let is_asked = change.changes_settings() || !asymmetries.is_empty();
    for ((name, was), (_, is)) in rows(&before).into_iter().zip(rows(&after)) {
        match (was == is, is_asked) {
            (false, _) => table.row([format!("  {name}"), format!("{was} → {is}")]),
            (true, false) => table.row([format!("  {name}"), is]),
            (true, true) => {}
        }
    }
    for Set { type_name, asymmetry_steps } in &asymmetries {
        let row = [format!("  asymmetry of {}", printable(type_name)), micros((*asymmetry_steps).into())];
        table.row(row);
    }
    if table.is_empty() {
        table.row(["  as it was"]);
    }
    output.text(table.plain_body())
}

fn rows(settings: &TimeSettings) -> [(&'static str, String); 8] {
    let factor = |q16: i32| format!("{:.4}", f64::from(q16) / 65_536.0);
    [
        ("servo", settings.servo.name().to_owned()),
        ("interval", micros(i64::from(settings.interval_us) * 256)),
        ("filter", factor(settings.filter_q16)),
        ("proportional", factor(settings.proportional_q16)),
        ("integral", factor(settings.integral_q16)),
        ("limit", format!("{} ppm", ppm(settings.skew_limit_ppb))),
        ("gate", micros(settings.gate_steps.into())),
        ("priority", settings.priority.to_string()),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    const WAS: TimeSettings = TimeSettings {
        interval_us: 50_000,
        filter_q16: 16_384,
        proportional_q16: 6_554,
        integral_q16: 655,
        skew_limit_ppb: 500_000,
        gate_steps: 2_560_000,
        servo: ServoKind::Oldest,
        priority: 128,
    };

    #[test]
    fn only_what_is_named_is_changed() {
        assert_eq!(Change::default().applied_to(WAS), WAS);
        let change = Change { interval: Some(Span::from_us(20_000)), priority: Some(3), ..Change::default() };
        assert_eq!(change.applied_to(WAS), TimeSettings { interval_us: 20_000, priority: 3, ..WAS });
        assert!(change.changes_settings() && !Change::default().changes_settings());
    }

    #[test]
    fn an_asymmetry_has_its_type_and_its_unit() {
        let usb = parse_asymmetry("usb-cdc=-12us").unwrap();
        assert_eq!((usb.type_name.as_str(), usb.steps), ("usb-cdc", -3_072));
        assert!(parse_asymmetry("usb-cdc").is_err() && parse_asymmetry("usb-cdc=12").is_err());
    }
}

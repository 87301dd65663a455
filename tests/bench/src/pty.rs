//! How well a workstation agrees with another clock over a real pseudo-terminal: the links, threads and kernel are those that a device meets.
//!
//! A second process of this program is the root. Its counter is the kernel's monotonic clock with an offset and a skew of its own, so that the
//! truth about it is known here to the nanosecond; all else is as with a device: a terminal's queue, four threads, the scheduler. Measured is
//! this process's system time less that counter, both at one reading of the kernel's clock, in the midst of the node's own thread's turns.
//! Idle, and beside as many processes that only burn time as there are cores; then both once more with the calibration constant that the first
//! case gives: bytes into a terminal's other end pass a queue of the kernel that those out of it do not.

mod child;
mod figures;

pub(crate) use child::{Role, run as child};

use child::{Burners, Child};
use figures::{Case, Sample};
use fixed_math::time::{LocalTicks, Span};
use osap::core::HostCore;
use osap::link::{LinkOptions, LinkSpec};
use osap::map::RouteText;
use osap::network::{Network, RealNetwork};
use osap::session::{OpenOptions, Session};
use osap_protocol::discovery::{Name, TimeAsymmetry};
use osap_runtime::SystemTime;
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};

/// Between two looks at the error.
const LOOK_EVERY: Duration = Duration::from_millis(2);
/// Readings of which the closest pair counts.
const PAIRING_TRIES: u32 = 1_000;

/// What goes wrong around a measurement, with what to do.
pub(crate) type Fault = String;

/// How to measure.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Options {
    /// Of each case.
    pub(crate) seconds: u64,
    /// Of the root's counter, parts per 10⁹.
    pub(crate) skew_ppb: i32,
    /// As a document instead of a table.
    pub(crate) json: bool,
}

/// A counter against the kernel's monotonic clock, at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pairing {
    /// What the counter showed, 1/256 µs.
    pub(crate) steps: u64,
    /// What the kernel's clock showed, ns.
    pub(crate) kernel_ns: i64,
    /// Either is no further off than this, ns.
    pub(crate) within_ns: i64,
}

impl Pairing {
    /// The closest of many readings, each of the counter between two of the kernel's clock.
    pub(crate) fn of(mut counter: impl FnMut() -> LocalTicks) -> Result<Self, Fault> {
        let mut best: Option<Self> = None;
        for _ in 0..PAIRING_TRIES {
            let before = kernel_ns()?;
            let steps = counter().steps();
            let after = kernel_ns()?;
            let within_ns = after - before;
            if best.is_none_or(|best| within_ns < best.within_ns) {
                best = Some(Self { steps, kernel_ns: i64::midpoint(before, after), within_ns });
            }
        }
        best.ok_or_else(|| "the kernel's clock gave no reading".to_owned())
    }
}

/// The clock that all processes of this computer share.
fn kernel_ns() -> Result<i64, Fault> {
    let clock = nix::time::ClockId::CLOCK_MONOTONIC;
    let now = nix::time::clock_gettime(clock).map_err(|error| format!("no monotonic clock: {error}"))?;
    Ok(now.tv_sec() * 1_000_000_000 + now.tv_nsec())
}

/// Measures idle and under load, and prints it.
pub(crate) fn run(options: Options) {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let mut cases: Vec<Case> = Vec::new();
    for (name, burners, is_calibrated) in [
        ("idle", 0, false),
        ("CPU load", cores, false),
        ("idle, calibrated", 0, true),
        ("CPU load, calibrated", cores, true),
    ] {
        // what the first case was off in the mean is half of what one way is longer than the other
        let asymmetry_us = if is_calibrated { cases.first().map_or(0.0, |first| 2.0 * first.mean_us) } else { 0.0 };
        match measure(options, burners, asymmetry_us) {
            Ok(samples) => cases.push(Case::of(name, burners, asymmetry_us, &samples)),
            Err(fault) => println!("NOT RUN: {name}: {fault}"),
        }
    }
    figures::print(options, cores, &cases);
}

fn measure(options: Options, burners: usize, asymmetry_us: f64) -> Result<Vec<Sample>, Fault> {
    let _burners = Burners::start(burners)?;
    let child = Child::start(options.skew_ppb)?;
    let spec = format!("serial:{}", child.device).parse::<LinkSpec>().map_err(|error| error.to_string())?;
    let open = OpenOptions { link: LinkOptions::default(), ..OpenOptions::default() };
    let started = Instant::now();
    let network = RealNetwork::open(&[spec], &open).map_err(|error| error.to_string())?;
    let ours = Pairing::of(|| network.now())?;
    let mut session = Session::over(network);
    if asymmetry_us != 0.0 {
        calibrate(&mut session, asymmetry_us)?;
    }
    let network = session.network();
    let mut samples = Vec::new();
    let end = Duration::from_secs(options.seconds);
    while started.elapsed() < end {
        network.pause(Span::from_us(u64::try_from(LOOK_EVERY.as_micros()).unwrap_or(u64::MAX))).map_err(stopped)?;
        let (at, time) = look(network)?;
        let truth = child.truth_steps(ours, at);
        #[expect(clippy::cast_precision_loss, reason = "errors of far less than 2^52 steps, for people")]
        let us = |steps: i64| steps as f64 / 256.0;
        samples.push(Sample {
            at_s: started.elapsed().as_secs_f64(),
            error_us: us(i64::try_from(i128::from(time.at.steps()) - truth).unwrap_or(i64::MAX)),
            bound_us: time.bound.map(|bound| us(i64::try_from(bound.steps()).unwrap_or(i64::MAX))),
        });
    }
    Ok(samples)
}

/// Tells the host's own node how unequal its links' ways are, `[TIM-13]`.
fn calibrate(session: &mut Session, asymmetry_us: f64) -> Result<(), Fault> {
    #[expect(clippy::cast_possible_truncation, reason = "a cast saturates, and no way is that long")]
    let asymmetry_steps = (asymmetry_us * 256.0) as i32;
    let type_name = Name::try_from("serial").map_err(|_| "a name is too long".to_owned())?;
    let host = session.destination(&RouteText::host());
    let set = session.set_time_asymmetry(&host, &TimeAsymmetry { type_name, asymmetry_steps });
    set.map(|_| ()).map_err(|error| error.to_string())
}

/// The node's clock and its system time in one turn of its own thread, as a program on the node would read them.
fn look(network: &mut dyn Network) -> Result<(LocalTicks, SystemTime), Fault> {
    let (told, seen) = sync_channel(1);
    let task = move |core: &mut HostCore, now: LocalTicks| told.try_send((now, core.system_time(now))).is_ok();
    network.drive(LocalTicks::ZERO, Box::new(task)).map_err(stopped)?;
    seen.try_recv().map_err(|_| "the host's node did not look at its clock".to_owned())
}

fn stopped(error: impl std::fmt::Display) -> Fault {
    format!("the host's node stopped: {error}")
}

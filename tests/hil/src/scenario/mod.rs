//! What `cargo xtask hil NAME` shows, a file each.
//!
//! - **Walk:** [`Scenario::run`] → the scenario's file → a [`Report`].
//! - **Invariants:** a scenario ends the processes it started; one seed gives one run, where virtual time is used.

mod clock;
mod cycles;
mod evaluations;
mod motion;
mod motion_m7;
mod preemption;
mod preemption_m7;
mod round_trip;
mod rta;
mod scan;
mod settings;
mod soak;
mod usb;

use crate::images::Places;
use crate::report::{Failure, Report};
use clap::Subcommand;
use std::path::PathBuf;

/// What scenarios are given.
#[derive(Clone, Debug)]
pub struct Context {
    /// Where things are.
    pub places: Places,
    /// Where random numbers begin.
    pub seed: u64,
    /// The serial port of a real Pico that takes the emulated one's place.
    pub board: Option<PathBuf>,
}

/// What can be shown.
#[derive(Clone, Debug, Subcommand)]
pub enum Scenario {
    /// Scans of an emulated Cortex-M7 hub, a Cortex-M7 device and an RP2040, in every order of start, with restarts
    Scan,
    /// The same network left running, for `osap` in another terminal
    Up {
        /// TCP port it listens at; 0 for any that is free
        #[arg(long, default_value_t = 4100)]
        port: u16,
        /// Ends after so many seconds
        #[arg(long = "for", value_name = "SECONDS")]
        seconds: Option<u64>,
    },
    /// Round trips of the 76-byte answer through a Pico hub to a Pico and to one alone, in virtual time: wire and processing apart
    RoundTrip {
        /// Questions to each
        #[arg(long, default_value_t = 250)]
        count: u32,
        /// Fails where a device takes longer in the median, µs
        #[arg(long)]
        goal: Option<f64>,
    },
    /// Full load through a Pico hub both ways, with byte errors on both links: nothing delivered wrong, every loss accounted for
    Soak {
        /// Virtual milliseconds
        #[arg(long, default_value_t = 60_000)]
        ms: u64,
        /// Part of the bytes in which a bit is turned over
        #[arg(long, default_value_t = 1e-5)]
        errors: f64,
    },
    /// A user port that spins 50 ms, and the hub still forwards: latencies with and without
    Preemption,
    /// System time of a root and two devices behind it against the truth, idle and under full load
    Clock {
        /// Virtual milliseconds after the last power-on
        #[arg(long, default_value_t = 10_000)]
        ms: u64,
    },
    /// Tracks on two Pico motors: every step edge against the spline and the truth of time, halts, faults, signals, readings, a servo, cycles
    Motion,
    /// Cycles of what a beat calls on a Cortex-M0+, and the share of the processor that one and three axes take at 15.625 and 100 kHz
    Evaluations,
    /// Worst cycles of each task of the Pico image, measured under several loads
    Cycles,
    /// Response times from the task table of each image, against the deadlines
    Rta,
    /// A name kept over power-off and reset, what a write delays, and reports of a fault and a hang
    Settings,
    /// Enumeration and a scan over the Pico's USB
    Usb,
    /// Tracks on an emulated Cortex-M7, sent over the network: its history against the exact splines, and the steps that it put out
    MotionM7,
}

impl Scenario {
    /// Those that `all` runs, with what they are given there.
    #[must_use]
    pub fn all() -> Vec<Self> {
        vec![
            Self::Scan,
            Self::RoundTrip { count: 250, goal: None },
            Self::Soak { ms: 2_000, errors: 1e-5 },
            Self::Preemption,
            Self::Clock { ms: 4_000 },
            Self::Motion,
            Self::Evaluations,
            Self::Cycles,
            Self::Rta,
            Self::Settings,
            Self::Usb,
            Self::MotionM7,
        ]
    }

    /// As it is called on the command line.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Scan => "scan",
            Self::Up { .. } => "up",
            Self::RoundTrip { .. } => "round-trip",
            Self::Soak { .. } => "soak",
            Self::Preemption => "preemption",
            Self::Clock { .. } => "clock",
            Self::Motion => "motion",
            Self::Evaluations => "evaluations",
            Self::Cycles => "cycles",
            Self::Rta => "rta",
            Self::Settings => "settings",
            Self::Usb => "usb",
            Self::MotionM7 => "motion-m7",
        }
    }

    /// Runs it.
    ///
    /// # Errors
    /// [`Failure`] where it ended early.
    pub fn run(&self, context: &Context) -> Result<Report, Failure> {
        match self {
            Self::Scan => scan::run(context),
            Self::Up { port, seconds } => scan::up(context, *port, *seconds),
            Self::RoundTrip { count, goal } => round_trip::run(context, *count, *goal),
            Self::Soak { ms, errors } => soak::run(context, *ms, *errors),
            Self::Preemption => preemption::run(context),
            Self::Clock { ms } => clock::run(context, *ms),
            Self::Motion => motion::run(context),
            Self::Evaluations => evaluations::run(context),
            Self::Cycles => cycles::run(context),
            Self::Rta => rta::run(context),
            Self::Settings => settings::run(context),
            Self::Usb => usb::run(context),
            Self::MotionM7 => motion_m7::run(context),
        }
    }
}

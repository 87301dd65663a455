//! What `cargo xtask hil NAME` shows, a file each.
//!
//! - **Walk:** [`Scenario::run`] → the scenario's file → a [`Report`].
//! - **Invariants:** a scenario ends the processes it started; one seed gives one run, where virtual time is used.

mod round_trip;

use crate::images::Places;
use crate::report::{Failure, Report};
use clap::Subcommand;

/// What scenarios are given.
#[derive(Clone, Debug)]
pub struct Context {
    /// Where things are.
    pub places: Places,
    /// Where random numbers begin.
    pub seed: u64,
}

/// What can be shown.
#[derive(Clone, Debug, Subcommand)]
pub enum Scenario {
    /// Round trips of the 76-byte answer through a Pico hub to a Pico and to one alone, in virtual time: wire and processing apart
    RoundTrip {
        /// Questions to each
        #[arg(long, default_value_t = 250)]
        count: u32,
    },
}

impl Scenario {
    /// Those that `all` runs, with what they are given there.
    #[must_use]
    pub fn all() -> Vec<Self> {
        vec![Self::RoundTrip { count: 250 }]
    }

    /// As it is called on the command line.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::RoundTrip { .. } => "round-trip",
        }
    }

    /// Runs it.
    ///
    /// # Errors
    /// [`Failure`] where it ended early.
    pub fn run(&self, context: &Context) -> Result<Report, Failure> {
        match self {
            Self::RoundTrip { count } => round_trip::run(context, *count),
        }
    }
}

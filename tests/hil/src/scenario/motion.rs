//! Tracks on real Pico images, co-simulated: every edge at the pins against the spline and against the truth of time.
//!
//! - **Walk:** a workstation, a hub and two motors → settled clocks → tracks sent ahead ([`play`]) → halts, faults and refusals → signals and
//!   readings → a motor that closes its loop → cycles a beat.
//! - **Invariants:** virtual time; one seed gives one run. What is expected is calculated here from the points that were sent.
//! - **Clauses:** `[MOT-03]` to `[MOT-14]`, `[MOT-20]`, `[MOT-24]`.

mod beats;
mod closed;
mod judge;
mod load;
mod play;
pub(super) mod share;
mod signals;
mod stage;
mod stops;
mod track;

use super::Context;
use crate::report::{Failure, Report};
use stage::Stage;

/// Length of a series, virtual µs.
const SERIES_US: u64 = 360_448;

pub(super) fn run(context: &Context) -> Result<Report, Failure> {
    let mut report = Report::new();
    let mut stage = Stage::start(context)?;
    report.line(format!(
        "Two Pico motors behind a Pico hub, co-simulated; crystals of -35, +50 and -50 ppm; seed {}. Clocks settled {} ms after power-on, bounds {:?} of 1/256 µs",
        context.seed,
        stage.bench.now_ns() / crate::cosim::NS_PER_MS,
        stage.bounds_steps
    ));
    if let Err(failure) = on_stage(&mut stage, &mut report) {
        report.check(false, format!("two motors: {failure}"));
    }
    drop(stage);
    for (what, part) in [("servo", closed::run as Part), ("beats", beats::run as Part)] {
        if let Err(failure) = part(context, &mut report, SERIES_US) {
            report.check(false, format!("{what}: {failure}"));
        }
    }
    Ok(report)
}

/// A part with a motor of its own.
type Part = fn(&Context, &mut Report, u64) -> Result<(), Failure>;

/// What two motors show; one part needs the one before it to have ended.
fn on_stage(stage: &mut Stage, report: &mut Report) -> Result<(), Failure> {
    play::streamed(stage, report, SERIES_US)?;
    play::loaded(stage, report, SERIES_US)?;
    let delay = stops::halted(stage, report, SERIES_US)?;
    stops::starved(stage, report, SERIES_US, delay)?;
    let delay = stops::fault(stage, report, SERIES_US, delay)?;
    stops::refusals(stage, report, delay)?;
    signals::run(stage, report, delay)
}

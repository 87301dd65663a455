//! The share of an RP2040 that playing takes: real images, one Pico alone, one and three axes, at 15.625 kHz and in steps at 125 kHz.
//!
//! - **Walk:** points of all axes, sent ahead → the profile is begun anew when the first is due → the interrupt's own cycles up to the end.
//! - **Invariants:** entry and return of the interrupt are in its cycles, what it delays is not. Of the fast image a call is a slice of a beat,
//!   and at another rate it takes the same cycles: its share at 100 kHz is calculated from them. Virtual time, code in RAM.

use super::super::Context;
use super::play::{BEAT_IRQ, all_series, arm, end_of, first_after, intervals, mean};
use super::stage::Stage;
use super::track::Series;
use crate::images::Image;
use crate::pico::CORE_HZ;
use crate::report::{Failure, Report, real, table};
use fixed_math::time::Span;
use osap_protocol::motion::{POINTS_MAX, Points};
use serde_json::json;

/// Length of a series, virtual µs.
const SERIES_US: u64 = 360_448;
/// Goal: three axes at 100 kHz take less, %. `cargo xtask motion` tells whether it is met.
const SHARE_GOAL: f64 = 25.0;
/// What must not be lost again: 49.2 % were reached, and a twentieth.
const SHARE_MAX: f64 = 51.7;
/// Where the goal is.
const GOAL_HZ: f64 = 100_000.0;
/// Images and their interrupt's rate, Hz.
const IMAGES: [(Image, f64); 2] = [(Image::Rp2040Pico, 15_625.0), (Image::Rp2040PicoFast, 125_000.0)];

/// Of one image with so many axes.
struct Share {
    image: &'static str,
    cycles_mean: f64,
    cycles_max: u64,
    /// Steps of all axes a second.
    steps_hz: f64,
}

impl Share {
    /// At a rate, %.
    fn at(&self, rate_hz: f64) -> f64 {
        100.0 * self.cycles_mean * rate_hz / real(CORE_HZ)
    }
}

/// Measures all.
pub(in crate::scenario) fn run(context: &Context, report: &mut Report) -> Result<(), Failure> {
    let mut rows = Vec::new();
    let mut data = Vec::new();
    for (image, rate_hz) in IMAGES {
        for axes in [1, 3] {
            let share = measure(context, image, axes)?;
            let is_fast = rate_hz > GOAL_HZ;
            let at_goal = if is_fast { format!("{:.1}", share.at(GOAL_HZ)) } else { "-".to_owned() };
            let Share { image, cycles_mean, cycles_max, steps_hz, .. } = share;
            rows.push(vec![
                image.to_owned(),
                axes.to_string(),
                format!("{:.3}", rate_hz / 1e3),
                format!("{cycles_mean:.0}"),
                cycles_max.to_string(),
                format!("{:.1}", share.at(rate_hz)),
                at_goal,
                format!("{:.1}", steps_hz / 1e3),
            ]);
            let at_goal = is_fast.then(|| share.at(GOAL_HZ));
            data.push(json!({ "image": image, "axes": axes, "rate_hz": rate_hz, "cycles_mean": cycles_mean, "cycles_max": cycles_max,
                "share_percent": share.at(rate_hz), "share_at_100_khz_percent": at_goal, "steps_hz": steps_hz }));
            if is_fast && axes == 3 {
                let percent = share.at(GOAL_HZ);
                report.check(
                    percent < SHARE_MAX,
                    format!("{axes} axes at 100 kHz take {percent:.1} % of the processor, of {SHARE_MAX} (the goal is {SHARE_GOAL})"),
                );
            }
        }
    }
    report.line("Own cycles of the interpolating interrupt while tracks are played, of a Pico at 125 MHz");
    let head = ["image", "axes", "kHz", "mean", "worst", "share %", "at 100 kHz %", "steps 1000/s"];
    report.line(table(&head, &rows));
    report.datum("share", data.into());
    Ok(())
}

/// Sends all points of an axis, message by message.
fn send(stage: &mut Stage, axis: u8, series: &Series) -> Result<(), Failure> {
    for (number, positions) in series.points.chunks(POINTS_MAX).enumerate() {
        let index = (number * POINTS_MAX + 1) as u64;
        let time = series.start + Span::from_steps(index * u64::from(series.interval.steps()));
        let to = stage.ports[0].clone();
        stage.bench.session.motion_points(&to, &Points { axis, time, positions })?;
    }
    Ok(())
}

fn measure(context: &Context, image: Image, axes: usize) -> Result<Share, Failure> {
    let elf = context.places.image(image)?;
    let mut stage = Stage::alone(context, &elf)?;
    let (intervals, at) = (&intervals([12; 4])[..axes], &[0; 4][..axes]);
    arm(&mut stage, 0, intervals, at)?;
    let first = first_after(&stage, super::play::LEAD, Span::ZERO);
    let series = all_series(intervals, at, first, SERIES_US);
    for (axis, series) in (0..).zip(&series) {
        send(&mut stage, axis, series)?;
    }
    stage.run_until(first)?;
    stage.edges()?;
    for steps in &mut stage.pins[0].steps {
        steps.clear();
    }
    drop(stage.profile(0)?);
    let until = first.shifted(i64::try_from(SERIES_US << 8).unwrap_or(0)).min(end_of(&series));
    stage.run_until(until)?;
    let profile = stage.profile(0)?;
    stage.edges()?;
    let steps: usize = stage.pins[0].steps.iter().map(Vec::len).sum();
    let irq = profile.irq(BEAT_IRQ);
    let status = stage.status(0, 0)?;
    if steps == 0 || status.fault.is_some() || status.halted.is_some() {
        return Err(Failure::Failed(format!("{}: nothing was played: {steps} steps, {status:?}", image.name())));
    }
    let seconds = real(profile.cycles) / real(CORE_HZ);
    Ok(Share {
        image: image.name(),
        cycles_mean: mean(&profile),
        cycles_max: irq.cycles_max,
        steps_hz: real(steps as u64) / seconds,
    })
}

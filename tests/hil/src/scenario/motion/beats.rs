//! What a beat takes: cycles and the share of the processor, with none, one, three and four axes that move.
//!
//! - **Walk:** a motor alone, tracks sent ahead → the co-simulation's profile over the middle of them.

use super::super::Context;
use super::play::{BEAT_IRQ, LEAD, all_series, arm, first_after, intervals, mean};
use super::stage::{Feed, Stage};
use crate::images::Image;
use crate::pico::CORE_HZ;
use crate::pins::AXES;
use crate::report::{Failure, Report, real, table};
use fixed_math::time::Span;
use osap_protocol::motion::AxisState;
use serde_json::json;

/// Axes that move.
const MOVING: [usize; 4] = [0, 1, 3, 4];
/// Beats a second.
const BEATS_HZ: f64 = 15_625.0;

pub(super) fn run(context: &Context, report: &mut Report, us: u64) -> Result<(), Failure> {
    let mut stage = Stage::alone(context, &context.places.image(Image::Rp2040Pico)?)?;
    let mut rows = Vec::new();
    for axes in MOVING {
        let at = [0; AXES];
        arm(&mut stage, 0, &intervals([12; AXES])[..axes], &at[..axes])?;
        let first = first_after(&stage, LEAD, Span::ZERO);
        let series = all_series(&intervals([12; AXES])[..axes], &at[..axes], first, us);
        let all: Vec<_> = (0..).zip(&series).map(|(axis, series)| (0, axis, series)).collect();
        let begin = first + Span::from_us(us / 10);
        Feed::new(&all, 32, Span::from_us(2_000_000), false, Span::ZERO).play(&mut stage, &all, begin)?;
        stage.profile(0)?;
        stage.run_until(first + Span::from_us(us * 9 / 10))?;
        let profile = stage.profile(0)?;
        let (mean, worst) = (mean(&profile), profile.irq(BEAT_IRQ).cycles_max);
        let share = |cycles: f64| 100.0 * cycles * BEATS_HZ / real(CORE_HZ);
        rows.push(vec![axes.to_string(), format!("{mean:.0}"), worst.to_string(), format!("{:.1}", share(mean))]);
        report.datum(
            &format!("beat with {axes} axes"),
            json!({ "cycles_mean": mean, "cycles_max": worst, "share_percent": share(mean) }),
        );
        report.check(
            share(real(worst)) <= 100.0,
            format!("a beat with {axes} axes that move is over before the next: {worst} cycles at most"),
        );
        stage.run_until(first + Span::from_us(us + 60_000))?;
        for axis in 0..u8::try_from(axes).unwrap_or(u8::MAX) {
            let status = stage.status(0, axis)?;
            report.check(
                status.position == 0 && status.halted.is_none() && status.state == AxisState::Starved,
                format!(
                    "{axes} axes: axis {axis} is back at rest: {:?} at {}, halted {:?}",
                    status.state, status.position, status.halted
                ),
            );
        }
    }
    report
        .line("Cycles of a beat on a Cortex-M0+ by axes that move, and their share of the processor at 15.625 kHz, %");
    report.line(table(&["axes", "mean", "worst", "share"], &rows));
    Ok(())
}

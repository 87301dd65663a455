//! A motor that closes its loop: the image whose first axis is driven by the currents of two coils, with a simulated encoder.
//!
//! - **Walk:** a track → the servo at every beat → compare values of the PWM; the encoder's readings against the track.
//! - **What is real:** the loop, its rate and the pins' PWM. **What is not:** motor and encoder, which the image simulates.

use super::super::Context;
use super::play::{LEAD, first_after};
use super::stage::{Feed, Stage};
use super::track::{Series, Shape, limits, settings, shape};
use crate::images::Image;
use crate::report::{Failure, Report};
use firmware_app::servo::{COUNT_LOG2, TURN_LOG2};
use fixed_math::phase::{Coils, PhaseWindow};
use fixed_math::spline::IntervalLog2;
use fixed_math::time::Span;
use osap_protocol::motion::{MotionRequest, TriggerSettings};

/// Beats from one reading of the encoder to the next.
const BEATS: u32 = 8;
/// The way: 22 LSB a beat at its fastest.
const WAY: Shape = Shape { reach: 20_000.0, turns: 1.0 };
/// Times at which the coils are looked at.
const LOOKS: u64 = 60;
/// Slices of the coils' PWM, and its period, cycles.
const COILS: [usize; 2] = [1, 5];
const PERIOD: f64 = 4_000.0;

pub(super) fn run(context: &Context, report: &mut Report, us: u64) -> Result<(), Failure> {
    let elf = match context.places.image(Image::Rp2040PicoServo) {
        Ok(elf) => elf,
        Err(missing) => {
            report.not_run("a motor that closes its loop", missing.to_string());
            return Ok(());
        }
    };
    let mut stage = Stage::alone(context, &elf)?;
    let interval = IntervalLog2::new(12).ok_or_else(|| Failure::Failed("no interval".to_owned()))?;
    let step_log2 = u8::try_from(TURN_LOG2).unwrap_or(u8::MAX);
    let settings = osap_protocol::motion::AxisSettings { step_log2, ..settings(interval) };
    stage.ask(0, &MotionRequest::Configure { axis: 0, settings })?;
    stage.ask(0, &MotionRequest::Arm { axis: 0, position: 0 })?;
    let first = first_after(&stage, LEAD, Span::ZERO);
    let series = Series::new(interval, first, 0, shape(WAY, 0, interval, us), *limits(&settings).brake());
    let all = [(0, 0, &series)];
    Feed::new(&all, 32, Span::from_us(2_000_000), false, Span::ZERO).play(
        &mut stage,
        &all,
        first.shifted(-(20_000 << 8)),
    )?;
    let every = TriggerSettings::Interval { beats: BEATS };
    stage.tell(0, &MotionRequest::SetTrigger { trigger: 0, channel: 0, settings: every })?;
    let (mut across, mut largest) = (0.0_f64, 0.0_f64);
    for look in 1..=LOOKS {
        let at = first + Span::from_us(look * us / (LOOKS + 1));
        stage.run_until(at)?;
        let position = series.exact(stage.now());
        let (size, along) = coils(&mut stage, position)?;
        across = across.max(along.abs());
        largest = largest.max(size);
    }
    stage.run_until(series.end_time())?;
    let end = stage.now();
    report.check(
        across <= 2.0 && largest >= 20.0,
        format!("servo: the coils' field is a quarter turn from the rotor at {LOOKS} looks: of {largest:.0} cycles of current at most, of {PERIOD:.0}, {across:.2} lie along it, of 2 that rounding makes"),
    );
    let from = first + Span::from_us(us / 10);
    let errors: Vec<f64> = stage
        .readings
        .iter()
        .filter(|reading| reading.channel == 0 && (from..end).contains(&reading.time))
        .map(|reading| (f64::from(reading.value) - series.exact(reading.time)).abs())
        .collect();
    let error = errors.iter().copied().fold(0.0, f64::max);
    let bound = f64::from(2_u32 << COUNT_LOG2);
    report.check(
        errors.len() as u64 > us / 1_000 && error <= bound,
        format!(
            "servo: {} readings of the encoder are {error:.1} LSB from the track at most, of {bound}",
            errors.len()
        ),
    );
    let status = stage.status(0, 0)?;
    report.check(
        status.halted.is_none() && stage.refused.is_empty(),
        format!("servo: nothing halted it, nothing was refused: {:?}, {:?}", status.halted, stage.refused),
    );
    let profile = stage.profile(0)?;
    report.line(format!(
        "servo: a beat takes {:.0} cycles in the mean, {} at most",
        super::play::mean(&profile),
        profile.irq(super::play::BEAT_IRQ).cycles_max
    ));
    Ok(())
}

/// Current of both coils together, cycles of the PWM's period, and what of it lies along a rotor at `position`.
fn coils(stage: &mut Stage, position: f64) -> Result<(f64, f64), Failure> {
    let slices = stage.bench.cosim.borrow_mut().pwm(stage.names[0])?;
    let current = |slice: usize| slices.get(slice).map_or(f64::NAN, |it| f64::from(it.now.a) - f64::from(it.now.b));
    let [a, b] = COILS.map(current);
    let window = PhaseWindow::new(TURN_LOG2, 0).map_err(|_| Failure::Failed("no such turn".to_owned()))?;
    #[expect(clippy::cast_possible_truncation, reason = "within 2^20")]
    let rotor = Coils::at(window.phase(position.round() as i32), u16::MAX);
    let (cosine, sine) = (f64::from(rotor.a) / 32_768.0, f64::from(rotor.b) / 32_768.0);
    Ok((a.hypot(b), a * cosine + b * sine))
}

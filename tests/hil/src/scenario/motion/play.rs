//! The same tracks on two motors: every edge against the spline, against the beat, and against the other motor's; idle and under load.

use super::judge::{BEAT_US, Followed, StepEdge, follow, quantiles};
use super::load::Load;
use super::stage::{Feed, MOTORS, Stage};
use super::track::{Series, Shape, limits, settings, shape};
use crate::cosim::Profile;
use crate::pico::cycles_us;
use crate::pins::AXES;
use crate::report::{Failure, Report, real, table};
use fixed_math::spline::IntervalLog2;
use fixed_math::time::{NetTime, Span};
use osap_protocol::motion::{AxisState, MotionReply, MotionRequest};
use osap_protocol::{DropCause, PortIndex};
use osap_runtime::sequenced::Destination;
use serde_json::json;

/// Interrupt of interpolation.
pub(super) const BEAT_IRQ: u32 = 4;
/// Goal: an edge is no farther from its place, µs.
const JITTER_US_MAX: f64 = 1.0;
/// Series that are sent ahead begin so long after they were asked for: they end before half a second without a fresh point halts all motion.
pub(super) const LEAD: Span = Span::from_us(70_000);
/// Series that are sent as they go.
const STREAM_LEAD: Span = Span::from_us(120_000);
/// A series' first point is a multiple of all intervals.
const GRID_US: u64 = 1 << 14;

/// One way for each axis, LSB; the fastest makes 10,000 steps a second.
pub(super) const SHAPES: [Shape; AXES] = [
    Shape { reach: 80_000.0, turns: 2.0 },
    Shape { reach: -60_000.0, turns: 1.0 },
    Shape { reach: 25_000.0, turns: 3.0 },
    Shape { reach: -40_000.0, turns: 2.0 },
];

/// Intervals of axes.
pub(super) fn intervals(log2: [u32; AXES]) -> [IntervalLog2; AXES] {
    log2.map(|log2| IntervalLog2::new(log2).expect("an interval"))
}

/// Configures and arms axes of a motor where they are.
pub(super) fn arm(stage: &mut Stage, motor: usize, intervals: &[IntervalLog2], at: &[i32]) -> Result<(), Failure> {
    for (axis, (interval, position)) in (0..).zip(intervals.iter().zip(at)) {
        stage.ask(motor, &MotionRequest::Configure { axis, settings: settings(*interval) })?;
        stage.ask(motor, &MotionRequest::Arm { axis, position: *position })?;
    }
    Ok(())
}

/// The first time on everybody's grid that is `lead` from now, track time.
pub(super) fn first_after(stage: &Stage, lead: Span, delay: Span) -> NetTime {
    let from = (stage.now() + lead).shifted(-delay.steps().cast_signed());
    NetTime::from_us((from.as_us() / GRID_US + 1) * GRID_US)
}

/// The shapes of all axes from `first` on.
pub(super) fn all_series(intervals: &[IntervalLog2], at: &[i32], first: NetTime, us: u64) -> Vec<Series> {
    let one = |((interval, rest), way): ((&IntervalLog2, &i32), Shape)| {
        let brake = *limits(&settings(*interval)).brake();
        Series::new(*interval, first, *rest, shape(way, *rest, *interval, us), brake)
    };
    intervals.iter().zip(at).zip(SHAPES).map(one).collect()
}

/// Each series for each motor.
pub(super) fn both(series: &[Series]) -> Vec<(usize, u8, &Series)> {
    (0..MOTORS).flat_map(|motor| (0..).zip(series).map(move |(axis, series)| (motor, axis, series))).collect()
}

/// When all have come to rest, and a little.
pub(super) fn end_of(series: &[Series]) -> NetTime {
    series.iter().map(Series::end_time).max().unwrap_or(NetTime::ZERO) + Span::from_us(10_000)
}

/// What two motors did that were to play the same.
pub(super) struct Seen {
    /// Of each motor, each axis.
    pub(super) steps: Vec<[Vec<StepEdge>; AXES]>,
    pub(super) profiles: Vec<Profile>,
}

/// Collects edges and profiles.
pub(super) fn seen(stage: &mut Stage) -> Result<Seen, Failure> {
    stage.edges()?;
    let steps = stage.pins.iter_mut().map(super::judge::Pins::drain).collect();
    let profiles = (0..stage.names.len()).map(|motor| stage.profile(motor)).collect::<Result<_, _>>()?;
    Ok(Seen { steps, profiles })
}

/// Compares all axes of all motors with their series.
pub(super) fn compare(
    report: &mut Report,
    what: &str,
    series: [&[Series]; MOTORS],
    seen: &Seen,
    beats: (NetTime, NetTime),
    track: impl Fn(NetTime) -> NetTime,
) {
    let beats = (beats.0.as_us() / BEAT_US, beats.1.as_us() / BEAT_US);
    let mut all = Vec::new();
    for (motor, (series, steps)) in series.iter().zip(&seen.steps).enumerate() {
        for (axis, (series, steps)) in series.iter().zip(steps).enumerate() {
            let followed = follow(series, steps, beats, &track);
            if !followed.is_exact() {
                let Followed { moved, expected, unlike, error_lsb, .. } = &followed;
                let unlike = unlike.as_deref().unwrap_or("every step in its beat");
                report.check(
                    false,
                    format!("{what}: motor {motor}, axis {axis}: {unlike}; moved {moved} steps of {expected}, off by {error_lsb:.2} LSB"),
                );
            }
            all.push(followed);
        }
    }
    let steps: usize = all.iter().map(|it| it.steps).sum();
    let error = all.iter().map(|it| it.error_lsb).fold(0.0, f64::max);
    report.check(
        steps > 0 && all.iter().all(Followed::is_exact),
        format!("{what}: {steps} steps of {} axes, each in the beat that the device's arithmetic says; the exact spline is {error:.2} LSB outside of the motor's step at most, of 1", all.len()),
    );
}

/// How far edges are from their beats, from the interrupt, and from the other motor's; µs.
pub(super) fn jitter(report: &mut Report, what: &str, stage: &Stage, seen: &Seen) {
    let mut rows = Vec::new();
    let text = |figures: [f64; 3]| figures.map(|us| format!("{us:.3}"));
    for (name, (steps, profile)) in stage.names.iter().zip(seen.steps.iter().zip(&seen.profiles)) {
        let late: Vec<f64> = steps.iter().flatten().map(|step| step.late_ns / 1_000.0).collect();
        let least = late.iter().copied().fold(f64::INFINITY, f64::min);
        let [median, p99, max] = quantiles(late);
        let [entry_median, entry_p99, entry_max] = entry(profile);
        let row = [least, median, p99, max, entry_median, entry_p99, entry_max];
        rows.push([(*name).to_owned()].into_iter().chain(row.map(|us| format!("{us:.3}"))).collect());
        report.check(
            entry_max <= JITTER_US_MAX,
            format!("{what}: {name}: an edge is {entry_max:.3} µs later at most than one that nothing delays, of {JITTER_US_MAX}"),
        );
        report.datum(
            &format!("{what} {name}"),
            json!({ "late_us": { "least": least, "median": median, "p99": p99, "max": max },
                "entry_us": { "median": entry_median, "p99": entry_p99, "max": entry_max },
                "cycles_mean": mean(profile), "cycles_max": profile.irq(BEAT_IRQ).cycles_max }),
        );
    }
    report.line(format!(
        "{what}: step edges after their beat of system time, and what delays the interrupt beyond its least, µs"
    ));
    let head = ["motor", "least", "median", "p99", "max", "entry median", "p99", "max"];
    report.line(table(&head, &rows));
    let [one, two] = &seen.steps[..] else { return };
    let pairs = one.iter().flatten().zip(two.iter().flatten());
    let apart = quantiles(pairs.map(|(one, two)| (one.global_ns - two.global_ns).abs() / 1_000.0).collect());
    let [median, p99, max] = text(apart);
    let bound = stage.bounds_steps.iter().map(|steps| f64::from(*steps) / 256.0).sum::<f64>() + 2.0 * JITTER_US_MAX;
    report.check(
        apart[2] <= bound,
        format!("{what}: the same step of two motors is {max} µs apart at most (median {median}, p99 {p99}): their clocks' bounds and both jitters are {bound:.2}"),
    );
    report.datum(&format!("{what} apart_us"), json!({ "median": apart[0], "p99": apart[1], "max": apart[2] }));
}

/// Delays of the beat's interrupt beyond the least that there was: median, 99th percentile, most; µs.
fn entry(profile: &Profile) -> [f64; 3] {
    let irq = profile.irq(BEAT_IRQ);
    let least = irq.latencies.first().map_or(0, |(cycles, _)| *cycles);
    let count: u64 = irq.latencies.iter().map(|(_, count)| count).sum();
    let at = |part: u64| {
        let mut left = (count * part).div_ceil(100);
        let found = irq.latencies.iter().find(|(_, count)| {
            let is_there = left <= *count;
            left = left.saturating_sub(*count);
            is_there
        });
        found.map_or(0, |(cycles, _)| cycles - least)
    };
    [at(50), at(99), irq.latency_cycles_max.saturating_sub(least)].map(cycles_us)
}

/// Mean cycles of a beat.
pub(super) fn mean(profile: &Profile) -> f64 {
    let irq = profile.irq(BEAT_IRQ);
    real(irq.cycles_total) / real(irq.count.max(1))
}

/// Four axes at two intervals, streamed by requests and datagrams.
pub(super) fn streamed(stage: &mut Stage, report: &mut Report, us: u64) -> Result<(), Failure> {
    for motor in 0..MOTORS {
        match stage.ask(motor, &MotionRequest::Describe)? {
            MotionReply::Described { axes: 4, beat_us: 64, .. } => {}
            other => report.check(false, format!("a motor describes itself as {other:?}")),
        }
        arm(stage, motor, &intervals([12, 12, 10, 10]), &[0; AXES])?;
    }
    let first = first_after(stage, STREAM_LEAD, Span::ZERO);
    let series = all_series(&intervals([12, 12, 10, 10]), &[0; AXES], first, us);
    drop(seen(stage)?);
    let began = stage.now();
    let until = end_of(&series);
    Feed::new(&both(&series), 20, Span::from_us(90_000), true, Span::ZERO).play(stage, &both(&series), until)?;
    let seen = seen(stage)?;
    compare(report, "streamed", [&series; MOTORS], &seen, (began, until), |system| system);
    jitter(report, "streamed", stage, &seen);
    let points = 2 * series.iter().map(|series| series.points.len()).sum::<usize>();
    report.check(
        stage.taken as usize == points && stage.refused.is_empty(),
        format!("streamed: {} of {points} points taken, refused {:?}", stage.taken, stage.refused),
    );
    for motor in 0..MOTORS {
        for axis in 0..4 {
            let status = stage.status(motor, axis)?;
            report.check(
                status.state == AxisState::Starved
                    && status.steps_late == 0
                    && status.fault.is_none()
                    && status.position == 0,
                format!(
                    "streamed: motor {motor}, axis {axis} ends at rest for want of points, no step late: {status:?}"
                ),
            );
        }
        let pins = &stage.pins[motor];
        let first_ns = seen.steps[motor]
            .iter()
            .flatten()
            .map(|step| real(step.beat * BEAT_US) * 1e3)
            .fold(f64::INFINITY, f64::min);
        let enabled = pins.enables().first().is_some_and(|(is_on, at)| *is_on && *at < first_ns);
        report.check(enabled, format!("motor {motor}: its drivers are on before the first step"));
        report.check(
            pins.set_up_ns_min >= 60_000.0,
            format!(
                "motor {motor}: a direction is set {:.1} µs before its first step, a pulse lasts {:.1} µs at least",
                pins.set_up_ns_min / 1e3,
                pins.pulse_ns_min / 1e3
            ),
        );
    }
    Ok(())
}

/// Four axes, sent ahead, with both wires full both ways and user code that never ends.
pub(super) fn loaded(stage: &mut Stage, report: &mut Report, us: u64) -> Result<Seen, Failure> {
    let four = intervals([12; AXES]);
    for motor in 0..MOTORS {
        arm(stage, motor, &four, &[0; AXES])?;
    }
    let first = first_after(stage, LEAD, Span::ZERO);
    let series = all_series(&four, &[0; AXES], first, us);
    let until = end_of(&series);
    let began = stage.now();
    Feed::new(&both(&series), 32, Span::from_us(2_000_000), false, Span::ZERO).play(
        stage,
        &both(&series),
        first.shifted(-(20_000 << 8)),
    )?;
    drop(seen(stage)?);
    let ms = u32::try_from(us / 1_000 + 80).unwrap_or(u32::MAX);
    Load::start(stage, ms)?.run_until(stage, until)?;
    let seen = seen(stage)?;
    compare(report, "loaded", [&series; MOTORS], &seen, (began, until), |system| system);
    jitter(report, "loaded", stage, &seen);
    for (name, profile) in stage.names.iter().zip(&seen.profiles) {
        let busy = 100.0 - 100.0 * real(profile.sleep_cycles) / real(profile.cycles.max(1));
        report.check(busy >= 99.0, format!("loaded: {name} is busy for {busy:.0} % of the time"));
        let tasks = crate::scenario::cycles::TASKS.map(|(task, irq)| {
            let irq = profile.irq(irq);
            let share = 100.0 * real(irq.cycles_total) / real(profile.cycles.max(1));
            format!("{task} {} cycles at most, {share:.0} %", irq.cycles_max)
        });
        report.line(format!("loaded, {name}: {}", tasks.join("; ")));
        let overruns: u64 = profile.uarts.iter().map(|uart| uart.overruns).sum();
        report.check(overruns == 0, format!("loaded: {name}: its UARTs lost {overruns} bytes"));
    }
    overruns(stage, report)?;
    Ok(seen)
}

/// Bytes that were not taken out of their ring in time, as the motors count them.
fn overruns(stage: &mut Stage, report: &mut Report) -> Result<(), Failure> {
    for (motor, name) in stage.names.clone().into_iter().enumerate() {
        let chip = Destination { port: PortIndex::NETRESPONDER, ..stage.ports[motor].clone() };
        let counters = stage.bench.session.counters(&chip)?;
        let lost: u64 = counters
            .iter()
            .filter(|counter| counter.cause == Some(DropCause::RxOverrun))
            .map(|counter| u64::from(counter.value))
            .sum();
        report.check(lost == 0, format!("loaded: {name} drained its rings in time: {lost} were lapped"));
    }
    Ok(())
}

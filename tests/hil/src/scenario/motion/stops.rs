//! What ends motion: a halt along the path and its resume, points that do not come, a point that breaks a limit.
//!
//! - **Walk:** tracks sent ahead → the event → edges against the spline at the warped time → the same end as without.
//! - **Invariants:** of a halt only its epoch is known, from the reply; of one that a device makes by itself it is found: the one multiple of
//!   64 µs by which all edges of all motors are in their beats. **Clauses:** `[MOT-06]`, `[MOT-07]`, `[MOT-20]`, `[MOT-24]`.

use super::judge::{BEAT_US, follow};
use super::play::{LEAD, all_series, arm, both, compare, end_of, first_after, intervals, seen};
use super::stage::{Feed, MOTORS, Stage};
use super::track::{MISSING_MAX, Series, limits, settings, warp};
use crate::pins::AXES;
use crate::report::{Failure, Report};
use fixed_math::time::{NetTime, Span};
use osap_protocol::motion::{
    AxisState, AxisStatus, Fault, HaltReason, LimitKind, MotionRefusal, MotionReply, MotionRequest, Points,
};

/// From a series' begin to the event, and from there to the resume.
const MOVING: Span = Span::from_us(130_000);
const STANDING: Span = Span::from_us(150_000);
/// A halt is asked for so long ahead.
const HALT_LEAD_US: u32 = 30_000;
/// Points of a series that is cut off while it moves, and of one whose next point breaks a limit.
const CUT: usize = 33;
const GOOD: usize = 60;
/// How far that point jumps, LSB.
const JUMP: i32 = 100_000;

/// Track time of a stop and its resume.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stopped {
    /// What earlier stops have used up.
    before: Span,
    stop: NetTime,
    resume: Option<NetTime>,
}

impl Stopped {
    /// Track time at a system time.
    pub(super) fn track(&self, system: NetTime) -> NetTime {
        let before = self.before.steps().cast_signed();
        let stopped = |system: NetTime| self.stop + warp().stopped(system.since(self.stop));
        let track = match self.resume {
            _ if system <= self.stop => system,
            Some(resume) if system > resume => stopped(resume) + warp().resumed(system.since(resume)),
            _ => stopped(system),
        };
        track.shifted(-before)
    }
}

/// Epochs are multiples of a beat.
fn on_grid(epoch_steps: u64) -> NetTime {
    NetTime::from_us(NetTime::from_steps(epoch_steps + (BEAT_US << 8) - 1).as_us() / BEAT_US * BEAT_US)
}

/// Asks a motor for a halt; its epoch.
fn halt(stage: &mut Stage, motor: usize, resume: bool) -> Result<NetTime, Failure> {
    match stage.ask(motor, &MotionRequest::Halt { resume, lead_us: HALT_LEAD_US })? {
        MotionReply::Halted { epoch_steps, .. } => Ok(on_grid(epoch_steps)),
        other => Err(Failure::Failed(format!("a halt was answered by {other:?}"))),
    }
}

/// Arms all axes of both motors at rest and sends all points; the series.
fn ahead(stage: &mut Stage, us: u64, delay: Span) -> Result<Vec<Series>, Failure> {
    let four = intervals([12; AXES]);
    for motor in 0..MOTORS {
        arm(stage, motor, &four, &[0; AXES])?;
    }
    let series = all_series(&four, &[0; AXES], first_after(stage, LEAD, delay), us);
    drop(seen(stage)?);
    Ok(series)
}

/// One motor is asked for a halt, the other for the resume: both stop along the path, and go on. What stops have used up since.
pub(super) fn halted(stage: &mut Stage, report: &mut Report, us: u64) -> Result<Span, Failure> {
    let series = ahead(stage, us, Span::ZERO)?;
    let (began, moving) = (stage.now(), series[0].start + MOVING);
    Feed::new(&both(&series), 32, Span::from_us(2_000_000), false, Span::ZERO).play(stage, &both(&series), moving)?;
    let stop = halt(stage, 1, false)?;
    stage.run_until(stop + STANDING)?;
    let mut stood = Vec::new();
    for motor in 0..MOTORS {
        stood.push(stage.status(motor, 0)?.position);
    }
    let resume = halt(stage, 0, true)?;
    let stopped = Stopped { before: Span::ZERO, stop, resume: Some(resume) };
    let until = stage.now() + end_of(&series).since(stopped.track(stage.now())) + Span::from_us(200_000);
    stage.run_until(until)?;
    let all = seen(stage)?;
    compare(report, "halted and resumed", [&series; MOTORS], &all, (began, until), |system| stopped.track(system));
    let standing = (stop + warp().duration(), resume);
    let moved = all
        .steps
        .iter()
        .flatten()
        .flatten()
        .filter(|step| (standing.0.as_us() / BEAT_US + 1..standing.1.as_us() / BEAT_US).contains(&step.beat));
    let moved = moved.count();
    let path = series[0].played(stopped.track(resume))[0];
    report.check(
        moved == 0 && stood.iter().all(|at| *at == path),
        format!("halted: {moved} steps while track time stood for {} ms; both motors say they stand at {stood:?}, where the path has {path}", standing.1.since(standing.0).as_us_floor() / 1_000),
    );
    past(stage, report, &series[0], &stopped)?;
    Ok(until.since(stopped.track(until)))
}

/// Where axis 0 was, before, in and behind the halt.
fn past(stage: &mut Stage, report: &mut Report, series: &Series, stopped: &Stopped) -> Result<(), Failure> {
    let (mut asked, mut wrong) = (0, Vec::new());
    let first = stopped.stop.shifted(-(60_000 << 8));
    for number in 0..24 {
        let at = first + Span::from_us(17_003 * number);
        let track = stopped.track(at);
        let expected = series.played(track);
        let reply = stage.ask((number % 2) as usize, &MotionRequest::MotionAt { axis: 0, time_steps: at.steps() })?;
        let MotionReply::Motion { position, velocity, acceleration, jerk } = reply else {
            return Err(Failure::Failed(format!("a past position was answered by {reply:?}")));
        };
        let exact = (f64::from(position) - series.exact(track)).abs();
        asked += 1;
        if [position, velocity, acceleration, jerk] != expected || exact > 1.0 {
            wrong.push((at.as_us(), position, expected[0]));
        }
    }
    report.check(
        wrong.is_empty(),
        format!("past: {asked} times before, in and behind the halt are told as they were played, a LSB from the exact spline at most: {wrong:?}"),
    );
    Ok(())
}

/// No more points come while the axes move: each brakes by itself.
pub(super) fn starved(stage: &mut Stage, report: &mut Report, us: u64, delay: Span) -> Result<(), Failure> {
    let mut series = ahead(stage, us, delay)?;
    for one in &mut series {
        let brake = *limits(&settings(one.interval)).brake();
        *one = one.cut(CUT, MISSING_MAX, brake);
    }
    let (began, until) = (stage.now(), end_of(&series) + delay);
    Feed::new(&both(&series), 32, Span::from_us(2_000_000), false, delay).play(stage, &both(&series), until)?;
    let all = seen(stage)?;
    let later = delay.steps().cast_signed();
    compare(report, "starved", [&series; MOTORS], &all, (began, until), |system| system.shifted(-later));
    for (axis, one) in (0..).zip(&series) {
        let whole = settings(one.interval);
        let (second, third) = one.differences_max();
        let status = stage.status(0, axis)?;
        report.check(
            status.state == AxisState::Starved && status.rebuilt > 0 && status.position == one.end() && second <= whole.acceleration.at_rest && third <= whole.jerk.at_rest,
            format!("starved: axis {axis} brakes from point {CUT} on to {} and says {:?}; its differences are {second} of {} and {third} of {}", status.position, status.state, whole.acceleration.at_rest, whole.jerk.at_rest),
        );
    }
    Ok(())
}

/// A point that jumps: refused, latched, and all motion halts along the path; then it goes on to its end.
pub(super) fn fault(stage: &mut Stage, report: &mut Report, us: u64, delay: Span) -> Result<Span, Failure> {
    let series = ahead(stage, us, delay)?;
    let mut broken = series.clone();
    let brake = *limits(&settings(series[1].interval)).brake();
    let step = u64::from(series[1].interval.steps());
    let first = series[1].start + Span::from_steps(step);
    broken[1] = series[1].cut(GOOD, 0, brake);
    let sent: Vec<_> = both(&series)
        .into_iter()
        .filter(|(motor, ..)| *motor == 1)
        .chain(both(&broken).into_iter().filter(|(motor, ..)| *motor == 0))
        .collect();
    let (began, moving) = (stage.now(), series[0].start + delay + MOVING);
    Feed::new(&sent, 32, Span::from_us(2_000_000), false, delay).play(stage, &sent, moving)?;
    let bad = Points {
        axis: 1,
        time: first + Span::from_steps(GOOD as u64 * step),
        positions: &[series[1].points[GOOD - 1] + JUMP],
    };
    let sent = stage.now();
    let refusal = stage.refused_points(0, &bad)?;
    let wanted = Fault {
        point_steps: bad.time.steps(),
        limit: LimitKind::Velocity,
        value: JUMP,
        bound: settings(series[1].interval).velocity,
    };
    report.check(
        refusal == MotionRefusal::Limit(wanted),
        format!("fault: a jump of {JUMP} LSB is refused with {refusal:?}"),
    );
    let again = stage.refused_points(0, &bad)?;
    report.check(again == MotionRefusal::Latched(wanted), format!("fault: it is latched: {again:?}"));
    stage.run_until(sent + STANDING + Span::from_us(30_000))?;
    let moving = stage.refusal(0, &MotionRequest::ClearFault { axis: 1 })?;
    report
        .check(moving == MotionRefusal::Moving, format!("fault: it is not cleared before the axis rests: {moving:?}"));
    let halted = stage.status(0, 1)?;
    report.check(
        halted.halted == Some(HaltReason::Fault { axis: 1 }) && halted.fault == Some(wanted),
        format!("fault: the motor says why it halted: {:?}", halted.halted),
    );
    let resume = halt(stage, 1, true)?;
    let until = resume + Span::from_us(us + 200_000);
    stage.run_until(until)?;
    let all = seen(stage)?;
    let beats = (began.as_us() / BEAT_US, until.as_us() / BEAT_US);
    let mut epochs =
        (0..400).map(|beat| on_grid(sent.steps()) + Span::from_us(18_000 / BEAT_US * BEAT_US + beat * BEAT_US));
    let fits = |stop: &NetTime| {
        let stopped = Stopped { before: delay, stop: *stop, resume: Some(resume) };
        follow(&series[0], &all.steps[0][0], beats, |system| stopped.track(system)).unlike.is_none()
    };
    let Some(epoch) = epochs.find(fits) else {
        report.check(false, "fault: axis 0 did not stop along its path at any epoch of the 26 ms after the point");
        return Ok(delay);
    };
    let stopped = Stopped { before: delay, stop: epoch, resume: Some(resume) };
    compare(report, "fault", [&broken, &series], &all, (began, until), |system| stopped.track(system));
    report.line(format!("fault: the halt's epoch is {} µs after the point was sent", epoch.since(sent).as_us_floor()));
    let cleared = stage.ask(0, &MotionRequest::ClearFault { axis: 1 })?;
    report.check(cleared == MotionReply::Done, format!("fault: it is cleared at rest: {cleared:?}"));
    Ok(until.since(stopped.track(until)))
}

/// Points that are not to be taken, each with its operands.
pub(super) fn refusals(stage: &mut Stage, report: &mut Report, delay: Span) -> Result<(), Failure> {
    let interval = intervals([12; AXES])[0];
    let h = Span::from_steps(interval.steps().into());
    let rest = [0; 32];
    let mut check = |what: &str, got: MotionRefusal, is_so: bool| {
        report.check(is_so, format!("refused, {what}: {got:?}"));
    };
    let first = first_after(stage, LEAD, delay);
    let points = |time: NetTime, count: usize| Points { axis: 0, time, positions: &rest[..count] };
    let none = stage.refusal(0, &MotionRequest::Status { axis: 7 })?;
    check("an axis that is not there", none, none == MotionRefusal::NoSuch { index: 7, count: 4 });
    let not_armed = stage.refused_points(0, &points(first, 1))?;
    check("at rest and not armed", not_armed, not_armed == MotionRefusal::NotArmed);
    let config = osap_protocol::motion::AxisSettings { stop_log2: 8, ..settings(interval) };
    let short = stage.refusal(0, &MotionRequest::Configure { axis: 0, settings: config })?;
    check("a halt of 0.8 ms", short, matches!(short, MotionRefusal::HaltTooShort { least: 9..=15, .. }));
    arm(stage, 0, &[interval], &[0])?;
    let past = first.shifted(-(500_000 << 8) / (16_384 << 8) * (16_384 << 8));
    let late = stage.refused_points(0, &points(past, 1))?;
    let is_late = matches!(late, MotionRefusal::Late { point_steps, earliest_steps } if point_steps == past.steps() && earliest_steps > point_steps);
    check("late", late, is_late);
    let off = stage.refused_points(0, &points(first + Span::from_steps(1), 1))?;
    check("off the grid", off, off == MotionRefusal::OffGrid { point_steps: first.steps() + 1, interval_log2: 12 });
    stage.post(0, &points(first, 4), false)?;
    stage.run_until(stage.now() + Span::from_us(5_000))?;
    let far = first + Span::from_steps(12 * h.steps());
    let gap = stage.refused_points(0, &points(far, 1))?;
    check("gap", gap, gap == MotionRefusal::Gap { missing: 8, missing_max: 2 });
    let twice = stage.refused_points(0, &points(first, 1))?;
    let last = first + Span::from_steps(3 * h.steps());
    check(
        "not monotonic",
        twice,
        twice == MotionRefusal::NonMonotonic { point_steps: first.steps(), last_steps: last.steps() },
    );
    for message in 0..3 {
        let time = first + Span::from_steps((4 + 32 * message) * h.steps());
        stage.post(0, &points(time, 32), false)?;
        stage.run_until(stage.now() + Span::from_us(3_000))?;
    }
    let full = stage.refused_points(0, &points(first + Span::from_steps(100 * h.steps()), 32))?;
    check("full", full, matches!(full, MotionRefusal::Full { taken: 28, capacity: 128 }));
    // half a second without a fresh point would halt all motion, so some follow; then the queue is let run out
    stage.run_until(first + delay + Span::from_steps(40 * h.steps()))?;
    stage.post(0, &points(first + Span::from_steps(128 * h.steps()), 4), false)?;
    stage.run_until(first + delay + Span::from_steps(145 * h.steps()))?;
    let status = stage.status(0, 0)?;
    check_end(report, &status);
    Ok(())
}

/// Nothing of what was refused has done anything.
fn check_end(report: &mut Report, status: &AxisStatus) {
    report.check(
        status.state == AxisState::Starved && status.position == 0 && status.fault.is_none(),
        format!("refused: the axis has not moved: {status:?}"),
    );
}

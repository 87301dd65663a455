//! Looks at every beat of a player and at every point that it plays, and knows nothing of how they came about.

use super::truth::{ClockModel, Truth, real, spline};
use fixed_math::spline::IntervalLog2;
use fixed_math::time::NetTime;
use osap_maxl::{Motion, Output, PlayerState, TrackTime};

/// Points that are remembered.
const KEPT: usize = 512;
/// Most intervals that a player follows at once; a wider leap it brakes from.
const LEAP: u64 = 8;

/// What is expected of an armed axis.
#[derive(Clone, Debug)]
struct Series {
    truth: Truth,
    interval: u64,
    start: u64,
    /// Index and position of points that were accepted.
    accepted: Box<[(u64, i32); KEPT]>,
    is_following: bool,
    /// Knots since it brakes.
    braking: u32,
}

/// The last beat.
#[derive(Clone, Copy, Debug)]
struct Seen {
    points: [i32; 4],
    knot: u64,
    track: u64,
    position: i32,
    state: PlayerState,
}

/// Judges one axis.
#[derive(Clone, Debug)]
pub(super) struct Judge {
    pub(super) clock: ClockModel,
    series: Option<Series>,
    /// Armed, but not yet seen by the player.
    coming: Option<(Series, i32)>,
    last: Option<Seen>,
    pub(super) knots: u64,
    pub(super) rebuilt: u64,
    pub(super) stops: u64,
    pub(super) leaps: u64,
}

impl Judge {
    pub(super) const fn new() -> Self {
        let clock = ClockModel::new();
        Self { clock, series: None, coming: None, last: None, knots: 0, rebuilt: 0, stops: 0, leaps: 0 }
    }

    /// The axis was armed.
    pub(super) fn arm(&mut self, truth: Truth, interval: IntervalLog2, position: i32, start: NetTime) {
        let series = Series {
            truth,
            interval: interval.steps().into(),
            start: start.steps(),
            accepted: Box::new([(0, 0); KEPT]),
            is_following: true,
            braking: 0,
        };
        self.coming = Some((series, position));
    }

    /// A point was accepted.
    pub(super) fn accept(&mut self, time: NetTime, position: i32) {
        if let Some(series) = self.coming.as_mut().map(|(series, _)| series).or(self.series.as_mut()) {
            let index = (time.steps() - series.start) / series.interval;
            series.accepted[slot(index)] = (index, position);
        }
    }

    /// One beat at `system`.
    pub(super) fn see(
        &mut self,
        system: NetTime,
        track: TrackTime,
        output: Output,
        points: ([i32; 4], NetTime),
    ) -> Result<(), String> {
        let (expected, rate) = self.clock.beat(system.steps());
        let track = track.time.steps();
        if (real(track) - expected).abs() > 1.01 {
            return Err(format!("track time {track} where {expected} was expected: {:?} {rate:?}", self.clock));
        }
        let (points, knot) = (points.0, points.1.steps());
        let seen = Seen { points, knot, track, position: output.position, state: output.state };
        if let Some(last) = self.last
            && track < last.track
        {
            return Err(format!("track time went back from {} to {track}", last.track));
        }
        self.begin(&seen)?;
        if let Some(mut series) = self.series.take() {
            let judged = self.judge(&mut series, &seen, rate);
            self.series = Some(series);
            judged?;
        }
        self.last = Some(seen);
        Ok(())
    }

    /// Where the axis is said to have been: on the last segments, as far as they are known.
    pub(super) fn check_past(&self, at: NetTime, motion: Motion) -> Result<(), String> {
        let (Some(series), Some(last)) = (&self.series, &self.last) else { return Ok(()) };
        let at = at.steps();
        if at < last.knot || at >= last.knot + series.interval || self.coming.is_some() {
            return Ok(());
        }
        let [position, velocity, ..] = spline(last.points, part(at - last.knot, series.interval));
        let is_close = (position - f64::from(motion.position)).abs() < 1.0 + 1e-6
            && (16.0 * velocity - f64::from(motion.velocity)).abs() < 7.0 + 1e-6 * velocity.abs();
        if is_close { Ok(()) } else { Err(format!("{motion:?} at {at}, where {position}, {velocity} was played")) }
    }

    /// A series begins when the player has taken it: it follows, or has even come to rest again.
    fn begin(&mut self, seen: &Seen) -> Result<(), String> {
        let (before, was) = self.last.map_or((0, PlayerState::Idle), |last| (last.knot, last.state));
        let is_taken = |_: &mut (Series, i32)| {
            seen.state == PlayerState::Following
                || seen.knot != before
                || (was == PlayerState::Idle && seen.state != was)
        };
        let Some((series, position)) = self.coming.take_if(is_taken) else { return Ok(()) };
        if let Some(last) = self.last
            && last.state != PlayerState::Idle
            && last.position != position
        {
            return Err(format!("armed at {position}, rested at {}", last.position));
        }
        let knot = series.start - 2 * series.interval;
        let track = self.last.map_or(0, |last| last.track).min(knot);
        self.series = Some(series);
        self.last = Some(Seen { points: [position; 4], knot, track, position, state: PlayerState::Following });
        Ok(())
    }

    fn judge(&mut self, series: &mut Series, seen: &Seen, rate: [f64; 3]) -> Result<(), String> {
        let Some(last) = self.last else { return Ok(()) };
        if seen.state == PlayerState::Idle {
            return Ok(());
        }
        let waited = last.track.max(last.knot);
        let is_leap = seen.track > waited + LEAP * series.interval;
        if is_leap && (last.state == PlayerState::Following || last.state == PlayerState::Stopping) {
            self.leaps += 1;
            series.is_following = false;
            if seen.points != last.points || seen.position != last.position {
                return Err(format!("a leap moved the axis: {last:?}, {seen:?}"));
            }
        } else {
            self.follow(series, &last, seen)?;
        }
        Self::judge_state(series, &last, seen)?;
        let part = part(seen.track.saturating_sub(seen.knot), series.interval);
        let is_moving = seen.state == PlayerState::Following || seen.state == PlayerState::Stopping;
        let part = if is_moving { part } else { part.min(1.0) };
        if part > 1.0 {
            return Err(format!("part {part} of an interval: {seen:?}"));
        }
        let [position, ..] = spline(seen.points, part);
        if (position - f64::from(seen.position)).abs() > 1.0 + 1e-6 {
            return Err(format!("{} where the path is at {position}: {seen:?}", seen.position));
        }
        if !(series.truth.min..=series.truth.max).contains(&seen.position) {
            return Err(format!("{} is outside of the limits", seen.position));
        }
        // per step to per interval
        let step = real(series.interval);
        let rate = [rate[0], rate[1] * step, rate[2] * step * step];
        series.truth.keeps_warped(seen.points, part, rate)
    }

    /// Points that came since the last beat.
    fn follow(&mut self, series: &mut Series, last: &Seen, seen: &Seen) -> Result<(), String> {
        let passed = seen.knot.checked_sub(last.knot).filter(|passed| passed % series.interval == 0);
        let Some(passed) = passed.map(|passed| passed / series.interval) else {
            return Err(format!("the knot is off: {last:?}, {seen:?}"));
        };
        // time is played by whole 2^−16 of an interval, and each position is less than one LSB off
        let parts = real(seen.track - last.track) / real(series.interval) + 1.0 / f64::from(1 << 16);
        let most = f64::from(series.truth.velocity) * parts + 2.0;
        if (f64::from(seen.position) - f64::from(last.position)).abs() > most {
            return Err(format!("faster than the limit: {last:?}, {seen:?}"));
        }
        let new = usize::try_from(passed).unwrap_or(usize::MAX).min(4);
        let mut line = [0; 8];
        line[..4].copy_from_slice(&last.points);
        line[4..4 + new].copy_from_slice(&seen.points[4 - new..]);
        if passed < 4 && seen.points[..4 - new] != last.points[new..] {
            return Err(format!("points changed: {last:?}, {seen:?}"));
        }
        if passed > 4 {
            // points in between were not seen
            line[..4].copy_from_slice(&seen.points);
            series.truth.keeps(seen.points)?;
            series.braking += u32::from(!series.is_following);
            return Self::known(series, seen);
        }
        for at in 0..new {
            let four = [line[at + 1], line[at + 2], line[at + 3], line[at + 4]];
            series.truth.keeps(four)?;
            self.knots += 1;
            let newest = (seen.knot + 2 * series.interval).saturating_sub(series.start) / series.interval;
            self.explain(series, newest.saturating_sub((new - 1 - at) as u64), four, seen.state)?;
        }
        Ok(())
    }

    /// Every point is one that was accepted, one rebuilt from its neighbours, or the brake's.
    fn explain(&mut self, series: &mut Series, index: u64, four: [i32; 4], state: PlayerState) -> Result<(), String> {
        let [p3, p2, p1, point] = four.map(i64::from);
        if !series.is_following {
            series.braking += 1;
            if series.braking > 600 {
                return Err(format!("no rest after {} intervals: {four:?}", series.braking));
            }
            return Ok(());
        }
        let at = |index: u64| {
            Some(series.accepted[slot(index)]).filter(|kept| kept.0 == index).map(|kept| i64::from(kept.1))
        };
        if at(index) == Some(point) {
            return Ok(());
        }
        let tail = 3 * p1 - 3 * p2 + p3;
        let between = at(index + 1)
            .zip(at(index + 2))
            .map(|(after, behind)| (-p2 + 4 * p1 + 4 * after - behind + 3).div_euclid(6));
        if at(index).is_none() && (point == tail || between == Some(point)) && state == PlayerState::Following {
            self.rebuilt += 1;
            return Ok(());
        }
        if state == PlayerState::Following {
            return Err(format!(
                "point {index} is {point}, accepted was {:?}, rebuilt {tail} or {between:?}",
                at(index)
            ));
        }
        series.is_following = false;
        series.braking = 1;
        self.stops += 1;
        Ok(())
    }

    /// After several knots at once: the newest four are all that can be said.
    fn known(series: &Series, seen: &Seen) -> Result<(), String> {
        let first = (seen.knot - series.start.min(seen.knot)) / series.interval;
        let wrong = seen.points.iter().zip(first..).find(|(point, index)| {
            let index = index.saturating_sub(1);
            let kept = series.accepted[slot(index)];
            series.is_following
                && seen.state == PlayerState::Following
                && index > 0
                && kept.0 == index
                && kept.1 != **point
        });
        wrong.map_or(Ok(()), |(point, index)| Err(format!("point {index} is {point}: {seen:?}")))
    }

    fn judge_state(series: &mut Series, last: &Seen, seen: &Seen) -> Result<(), String> {
        use PlayerState::{Following, Holding, Released, Resting, Stopping};
        let is_resting = matches!(seen.state, Resting | Holding | Released);
        if is_resting && seen.points.iter().any(|point| *point != seen.position) {
            return Err(format!("rests while it moves: {seen:?}"));
        }
        if seen.state == Stopping {
            series.is_following = false;
        }
        match (last.state, seen.state) {
            (Stopping | Resting | Holding | Released, Following) => {
                Err(format!("goes on without being armed: {seen:?}"))
            }
            (Resting | Holding | Released, _) if seen.position != last.position => {
                Err(format!("moves at rest: {last:?}, {seen:?}"))
            }
            _ => Ok(()),
        }
    }
}

/// Part of an interval, by whole 2^−16 of it, which is how finely time is played.
fn part(elapsed: u64, interval: u64) -> f64 {
    real(elapsed.saturating_mul(1 << 16) / interval) / f64::from(1 << 16)
}

/// Where a point of this index is kept.
fn slot(index: u64) -> usize {
    usize::try_from(index % KEPT as u64).unwrap_or(0)
}

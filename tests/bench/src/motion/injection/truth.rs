//! What limits and stops mean, in arithmetic of its own: integers for points, double precision for what a stop adds to them.

use fixed_math::limits::{Curve, Limits};

/// A limit over speed as it is meant: a straight line between two corners, not rounded.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    pub(super) at_rest: i32,
    pub(super) at_full: i32,
    pub(super) knee: i32,
    pub(super) full: i32,
}

impl Line {
    fn curve(self) -> Option<Curve> {
        if self.at_rest == self.at_full {
            return Some(Curve::flat(self.at_rest));
        }
        Curve::falling(self.at_rest, self.at_full, self.knee, self.full)
    }

    /// Whether |value|/of is at most what is allowed at |speed|/of; `of` is at most 2^6.
    fn allows(self, value: i64, speed: i64, of: i64) -> bool {
        let (value, speed) = (value.abs(), speed.abs());
        let [at_rest, at_full, knee, full] = [self.at_rest, self.at_full, self.knee, self.full].map(i64::from);
        if at_rest == at_full || speed <= knee * of {
            return value <= at_rest * of;
        }
        if speed >= full * of {
            return value <= at_full * of;
        }
        value * (full - knee) <= at_rest * of * (full - knee) - (at_rest - at_full) * (speed - knee * of)
    }

    /// The same in double precision, with room for its rounding.
    fn allows_real(self, value: f64, speed: f64) -> bool {
        let [at_rest, at_full, knee, full] = [self.at_rest, self.at_full, self.knee, self.full].map(f64::from);
        let down = ((speed.abs() - knee) / (full - knee)).clamp(0.0, 1.0);
        let bound = if at_rest > at_full { at_rest - (at_rest - at_full) * down } else { at_rest };
        value.abs() <= bound * (1.0 + 1e-9) + 1e-6
    }
}

/// Limits of an axis as they are meant, in differences of an interval.
#[derive(Clone, Copy, Debug)]
pub(super) struct Truth {
    pub(super) min: i32,
    pub(super) max: i32,
    pub(super) velocity: i32,
    pub(super) acceleration: Line,
    pub(super) jerk: Line,
}

/// Samples of an interval.
const SAMPLES: i64 = 4;

/// Position, velocity, acceleration and jerk of a segment in double precision, per interval.
pub(super) fn spline(points: [i32; 4], part: f64) -> [f64; 4] {
    let [p0, p1, p2, p3] = points.map(f64::from);
    let (bend, jerk) = (p0 - 2.0 * p1 + p2, p3 - 3.0 * p2 + 3.0 * p1 - p0);
    let slope = (p2 - p0) / 2.0;
    let position = p1 + bend / 6.0 + part * (slope + part * (bend / 2.0 + part * jerk / 6.0));
    [position, slope + part * (bend + part * jerk / 2.0), bend + part * jerk, jerk]
}

impl Truth {
    pub(super) fn limits(&self) -> Option<Limits> {
        let (acceleration, jerk) = (self.acceleration.curve()?, self.jerk.curve()?);
        Limits::new((self.min, self.max), self.velocity, acceleration, jerk).ok()
    }

    /// The segment of four points, at its knots and between, exactly.
    pub(super) fn keeps(&self, points: [i32; 4]) -> Result<(), String> {
        let [p0, p1, p2, p3] = points.map(i64::from);
        let n = SAMPLES;
        if points.iter().any(|point| !(self.min..=self.max).contains(point)) {
            return Err(format!("{points:?} leave {}..={}", self.min, self.max));
        }
        let (bend, jerk) = (p0 - 2 * p1 + p2, p3 - 3 * p2 + 3 * p1 - p0);
        for t in 0..=n {
            let of = 2 * n * n;
            let velocity = (p2 - p0) * n * n + 2 * bend * n * t + jerk * t * t;
            let acceleration = 2 * n * (bend * n + jerk * t);
            if velocity.abs() > i64::from(self.velocity) * of {
                return Err(format!("{points:?} at {t}/{n}: velocity {velocity}/{of} of {}", self.velocity));
            }
            if !self.acceleration.allows(acceleration, velocity, of) {
                return Err(format!(
                    "{points:?} at {t}/{n}: acceleration {acceleration}/{of} at velocity {velocity}/{of}"
                ));
            }
            if !self.jerk.allows(jerk * of, velocity, of) {
                return Err(format!("{points:?} at {t}/{n}: jerk {jerk} at velocity {velocity}/{of}"));
            }
        }
        Ok(())
    }

    /// What an axis does over real time: velocity, acceleration and jerk at `part`, with the rate of track time and its derivatives, per interval.
    pub(super) fn keeps_warped(&self, points: [i32; 4], part: f64, rate: [f64; 3]) -> Result<(), String> {
        let [_, v, a, j] = spline(points, part);
        let [first, second, third] = rate;
        let velocity = v * first;
        let acceleration = a * first * first + v * second;
        let jerk = j * first.powi(3) + 3.0 * a * first * second + v * third;
        let is_kept = velocity.abs() <= f64::from(self.velocity) + 1e-6
            && self.acceleration.allows_real(acceleration, velocity)
            && self.jerk.allows_real(jerk, velocity);
        if is_kept {
            return Ok(());
        }
        Err(format!(
            "{points:?} at {part}, rate {rate:?}: velocity {velocity}, acceleration {acceleration}, jerk {jerk}"
        ))
    }
}

/// A model of the motion clock, in µs of a time that never steps back.
#[derive(Clone, Debug)]
pub(super) struct ClockModel {
    /// System time of the last beat, steps.
    last: u64,
    /// What system time stepped back so far, steps.
    back: u64,
    /// Stop or resume, epoch in unstepped steps, track time then, duration.
    turn: Option<(bool, f64, f64, f64)>,
    next: Option<(bool, f64, f64)>,
    /// Requests that wait, as they were asked.
    requests: std::collections::VecDeque<(bool, u64, f64)>,
}

/// Multiples of which epochs are, steps.
const GRID: u64 = 64 * 256;

impl ClockModel {
    pub(super) const fn new() -> Self {
        Self { last: 0, back: 0, turn: None, next: None, requests: std::collections::VecDeque::new() }
    }

    /// A request was taken; `epoch` is no earlier than its now, steps.
    pub(super) fn ask(&mut self, is_stop: bool, epoch: u64, duration: f64) {
        self.requests.push_back((is_stop, epoch, duration));
    }

    /// The beat at `system`: track time in steps, and its rate with two derivatives, per step.
    pub(super) fn beat(&mut self, system: u64) -> (f64, [f64; 3]) {
        if self.last > system + GRID {
            self.back += self.last - system;
            self.last = system;
        }
        if let Some((is_stop, epoch, duration)) = self.requests.pop_front() {
            self.take(is_stop, epoch.max(self.last).div_ceil(GRID) * GRID, duration);
        }
        self.last = self.last.max(system);
        let now = real(self.last + self.back);
        if let Some((is_stop, epoch, duration)) = self.next.filter(|next| next.1 <= now) {
            let track = self.at(epoch).0;
            self.turn = Some((is_stop, epoch, track, duration));
            self.next = None;
        }
        self.at(now)
    }

    fn take(&mut self, is_stop: bool, epoch: u64, duration: f64) {
        let over = self.turn.map_or(0.0, |(_, epoch, _, duration)| epoch + duration);
        let stands = self.turn.is_some_and(|turn| turn.0);
        let grid = real(GRID);
        // epochs are on the grid of system time
        let over = ((over - real(self.back)) / grid).ceil() * grid + real(self.back);
        let epoch = real(epoch + self.back);
        match (is_stop, self.next) {
            (true, Some((false, ..))) => self.next = None,
            (true, Some((true, planned, _))) if epoch.max(over) < planned => {
                self.next = Some((true, epoch.max(over), duration));
            }
            (true, None) if !stands => self.next = Some((true, epoch.max(over), duration)),
            (false, None) if stands && epoch >= self.turn.map_or(0.0, |(_, epoch, _, duration)| epoch + duration) => {
                self.next = Some((false, epoch, duration));
            }
            _ => {}
        }
    }

    fn at(&self, now: f64) -> (f64, [f64; 3]) {
        let Some((is_stop, epoch, track, duration)) = self.turn else { return (now, [1.0, 0.0, 0.0]) };
        let s = ((now - epoch) / duration).max(0.0);
        if s >= 1.0 {
            let passed = if is_stop { duration / 2.0 } else { now - epoch - duration / 2.0 };
            return (track + passed, if is_stop { [0.0; 3] } else { [1.0, 0.0, 0.0] });
        }
        let from_end = if is_stop { s } else { 1.0 - s };
        let (passed, rate, first, second) = if from_end <= 0.5 {
            let s = from_end;
            (s - 2.0 / 3.0 * s.powi(3), 1.0 - 2.0 * s * s, -4.0 * s, -4.0)
        } else {
            let s = 1.0 - from_end;
            (0.5 - 2.0 / 3.0 * s.powi(3), 2.0 * s * s, -4.0 * s, 4.0)
        };
        if is_stop {
            (track + duration * passed, [rate, first / duration, second / (duration * duration)])
        } else {
            (track + duration * (0.5 - passed), [rate, -first / duration, second / (duration * duration)])
        }
    }
}

/// Steps in double precision: exact below 2^53, 400 days.
#[expect(clippy::cast_precision_loss, reason = "as said above")]
pub(super) const fn real(steps: u64) -> f64 {
    steps as f64
}

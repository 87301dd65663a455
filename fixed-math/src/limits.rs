//! Limits of an axis in differences of its control points: exact integers, no unit of time.
//!
//! - **Walk:** a point in order → [`Limits::check`] → the track's queue, or a latched fault with the limit, the value and the bound.
//! - **Invariants:** a point that was accepted keeps all limits over the segment that it completes, and so does the [stop](crate::brake)
//!   that would follow it, all the way to rest. What a spline says between points keeps them too, since velocity lies in the hull of
//!   three differences, acceleration between two second differences, and jerk is the third.
//! - **Context:** the task that takes points. A point near a limit costs a simulated stop, [`STOP_INTERVALS_MAX`] steps at the most.
//!
//! Positions are LSB, velocities δ = P(i) − P(i−1), accelerations α = δ(i) − δ(i−1), jerks α(i) − α(i−1). A workstation that rounds each
//! point by half an LSB gives ⌊V·h⌋ + 1, ⌊A·h²⌋ + 2 and ⌊J·h³⌋ + 4: what rounding can add.

use crate::brake::Brake;
use crate::widening::product;

/// Most that a velocity may be limited to: the evaluator's range.
pub const VELOCITY_MAX: i32 = 1 << 25;
/// Longest stop that limits may lead to, intervals.
pub const STOP_INTERVALS_MAX: u32 = 512;

/// The newest of a series of points with its differences.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Knot {
    /// The point itself.
    pub position: i32,
    /// It less the one before.
    pub velocity: i32,
    /// Its velocity less that of the one before.
    pub acceleration: i32,
}

impl Knot {
    /// A point that has been there for at least two intervals.
    #[must_use]
    pub const fn resting(position: i32) -> Self {
        Self { position, velocity: 0, acceleration: 0 }
    }

    /// Nothing changes any more unless a further point says so.
    #[must_use]
    pub const fn is_at_rest(&self) -> bool {
        self.velocity == 0 && self.acceleration == 0
    }
}

/// What can be limited.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LimitKind {
    /// The least position.
    PositionMin,
    /// The greatest position.
    PositionMax,
    /// Speed, either way.
    Velocity,
    /// Acceleration, either way.
    Acceleration,
    /// Jerk, either way.
    Jerk,
}

/// A limit that a point breaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Violation {
    /// Which one.
    pub limit: LimitKind,
    /// Not the point itself breaks it, but the stop that would have to follow.
    pub is_of_stop: bool,
    /// What it came to, saturated to 32 bits.
    pub value: i32,
    /// What it may be at the most, or for [`LimitKind::PositionMin`] at the least.
    pub bound: i32,
}

/// A limit that may fall with speed: `at_rest` up to a knee, from there in a straight line to `at_full` at full speed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Curve {
    at_rest: i32,
    at_full: i32,
    knee: u32,
    /// How it falls behind the knee, 2^−16, rounded up.
    slope_q16: u32,
}

impl Curve {
    /// The same at any speed.
    #[must_use]
    pub const fn flat(value: i32) -> Self {
        Self { at_rest: value, at_full: value, knee: 0, slope_q16: 0 }
    }

    /// Falls from `at_rest` at speed `knee` to `at_full` at speed `full`. `None` unless 0 ≤ `knee` < `full` and 1 ≤ `at_full` ≤ `at_rest`.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "at most 2^26 << 16 over one is cut below 2^32 by the check")]
    pub const fn falling(at_rest: i32, at_full: i32, knee: i32, full: i32) -> Option<Self> {
        if knee < 0 || knee >= full || at_full > at_rest || at_full < 1 {
            return None;
        }
        let (drop, run) = (at_rest.abs_diff(at_full) as u64, full.abs_diff(knee) as u64);
        let slope = (drop << 16).div_ceil(run);
        // steeper than 2^16 a unit of speed is a step
        let slope_q16 = if slope > u32::MAX as u64 { u32::MAX } else { slope as u32 };
        Some(Self { at_rest, at_full, knee: knee.unsigned_abs(), slope_q16 })
    }

    /// What is allowed at `speed`, rounded down.
    #[must_use]
    pub const fn at(&self, speed: u32) -> i32 {
        if self.slope_q16 == 0 || speed <= self.knee {
            return self.at_rest;
        }
        let fallen = (product(speed - self.knee, self.slope_q16) + 0xffff) >> 16;
        let left = self.at_rest as i64 - fallen.cast_signed();
        #[expect(clippy::cast_possible_truncation, reason = "between two values of 32 bits")]
        if left < self.at_full as i64 { self.at_full } else { left as i32 }
    }

    /// The most there is.
    #[must_use]
    pub const fn at_rest(&self) -> i32 {
        self.at_rest
    }

    /// What is left at full speed.
    #[must_use]
    pub const fn at_full(&self) -> i32 {
        self.at_full
    }

    /// The curve less `reserve`.
    #[must_use]
    pub const fn less(&self, reserve: i32) -> Self {
        Self { at_rest: self.at_rest.saturating_sub(reserve), at_full: self.at_full.saturating_sub(reserve), ..*self }
    }
}

/// Why limits are none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LimitsError {
    /// The least position is above the greatest.
    PositionsCrossed {
        /// The least.
        min: i32,
        /// The greatest.
        max: i32,
    },
    /// A limit is outside what can be checked.
    OutOfRange {
        /// Which one.
        limit: LimitKind,
        /// What it is, at full speed.
        value: i32,
        /// The least that it may be.
        least: i32,
        /// The most that it may be.
        most: i32,
    },
    /// A stop from full speed takes too long.
    StopTooLong {
        /// How long, intervals, or one more than was looked at.
        intervals: u32,
        /// How long it may take.
        most: u32,
    },
}

/// Limits of one axis, and its brake.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    min: i32,
    max: i32,
    velocity: i32,
    acceleration: Curve,
    jerk: Curve,
    brake: Brake,
    /// No stop is longer, intervals.
    stop_intervals: u32,
}

impl Limits {
    /// Positions `min` to `max`, LSB; `velocity` per interval, `acceleration` per interval², `jerk` per interval³.
    ///
    /// # Errors
    /// [`LimitsError`] where a limit is out of range or a stop from full speed would take more than [`STOP_INTERVALS_MAX`] intervals.
    pub const fn new(
        (min, max): (i32, i32),
        velocity: i32,
        acceleration: Curve,
        jerk: Curve,
    ) -> Result<Self, LimitsError> {
        if min > max {
            return Err(LimitsError::PositionsCrossed { min, max });
        }
        if velocity < 1 || velocity > VELOCITY_MAX {
            let limit = LimitKind::Velocity;
            return Err(LimitsError::OutOfRange { limit, value: velocity, least: 1, most: VELOCITY_MAX });
        }
        if acceleration.at_full < 1 || acceleration.at_rest > 2 * VELOCITY_MAX {
            let limit = LimitKind::Acceleration;
            let value = if acceleration.at_full < 1 { acceleration.at_full } else { acceleration.at_rest };
            return Err(LimitsError::OutOfRange { limit, value, least: 1, most: 2 * VELOCITY_MAX });
        }
        if jerk.at_full < 1 || jerk.at_rest > 4 * VELOCITY_MAX {
            let limit = LimitKind::Jerk;
            let value = if jerk.at_full < 1 { jerk.at_full } else { jerk.at_rest };
            return Err(LimitsError::OutOfRange { limit, value, least: 1, most: 4 * VELOCITY_MAX });
        }
        let brake = Brake::new(jerk.at_full, acceleration.at_full);
        let release = acceleration.at_rest.unsigned_abs().div_ceil(jerk.at_full.unsigned_abs());
        let mut knot = Knot { position: 0, velocity, acceleration: 0 };
        let mut intervals = release.saturating_add(2);
        while !knot.is_at_rest() && intervals <= STOP_INTERVALS_MAX {
            knot = brake.next(knot);
            intervals += 1;
        }
        if intervals > STOP_INTERVALS_MAX {
            return Err(LimitsError::StopTooLong { intervals, most: STOP_INTERVALS_MAX });
        }
        Ok(Self { min, max, velocity, acceleration, jerk, brake, stop_intervals: intervals })
    }

    /// The brake that these limits are kept with.
    #[must_use]
    pub const fn brake(&self) -> &Brake {
        &self.brake
    }

    /// Least and greatest position.
    #[must_use]
    pub const fn positions(&self) -> (i32, i32) {
        (self.min, self.max)
    }

    /// The greatest speed.
    #[must_use]
    pub const fn velocity(&self) -> i32 {
        self.velocity
    }

    /// Acceleration over speed.
    #[must_use]
    pub const fn acceleration(&self) -> &Curve {
        &self.acceleration
    }

    /// Jerk over speed.
    #[must_use]
    pub const fn jerk(&self) -> &Curve {
        &self.jerk
    }

    /// No stop takes more intervals.
    #[must_use]
    pub const fn stop_intervals(&self) -> u32 {
        self.stop_intervals
    }

    /// The point `position` after `last`, which was accepted before: its differences, if it may follow.
    ///
    /// # Errors
    /// The first limit that it breaks, or that the stop from it would break.
    pub fn check(&self, last: Knot, position: i32) -> Result<Knot, Violation> {
        let next = self.keeps(last, position)?;
        if self.stop_is_clear(next) { Ok(next) } else { self.stop_from(next).map(|_| next) }
    }

    /// A first point: no differences yet.
    ///
    /// # Errors
    /// The position limit that it breaks.
    pub const fn check_rest(&self, position: i32) -> Result<Knot, Violation> {
        match self.position(position) {
            Some(violation) => Err(violation),
            None => Ok(Knot::resting(position)),
        }
    }

    /// The limits over the one segment that `position` completes.
    fn keeps(&self, last: Knot, position: i32) -> Result<Knot, Violation> {
        if let Some(violation) = self.position(position) {
            return Err(violation);
        }
        let velocity = i64::from(position) - i64::from(last.position);
        if velocity.unsigned_abs() > u64::from(self.velocity.unsigned_abs()) {
            return Err(violation(LimitKind::Velocity, velocity, self.velocity));
        }
        let acceleration = velocity - i64::from(last.velocity);
        let jerk = acceleration - i64::from(last.acceleration);
        let next = Knot { position, velocity: cut(velocity), acceleration: cut(acceleration) };
        let before = last.velocity.saturating_sub(last.acceleration);
        let speed = next.velocity.unsigned_abs().max(last.velocity.unsigned_abs()).max(before.unsigned_abs());
        let bound = self.acceleration.at(speed);
        let greater = if last.acceleration.unsigned_abs() > next.acceleration.unsigned_abs() { last } else { next };
        if greater.acceleration.unsigned_abs() > bound.unsigned_abs() {
            return Err(violation(LimitKind::Acceleration, i64::from(greater.acceleration), bound));
        }
        let bound = self.jerk.at(speed);
        if jerk.unsigned_abs() > u64::from(bound.unsigned_abs()) {
            return Err(violation(LimitKind::Jerk, jerk, bound));
        }
        Ok(next)
    }

    const fn position(&self, position: i32) -> Option<Violation> {
        let (limit, bound) = if position < self.min {
            (LimitKind::PositionMin, self.min)
        } else if position > self.max {
            (LimitKind::PositionMax, self.max)
        } else {
            return None;
        };
        Some(Violation { limit, is_of_stop: false, value: position, bound })
    }

    /// A stop from `knot` needs no look: it is at rest, or so far from every limit that none can be reached.
    fn stop_is_clear(&self, knot: Knot) -> bool {
        if knot.is_at_rest() {
            return true;
        }
        // while |α| is let go of, J less each interval, velocity changes by less than |α|·(|α|/J + 1)/2
        let held = knot.acceleration.unsigned_abs();
        let release = held.div_ceil(self.brake.jerk().unsigned_abs());
        let change = u64::from(held) * u64::from(release) / 2;
        let peak = u64::from(knot.velocity.unsigned_abs()) + change;
        if peak > u64::from(self.velocity.unsigned_abs()) {
            return false;
        }
        let Ok(speed) = u32::try_from(peak) else { return false };
        if held > self.acceleration.at(speed).unsigned_abs() {
            return false;
        }
        let reach = peak * u64::from(self.stop_intervals);
        let room = |a: i32, b: i32| u64::from(a.abs_diff(b));
        reach <= room(self.max, knot.position).min(room(knot.position, self.min))
    }

    /// Stops from `knot`, looking at every step; how many it took.
    fn stop_from(&self, mut knot: Knot) -> Result<u32, Violation> {
        for step in 0..=STOP_INTERVALS_MAX {
            if knot.is_at_rest() {
                return Ok(step);
            }
            let next = self.brake.next(knot);
            if knot.position.checked_add(next.velocity).is_none() {
                // a limit at the end of all positions: what saturates there is no stop
                let (limit, bound) = if next.velocity > 0 {
                    (LimitKind::PositionMax, self.max)
                } else {
                    (LimitKind::PositionMin, self.min)
                };
                return Err(Violation { limit, is_of_stop: true, value: next.position, bound });
            }
            self.keeps(knot, next.position).map_err(|violation| Violation { is_of_stop: true, ..violation })?;
            knot = next;
        }
        let bound = self.velocity;
        Err(Violation { limit: LimitKind::Velocity, is_of_stop: true, value: knot.velocity, bound })
    }
}

fn violation(limit: LimitKind, value: i64, bound: i32) -> Violation {
    Violation { limit, is_of_stop: false, value: cut(value), bound }
}

/// To 32 bits, towards the side that was overflown.
fn cut(value: i64) -> i32 {
    i32::try_from(value).unwrap_or(if value > 0 { i32::MAX } else { i32::MIN })
}

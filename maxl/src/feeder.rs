//! The task's half of an axis: takes points or refuses them with operands, rebuilds missing ones, and knows where the axis was.
//!
//! - **Walk:** a pipe's point → [`Feeder::offer`] → limits → the ring. [`Feeder::run`] at [`Feeder::needed_by`] rebuilds what is missing,
//!   and learns what the player did.
//! - **Invariants:** points enter the ring in order, without a gap, and only such that keep the limits and can be stopped from. What
//!   breaks one latches a [`Fault`]: nothing more enters. The player's own points are computed here again, exactly.
//! - **Context:** the task `serve`. **Clauses:** `[MOT-04]`, `[MOT-05]`, `[MOT-06]`, `[MOT-08]`, `[MOT-10]`.

use crate::axis::{ArmError, AxisConfig, ConfigError, Event, Fault, Order, Point, Start, StarvedCause};
use crate::history::History;
use crate::ring::PointsIn;
use fixed_math::limits::{Knot, Limits};
use fixed_math::spline::horner::Cubic;
use fixed_math::time::{NetTime, Span};
use heapless::spsc::{Consumer, Producer};

/// Points that are kept behind a missing one.
pub const HELD_MAX: usize = 16;

/// Why a point was not taken. Nothing has changed, but for a [`Refusal::Limit`], which latches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// The axis is not armed.
    NotArmed,
    /// The series ended without points: arm it anew.
    Starved {
        /// Why.
        cause: StarvedCause,
    },
    /// Its time is no multiple of the interval.
    OffGrid {
        /// Its time.
        time: NetTime,
        /// The interval.
        interval: Span,
    },
    /// It should have been here before.
    Late {
        /// When it was needed.
        needed_by: NetTime,
        /// Track time now.
        now: NetTime,
    },
    /// There is one of its time or of a later one, and no gap.
    NonMonotonic {
        /// Its time.
        time: NetTime,
        /// The newest one's time.
        newest: NetTime,
    },
    /// Too many points are missing before it.
    Gap {
        /// Points missing between the newest one and this.
        missing: u64,
        /// The most that may be.
        most: u64,
    },
    /// There is no room for it yet.
    Full {
        /// Points from the one that is played next to this one.
        needed: u64,
        /// Room.
        room: u64,
    },
    /// An earlier point broke a limit.
    Latched(Fault),
    /// This point breaks a limit.
    Limit(Fault),
}

/// A point was taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Accepted {
    /// Points that there is room for.
    pub free: u32,
    /// It is ahead of all before it: what a [`Watchdog`](crate::watch::Watchdog) is fed with.
    pub is_fresh: bool,
}

/// What happened to points since start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FeederCounters {
    /// Points taken.
    pub accepted: u32,
    /// [`Refusal::NotArmed`] and [`Refusal::Starved`].
    pub not_armed: u32,
    /// [`Refusal::OffGrid`].
    pub off_grid: u32,
    /// [`Refusal::Late`].
    pub late: u32,
    /// [`Refusal::NonMonotonic`].
    pub non_monotonic: u32,
    /// [`Refusal::Gap`].
    pub gap: u32,
    /// [`Refusal::Full`].
    pub full: u32,
    /// [`Refusal::Latched`].
    pub latched: u32,
    /// Limits broken, by points or by rebuilt ones.
    pub limit: u32,
    /// Missing points that were rebuilt.
    pub rebuilt: u32,
    /// Series that ended without points, for whatever cause.
    pub starved: u32,
}

/// What the feeder knows of its axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FeederState {
    /// Not armed: position means nothing.
    #[default]
    Unarmed,
    /// Takes points.
    Following,
    /// The player brakes.
    Stopping {
        /// Why.
        cause: StarvedCause,
    },
    /// The player rests.
    Resting {
        /// Why it stopped.
        cause: StarvedCause,
    },
}

/// Where an axis was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Motion {
    /// LSB.
    pub position: i32,
    /// Along the track, 2^−4 LSB an interval.
    pub velocity: i32,
    /// Along the track, 2^−4 LSB an interval².
    pub acceleration: i32,
    /// Along the track, LSB an interval³.
    pub jerk: i32,
}

/// The task's half of an axis.
pub struct Feeder<'a, const QUEUE: usize, const HISTORY: usize> {
    points: PointsIn<'a, QUEUE>,
    orders: Producer<'a, Order>,
    events: Consumer<'a, Event>,
    counters: FeederCounters,
    fault: Option<Fault>,
    state: FeederState,
    series: Option<Series>,
    history: History<HISTORY>,
}

/// Since the axis was armed. Points are counted from the one that it rested at.
#[derive(Clone, Copy, Debug)]
struct Series {
    config: AxisConfig,
    /// The configuration's, less the reserve.
    limits: Limits,
    /// Time of point 0.
    start: NetTime,
    /// Ring number of point 1.
    first: u32,
    /// The last point in the ring, or the last that the player is known to have made.
    front: u64,
    knot: Knot,
    /// Points behind missing ones: that of index i is at i modulo [`HELD_MAX`].
    held: [Option<i32>; HELD_MAX],
    /// The highest index that was taken.
    highest: u64,
    rebuilt_in_row: u8,
    rebuilt: u16,
    /// Track time leapt: the player's points are not where their indices say.
    has_leapt: bool,
}

impl Series {
    fn step(&self) -> u64 {
        u64::from(self.config.interval.steps())
    }

    fn time_of(&self, index: u64) -> NetTime {
        NetTime::from_steps(self.start.steps().saturating_add(index.saturating_mul(self.step())))
    }

    /// When the player takes point `index` at the earliest, less the lead.
    fn needed_by(&self, index: u64) -> NetTime {
        let early = 2 * self.step() + self.config.lead.steps();
        NetTime::from_steps(self.time_of(index).steps().saturating_sub(early))
    }

    #[expect(clippy::cast_possible_truncation, reason = "the low bits are what is wanted")]
    fn held_at(&mut self, index: u64) -> &mut Option<i32> {
        &mut self.held[index as usize % HELD_MAX]
    }
}

impl<'a, const QUEUE: usize, const HISTORY: usize> Feeder<'a, QUEUE, HISTORY> {
    pub(crate) fn new(points: PointsIn<'a, QUEUE>, orders: Producer<'a, Order>, events: Consumer<'a, Event>) -> Self {
        const {
            assert!(
                HISTORY >= QUEUE + 8,
                "the points in the ring, and four before them, are needed to tell what a player did"
            );
        };
        Self {
            points,
            orders,
            events,
            counters: FeederCounters::default(),
            fault: None,
            state: FeederState::Unarmed,
            series: None,
            history: History::new(),
        }
    }

    /// What the axis does, as far as the player has told.
    #[must_use]
    pub const fn state(&self) -> FeederState {
        self.state
    }

    /// What happened since start.
    #[must_use]
    pub const fn counters(&self) -> &FeederCounters {
        &self.counters
    }

    /// The limit that was broken, until it is cleared.
    #[must_use]
    pub const fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// Clears the fault. False while the axis may still move.
    pub fn clear_fault(&mut self) -> bool {
        let is_at_rest = matches!(self.state, FeederState::Unarmed | FeederState::Resting { .. });
        if is_at_rest {
            self.fault = None;
        }
        is_at_rest
    }

    /// Begins a series: the axis rests at `position` up to track time `start`, and the first point is one interval later.
    ///
    /// # Errors
    /// [`ArmError`]; nothing has changed.
    pub fn arm(&mut self, config: &AxisConfig, position: i32, start: NetTime, now: NetTime) -> Result<(), ArmError> {
        self.hear();
        match self.state {
            FeederState::Unarmed => {}
            FeederState::Resting { .. } => {
                let rests_at = self.series.map_or(position, |series| series.knot.position);
                if rests_at != position {
                    return Err(ArmError::Elsewhere { position, rests_at });
                }
            }
            FeederState::Following | FeederState::Stopping { .. } => return Err(ArmError::Moving),
        }
        if let Some(fault) = self.fault {
            return Err(ArmError::Latched(fault));
        }
        let limits = config.check().map_err(ArmError::Config)?;
        let step = u64::from(config.interval.steps());
        // a missing point is given up when at most three and those of the lead are before it
        let most = Span::from_steps(step * (QUEUE as u64 - 4));
        if config.lead > most {
            return Err(ArmError::Config(ConfigError::Lead { value: config.lead, most }));
        }
        if start.steps() & (step - 1) != 0 {
            return Err(ArmError::OffGrid { start, interval: Span::from_steps(step) });
        }
        let knot = limits.check_rest(position);
        let knot = knot.map_err(|violation| ArmError::Limit(Fault::new(start, false, violation)))?;
        let series = Series {
            config: *config,
            limits,
            start,
            first: self.points.next(),
            front: 0,
            knot,
            held: [None; HELD_MAX],
            highest: 0,
            rebuilt_in_row: 0,
            rebuilt: 0,
            has_leapt: false,
        };
        let needed_by = series.needed_by(1);
        if needed_by <= now {
            return Err(ArmError::Late { needed_by, now });
        }
        let order = Start {
            first: series.first,
            position,
            time: start,
            interval: config.interval,
            brake: *limits.brake(),
            policy: config.policy,
        };
        // there is room: the player has taken the order before, or it would not have come to rest
        self.orders.enqueue(Order::Start(order)).map_err(|_| ArmError::Moving)?;
        self.series = Some(series);
        self.history.restart(position);
        self.state = FeederState::Following;
        Ok(())
    }

    /// Gives the rest position no meaning any more, so that the axis can be armed at another. False where it does not rest.
    pub fn disarm(&mut self) -> bool {
        self.hear();
        if !matches!(self.state, FeederState::Resting { .. }) || self.orders.enqueue(Order::Disarm).is_err() {
            return matches!(self.state, FeederState::Unarmed);
        }
        self.state = FeederState::Unarmed;
        self.series = None;
        true
    }

    /// Gives the series up: the player brakes at its next beat, off the path if it has to.
    pub fn abandon(&mut self) -> bool {
        matches!(self.state, FeederState::Following) && self.orders.enqueue(Order::Abandon).is_ok()
    }

    /// Takes a point or refuses it; `now` is track time.
    ///
    /// # Errors
    /// [`Refusal`], counted.
    pub fn offer(&mut self, point: Point, now: NetTime) -> Result<Accepted, Refusal> {
        self.hear();
        let taken = self.take(point, now);
        self.count(taken.err());
        taken
    }

    /// When [`run`](Self::run) has something to do at the latest, if no point comes before.
    #[must_use]
    pub fn needed_by(&self) -> Option<NetTime> {
        let series = self.series.as_ref()?;
        (matches!(self.state, FeederState::Following) && self.fault.is_none())
            .then(|| series.needed_by(series.front + 1))
    }

    /// Hears what the player did, and rebuilds points that are missing at `now`, track time.
    pub fn run(&mut self, now: NetTime) {
        self.hear();
        while self.rebuild(now) {}
        self.retrace(now);
    }

    /// Where the axis was, or will be, at track time `at`. `None` before the history, beyond the points, and for a series in which time leapt.
    #[must_use]
    pub fn position_at(&self, at: NetTime) -> Option<Motion> {
        let series = self.series.as_ref().filter(|series| !series.has_leapt)?;
        let after = at.steps_after(series.start);
        let step = i64::from(series.config.interval.steps());
        let (index, since) = (after.div_euclid(step), after.rem_euclid(step));
        let is_over =
            matches!(self.state, FeederState::Resting { .. }) && index > self.history.newest().cast_signed() - 3;
        let mut points = [series.knot.position; 4];
        for (offset, point) in (-1..).zip(&mut points).filter(|_| !is_over) {
            *point = self.history.get(index.saturating_add(offset))?;
        }
        let cubic = Cubic::new(points).ok()?;
        let part = series.config.interval.part(u32::try_from(since).ok()?);
        let (position, velocity) = cubic.position_velocity(part);
        let (acceleration, jerk) = (cubic.acceleration(part), cubic.jerk());
        Some(Motion { position, velocity, acceleration, jerk })
    }

    /// Points that there is room for.
    #[must_use]
    pub fn free(&self) -> u32 {
        u32::try_from(QUEUE).unwrap_or(u32::MAX).saturating_sub(self.points.waiting())
    }

    /// From when to when [`position_at`](Self::position_at) knows the track, track time. An axis rested before its series, and rests after it.
    #[must_use]
    pub fn history(&self) -> Option<(NetTime, NetTime)> {
        let series = self.series.as_ref()?;
        let oldest = self.history.oldest();
        // the segment from point i on takes those from i − 1 to i + 2
        let from = series.time_of(if oldest == 0 { 0 } else { oldest + 1 });
        Some((from, series.time_of(self.history.newest().saturating_sub(1)).max(from)))
    }

    fn count(&mut self, refusal: Option<Refusal>) {
        let counters = &mut self.counters;
        let counter = match refusal {
            None => &mut counters.accepted,
            Some(Refusal::NotArmed | Refusal::Starved { .. }) => &mut counters.not_armed,
            Some(Refusal::OffGrid { .. }) => &mut counters.off_grid,
            Some(Refusal::Late { .. }) => &mut counters.late,
            Some(Refusal::NonMonotonic { .. }) => &mut counters.non_monotonic,
            Some(Refusal::Gap { .. }) => &mut counters.gap,
            Some(Refusal::Full { .. }) => &mut counters.full,
            Some(Refusal::Latched(_)) => &mut counters.latched,
            // counted where it was latched
            Some(Refusal::Limit(_)) => return,
        };
        *counter = counter.saturating_add(1);
    }

    fn take(&mut self, point: Point, now: NetTime) -> Result<Accepted, Refusal> {
        let index = self.admit(point, now)?;
        let Some(series) = &mut self.series else { return Err(Refusal::NotArmed) };
        let is_fresh = index > series.highest;
        series.highest = series.highest.max(index);
        if index == series.front + 1 {
            self.append(point.position, false).map_err(Refusal::Limit)?;
            self.release_held();
        } else {
            *series.held_at(index) = Some(point.position);
        }
        Ok(Accepted { free: self.free(), is_fresh })
    }

    /// The index of a point that may be taken.
    fn admit(&mut self, point: Point, now: NetTime) -> Result<u64, Refusal> {
        match self.state {
            FeederState::Unarmed => return Err(Refusal::NotArmed),
            FeederState::Stopping { cause } | FeederState::Resting { cause } => return Err(Refusal::Starved { cause }),
            FeederState::Following => {}
        }
        if let Some(fault) = self.fault {
            return Err(Refusal::Latched(fault));
        }
        let waiting = u64::from(self.points.waiting());
        let Some(series) = &mut self.series else { return Err(Refusal::NotArmed) };
        let Point { time, .. } = point;
        let step = series.step();
        if time.steps() & (step - 1) != 0 {
            return Err(Refusal::OffGrid { time, interval: Span::from_steps(step) });
        }
        // both are multiples of the interval, a power of two
        let index = time.since(series.start).steps() >> step.trailing_zeros();
        let needed_by = series.needed_by(index);
        if needed_by <= now {
            return Err(Refusal::Late { needed_by, now });
        }
        let newest = series.time_of(series.highest);
        if index <= series.front || (index <= series.highest && series.held_at(index).is_some()) {
            return Err(Refusal::NonMonotonic { time, newest });
        }
        let most = u64::from(series.config.missing_max);
        let missing = index.saturating_sub(series.highest + 1);
        if missing > most {
            return Err(Refusal::Gap { missing, most });
        }
        let ahead = index - series.front;
        let (needed, room) = (waiting + ahead, QUEUE as u64);
        if needed > room {
            return Err(Refusal::Full { needed, room });
        }
        let room = HELD_MAX as u64;
        if ahead > room { Err(Refusal::Full { needed: ahead, room }) } else { Ok(index) }
    }

    /// Puts the next point into the ring, or latches why not. False where there is no room.
    fn append(&mut self, position: i32, is_rebuilt: bool) -> Result<bool, Fault> {
        let Some(series) = &mut self.series else { return Ok(false) };
        let index = series.front + 1;
        let checked = series.limits.check(series.knot, position);
        let knot = checked.map_err(|violation| Fault::new(series.time_of(index), is_rebuilt, violation));
        let knot = knot.inspect_err(|fault| {
            self.fault = Some(*fault);
            self.counters.limit = self.counters.limit.saturating_add(1);
        })?;
        // there is room: `admit` has counted it, and a rebuilt point comes when the ring is all but empty
        let is_in = self.points.push(position);
        if is_in {
            series.front = index;
            series.highest = series.highest.max(index);
            series.knot = knot;
            self.history.push(position);
            series.rebuilt_in_row = if is_rebuilt { series.rebuilt_in_row.saturating_add(1) } else { 0 };
        }
        Ok(is_in)
    }

    /// Moves held points on whose gap is closed.
    fn release_held(&mut self) {
        while let Some(series) = &mut self.series {
            let next = series.front + 1;
            let Some(position) = series.held_at(next).take() else { return };
            if self.append(position, false) != Ok(true) {
                return;
            }
        }
    }

    /// `[MOT-05]`: rebuilds the next point if it is due and may be; true if it did.
    fn rebuild(&mut self, now: NetTime) -> bool {
        if self.needed_by().is_none_or(|due| due > now) {
            return false;
        }
        let Some(series) = &mut self.series else { return false };
        if series.knot.is_at_rest() && series.held.iter().all(Option::is_none) {
            // the series has ended, and nothing is missing
            return false;
        }
        let may = series.rebuilt_in_row < series.config.missing_max && series.rebuilt < series.config.rebuilt_max;
        if !may {
            return false;
        }
        let Some(position) = Self::rebuilt(series) else { return false };
        series.rebuilt += 1;
        self.counters.rebuilt = self.counters.rebuilt.saturating_add(1);
        let is_in = self.append(position, true) == Ok(true);
        if is_in {
            self.release_held();
        }
        is_in
    }

    /// (−P₋₂ + 4P₋₁ + 4P₊₁ − P₊₂)/6 to the nearest between neighbours, 3P₋₁ − 3P₋₂ + P₋₃ where there are none behind it.
    fn rebuilt(series: &mut Series) -> Option<i32> {
        let Knot { position, velocity, acceleration } = series.knot;
        let (last, velocity) = (i64::from(position), i64::from(velocity));
        let behind = (*series.held_at(series.front + 2), *series.held_at(series.front + 3));
        let between = match behind {
            (Some(first), Some(second)) => {
                let sum = -(last - velocity) + 4 * last + 4 * i64::from(first) - i64::from(second);
                (sum + 3).div_euclid(6)
            }
            // P₋₁ + δ + δ²
            _ => last + velocity + i64::from(acceleration),
        };
        i32::try_from(between).ok()
    }

    /// Takes the player's events.
    fn hear(&mut self) {
        while let Some(event) = self.events.dequeue() {
            match (event, self.state) {
                (Event::Starved { number, cause }, FeederState::Following) => {
                    self.counters.starved = self.counters.starved.saturating_add(1);
                    self.state = FeederState::Stopping { cause };
                    self.go_back_to(number);
                }
                (Event::Leapt, _) => {
                    if let Some(series) = &mut self.series {
                        series.has_leapt = true;
                    }
                }
                (Event::Rested, FeederState::Stopping { cause }) => {
                    self.retrace(NetTime::MAX);
                    self.state = FeederState::Resting { cause };
                }
                _ => {}
            }
        }
    }

    /// Points from ring number `number` on were not played.
    fn go_back_to(&mut self, number: u32) {
        let Some(series) = &mut self.series else { return };
        // what the ring still holds is less than 2^16 points
        let dropped = series.first.wrapping_add(low(series.front)).wrapping_sub(number);
        series.front = series.front.saturating_sub(u64::from(dropped));
        series.held = [None; HELD_MAX];
        self.history.cut(series.front);
        let point = |back: i64| self.history.get(series.front.cast_signed() - back).unwrap_or(series.knot.position);
        let (velocity, before) = (point(0).wrapping_sub(point(1)), point(1).wrapping_sub(point(2)));
        series.knot = Knot { position: point(0), velocity, acceleration: velocity.wrapping_sub(before) };
    }

    /// Makes the points that the player has made by braking, as far as `now` needs them or to rest.
    fn retrace(&mut self, now: NetTime) {
        let Some(series) = &mut self.series else { return };
        if !matches!(self.state, FeederState::Stopping { .. }) {
            return;
        }
        while series.time_of(series.front) <= now + Span::from_steps(3 * series.step()) {
            if series.knot.is_at_rest()
                && self.history.get(self.history.newest().cast_signed() - 3) == Some(series.knot.position)
            {
                return;
            }
            series.knot = series.limits.brake().next(series.knot);
            series.front += 1;
            self.history.push(series.knot.position);
        }
    }
}

#[expect(clippy::cast_possible_truncation, reason = "the low bits are what is wanted")]
const fn low(index: u64) -> u32 {
    index as u32
}

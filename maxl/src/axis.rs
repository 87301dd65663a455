//! One axis: its configuration, its rings, and what its two halves tell each other.
//!
//! - **Walk:** [`AxisRings::split`] once at start → a [`Feeder`] for the task `serve`, a [`Player`] for the highest-priority task.
//! - **Invariants:** the halves share points, starts and what became of them, each through a ring of its own with one writer.
//! - **Context:** static memory.

use crate::feeder::Feeder;
use crate::player::Player;
use crate::ring::PointRing;
use fixed_math::brake::Brake;
use fixed_math::limits::{LimitKind, Limits, LimitsError, Violation};
use fixed_math::spline::IntervalLog2;
use fixed_math::time::{NetTime, Span};
use fixed_math::warp::{Warp, WarpTooShort};
use heapless::spsc::Queue;

/// Most points in a row that may be rebuilt.
pub const MISSING_MAX: u8 = 8;
/// Longest time by which points may have to come early, intervals.
pub const LEAD_INTERVALS_MAX: u64 = 64;

/// A control point: where the track's spline is drawn to at `time`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Point {
    /// Track time, a multiple of the interval.
    pub time: NetTime,
    /// LSB of the track.
    pub position: i32,
}

/// What an axis does when it has come to rest without points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StarvedPolicy {
    /// Stays, and keeps its output on.
    #[default]
    Stop,
    /// As [`Stop`](Self::Stop), and says so: its output may lower currents to what holding takes.
    Hold,
    /// Lets go: the output is to take the least energy.
    Relax,
}

/// Why a player went on without its feeder's points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StarvedCause {
    /// The next point was not there when it was needed.
    NoPoint,
    /// Track time leapt, forwards or back, by more than the player follows.
    Leapt,
    /// The feeder gave the series up: [`Feeder::abandon`].
    Abandoned,
}

/// A point, one's own or rebuilt, that broke a limit. Latched until it is cleared at rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// When the point would have been.
    pub point_time: NetTime,
    /// Which limit.
    pub limit: LimitKind,
    /// The stop that would have to follow breaks it, not the point itself.
    pub is_of_stop: bool,
    /// The point was missing and this is its rebuilt one.
    pub is_rebuilt: bool,
    /// What it came to, in differences, saturated to 32 bits.
    pub value: i32,
    /// What it may be at the most, or for a least position at the least.
    pub bound: i32,
}

impl Fault {
    pub(crate) const fn new(point_time: NetTime, is_rebuilt: bool, violation: Violation) -> Self {
        let Violation { limit, is_of_stop, value, bound } = violation;
        Self { point_time, limit, is_of_stop, is_rebuilt, value, bound }
    }
}

/// What an axis is armed with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisConfig {
    /// Time between points.
    pub interval: IntervalLog2,
    /// What the axis can do, in differences of that interval. Points are checked against these less the reserve of `warp`.
    pub limits: Limits,
    /// The node's stop along the path.
    pub warp: Warp,
    /// What to do without points.
    pub policy: StarvedPolicy,
    /// Most points in a row that are rebuilt, at most [`MISSING_MAX`].
    pub missing_max: u8,
    /// Most points that are rebuilt in a series.
    pub rebuilt_max: u16,
    /// How long before the player needs it a missing point is given up and rebuilt: what the feeder's task may be late.
    pub lead: Span,
}

/// Why a configuration is none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConfigError {
    /// The stop along the path would break the limits, or leave nothing of them.
    Warp(WarpTooShort),
    /// More points in a row would be rebuilt than can be.
    MissingMax {
        /// How many.
        value: u8,
        /// The most.
        most: u8,
    },
    /// Points would have to come too early.
    Lead {
        /// How early.
        value: Span,
        /// The most.
        most: Span,
    },
}

impl From<LimitsError> for ConfigError {
    fn from(error: LimitsError) -> Self {
        Self::Warp(WarpTooShort { error, least_log2: None })
    }
}

impl AxisConfig {
    /// The limits that points have to keep.
    ///
    /// # Errors
    /// [`ConfigError`], with what is out of range.
    pub fn check(&self) -> Result<Limits, ConfigError> {
        if self.missing_max > MISSING_MAX {
            return Err(ConfigError::MissingMax { value: self.missing_max, most: MISSING_MAX });
        }
        let most = Span::from_steps(u64::from(self.interval.steps()) * LEAD_INTERVALS_MAX);
        if self.lead > most {
            return Err(ConfigError::Lead { value: self.lead, most });
        }
        self.warp.limits_within(&self.limits, self.interval).map_err(ConfigError::Warp)
    }
}

/// Why an axis was not armed. Nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmError {
    /// It plays, or has not come to rest yet.
    Moving,
    /// A fault is latched: clear it first.
    Latched(Fault),
    /// The configuration is none.
    Config(ConfigError),
    /// The start is no multiple of the interval.
    OffGrid {
        /// The start.
        start: NetTime,
        /// The interval.
        interval: Span,
    },
    /// The first point would be needed already.
    Late {
        /// When the first point would be needed.
        needed_by: NetTime,
        /// Track time now.
        now: NetTime,
    },
    /// The axis rests elsewhere. Arm it there, or disarm it first to give its position a new meaning.
    Elsewhere {
        /// Where it was to be armed.
        position: i32,
        /// Where it rests.
        rests_at: i32,
    },
    /// The position is outside of the limits.
    Limit(Fault),
}

/// From the feeder: a series begins.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Start {
    /// Number of its first point in the ring, the one after `time`.
    pub(crate) first: u32,
    /// Where it rests until then.
    pub(crate) position: i32,
    /// Its last point at rest.
    pub(crate) time: NetTime,
    pub(crate) interval: IntervalLog2,
    pub(crate) brake: Brake,
    pub(crate) policy: StarvedPolicy,
}

/// From the feeder.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Order {
    Start(Start),
    /// The rest position has no meaning any more.
    Disarm,
    /// No more points of this series are played.
    Abandon,
}

/// From the player.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Event {
    /// From the point of this number on, points are the player's own.
    Starved { number: u32, cause: StarvedCause },
    /// Track time leapt while it braked: its points are not where their indices say. Once a series.
    Leapt,
    /// All points are at one position.
    Rested,
}

/// What the two halves of an axis share: room for `QUEUE` points, a power of two.
#[derive(Debug)]
pub struct AxisRings<const QUEUE: usize> {
    points: PointRing<QUEUE>,
    orders: Queue<Order, 4>,
    events: Queue<Event, 4>,
}

impl<const QUEUE: usize> AxisRings<QUEUE> {
    /// Empty ones.
    #[must_use]
    pub const fn new() -> Self {
        Self { points: PointRing::new(), orders: Queue::new(), events: Queue::new() }
    }

    /// The half of the task and the half of the interrupt. The feeder remembers `HISTORY` points, a power of two of at least `QUEUE` + 8.
    pub fn split<const HISTORY: usize>(&mut self) -> (Feeder<'_, QUEUE, HISTORY>, Player<'_, QUEUE>) {
        let (points_in, points_out) = self.points.split();
        let (orders_in, orders_out) = self.orders.split();
        let (events_in, events_out) = self.events.split();
        (Feeder::new(points_in, orders_in, events_out), Player::new(points_out, orders_out, events_in))
    }
}

impl<const QUEUE: usize> Default for AxisRings<QUEUE> {
    fn default() -> Self {
        Self::new()
    }
}

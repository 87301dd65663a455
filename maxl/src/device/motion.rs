//! The task's half of a device: messages become points, settings and orders; what went wrong becomes a halt.
//!
//! - **Walk:** a request → *here* → a feeder's ring, an order's ring; [`Motion::run`] at least every [`RUN_US_MAX`] → the time for the
//!   interpolator, rebuilt points, and whether to halt.
//! - **Invariants:** whatever is refused has changed nothing. Settings are taken at rest. A halt is wanted once for each cause.
//! - **Context:** the task `serve`. **Clauses:** `[MOT-04]` to `[MOT-14]`, `[MOT-24]`.

use super::{AXES, Drive, HISTORY, INPUTS, LEVELS, NODES, OUTPUTS, Order, QUEUE, RAMPS, TRIGGERS, ToldOfAll};
use crate::axis::{ArmError, AxisConfig, ConfigError, Fault, Point};
use crate::clock::{HaltError, MotionClock, MotionState};
use crate::feeder::{Accepted, Feeder, FeederCounters, FeederState, Motion as MotionAt, Refusal};
use crate::tracks::{LevelFeeder, RampFeeder, TrackRefusal};
use crate::triggers::{Reading, ReadingsOut, Trigger};
use crate::watch::{ClockFault, ClockGuard, ClockHealth, Watchdog};
use core::sync::atomic::Ordering;
use fixed_math::clock::SlewedMap;
use fixed_math::level::Level;
use fixed_math::logic::{Graph, GraphError, Node};
use fixed_math::ramp::Ramp;
use fixed_math::spline::IntervalLog2;
use fixed_math::time::{NetTime, Span};
use fixed_math::warp::Warp;
use heapless::spsc::Producer;

/// [`Motion::run`] wants to be called so often while an axis is armed, µs: a fifth of what a time may be old.
pub const RUN_US_MAX: u64 = 20_000;
/// A moving axis without a fresh point for longer is halted, `[MOT-11]`.
pub const FRESH_MAX: Span = Span::from_us(500_000);
/// A clock less sure than this is not moved by, `[MOT-11]`.
pub const CLOCK_BOUND_MAX: Span = Span::from_us(1_000);
/// A clock may be without its root for so long.
pub const CLOCK_LOST_MAX: Span = Span::from_us(3_000_000);

/// Why all motion is to be halted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HaltCause {
    /// An axis broke a limit.
    Fault {
        /// Which axis.
        axis: u8,
        /// How.
        fault: Fault,
    },
    /// No fresh point came for too long.
    Silence {
        /// For which axis.
        axis: u8,
    },
    /// The clock cannot be relied on.
    Clock(ClockFault),
}

/// Why a setting was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SettingError {
    /// There is no such axis, node, output or trigger.
    NoSuch {
        /// What was named.
        index: u8,
        /// How many there are.
        count: usize,
    },
    /// The axis, or for the time of stops any axis, may still move.
    Moving,
    /// The configuration is none.
    Config(ConfigError),
    /// A node that cannot be.
    Node(GraphError),
    /// The interrupt has not taken the orders before yet: send it again.
    Busy,
}

/// An axis as it is seen from the task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisView {
    /// What the feeder knows.
    pub state: FeederState,
    /// What the interrupt said last, as a number of [`PlayerState`](crate::player::PlayerState).
    pub played: u32,
    /// Where it was then.
    pub position: i32,
    /// Steps that were late.
    pub steps_late: u32,
    /// The fault that is latched.
    pub fault: Option<Fault>,
    /// What happened.
    pub counters: FeederCounters,
    /// Room for points.
    pub free: u32,
    /// Time of the last point that was taken.
    pub last: NetTime,
}

/// One axis.
struct AxisIn<'a> {
    feeder: Feeder<'a, QUEUE, HISTORY>,
    config: Option<AxisConfig>,
    /// Where it is to be armed, with the first point.
    armed_at: Option<i32>,
    watchdog: Watchdog,
    /// The fault was told as a cause of a halt.
    is_told: bool,
    last: NetTime,
}

/// The half.
pub struct Motion<'a> {
    axes: [AxisIn<'a>; AXES],
    clock: MotionClock<'a>,
    ramps: [RampFeeder<'a>; RAMPS],
    levels: [LevelFeeder<'a>; LEVELS],
    readings: ReadingsOut<'a>,
    orders: Producer<'a, Order>,
    told: &'a ToldOfAll,
    guard: ClockGuard,
    is_clock_told: bool,
    /// What the interrupt's graph is, to check nodes against.
    graph: Graph<NODES>,
}

impl<'a> Motion<'a> {
    pub(super) fn new(
        feeders: [Feeder<'a, QUEUE, HISTORY>; AXES],
        clock: MotionClock<'a>,
        (ramps, levels): ([RampFeeder<'a>; RAMPS], [LevelFeeder<'a>; LEVELS]),
        readings: ReadingsOut<'a>,
        orders: Producer<'a, Order>,
        told: &'a ToldOfAll,
    ) -> Self {
        let axes = feeders.map(|feeder| AxisIn {
            feeder,
            config: None,
            armed_at: None,
            watchdog: Watchdog::new(FRESH_MAX),
            is_told: false,
            last: NetTime::ZERO,
        });
        let guard = ClockGuard::new(CLOCK_BOUND_MAX, CLOCK_LOST_MAX);
        let graph = Graph::new(INPUTS).expect("few inputs");
        Self { axes, clock, ramps, levels, readings, orders, told, guard, is_clock_told: false, graph }
    }

    fn axis(&mut self, axis: u8) -> Result<&mut AxisIn<'a>, SettingError> {
        self.axes.get_mut(usize::from(axis)).ok_or(SettingError::NoSuch { index: axis, count: AXES })
    }

    /// Settings of an axis, for when it is armed next, and what moves its motor.
    ///
    /// # Errors
    /// [`SettingError`].
    pub fn configure(&mut self, axis: u8, config: &AxisConfig, drive: Drive) -> Result<(), SettingError> {
        let moves =
            |it: &AxisIn<'_>| matches!(it.feeder.state(), FeederState::Following | FeederState::Stopping { .. });
        let index = usize::from(axis);
        self.axis(axis)?;
        let others_move = self.axes.iter().enumerate().any(|(at, it)| at != index && moves(it));
        // one time of stops for all axes: it may change only while none relies on it
        if moves(&self.axes[index]) || (others_move && config.warp != *self.clock.warp()) {
            return Err(SettingError::Moving);
        }
        config.check().map_err(SettingError::Config)?;
        self.orders.enqueue(Order::Drive { axis, drive }).map_err(|_| SettingError::Busy)?;
        self.clock.set_warp(config.warp);
        self.axes[index].config = Some(*config);
        Ok(())
    }

    /// Makes ready to take points: the axis rests at `position`.
    ///
    /// # Errors
    /// [`ArmError`]; `None` in its place where the axis has no settings.
    pub fn arm(&mut self, axis: u8, position: i32) -> Result<(), Option<ArmError>> {
        let warp = *self.clock.warp();
        let Ok(it) = self.axis(axis) else { return Err(None) };
        let config = it.config.as_mut().ok_or(None)?;
        config.warp = warp;
        match it.feeder.state() {
            FeederState::Following | FeederState::Stopping { .. } => return Err(Some(ArmError::Moving)),
            FeederState::Unarmed | FeederState::Resting { .. } => {}
        }
        if let Some(fault) = it.feeder.fault() {
            return Err(Some(ArmError::Latched(fault)));
        }
        it.feeder.disarm();
        it.armed_at = Some(position);
        Ok(())
    }

    /// Takes a point; `now` is system time. An axis that was made ready is armed by its first point, one interval before it.
    ///
    /// # Errors
    /// [`Refusal`], or [`ArmError`] where it is the first.
    pub fn offer(&mut self, axis: u8, point: Point, now: NetTime) -> Result<Accepted, OfferError> {
        let track_now = self.clock.track_time(now).time;
        let it = self.axis(axis).map_err(OfferError::Setting)?;
        if let (Some(position), Some(config)) = (it.armed_at, &it.config) {
            let interval = config.interval.steps();
            let start = point.time.shifted(-i64::from(interval));
            it.feeder.arm(config, position, start, track_now).map_err(OfferError::Arm)?;
            it.armed_at = None;
        }
        let accepted = it.feeder.offer(point, track_now).map_err(OfferError::Refused)?;
        it.last = it.last.max(point.time);
        it.watchdog.feed(point.time, now);
        Ok(accepted)
    }

    /// The earliest point that `axis` would still take; for a refusal.
    #[must_use]
    pub fn track_time(&self, now: NetTime) -> NetTime {
        self.clock.track_time(now).time
    }

    /// An axis.
    #[must_use]
    pub fn view(&self, axis: u8) -> Option<AxisView> {
        let at = usize::from(axis);
        let (it, told) = (self.axes.get(at)?, self.told.axes.get(at)?);
        Some(AxisView {
            state: it.feeder.state(),
            played: told.state.load(Ordering::Relaxed),
            position: told.position.load(Ordering::Relaxed),
            steps_late: told.steps_late.load(Ordering::Relaxed),
            fault: it.feeder.fault(),
            counters: *it.feeder.counters(),
            free: it.feeder.free(),
            last: it.last,
        })
    }

    /// Time between the points of an axis, once it has settings.
    #[must_use]
    pub fn interval(&self, axis: u8) -> Option<IntervalLog2> {
        self.axes.get(usize::from(axis))?.config.map(|config| config.interval)
    }

    /// Whether an axis is ready for its first point.
    #[must_use]
    pub fn is_ready(&self, axis: u8) -> bool {
        self.axes.get(usize::from(axis)).is_some_and(|it| it.armed_at.is_some())
    }

    /// Where an axis was at a system time.
    #[must_use]
    pub fn motion_at(&self, axis: u8, system: NetTime) -> Option<MotionAt> {
        let track = self.clock.track_time(system).time;
        self.axes.get(usize::from(axis))?.feeder.position_at(track)
    }

    /// System times between which [`Motion::motion_at`] knows an axis, as far as no halt lies between.
    #[must_use]
    pub fn history_of(&self, axis: u8, now: NetTime) -> Option<(NetTime, NetTime)> {
        let delay = now.since(self.clock.track_time(now).time);
        let (from, to) = self.axes.get(usize::from(axis))?.feeder.history()?;
        Some((from + delay, to + delay))
    }

    /// Forgets a fault; false while the axis may move.
    ///
    /// # Errors
    /// [`SettingError::NoSuch`].
    pub fn clear_fault(&mut self, axis: u8) -> Result<bool, SettingError> {
        let it = self.axis(axis)?;
        let is_cleared = it.feeder.clear_fault();
        it.is_told &= !is_cleared;
        Ok(is_cleared)
    }

    /// A ramp for a track; `now` is system time.
    ///
    /// # Errors
    /// [`TrackRefusal`]; `None` where there is no such track.
    pub fn ramp(&mut self, track: u8, ramp: &Ramp, now: NetTime) -> Result<(), Option<TrackRefusal>> {
        let now = self.clock.track_time(now).time;
        self.ramps.get_mut(usize::from(track)).ok_or(None)?.offer(ramp, now).map_err(Some)
    }

    /// A level for a track; `now` is system time.
    ///
    /// # Errors
    /// [`TrackRefusal`]; `None` where there is no such track.
    pub fn level(&mut self, track: u8, level: Level, now: NetTime) -> Result<(), Option<TrackRefusal>> {
        let now = self.clock.track_time(now).time;
        self.levels.get_mut(usize::from(track)).ok_or(None)?.offer(level, now).map_err(Some)
    }

    /// A node of the signals.
    ///
    /// # Errors
    /// [`SettingError`].
    pub fn set_node(&mut self, index: u8, node: Node) -> Result<(), SettingError> {
        if !self.orders.ready() {
            return Err(SettingError::Busy);
        }
        self.graph.set(usize::from(index), node).map_err(SettingError::Node)?;
        self.order(Order::SetNode { index, node })
    }

    /// Has an output follow a node, or stay low.
    ///
    /// # Errors
    /// [`SettingError`].
    pub fn set_output(&mut self, output: u8, node: Option<u8>) -> Result<(), SettingError> {
        in_range(output, OUTPUTS)?;
        node.map_or(Ok(()), |node| in_range(node, NODES))?;
        self.order(Order::SetOutput { output, node })
    }

    /// When a channel is read. A trigger's signal is 1 where its node is true, else 0.
    ///
    /// # Errors
    /// [`SettingError`].
    pub fn set_trigger(
        &mut self,
        trigger: u8,
        channel: u8,
        node: u8,
        what: Option<Trigger>,
    ) -> Result<(), SettingError> {
        in_range(trigger, TRIGGERS)?;
        in_range(node, NODES)?;
        self.order(Order::SetTrigger { trigger, channel, node, what })
    }

    fn order(&mut self, order: Order) -> Result<(), SettingError> {
        self.orders.enqueue(order).map_err(|_| SettingError::Busy)
    }

    /// Follows a halt of the network; `now` is system time.
    ///
    /// # Errors
    /// [`HaltError`].
    pub fn halt(&mut self, is_stop: bool, sequence: u32, epoch: NetTime, now: NetTime) -> Result<(), HaltError> {
        if is_stop { self.clock.stop(sequence, epoch, now) } else { self.clock.resume(sequence, epoch, now) }
    }

    /// What track time does.
    #[must_use]
    pub fn state(&self, now: NetTime) -> MotionState {
        self.clock.state(now)
    }

    /// System time less track time.
    #[must_use]
    pub fn delay(&self, now: NetTime) -> Span {
        now.since(self.clock.track_time(now).time)
    }

    /// Whether an axis moves or may: system time is not to be set, and a halt means something.
    #[must_use]
    pub fn is_live(&self) -> bool {
        let is_live =
            |it: &AxisIn<'_>| matches!(it.feeder.state(), FeederState::Following | FeederState::Stopping { .. });
        self.axes.iter().any(is_live)
    }

    /// Tells the interrupt the time, rebuilds what is missing; why to halt, if there is a new reason. To be called at least every
    /// [`RUN_US_MAX`] while an axis is armed.
    pub fn run(&mut self, map: &SlewedMap, health: &ClockHealth, now: NetTime) -> Option<HaltCause> {
        // where the interrupt has not taken the former yet, that is as good
        let _told = self.orders.enqueue(Order::Time(*map));
        self.clock.run();
        let track = self.clock.track_time(now).time;
        for it in &mut self.axes {
            it.feeder.run(track);
        }
        let stands = !matches!(self.clock.state(now), MotionState::Running | MotionState::Resuming);
        let is_live = self.is_live();
        let mut cause = None;
        for (axis, it) in (0..).zip(&mut self.axes) {
            if let Some(fault) = it.feeder.fault()
                && !core::mem::replace(&mut it.is_told, true)
            {
                cause = cause.or(Some(HaltCause::Fault { axis, fault }));
            }
            if stands || !matches!(it.feeder.state(), FeederState::Following) {
                it.watchdog.rest();
            } else if it.watchdog.is_expired(now) {
                cause = cause.or(Some(HaltCause::Silence { axis }));
            }
        }
        match self.guard.check(health, now) {
            Ok(()) => self.is_clock_told = false,
            Err(fault) if is_live && !stands && !self.is_clock_told => {
                self.is_clock_told = true;
                cause = cause.or(Some(HaltCause::Clock(fault)));
            }
            Err(_) => {}
        }
        cause
    }

    /// When a point will have to be rebuilt at the latest, system time: [`Motion::run`] wants to be called then.
    #[must_use]
    pub fn needed_by(&self, now: NetTime) -> Option<NetTime> {
        let delay = self.delay(now);
        self.axes.iter().filter_map(|it| it.feeder.needed_by()).min().map(|at| at + delay)
    }

    /// The oldest reading that waits.
    pub fn take_reading(&mut self) -> Option<Reading> {
        self.readings.take()
    }

    /// Readings that wait.
    #[must_use]
    pub fn readings_waiting(&self) -> usize {
        self.readings.waiting()
    }

    /// Readings that found no room.
    #[must_use]
    pub fn readings_lost(&self) -> u32 {
        self.readings.overflows()
    }

    /// Stops of the device.
    #[must_use]
    pub const fn warp(&self) -> &Warp {
        self.clock.warp()
    }

    /// Beats since start, how late the last one was in steps of 1/256 µs, and whether beats are where they should be.
    #[must_use]
    pub fn beats(&self) -> (u32, i32, bool) {
        let ToldOfAll { beats, late_steps, is_locked, .. } = self.told;
        let is_locked = is_locked.load(Ordering::Relaxed) != 0;
        (beats.load(Ordering::Relaxed), late_steps.load(Ordering::Relaxed), is_locked)
    }
}

/// Why a point was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OfferError {
    /// There is no such axis.
    Setting(SettingError),
    /// It was the first, and the axis could not be armed by it.
    Arm(ArmError),
    /// It was refused.
    Refused(Refusal),
}

fn in_range(index: u8, count: usize) -> Result<(), SettingError> {
    if usize::from(index) < count { Ok(()) } else { Err(SettingError::NoSuch { index, count }) }
}

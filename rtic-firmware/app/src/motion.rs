//! The motion port: messages to tracks, refusals with their operands, readings back, halts both ways.
//!
//! - **Walk:** port of type `motion` → [`MotionService::accept`] → [`Motion`] → rings → the [`Interpolator`] of the highest-priority task.
//!   [`MotionService::poll`] tells the interpolator the time, follows halts of the network and raises its own.
//! - **Invariants:** what is refused has changed nothing; a request is answered whatever it was; a datagram of points is answered only by
//!   a refusal. While an axis is live, system time is slewed and never set.
//! - **Context:** the serving task. **Clauses:** `[MOT-01]` to `[MOT-14]`, `[MOT-20]` to `[MOT-25]`.

mod answer;

use crate::echo::route_back;
use answer::fault_of;
use fixed_math::level::Level;
use fixed_math::limits::{Curve, Limits};
use fixed_math::logic::Node;
use fixed_math::phase::PhaseWindow;
use fixed_math::ramp::Ramp;
use fixed_math::spline::IntervalLog2;
use fixed_math::time::{LocalTicks, NetTime, Span};
use fixed_math::warp::Warp;
use osap_maxl::axis::{AxisConfig, MISSING_MAX, Point, StarvedPolicy};
use osap_maxl::clock::HaltError;
use osap_maxl::device::{
    AXES, Drive, HISTORY, HaltCause, Interpolator, LEVELS, Motion, OUTPUTS, QUEUE, RAMPS, RUN_US_MAX, TRIGGERS,
};
use osap_maxl::triggers::{Edge, Trigger};
use osap_maxl::watch::ClockHealth;
use osap_protocol::halt::{Action, Halt};
use osap_protocol::motion::{
    AxisSettings, AxisState, AxisStatus, CurveSettings, HaltReason, MOTION_VERSION, Message, MotionRefusal,
    MotionReply, MotionRequest, PointsRef, READINGS_OPERATION, REFUSAL_OPERATION, REPLY_BYTES_MAX, ReadingMessage,
    TriggerSettings,
};
use osap_protocol::transport::{SequencedKind, Transport};
use osap_protocol::{DropCause, PortIndex, RouteBuf};
use osap_runtime::{Delivery, Mailbox, Outbound};

/// From a cause to the epoch of the halt that a device raises: time for the halt to reach all others, µs.
pub const HALT_LEAD_US: u64 = 20_000;
/// Longest lead of a halt that is asked for, µs.
pub const HALT_LEAD_US_MAX: u32 = 1_000_000;
/// Most readings of one datagram.
pub const READINGS_A_PACKET: usize = 8;
/// Time to live of a datagram of readings, µs.
const READINGS_TTL_US: u16 = 20_000;
/// How long before it is needed a missing point is rebuilt, µs: what this task may be late.
const REBUILD_LEAD_US: u64 = 2_000;
/// From one beat to the next where no interrupt plays, µs: more than one in the shortest interval.
pub const PLAYED_HERE_US: u64 = 200;
/// Missing points rebuilt in a series at most.
const REBUILT_MAX: u16 = 1_000;

/// What a board has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MotionTraits {
    /// From one beat to the next, µs.
    pub beat_us: u8,
    /// Channels that can be read.
    pub channels: u8,
    /// Whether the first axis is driven by phases and not by steps.
    pub has_phases: bool,
}

/// Who gets readings.
#[derive(Debug)]
struct Watcher {
    back: RouteBuf,
    port: PortIndex,
    mtu_bytes: u16,
}

/// The service.
pub struct MotionService {
    motion: Motion<'static>,
    traits: MotionTraits,
    watcher: Option<Watcher>,
    /// The last halt that was followed, or that nothing was to be done for.
    halt: Option<Halt>,
    halted: Option<HaltReason>,
    next: LocalTicks,
    /// Readings that could not be sent.
    unsent: u32,
    /// Where no interrupt plays.
    played_here: Option<Interpolator<'static>>,
}

impl core::fmt::Debug for MotionService {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("MotionService").field("traits", &self.traits).field("halt", &self.halt).finish_non_exhaustive()
    }
}

impl MotionService {
    /// Over one half of a device's rings; the other half is the interpolator's.
    #[must_use]
    pub const fn new(motion: Motion<'static>, traits: MotionTraits) -> Self {
        let (watcher, halt, halted, played_here) = (None, None, None, None);
        Self { motion, traits, watcher, halt, halted, next: LocalTicks::ZERO, unsent: 0, played_here }
    }

    /// Has the other half played whenever the service is polled, every [`PLAYED_HERE_US`] while an axis is live: in a simulation, where no
    /// interrupt does. What would be put out is not.
    #[must_use]
    pub fn played_here(mut self, interpolator: Interpolator<'static>) -> Self {
        self.played_here = Some(interpolator);
        self
    }

    /// Takes one packet of the port's.
    pub fn accept(&mut self, node: &mut impl Mailbox, delivery: Delivery, scratch: &mut [u8], now: LocalTicks) {
        let is_request = match delivery.sequenced.map(|it| it.kind) {
            Some(SequencedKind::Request) => true,
            Some(_) => return node.release(delivery, Some(DropCause::ReplyUnmatched), now),
            None if delivery.transport == Transport::Datagram => false,
            None => return node.release(delivery, Some(DropCause::PortRefused), now),
        };
        let len = node.with_payload(&delivery, |payload| {
            scratch.get_mut(..payload.len())?.copy_from_slice(payload);
            Some(payload.len())
        });
        let message = len.and_then(|len| scratch.get(..len)).and_then(Message::decode);
        let answer = match message {
            None => Err(MotionRefusal::Malformed),
            Some(Message::Points(points)) => self.points(&points, node, now),
            Some(Message::Request(request)) => self.request(&request, node, &delivery, now),
        };
        let mut out = [0; REPLY_BYTES_MAX];
        // the longest of both fits: a test of the protocol's says so. One that does not get away is counted by the node
        let _counted = match (answer, is_request) {
            (Ok(reply), true) => node.reply(delivery, &[reply.encode(&mut out).unwrap_or_default()], now),
            (Err(refusal), true) => node.refuse(delivery, &[refusal.encode(&mut out).unwrap_or_default()], now),
            (Err(refusal), false) => {
                let head = [MOTION_VERSION, REFUSAL_OPERATION];
                node.reply(delivery, &[&head, refusal.encode(&mut out).unwrap_or_default()], now)
            }
            (Ok(_), false) => return node.release(delivery, None, now),
        };
    }

    /// `[MOT-03]`, `[MOT-04]`
    fn points(&mut self, points: &PointsRef<'_>, node: &mut impl Mailbox, now: LocalTicks) -> Answered {
        let axis = points.axis;
        let (system, _) = node.system_time(now);
        let interval = self.motion.interval(axis).ok_or(MotionRefusal::NotArmed)?;
        let mut taken = 0;
        for (index, position) in (0..).zip(points.positions()) {
            let time = points.time + Span::from_steps(index * u64::from(interval.steps()));
            let offered = self.motion.offer(axis, Point { time, position }, system.at);
            offered.map_err(|error| {
                // what it latched is to halt all motion, and that at once
                self.next = now;
                answer::of_offer(&error, time, taken, interval)
            })?;
            taken += 1;
        }
        node.set_live(self.motion.is_live());
        let view = self.motion.view(axis).ok_or(MotionRefusal::NotArmed)?;
        let free = u16::try_from(view.free).unwrap_or(u16::MAX);
        Ok(MotionReply::Accepted { taken, free, last_steps: view.last.steps() })
    }

    fn request(
        &mut self,
        request: &MotionRequest,
        node: &mut impl Mailbox,
        delivery: &Delivery,
        now: LocalTicks,
    ) -> Answered {
        let (system, _) = node.system_time(now);
        match *request {
            MotionRequest::Describe => Ok(self.describe()),
            MotionRequest::Configure { axis, settings } => self.configure(axis, &settings),
            MotionRequest::Arm { axis, position } => {
                existing(axis)?;
                self.motion.arm(axis, position).map_err(|error| answer::of_arm(error.as_ref()))?;
                Ok(MotionReply::Done)
            }
            MotionRequest::Status { axis } => self.status(axis, system.at).map(MotionReply::Status),
            MotionRequest::MotionAt { axis, time_steps } => {
                self.motion_at(axis, NetTime::from_steps(time_steps), system.at)
            }
            MotionRequest::ClearFault { axis } => match self.motion.clear_fault(axis) {
                Ok(true) => Ok(MotionReply::Done),
                Ok(false) => Err(MotionRefusal::Moving),
                Err(error) => Err(answer::of_setting(&error)),
            },
            MotionRequest::Halt { resume, lead_us } => {
                let action = if resume { Action::Resume } else { Action::Stop };
                let lead = Span::from_us(u64::from(lead_us.min(HALT_LEAD_US_MAX)));
                let Halt { sequence, epoch, .. } = node.raise_halt(action, system.at + lead, now);
                self.next = now;
                Ok(MotionReply::Halted { sequence, epoch_steps: epoch.steps() })
            }
            MotionRequest::Ramp { track, start_steps, end_steps, from, to } => {
                let start = start_steps.map(NetTime::from_steps);
                let ramp = Ramp { start, end: NetTime::from_steps(end_steps), start_value: from, end_value: to };
                let taken = self.motion.ramp(track, &ramp, system.at);
                taken.map_err(|error| answer::of_track(error.as_ref(), track, RAMPS))?;
                Ok(MotionReply::Done)
            }
            MotionRequest::Level { track, start_steps, value } => {
                let level = Level { start: NetTime::from_steps(start_steps), value };
                let taken = self.motion.level(track, level, system.at);
                taken.map_err(|error| answer::of_track(error.as_ref(), track, LEVELS))?;
                Ok(MotionReply::Done)
            }
            MotionRequest::SetNode { node: index, bytes } => {
                let [operation, operand, ..] = bytes;
                let node = Node::decode(&bytes).map_err(|_| MotionRefusal::Node { operation, operand })?;
                self.motion.set_node(index, node).map_err(|error| answer::of_node(&error, operation, operand))?;
                Ok(MotionReply::Done)
            }
            MotionRequest::SetOutput { output, node } => {
                self.motion.set_output(output, node).map_err(|error| answer::of_setting(&error))?;
                Ok(MotionReply::Done)
            }
            MotionRequest::SetTrigger { trigger, channel, settings } => {
                self.set_trigger(trigger, channel, settings, system.at)?;
                let back = route_back(node, delivery);
                self.watcher = Some(Watcher { back, port: delivery.source, mtu_bytes: delivery.mtu_bytes });
                Ok(MotionReply::Done)
            }
        }
    }

    const fn describe(&self) -> MotionReply {
        MotionReply::Described {
            axes: COUNT_OF_AXES,
            beat_us: self.traits.beat_us,
            queue: CAPACITY,
            history: const { word(HISTORY) },
            ramps: const { byte(RAMPS) },
            levels: const { byte(LEVELS) },
            outputs: const { byte(OUTPUTS) },
            channels: self.traits.channels,
            triggers: const { byte(TRIGGERS) },
        }
    }

    /// `[MOT-09]`
    fn configure(&mut self, axis: u8, settings: &AxisSettings) -> Answered {
        existing(axis)?;
        let drive = if self.traits.has_phases && axis == 0 {
            let window = PhaseWindow::new(settings.step_log2.into(), 0);
            Drive::Phases(window.map_err(|_| field(1, settings.step_log2.into(), 18))?)
        } else {
            Drive::Steps { step_log2: in_range(1, settings.step_log2, 1, 30)? }
        };
        let config = config_of(settings)?;
        self.motion.configure(axis, &config, drive).map_err(|error| answer::of_setting(&error))?;
        Ok(MotionReply::Done)
    }

    fn status(&self, axis: u8, now: NetTime) -> Result<AxisStatus, MotionRefusal> {
        existing(axis)?;
        let view = self.motion.view(axis).ok_or(MotionRefusal::NotArmed)?;
        let state = if self.motion.is_ready(axis) { AxisState::Armed } else { answer::state_of(view.played) };
        let counters = view.counters;
        let refused = [
            counters.not_armed,
            counters.off_grid,
            counters.late,
            counters.non_monotonic,
            counters.gap,
            counters.full,
            counters.latched,
            counters.limit,
        ];
        Ok(AxisStatus {
            state,
            position: view.position,
            free: u16::try_from(view.free).unwrap_or(u16::MAX),
            last_steps: view.last.steps(),
            delay_steps: self.motion.delay(now).steps(),
            fault: view.fault.as_ref().map(fault_of),
            accepted: counters.accepted,
            refused: refused.into_iter().fold(0, u32::saturating_add),
            rebuilt: counters.rebuilt,
            starved: counters.starved,
            steps_late: view.steps_late,
            halted: self.halted,
        })
    }

    /// `[MOT-10]`
    fn motion_at(&self, axis: u8, at: NetTime, now: NetTime) -> Answered {
        existing(axis)?;
        let (earliest, latest) = self.motion.history_of(axis, now).unwrap_or_default();
        let range = MotionRefusal::NotInHistory { earliest_steps: earliest.steps(), latest_steps: latest.steps() };
        let was = self.motion.motion_at(axis, at).ok_or(range)?;
        Ok(MotionReply::Motion {
            position: was.position,
            velocity: was.velocity,
            acceleration: was.acceleration,
            jerk: was.jerk,
        })
    }

    /// `[MOT-14]`
    fn set_trigger(
        &mut self,
        trigger: u8,
        channel: u8,
        settings: TriggerSettings,
        now: NetTime,
    ) -> Result<(), MotionRefusal> {
        if channel >= self.traits.channels {
            return Err(MotionRefusal::NoSuch { index: channel, count: self.traits.channels });
        }
        let every = |beats: u32| Span::from_us(u64::from(beats) * u64::from(self.traits.beat_us));
        let (node, what) = match settings {
            TriggerSettings::Off => (0, None),
            TriggerSettings::Interval { beats } => {
                (0, Some(Trigger::interval(now, every(beats)).ok_or(field(0, 0, 1))?))
            }
            TriggerSettings::Edge { node, rising, falling } => {
                let edge = match (rising, falling) {
                    (true, true) => Edge::Either,
                    (true, false) => Edge::Rising,
                    (false, true) => Edge::Falling,
                    (false, false) => return Err(field(0, 0, 1)),
                };
                (node, Some(Trigger::edge(1, edge)))
            }
            TriggerSettings::Window { node, beats } => {
                (node, Some(Trigger::window(1, 1, now, every(beats)).ok_or(field(0, 0, 1))?))
            }
        };
        self.motion.set_trigger(trigger, channel, node, what).map_err(|error| answer::of_setting(&error))
    }

    /// Tells the interpolator the time, follows halts and raises them, sends readings. At least every [`RUN_US_MAX`].
    pub fn poll(&mut self, node: &mut impl Mailbox, port: PortIndex, now: LocalTicks) {
        if let Some(interpolator) = &mut self.played_here
            && (self.motion.is_live() || now >= self.next)
        {
            interpolator.beat(now, |_| 0);
        }
        let halt = node.halt();
        if now < self.next && halt == self.halt && self.motion.readings_waiting() < READINGS_A_PACKET {
            return;
        }
        let (system, map) = node.system_time(now);
        if halt != self.halt
            && let Some(halt) = halt
        {
            self.follow(halt, system.at);
        }
        // a node that hears no root becomes one, and is settled anew then: being without a root is no state of its own
        let health = ClockHealth { is_settled: system.is_settled, is_linked: true, bound: system.bound };
        if let Some(cause) = self.motion.run(&map, &health, system.at) {
            self.halted = Some(match cause {
                HaltCause::Fault { axis, .. } => HaltReason::Fault { axis },
                HaltCause::Silence { axis } => HaltReason::Silence { axis },
                HaltCause::Clock(_) => HaltReason::Clock,
            });
            let halt = node.raise_halt(Action::Stop, system.at + Span::from_us(HALT_LEAD_US), now);
            self.follow(halt, system.at);
        }
        node.set_live(self.motion.is_live());
        self.send_readings(node, port, now);
        self.next = self.next_run(system.at, now);
    }

    /// Does what a halt says; one that cannot be followed yet is tried again.
    fn follow(&mut self, halt: Halt, now: NetTime) {
        match self.motion.halt(halt.action == Action::Stop, halt.sequence, halt.epoch, now) {
            Err(HaltError::StillStopping { .. } | HaltError::Busy) => {}
            Ok(()) | Err(HaltError::Stale { .. } | HaltError::NotStopped) => self.halt = Some(halt),
        }
    }

    fn next_run(&self, system: NetTime, now: LocalTicks) -> LocalTicks {
        let plays_here = self.played_here.is_some() && self.motion.is_live();
        let regular = now + Span::from_us(if plays_here { PLAYED_HERE_US } else { RUN_US_MAX });
        let Some(needed) = self.motion.needed_by(system) else { return regular };
        regular.min(now + needed.since(system)).max(now + Span::from_us(1))
    }

    /// When [`MotionService::poll`] has something to do even if nothing comes.
    #[must_use]
    pub const fn next_wake(&self) -> LocalTicks {
        self.next
    }

    fn send_readings(&mut self, node: &mut impl Mailbox, port: PortIndex, now: LocalTicks) {
        while self.motion.readings_waiting() > 0 {
            let mut payload = [0; 2 + READINGS_A_PACKET * ReadingMessage::LEN];
            payload[..2].copy_from_slice(&[MOTION_VERSION, READINGS_OPERATION]);
            let mut len = 2;
            for room in payload[2..].chunks_exact_mut(ReadingMessage::LEN) {
                let Some(reading) = self.motion.take_reading() else { break };
                let message = ReadingMessage { time: reading.time, channel: reading.channel, value: reading.value };
                room.copy_from_slice(&message.encode());
                len += ReadingMessage::LEN;
            }
            let Some(Watcher { back, port: destination, mtu_bytes }) = &self.watcher else { return };
            let to = Outbound {
                route: back.as_route(),
                mtu_bytes: *mtu_bytes,
                ttl_us: READINGS_TTL_US,
                destination: *destination,
                transport: Transport::Datagram,
            };
            if node.send(port, to, &[&payload[..len]], now).is_err() {
                // counted by the node too, which does not know how many there were
                let unsent = u32::try_from((len - 2) / ReadingMessage::LEN).unwrap_or(u32::MAX);
                self.unsent = self.unsent.saturating_add(unsent);
            }
        }
    }
}

/// Axes of every device.
const COUNT_OF_AXES: u8 = byte(AXES);
/// Points that an axis holds.
const CAPACITY: u16 = word(QUEUE);

#[expect(clippy::cast_possible_truncation, reason = "asserted to fit when this is compiled")]
const fn byte(count: usize) -> u8 {
    assert!(count <= u8::MAX as usize);
    count as u8
}

#[expect(clippy::cast_possible_truncation, reason = "asserted to fit when this is compiled")]
const fn word(count: usize) -> u16 {
    assert!(count <= u16::MAX as usize);
    count as u16
}

const fn existing(axis: u8) -> Result<(), MotionRefusal> {
    let count = COUNT_OF_AXES;
    if axis < count { Ok(()) } else { Err(MotionRefusal::NoSuch { index: axis, count }) }
}

/// What a request comes to.
type Answered = Result<MotionReply, MotionRefusal>;

/// A setting that is out of its range, by its place in [`AxisSettings`].
const fn field(field: u8, value: i32, bound: i32) -> MotionRefusal {
    MotionRefusal::Setting { field, value, bound }
}

fn in_range(at: u8, value: u8, least: u8, most: u8) -> Result<u32, MotionRefusal> {
    let bound = value.clamp(least, most);
    if bound == value { Ok(value.into()) } else { Err(field(at, value.into(), bound.into())) }
}

/// Settings as the axis wants them, each in its range.
fn config_of(settings: &AxisSettings) -> Result<AxisConfig, MotionRefusal> {
    let AxisSettings { interval_log2, policy, missing_max, stop_log2, velocity, .. } = *settings;
    let interval = IntervalLog2::new(interval_log2.into()).ok_or(field(0, interval_log2.into(), 12))?;
    in_range(3, missing_max, 0, MISSING_MAX)?;
    let warp = Warp::new(stop_log2.into()).ok_or(field(4, stop_log2.into(), 16))?;
    let acceleration = curve(settings.acceleration, velocity).ok_or(field(8, settings.acceleration.at_full, 1))?;
    let jerk = curve(settings.jerk, velocity).ok_or(field(9, settings.jerk.at_full, 1))?;
    let positions = (settings.position_min, settings.position_max);
    let limits = Limits::new(positions, velocity, acceleration, jerk).map_err(answer::of_limits)?;
    Ok(AxisConfig {
        interval,
        limits,
        warp,
        policy: match policy {
            osap_protocol::motion::StarvedPolicy::Stop => StarvedPolicy::Stop,
            osap_protocol::motion::StarvedPolicy::Hold => StarvedPolicy::Hold,
            osap_protocol::motion::StarvedPolicy::Relax => StarvedPolicy::Relax,
        },
        missing_max,
        rebuilt_max: REBUILT_MAX,
        lead: Span::from_us(REBUILD_LEAD_US),
    })
}

/// The same at all speeds where both ends are the same.
fn curve(settings: CurveSettings, velocity: i32) -> Option<Curve> {
    let CurveSettings { at_rest, at_full, knee } = settings;
    if at_rest == at_full { Some(Curve::flat(at_rest)) } else { Curve::falling(at_rest, at_full, knee, velocity) }
}

const _: () = assert!(2 + READINGS_A_PACKET * ReadingMessage::LEN <= 128, "a datagram that every link carries");
const _: () = assert!(REPLY_BYTES_MAX <= 128, "an answer that every link carries");

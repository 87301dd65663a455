//! The highest-priority task's half of a device: once a beat, all axes, tracks, signals, outputs and triggers.
//!
//! - **Walk:** the beat's wrap → [`Interpolator::beat`] → the next beat's [`BeatOutput`], which the board puts out as the first thing of that
//!   beat: edges are as exact as the interrupt's entry, whatever was to be calculated.
//! - **Invariants:** what is put out at a beat is the tracks' value at that beat's own multiple of the period. Without a time, or with one
//!   that was told too long ago, no axis moves on: those that moved brake by themselves. O(axes + nodes + triggers), no division, no
//!   product of 64 bits but in the clock.
//! - **Context:** the highest-priority task; nothing it calls waits. **Clauses:** `[MOT-11]`, `[MOT-13]`, `[MOT-14]`, `[MOT-24]`.

use super::{
    AXES, Drive, INPUT_LEVELS, INPUT_RAMPS, INPUTS, LEVELS, NODES, OUTPUTS, Order, QUEUE, RAMPS, TIME_AGE_MAX,
    TRIGGERS, ToldOfAll, count,
};
use crate::beat::BeatLock;
use crate::clock::BeatClock;
use crate::player::{Output, Player, PlayerState};
use crate::tracks::{LevelPlayer, RampPlayer};
use crate::triggers::{Reading, ReadingsIn, Trigger};
use core::sync::atomic::Ordering;
use fixed_math::clock::SlewedMap;
use fixed_math::logic::Graph;
use fixed_math::phase::{Coils, PhaseWindow};
use fixed_math::steps::{Direction, Step, StepBits};
use fixed_math::time::{LocalTicks, NetTime, Span};
use heapless::spsc::Consumer;

/// Currents of coils, in 2^−16 of full scale: 70 %, the effective value of a sine of full scale.
const AMPLITUDE: u16 = 45_875;

/// A board's beat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BeatTraits {
    /// A period is 2^n µs: 6 for 15.625 kHz, 3 for 125 kHz.
    pub period_log2: u32,
    /// The same in cycles of the board's counter.
    pub nominal_cycles: u32,
}

/// What a board puts out at the next beat.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BeatOutput {
    /// A step pulse for axis n: bit n.
    pub steps: u8,
    /// Level of the direction of axis n, 1 towards larger positions: bit n.
    pub directions: u8,
    /// Level of output n: bit n.
    pub outputs: u8,
    /// Drivers are on: an axis is armed and not let go of.
    pub is_enabled: bool,
    /// Currents of the first axis' coils, Q15, where it is driven by phases.
    pub coils: Option<[i16; 2]>,
    /// The first axis as of then, for a servo.
    pub first: Output,
    /// Length of the period that begins with the next wrap, cycles.
    pub period_cycles: u32,
}

/// What a beat is calculated for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Times {
    pub(super) system: NetTime,
    pub(super) track: NetTime,
}

/// One axis' output stage.
#[derive(Clone, Copy, Debug)]
enum Stage {
    /// No motor yet.
    None,
    Steps(StepBits),
    Phases(PhaseWindow),
}

/// One axis: its player, and what moves its motor.
pub(super) struct AxisOut<'a> {
    player: Player<'a, QUEUE>,
    stage: Stage,
    /// [`Output::origin`](crate::player::Output::origin) at which the stage was begun.
    origin: u8,
    step_log2: u32,
    /// Steps late of former stages.
    late: u32,
}

struct Watched {
    channel: u8,
    node: u8,
    trigger: Option<Trigger>,
}

/// The half.
pub struct Interpolator<'a> {
    pub(super) axes: [AxisOut<'a>; AXES],
    clock: BeatClock<'a>,
    ramps: [RampPlayer<'a>; RAMPS],
    levels: [LevelPlayer<'a>; LEVELS],
    readings: ReadingsIn<'a>,
    orders: Consumer<'a, Order>,
    told: &'a ToldOfAll,
    map: Option<SlewedMap>,
    /// Of the counter, when the map was told.
    told_at: LocalTicks,
    lock: BeatLock,
    pub(super) period: Span,
    graph: Graph<NODES>,
    /// A node or more was set.
    has_nodes: bool,
    outputs: [Option<u8>; OUTPUTS],
    triggers: [Watched; TRIGGERS],
    has_triggers: bool,
    pub(super) nominal_cycles: u32,
    inputs: [i32; INPUTS],
}

impl<'a> Interpolator<'a> {
    pub(super) fn new(
        players: [Player<'a, QUEUE>; AXES],
        clock: BeatClock<'a>,
        (ramps, levels): ([RampPlayer<'a>; RAMPS], [LevelPlayer<'a>; LEVELS]),
        readings: ReadingsIn<'a>,
        orders: Consumer<'a, Order>,
        told: &'a ToldOfAll,
        beat: BeatTraits,
    ) -> Self {
        let BeatTraits { period_log2, nominal_cycles } = beat;
        Self {
            axes: players.map(|player| AxisOut { player, stage: Stage::None, origin: 0, step_log2: 1, late: 0 }),
            clock,
            ramps,
            levels,
            readings,
            orders,
            told,
            map: None,
            told_at: LocalTicks::ZERO,
            lock: BeatLock::new(period_log2, nominal_cycles).expect("a beat of 8 to 64 µs"),
            period: Span::from_us(1 << period_log2),
            graph: Graph::new(INPUTS).expect("few inputs"),
            has_nodes: false,
            outputs: [None; OUTPUTS],
            triggers: [const { Watched { channel: 0, node: 0, trigger: None } }; TRIGGERS],
            has_triggers: false,
            nominal_cycles,
            inputs: [0; INPUTS],
        }
    }

    /// The beat that wrapped when the counter read `wrap`: what to put out at the next. `sense` reads a channel.
    pub fn beat(&mut self, wrap: LocalTicks, mut sense: impl FnMut(u8) -> i32) -> BeatOutput {
        let (mut out, times) = self.begin(wrap, self.period);
        if let Some(times) = times {
            // of the nodes as they are at this very beat: what they come to next is for the next one
            self.trigger(times.system.shifted(-self.period.steps().cast_signed()), &mut sense);
            for index in 0..AXES {
                let played = self.play(index, times.track, &mut out);
                if let Some(axis) = self.axes.get_mut(index) {
                    axis.step(&played, index, &mut out);
                }
            }
            self.signals(times.track, &mut out);
        }
        out
    }

    /// First part of a beat: orders, and the times for which the rest is done, `lead` after this beat's own; `None` before there is a time.
    pub(super) fn begin(&mut self, wrap: LocalTicks, lead: Span) -> (BeatOutput, Option<Times>) {
        self.take_orders(wrap);
        count(&self.told.beats);
        let mut out = BeatOutput { period_cycles: self.nominal_cycles, ..BeatOutput::default() };
        let Some(map) = &self.map else { return (out, None) };
        let beat = self.lock.wrapped(map.system_at(wrap));
        out.period_cycles = beat.period_cycles;
        self.told.late_steps.store(beat.late_steps, Ordering::Relaxed);
        self.told.is_locked.store(beat.is_locked.into(), Ordering::Relaxed);
        if wrap.since(self.told_at) > TIME_AGE_MAX {
            // nobody has said for long what time it is: what moves comes to rest by itself, by the last time that was told
            self.told_at = wrap;
            count(&self.told.stale);
            self.axes.iter_mut().for_each(|axis| axis.player.abandon());
        }
        let system = beat.grid + lead;
        (out, Some(Times { system, track: self.clock.advance(system).time }))
    }

    /// One axis at a track time.
    #[inline]
    pub(super) fn play(&mut self, index: usize, track: NetTime, out: &mut BeatOutput) -> Output {
        let (Some(axis), Some(told)) = (self.axes.get_mut(index), self.told.axes.get(index)) else {
            return Output::default();
        };
        let played = axis.player.beat(track);
        let Output { position, velocity, state, .. } = played;
        if let Some([at, rate]) = self.inputs.as_chunks_mut().0.get_mut(index) {
            (*at, *rate) = (position, velocity);
        }
        if index == 0 {
            out.first = played;
        }
        out.is_enabled |= !matches!(state, PlayerState::Idle | PlayerState::Released);
        told.position.store(position, Ordering::Relaxed);
        told.state.store(state as u32, Ordering::Relaxed);
        told.steps_late.store(axis.steps_late(), Ordering::Relaxed);
        played
    }

    /// What the task below wants, one order a beat so that no beat takes long.
    fn take_orders(&mut self, wrap: LocalTicks) {
        match self.orders.dequeue() {
            None => {}
            Some(Order::Time(map)) => {
                self.map = Some(map);
                self.told_at = wrap;
            }
            Some(Order::Drive { axis, drive }) => {
                if let Some(axis) = self.axes.get_mut(usize::from(axis)) {
                    axis.begin(drive);
                }
            }
            Some(Order::SetNode { index, node }) => {
                // checked by the task, which has a graph of its own
                self.has_nodes |= self.graph.set(usize::from(index), node).is_ok();
            }
            Some(Order::SetOutput { output, node }) => {
                if let Some(slot) = self.outputs.get_mut(usize::from(output)) {
                    *slot = node;
                }
            }
            Some(Order::SetTrigger { trigger, channel, node, what }) => {
                if let Some(slot) = self.triggers.get_mut(usize::from(trigger)) {
                    *slot = Watched { channel, node, trigger: what };
                }
                self.has_triggers = self.triggers.iter().any(|it| it.trigger.is_some());
            }
        }
    }

    /// Tracks beside axes, nodes and outputs.
    pub(super) fn signals(&mut self, track: NetTime, out: &mut BeatOutput) {
        if !self.has_nodes {
            return;
        }
        for (input, ramp) in self.inputs[INPUT_RAMPS..].iter_mut().zip(&mut self.ramps) {
            *input = ramp.value(track).unwrap_or(0);
        }
        for (input, level) in self.inputs[INPUT_LEVELS..].iter_mut().zip(&mut self.levels) {
            *input = level.value(track).unwrap_or(0);
        }
        let _saturated = self.graph.evaluate(&self.inputs);
        for (index, node) in self.outputs.iter().enumerate() {
            let is_high = node.is_some_and(|node| self.graph.is_true(usize::from(node)).unwrap_or(false));
            out.outputs |= u8::from(is_high) << index;
        }
    }

    /// Readings that are due at the beat of `now`.
    pub(super) fn trigger(&mut self, now: NetTime, sense: &mut impl FnMut(u8) -> i32) {
        if !self.has_triggers {
            return;
        }
        for Watched { channel, node, trigger } in &mut self.triggers {
            let Some(trigger) = trigger else { continue };
            let signal = i32::from(self.graph.is_true(usize::from(*node)).unwrap_or(false));
            if trigger.is_due(now, signal) {
                let _counted = self.readings.push(Reading { time: now, channel: *channel, value: sense(*channel) });
            }
        }
    }

    /// What nodes came to at the last beat: a servo's gains and torques may follow them.
    #[must_use]
    pub fn node(&self, index: usize) -> Option<i32> {
        if self.has_nodes { self.graph.value(index) } else { None }
    }
}

impl AxisOut<'_> {
    fn begin(&mut self, drive: Drive) {
        self.late = self.steps_late();
        match drive {
            Drive::Steps { step_log2 } => {
                self.step_log2 = step_log2;
                // its position comes with the first beat
                self.stage =
                    StepBits::new(step_log2, StepBits::quarter(step_log2), 0).map_or(Stage::None, Stage::Steps);
                self.origin = 0;
            }
            Drive::Phases(window) => self.stage = Stage::Phases(window),
        }
    }

    fn steps_late(&self) -> u32 {
        match &self.stage {
            Stage::Steps(steps) => self.late.saturating_add(steps.missed()),
            _ => self.late,
        }
    }

    /// Steps or currents for what was played.
    #[inline]
    fn step(&mut self, played: &Output, index: usize, out: &mut BeatOutput) {
        if played.state == PlayerState::Idle {
            return;
        }
        self.rebase(played);
        match &mut self.stage {
            Stage::Steps(steps) => put_step(steps.update(played.position), index, out),
            Stage::Phases(window) if index == 0 => {
                let amplitude = if played.state == PlayerState::Released { 0 } else { AMPLITUDE };
                let Coils { a, b } = Coils::at(window.phase(played.position), amplitude);
                out.coils = Some([a, b]);
            }
            Stage::Phases(_) | Stage::None => {}
        }
    }

    /// Where the axis is may have got a new meaning: then the motor is there, and has not moved.
    #[inline]
    pub(super) fn rebase(&mut self, played: &Output) {
        if played.origin != self.origin
            && let Stage::Steps(steps) = &mut self.stage
        {
            self.late = self.late.saturating_add(steps.missed());
            if let Ok(begun) = StepBits::new(self.step_log2, StepBits::quarter(self.step_log2), played.position) {
                *steps = begun;
            }
            self.origin = played.origin;
        }
    }

    /// Whether what was played is of another origin than what was stepped.
    #[inline]
    pub(super) const fn begins(&self, played: &Output) -> bool {
        played.origin != self.origin
    }

    /// What steps by position, if it does.
    #[inline]
    pub(super) const fn steps(&mut self) -> Option<&mut StepBits> {
        match &mut self.stage {
            Stage::Steps(steps) => Some(steps),
            Stage::Phases(_) | Stage::None => None,
        }
    }
}

/// Puts a step out for axis `index`.
#[inline]
pub(super) fn put_step(step: Step, index: usize, out: &mut BeatOutput) {
    out.steps |= u8::from(step.is_step) << index;
    out.directions |= u8::from(step.direction == Direction::Up) << index;
}

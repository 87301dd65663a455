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
use fixed_math::steps::{Direction, StepBits};
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

/// One axis' output stage.
#[derive(Clone, Copy, Debug)]
enum Stage {
    /// No motor yet.
    None,
    Steps(StepBits),
    Phases(PhaseWindow),
}

/// One axis: its player, and what moves its motor.
struct AxisOut<'a> {
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
    axes: [AxisOut<'a>; AXES],
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
    period: Span,
    graph: Graph<NODES>,
    /// A node or more was set.
    has_nodes: bool,
    outputs: [Option<u8>; OUTPUTS],
    triggers: [Watched; TRIGGERS],
    has_triggers: bool,
    nominal_cycles: u32,
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
        self.take_orders(wrap);
        count(&self.told.beats);
        let mut out = BeatOutput { period_cycles: self.nominal_cycles, ..BeatOutput::default() };
        let Some(map) = &self.map else { return out };
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
        let now = beat.grid + self.period;
        let track = self.clock.advance(now).time;
        let inputs = &mut self.inputs;
        for (index, axis) in self.axes.iter_mut().enumerate() {
            let told = &self.told.axes[index];
            let played = axis.beat(track, index, &mut out);
            let Output { position, velocity, state, .. } = played;
            if index == 0 {
                out.first = played;
            }
            inputs[2 * index] = position;
            inputs[2 * index + 1] = velocity;
            told.position.store(position, Ordering::Relaxed);
            told.state.store(state as u32, Ordering::Relaxed);
            told.steps_late.store(axis.steps_late(), Ordering::Relaxed);
        }
        if self.has_nodes {
            self.signals(track, &mut out);
        }
        if self.has_triggers {
            self.trigger(now, &mut sense);
        }
        out
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

    fn signals(&mut self, track: NetTime, out: &mut BeatOutput) {
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

    fn trigger(&mut self, now: NetTime, sense: &mut impl FnMut(u8) -> i32) {
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

    #[inline]
    fn beat(&mut self, track: NetTime, index: usize, out: &mut BeatOutput) -> Output {
        let played = self.player.beat(track);
        let is_on = !matches!(played.state, PlayerState::Idle | PlayerState::Released);
        out.is_enabled |= is_on;
        if played.state == PlayerState::Idle {
            return Output { velocity: 0, acceleration: 0, ..played };
        }
        match &mut self.stage {
            Stage::None => {}
            Stage::Steps(steps) => {
                if played.origin != self.origin {
                    // where the axis is has a new meaning, and the motor has not moved
                    self.late = self.late.saturating_add(steps.missed());
                    let hysteresis = StepBits::quarter(self.step_log2);
                    if let Ok(begun) = StepBits::new(self.step_log2, hysteresis, played.position) {
                        *steps = begun;
                    }
                    self.origin = played.origin;
                }
                let step = steps.update(played.position);
                out.steps |= u8::from(step.is_step) << index;
                out.directions |= u8::from(step.direction == Direction::Up) << index;
            }
            Stage::Phases(window) if index == 0 => {
                let amplitude = if is_on { AMPLITUDE } else { 0 };
                let Coils { a, b } = Coils::at(window.phase(played.position), amplitude);
                out.coils = Some([a, b]);
            }
            Stage::Phases(_) => {}
        }
        played
    }
}

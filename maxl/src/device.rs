//! What one device plays: four axes, tracks of ramps and levels, signals made of them, outputs and triggers, in two halves.
//!
//! - **Walk:** [`DeviceRings::split`] once at start → [`Motion`] for the task `serve`, [`Interpolator`] for the highest-priority task. Messages →
//!   [`Motion`] → rings → [`Interpolator::beat`] → levels of pins.
//! - **Invariants:** sizes are those below, for every device, so that none of this is generic and all of it is compiled once, for speed. The
//!   halves share rings and words with one writer each, no lock.
//! - **Context:** static memory. **Clauses:** `[MOT-02]` to `[MOT-14]`, `[MOT-24]`.

mod fast;
mod interpolator;
mod motion;

pub use fast::{FastInterpolator, SLICES};
pub use interpolator::{BeatOutput, BeatTraits, Interpolator};
pub use motion::{
    AxisView, CLOCK_BOUND_MAX, CLOCK_LOST_MAX, FRESH_MAX, HaltCause, Motion, OfferError, RUN_US_MAX, SettingError,
};

use crate::axis::AxisRings;
use crate::clock::ClockRings;
use crate::tracks::{LevelTrack, RampTrack};
use crate::triggers::{ReadingRing, Trigger};
use core::sync::atomic::{AtomicI32, AtomicU32, Ordering};
use fixed_math::clock::SlewedMap;
use fixed_math::logic::Node;
use fixed_math::phase::PhaseWindow;
use fixed_math::time::Span;
use fixed_math::warp::Warp;
use heapless::spsc::Queue;

/// Axes of a device.
pub const AXES: usize = 4;
/// Points that an axis holds ahead: half a second at intervals of 4 ms.
pub const QUEUE: usize = 128;
/// Points that an axis remembers.
pub const HISTORY: usize = 256;
/// Tracks of ramps.
pub const RAMPS: usize = 2;
/// Tracks of levels.
pub const LEVELS: usize = 4;
/// Ramps or levels that a track holds ahead, and one.
pub const SEGMENTS: usize = 17;
/// Nodes of signals.
pub const NODES: usize = 16;
/// Outputs that follow nodes.
pub const OUTPUTS: usize = 4;
/// Triggers.
pub const TRIGGERS: usize = 4;
/// Readings that wait to be sent, and one.
pub const READINGS: usize = 65;
/// What nodes read: position and velocity of each axis, ramps, levels.
pub const INPUTS: usize = 2 * AXES + RAMPS + LEVELS;
/// Input of the first ramp.
pub const INPUT_RAMPS: usize = 2 * AXES;
/// Input of the first level.
pub const INPUT_LEVELS: usize = INPUT_RAMPS + RAMPS;
/// A time that was told to the interpolator so long ago is not played by any more.
pub const TIME_AGE_MAX: Span = Span::from_us(500_000);
/// Stops of a device that was told nothing else: 3·2^16 µs, a fifth of a second.
pub const WARP_LOG2_DEFAULT: u32 = 16;

/// How an axis moves its motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Drive {
    /// Step and direction, 2^n LSB a step.
    Steps {
        /// n, 1 to 30.
        step_log2: u32,
    },
    /// Currents of two coils; the first axis alone, on a board that has them.
    Phases(PhaseWindow),
}

/// From the task to the interrupt.
#[derive(Clone, Copy, Debug)]
enum Order {
    Time(SlewedMap),
    Drive { axis: u8, drive: Drive },
    SetNode { index: u8, node: Node },
    SetOutput { output: u8, node: Option<u8> },
    SetTrigger { trigger: u8, channel: u8, node: u8, what: Option<Trigger> },
}

/// What the interrupt says of an axis, for whoever asks.
#[derive(Debug)]
struct Told {
    position: AtomicI32,
    state: AtomicU32,
    steps_late: AtomicU32,
}

impl Told {
    const fn new() -> Self {
        Self { position: AtomicI32::new(0), state: AtomicU32::new(0), steps_late: AtomicU32::new(0) }
    }
}

/// What it says of all.
#[derive(Debug)]
struct ToldOfAll {
    axes: [Told; AXES],
    /// Beats since start.
    beats: AtomicU32,
    /// Of the last beat: how late it was, steps.
    late_steps: AtomicI32,
    /// Whether beats are where they should be.
    is_locked: AtomicU32,
    /// Times that the time told was too old to play by.
    stale: AtomicU32,
}

/// What both halves share.
#[derive(Debug)]
pub struct DeviceRings {
    axes: [AxisRings<QUEUE>; AXES],
    clock: ClockRings,
    ramps: [RampTrack<SEGMENTS>; RAMPS],
    levels: [LevelTrack<SEGMENTS>; LEVELS],
    readings: ReadingRing<READINGS>,
    orders: Queue<Order, 9>,
    told: ToldOfAll,
}

impl DeviceRings {
    /// Empty ones.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            axes: [const { AxisRings::new() }; AXES],
            clock: ClockRings::new(),
            ramps: [const { RampTrack::new() }; RAMPS],
            levels: [const { LevelTrack::new() }; LEVELS],
            readings: ReadingRing::new(),
            orders: Queue::new(),
            told: ToldOfAll {
                axes: [const { Told::new() }; AXES],
                beats: AtomicU32::new(0),
                late_steps: AtomicI32::new(0),
                is_locked: AtomicU32::new(0),
                stale: AtomicU32::new(0),
            },
        }
    }

    /// The half of the task and the half of the interrupt, whose beats are as `beat` says.
    ///
    /// # Panics
    /// Where `beat` is out of range, which is a mistake of the image.
    pub fn split(&mut self, beat: BeatTraits) -> (Motion<'_>, Interpolator<'_>) {
        let warp = Warp::new(WARP_LOG2_DEFAULT).expect("in range");
        let [a, b, c, d] = self.axes.each_mut().map(AxisRings::split);
        let (clock, beat_clock) = self.clock.split(warp);
        let [r0, r1] = self.ramps.each_mut().map(|track| track.split(Span::MAX));
        let [l0, l1, l2, l3] = self.levels.each_mut().map(|track| track.split(Span::MAX));
        let (readings_in, readings_out) = self.readings.split();
        let (orders_in, orders_out) = self.orders.split();
        let motion = Motion::new(
            [a.0, b.0, c.0, d.0],
            clock,
            ([r0.0, r1.0], [l0.0, l1.0, l2.0, l3.0]),
            readings_out,
            orders_in,
            &self.told,
        );
        let interpolator = Interpolator::new(
            [a.1, b.1, c.1, d.1],
            beat_clock,
            ([r0.1, r1.1], [l0.1, l1.1, l2.1, l3.1]),
            readings_in,
            orders_out,
            &self.told,
            beat,
        );
        (motion, interpolator)
    }
}

impl Default for DeviceRings {
    fn default() -> Self {
        Self::new()
    }
}

/// Adds one, for a word with one writer: an exchange is not needed, and a Cortex-M0+ has none.
fn count(word: &AtomicU32) {
    word.store(word.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
}

//! The beat: edges first, then what follows at the next.
//!
//! - **Walk:** a board's [`Pace`] wraps → its interrupt → [`Beats::beat`] → the board's [`Motors`].
//! - **Invariants:** what the last beat calculated is put out before anything else, in one store, so that an edge is as late as the
//!   interrupt's entry, and by no more. A step's pulse lasts from there to the end of the same call.
//! - **Context:** the highest-priority task, which nothing interrupts and which waits for nobody.
//! - **Clauses:** `[MOT-13]`, `[MOT-14]`. Boards implement both traits, as they do [`Wire`](crate::Wire): decision 5.

use fixed_math::time::LocalTicks;
use osap_maxl::device::{AXES, BeatOutput, FastInterpolator, Interpolator};

/// A board's beat.
pub trait Pace {
    /// Ends the interrupt.
    fn clear(&mut self);

    /// When the last wrap was.
    fn wrap_stamp(&mut self) -> LocalTicks;

    /// Length of the period that begins with the next wrap, cycles.
    fn set_period(&mut self, cycles: u32);
}

/// A board's pins that move motors.
pub trait Motors {
    /// Step pin of each axis, as a bit of [`Motors::write`].
    const STEPS: [u32; AXES];
    /// Direction pin of each axis.
    const DIRECTIONS: [u32; AXES];

    /// Makes the pins in `clear` low and those in `set` high, which wins, with one store.
    fn write(&mut self, set: u32, clear: u32);

    /// Switches the drivers on or off.
    fn enable(&mut self, on: bool);

    /// Pins that follow signals: bit n is output n.
    fn outputs(&mut self, levels: u8);

    /// Currents of the two coils of a motor that is driven by phases, Q15.
    fn coils(&mut self, currents: [i16; 2]);

    /// Reads a channel; one that is not there reads 0.
    fn sense(&mut self, channel: u8) -> i32;
}

/// A simulated motor, or whatever else makes currents of where the first axis should be.
pub trait Follower {
    /// Currents for the next beat, of what is to be put out then.
    fn follow(&mut self, out: &BeatOutput, interpolator: &Interpolator<'_>) -> [i16; 2];

    /// Where the motor is, by its encoder.
    fn measured(&self) -> i32;
}

/// No servo.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NoServo;

impl Follower for NoServo {
    fn follow(&mut self, out: &BeatOutput, _: &Interpolator<'_>) -> [i16; 2] {
        out.coils.unwrap_or_default()
    }

    fn measured(&self) -> i32 {
        0
    }
}

/// Channel of a follower's encoder; those of the board come after it.
pub const CHANNEL_ENCODER: u8 = 0;

/// Levels of all combinations of axes: bit n of the index is axis n.
const fn levels(pins: [u32; AXES]) -> [u32; 1 << AXES] {
    let mut levels = [0; 1 << AXES];
    let mut index = 0;
    while index < levels.len() {
        let mut axis = 0;
        while axis < AXES {
            if index >> axis & 1 == 1 {
                levels[index] |= pins[axis];
            }
            axis += 1;
        }
        index += 1;
    }
    levels
}

/// A board's motors, and what they get at the next beat.
struct Edges<M> {
    motors: M,
    /// Pins that will be high, of all that there are.
    set: u32,
    /// Of them, steps.
    steps: u32,
    is_enabled: bool,
    /// Levels of the outputs, and whether they are to change.
    outputs: u8,
    has_turned: bool,
}

impl<M: Motors> Edges<M> {
    const STEPS: [u32; 1 << AXES] = levels(M::STEPS);
    const DIRECTIONS: [u32; 1 << AXES] = levels(M::DIRECTIONS);
    const ALL: u32 = Self::STEPS[(1 << AXES) - 1] | Self::DIRECTIONS[(1 << AXES) - 1];

    const fn new(motors: M) -> Self {
        Self { motors, set: 0, steps: 0, is_enabled: false, outputs: 0, has_turned: false }
    }

    /// What was calculated last: the first thing of a beat.
    #[inline]
    fn put_out(&mut self) {
        self.motors.write(self.set, Self::ALL);
        if self.has_turned {
            self.motors.outputs(self.outputs);
        }
    }

    /// Ends the pulses, and keeps what is to come; the last thing of a beat.
    #[inline]
    fn take(&mut self, out: &BeatOutput) {
        if out.is_enabled != self.is_enabled {
            self.is_enabled = out.is_enabled;
            self.motors.enable(out.is_enabled);
        }
        self.has_turned = out.outputs != self.outputs;
        self.outputs = out.outputs;
        if self.steps != 0 {
            self.motors.write(0, self.steps);
        }
        let mask = (1 << AXES) - 1;
        self.steps = Self::STEPS[usize::from(out.steps & mask)];
        self.set = self.steps | Self::DIRECTIONS[usize::from(out.directions & mask)];
    }
}

/// All that the interrupt has.
pub struct Beats<P, M, F> {
    interpolator: Interpolator<'static>,
    pace: P,
    edges: Edges<M>,
    follower: F,
    coils: [i16; 2],
    has_coils: bool,
}

impl<P: Pace, M: Motors, F: Follower> Beats<P, M, F> {
    /// At rest, with everything off.
    pub const fn new(interpolator: Interpolator<'static>, pace: P, motors: M, follower: F) -> Self {
        Self { interpolator, pace, edges: Edges::new(motors), follower, coils: [0; 2], has_coils: false }
    }

    /// One beat.
    #[inline]
    pub fn beat(&mut self) {
        self.edges.put_out();
        if self.has_coils {
            self.edges.motors.coils(self.coils);
        }
        self.pace.clear();
        let wrap = self.pace.wrap_stamp();
        let (motors, follower) = (&mut self.edges.motors, &self.follower);
        let out = self.interpolator.beat(wrap, |channel| match channel.checked_sub(CHANNEL_ENCODER + 1) {
            None => follower.measured(),
            Some(channel) => motors.sense(channel),
        });
        self.pace.set_period(out.period_cycles);
        self.coils = self.follower.follow(&out, &self.interpolator);
        self.has_coils |= self.coils != [0; 2];
        self.edges.take(&out);
    }
}

/// The same at eight times the rate, for steps: a slice of a beat at each interrupt.
pub struct FastBeats<P, M> {
    interpolator: FastInterpolator<'static>,
    pace: P,
    edges: Edges<M>,
}

impl<P: Pace, M: Motors> FastBeats<P, M> {
    /// At rest, with everything off.
    pub const fn new(interpolator: FastInterpolator<'static>, pace: P, motors: M) -> Self {
        Self { interpolator, pace, edges: Edges::new(motors) }
    }

    /// One slice.
    #[inline]
    pub fn beat(&mut self) {
        self.edges.put_out();
        self.pace.clear();
        let (motors, pace) = (&mut self.edges.motors, &mut self.pace);
        let out = self.interpolator.slice(
            || pace.wrap_stamp(),
            |channel| channel.checked_sub(CHANNEL_ENCODER + 1).map_or(0, |channel| motors.sense(channel)),
        );
        self.pace.set_period(out.period_cycles);
        self.edges.take(&out);
    }
}

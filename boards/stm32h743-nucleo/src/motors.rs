//! Beat and pins of this board as the application's [`Beats`](firmware_app::beats::Beats) takes them.
//!
//! - **Walk:** [`pace`](crate::pace), [`outputs`](crate::outputs), [`signals`](crate::signals) → *here* → interpolation. **Context:** the
//!   interrupt `TIM3`. Decision 5.

use crate::outputs::{AXES, Enable, StepPins};
use crate::pace::Pace;
use crate::signals::SignalPins;
use firmware_app::beats;
use fixed_math::time::LocalTicks;

impl beats::Pace for Pace {
    #[inline]
    fn clear(&mut self) {
        Self::clear(self);
    }

    #[inline]
    fn wrap_stamp(&mut self) -> LocalTicks {
        Self::wrap_stamp(self)
    }

    #[inline]
    fn set_period(&mut self, cycles: u32) {
        Self::set_period(self, cycles);
    }
}

/// All pins that interpolation has.
pub struct Motors {
    /// Steps and directions.
    pub steps: StepPins,
    /// Of all drivers.
    pub enable: Enable,
    /// What follows signals, and what can be read.
    pub signals: SignalPins,
}

impl beats::Motors for Motors {
    const STEPS: [u32; AXES] = [StepPins::step(0), StepPins::step(1), StepPins::step(2), StepPins::step(3)];
    const DIRECTIONS: [u32; AXES] =
        [StepPins::direction(0), StepPins::direction(1), StepPins::direction(2), StepPins::direction(3)];

    #[inline]
    fn write(&mut self, set: u32, clear: u32) {
        self.steps.write(set, clear);
    }

    fn enable(&mut self, on: bool) {
        self.enable.set(on);
    }

    fn outputs(&mut self, levels: u8) {
        self.signals.write(levels);
    }

    /// This board has no pins for coils.
    fn coils(&mut self, _: [i16; 2]) {}

    fn sense(&mut self, channel: u8) -> i32 {
        if channel == 0 { self.signals.read().into() } else { 0 }
    }
}

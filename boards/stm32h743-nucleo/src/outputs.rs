//! What moves motors: steps and directions of four axes at pins, and the drivers' enable.
//!
//! - **Walk:** interpolation → [`StepPins::write`] → pins. A backstop → [`Enable::set`].
//! - **Invariants:** from the board's start on every pin here is driven: steps and directions low, drivers off. Before that, in a reset, they
//!   float: a driver needs a resistor of its own at its enable. What [`StepPins::write`] changes changes with one store, all axes at once.
//! - **Context:** interpolation; each part has one owner. [`Enable`] may be another task's.
//!
//! | axis | step | on CN10 | direction | on CN10 |
//! |---|---|---|---|---|
//! | 0 | PE9 | D6 | PE10 | D40 |
//! | 1 | PE11 | D5 | PE12 | D39 |
//! | 2 | PE13 | D3 | PE14 | D38 |
//! | 3 | PE15 | D37 | PE0 | D34 |
//!
//! The enable is PE2, D31 on CN10 and D56 on CN9; high is on, as at `nSLEEP` of an A4988, DRV8825 or DRV8833. The names on the connectors
//! are those of ST's manual of the board (UM2407).
//!
//! Registers: RM0433 (rev 7), chapter 11, GPIO: `GPIOx_BSRR` in 11.4.7.

use stm32h7xx_hal::gpio::{Pin, PinState};
use stm32h7xx_hal::pac;

/// Axes with a step and a direction.
pub const AXES: usize = 4;

/// Pins of port E: the step and the direction of each axis.
const PINS: [(u8, u8); AXES] = [(9, 10), (11, 12), (13, 14), (15, 0)];
/// The pin of [`Enable`], of port E too.
const ENABLE_PIN: u8 = 2;

/// Drives a pin low.
pub(crate) fn low<const P: char, const N: u8>(pin: Pin<P, N>) {
    let _driven = pin.into_push_pull_output_in_state(PinState::Low);
}

/// Of pins that are driven low.
pub(crate) const fn of_low_pins() -> (StepPins, Enable) {
    (StepPins(()), Enable(()))
}

/// Steps and directions.
pub struct StepPins(());

/// The drivers' enable, for all axes.
pub struct Enable(());

impl StepPins {
    /// All pins of this.
    pub const ALL: u32 = 0xfe01;

    /// The step pin of an axis, as a bit of [`StepPins::write`].
    ///
    /// # Panics
    /// Where there is no such axis, which is a mistake of the image.
    #[must_use]
    pub const fn step(axis: usize) -> u32 {
        1 << PINS[axis].0
    }

    /// The direction pin of an axis.
    ///
    /// # Panics
    /// As [`StepPins::step`].
    #[must_use]
    pub const fn direction(axis: usize) -> u32 {
        1 << PINS[axis].1
    }

    /// Makes the pins in `clear` low and those in `set` high, which wins; leaves the others. One store.
    #[inline]
    pub fn write(&mut self, set: u32, clear: u32) {
        set_reset(set & Self::ALL, clear & Self::ALL);
    }

    /// The pins that are high.
    #[must_use]
    pub fn levels(&self) -> u32 {
        port().odr.read().bits() & Self::ALL
    }
}

impl Enable {
    /// Switches the drivers on or off.
    #[inline]
    pub fn set(&mut self, on: bool) {
        set_reset(u32::from(on) << ENABLE_PIN, 1 << ENABLE_PIN);
    }
}

/// Sets and resets pins of port E; setting wins, as `GPIOx_BSRR` has it.
fn set_reset(set: u32, reset: u32) {
    // SAFETY: any word is valid: the low half sets, the high half resets, zeros leave; callers name pins of their own alone
    port().bsrr.write(|w| unsafe { w.bits(set | reset << 16) });
}

fn port() -> &'static pac::gpioe::RegisterBlock {
    // SAFETY: the block is there for good; it is read, and written through the register that leaves other pins alone
    unsafe { &*pac::GPIOE::ptr() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_axis_has_two_pins_of_its_own_and_the_enable_another() {
        let all = (0..AXES).flat_map(|axis| [StepPins::step(axis), StepPins::direction(axis)]);
        let seen = all.fold(1 << ENABLE_PIN, |seen, pin| {
            assert_eq!(seen & pin, 0, "{pin:#x}");
            seen | pin
        });
        assert_eq!(seen, StepPins::ALL | 1 << ENABLE_PIN);
    }
}

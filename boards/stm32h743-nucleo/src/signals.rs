//! Pins of signals: four outputs that follow nodes, two inputs that can be read at a beat.
//!
//! - **Walk:** interpolation → [`SignalPins::write`] → pins; pins → [`SignalPins::read`] → readings.
//! - **Invariants:** outputs are driven low from the board's start on, inputs pulled down. One store changes all outputs.
//! - **Context:** interpolation alone.
//!
//! | pin | on CN8 | is | pin | on CN8 | is |
//! |---|---|---|---|---|---|
//! | PC8 | D43 | output 0 | PC9 | D44 | output 1 |
//! | PC10 | D45 | output 2 | PC11 | D46 | output 3 |
//! | PG2 | D49 | input, bit 0 | PG3 | D50 | input, bit 1 |
//!
//! The names on the connector are those of ST's manual of the board (UM2407).
//!
//! Registers: RM0433 (rev 7), chapter 11, GPIO: `GPIOx_BSRR` in 11.4.7, `GPIOx_IDR` in 11.4.5.

use crate::outputs::low;
use stm32h7xx_hal::gpio::{gpioc, gpiog};
use stm32h7xx_hal::pac;

/// The first pin of the outputs, of port C; the others follow.
const FIRST_OUTPUT: u32 = 8;
/// Which outputs there are.
const OUTPUTS: u32 = 0b1111;
/// The first pin of the inputs, of port G.
const FIRST_INPUT: u32 = 2;
/// Which inputs there are.
const INPUTS: u32 = 0b11;

/// Drives the outputs low and pulls the inputs down.
pub(crate) fn start(outputs: gpioc::Parts, inputs: gpiog::Parts) -> SignalPins {
    low(outputs.pc8);
    low(outputs.pc9);
    low(outputs.pc10);
    low(outputs.pc11);
    let _inputs = (inputs.pg2.into_pull_down_input(), inputs.pg3.into_pull_down_input());
    SignalPins(())
}

/// These pins.
pub struct SignalPins(());

impl SignalPins {
    /// Puts out levels, bit n is output n; bits beyond are nothing.
    #[inline]
    pub fn write(&mut self, levels: u8) {
        // SAFETY: any word is valid, and these pins of port C are the one `SignalPins`'s
        unsafe { (*pac::GPIOC::ptr()).bsrr.write(|w| w.bits(set_reset(levels))) };
    }

    /// Levels of the inputs, bit n is input n.
    #[must_use]
    #[inline]
    pub fn read(&self) -> u8 {
        // SAFETY: reading has no effect
        let levels = unsafe { (*pac::GPIOG::ptr()).idr.read().bits() };
        (levels >> FIRST_INPUT & INPUTS).to_le_bytes()[0]
    }
}

/// The word that sets high outputs and resets low ones, and leaves other pins: the low half sets, the high half resets.
const fn set_reset(levels: u8) -> u32 {
    let high = levels as u32 & OUTPUTS;
    high << FIRST_OUTPUT | (OUTPUTS & !high) << (FIRST_OUTPUT + 16)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_output_is_set_or_reset_and_no_other_pin() {
        assert_eq!(set_reset(0), 0x0f00_0000);
        assert_eq!(set_reset(0b1111), 0x0f00);
        assert_eq!(set_reset(0b1111_0101), 0x0a00_0500);
    }
}

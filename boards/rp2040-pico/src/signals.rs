//! Pins of signals: four outputs that follow nodes, two inputs that can be read at a beat.
//!
//! - **Walk:** interpolation → [`SignalPins::write`] → pins; pins → [`SignalPins::read`] → readings.
//! - **Invariants:** outputs are driven low from the board's start on, inputs pulled down. One store changes all outputs.
//! - **Context:** interpolation alone.
//!
//! | pin | on the Pico | is | pin | on the Pico | is |
//! |---|---|---|---|---|---|
//! | GPIO16 | 21 | output 0 | GPIO17 | 22 | output 1 |
//! | GPIO21 | 27 | output 2 | GPIO22 | 29 | output 3 |
//! | GPIO15 | 20 | input, bit 0 | GPIO28 | 34 | input, bit 1 |

use rp2040_hal::pac;

/// Pins of outputs 0 to 3.
const OUTPUT_PINS: [usize; 4] = [16, 17, 21, 22];
/// Pins of the inputs.
const INPUT_PINS: [usize; 2] = [15, 28];
/// What leads SIO to a pin.
const FUNCTION_SIO: u8 = 5;

/// The levels of outputs, bit n of the index is output n.
const LEVELS: [u32; 16] = {
    let mut levels = [0; 16];
    let mut index = 0;
    while index < levels.len() {
        let mut output = 0;
        while output < OUTPUT_PINS.len() {
            if index >> output & 1 == 1 {
                levels[index] |= 1 << OUTPUT_PINS[output];
            }
            output += 1;
        }
        index += 1;
    }
    levels
};

/// Drives the outputs low and lets the inputs be read. Behind the reset of SIO's pins and the pads.
pub(crate) fn start() -> SignalPins {
    // SAFETY: called once, by `Board::init`, which owns SIO, IO_BANK0 and the pads and gives these pins to nobody else; the set and clear
    // registers leave the other pins, and every function number is one that the pin has
    unsafe {
        let (sio, io, pads) = (&*pac::SIO::ptr(), &*pac::IO_BANK0::ptr(), &*pac::PADS_BANK0::ptr());
        sio.gpio_out_clr().write(|w| w.bits(LEVELS[15]));
        sio.gpio_oe_set().write(|w| w.bits(LEVELS[15]));
        for pin in INPUT_PINS {
            pads.gpio(pin).modify(|_, w| w.ie().set_bit().pde().set_bit().pue().clear_bit());
        }
        for pin in OUTPUT_PINS.into_iter().chain(INPUT_PINS) {
            io.gpio(pin).gpio_ctrl().write(|w| w.funcsel().bits(FUNCTION_SIO));
        }
    }
    SignalPins(())
}

/// These pins.
pub struct SignalPins(());

impl SignalPins {
    /// Puts out levels, bit n is output n; bits beyond are nothing.
    #[inline]
    pub fn write(&mut self, levels: u8) {
        let set = LEVELS[usize::from(levels & 15)];
        // SAFETY: these pins are the one `SignalPins`'s, and setting and clearing leave the others
        unsafe {
            let sio = &*pac::SIO::ptr();
            sio.gpio_out_set().write(|w| w.bits(set));
            sio.gpio_out_clr().write(|w| w.bits(LEVELS[15] & !set));
        }
    }

    /// Levels of the inputs, bit n is input n.
    #[must_use]
    #[inline]
    pub fn read(&self) -> u8 {
        // SAFETY: reading has no effect
        let levels = unsafe { (*pac::SIO::ptr()).gpio_in().read().bits() };
        (0..).zip(INPUT_PINS).fold(0, |bits, (at, pin)| bits | (u8::from(levels >> pin & 1 == 1) << at))
    }
}

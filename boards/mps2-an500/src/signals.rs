//! Pins of signals: four outputs that follow nodes, two inputs that can be read at a beat, and a record of the outputs that the host can read.
//!
//! - **Walk:** interpolation → [`SignalPins::write`] → pins and the record in the [`Region`]; buttons → [`SignalPins::read`] → readings.
//! - **Invariants:** outputs are driven low from the board's start on. One store changes all of them.
//! - **Context:** interpolation alone, O(outputs).
//!
//! | pin | is |
//! |---|---|
//! | EXP32 to EXP35 | outputs 0 to 3: bits 0 to 3 of GPIO block 2 |
//! | buttons 0 and 1 of the user | inputs, bits 0 and 1, 1 where pressed |
//!
//! QEMU has neither: the pins are unproven, and the buttons read as not pressed. What goes to the pins is counted in a record, words in
//! little-endian:
//!
//! | word | what |
//! |---|---|
//! | 0 | [`RECORD_MARK`] |
//! | 1 | levels, bit n is output n |
//! | 2 to 5 | rising edges of each output |

use crate::kept::{Region, SIGNALS};
use crate::pac::{GpioRegisters, IoRegisters, Registers};
use core::sync::atomic::{AtomicU32, Ordering};

/// Begins a record.
pub const RECORD_MARK: u32 = 0x0511_51c5;
/// Outputs.
pub const OUTPUTS: usize = 4;

/// The pins of the outputs.
const OUTPUT_PINS: u32 = (1 << OUTPUTS) - 1;
/// The buttons.
const BUTTONS: u8 = 0b11;

/// The record in memory.
#[repr(C)]
struct Record {
    mark: AtomicU32,
    levels: AtomicU32,
    edges: [AtomicU32; OUTPUTS],
}

impl Record {
    /// Begins a new one.
    fn clear(&self) {
        let Self { mark, levels, edges } = self;
        [levels].into_iter().chain(edges).for_each(|word| word.store(0, Ordering::Relaxed));
        mark.store(RECORD_MARK, Ordering::Relaxed);
    }

    /// Counts what changes to other levels. Nobody else writes.
    fn count(&self, after: u32) {
        let rising = after & !self.levels.load(Ordering::Relaxed);
        self.levels.store(after, Ordering::Relaxed);
        for (index, edges) in self.edges.iter().enumerate() {
            edges.store(edges.load(Ordering::Relaxed).wrapping_add(rising >> index & 1), Ordering::Relaxed);
        }
    }
}

/// These pins.
pub struct SignalPins {
    port: Registers<GpioRegisters>,
    io: Registers<IoRegisters>,
    record: &'static Record,
}

/// Drives the outputs low.
pub(crate) fn start(port: Registers<GpioRegisters>, io: Registers<IoRegisters>, region: Region) -> SignalPins {
    port.output.set(0);
    port.alternate_clear.set(OUTPUT_PINS);
    port.output_enable.set(OUTPUT_PINS);
    // SAFETY: an aligned place in RAM that is reached through atomics alone
    let record: &'static Record = unsafe { &*region.place(SIGNALS) };
    record.clear();
    SignalPins { port, io, record }
}

impl SignalPins {
    /// Puts out levels, bit n is output n; bits beyond are nothing.
    pub fn write(&mut self, levels: u8) {
        let levels = u32::from(levels) & OUTPUT_PINS;
        self.port.output.set(levels);
        self.record.count(levels);
    }

    /// Levels of the inputs, bit n is input n.
    #[must_use]
    pub fn read(&self) -> u8 {
        self.io.button.get().to_le_bytes()[0] & BUTTONS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rising_edges_are_counted_one_by_one() {
        let word = || AtomicU32::new(7);
        let record = Record { mark: word(), levels: word(), edges: [word(), word(), word(), word()] };
        record.clear();
        [0b0001, 0b0001, 0b1010, 0b0001, 0].into_iter().for_each(|levels| record.count(levels));
        assert_eq!(record.edges.map(AtomicU32::into_inner), [2, 1, 0, 1]);
        assert_eq!((record.mark.into_inner(), record.levels.into_inner()), (RECORD_MARK, 0));
    }
}

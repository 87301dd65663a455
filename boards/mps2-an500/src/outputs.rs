//! What moves motors: steps and directions of four axes at pins, the drivers' enable, and a record of both that the host can read.
//!
//! - **Walk:** interpolation → [`StepPins::write`] → pins and the record in the [`Region`]. A backstop → [`Enable::set`] → pin, LED, record.
//! - **Invariants:** from the board's start on every pin here is driven: steps and directions low, drivers off. What [`StepPins::write`]
//!   changes changes with one store.
//! - **Context:** interpolation, O(axes); each part has one owner. [`Enable`] may be another task's.
//!
//! | pin | is |
//! |---|---|
//! | EXP6, EXP8, EXP10, EXP12 | steps of axes 0 to 3: bits 6, 8, 10, 12 of GPIO block 0 |
//! | EXP7, EXP9, EXP11, EXP13 | their directions |
//! | EXP16 | enable, high is on: bit 0 of GPIO block 1 |
//! | LED 0 | the same as the enable |
//!
//! QEMU has no model of the GPIO blocks: stores there are lost, and the pins are unproven. The LEDs it has. So that its runs can be checked all
//! the same, what goes to the pins is counted in a record, words in little-endian:
//!
//! | word | what |
//! |---|---|
//! | 0 | [`RECORD_MARK`] |
//! | 1 | writes |
//! | 2 | levels of the step and direction pins, as bits of [`StepPins::write`] |
//! | 3 | 1 where the drivers are on |
//! | 4 to 7 | steps of each axis: rising edges |
//! | 8 to 11 | position of each axis: steps with the direction high less those with it low, signed |
//! | 12 | steps at which the direction changed with the same store, which a driver may take either way |

use crate::kept::{OUTPUTS, Region};
use crate::pac::{GpioRegisters, IoRegisters, Registers};
use core::sync::atomic::{AtomicU32, Ordering};

/// Begins a record.
pub const RECORD_MARK: u32 = 0x0511_0a75;
/// Axes with a step and a direction.
pub const AXES: usize = 4;

/// The first of the pins of [`StepPins`]: step and direction of each axis in turn.
const FIRST_PIN: usize = 6;
/// The pin of [`Enable`], in a block of its own, so that no store to the one changes the other.
const ENABLE_PIN: u32 = 0;

/// The record in memory.
#[repr(C)]
struct Record {
    mark: AtomicU32,
    writes: AtomicU32,
    levels: AtomicU32,
    enabled: AtomicU32,
    steps: [AtomicU32; AXES],
    positions: [AtomicU32; AXES],
    late_directions: AtomicU32,
}

impl Record {
    /// Begins a new one.
    fn clear(&self) {
        let Self { mark, writes, levels, enabled, steps, positions, late_directions } = self;
        let words = [writes, levels, enabled, late_directions].into_iter().chain(steps).chain(positions);
        words.for_each(|word| word.store(0, Ordering::Relaxed));
        mark.store(RECORD_MARK, Ordering::Relaxed);
    }

    /// Counts what changes from levels to others.
    fn count(&self, before: u32, after: u32) {
        add(&self.writes, 1);
        self.levels.store(after, Ordering::Relaxed);
        let (rising, changed) = (after & !before, after ^ before);
        if rising == 0 {
            return;
        }
        for (axis, (steps, position)) in self.steps.iter().zip(&self.positions).enumerate() {
            if rising & StepPins::step(axis) != 0 {
                add(steps, 1);
                let direction = StepPins::direction(axis);
                add(position, if after & direction == 0 { u32::MAX } else { 1 });
                add(&self.late_directions, u32::from(changed & direction != 0));
            }
        }
    }
}

/// Adds where nobody else writes.
fn add(word: &AtomicU32, more: u32) {
    word.store(word.load(Ordering::Relaxed).wrapping_add(more), Ordering::Relaxed);
}

/// Steps and directions.
pub struct StepPins {
    port: Registers<GpioRegisters>,
    record: &'static Record,
    levels: u32,
}

/// The drivers' enable, for all axes.
pub struct Enable {
    port: Registers<GpioRegisters>,
    io: Registers<IoRegisters>,
    record: &'static Record,
}

/// Drives all pins of this module: low and off.
pub(crate) fn start(
    steps: Registers<GpioRegisters>,
    enable: Registers<GpioRegisters>,
    io: Registers<IoRegisters>,
    region: Region,
) -> (StepPins, Enable) {
    for (port, pins) in [(&steps, StepPins::ALL), (&enable, 1 << ENABLE_PIN)] {
        port.output.set(0);
        port.alternate_clear.set(pins);
        port.output_enable.set(pins);
    }
    // SAFETY: an aligned place in RAM that is reached through atomics alone
    let record: &'static Record = unsafe { &*region.place(OUTPUTS) };
    record.clear();
    let mut enable = Enable { port: enable, io, record };
    enable.set(false);
    (StepPins { port: steps, record, levels: 0 }, enable)
}

impl StepPins {
    /// All pins of this.
    pub const ALL: u32 = ((1 << (2 * AXES)) - 1) << FIRST_PIN;

    /// The step pin of an axis, as a bit of [`StepPins::write`].
    ///
    /// # Panics
    /// Where there is no such axis, which is a mistake of the image.
    #[must_use]
    pub const fn step(axis: usize) -> u32 {
        assert!(axis < AXES, "no such axis");
        1 << (FIRST_PIN + 2 * axis)
    }

    /// The direction pin of an axis.
    ///
    /// # Panics
    /// As [`StepPins::step`].
    #[must_use]
    pub const fn direction(axis: usize) -> u32 {
        Self::step(axis) << 1
    }

    /// Makes the pins in `clear` low and those in `set` high, which wins; leaves the others. One store changes all.
    #[inline]
    pub fn write(&mut self, set: u32, clear: u32) {
        let levels = ((self.levels & !clear) | set) & Self::ALL;
        self.port.output.set(levels);
        self.record.count(self.levels, levels);
        self.levels = levels;
    }

    /// The pins that are high.
    #[must_use]
    pub const fn levels(&self) -> u32 {
        self.levels
    }
}

impl Enable {
    /// Switches the drivers on or off.
    pub fn set(&mut self, on: bool) {
        self.port.output.set(u32::from(on) << ENABLE_PIN);
        self.io.led.set(u32::from(on));
        self.record.enabled.store(u32::from(on), Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record() -> Record {
        let word = || AtomicU32::new(7);
        let words = || [const { AtomicU32::new(7) }; AXES];
        Record {
            mark: word(),
            writes: word(),
            levels: word(),
            enabled: word(),
            steps: words(),
            positions: words(),
            late_directions: word(),
        }
    }

    fn values<const N: usize>(words: &[AtomicU32; N]) -> [u32; N] {
        words.each_ref().map(|word| word.load(Ordering::Relaxed))
    }

    #[test]
    fn steps_count_by_their_direction_and_late_directions_are_told() {
        let record = record();
        record.clear();
        let (step, direction) = (StepPins::step, StepPins::direction);
        let levels = [
            0,
            step(0) | step(3),                // both backward
            direction(0),                     // no step
            direction(0) | step(0),           // forward
            direction(0) | step(0),           // nothing
            direction(0) | direction(2),      // falling is no step
            direction(2) | step(2) | step(0), // forward; and backward, with its direction changed at once
        ];
        for pair in levels.windows(2) {
            record.count(pair[0], pair[1]);
        }
        assert_eq!(values(&record.steps), [3, 0, 1, 1]);
        assert_eq!(values(&record.positions).map(u32::cast_signed), [-1, 0, 1, -1]);
        let rest = [&record.mark, &record.writes, &record.levels, &record.enabled, &record.late_directions];
        assert_eq!(rest.map(|word| word.load(Ordering::Relaxed)), [RECORD_MARK, 6, levels[6], 0, 1]);
    }

    #[test]
    fn the_pins_are_those_of_the_table() {
        assert_eq!([0, 1, 2, 3].map(StepPins::step), [1 << 6, 1 << 8, 1 << 10, 1 << 12]);
        assert_eq!(StepPins::direction(3), 1 << 13);
        assert_eq!(StepPins::ALL, 0x3fc0);
    }
}

//! What outlives a reset: settings, the report of why it came, and who the device is.
//!
//! - **Walk:** start-up → [`Region::take`], [`Region::factory`]; a handler → [`Region::report`] → reset → start-up.
//! - **Invariants:** the region lies outside the program's memory, so that neither start-up nor QEMU's loader writes there at a reset.
//! - **Context:** start-up; [`Region::report`] in handlers, with everything else stopped. **Clause:** `[DSC-05]`.
//!
//! These boards have no flash of their own to write to: their pseudo-static RAM stands for it, handled as flash is. It outlives a
//! reset, and the emulator's end where a file backs it:
//! `-object memory-backend-file,id=nvm,size=16M,mem-path=FILE,share=on -machine mps2-an500,memory-backend=nvm`.
//!
//! | offset | bytes | what |
//! |---|---|---|
//! | 0x0000 | 16 KiB | settings, four pages of flash |
//! | 0x4000 | [`REPORT_WORDS`] × 4 | why the device was reset |
//! | 0x5000 | 20 | the factory record: who the device is |
//! | 0x6000 | 32 | what the latency probe counted, with the feature `probe` |
//! | 0x7000 | 52 | what was put out at the motors' pins, see [`crate::outputs`] |
//! | 0x7800 | 24 | what was put out at the signals' pins, see [`crate::signals`] |
//!
//! These chips have no identity in silicon, so that whoever starts one gives it a factory record, little-endian: `0x0511_fac7`, twelve
//! bytes of unique id, an index into `firmware_app::kind::KINDS`. It may stand in the file before the start, or be loaded, eight bytes
//! at a time: `-device loader,addr=0x60005000,data=…,data-len=8`. Without one the device is a hub, with [`Factory::UNKNOWN`]'s id.

use firmware_app::Kind;
use firmware_app::kind::{HUB, KINDS};
use firmware_app::report::{REPORT_WORDS, Report};
use firmware_app::settings::memory::MemoryFlash;
use osap_protocol::discovery::UniqueId;

/// Settings, as flash.
pub type SettingsFlash = MemoryFlash<4>;

/// Offset of the settings in the region.
const SETTINGS: usize = 0;
/// Offset of the report.
const REPORT: usize = 0x4000;
/// Offset of the factory record.
const FACTORY: usize = 0x5000;
/// Offset of the probe's record.
pub(crate) const PROBE: usize = 0x6000;
/// Offset of the outputs' record.
pub(crate) const OUTPUTS: usize = 0x7000;
/// Offset of the signals' record.
pub(crate) const SIGNALS: usize = 0x7800;

const _: () = assert!(size_of::<SettingsFlash>() <= REPORT - SETTINGS && REPORT_WORDS * 4 <= FACTORY - REPORT);

/// Begins a factory record.
pub const FACTORY_MARK: u32 = 0x0511_fac7;

/// Words of a factory record.
const FACTORY_WORDS: usize = 5;

/// Memory that outlives a reset.
#[derive(Clone, Copy, Debug)]
pub struct Region(usize);

/// The region's two parts that are written to.
pub struct Kept {
    /// For [`firmware_app::settings::Settings`].
    pub settings: &'static mut SettingsFlash,
    /// For [`Report::decode`].
    pub report: &'static mut [u32; REPORT_WORDS],
}

/// Who a device was made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Factory {
    /// Which one.
    pub unique_id: UniqueId,
    /// What kind.
    pub kind: &'static Kind,
}

impl Region {
    /// The 16 MiB of RAM at `address`, which is a board's own.
    #[must_use]
    pub const fn at(address: usize) -> Self {
        Self(address)
    }

    pub(crate) fn place<T>(self, offset: usize) -> *mut T {
        core::ptr::with_exposed_provenance_mut(self.0 + offset)
    }

    pub(crate) fn take(self) -> Kept {
        // SAFETY: both are arrays of integers at aligned places in RAM that nothing else is laid over; `Board::new` consumes the
        // peripherals, which there are once, so these references are made once. A handler that writes the report never returns.
        unsafe { Kept { settings: &mut *self.place(SETTINGS), report: &mut *self.place(REPORT) } }
    }

    pub(crate) fn factory(self) -> Factory {
        // SAFETY: an aligned place in RAM that is only ever read.
        Factory::read(unsafe { &*self.place::<[u32; FACTORY_WORDS]>(FACTORY) })
    }

    /// Writes down why the device is about to be reset.
    ///
    /// # Safety
    /// Nothing else runs any more: interrupts are masked, and the caller never returns.
    pub unsafe fn report(self, report: &Report) {
        // SAFETY: an aligned place in RAM; start-up's reference to it is used no more, as the caller vouches.
        report.encode(unsafe { &mut *self.place(REPORT) });
    }
}

impl Factory {
    /// Nobody in particular.
    pub const UNKNOWN: Self = Self { unique_id: UniqueId(*b"mps2-unknown"), kind: &HUB };

    /// Reads a record; [`Factory::UNKNOWN`] where there is none, a hub where its kind is none.
    fn read(words: &[u32; FACTORY_WORDS]) -> Self {
        let [FACTORY_MARK, id @ .., kind] = *words else { return Self::UNKNOWN };
        let mut unique_id = [0; 12];
        for (four, word) in unique_id.chunks_exact_mut(4).zip(id) {
            four.copy_from_slice(&word.to_le_bytes());
        }
        let kind = usize::from(kind.to_le_bytes()[0]);
        Self { unique_id: UniqueId(unique_id), kind: KINDS.get(kind).unwrap_or(&HUB) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_app::kind::MOTOR;

    #[test]
    fn a_factory_record_is_taken_as_written_and_nothing_else_for_one() {
        assert_eq!(Factory::read(&[0; 5]), Factory::UNKNOWN);
        assert_eq!(Factory::read(&[u32::MAX; 5]), Factory::UNKNOWN);
        let read = Factory::read(&[FACTORY_MARK, 0x0403_0201, 0x0807_0605, 0x0c0b_0a09, 1]);
        assert_eq!(read, Factory { unique_id: UniqueId([1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]), kind: &MOTOR });
        assert_eq!(Factory::read(&[FACTORY_MARK, 1, 2, 3, 77]).kind, &HUB);
    }
}

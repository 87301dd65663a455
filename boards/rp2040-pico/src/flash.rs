//! The flash chip: its number, and its last 64 KiB for settings.
//!
//! - **Invariants:** nothing is read from flash while it is written: code, constants and vectors are in RAM, and only idle comes here.
//!   Interrupts go on.
//! - **Context:** start-up, and idle. A write takes about a millisecond, an erasure about 45, 400 at worst.

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use rp2040_hal::{pac, rom_data};

/// Start of the settings, from the flash's; as in memory.x.
const OFFSET: u32 = 0x001f_0000;
/// Bytes of the settings.
pub const SETTINGS_BYTES: u32 = 64 * 1024;
/// Where the processor reads the flash.
const MAPPED: u32 = 0x1000_0000;
/// What the chip writes at once.
const PAGE_BYTES: usize = 256;
const SECTOR_BYTES: usize = 4096;
/// Erases 64 KiB at once, where an erasure is as long.
const BLOCK_BYTES: u32 = 1 << 16;
const BLOCK_ERASE: u8 = 0xd8;
const READ_UNIQUE_ID: u8 = 0x4b;
const UNIQUE_ID_DUMMY_BYTES: usize = 4;

/// The chip's 64-bit number behind four letters for its maker.
pub(crate) fn unique_id() -> [u8; 12] {
    let mut id = *b"2040\0\0\0\0\0\0\0\0";
    let (_letters, number) = id.split_at_mut(4);
    // SAFETY: nothing else reads flash: called at start-up, before interrupts are enabled, and all code is in RAM
    unsafe { without_mapping(|| command(READ_UNIQUE_ID, UNIQUE_ID_DUMMY_BYTES, number)) };
    id
}

/// Asks the chip by `code`, passes over `dummy` bytes and reads the answer.
fn command(code: u8, dummy: usize, answer: &mut [u8]) {
    // SAFETY: the flash is not mapped meanwhile, and only this module uses its interface
    let ssi = unsafe { &*pac::XIP_SSI::ptr() };
    let frames = (dummy + answer.len()).saturating_sub(1) as u32;
    ssi.ssienr().write(|w| w.ssi_en().clear_bit());
    ssi.ctrlr0().modify(|_, w| w.tmod().eeprom_read());
    // SAFETY: the number of frames to read, less one
    ssi.ctrlr1().write(|w| unsafe { w.bits(frames) });
    ssi.ssienr().write(|w| w.ssi_en().set_bit());
    // SAFETY: any byte may be sent
    ssi.dr0().write(|w| unsafe { w.bits(u32::from(code)) });
    for place in 0..dummy + answer.len() {
        while ssi.sr().read().rfne().bit_is_clear() {}
        let byte = ssi.dr0().read().bits().to_le_bytes()[0];
        if let Some(place) = place.checked_sub(dummy).and_then(|place| answer.get_mut(place)) {
            *place = byte;
        }
    }
    ssi.ssienr().write(|w| w.ssi_en().clear_bit());
    // the ROM takes it to be 0 when it maps the flash again
    // SAFETY: the register's value after reset
    ssi.ctrlr1().write(|w| unsafe { w.bits(0) });
}

/// Does `work` while the flash takes commands and is not mapped. It is mapped again in the slow way that any flash understands, which
/// only settings are read by.
///
/// # Safety
/// Nothing may read or execute flash meanwhile, interrupts included.
unsafe fn without_mapping(work: impl FnOnce()) {
    // SAFETY: the caller's promise; the order is the data sheet's (RP2040, 2.8.3.1.3)
    unsafe {
        rom_data::connect_internal_flash();
        rom_data::flash_exit_xip();
        work();
        rom_data::flash_flush_cache();
        rom_data::flash_enter_cmd_xip();
    }
}

/// The settings' part of the flash.
pub struct SettingsFlash(());

impl SettingsFlash {
    /// For the one who writes settings.
    ///
    /// # Safety
    /// There is one at a time, and nothing reads or executes flash while it writes.
    #[must_use]
    pub const unsafe fn new() -> Self {
        Self(())
    }
}

/// What the flash refuses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refused(NorFlashErrorKind);

impl NorFlashError for Refused {
    fn kind(&self) -> NorFlashErrorKind {
        self.0
    }
}

impl ErrorType for SettingsFlash {
    type Error = Refused;
}

impl ReadNorFlash for SettingsFlash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Refused> {
        check_read(self, offset, bytes.len()).map_err(Refused)?;
        let from = (MAPPED + OFFSET + offset) as *const u8;
        for (place, byte) in bytes.iter_mut().enumerate() {
            // SAFETY: within the mapped flash, as checked; volatile since it is written behind the compiler's back
            *byte = unsafe { from.add(place).read_volatile() };
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        SETTINGS_BYTES as usize
    }
}

impl NorFlash for SettingsFlash {
    // the chip takes single bytes, as long as they are erased: what is beside them is written as ones, which changes nothing
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR_BYTES;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Refused> {
        check_erase(self, from, to).map_err(Refused)?;
        // SAFETY: as `new` demands, and sectors of the settings alone
        unsafe {
            without_mapping(|| {
                rom_data::flash_range_erase(OFFSET + from, (to - from) as usize, BLOCK_BYTES, BLOCK_ERASE);
            });
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Refused> {
        check_write(self, offset, bytes.len()).map_err(Refused)?;
        let mut at = offset as usize;
        let mut rest = bytes;
        while !rest.is_empty() {
            let within = at % PAGE_BYTES;
            let (now, later) = rest.split_at(rest.len().min(PAGE_BYTES - within));
            let mut page = [0xff; PAGE_BYTES];
            page[within..within + now.len()].copy_from_slice(now);
            let start = OFFSET + (at - within) as u32;
            // SAFETY: as `new` demands, and a page of the settings alone
            unsafe { without_mapping(|| rom_data::flash_range_program(start, page.as_ptr(), PAGE_BYTES)) };
            at += now.len();
            rest = later;
        }
        Ok(())
    }
}

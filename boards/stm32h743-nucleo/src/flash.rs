//! The last two sectors of flash bank 2, for settings.
//!
//! - **Walk:** start-up and idle → `firmware_app::settings` → *here* → the HAL's driver.
//! - **Invariants:** the image lies in bank 1 whole, and a bank can be read while the other is written (RM0433, chapter 4): writing stops
//!   no task. Bank 2 is set up as device memory (see `memory.rs`), so that no cache keeps what was there, and the processor does not
//!   read ahead into a bank that is being erased, which would stall it.
//! - **Context:** start-up, and idle. A flash word takes some 0.1 ms to write, a sector of 128 KiB some 1 s to erase (data sheet, flash
//!   memory characteristics); both are waited for here, with interrupts going on. **Clause:** `[DSC-05]`.
//!
//! Each flash word of 32 bytes has a check. One that was being written when power failed may fail it, and reading it then ends in a bus
//! fault: reported of many devices in the field, where it meant a device that never starts again. So words are read with bus faults
//! ignored, and one that fails reads as zeros, which the store over this takes for what it is: an item that was never finished.

use core::sync::atomic::{Ordering, fence};
use cortex_m::peripheral::SCB;
use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use stm32h7xx_hal::flash::{FlashExt, LockedFlashBank};
use stm32h7xx_hal::pac;

/// Bytes of the settings.
pub const SETTINGS_BYTES: u32 = 2 * SECTOR_BYTES;

/// Start of bank 2, and its bytes.
pub(crate) const BANK: u32 = 0x0810_0000;
const BANK_BYTES: u32 = 1 << 20;
/// Start of the settings, from the bank's.
const OFFSET: u32 = BANK_BYTES - SETTINGS_BYTES;
const SECTOR_BYTES: u32 = 128 * 1024;
/// What has a check, and is written at once.
const WORD_BYTES: usize = 32;
/// Flags of a failure in `FLASH_SR2`: WRPERR, PGSERR, STRBERR, INCERR, OPERR (RM0433, 4.7).
const WRITE_ERRORS: u32 = 1 << 17 | 1 << 18 | 1 << 19 | 1 << 21 | 1 << 22;
/// All that `FLASH_CCR2` clears, the reading errors included.
const ALL_ERRORS: u32 = WRITE_ERRORS | 1 << 23 | 1 << 24 | 1 << 25 | 1 << 26;
/// `SCB_CCR.BFHFNMIGN` (ARMv7-M, B3.2.8): a data access that fails gives any value and no fault, below priority 0.
const IGNORE_BUS_FAULTS: u32 = 1 << 8;
/// `SCB_CFSR`: a data bus fault was told, with its address. Written to clear.
const BUS_FAULT_STATUS: u32 = 1 << 9 | 1 << 15;

/// The settings' part of the flash.
pub struct SettingsFlash {
    bank: LockedFlashBank,
}

impl SettingsFlash {
    /// `None` on a chip with one bank, which a Nucleo's is not.
    pub(crate) fn new(flash: pac::FLASH) -> Option<Self> {
        let (_, bank) = flash.split();
        bank.map(|bank| Self { bank })
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
        let mut at = offset as usize;
        let mut rest = bytes;
        while !rest.is_empty() {
            let within = at % WORD_BYTES;
            let (now, later) = rest.split_at_mut(rest.len().min(WORD_BYTES - within));
            let word = read_word(at - within);
            now.copy_from_slice(&word[within..within + now.len()]);
            at += now.len();
            rest = later;
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        SETTINGS_BYTES as usize
    }
}

impl NorFlash for SettingsFlash {
    const WRITE_SIZE: usize = WORD_BYTES;
    const ERASE_SIZE: usize = SECTOR_BYTES as usize;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Refused> {
        check_erase(self, from, to).map_err(Refused)?;
        for at in (from..to).step_by(Self::ERASE_SIZE) {
            clear_errors();
            let mut bank = self.bank.unlocked();
            let told = NorFlash::erase(&mut bank, OFFSET + at, OFFSET + at + SECTOR_BYTES);
            // before `bank` is locked again
            finish(told)?;
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Refused> {
        check_write(self, offset, bytes.len()).map_err(Refused)?;
        clear_errors();
        let mut bank = self.bank.unlocked();
        let told = NorFlash::write(&mut bank, OFFSET + offset, bytes);
        finish(told)
    }
}

/// Clears what failed before: the HAL looks at the flags but clears them in `FLASH_SR2`, where they are read-only.
fn clear_errors() {
    // SAFETY: `FLASH_CCR2` takes any pattern of the flags above
    registers().ccr.write(|w| unsafe { w.bits(ALL_ERRORS) });
}

/// Waits for what the HAL began, as it does not wait for what still queues, and says how it ended.
fn finish(told: Result<(), stm32h7xx_hal::flash::Error>) -> Result<(), Refused> {
    let status = loop {
        let status = registers().sr.read();
        if status.qw().bit_is_clear() && status.bsy().bit_is_clear() {
            break status.bits();
        }
    };
    match told {
        Ok(()) if status & WRITE_ERRORS == 0 => Ok(()),
        Ok(()) => Err(Refused(NorFlashErrorKind::Other)),
        Err(error) => Err(Refused(error.kind())),
    }
}

/// The flash word at `offset` of the settings; zeros where its check fails.
fn read_word(offset: usize) -> [u8; WORD_BYTES] {
    let from = ((BANK + OFFSET) as usize + offset) as *const u32;
    // SAFETY: a whole word of the settings, checked by the caller; volatile since it is written behind the compiler's back
    let words: [u32; WORD_BYTES / 4] =
        ignoring_bus_faults(|| core::array::from_fn(|n| unsafe { from.add(n).read_volatile() }));
    if registers().sr.read().dbeccerr().bit_is_set() {
        clear_errors();
        return [0; WORD_BYTES];
    }
    let mut bytes = [0; WORD_BYTES];
    for (four, word) in bytes.chunks_exact_mut(4).zip(words) {
        four.copy_from_slice(&word.to_le_bytes());
    }
    bytes
}

/// Does `read` at the priority of a hard fault, where bus faults can be ignored: every interrupt waits, for eight loads.
fn ignoring_bus_faults<R>(read: impl FnOnce() -> R) -> R {
    // SAFETY: these registers are the processor's own; start-up and idle, which alone come here, have no fault mask set, and nothing
    // that could change them runs meanwhile
    unsafe {
        let scb = &*SCB::PTR;
        set_fault_mask();
        scb.ccr.modify(|ccr| ccr | IGNORE_BUS_FAULTS);
        barrier();
        let result = read();
        barrier();
        scb.ccr.modify(|ccr| ccr & !IGNORE_BUS_FAULTS);
        scb.cfsr.write(BUS_FAULT_STATUS);
        barrier();
        clear_fault_mask();
        result
    }
}

fn barrier() {
    fence(Ordering::SeqCst);
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// Sets FAULTMASK.
///
/// # Safety
/// [`clear_fault_mask`] follows soon.
unsafe fn set_fault_mask() {
    #[cfg(target_arch = "arm")]
    // SAFETY: as said; it touches no memory
    unsafe {
        core::arch::asm!("cpsid f", options(nostack, preserves_flags));
    }
}

/// Clears FAULTMASK.
///
/// # Safety
/// It was not set before [`set_fault_mask`].
unsafe fn clear_fault_mask() {
    #[cfg(target_arch = "arm")]
    // SAFETY: as said
    unsafe {
        core::arch::asm!("cpsie f", options(nostack, preserves_flags));
    }
}

fn registers() -> &'static pac::flash::BANK {
    // SAFETY: the block is there for good; `SettingsFlash` alone uses bank 2's registers, the HAL's driver within it included
    unsafe { &*pac::FLASH::ptr() }.bank2()
}

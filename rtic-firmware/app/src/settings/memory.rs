//! Memory that behaves as flash does: for boards that have none, and for tests.
//!
//! - **Invariants:** erasing sets bits, writing only clears them; what is out of range or crosses a word is refused.
//! - **Context:** start-up and idle.

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};

/// Bytes of a page.
const PAGE_BYTES: usize = 4096;

/// `PAGES` pages of 4 KiB. As `repr(transparent)` over its bytes it may be laid over a region that start-up leaves alone.
#[derive(Clone, Debug)]
#[repr(transparent)]
pub struct MemoryFlash<const PAGES: usize>([[u8; PAGE_BYTES]; PAGES]);

impl<const PAGES: usize> MemoryFlash<PAGES> {
    /// Its size, bytes.
    #[expect(clippy::cast_possible_truncation, reason = "a memory of 4 GiB has no place on these processors")]
    pub const BYTES: u32 = (PAGES * PAGE_BYTES) as u32;

    /// Erased.
    #[must_use]
    pub const fn new() -> Self {
        Self([[0xff; PAGE_BYTES]; PAGES])
    }

    fn slice(&mut self, offset: u32, len: usize) -> &mut [u8] {
        let start = usize::try_from(offset).unwrap_or(usize::MAX);
        let end = start.saturating_add(len);
        self.0.as_flattened_mut().get_mut(start..end).unwrap_or_default()
    }
}

impl<const PAGES: usize> Default for MemoryFlash<PAGES> {
    fn default() -> Self {
        Self::new()
    }
}

/// What flash refuses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refused(NorFlashErrorKind);

impl NorFlashError for Refused {
    fn kind(&self) -> NorFlashErrorKind {
        self.0
    }
}

impl<const PAGES: usize> ErrorType for MemoryFlash<PAGES> {
    type Error = Refused;
}

impl<const PAGES: usize> ReadNorFlash for MemoryFlash<PAGES> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Refused> {
        check_read(self, offset, bytes.len()).map_err(Refused)?;
        bytes.copy_from_slice(self.slice(offset, bytes.len()));
        Ok(())
    }

    fn capacity(&self) -> usize {
        PAGES * PAGE_BYTES
    }
}

impl<const PAGES: usize> NorFlash for MemoryFlash<PAGES> {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = PAGE_BYTES;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Refused> {
        check_erase(self, from, to).map_err(Refused)?;
        self.slice(from, usize::try_from(to - from).unwrap_or(0)).fill(0xff);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Refused> {
        check_write(self, offset, bytes.len()).map_err(Refused)?;
        for (place, byte) in self.slice(offset, bytes.len()).iter_mut().zip(bytes) {
            *place &= byte;
        }
        Ok(())
    }
}

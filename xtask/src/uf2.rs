//! A UF2 file: what the boot ROM of an RP2040 takes when it is copied to the drive that it shows.
//!
//! The format is Microsoft's, the family and the erratum are Raspberry Pi's. This is written here because no library fits: the
//! crate `uf2` knows neither families nor addresses, `elf2uf2-rs` is a program only, and `elf2flash-core` brings a reader
//! of ELF files of its own beside the one that this driver has.

use std::collections::BTreeMap;
use std::ops::Range;

use crate::elf::Segment;

/// Length of a block, which is a sector of the drive.
const BLOCK_BYTES: usize = 512;

/// What a block carries: a page, which is what the flash is written by.
const PAGE_BYTES: u32 = 256;

/// What the flash is erased by.
const SECTOR_BYTES: u32 = 4096;

type Page = [u8; PAGE_BYTES as usize];

/// What a page has where the image has nothing.
const EMPTY: Page = [0; PAGE_BYTES as usize];

/// A block begins with these two words and ends with [`MAGIC_END`].
const MAGIC_START: [u32; 2] = [0x0A32_4655, 0x9E5D_5157];

/// The last word of a block.
const MAGIC_END: u32 = 0x0AB1_6F30;

/// The flag which says that the block names its chip's family.
const FLAG_FAMILY: u32 = 0x0000_2000;

/// The family of the RP2040.
const FAMILY_RP2040: u32 = 0xE48B_FF56;

/// Where the RP2040 sees its flash: 16 MiB of room, of which a Pico has two.
const FLASH: Range<u32> = 0x1000_0000..0x1100_0000;

/// Where the RP2040 has RAM, which a file for the flash leaves alone.
const RAM: Range<u32> = 0x2000_0000..0x2004_2000;

/// Why an image cannot become a UF2 file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Uf2Error {
    /// Bytes that are kept neither in flash nor in RAM.
    #[error(
        "{bytes} bytes at {address:#010x} lie neither in the flash of an RP2040 nor in its RAM; compare the board's memory.x"
    )]
    Elsewhere {
        /// Address of the first one.
        address: u64,
        /// How many.
        bytes: usize,
    },
    /// Nothing is kept in flash.
    #[error("nothing of this image is kept in flash; compare the board's memory.x")]
    Empty,
}

/// The blocks that put `segments` into the flash.
///
/// All of a sector that is touched is written, with zeros where the image has nothing, but for the end of the last one:
/// the boot ROM erases a sector when it counts that one begins, and a gap would make it count wrong (RP2040-E14).
pub(crate) fn encode(segments: &[Segment]) -> Result<Vec<u8>, Uf2Error> {
    let pages = pages(segments)?;
    let count = pages.keys().fold(0_u32, |count, _| count + 1);
    let mut file = Vec::with_capacity(pages.len() * BLOCK_BYTES);
    for ((&address, page), number) in pages.iter().zip(0_u32..) {
        let [first, second] = MAGIC_START;
        let head = [first, second, FLAG_FAMILY, address, PAGE_BYTES, number, count, FAMILY_RP2040];
        let end = file.len() + BLOCK_BYTES;
        file.extend(head.iter().flat_map(|word| word.to_le_bytes()));
        file.extend(page);
        file.resize(end - size_of_val(&MAGIC_END), 0);
        file.extend(MAGIC_END.to_le_bytes());
    }
    Ok(file)
}

/// Pages of flash by address, all of the sectors that are touched.
fn pages(segments: &[Segment]) -> Result<BTreeMap<u32, Page>, Uf2Error> {
    let mut pages = BTreeMap::new();
    for Segment { address, data } in segments {
        let elsewhere = Uf2Error::Elsewhere { address: *address, bytes: data.len() };
        let Some(range) = range(*address, data.len()) else { return Err(elsewhere) };
        if lies_in(&range, &RAM) {
            continue;
        }
        if !lies_in(&range, &FLASH) {
            return Err(elsewhere);
        }
        for (at, byte) in range.zip(data) {
            let within = at % PAGE_BYTES;
            let page: &mut Page = pages.entry(at - within).or_insert(EMPTY);
            page[within as usize] = *byte;
        }
    }
    let last = *pages.last_key_value().ok_or(Uf2Error::Empty)?.0;
    let touched: Vec<u32> = pages.keys().map(|page| page - page % SECTOR_BYTES).collect();
    for sector in touched {
        for page in (sector..sector + SECTOR_BYTES).step_by(EMPTY.len()).take_while(|page| *page <= last) {
            pages.entry(page).or_insert(EMPTY);
        }
    }
    Ok(pages)
}

/// Addresses of `bytes` bytes from `address` on, where a 32-bit chip has them.
fn range(address: u64, bytes: usize) -> Option<Range<u32>> {
    let start = u32::try_from(address).ok()?;
    Some(start..start.checked_add(u32::try_from(bytes).ok()?)?)
}

fn lies_in(inner: &Range<u32>, outer: &Range<u32>) -> bool {
    outer.start <= inner.start && inner.end <= outer.end
}

#[cfg(test)]
mod tests {
    use super::*;

    fn segment(address: u64, data: &[u8]) -> Segment {
        Segment { address, data: data.to_vec() }
    }

    /// Address, block number, count of blocks and the page of each block of a file.
    fn blocks(file: &[u8]) -> Vec<(u32, u32, u32, Vec<u8>)> {
        let word = |block: &[u8], at: usize| u32::from_le_bytes(block[at..at + 4].try_into().unwrap());
        let (blocks, rest) = file.as_chunks::<BLOCK_BYTES>();
        assert!(rest.is_empty());
        blocks.iter().map(|b| (word(b, 12), word(b, 20), word(b, 24), b[32..288].to_vec())).collect()
    }

    #[test]
    fn a_block_is_laid_out_as_published() {
        // By hand from the format's page: "UF2\n", "WQ]\x9e", flags, address, payload's length, number, count, family, data.
        let mut expected = b"UF2\nWQ\x5d\x9e\x00\x20\x00\x00\x00\x00\x00\x10\x00\x01\x00\x00".to_vec();
        expected.extend(b"\x00\x00\x00\x00\x01\x00\x00\x00\x56\xff\x8b\xe4");
        expected.extend(b"\x01\x02\x03");
        expected.resize(508, 0);
        expected.extend(b"\x30\x6f\xb1\x0a");
        assert_eq!(encode(&[segment(0x1000_0000, &[1, 2, 3])]).unwrap(), expected);
    }

    #[test]
    fn blocks_are_numbered_in_the_order_of_their_addresses_and_share_pages() {
        let file =
            encode(&[segment(0x1000_0102, &[7]), segment(0x1000_0000, &[1; 256]), segment(0x1000_0100, &[5, 6])]);
        let blocks = blocks(&file.unwrap());
        let heads: Vec<_> = blocks.iter().map(|&(address, number, count, _)| (address, number, count)).collect();
        assert_eq!(heads, [(0x1000_0000, 0, 2), (0x1000_0100, 1, 2)]);
        assert_eq!(blocks[1].3[..4], [5, 6, 7, 0]);
    }

    #[test]
    fn a_touched_sector_is_written_from_its_beginning_and_without_gaps_up_to_the_last_page() {
        let file = encode(&[segment(0x1000_0300, &[1]), segment(0x1000_2200, &[2])]).unwrap();
        let found: Vec<_> = blocks(&file).iter().map(|block| block.0).collect();
        // the first sector whole, nothing of the second, the third up to its last page in use
        let first = (0..16).map(|page| 0x1000_0000 + page * 0x100);
        let expected: Vec<u32> = first.chain([0x1000_2000, 0x1000_2100, 0x1000_2200]).collect();
        assert_eq!(found, expected);
        assert_eq!(blocks(&file)[0].3, [0; 256]);
    }

    #[test]
    fn what_is_in_ram_is_left_out_and_what_is_nowhere_is_an_error() {
        let flash = segment(0x1000_0000, &[1]);
        let with_ram = encode(&[flash.clone(), segment(0x2000_0000, &[1; 300])]).unwrap();
        assert_eq!(with_ram, encode(&[flash]).unwrap());
        assert_eq!(encode(&[segment(0x2000_0000, &[1])]), Err(Uf2Error::Empty));
        for (address, bytes) in [(0, 4), (0x0fff_ffff, 2), (0x10ff_ffff, 2), (0x2004_1fff, 2), (0x0800_0000, 1)] {
            let elsewhere = Uf2Error::Elsewhere { address, bytes };
            assert_eq!(encode(&[segment(address, &vec![0; bytes])]), Err(elsewhere), "{address:#x}");
        }
    }
}

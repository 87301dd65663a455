//! What an image's ELF says about memory: its sections, where they are kept and where they run, its symbols, and the bytes
//! that a loader puts into the device.

use object::elf::{PT_LOAD, SHF_ALLOC, SHF_EXECINSTR, SHF_WRITE};
use object::read::elf::{ElfFile32, ProgramHeader};
use object::{LittleEndian, Object, ObjectSection, ObjectSymbol, SectionFlags, SymbolKind};

/// Why an ELF tells nothing that can be used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ElfError {
    /// It is not the 32-bit little-endian ELF that an image is.
    #[error("not the ELF of an image: {0}; build it with `cargo xtask build`")]
    Object(#[from] object::Error),
    /// A section has bytes for the device that no segment loads.
    #[error("the section `{name}` has {bytes} bytes that nothing would load; give it a region in the board's memory.x")]
    NotLoaded {
        /// The section.
        name: String,
        /// Its length.
        bytes: u64,
    },
    /// The file ends before what it says that it has.
    #[error("the file ends within what is loaded at {address:#010x}; build it again")]
    CutOff {
        /// Where it would be loaded.
        address: u64,
    },
    /// There is nothing in it that could be loaded.
    #[error(
        "the ELF has nothing to load; is `-Tlink.x` among the linker's arguments, and has the crate an entry point?"
    )]
    Empty,
}

/// A section that takes memory on the device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Section {
    /// Its name.
    pub(crate) name: String,
    /// Where the program finds it.
    pub(crate) address: u64,
    /// How long it is.
    pub(crate) bytes: u64,
    /// Where it is kept while the power is off; `None` where it only takes room.
    pub(crate) kept_at: Option<u64>,
    /// It holds instructions.
    pub(crate) is_code: bool,
    /// The program may write to it.
    pub(crate) is_writable: bool,
}

impl Section {
    /// Whether `address` lies in it, as the program sees it.
    pub(crate) fn contains(&self, address: u64) -> bool {
        (self.address..self.address + self.bytes).contains(&address)
    }
}

/// A function or a static, with the memory that it takes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Symbol {
    /// Its path, as one would write it in Rust.
    pub(crate) name: String,
    /// Where the program finds it; for a function without the bit that says Thumb.
    pub(crate) address: u64,
    /// How long it is.
    pub(crate) bytes: u64,
    /// It is a function.
    pub(crate) is_function: bool,
}

/// Bytes that a loader puts into the device, and where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Segment {
    /// Address of the first one, where it is kept and not where it runs.
    pub(crate) address: u64,
    /// The bytes.
    pub(crate) data: Vec<u8>,
}

/// All of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Layout {
    /// Sections in the order of the file.
    pub(crate) sections: Vec<Section>,
    /// Functions and statics that take memory.
    pub(crate) symbols: Vec<Symbol>,
    /// What is loaded, in the order of the file.
    pub(crate) segments: Vec<Segment>,
}

/// Where a part of the file is loaded.
struct Loaded {
    offset: u64,
    bytes: u64,
    address: u64,
}

impl Layout {
    /// Reads the ELF in `file`.
    pub(crate) fn parse(file: &[u8]) -> Result<Self, ElfError> {
        let elf = ElfFile32::<LittleEndian>::parse(file)?;
        let (mut loaded, mut segments) = (Vec::new(), Vec::new());
        for header in elf.elf_program_headers() {
            let little = LittleEndian;
            let bytes = u64::from(header.p_filesz(little));
            if header.p_type(little) != PT_LOAD || bytes == 0 {
                continue;
            }
            let address = u64::from(header.p_paddr(little));
            let data = header.data(little, file).map_err(|()| ElfError::CutOff { address })?;
            loaded.push(Loaded { offset: u64::from(header.p_offset(little)), bytes, address });
            segments.push(Segment { address, data: data.to_vec() });
        }
        if segments.is_empty() {
            return Err(ElfError::Empty);
        }
        let sections = elf.sections().filter_map(|section| read_section(&section, &loaded).transpose());
        let sections = sections.collect::<Result<_, _>>()?;
        let symbols = elf.symbols().filter_map(|symbol| read_symbol(&symbol)).collect();
        Ok(Self { sections, symbols, segments })
    }
}

/// A section that takes memory; none where it is only for tools to read.
fn read_section<'data>(section: &impl ObjectSection<'data>, loaded: &[Loaded]) -> Result<Option<Section>, ElfError> {
    let SectionFlags::Elf { sh_flags, .. } = section.flags() else { return Ok(None) };
    let has = |flag: object::elf::SectionFlags| sh_flags.0 & flag.0 != 0;
    if !has(SHF_ALLOC) || section.size() == 0 {
        return Ok(None);
    }
    let name = section.name()?.to_owned();
    let kept_at = match section.file_range() {
        None => None,
        Some((offset, bytes)) => {
            let whole = loaded.iter().find(|part| part.offset <= offset && offset + bytes <= part.offset + part.bytes);
            let part = whole.ok_or_else(|| ElfError::NotLoaded { name: name.clone(), bytes })?;
            Some(part.address + (offset - part.offset))
        }
    };
    let (address, bytes) = (section.address(), section.size());
    Ok(Some(Section { name, address, bytes, kept_at, is_code: has(SHF_EXECINSTR), is_writable: has(SHF_WRITE) }))
}

fn read_symbol<'data>(symbol: &impl ObjectSymbol<'data>) -> Option<Symbol> {
    let is_function = match symbol.kind() {
        SymbolKind::Text => true,
        SymbolKind::Data => false,
        _ => return None,
    };
    let name = format!("{:#}", rustc_demangle::demangle(symbol.name().ok()?));
    let address = if is_function { symbol.address() & !1 } else { symbol.address() };
    (symbol.size() > 0).then_some(Symbol { name, address, bytes: symbol.size(), is_function })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Where the parts of the file below begin.
    const TEXT_AT: u32 = 0x80;
    const NAMES_AT: u32 = 0x90;
    const SYMBOLS_AT: u32 = 0xd0;
    const SECTIONS_AT: u32 = 0x100;

    /// Names of sections and symbols, each at the offset that is used below.
    const NAMES: &[u8; 38] = b"\0.text\0.data\0.bss\0hot\0BUFFER\0.symtab\0\0";

    fn words(file: &mut Vec<u8>, words: &[u32]) {
        file.extend(words.iter().flat_map(|word| word.to_le_bytes()));
    }

    /// An ELF for Arm by hand: 8 bytes of code at 0x100, 4 of data in RAM that are kept at 0x108, 16 zeroed.
    fn file() -> Vec<u8> {
        let mut file = b"\x7fELF\x01\x01\x01\0\0\0\0\0\0\0\0\0".to_vec();
        // executable for Arm (40), version 1, entry, program headers, section headers, flags
        words(&mut file, &[0x0028_0002, 1, 0x101, 52, SECTIONS_AT, 0x0500_0000]);
        // sizes and counts, two in a word: header 52, program headers 2 of 32, section headers 6 of 40, names in the fifth
        words(&mut file, &[0x0020_0034, 0x0028_0002, 0x0005_0006]);
        // to load: type, offset, virtual, physical, in the file, in memory, flags, alignment
        words(&mut file, &[1, TEXT_AT, 0x100, 0x100, 8, 8, 5, 4]);
        words(&mut file, &[1, TEXT_AT + 8, 0x2000_0000, 0x108, 4, 20, 6, 4]);
        file.resize(TEXT_AT as usize, 0);
        file.extend(*b"codecode\x01\x02\x03\x04");
        file.resize(NAMES_AT as usize, 0);
        file.extend(NAMES);
        file.resize(SYMBOLS_AT as usize, 0);
        // symbols: name, value, size, kind with its section; the function's value says Thumb
        words(&mut file, &[0; 4]);
        words(&mut file, &[18, 0x2000_0001, 4, 0x0002_0012]);
        words(&mut file, &[22, 0x2000_0004, 16, 0x0003_0011]);
        file.resize(SECTIONS_AT as usize, 0);
        // sections: name, type, flags, address, offset, size, link, info, alignment, entry
        words(&mut file, &[0; 10]);
        words(&mut file, &[1, 1, 6, 0x100, TEXT_AT, 8, 0, 0, 4, 0]);
        words(&mut file, &[7, 1, 3, 0x2000_0000, TEXT_AT + 8, 4, 0, 0, 4, 0]);
        words(&mut file, &[13, 8, 3, 0x2000_0004, TEXT_AT + 12, 16, 0, 0, 4, 0]);
        words(&mut file, &[29, 2, 0, 0, SYMBOLS_AT, 48, 5, 1, 4, 16]);
        words(&mut file, &[0, 3, 0, 0, NAMES_AT, 38, 0, 0, 1, 0]);
        file
    }

    #[test]
    fn sections_are_read_with_the_place_where_they_are_kept() {
        let layout = Layout::parse(&file()).unwrap();
        let found: Vec<_> = layout.sections.iter().map(|s| (&s.name[..], s.address, s.bytes, s.kept_at)).collect();
        assert_eq!(
            found,
            [(".text", 0x100, 8, Some(0x100)), (".data", 0x2000_0000, 4, Some(0x108)), (".bss", 0x2000_0004, 16, None)]
        );
        let flags: Vec<_> = layout.sections.iter().map(|section| (section.is_code, section.is_writable)).collect();
        assert_eq!(flags, [(true, false), (false, true), (false, true)]);
        assert!(layout.sections[0].contains(0x107) && !layout.sections[0].contains(0x108));
    }

    #[test]
    fn symbols_are_read_without_the_bit_that_says_thumb() {
        let function = Symbol { name: "hot".to_owned(), address: 0x2000_0000, bytes: 4, is_function: true };
        let buffer = Symbol { name: "BUFFER".to_owned(), address: 0x2000_0004, bytes: 16, is_function: false };
        assert_eq!(Layout::parse(&file()).unwrap().symbols, [function, buffer]);
    }

    #[test]
    fn what_is_loaded_stands_at_the_address_where_it_is_kept() {
        let segments = Layout::parse(&file()).unwrap().segments;
        let code = Segment { address: 0x100, data: b"codecode".to_vec() };
        assert_eq!(segments, [code, Segment { address: 0x108, data: vec![1, 2, 3, 4] }]);
    }

    #[test]
    fn an_elf_that_tells_nothing_is_refused_with_what_to_do() {
        let said = |file: &[u8]| Layout::parse(file).unwrap_err().to_string();
        assert!(said(b"#!/bin/sh").starts_with("not the ELF of an image"), "{}", said(b"#!/bin/sh"));
        // the program headers are of no type that is loaded
        let mut nothing = file();
        (nothing[52], nothing[84]) = (0, 0);
        assert!(said(&nothing).contains("nothing to load"), "{}", said(&nothing));
        // the second segment is gone: nobody loads the data
        let mut half = file();
        half[84] = 0;
        assert!(said(&half).starts_with("the section `.data` has 4 bytes that nothing would load"), "{}", said(&half));
        // the first segment claims more bytes than the file has
        let mut cut = file();
        cut[52 + 16 + 2] = 1;
        assert!(said(&cut).starts_with("the file ends within what is loaded at 0x00000100"), "{}", said(&cut));
    }
}

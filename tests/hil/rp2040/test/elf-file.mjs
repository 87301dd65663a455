// Writes a minimal ELF file for the tests: program headers and a symbol table.

const HEADER_BYTES = 52;
const PROGRAM_HEADER_BYTES = 32;
const SECTION_HEADER_BYTES = 40;

/** @param {import('../src/elf.mjs').Image} image @returns {Uint8Array} */
export function elfFile({ segments, symbols }) {
  const names = [...symbols.keys()];
  const strings = Buffer.from(`\0${names.join('\0')}\0`);
  const dataAt = HEADER_BYTES + PROGRAM_HEADER_BYTES * segments.length;
  const dataBytes = segments.reduce((sum, { data }) => sum + data.length, 0);
  const symbolsAt = dataAt + dataBytes;
  const symbolBytes = 16 * (names.length + 1);
  const sectionsAt = symbolsAt + symbolBytes + strings.length;
  const bytes = new Uint8Array(sectionsAt + 3 * SECTION_HEADER_BYTES);
  const view = new DataView(bytes.buffer);
  const words = (/** @type {number} */ at, /** @type {number[]} */ values) =>
    values.forEach((value, i) => view.setUint32(at + 4 * i, value, true));
  bytes.set([0x7f, 0x45, 0x4c, 0x46, 1, 1, 1]);
  view.setUint16(18, 40, true);
  words(28, [HEADER_BYTES, sectionsAt]);
  view.setUint16(42, PROGRAM_HEADER_BYTES, true);
  view.setUint16(44, segments.length, true);
  view.setUint16(46, SECTION_HEADER_BYTES, true);
  view.setUint16(48, 3, true);
  let at = dataAt;
  segments.forEach(({ address, data }, i) => {
    // Type, offset, virtual and physical address, sizes.
    words(HEADER_BYTES + PROGRAM_HEADER_BYTES * i, [1, at, 0x20000000, address, data.length, data.length]);
    bytes.set(data, at);
    at += data.length;
  });
  let nameAt = 1;
  names.forEach((name, i) => {
    const symbol = symbols.get(name) ?? { address: 0, size: 0 };
    words(symbolsAt + 16 * (i + 1), [nameAt, symbol.address, symbol.size]);
    view.setUint16(symbolsAt + 16 * (i + 1) + 14, 1, true);
    nameAt += name.length + 1;
  });
  bytes.set(strings, symbolsAt + symbolBytes);
  // Name, type, flags, address, offset, size, link: the null section, .symtab (2), .strtab (3).
  words(sectionsAt + SECTION_HEADER_BYTES, [0, 2, 0, 0, symbolsAt, symbolBytes, 2]);
  words(sectionsAt + 2 * SECTION_HEADER_BYTES, [0, 3, 0, 0, symbolsAt + symbolBytes, strings.length, 0]);
  return bytes;
}

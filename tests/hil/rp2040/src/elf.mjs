// Reads what a chip needs of an ELF file: the loadable segments by physical (load) address, and the symbols.
import { readFileSync } from 'node:fs';

/** @typedef {{ address: number, data: Uint8Array }} Segment */
/** @typedef {{ address: number, size: number }} Symbol */
/** @typedef {{ segments: Segment[], symbols: Map<string, Symbol> }} Image */

const ELF_MAGIC = 0x7f454c46;
const CLASS_32 = 1;
const LITTLE_ENDIAN = 1;
const MACHINE_ARM = 40;
const PT_LOAD = 1;
const SHT_SYMTAB = 2;

/**
 * Segments lie where `p_paddr` says, as in a flash programmer: code linked to run from RAM is in flash until its
 * start-up code has copied it.
 * @param {string} path
 * @returns {Image}
 */
export function readElf(path) {
  const bytes = readFileSync(path);
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
  if (bytes.length < 52 || view.getUint32(0) !== ELF_MAGIC) throw new Error(`${path}: not an ELF file`);
  if (bytes[4] !== CLASS_32 || bytes[5] !== LITTLE_ENDIAN || view.getUint16(18, true) !== MACHINE_ARM) {
    throw new Error(`${path}: not a 32-bit little-endian Arm image; build it for thumbv6m-none-eabi`);
  }
  return { segments: readSegments(bytes, view), symbols: readSymbols(bytes, view) };
}

/** @param {Uint8Array} bytes @param {DataView} view @returns {Segment[]} */
function readSegments(bytes, view) {
  const start = view.getUint32(28, true);
  const entrySize = view.getUint16(42, true);
  const count = view.getUint16(44, true);
  const segments = [];
  for (let i = 0; i < count; i++) {
    const at = start + i * entrySize;
    const offset = view.getUint32(at + 4, true);
    const address = view.getUint32(at + 12, true);
    const fileSize = view.getUint32(at + 16, true);
    if (view.getUint32(at, true) !== PT_LOAD || fileSize === 0) continue;
    segments.push({ address, data: bytes.subarray(offset, offset + fileSize) });
  }
  return segments;
}

/** @param {Uint8Array} bytes @param {DataView} view @returns {Map<string, Symbol>} */
function readSymbols(bytes, view) {
  const start = view.getUint32(32, true);
  const entrySize = view.getUint16(46, true);
  const count = view.getUint16(48, true);
  /** @type {Map<string, Symbol>} */
  const symbols = new Map();
  for (let i = 0; i < count; i++) {
    const at = start + i * entrySize;
    if (view.getUint32(at + 4, true) !== SHT_SYMTAB) continue;
    const tableAt = view.getUint32(at + 16, true);
    const tableSize = view.getUint32(at + 20, true);
    const stringsAt = view.getUint32(start + view.getUint32(at + 24, true) * entrySize + 16, true);
    for (let entry = tableAt; entry < tableAt + tableSize; entry += 16) {
      const name = cString(bytes, stringsAt + view.getUint32(entry, true));
      const sectionIndex = view.getUint16(entry + 14, true);
      if (name === '' || sectionIndex === 0) continue;
      symbols.set(name, { address: view.getUint32(entry + 4, true), size: view.getUint32(entry + 8, true) });
    }
  }
  return symbols;
}

/** @param {Uint8Array} bytes @param {number} at */
function cString(bytes, at) {
  let end = at;
  while (end < bytes.length && bytes[end] !== 0) end++;
  return Buffer.from(bytes.subarray(at, end)).toString('utf8');
}

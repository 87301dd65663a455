// The flash chip of a Pico: Winbond W25Q16JV, 2 MiB. Its array with the rules of NOR flash, its typical times, and its
// serial commands as far as firmware sends them through the SSI. W25Q16JV datasheet, commands and AC characteristics.
import { existsSync, readFileSync, writeFileSync } from 'node:fs';

export const FLASH_BYTES = 2 * 1024 * 1024;
export const SECTOR_BYTES = 4096;
export const PAGE_BYTES = 256;

/** Typical times (AC characteristics): tSE, tBE1 (32 KiB), tBE2 (64 KiB), tPP. */
const SECTOR_ERASE_NS = 45e6;
const BLOCK_32K_ERASE_NS = 120e6;
const BLOCK_64K_ERASE_NS = 150e6;
const PAGE_PROGRAM_NS = 0.4e6;

const BLOCK_ERASE_32K = 0x52;
const BLOCK_ERASE_64K = 0xd8;

/** Manufacturer Winbond, type, capacity 2^21 bytes. */
const JEDEC_ID = [0xef, 0x70, 0x15];
const STATUS_2_QUAD_ENABLED = 0x02;

/**
 * One step of an erase or a program operation: how long the chip is busy, and what has changed after it.
 * @typedef {{ busyNs: number, apply: () => void }} FlashStep
 */

export class Flash {
  /**
   * @param {string | null} path file that keeps the content; null keeps nothing
   * @param {string} uniqueId 16 hexadecimal digits
   */
  constructor(path, uniqueId) {
    if (!/^[0-9a-f]{16}$/i.test(uniqueId)) throw new Error(`unique_id "${uniqueId}": give 16 hexadecimal digits`);
    this.path = path;
    this.uniqueId = Uint8Array.from(Buffer.from(uniqueId, 'hex'));
    this.array = new Uint8Array(FLASH_BYTES).fill(0xff);
    this.erases = 0;
    this.programmedPages = 0;
    if (path && existsSync(path)) {
      const kept = readFileSync(path);
      if (kept.length !== FLASH_BYTES)
        throw new Error(`${path}: ${kept.length} bytes; a flash file has ${FLASH_BYTES}`);
      this.array.set(kept);
    }
  }

  save() {
    if (this.path) writeFileSync(this.path, this.array);
  }

  /**
   * The boot ROM's flash_range_erase (RP2040 datasheet 2.8.3): blocks where they fit, else sectors.
   * @param {number} address within the flash @param {number} count bytes @param {number} blockBytes
   * @param {number} blockCommand
   * @returns {FlashStep[]}
   */
  eraseSteps(address, count, blockBytes, blockCommand) {
    if (address % SECTOR_BYTES || count % SECTOR_BYTES || address + count > FLASH_BYTES) {
      throw new Error(`flash_range_erase(0x${address.toString(16)}, ${count}): not whole sectors of the flash`);
    }
    const blockNs = { [BLOCK_ERASE_32K]: BLOCK_32K_ERASE_NS, [BLOCK_ERASE_64K]: BLOCK_64K_ERASE_NS }[blockCommand];
    const steps = [];
    for (let at = address; at < address + count;) {
      const isBlock = blockNs !== undefined && at % blockBytes === 0 && address + count - at >= blockBytes;
      const from = at;
      const length = isBlock ? blockBytes : SECTOR_BYTES;
      const apply = () => {
        this.erases++;
        this.array.fill(0xff, from, from + length);
      };
      steps.push({ busyNs: isBlock ? blockNs : SECTOR_ERASE_NS, apply });
      at += length;
    }
    return steps;
  }

  /**
   * The boot ROM's flash_range_program: whole pages; programming clears bits and never sets one.
   * @param {number} address @param {Uint8Array} data
   * @returns {FlashStep[]}
   */
  programSteps(address, data) {
    if (address % PAGE_BYTES || data.length % PAGE_BYTES || address + data.length > FLASH_BYTES) {
      throw new Error(`flash_range_program(0x${address.toString(16)}, ${data.length}): not whole pages of the flash`);
    }
    const steps = [];
    for (let at = 0; at < data.length; at += PAGE_BYTES) {
      const page = data.slice(at, at + PAGE_BYTES);
      const apply = () => {
        this.programmedPages++;
        page.forEach((byte, i) => (this.array[address + at + i] &= byte));
      };
      steps.push({ busyNs: PAGE_PROGRAM_NS, apply });
    }
    return steps;
  }

  /**
   * The chip's answer to a serial command: what it shifts out while byte `index` of the transfer is clocked.
   * @param {number} command its first byte @param {number} index of the byte, 0 for the command's own
   */
  respond(command, index) {
    if (index === 0) return 0;
    switch (command) {
      case 0x05: // Read Status Register-1: never busy, the ROM's functions wait themselves
        return 0;
      case 0x35: // Read Status Register-2
        return STATUS_2_QUAD_ENABLED;
      case 0x4b: // Read Unique ID: four dummy bytes, then 64 bits
        return index <= 4 ? 0 : this.uniqueId[(index - 5) % 8];
      case 0x9f: // Read JEDEC ID
        return JEDEC_ID[(index - 1) % 3];
      default:
        return 0;
    }
  }
}

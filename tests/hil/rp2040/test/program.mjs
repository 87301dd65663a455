// Tiny Thumb programs for the tests: halfwords with labels and literals, placed behind a vector table in flash.
import { Chip } from '../src/chip.mjs';

export const FLASH = 0x10000100;
export const RAM = 0x20000000;
export const STACK_TOP = 0x20042000;

export const WFI = 0xbf30;
export const NOP = 0xbf00;
export const CPSID = 0xb672;
export const CPSIE = 0xb662;
export const BX_LR = 0x4770;
const CONDITIONS = ['eq', 'ne', 'cs', 'cc', 'mi', 'pl', 'vs', 'vc', 'hi', 'ls', 'ge', 'lt', 'gt', 'le'];

/** Encodings: ARMv6-M ARM A6.7. Offsets in bytes. */
export const movs = (/** @type {number} */ rd, /** @type {number} */ imm) => 0x2000 | (rd << 8) | imm;
export const adds = (/** @type {number} */ rd, /** @type {number} */ imm) => 0x3000 | (rd << 8) | imm;
export const subs = (/** @type {number} */ rd, /** @type {number} */ imm) => 0x3800 | (rd << 8) | imm;
export const cmp = (/** @type {number} */ rn, /** @type {number} */ imm) => 0x2800 | (rn << 8) | imm;
export const ldr = (/** @type {number} */ rt, /** @type {number} */ rn, offset = 0) =>
  0x6800 | ((offset >> 2) << 6) | (rn << 3) | rt;
export const str = (/** @type {number} */ rt, /** @type {number} */ rn, offset = 0) =>
  0x6000 | ((offset >> 2) << 6) | (rn << 3) | rt;
export const ldrb = (/** @type {number} */ rt, /** @type {number} */ rn, offset = 0) =>
  0x7800 | (offset << 6) | (rn << 3) | rt;
export const push = (/** @type {number} */ list) => 0xb400 | list;
export const pop = (/** @type {number} */ list) => 0xbc00 | list;
/** In a list: LR of PUSH, PC of POP. */
export const LINK = 0x100;

const VECTOR_BYTES = 48 * 4;

export class Program {
  /** @param {number} base where the code lies */
  constructor(base = FLASH + VECTOR_BYTES) {
    this.base = base;
    /** @type {(number | { at: number, label?: string, condition?: number, rd?: number, value?: number | string })[]} */
    this.code = [];
    /** @type {Map<string, number>} */
    this.labels = new Map();
    /** @type {Map<number, string>} */
    this.vectors = new Map();
  }

  /** @param {number[]} halfwords */
  op(...halfwords) {
    this.code.push(...halfwords);
    return this;
  }

  /** @param {string} name */
  label(name) {
    this.labels.set(name, this.code.length);
    return this;
  }

  /** A handler begins here. @param {number} exception */
  handler(exception) {
    const name = `exception ${exception}`;
    this.vectors.set(exception, name);
    return this.label(name);
  }

  /** B, or with a condition B<c>. @param {string} label @param {string} [condition] */
  branch(label, condition) {
    const number = condition === undefined ? undefined : CONDITIONS.indexOf(condition);
    this.code.push({ at: this.code.length, label, condition: number });
    return this;
  }

  /** LDR rd, =value; of a label its address with the Thumb bit. @param {number} rd @param {number | string} value */
  load(rd, value) {
    this.code.push({ at: this.code.length, rd, value });
    return this;
  }

  /** Stores a constant: uses r0 and r1. @param {number} address @param {number} value */
  poke(address, value) {
    return this.load(0, address).load(1, value).op(str(1, 0));
  }

  /** Stores a register: uses r0. @param {number} address @param {number} register */
  keep(address, register) {
    return this.load(0, address).op(str(register, 0));
  }

  /** Address of a label. @param {string} name */
  address(name) {
    return this.base + 2 * /** @type {number} */ (this.labels.get(name));
  }

  /** @returns {import('../src/elf.mjs').Image} */
  image() {
    const literals = this.code.flatMap((item) => (typeof item === 'object' && item.value !== undefined ? [item] : []));
    const literalsAt = (this.code.length * 2 + 3) & ~3;
    const data = new Uint8Array(literalsAt + 4 * literals.length);
    const view = new DataView(data.buffer);
    this.code.forEach((item, i) => {
      const literal = literalsAt + 4 * literals.indexOf(/** @type {any} */ (item));
      view.setUint16(2 * i, typeof item === 'number' ? item : this.#resolve(item, 2 * i, literal), true);
    });
    literals.forEach(({ value }, i) => {
      view.setUint32(literalsAt + 4 * i, typeof value === 'string' ? this.address(value) | 1 : Number(value), true);
    });
    const vectors = new DataView(new ArrayBuffer(VECTOR_BYTES));
    vectors.setUint32(0, STACK_TOP, true);
    vectors.setUint32(4, this.base | 1, true);
    for (const [exception, name] of this.vectors) vectors.setUint32(4 * exception, this.address(name) | 1, true);
    const segments = [
      { address: FLASH, data: new Uint8Array(vectors.buffer) },
      { address: this.base, data },
    ];
    return { segments, symbols: new Map() };
  }

  /** @param {{ label?: string, condition?: number, rd?: number }} item @param {number} at @param {number} literal */
  #resolve(item, at, literal) {
    if (item.label === undefined) {
      return 0x4800 | (Number(item.rd) << 8) | ((literal - ((at + 4) & ~3)) >> 2);
    }
    const offset = (this.address(item.label) - this.base - at - 4) >> 1;
    return item.condition === undefined ? 0xe000 | (offset & 0x7ff) : 0xd000 | (item.condition << 8) | (offset & 0xff);
  }

  /** A chip that runs this program with its system and peripheral clock at 125 MHz. @param {object} [options] */
  chip(options = {}) {
    /** @type {import('../src/chip.mjs').ChipEvent[]} */
    const events = [];
    const chip = new Chip({ name: 'chip', image: this.image(), onEvent: (event) => events.push(event), ...options });
    setClock(chip);
    return { chip, events, word: (/** @type {number} */ address) => chip.rp.sramView.getUint32(address - RAM, true) };
  }
}

/** The clock tree at 125 MHz without the firmware that sets it up. @param {Chip} chip */
export function setClock(chip) {
  chip.rp.clkSys = chip.rp.clkPeri = 125e6;
  chip.machine.cycleNs = 8;
}

/** A program that sleeps for ever: for tests of peripherals alone. */
export function idle() {
  return new Program().label('sleep').op(WFI).branch('sleep');
}

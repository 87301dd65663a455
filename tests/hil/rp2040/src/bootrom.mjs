// A boot ROM of our own: the package has none, and the real one is not ours to ship. It holds what firmware looks up
// (RP2040 datasheet 2.8.2, 2.8.3): the magic, the tables, rom_table_lookup in real Thumb code, and functions that are a
// breakpoint each, whose work is done here. Codes it does not know look up as 0, as on the real ROM.
import { CTRLR0_SERIAL, CTRLR0_XIP } from './ssi.mjs';

const ROM_VERSION = 3;
const LOOKUP_AT = 0x40;
const FUNCTIONS_AT = 0x60;
const BX_LR = 0x4770;
const BKPT = 0xbe00;
const BRANCH_SELF = 0xe7fe;
/** Immediate of the breakpoint at which a flash operation waits. */
const WAIT = 0xff;

/** `uint32 rom_table_lookup(uint16 *table, uint32 code)` over pairs of code and address, ended by a code of 0. */
const LOOKUP = [
  0x8802, // loop: ldrh r2, [r0, #0]
  0x2a00, //       cmp  r2, #0
  0xd005, //       beq  none
  0x8843, //       ldrh r3, [r0, #2]
  0x3004, //       adds r0, #4
  0x428a, //       cmp  r2, r1
  0xd1f8, //       bne  loop
  0x0018, //       movs r0, r3
  BX_LR,
  0x2000, // none: movs r0, #0
  BX_LR,
];

/** Codes of datasheet 2.8.3.1, in the order of their breakpoint's number; `waits` marks those that take flash time. */
const FUNCTIONS = [
  { code: 'IF', waits: false },
  { code: 'EX', waits: false },
  { code: 'RE', waits: true },
  { code: 'RP', waits: true },
  { code: 'FC', waits: false },
  { code: 'CX', waits: false },
  { code: 'UB', waits: false },
  { code: 'MC', waits: false },
  { code: 'C4', waits: false },
  { code: 'MS', waits: false },
  { code: 'S4', waits: false },
  { code: 'P3', waits: false },
  { code: 'R3', waits: false },
  { code: 'L3', waits: false },
  { code: 'T3', waits: false },
];

/** The ROM's content: 16 KiB as words. */
export function romImage() {
  const bytes = new Uint8Array(16 * 1024);
  const view = new DataView(bytes.buffer);
  let at = FUNCTIONS_AT;
  const emit = (/** @type {number[]} */ ...halfwords) => {
    for (const halfword of halfwords) {
      view.setUint16(at, halfword, true);
      at += 2;
    }
  };
  const idle = at;
  emit(BRANCH_SELF);
  const entries = FUNCTIONS.map(({ code, waits }, number) => {
    const entry = at;
    emit(BKPT | number, ...(waits ? [BKPT | WAIT] : []), BX_LR);
    return { code, entry };
  });
  at = (at + 3) & ~3;
  const functionTable = at;
  for (const { code, entry } of entries) emit(code.charCodeAt(0) | (code.charCodeAt(1) << 8), entry | 1);
  emit(0);
  const dataTable = at;
  emit(0);
  at = LOOKUP_AT;
  emit(...LOOKUP);
  view.setUint32(0x00, 0x20041f00, true);
  for (const vector of [0x04, 0x08, 0x0c]) view.setUint32(vector, idle | 1, true);
  bytes.set([0x4d, 0x75, 0x01, ROM_VERSION], 0x10);
  view.setUint16(0x14, functionTable, true);
  view.setUint16(0x16, dataTable, true);
  view.setUint16(0x18, LOOKUP_AT | 1, true);
  return new Uint32Array(bytes.buffer);
}

/** What the ROM's functions do on one chip. */
export class BootRom {
  /**
   * @param {import('rp2040js').RP2040} rp
   * @param {import('./core.mjs').Exceptions} exceptions
   * @param {import('./flash.mjs').Flash} flash
   * @param {import('./ssi.mjs').Ssi} ssi
   * @param {() => void} onUsbBoot reset_to_usb_boot was called
   */
  constructor(rp, exceptions, flash, ssi, onUsbBoot) {
    this.rp = rp;
    this.core = rp.core;
    this.exceptions = exceptions;
    this.flash = flash;
    this.ssi = ssi;
    this.onUsbBoot = onUsbBoot;
    this.clock = /** @type {import('./clock.mjs').VirtualClock} */ (rp.clock);
    /** @type {import('./flash.mjs').FlashStep[]} what is still to be done; the first is under way */
    this.steps = [];
    this.untilNs = 0;
    this.wake = this.clock.createAlarm(() => (this.core.waiting = false));
    rp.bootrom.set(romImage());
    rp.onBreak = (immediate) => this.onBreak(immediate);
  }

  /** A BKPT or UDF has been executed; outside the ROM both are a HardFault without a debugger (ARMv6-M ARM, BKPT). */
  onBreak(/** @type {number} */ immediate) {
    const at = (this.core.PC - 2) >>> 0;
    if (at >= 16 * 1024) {
      this.exceptions.raise(`breakpoint or undefined instruction, immediate ${immediate}`, at);
      return;
    }
    try {
      if (immediate === WAIT) this.#wait();
      else this.#call(FUNCTIONS[immediate].code);
    } catch (error) {
      this.exceptions.raise(/** @type {Error} */ (error).message, at);
    }
  }

  /** @param {string} code */
  #call(code) {
    const [r0, r1, r2, r3] = this.core.registers;
    switch (code) {
      case 'EX':
        this.ssi.configure(CTRLR0_SERIAL, true);
        break;
      case 'CX':
        this.ssi.configure(CTRLR0_XIP, true);
        break;
      case 'RE':
        this.#begin(this.flash.eraseSteps(r0, r1, r2, r3));
        break;
      case 'RP':
        this.#begin(this.flash.programSteps(r0, this.#bytes(r1, r2)));
        break;
      case 'UB':
        this.onUsbBoot();
        break;
      case 'MC':
      case 'C4':
        this.#bytes(r1, r2).forEach((byte, i) => this.rp.writeUint8(r0 + i, byte));
        this.exceptions.extraCycles += 20 + r2;
        break;
      case 'MS':
      case 'S4':
        for (let i = 0; i < r2; i++) this.rp.writeUint8(r0 + i, r1 & 0xff);
        this.exceptions.extraCycles += 20 + (r2 >> 1);
        break;
      case 'P3':
        this.core.registers[0] = [...r0.toString(2)].filter((bit) => bit === '1').length;
        break;
      case 'R3':
        this.core.registers[0] = parseInt([...r0.toString(2).padStart(32, '0')].reverse().join(''), 2);
        break;
      case 'L3':
        this.core.registers[0] = Math.clz32(r0);
        break;
      case 'T3':
        this.core.registers[0] = r0 === 0 ? 32 : 31 - Math.clz32(r0 & -r0);
        break;
      default: // IF and FC: pads and cache, which are not modelled
        break;
    }
  }

  /** @param {number} address @param {number} count */
  #bytes(address, count) {
    const bytes = new Uint8Array(count);
    for (let i = 0; i < count; i++) bytes[i] = this.rp.readUint8(address + i);
    return bytes;
  }

  /** @param {import('./flash.mjs').FlashStep[]} steps */
  #begin(steps) {
    if (this.ssi.isXip) throw new Error('flash erase or program while in XIP mode: call flash_exit_xip first');
    if (this.steps.length > 0) throw new Error('flash erase or program within another one');
    this.steps = steps;
    if (steps.length > 0) this.untilNs = this.clock.nanos + steps[0].busyNs;
  }

  /**
   * The ROM polls the flash here. The core sleeps in virtual time, but an interrupt that is not masked is taken; the
   * breakpoint is repeated until the last step is over.
   */
  #wait() {
    while (this.steps.length > 0 && this.clock.nanos >= this.untilNs) {
      const step = this.steps.shift();
      step?.apply();
      if (this.steps.length > 0) this.untilNs += this.steps[0].busyNs;
    }
    this.exceptions.polling = this.steps.length > 0;
    if (this.steps.length === 0) return;
    this.core.PC -= 2;
    this.core.waiting = true;
    this.wake.scheduleAt(this.untilNs);
  }
}

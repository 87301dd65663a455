// Executes Thumb instructions: a table of handlers over the package's core, whose registers and exceptions it shares.
// The package's own interpreter tries some eighty patterns in turn; this one is several times as fast, sets the flags
// as the manual says, and counts cycles by the Cortex-M0+ TRM's instruction table. What is rare (MRS, MSR, barriers,
// SVC, BKPT, UDF, most hints) still goes to the package. Encodings and flags: ARMv6-M ARM A6.7, A2.2.1.
import { RAM_BYTES } from './bus.mjs';

const RAM = 0x20000000;
const SP = 13;
const LR = 14;
const PC = 15;
/** The package's numbers of the core's modes. */
const THREAD_MODE = 0;
const HANDLER_MODE = 1;

/** @typedef {(cpu: Cpu, opcode: number) => number} Handler executes an instruction and returns its cycles */

export class Cpu {
  /**
   * @param {import('rp2040js').RP2040['core']} core
   * @param {import('./core.mjs').Exceptions} exceptions
   * @param {import('./bus.mjs').BusState} bus
   * @param {Uint8Array} sram
   */
  constructor(core, exceptions, bus, sram) {
    this.core = core;
    this.exceptions = exceptions;
    this.bus = bus;
    /** Signed view of the core's registers; the PC is two past the instruction while a handler runs. */
    this.r = new Int32Array(core.registers.buffer);
    this.ram8 = sram;
    this.ram16 = new Uint16Array(sram.buffer);
    this.ram32 = new Int32Array(sram.buffer);
    this.flash16 = new Uint16Array(bus.flash.buffer, bus.flash.byteOffset, bus.flash.length >> 1);
    this.flashMask = bus.flash.length - 1;
    this.n = false;
    this.z = false;
    this.c = false;
    this.v = false;
    for (const [flag, own] of /** @type {const} */ ([
      ['N', 'n'],
      ['Z', 'z'],
      ['C', 'c'],
      ['V', 'v'],
    ])) {
      Object.defineProperty(core, flag, {
        get: () => this[own],
        set: (/** @type {boolean} */ value) => (this[own] = value),
      });
    }
  }

  /**
   * Pushes the frame of exception entry and goes to the handler, on the main stack in RAM; anything else the package
   * does (ARMv6-M ARM, PushStack() and ExceptionTaken()). The vector's Thumb bit is still in the PC afterwards.
   * @param {number} number
   */
  stack(number) {
    const { core, ram32, r } = this;
    const frame = (r[SP] - 0x20) & ~4;
    const at = (frame - RAM) >>> 0;
    if (core.SPSEL !== 0 || at > RAM_BYTES - 0x20) {
      this.exceptions.enter(number);
      return;
    }
    const i = at >> 2;
    ram32[i] = r[0];
    ram32[i + 1] = r[1];
    ram32[i + 2] = r[2];
    ram32[i + 3] = r[3];
    ram32[i + 4] = r[12];
    ram32[i + 5] = r[LR];
    ram32[i + 6] = r[PC] & ~1;
    ram32[i + 7] = this.#flags() | core.IPSR | (1 << 24) | (r[SP] & 4 ? 1 << 9 : 0);
    r[SP] = frame;
    r[LR] = core.currentMode === HANDLER_MODE ? 0xfffffff1 | 0 : 0xfffffff9 | 0;
    core.currentMode = HANDLER_MODE;
    core.IPSR = number;
    core.eventRegistered = true;
    r[PC] = core.readUint32(core.VTOR + 4 * number);
  }

  /** The way back (ARMv6-M ARM, ExceptionReturn() and PopStack()). @param {number} excReturn its low bits */
  unstack(excReturn) {
    const { core, ram32, r } = this;
    const at = (r[SP] - RAM) >>> 0;
    const mode = excReturn & 0xf;
    if (core.SPSEL !== 0 || at > RAM_BYTES - 0x20 || (mode !== 1 && mode !== 9)) {
      this.exceptions.leave(excReturn);
      return;
    }
    const i = at >> 2;
    r[0] = ram32[i];
    r[1] = ram32[i + 1];
    r[2] = ram32[i + 2];
    r[3] = ram32[i + 3];
    r[12] = ram32[i + 4];
    r[LR] = ram32[i + 5];
    r[PC] = ram32[i + 6];
    const status = ram32[i + 7];
    r[SP] = (r[SP] + 0x20) | (status & (1 << 9) ? 4 : 0);
    this.n = status < 0;
    this.z = (status & (1 << 30)) !== 0;
    this.c = (status & (1 << 29)) !== 0;
    this.v = (status & (1 << 28)) !== 0;
    core.IPSR = status & 0x3f;
    core.currentMode = mode === 1 ? HANDLER_MODE : THREAD_MODE;
    core.eventRegistered = true;
    core.interruptsUpdated = true;
  }

  #flags() {
    return (this.n ? 1 << 31 : 0) | (this.z ? 1 << 30 : 0) | (this.c ? 1 << 29 : 0) | (this.v ? 1 << 28 : 0);
  }

  /** Executes the instruction at the PC and returns its cycles. */
  step() {
    const { r } = this;
    const pc = r[PC];
    r[PC] = pc + 2;
    const offset = (pc - RAM) >>> 0;
    let opcode;
    if (offset < RAM_BYTES) opcode = this.ram16[offset >> 1];
    else if (pc >>> 26 === 4 && this.bus.xip) opcode = this.flash16[(pc & this.flashMask) >> 1];
    else opcode = this.#fetch(pc);
    return HANDLERS[opcode >> 6](this, opcode);
  }

  /** From the ROM, or from where nothing is: the bus tells a fetch by the PC. @param {number} pc */
  #fetch(pc) {
    this.r[PC] = pc;
    const opcode = this.core.readUint16(pc);
    this.r[PC] = pc + 2;
    return opcode;
  }
}

/** Cycles of a data access beyond the first: none to SIO, three or four over the APB bridge (RP2040 datasheet 2.1). */
const wait = (/** @type {number} */ address, /** @type {boolean} */ isWrite) => {
  const region = address >>> 28;
  if (region === 4) return isWrite ? 4 : 3;
  return region === 13 ? 0 : 1;
};

const load32 = (/** @type {Cpu} */ cpu, /** @type {number} */ address) => {
  const offset = (address - RAM) >>> 0;
  if (offset < RAM_BYTES && !(offset & 3)) return cpu.ram32[offset >> 2];
  return cpu.core.readUint32(address >>> 0) | 0;
};

const load16 = (/** @type {Cpu} */ cpu, /** @type {number} */ address) => {
  const offset = (address - RAM) >>> 0;
  if (offset < RAM_BYTES && !(offset & 1)) return cpu.ram16[offset >> 1];
  return cpu.core.readUint16(address >>> 0);
};

const load8 = (/** @type {Cpu} */ cpu, /** @type {number} */ address) => {
  const offset = (address - RAM) >>> 0;
  return offset < RAM_BYTES ? cpu.ram8[offset] : cpu.core.readUint8(address >>> 0);
};

const store32 = (/** @type {Cpu} */ cpu, /** @type {number} */ address, /** @type {number} */ value) => {
  const offset = (address - RAM) >>> 0;
  if (offset < RAM_BYTES && !(offset & 3)) cpu.ram32[offset >> 2] = value;
  else cpu.core.writeUint32(address >>> 0, value >>> 0);
};

const store16 = (/** @type {Cpu} */ cpu, /** @type {number} */ address, /** @type {number} */ value) => {
  const offset = (address - RAM) >>> 0;
  if (offset < RAM_BYTES && !(offset & 1)) cpu.ram16[offset >> 1] = value;
  else cpu.core.writeUint16(address >>> 0, value & 0xffff);
};

const store8 = (/** @type {Cpu} */ cpu, /** @type {number} */ address, /** @type {number} */ value) => {
  const offset = (address - RAM) >>> 0;
  if (offset < RAM_BYTES) cpu.ram8[offset] = value;
  else cpu.core.writeUint8(address >>> 0, value & 0xff);
};

/** N and Z of a result, which it returns. @param {Cpu} cpu @param {number} result signed */
const flagged = (cpu, result) => {
  cpu.n = result < 0;
  cpu.z = result === 0;
  return result;
};

/** AddWithCarry(x, y, carry) and all four flags; subtraction passes NOT(y). @returns {number} */
const sum = (/** @type {Cpu} */ cpu, /** @type {number} */ x, /** @type {number} */ y, /** @type {number} */ carry) => {
  const result = (x + y + carry) | 0;
  cpu.n = result < 0;
  cpu.z = result === 0;
  cpu.c = (x >>> 0) + (y >>> 0) + carry > 0xffffffff;
  cpu.v = ((x ^ result) & (y ^ result)) < 0;
  return result;
};

/** Immediate shifts; a right shift of 0 means 32. @type {Handler[]} */
const SHIFTS_IMMEDIATE = [
  (cpu, op) => {
    const value = cpu.r[(op >> 3) & 7];
    const count = (op >> 6) & 31;
    if (count) cpu.c = ((value >>> (32 - count)) & 1) !== 0;
    cpu.r[op & 7] = flagged(cpu, value << count);
    return 1;
  },
  (cpu, op) => {
    const value = cpu.r[(op >> 3) & 7];
    const count = (op >> 6) & 31 || 32;
    cpu.c = ((value >>> (count - 1)) & 1) !== 0;
    cpu.r[op & 7] = flagged(cpu, count === 32 ? 0 : (value >>> count) | 0);
    return 1;
  },
  (cpu, op) => {
    const value = cpu.r[(op >> 3) & 7];
    const count = (op >> 6) & 31 || 32;
    cpu.c = ((value >> (count - 1)) & 1) !== 0;
    cpu.r[op & 7] = flagged(cpu, value >> Math.min(31, count));
    return 1;
  },
];

/** ADD and SUB of registers and of three bits. @type {Handler[]} */
const ADD_SUBTRACT = [
  (cpu, op) => ((cpu.r[op & 7] = sum(cpu, cpu.r[(op >> 3) & 7], cpu.r[(op >> 6) & 7], 0)), 1),
  (cpu, op) => ((cpu.r[op & 7] = sum(cpu, cpu.r[(op >> 3) & 7], ~cpu.r[(op >> 6) & 7], 1)), 1),
  (cpu, op) => ((cpu.r[op & 7] = sum(cpu, cpu.r[(op >> 3) & 7], (op >> 6) & 7, 0)), 1),
  (cpu, op) => ((cpu.r[op & 7] = sum(cpu, cpu.r[(op >> 3) & 7], ~((op >> 6) & 7), 1)), 1),
];

/** MOV, CMP, ADD and SUB of eight bits. @type {Handler[]} */
const IMMEDIATE = [
  (cpu, op) => ((cpu.r[(op >> 8) & 7] = flagged(cpu, op & 0xff)), 1),
  (cpu, op) => (sum(cpu, cpu.r[(op >> 8) & 7], ~(op & 0xff), 1), 1),
  (cpu, op) => ((cpu.r[(op >> 8) & 7] = sum(cpu, cpu.r[(op >> 8) & 7], op & 0xff, 0)), 1),
  (cpu, op) => ((cpu.r[(op >> 8) & 7] = sum(cpu, cpu.r[(op >> 8) & 7], ~(op & 0xff), 1)), 1),
];

/** The carry and result of a shift by a register's low byte (A2.2.1 Shift_C): a count of 0 leaves the carry alone. */
const shiftLeft = (/** @type {Cpu} */ cpu, /** @type {number} */ value, /** @type {number} */ count) => {
  if (count === 0) return value;
  cpu.c = count <= 32 && ((value >>> (32 - count)) & 1) !== 0;
  return count < 32 ? value << count : 0;
};
const shiftRight = (/** @type {Cpu} */ cpu, /** @type {number} */ value, /** @type {number} */ count) => {
  if (count === 0) return value;
  cpu.c = count <= 32 && ((value >>> (count - 1)) & 1) !== 0;
  return count < 32 ? (value >>> count) | 0 : 0;
};
const shiftSigned = (/** @type {Cpu} */ cpu, /** @type {number} */ value, /** @type {number} */ count) => {
  if (count === 0) return value;
  cpu.c = ((value >> Math.min(31, count - 1)) & 1) !== 0;
  return value >> Math.min(31, count);
};
const rotate = (/** @type {Cpu} */ cpu, /** @type {number} */ value, /** @type {number} */ count) => {
  if (count === 0) return value;
  const result = (value >>> (count & 31)) | (value << (32 - (count & 31)));
  cpu.c = result < 0;
  return result;
};

/** Data processing of two registers, by bits 9 to 6. @type {Handler[]} */
const DATA_PROCESSING = [
  ({ r }, op) => r[op & 7] & r[(op >> 3) & 7],
  ({ r }, op) => r[op & 7] ^ r[(op >> 3) & 7],
  (cpu, op) => shiftLeft(cpu, cpu.r[op & 7], cpu.r[(op >> 3) & 7] & 0xff),
  (cpu, op) => shiftRight(cpu, cpu.r[op & 7], cpu.r[(op >> 3) & 7] & 0xff),
  (cpu, op) => shiftSigned(cpu, cpu.r[op & 7], cpu.r[(op >> 3) & 7] & 0xff),
  (cpu, op) => sum(cpu, cpu.r[op & 7], cpu.r[(op >> 3) & 7], cpu.c ? 1 : 0),
  (cpu, op) => sum(cpu, cpu.r[op & 7], ~cpu.r[(op >> 3) & 7], cpu.c ? 1 : 0),
  (cpu, op) => rotate(cpu, cpu.r[op & 7], cpu.r[(op >> 3) & 7] & 0xff),
  ({ r }, op) => r[op & 7] & r[(op >> 3) & 7],
  (cpu, op) => sum(cpu, ~cpu.r[(op >> 3) & 7], 0, 1),
  (cpu, op) => sum(cpu, cpu.r[op & 7], ~cpu.r[(op >> 3) & 7], 1),
  (cpu, op) => sum(cpu, cpu.r[op & 7], cpu.r[(op >> 3) & 7], 0),
  ({ r }, op) => r[op & 7] | r[(op >> 3) & 7],
  ({ r }, op) => Math.imul(r[op & 7], r[(op >> 3) & 7]),
  ({ r }, op) => r[op & 7] & ~r[(op >> 3) & 7],
  ({ r }, op) => ~r[(op >> 3) & 7],
];
/** TST, CMP and CMN keep their result to themselves. */
const COMPARES = new Set([8, 10, 11]);

/** Registers of the high half take part; the PC reads four past the instruction. */
const high = (/** @type {Cpu} */ cpu, /** @type {number} */ n) => (n === PC ? cpu.r[PC] + 2 : cpu.r[n]);
const setHigh = (/** @type {Cpu} */ cpu, /** @type {number} */ n, /** @type {number} */ value) => {
  cpu.r[n] = n === PC ? value & ~1 : n === SP ? value & ~3 : value;
  return n === PC ? 2 : 1;
};
const highTarget = (/** @type {number} */ op) => ((op >> 4) & 8) | (op & 7);

/** ADD, CMP and MOV of all registers, BX and BLX. @type {Handler[]} */
const HIGH_REGISTERS = [
  (cpu, op) => setHigh(cpu, highTarget(op), high(cpu, highTarget(op)) + high(cpu, (op >> 3) & 15)),
  (cpu, op) => (sum(cpu, high(cpu, highTarget(op)), ~high(cpu, (op >> 3) & 15), 1), 1),
  (cpu, op) => setHigh(cpu, highTarget(op), high(cpu, (op >> 3) & 15)),
  (cpu, op) => {
    const target = cpu.r[(op >> 3) & 15];
    if (op & 0x80) {
      cpu.r[LR] = cpu.r[PC] | 1;
      cpu.exceptions.branchLink(target);
    } else {
      cpu.exceptions.branchExchange(target);
    }
    return 2;
  },
];

/** Stores and loads by the sum of two registers, in the order of bits 11 to 9. @type {Handler[]} */
const BY_REGISTER = [
  (cpu, op, address = indexed(cpu, op)) => (store32(cpu, address, cpu.r[op & 7]), 1 + wait(address, true)),
  (cpu, op, address = indexed(cpu, op)) => (store16(cpu, address, cpu.r[op & 7]), 1 + wait(address, true)),
  (cpu, op, address = indexed(cpu, op)) => (store8(cpu, address, cpu.r[op & 7]), 1 + wait(address, true)),
  (cpu, op, address = indexed(cpu, op)) => (
    (cpu.r[op & 7] = (load8(cpu, address) << 24) >> 24),
    1 + wait(address, false)
  ),
  (cpu, op, address = indexed(cpu, op)) => ((cpu.r[op & 7] = load32(cpu, address)), 1 + wait(address, false)),
  (cpu, op, address = indexed(cpu, op)) => ((cpu.r[op & 7] = load16(cpu, address)), 1 + wait(address, false)),
  (cpu, op, address = indexed(cpu, op)) => ((cpu.r[op & 7] = load8(cpu, address)), 1 + wait(address, false)),
  (cpu, op, address = indexed(cpu, op)) => (
    (cpu.r[op & 7] = (load16(cpu, address) << 16) >> 16),
    1 + wait(address, false)
  ),
];
function indexed(/** @type {Cpu} */ cpu, /** @type {number} */ op) {
  return (cpu.r[(op >> 3) & 7] + cpu.r[(op >> 6) & 7]) | 0;
}

/** Stores and loads by a register and an immediate, from 0x6000 by bits 15 to 11. @type {Handler[]} */
const BY_IMMEDIATE = [
  (cpu, op, address = offset(cpu, op, 2)) => (store32(cpu, address, cpu.r[op & 7]), 1 + wait(address, true)),
  (cpu, op, address = offset(cpu, op, 2)) => ((cpu.r[op & 7] = load32(cpu, address)), 1 + wait(address, false)),
  (cpu, op, address = offset(cpu, op, 0)) => (store8(cpu, address, cpu.r[op & 7]), 1 + wait(address, true)),
  (cpu, op, address = offset(cpu, op, 0)) => ((cpu.r[op & 7] = load8(cpu, address)), 1 + wait(address, false)),
  (cpu, op, address = offset(cpu, op, 1)) => (store16(cpu, address, cpu.r[op & 7]), 1 + wait(address, true)),
  (cpu, op, address = offset(cpu, op, 1)) => ((cpu.r[op & 7] = load16(cpu, address)), 1 + wait(address, false)),
  (cpu, op, address = (cpu.r[SP] + ((op & 0xff) << 2)) | 0) => (
    store32(cpu, address, cpu.r[(op >> 8) & 7]),
    1 + wait(address, true)
  ),
  (cpu, op, address = (cpu.r[SP] + ((op & 0xff) << 2)) | 0) => (
    (cpu.r[(op >> 8) & 7] = load32(cpu, address)),
    1 + wait(address, false)
  ),
  // ADR, and ADD of the SP.
  (cpu, op) => ((cpu.r[(op >> 8) & 7] = ((cpu.r[PC] + 2) & ~3) + ((op & 0xff) << 2)), 1),
  (cpu, op) => ((cpu.r[(op >> 8) & 7] = cpu.r[SP] + ((op & 0xff) << 2)), 1),
];
function offset(/** @type {Cpu} */ cpu, /** @type {number} */ op, /** @type {number} */ log2) {
  return (cpu.r[(op >> 3) & 7] + (((op >> 6) & 31) << log2)) | 0;
}

/** @type {Handler} */
const loadLiteral = (cpu, op) => {
  const address = ((cpu.r[PC] + 2) & ~3) + ((op & 0xff) << 2);
  cpu.r[(op >> 8) & 7] = load32(cpu, address);
  return 2;
};

/** PUSH, 1 + N. @type {Handler} */
const push = (cpu, op) => {
  const { r } = cpu;
  let count = 0;
  for (let list = op & 0x1ff; list; list &= list - 1) count++;
  let address = (r[SP] - 4 * count) | 0;
  r[SP] = address;
  for (let i = 0; i < 8; i++) {
    if (!((op >> i) & 1)) continue;
    store32(cpu, address, r[i]);
    address += 4;
  }
  if (op & 0x100) store32(cpu, address, r[LR]);
  return 1 + count;
};

/** POP, 1 + N; with the PC 3 + N. @type {Handler} */
const pop = (cpu, op) => {
  const { r } = cpu;
  let address = r[SP];
  let count = 0;
  for (let i = 0; i < 8; i++) {
    if (!((op >> i) & 1)) continue;
    r[i] = load32(cpu, address);
    address += 4;
    count++;
  }
  if (!(op & 0x100)) {
    r[SP] = address;
    return 1 + count;
  }
  const target = load32(cpu, address);
  r[SP] = address + 4;
  cpu.exceptions.branchExchange(target);
  return 4 + count;
};

/** STM with write-back, 1 + N. @type {Handler} */
const storeMultiple = (cpu, op) => {
  const base = (op >> 8) & 7;
  let address = cpu.r[base];
  let count = 0;
  for (let i = 0; i < 8; i++) {
    if (!((op >> i) & 1)) continue;
    store32(cpu, address, cpu.r[i]);
    address += 4;
    count++;
  }
  cpu.r[base] = address;
  return 1 + count;
};

/** LDM; writes back unless the base is loaded. @type {Handler} */
const loadMultiple = (cpu, op) => {
  const base = (op >> 8) & 7;
  let address = cpu.r[base];
  let count = 0;
  for (let i = 0; i < 8; i++) {
    if (!((op >> i) & 1)) continue;
    cpu.r[i] = load32(cpu, address);
    address += 4;
    count++;
  }
  if (!((op >> base) & 1)) cpu.r[base] = address;
  return 1 + count;
};

/** SXTH, SXTB, UXTH, UXTB. @type {Handler[]} */
const EXTEND = [
  ({ r }, op) => ((r[op & 7] = (r[(op >> 3) & 7] << 16) >> 16), 1),
  ({ r }, op) => ((r[op & 7] = (r[(op >> 3) & 7] << 24) >> 24), 1),
  ({ r }, op) => ((r[op & 7] = r[(op >> 3) & 7] & 0xffff), 1),
  ({ r }, op) => ((r[op & 7] = r[(op >> 3) & 7] & 0xff), 1),
];

const swapHalves = (/** @type {number} */ v) => ((v & 0x00ff00ff) << 8) | ((v >>> 8) & 0x00ff00ff);

/** Conditions of A6.3, by number. @type {((cpu: Cpu) => boolean)[]} */
const CONDITIONS = [
  (cpu) => cpu.z,
  (cpu) => !cpu.z,
  (cpu) => cpu.c,
  (cpu) => !cpu.c,
  (cpu) => cpu.n,
  (cpu) => !cpu.n,
  (cpu) => cpu.v,
  (cpu) => !cpu.v,
  (cpu) => cpu.c && !cpu.z,
  (cpu) => !cpu.c || cpu.z,
  (cpu) => cpu.n === cpu.v,
  (cpu) => cpu.n !== cpu.v,
  (cpu) => !cpu.z && cpu.n === cpu.v,
  (cpu) => cpu.z || cpu.n !== cpu.v,
];

/** @param {(cpu: Cpu) => boolean} condition @returns {Handler} */
const branchIf = (condition) => (cpu, op) => {
  if (!condition(cpu)) return 1;
  cpu.r[PC] += 2 + ((op << 24) >> 23);
  return 2;
};

/** @type {Handler} */
const branch = (cpu, op) => {
  cpu.r[PC] += 2 + ((op << 21) >> 20);
  return 2;
};

/** What the package knows as well, at its own pace. @type {Handler} */
const byPackage = ({ core, r }) => {
  r[PC] -= 2;
  return core.executeInstruction();
};

/** BL, 3 cycles on the M0+ without a wait state; every other 32-bit instruction goes to the package. @type {Handler} */
const wide = (cpu, op) => {
  const second = load16(cpu, cpu.r[PC]);
  if (op >> 11 !== 0x1e || second >> 14 !== 3 || !(second & 0x1000)) return byPackage(cpu, op);
  const sign = (op >> 10) & 1;
  const i1 = ~((second >> 13) ^ sign) & 1;
  const i2 = ~((second >> 11) ^ sign) & 1;
  const distance = (-sign << 24) | (i1 << 23) | (i2 << 22) | ((op & 0x3ff) << 12) | ((second & 0x7ff) << 1);
  const next = cpu.r[PC] + 2;
  cpu.r[LR] = next | 1;
  cpu.r[PC] = next + distance;
  return 3;
};

/** The handler of all opcodes whose upper ten bits are `index`. @param {number} index @returns {Handler} */
function handlerOf(index) {
  const top = index >> 5;
  if (top < 3) return SHIFTS_IMMEDIATE[top];
  if (top === 3) return ADD_SUBTRACT[(index >> 3) & 3];
  if (top < 8) return IMMEDIATE[top & 3];
  if (index < 0x110) return dataProcessing(index & 15);
  if (index < 0x120) return HIGH_REGISTERS[(index >> 2) & 3];
  if (top === 9) return loadLiteral;
  if (top < 12) return BY_REGISTER[(index >> 3) & 7];
  if (top < 22) return BY_IMMEDIATE[top - 12];
  if (top < 24) return miscellaneous(index);
  if (top === 24) return storeMultiple;
  if (top === 25) return loadMultiple;
  if (top < 28) return index < 0x378 ? branchIf(CONDITIONS[(index >> 2) & 15]) : byPackage;
  return top === 28 ? branch : wide;
}

/** @param {number} operation @returns {Handler} */
function dataProcessing(operation) {
  const compute = DATA_PROCESSING[operation];
  if (COMPARES.has(operation)) return (cpu, op) => (flagged(cpu, compute(cpu, op)), 1);
  return (cpu, op) => ((cpu.r[op & 7] = flagged(cpu, compute(cpu, op))), 1);
}

/** CPSIE i and CPSID i. @type {Handler} */
const changeMask = (cpu, op) => {
  const { core } = cpu;
  if (op !== 0xb662 && op !== 0xb672) return byPackage(cpu, op);
  core.PM = op === 0xb672;
  core.interruptsUpdated = true;
  return 1;
};

/** NOP and WFI; the other hints go to the package. @type {Handler} */
const hint = (cpu, op) => {
  if (op === 0xbf00) return 1;
  if (op !== 0xbf30) return byPackage(cpu, op);
  cpu.core.waiting = true;
  return 2;
};

/** 0xb000 to 0xbfff. @param {number} index @returns {Handler} */
function miscellaneous(index) {
  switch (index >> 2) {
    case 0xb0:
      return index & 2
        ? ({ r }, op) => ((r[SP] -= (op & 0x7f) << 2), 1)
        : ({ r }, op) => ((r[SP] += (op & 0x7f) << 2), 1);
    case 0xb2:
      return EXTEND[index & 3];
    case 0xb4:
    case 0xb5:
      return push;
    case 0xba:
      return reverse(index & 3);
    case 0xb6:
      return changeMask;
    case 0xbc:
    case 0xbd:
      return pop;
    case 0xbf:
      return hint;
    default:
      return byPackage;
  }
}

/** REV, REV16 and REVSH. @param {number} kind @returns {Handler} */
function reverse(kind) {
  if (kind === 0) {
    return ({ r }, op) => {
      const swapped = swapHalves(r[(op >> 3) & 7]);
      r[op & 7] = (swapped << 16) | (swapped >>> 16);
      return 1;
    };
  }
  if (kind === 1) return ({ r }, op) => ((r[op & 7] = swapHalves(r[(op >> 3) & 7])), 1);
  if (kind === 3) return ({ r }, op) => ((r[op & 7] = (swapHalves(r[(op >> 3) & 7]) << 16) >> 16), 1);
  return byPackage;
}

/** @type {Handler[]} */
const HANDLERS = Array.from({ length: 1024 }, (_, index) => handlerOf(index));

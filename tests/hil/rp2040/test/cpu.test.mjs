// The interpreter against the package's, instruction by instruction on random states, and against the manual's own
// arithmetic where the package is known to differ (carry of register shifts, V of ADCS and SBCS). ARMv6-M ARM A2.2.1.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { generator } from '../src/wire.mjs';
import { idle, RAM } from './program.mjs';

const CODE = RAM + 0x1000;
const DATA = RAM + 0x8000;
const DATA_BYTES = 0x800;
const EDGES = [0, 1, 2, 31, 32, 33, 0x7f, 0xff, 0x7fffffff, 0x80000000, 0xfffffffe, 0xffffffff];

/** @typedef {{ r: number[], flags: boolean[], memory: number[], cycles: number }} State */

function bench() {
  const { chip } = idle().chip();
  const { core, cpu } = chip.machine;
  const view = new DataView(chip.sram.buffer);
  /** @param {number[]} opcodes @param {number[]} registers @param {boolean[]} flags @param {boolean} byPackage */
  const run = (opcodes, registers, flags, byPackage) => {
    opcodes.forEach((opcode, i) => view.setUint16(CODE - RAM + 2 * i, opcode, true));
    for (let i = 0; i < DATA_BYTES; i++) chip.sram[DATA - RAM + i] = (i * 73) & 0xff;
    core.registers.set(registers);
    core.registers[15] = CODE;
    [core.N, core.Z, core.C, core.V] = flags;
    const cycles = byPackage ? core.executeInstruction() : cpu.step();
    const memory = [...chip.sram.subarray(DATA - RAM, DATA - RAM + DATA_BYTES)];
    return { r: [...core.registers], flags: [core.N, core.Z, core.C, core.V], memory, cycles };
  };
  return { chip, run };
}

/** @param {number} seed */
function source(seed) {
  const random = generator(seed);
  const below = (/** @type {number} */ n) => Math.floor(random() * n);
  const word = () => (below(3) === 0 ? EDGES[below(EDGES.length)] : below(2 ** 32));
  const flags = () => [0, 1, 2, 3].map(() => below(2) === 1);
  /** Any values, or (for memory) even registers as bases and odd ones as small offsets, all in the data. */
  const registers = (/** @type {boolean} */ forMemory) => {
    const low = Array.from({ length: 8 }, (_, i) =>
      !forMemory ? word() : i % 2 ? 4 * below(64) : DATA + 0x100 + 4 * below(64),
    );
    return [...low, ...Array.from({ length: 5 }, word), DATA + 0x400, CODE + 0x101, CODE];
  };
  return { below, flags, registers };
}

const even = (/** @type {number} */ n) => n & 6;

/** Opcodes by kind: `make` gives a random one. Those of ADC, SBC and the register shifts are tested apart. */
const KINDS = [
  { name: 'shift by an immediate', memory: false, make: (/** @type {number} */ x) => x % 0x1800 },
  { name: 'add and subtract', memory: false, make: (/** @type {number} */ x) => 0x1800 + (x % 0x800) },
  { name: 'immediates', memory: false, make: (/** @type {number} */ x) => 0x2000 + (x % 0x2000) },
  {
    name: 'data processing',
    memory: false,
    make: (/** @type {number} */ x) => 0x4000 | ([0, 1, 8, 9, 10, 11, 12, 13, 14, 15][(x >> 6) % 10] << 6) | (x & 0x3f),
  },
  // Neither the SP nor the PC as a target, which are tested by running code.
  { name: 'high registers', memory: false, make: (/** @type {number} */ x) => 0x4400 + ((x % 0x300) & 0x37f) },
  {
    name: 'literals and ADR',
    memory: false,
    make: (/** @type {number} */ x) => (x & 1 ? 0x4800 : 0xa000) | (x & 0x7ff),
  },
  {
    name: 'by registers',
    memory: true,
    make: (/** @type {number} */ x) => 0x5000 | (x & 0xe07) | (even(x >> 3) << 3) | ((even(x >> 6) | 1) << 6),
  },
  {
    name: 'by an immediate',
    memory: true,
    make: (/** @type {number} */ x) => 0x6000 + ((x % 0x3000) & ~0x38) + (even(x >> 3) << 3),
  },
  { name: 'by the SP', memory: true, make: (/** @type {number} */ x) => 0x9000 | (x & 0xf7f) },
  {
    name: 'the SP itself',
    memory: true,
    make: (/** @type {number} */ x) => (x & 0x100 ? 0xb000 | (x & 0xff) : 0xa800 | (x & 0x7ff)),
  },
  { name: 'extend', memory: false, make: (/** @type {number} */ x) => 0xb200 | (x & 0xff) },
  {
    name: 'reverse',
    memory: false,
    make: (/** @type {number} */ x) => 0xba00 | ([0, 1, 3][(x >> 6) % 3] << 6) | (x & 0x3f),
  },
  { name: 'push and pop', memory: true, make: (/** @type {number} */ x) => (x & 0x800 ? 0xb400 : 0xbc00) | (x & 0xff) },
  // STM with its base in the list is tested apart.
  {
    name: 'multiple',
    memory: true,
    make: (/** @type {number} */ x) => 0xc000 | (x & 0x8ff & ~(1 << even(x >> 8))) | (even(x >> 8) << 8),
  },
  { name: 'conditional branches', memory: false, make: (/** @type {number} */ x) => 0xd000 | (x % 0xe00) },
  { name: 'branches', memory: false, make: (/** @type {number} */ x) => 0xe000 | (x & 0x7ff) },
];

test('agrees with the package on every ordinary instruction: registers, flags, memory and cycles', () => {
  const { chip, run } = bench();
  const { below, flags, registers } = source(0x5eed);
  for (const { name, memory, make } of KINDS) {
    for (let i = 0; i < 1500; i++) {
      const opcode = make(below(0x10000));
      const target = ((opcode >> 4) & 8) | (opcode & 7);
      // A high target of SP or PC loses its low bits; LR stands for them here.
      if (name === 'high registers' && target > 12) continue;
      const before = registers(memory);
      const state = flags();
      const expected = run([opcode, 0xbf00], before, state, true);
      const actual = run([opcode, 0xbf00], before, state, false);
      assert.deepEqual(actual, expected, `${name}: 0x${opcode.toString(16)} with ${before.map((r) => r.toString(16))}`);
    }
  }
  assert.equal(chip.machine.exceptions.fault, null);
});

test('STM writes its base back even if the base is in the list (ARMv6-M ARM, STM)', () => {
  const { run } = bench();
  const { registers } = source(6);
  const before = registers(true);
  const { r, memory } = run([0xc003], before, [false, false, false, false], false);
  assert.equal(r[0], before[0] + 8);
  const stored = Buffer.from(memory.slice(before[0] - DATA, before[0] - DATA + 8));
  assert.deepEqual([stored.readUInt32LE(0), stored.readUInt32LE(4)], [before[0], before[1]]);
});

test('BL goes up to 16 MiB both ways, leaves LR odd and takes 3 cycles', () => {
  const { run } = bench();
  const { below, flags, registers } = source(2);
  for (let i = 0; i < 1500; i++) {
    const opcodes = [0xf000 | below(0x800), 0xd000 | below(0x1000) | 0x1000];
    const before = registers(false);
    const state = flags();
    assert.deepEqual(run(opcodes, before, state, false), run(opcodes, before, state, true));
  }
});

/** AddWithCarry of A2.2.1 in unbounded integers. */
function addWithCarry(/** @type {number} */ x, /** @type {number} */ y, /** @type {boolean} */ carry) {
  const unsigned = BigInt(x >>> 0) + BigInt(y >>> 0) + (carry ? 1n : 0n);
  const signed = BigInt(x | 0) + BigInt(y | 0) + (carry ? 1n : 0n);
  const result = Number(BigInt.asUintN(32, unsigned));
  return { result, c: unsigned !== BigInt(result), v: signed !== BigInt.asIntN(32, signed) };
}

test('ADCS and SBCS: all four flags', () => {
  const { run } = bench();
  const { flags, registers } = source(3);
  for (let i = 0; i < 4000; i++) {
    const isSubtract = i % 2 === 1;
    const before = registers(false);
    const state = flags();
    const { r, flags: after } = run([isSubtract ? 0x4188 : 0x4148], before, state, false);
    const { result, c, v } = addWithCarry(before[0], isSubtract ? ~before[1] : before[1], state[2]);
    assert.equal(r[0], result);
    assert.deepEqual(
      after,
      [result >= 0x80000000, result === 0, c, v],
      `${before[0].toString(16)}, ${before[1].toString(16)}`,
    );
  }
});

test('shifts by a register: the low byte counts, 0 leaves the carry, 32 and more empty the register', () => {
  const { run } = bench();
  const { below, flags, registers } = source(4);
  for (let i = 0; i < 8000; i++) {
    const kind = i % 4;
    const before = registers(false);
    if (below(2)) before[1] = below(40) + 256 * below(9);
    const state = flags();
    const count = BigInt(before[1] & 0xff);
    const value = BigInt(before[0]);
    const signed = BigInt.asIntN(32, value);
    let result = value;
    let carry = state[2];
    if (count > 0n) {
      if (kind === 0) [result, carry] = [value << count, ((value << count) >> 32n) & 1n ? true : false];
      if (kind === 1) [result, carry] = [value >> count, (value >> (count - 1n)) & 1n ? true : false];
      if (kind === 2) [result, carry] = [signed >> count, (signed >> (count - 1n)) & 1n ? true : false];
      if (kind === 3) {
        result = (value >> (count % 32n)) | (value << (32n - (count % 32n)));
        carry = (result >> 31n) & 1n ? true : false;
      }
    }
    const expected = Number(BigInt.asUintN(32, result));
    const { r, flags: after } = run([[0x4088, 0x40c8, 0x4108, 0x41c8][kind]], before, state, false);
    assert.equal(r[0], expected, `kind ${kind}: ${before[0].toString(16)} by ${count}`);
    assert.deepEqual(
      after,
      [expected >= 0x80000000, expected === 0, carry, state[3]],
      `kind ${kind}: ${before[0].toString(16)} by ${count}`,
    );
  }
});

test('cycles of the Cortex-M0+ TRM where the package counts others: PUSH with LR 1 + N', () => {
  const { run } = bench();
  const { registers } = source(5);
  for (const [opcode, cycles] of [
    [0xb500, 2],
    [0xb510, 3],
    [0xb5ff, 10],
    [0xb4ff, 9],
    [0xbcff, 9],
  ]) {
    assert.equal(
      run([opcode], registers(true), [false, false, false, false], false).cycles,
      cycles,
      opcode.toString(16),
    );
  }
});

// Counters and the crystal behind them: PWM slices (RP2040 datasheet 4.5), the timer's truth, rates that change.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { Crystal } from '../src/crystal.mjs';
import { World } from '../src/world.mjs';
import { BX_LR, idle, ldr, Program, RAM, str, WFI } from './program.mjs';

const TIMERAWL = 0x40054028;
const RESETS = 0x4000c000;
const RESET_PWM = 1 << 14;
const PWM = 0x40050000;
const CSR = 0x00;
const DIV = 0x04;
const CTR = 0x08;
const TOP = 0x10;
const EN = PWM + 0xa0;
const INTR = PWM + 0xa4;
const INTE = PWM + 0xa8;
const INTF = PWM + 0xac;
const INTS = PWM + 0xb0;
const CYCLE_NS = 8;
const IRQ_WRAP = 4;
const S = 1e9;

/** A chip that does nothing, its slices, and a way to let cycles pass. */
function open() {
  const { chip } = idle().chip();
  const { rp, clock } = chip;
  const at = (/** @type {number} */ slice, /** @type {number} */ register) => PWM + 0x14 * slice + register;
  const write = (/** @type {number} */ address, /** @type {number} */ value) => rp.writeUint32(address, value >>> 0);
  const read = (/** @type {number} */ address) => rp.readUint32(address);
  let zero = clock.nanos;
  return {
    chip,
    read,
    write,
    at,
    mark: () => (zero = clock.nanos),
    /** To so many cycles after the mark. */
    pass: (/** @type {number} */ cycles) => clock.advanceTo(zero + cycles * CYCLE_NS),
    pending: () => ((chip.machine.exceptions.lines >>> IRQ_WRAP) & 1) === 1,
  };
}

test('PWM: a fractional divisor: periods of INT and INT + 1 cycles, FRAC of sixteen the longer (4.5.2.4)', () => {
  const { at, mark, pass, read, write } = open();
  write(at(7, DIV), (7 << 4) | 13);
  write(at(7, CSR), 1);
  mark();
  /** @type {number[]} */
  const periods = [];
  let last = 0;
  for (let cycle = 1, count = 0; cycle <= 1250; cycle++) {
    pass(cycle);
    const now = read(at(7, CTR));
    assert.ok(now === count || now === count + 1, 'never more than one count a cycle');
    if (now !== count) {
      periods.push(cycle - last);
      last = cycle;
    }
    count = now;
  }
  assert.equal(periods.length, 160, '16 counts in 125 cycles');
  assert.equal(last, 1250);
  for (let i = 0; i < 160; i += 16) {
    const sixteen = periods.slice(i, i + 16).sort((a, b) => a - b);
    assert.deepEqual(sixteen, [7, 7, 7, ...new Array(13).fill(8)]);
  }
});

test('PWM: sixteen counts a microsecond stay in step with TIMER, over wraps too', () => {
  const { at, chip, read, write } = open();
  chip.clock.advanceTo(5_000);
  write(at(7, DIV), (7 << 4) | 13);
  write(at(7, CSR), 1);
  for (const us of [1, 4_095, 4_096, 4_097, 1_000_000, 4_000_000]) {
    chip.clock.advanceTo(5_000 + us * 1000);
    assert.equal(read(TIMERAWL), 5 + us);
    assert.equal(read(at(7, CTR)), (us * 16) % 65_536, `after ${us} us`);
  }
});

test('PWM: the wrap interrupt is held until INTR is cleared, by slice, and can be forced (4.5.3, INTR to INTS)', () => {
  const { at, mark, pass, pending, read, write } = open();
  write(at(0, TOP), 7_999);
  write(at(3, TOP), 99);
  write(INTE, 1);
  write(EN, 0b1001);
  mark();
  assert.equal(read(EN), 0b1001);
  pass(7_999);
  assert.deepEqual([read(at(0, CTR)), read(INTR), read(INTS), pending()], [7_999, 0b1000, 0, false]);
  pass(8_000);
  assert.deepEqual([read(at(0, CTR)), read(INTR), read(INTS), pending()], [0, 0b1001, 1, true]);
  write(INTR, 0b1000);
  assert.ok(pending(), 'the other slice does not end it');
  write(INTR, 1);
  assert.deepEqual([read(INTS), pending()], [0, false]);
  for (let turn = 2; turn < 2_000; turn++) {
    pass(turn * 8_000 - 1);
    assert.ok(!pending(), `wrap ${turn} is not early`);
    pass(turn * 8_000);
    assert.ok(pending(), `wrap ${turn} is not late`);
    write(INTR, 1);
  }
  write(INTE, 0);
  write(INTF, 4);
  assert.deepEqual([read(INTS), pending()], [4, true]);
});

test('PWM: a new TOP counts from the next wrap, a new CTR at once; a stopped slice keeps its count (4.5.2.3)', () => {
  const { at, mark, pass, read, write } = open();
  write(at(1, TOP), 99);
  write(at(1, CTR), 40);
  write(at(1, CSR), 1);
  mark();
  write(at(1, TOP), 9);
  pass(59);
  assert.equal(read(at(1, CTR)), 99);
  pass(60);
  assert.equal(read(at(1, CTR)), 0);
  pass(69);
  assert.equal(read(at(1, CTR)), 9);
  pass(70);
  assert.equal(read(at(1, CTR)), 0);
  pass(74);
  write(at(1, CSR), 0);
  pass(1_000);
  assert.equal(read(at(1, CTR)), 4);
  // INT at 0 is 256.
  write(at(1, DIV), 0);
  write(at(1, CSR), 1);
  mark();
  pass(255);
  assert.equal(read(at(1, CTR)), 4);
  pass(256);
  assert.equal(read(at(1, CTR)), 5);
});

test('PWM: a counter that is held in reset is at its beginning (datasheet 2.14)', () => {
  const { at, mark, pass, read, write } = open();
  write(INTE, 1);
  write(at(0, TOP), 9);
  write(at(0, CSR), 1);
  mark();
  pass(15);
  assert.equal(read(INTS), 1);
  write(RESETS, RESET_PWM);
  write(RESETS, 0);
  assert.deepEqual([INTR, INTE, at(0, TOP), at(0, DIV), at(0, CSR)].map(read), [0, 0, 0xffff, 0x10, 0]);
  pass(1_000);
  assert.deepEqual([read(at(0, CTR)), read(INTR)], [0, 0]);
});

test('PWM: a handler bound to the wrap runs once a period', () => {
  const program = new Program()
    .poke(0xe000e100, 1 << IRQ_WRAP)
    .poke(PWM + TOP, 7_999)
    .poke(INTE, 1)
    .poke(PWM, 1)
    .label('end')
    .op(WFI)
    .branch('end');
  program
    .handler(16 + IRQ_WRAP)
    .poke(INTR, 1)
    .load(0, RAM)
    .op(ldr(1, 0), 0x3101, str(1, 0), BX_LR);
  const { chip, word } = program.chip();
  chip.runTo(64_000 * 100 + 2_000);
  assert.equal(word(RAM), 100);
});

test('a crystal: global to local and back is exact to a thousandth of a nanosecond', () => {
  const crystal = new Crystal(-50, 1_000);
  crystal.set(2 * S, -50, 5);
  crystal.set(20 * S, 50, -0.01);
  for (const globalNs of [1_000, 1.5 * S, 2 * S, 2 * S + 1, 19.999 * S, 20 * S, 21 * S, 300 * S]) {
    const local = crystal.toLocal(globalNs);
    // Two roundings at 3e11 ns, 6e-5 ns each.
    assert.ok(Math.abs(crystal.toGlobal(local) - globalNs) < 1e-3, `${globalNs}`);
  }
});

test('a crystal: rate, ramp and step are the integral of the rate', () => {
  const crystal = new Crystal(20, 0);
  assert.equal(crystal.toLocal(S), S + 20_000);
  crystal.set(S, 20, 0.5);
  // 2 s of 20 ppm, and the triangle below 1 ppm: half of 2 s times 1 ppm.
  assert.ok(Math.abs(crystal.toLocal(3 * S) - (3 * S + 60_000 + 1_000)) < 1e-3);
  assert.ok(Math.abs(crystal.ppmAt(3 * S) - 21) < 1e-12);
  crystal.set(3 * S, -100, 0);
  assert.ok(Math.abs(crystal.toLocal(4 * S) - (4 * S + 61_000 - 100_000)) < 1e-3);
  // What has passed does not change.
  assert.equal(crystal.toLocal(S), S + 20_000);
  assert.equal(crystal.ppmAt(0.5 * S), 20);
  crystal.restart(5 * S);
  assert.equal(crystal.toLocal(5 * S), 0);
  assert.equal(crystal.ppmAt(6 * S), -100);
});

test('the truth of a chip’s time is what its timer counts, whatever its crystal does', () => {
  const made = new World();
  const { chip } = idle().chip({ name: 'a', ppm: 30, startNs: 700 });
  made.chips.set('a', chip);
  assert.throws(() => made.time('a', 600, undefined), /booted at 700 ns/);
  made.run(S, false);
  made.setCrystal('a', undefined, -20);
  made.run(2 * S, false);
  made.setCrystal('a', -40, undefined);
  for (let i = 1; i < 50; i++) {
    made.run(2 * S + i * 7_777_777, false);
    const { local_ns: local, ppm } = made.time('a', undefined, undefined);
    // What the last instruction took beyond the quantum: none here, the core sleeps.
    assert.equal(chip.rp.readUint32(TIMERAWL), Math.floor(local / 1000));
    assert.ok(Math.abs(ppm - (-40 - 20 * i * 7_777_777e-9)) < 1e-9);
  }
  // The microsecond in which the timer went on is found from the reading.
  const { global_ns: global } = made.time('a', undefined, 1_500_000_000);
  assert.ok(Math.abs(made.time('a', global, undefined).local_ns - 1_500_000_000) < 1e-3);
  assert.ok(global > S && global < 2 * S);
  chip.powerOff();
  assert.throws(() => made.time('a', undefined, undefined), /is off/);
});

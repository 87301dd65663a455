// Edges of pins as an outside sees them (RP2040 datasheet 2.3.1.2, 2.19), and what the PWM puts out (4.5.2).
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { EDGES_MAX, OPEN } from '../src/gpio.mjs';
import { idle, NOP, Program, RAM, str } from './program.mjs';

const SIO = 0xd0000000;
const OUT = SIO + 0x10;
const OUT_SET = SIO + 0x14;
const OUT_CLR = SIO + 0x18;
const OUT_XOR = SIO + 0x1c;
const OE = SIO + 0x20;
const OE_SET = SIO + 0x24;
const OE_CLR = SIO + 0x28;
const OE_XOR = SIO + 0x2c;
const FUNCTION_PWM = 4;
const FUNCTION_SIO = 5;
const CYCLE_NS = 8;
const PWM = 0x40050000;
/** A word of IO_BANK0: CTRL of a pin. */
const control = (/** @type {number} */ pin) => 0x40014004 + 8 * pin;
const pad = (/** @type {number} */ pin) => 0x4001c004 + 4 * pin;
const PAD_OD = 1 << 7;

/** A chip that sleeps, its registers, and the pins and levels of the edges since the last question. */
function open() {
  const { chip } = idle().chip();
  const write = (/** @type {number} */ address, /** @type {number} */ value) => chip.rp.writeUint32(address, value >>> 0);
  const edges = () => chip.pins.take().edges.map(([, , pin, level]) => [pin, level]);
  return { chip, write, edges };
}

test('two stores on end make edges one cycle apart, one store makes all of its edges at once', () => {
  const program = new Program(RAM + 0x1000);
  for (const pin of [6, 7]) program.poke(control(pin), FUNCTION_SIO);
  program.poke(OE_SET, 3 << 6);
  // r2: pin 6; r3: pins 6 and 7. STR to SIO takes one cycle (datasheet 2.3.1: single-cycle IO), so does NOP.
  program.load(0, SIO).load(2, 1 << 6).load(3, 3 << 6);
  program.op(str(2, 0, 0x14), str(2, 0, 0x18), str(3, 0, 0x1c), NOP, NOP, NOP, str(3, 0, 0x1c)).label('end').branch('end');
  const { chip } = program.chip({ ppm: 100, startNs: 1_000 });
  chip.pins.watch(3 << 6);
  chip.runTo(20_000);
  const { edges, lost } = chip.pins.take();
  const [first] = edges.slice(2).map(([, local]) => local);
  assert.equal(lost, 0);
  assert.deepEqual(
    edges.slice(2).map(([, local, pin, level]) => [Math.round((local - first) / CYCLE_NS), pin, level]),
    [
      [0, 6, 1],
      [1, 6, 0],
      [2, 6, 1],
      [2, 7, 1],
      [6, 6, 0],
      [6, 7, 0],
    ],
  );
  // OE before: both pins are driven low by one store.
  assert.deepEqual(
    edges.slice(0, 2).map(([, , pin, level]) => [pin, level]),
    [
      [6, 0],
      [7, 0],
    ],
  );
  assert.equal(edges[0][1], edges[1][1]);
  for (const [global, local] of edges) assert.ok(Math.abs(global - (1_000 + local / 1.0001)) < 1e-6);
});

test('GPIO_OUT and GPIO_OE with their set, clear and toggle registers (datasheet 2.3.1.7)', () => {
  const { chip, edges, write } = open();
  for (const pin of [0, 29]) write(control(pin), FUNCTION_SIO);
  assert.deepEqual(chip.pins.watch((1 << 29) | 1), { high: 0, open: (1 << 29) | 1 });
  write(OE, 1);
  write(OE_SET, 1 << 29);
  assert.deepEqual(edges(), [[0, 0], [29, 0]]);
  write(OUT, 1 << 29);
  write(OUT_SET, 1);
  write(OUT_SET, 1);
  write(OUT_CLR, 1 << 29);
  write(OUT_XOR, 1);
  assert.deepEqual(edges(), [[29, 1], [0, 1], [29, 0], [0, 0]]);
  write(OE_XOR, 1);
  write(OE_CLR, 1 << 29);
  assert.deepEqual(edges(), [[0, OPEN], [29, OPEN]]);
});

test('the function select, overrides and the pad decide what leaves the chip (datasheet 2.19.2, 2.19.6)', () => {
  const { chip, edges, write } = open();
  write(OE_SET, 1 << 9);
  write(OUT_SET, 1 << 9);
  chip.pins.watch(1 << 9);
  assert.deepEqual(edges(), [], 'SIO drives, but is not selected');
  write(control(9), FUNCTION_SIO);
  assert.deepEqual(edges(), [[9, 1]]);
  write(control(9), FUNCTION_SIO | (1 << 8));
  assert.deepEqual(edges(), [[9, 0]], 'OUTOVER inverts');
  write(control(9), FUNCTION_SIO);
  write(pad(9), 0x56 | PAD_OD);
  assert.deepEqual(edges(), [[9, 1], [9, OPEN]], 'OD has priority');
  write(OUT_CLR, 1 << 9);
  write(pad(9), 0x56);
  assert.deepEqual(edges(), [[9, 0]]);
  write(control(9), 31);
  assert.deepEqual(edges(), [[9, OPEN]], 'NULL drives nothing');
});

test('pins that are not asked for are not recorded, and a new question begins anew', () => {
  const { chip, edges, write } = open();
  for (const pin of [6, 7]) write(control(pin), FUNCTION_SIO);
  write(OE_SET, 3 << 6);
  chip.pins.watch(1 << 6);
  write(OUT_XOR, 3 << 6);
  assert.deepEqual(edges(), [[6, 1]]);
  write(OUT_XOR, 3 << 6);
  write(OUT_XOR, 1 << 7);
  assert.deepEqual(chip.pins.watch(1 << 7), { high: 1 << 7, open: 0 });
  assert.deepEqual(edges(), []);
  write(OUT_XOR, 3 << 6);
  assert.deepEqual(edges(), [[7, 0]]);
  assert.throws(() => chip.pins.watch(2 ** 30), /bit for each of the pins 0 to 29/);
});

test('a reset and the loss of power leave the pins open, and recording goes on', () => {
  const { chip, edges, write } = open();
  const drive = () => {
    write(control(6), FUNCTION_SIO);
    write(OE_SET, 1 << 6);
    write(OUT_SET, 1 << 6);
  };
  chip.pins.watch(1 << 6);
  drive();
  chip.reset(10_000);
  drive();
  chip.powerOff();
  const up = [[6, 0], [6, 1]];
  assert.deepEqual(edges(), [...up, [6, OPEN], ...up, [6, OPEN]]);
  assert.deepEqual(chip.pins.watch(1 << 6), { high: 0, open: 1 << 6 }, 'off');
  chip.powerOn(30_000);
  drive();
  assert.deepEqual(edges(), up);
});

test('what there is no room for is counted', () => {
  const { chip, write } = open();
  write(control(6), FUNCTION_SIO);
  write(OE_SET, 1 << 6);
  chip.pins.watch(1 << 6);
  for (let i = 0; i < EDGES_MAX + 5; i++) write(OUT_XOR, 1 << 6);
  const { edges, lost } = chip.pins.take();
  assert.deepEqual([edges.length, lost], [EDGES_MAX, 5]);
  write(OUT_XOR, 1 << 6);
  const after = chip.pins.take();
  assert.deepEqual([after.edges.length, after.lost], [1, 0]);
});

test('PWM: TOP and CC are taken with the next wrap, both channels at once (datasheet 4.5.2.3)', () => {
  const { chip, write } = open();
  const { clock } = chip;
  const slice = PWM + 0x14 * 5;
  for (const pin of [26, 27]) write(control(pin), FUNCTION_PWM);
  write(slice + 0x10, 99);
  write(slice + 0x0c, (30 << 16) | 10);
  // It stands, so that both are taken at once.
  const wanted = { top: 99, a: 10, b: 30 };
  const report = () => chip.machine.pwm.report()[5];
  const outputs = { enabled: true, invert_a: false, invert_b: true, count_cycles: 1, pins_a: [26], pins_b: [27] };
  write(slice, 1 | (1 << 3));
  const zero = clock.nanos;
  assert.deepEqual(report(), { ...outputs, ...wanted, next: wanted });
  const next = { top: 199, a: 0, b: 200 };
  clock.advanceTo(zero + 50 * CYCLE_NS);
  write(slice + 0x10, 199);
  write(slice + 0x0c, 200 << 16);
  clock.advanceTo(zero + 99 * CYCLE_NS);
  assert.deepEqual(report(), { ...outputs, ...wanted, next });
  clock.advanceTo(zero + 100 * CYCLE_NS);
  assert.deepEqual(report(), { ...outputs, ...next, next });
  // Slice 5 has two more pins (datasheet 4.5.2); the other slices have none of these.
  write(control(10), FUNCTION_PWM);
  assert.deepEqual(report().pins_a, [10, 26]);
  assert.deepEqual(chip.machine.pwm.report()[4].pins_a, []);
});

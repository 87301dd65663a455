// Watchdog, resets, timer alarms and PWM. RP2040 datasheet 4.7, 2.13, 2.10, 4.6, 4.5; errata RP2040-E1.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { adds, BX_LR, idle, ldr, Program, RAM, str, WFI } from './program.mjs';

const WATCHDOG = 0x40058000;
const CTRL = WATCHDOG;
const LOAD = WATCHDOG + 0x04;
const REASON = WATCHDOG + 0x08;
const SCRATCH3 = WATCHDOG + 0x18;
const TICK = WATCHDOG + 0x2c;
const PSM_WDSEL = 0x40010008;
const CLK_REF_CTRL = 0x40008030;
const CHIP_RESET = 0x40064008;
const TIMER = 0x40054000;
const PWM = 0x40050000;
const ENABLE = 1 << 30;
const TRIGGER = 0x80000000;

/** Counts its boots at RAM, then runs `rest` in the first of them only, then sleeps. */
function firstBoot(/** @type {(program: Program) => Program} */ rest) {
  const program = new Program().load(0, RAM).op(ldr(1, 0), adds(1, 1), str(1, 0), 0x2902).branch('end', 'cs');
  return rest(program).label('end').op(WFI).branch('end').chip();
}

const select = (/** @type {Program} */ program) =>
  program
    .poke(PSM_WDSEL, 0x1fffc)
    .poke(CLK_REF_CTRL, 2)
    .poke(TICK, 0x200 | 12);

test('the timer resets the chip after LOAD / 2 us (E1), keeps RAM and scratch, and says why', () => {
  const { chip, events, word } = firstBoot((program) =>
    select(program)
      .poke(SCRATCH3, 0xcafe)
      .poke(LOAD, 2 * 5000)
      .poke(CTRL, ENABLE),
  );
  chip.runTo(4.99e6);
  assert.deepEqual(events, []);
  chip.runTo(5.1e6);
  assert.deepEqual(events, [{ chip: 'chip', event: 'watchdog', detail: 'timer' }]);
  assert.equal(chip.rp.readUint32(REASON), 1);
  assert.equal(chip.rp.readUint32(SCRATCH3), 0xcafe);
  assert.equal(chip.rp.readUint32(CHIP_RESET), 1 << 8, 'HAD_POR, as before');
  assert.equal(chip.rp.readUint32(CTRL) & ENABLE, 0, 'stopped by the reset');
  chip.runTo(5.3e6);
  assert.equal(word(RAM), 2);
  // The RUN pin clears reason and scratch (datasheet 4.7), not RAM.
  chip.reset(chip.now);
  assert.deepEqual([chip.rp.readUint32(REASON), chip.rp.readUint32(SCRATCH3), word(RAM)], [0, 0, 2]);
  assert.equal(chip.rp.readUint32(CHIP_RESET), 1 << 16, 'HAD_RUN');
});

test('feeding holds it off, and CTRL.TIME runs down by two a microsecond', () => {
  const { chip, events } = firstBoot((program) =>
    select(program)
      .poke(LOAD, 2 * 1000)
      .poke(CTRL, ENABLE),
  );
  chip.runTo(600_000);
  const before = chip.rp.readUint32(CTRL) & 0xffffff;
  chip.runTo(700_000);
  assert.equal(before - (chip.rp.readUint32(CTRL) & 0xffffff), 200);
  for (let at = 700_000; at <= 5e6; at += 900_000) {
    chip.rp.writeUint32(LOAD, 2 * 1000);
    chip.runTo(at + 900_000);
  }
  assert.deepEqual(events, []);
});

test('CTRL.TRIGGER resets at once, with REASON 2; without PSM_WDSEL nothing happens (datasheet 2.13)', () => {
  const selected = firstBoot((program) => program.poke(PSM_WDSEL, 0x1fffc).poke(CTRL, TRIGGER));
  selected.chip.runTo(400_000);
  assert.deepEqual(
    selected.events.map((e) => [e.event, e.detail]),
    [['watchdog', 'CTRL.TRIGGER']],
  );
  assert.equal(selected.chip.rp.readUint32(REASON), 2);
  assert.equal(selected.word(RAM), 2);
  const unselected = firstBoot((program) => program.poke(CTRL, TRIGGER));
  unselected.chip.runTo(400_000);
  assert.deepEqual(unselected.events, []);
  assert.equal(unselected.word(RAM), 1);
});

test('a stopped tick stops the watchdog (datasheet 4.7, tick)', () => {
  const { chip, events } = firstBoot((program) =>
    program.poke(PSM_WDSEL, 0x1fffc).poke(TICK, 0).poke(LOAD, 100).poke(CTRL, ENABLE),
  );
  chip.runTo(1e6);
  assert.deepEqual(events, []);
});

test('power off loses RAM and the watchdog memory, and keeps the flash', () => {
  const { chip, word } = idle().chip();
  chip.runTo(10_000);
  chip.rp.writeUint32(SCRATCH3, 5);
  chip.rp.sramView.setUint32(0x100, 0x12345678, true);
  chip.flash.array[0x100000] = 1;
  chip.powerOff();
  chip.runTo(50_000);
  chip.powerOn(60_000);
  chip.runTo(70_000);
  assert.notEqual(word(RAM + 0x100), 0x12345678);
  assert.equal(chip.rp.readUint32(SCRATCH3), 0);
  assert.equal(chip.flash.array[0x100000], 1);
  assert.ok(Math.abs(chip.clock.nanos - 10_000) < 200, 'local time starts with the boot');
});

test('an alarm fires when the counter has reached it, not before (datasheet 4.6)', () => {
  // The handler keeps what the counter says and sets the next alarm 7 us after the last, at odd instants.
  const program = new Program()
    .poke(TIMER + 0x38, 1)
    .poke(TIMER + 0x10, 500)
    .poke(0xe000e100, 1);
  program.label('end').op(WFI).branch('end');
  program
    .handler(16)
    .poke(TIMER + 0x34, 1)
    .load(0, TIMER)
    .op(ldr(2, 0, 0x28), ldr(1, 0, 0x10), 0x1a52);
  // r2 = counter - alarm; keep the smallest and the largest (as numbers of events late and early).
  program
    .load(3, RAM)
    .op(ldr(4, 3), 0x18a4, str(4, 3), ldr(4, 3, 4), 0x3401, str(4, 3, 4), adds(1, 7), str(1, 0, 0x10), BX_LR);
  const { chip, word } = program.chip();
  chip.runTo(2e6);
  assert.equal(word(RAM + 4), Math.floor((2000 - 500) / 7) + 1);
  assert.equal(word(RAM), 0, 'never early, and late by less than a microsecond');
});

test('PWM: CTR counts whole periods of the divisor, wraps behind TOP and interrupts there (datasheet 4.5)', () => {
  const { chip } = idle().chip();
  const { rp } = chip;
  rp.writeUint32(PWM + 0x10, 999);
  rp.writeUint32(PWM + 0x04, 125 << 4);
  rp.writeUint32(PWM + 0xa8, 1);
  rp.writeUint32(PWM, 1);
  const start = chip.clock.nanos;
  // One count a microsecond.
  for (const [at, count] of [
    [0, 0],
    [999, 0],
    [1_000, 1],
    [1_999, 1],
    [500_600, 500],
    [999_999, 999],
    [1_000_000, 0],
  ]) {
    chip.clock.advanceTo(start + at);
    assert.equal(rp.readUint32(PWM + 0x08), count, `after ${at} ns`);
    assert.equal(rp.readUint32(PWM + 0xb0), at === 1_000_000 ? 1 : 0);
  }
  chip.clock.advanceTo(start + 15e6 + 1);
  rp.writeUint32(PWM + 0xa4, 1);
  assert.equal(rp.readUint32(PWM + 0xb0), 0);
  chip.clock.advanceTo(start + 16e6);
  assert.equal(rp.readUint32(PWM + 0xb0), 1);
});

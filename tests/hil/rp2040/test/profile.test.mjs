// The figures of the profile against programs whose cycles can be counted by hand (Cortex-M0+ TRM table 3-1).
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { BX_LR, CPSID, CPSIE, ldr, movs, NOP, Program, RAM, subs, WFI } from './program.mjs';

const ISPR = 0xe000e200;
const LOW = 25;
const HIGH = 26;

/** r2 times round: SUBS 1, BNE 2 when taken, 1 at the end. */
const spin = (/** @type {Program} */ program, /** @type {string} */ name, /** @type {number} */ times) =>
  program.op(movs(2, times)).label(name).op(subs(2, 1)).branch(name, 'ne');
const spinCycles = (/** @type {number} */ times) => 1 + 3 * times - 1;

/** @param {ReturnType<import('../src/profile.mjs').Profile['report']>} report @param {number} irq */
const of = (report, irq) => {
  const entry = report.exceptions.find(({ number }) => number === 16 + irq);
  assert.ok(entry, `interrupt ${irq} is not in the profile`);
  return entry;
};

test('own cycles leave out what preempted, the span does not', () => {
  const program = new Program().poke(0xe000e418, 0x00408000).poke(0xe000e100, (1 << LOW) | (1 << HIGH));
  program
    .poke(ISPR, 1 << LOW)
    .label('end')
    .op(WFI)
    .branch('end');
  program.handler(16 + LOW).poke(ISPR, 1 << HIGH);
  spin(program, 'low', 40).op(BX_LR);
  program.handler(16 + HIGH);
  spin(program, 'high', 100).op(BX_LR);
  const { chip } = program.chip();
  chip.runTo(50_000);
  const report = chip.report();
  const high = of(report, HIGH);
  const low = of(report, LOW);
  // Entry 15, the loop, BX 2, return 12.
  const highCycles = 15 + spinCycles(100) + 2 + 12;
  assert.deepEqual(
    [high.count, high.cycles_max, high.cycles_total, high.span_cycles_max],
    [1, highCycles, highCycles, highCycles],
  );
  // The two literals 2 + 2 and the STR 2 besides.
  const lowCycles = 15 + 6 + spinCycles(40) + 2 + 12;
  assert.deepEqual([low.count, low.cycles_max, low.span_cycles_max], [1, lowCycles, lowCycles + highCycles]);
});

test('latency counts from pended and enabled to the first instruction, masked time included', () => {
  const program = new Program()
    .poke(0xe000e100, 1 << LOW)
    .op(CPSID)
    .poke(ISPR, 1 << LOW);
  spin(program, 'masked', 50).op(CPSIE, NOP).label('end').op(WFI).branch('end');
  program.handler(16 + LOW).op(BX_LR);
  const { chip } = program.chip();
  chip.runTo(50_000);
  const report = chip.report();
  // STR 2 (it pends as it begins), the loop, CPSIE 1, entry 15.
  assert.equal(of(report, LOW).latency_cycles_max, 2 + spinCycles(50) + 1 + 15);
  // CPSID 1, two literals 4, STR 2, the loop; masked until CPSIE begins.
  assert.equal(report.primask_cycles_max, 1 + 4 + 2 + spinCycles(50));
});

test('time pended while the NVIC has it disabled counts apart, and what was cleared is forgotten', () => {
  const program = new Program()
    .poke(ISPR, 1 << LOW)
    .poke(0xe000e280, 1 << LOW)
    .poke(ISPR, 1 << LOW);
  // Locks of RTIC on this core clear and set enables.
  spin(program, 'disabled', 50)
    .poke(0xe000e100, 1 << LOW)
    .label('end')
    .op(WFI)
    .branch('end');
  program.handler(16 + LOW).op(BX_LR);
  const { chip } = program.chip();
  chip.runTo(50_000);
  const low = of(chip.report(), LOW);
  // Enabled by STR 2, entry 15.
  assert.equal(low.latency_cycles_max, 2 + 15);
  // Pended by STR 2, the loop, two literals 4, then as above.
  assert.equal(low.pended_cycles_max, 2 + spinCycles(50) + 4 + 2 + 15);
});

test('sleep and work make up the time; a reset of the profile forgets', () => {
  const program = new Program();
  spin(program, 'work', 200).label('end').op(WFI).branch('end');
  const { chip } = program.chip();
  chip.runTo(80_000);
  const { cycles, sleep_cycles: sleep, instructions } = chip.report();
  assert.equal(cycles, 10_000);
  assert.equal(instructions, 1 + 2 * 200 + 1);
  // WFI itself takes 2.
  assert.equal(cycles - sleep, spinCycles(200) + 2);
  chip.resetProfile();
  chip.runTo(160_000);
  assert.deepEqual(chip.report().instructions, 0);
  assert.equal(chip.report().cycles, 10_000);
});

test('the wait of a received byte is from its arrival to its being read', () => {
  const uart = 0x40034000;
  const program = new Program()
    .poke(uart + 0x24, 2)
    .poke(uart + 0x2c, 0x70)
    .poke(uart + 0x30, 0x301);
  program
    .label('spin')
    .load(0, RAM)
    .op(ldr(1, 0), 0x2900)
    .branch('spin', 'eq')
    .load(0, uart)
    .op(ldr(1, 0))
    .keep(RAM + 4, 1);
  program.label('end').op(WFI).branch('end');
  const { chip } = program.chip();
  chip.runTo(5_000);
  chip.uarts[0].receive({ data: 9, startNs: 0, bitNs: chip.uarts[0].bitNs, bits: 10, isBreak: false });
  const arrived = chip.clock.nanos;
  chip.runTo(12_000);
  chip.rp.sramView.setUint32(0, 1, true);
  chip.runTo(13_000);
  const [first] = chip.report().uarts;
  assert.equal(first.rx_bytes, 1);
  // The loop of 2 + 2 + 1 + 2 cycles finds the flag after 12 us, then 1 + 2 more until LDR reads.
  const least = 12_000 - arrived;
  assert.ok(first.rx_wait_ns_max >= least && first.rx_wait_ns_max < least + 20 * 8, `${first.rx_wait_ns_max}`);
});

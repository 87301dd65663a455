// Exceptions, NVIC, faults and arithmetic of the core against the ARMv6-M manual.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import {
  adds,
  BX_LR,
  cmp,
  CPSID,
  CPSIE,
  ldr,
  LINK,
  movs,
  NOP,
  pop,
  Program,
  push,
  RAM,
  STACK_TOP,
  str,
  WFI,
} from './program.mjs';

const ISER = 0xe000e100;
const ISPR = 0xe000e200;
const ICPR = 0xe000e280;
const IPR6 = 0xe000e418;
const ICSR = 0xe000ed04;
const VTOR = 0xe000ed08;
const AIRCR = 0xe000ed0c;
const PWM = 0x40050000;
const PWM_CTR = PWM + 0x08;
const SW0 = 26;
const UART0 = 20;

/** The PWM counter of slice 0 at one count a system clock cycle: a cycle counter that the core can read. */
const startCounter = (/** @type {Program} */ program) =>
  program
    .poke(PWM + 0x10, 0xffff)
    .poke(PWM + 0x04, 0x10)
    .poke(PWM, 1);

test('ADD Rd, PC at the top of a handler sees no Thumb bit (ARMv6-M ARM, ExceptionTaken())', () => {
  const program = new Program()
    .poke(ISER, 1 << SW0)
    .poke(ISPR, 1 << SW0)
    .label('end')
    .op(WFI)
    .branch('end');
  program
    .handler(16 + SW0)
    .op(movs(2, 0))
    .label('add')
    .op(0x447a)
    .keep(RAM, 2)
    .op(BX_LR);
  const { chip, word } = program.chip();
  chip.runTo(10_000);
  assert.equal(word(RAM), program.address('add') + 4);
});

test('a jump table in a handler reaches its case', () => {
  const program = new Program()
    .poke(ISER, 1 << SW0)
    .poke(ISPR, 1 << SW0)
    .label('end')
    .op(WFI)
    .branch('end');
  // r2 = 2 selects the second case: ADD PC, r2 jumps r2 bytes behind the address of the instruction after the next.
  program
    .handler(16 + SW0)
    .op(movs(3, 0), movs(2, 2), 0x4497, NOP, movs(3, 1), adds(3, 7))
    .keep(RAM, 3)
    .op(BX_LR);
  const { chip, events, word } = program.chip();
  chip.runTo(10_000);
  assert.deepEqual(events, []);
  assert.equal(word(RAM), 7);
});

test('exception entry takes 15 cycles and return 12 beyond the branch (Cortex-M0+ TRM 3.6.1)', () => {
  const program = startCounter(new Program())
    .poke(ISER, 1 << SW0)
    .load(2, PWM_CTR)
    .load(0, ISPR)
    .load(1, 1 << SW0);
  program
    .op(ldr(4, 2), str(1, 0), ldr(6, 2))
    .keep(RAM, 4)
    .keep(RAM + 4, 5)
    .keep(RAM + 8, 6);
  program.label('end').op(WFI).branch('end');
  program.handler(16 + SW0).op(ldr(5, 2), BX_LR);
  const { chip, word } = program.chip();
  chip.runTo(20_000);
  const [before, inside, after] = [word(RAM), word(RAM + 4), word(RAM + 8)];
  // LDR over APB 1 + 3, STR to the private bus 2, entry 15.
  assert.equal(inside - before, 4 + 2 + 15);
  // LDR over APB 1 + 3, BX 2, return 12.
  assert.equal(after - inside, 4 + 2 + 12);
});

test('POP with the PC takes 3 + N cycles (Cortex-M0+ TRM table 3-1)', () => {
  const program = startCounter(new Program()).load(2, PWM_CTR).load(3, 'behind');
  // MOV LR, r3: PUSH is outside of the measured stretch.
  program
    .op(0x469e, push(LINK | 1), ldr(4, 2), pop(LINK | 1))
    .label('behind')
    .op(ldr(5, 2));
  program
    .keep(RAM, 4)
    .keep(RAM + 4, 5)
    .label('end')
    .op(WFI)
    .branch('end');
  const { chip, events, word } = program.chip();
  chip.runTo(20_000);
  assert.deepEqual(events, []);
  assert.equal(word(RAM + 4) - word(RAM), 4 + (3 + 2));
});

test('an interrupt that software pends is entered once, whatever its number (DUI 0662)', () => {
  for (const irq of [3, 25, 26, 31]) {
    const program = new Program().poke(ISER, (1 << irq) >>> 0).poke(ISPR, (1 << irq) >>> 0);
    program.label('end').op(WFI).branch('end');
    program
      .handler(16 + irq)
      .load(0, RAM)
      .op(ldr(1, 0), adds(1, 1), str(1, 0), BX_LR);
    const { chip, word } = program.chip();
    chip.runTo(20_000);
    assert.equal(word(RAM), 1, `interrupt ${irq}`);
  }
});

test('a line that stays high pends again at the return; one that falls does not', () => {
  const program = new Program()
    .poke(ISER, 1 << UART0)
    .label('end')
    .op(WFI)
    .branch('end');
  program
    .handler(16 + UART0)
    .load(0, RAM)
    .op(ldr(1, 0), adds(1, 1), str(1, 0), BX_LR);
  const { chip, word } = program.chip();
  chip.runTo(10_000);
  chip.rp.setInterrupt(UART0, true);
  chip.runTo(20_000);
  const whileHigh = word(RAM);
  assert.ok(whileHigh > 10, `entered ${whileHigh} times while high`);
  chip.rp.setInterrupt(UART0, false);
  chip.runTo(30_000);
  // The one in service or already pended may still run.
  assert.ok(word(RAM) <= whileHigh + 1);
  const settled = word(RAM);
  chip.runTo(40_000);
  assert.equal(word(RAM), settled);
});

test('a line that rose and fell while masked stays pending (DUI 0662, level-sensitive interrupts)', () => {
  const program = new Program()
    .op(CPSID)
    .poke(ISER, 1 << UART0)
    .label('spin')
    .load(0, RAM + 4)
    .op(ldr(1, 0), cmp(1, 0));
  program.branch('spin', 'eq').op(CPSIE, NOP).label('end').op(WFI).branch('end');
  program
    .handler(16 + UART0)
    .load(0, RAM)
    .op(ldr(1, 0), adds(1, 1), str(1, 0), BX_LR);
  const { chip, word } = program.chip();
  chip.runTo(5_000);
  chip.rp.setInterrupt(UART0, true);
  chip.rp.setInterrupt(UART0, false);
  chip.rp.sramView.setUint32(4, 1, true);
  chip.runTo(10_000);
  assert.equal(word(RAM), 1);
});

test('ICPR clears a pending interrupt unless its line is high (DUI 0662)', () => {
  const { chip } = new Program().op(CPSID).label('end').branch('end').chip();
  const { rp } = chip;
  rp.writeUint32(ISPR, (1 << SW0) | (1 << UART0));
  rp.writeUint32(ICPR, (1 << SW0) | (1 << UART0));
  assert.equal(rp.readUint32(ISPR), 0);
  rp.setInterrupt(UART0, true);
  rp.writeUint32(ICPR, 1 << UART0);
  assert.equal(rp.readUint32(ISPR), 1 << UART0);
  rp.setInterrupt(UART0, false);
  rp.writeUint32(ICPR, 1 << UART0);
  assert.equal(rp.readUint32(ISPR), 0);
});

test('WFI under PRIMASK wakes, and the handler runs after CPSIE only (ARMv6-M ARM, Wait For Interrupt)', () => {
  const program = new Program()
    .op(CPSID)
    .poke(ISER, 1 << UART0)
    .op(movs(7, 0), WFI, movs(7, 1))
    .keep(RAM, 7);
  program
    .load(0, RAM + 4)
    .op(ldr(6, 0))
    .keep(RAM + 8, 6)
    .op(CPSIE, NOP)
    .label('end')
    .op(WFI)
    .branch('end');
  program
    .handler(16 + UART0)
    .op(movs(1, 1))
    .keep(RAM + 4, 1)
    .op(BX_LR);
  const { chip, word } = program.chip();
  chip.runTo(5_000);
  assert.equal(word(RAM), 0, 'asleep');
  chip.rp.setInterrupt(UART0, true);
  chip.rp.setInterrupt(UART0, false);
  chip.runTo(10_000);
  assert.equal(word(RAM), 1, 'went on behind WFI');
  assert.equal(word(RAM + 8), 0, 'not entered while masked');
  assert.equal(word(RAM + 4), 1, 'entered after CPSIE');
});

test('a higher priority preempts, an equal one waits (ARMv6-M ARM, exception priorities)', () => {
  // 24 has priority 0x40, 25 and 26 have 0x80: IPR6 holds 24 to 27.
  const program = new Program()
    .poke(IPR6, 0x00808040)
    .poke(ISER, 7 << 24)
    .poke(ISPR, 1 << 25);
  program.label('end').op(WFI).branch('end');
  // 25 pends 24 and 26, then marks itself; 24 and 26 mark themselves. The mark is a running number.
  const mark = (/** @type {number} */ address) =>
    program.load(0, RAM).op(ldr(1, 0), adds(1, 1), str(1, 0)).load(0, address).op(str(1, 0));
  program
    .handler(16 + 25)
    .poke(ISPR, (1 << 24) | (1 << 26))
    .op(NOP, NOP);
  mark(RAM + 4).op(BX_LR);
  program.handler(16 + 24);
  mark(RAM + 8).op(BX_LR);
  program.handler(16 + 26);
  mark(RAM + 12).op(BX_LR);
  const { chip, word } = program.chip();
  chip.runTo(20_000);
  assert.deepEqual([word(RAM + 8), word(RAM + 4), word(RAM + 12)], [1, 2, 3]);
});

test('the stacked frame is aligned to eight bytes, and the return undoes it (ARMv6-M ARM, PushStack())', () => {
  const program = new Program()
    .op(push(1))
    .poke(ISER, (1 << SW0) >>> 0)
    .load(2, 0x12345678);
  // r4 and r5 are the stack pointer before and after.
  program
    .op(0x466c)
    .poke(ISPR, (1 << SW0) >>> 0)
    .op(NOP, 0x466d);
  program
    .keep(RAM + 4, 4)
    .keep(RAM + 8, 5)
    .keep(RAM + 12, 6)
    .label('end')
    .op(WFI)
    .branch('end');
  // r6 is the stacked r2: kept over the return in a register that is not stacked.
  program
    .handler(16 + SW0)
    .op(0x466e, ldr(6, 6, 8))
    .load(0, RAM + 16)
    .op(0x4669, str(1, 0), BX_LR);
  const { chip, word } = program.chip();
  chip.runTo(20_000);
  assert.equal(word(RAM + 4), STACK_TOP - 4);
  assert.equal(word(RAM + 16), (STACK_TOP - 4 - 0x20) & ~7, 'the stack pointer in the handler');
  assert.equal(word(RAM + 12), 0x12345678, 'r2 in its place');
  assert.equal(word(RAM + 8), STACK_TOP - 4);
});

test('VTOR moves the vector table (ARMv6-M ARM, VTOR)', () => {
  const program = new Program()
    .poke(VTOR, RAM + 0x400)
    .poke(ICSR, 1 << 28)
    .label('end')
    .op(WFI)
    .branch('end');
  program.label('moved').op(movs(1, 5)).keep(RAM, 1).op(BX_LR);
  const { chip, word } = program.chip();
  chip.rp.sramView.setUint32(0x400 + 4 * 14, program.address('moved') | 1, true);
  chip.runTo(10_000);
  assert.equal(word(RAM), 5);
});

test('SBCS and ADCS set V of the whole sum (ARMv6-M A2.2.1)', () => {
  // [low a, high a, low b, high b, a < b signed]
  const cases = [
    [0, 0, 0xffffffff, 0x7fffffff, true],
    [0xffffffff, 0x7fffffff, 0, 0, false],
    [0, 0x80000000, 0xffffffff, 0xffffffff, true],
    [5, 0xffffffff, 4, 0xffffffff, false],
    [0xffffffff, 0xffffffff, 0, 0, true],
  ];
  for (const [al, ah, bl, bh, less] of cases) {
    const program = new Program().load(0, +al).load(1, +ah).load(2, +bl).load(3, +bh).op(movs(4, 1));
    // SUBS r0, r0, r2; SBCS r1, r3; BLT keeps r4 = 1.
    program.op(0x1a80, 0x4199).branch('less', 'lt').op(movs(4, 0)).label('less').keep(RAM, 4);
    program.label('end').op(WFI).branch('end');
    const { chip, word } = program.chip();
    chip.runTo(5_000);
    assert.equal(
      word(RAM) === 1,
      less,
      `${ah.toString(16)}:${al.toString(16)} < ${bh.toString(16)}:${bl.toString(16)}`,
    );
  }
  // 0x7fffffff + 0 + carry overflows: V set.
  const program = new Program().op(movs(4, 1), movs(2, 0), 0x43d2, adds(2, 1)).load(0, 0x7fffffff).op(movs(1, 0));
  program.op(0x4148).branch('overflow', 'vs').op(movs(4, 0)).label('overflow').keep(RAM, 4);
  program.label('end').op(WFI).branch('end');
  const { chip, word } = program.chip();
  chip.runTo(5_000);
  assert.equal(word(RAM), 1);
});

test('every fault enters HardFault with its instruction; one within locks up (ARMv6-M ARM, lockup)', () => {
  const bodies = {
    'word read of 0x20000001, which is not aligned': [movs(2, 1), 0x5881],
    'breakpoint or undefined instruction': [NOP, 0xde00],
    'where nothing is': [NOP, ldr(3, 4)],
  };
  for (const [detail, [first, second]] of Object.entries(bodies)) {
    const program = new Program().load(0, RAM).load(4, 0x30000000).op(first).label('fault').op(second, NOP);
    program
      .handler(3)
      .load(0, STACK_TOP - 8)
      .op(ldr(1, 0))
      .keep(RAM + 16, 1)
      .op(0xde00);
    const { chip, events, word } = program.chip();
    chip.runTo(10_000);
    assert.equal(events.length, 2, JSON.stringify(events));
    assert.match(events[0].detail, new RegExp(detail));
    assert.equal(word(RAM + 16), program.address('fault'), 'stacked PC');
    assert.match(events[1].detail, /^lockup/);
  }
});

test('AIRCR.SYSRESETREQ restarts the chip with its RAM kept (ARMv6-M ARM, AIRCR)', () => {
  const program = new Program().load(0, RAM).op(ldr(1, 0), adds(1, 1), str(1, 0), cmp(1, 3)).branch('end', 'cs');
  program.poke(VTOR, RAM).poke(AIRCR, 0x05fa0004).label('end').op(WFI).branch('end');
  const { chip, events, word } = program.chip();
  chip.runTo(200_000);
  assert.equal(word(RAM), 3);
  assert.deepEqual(
    events.map((e) => e.event),
    ['reset', 'reset'],
  );
  assert.equal(chip.rp.core.VTOR, 0x10000100);
});

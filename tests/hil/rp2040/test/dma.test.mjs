// The DMA controller against RP2040 datasheet 2.5, and the receive and transmit paths that firmware builds from it.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { ISSUE_CYCLES } from '../src/dma.mjs';
import { adds, BX_LR, idle, ldr, Program, RAM, str, WFI } from './program.mjs';

const DMA = 0x50000000;
const READ = 0x00;
const WRITE = 0x04;
const COUNT = 0x08;
const CTRL_TRIG = 0x0c;
const AL1_CTRL = 0x10;
const AL3_READ_TRIG = 0x3c;
const INTR = DMA + 0x400;
const INTE0 = DMA + 0x404;
const INTS0 = DMA + 0x40c;
const INTS1 = DMA + 0x41c;
const INTE1 = DMA + 0x414;
const TIMER0 = DMA + 0x420;
const MULTI = DMA + 0x430;
const ABORT = DMA + 0x444;
const UART = 0x40034000;
const UARTDMACR = UART + 0x48;
const TIMERAWL = 0x40054028;
const PWM = 0x40050000;

const EN = 1;
const HIGH_PRIORITY = 1 << 1;
const WORD = 2 << 2;
const HALF = 1 << 2;
const INCR_READ = 1 << 4;
const INCR_WRITE = 1 << 5;
const RING_WRITE = 1 << 10;
const QUIET = 1 << 21;
const BSWAP = 1 << 22;
const BUSY = 1 << 24;
const treq = (/** @type {number} */ n) => n << 15;
const chain = (/** @type {number} */ n) => n << 11;
const ring = (/** @type {number} */ bits) => bits << 6;
const ALWAYS = treq(0x3f);
const UART0_TX = treq(20);
const UART0_RX = treq(21);
const BIT_NS = (16 * (2 + 39 / 64) * 1e9) / 125e6;
const CYCLE_NS = 8;

/** @param {import('../src/chip.mjs').Chip} chip */
function access(chip) {
  const { rp } = chip;
  const write = (/** @type {number} */ address, /** @type {number} */ value) => rp.writeUint32(address, value >>> 0);
  const read = (/** @type {number} */ address) => rp.readUint32(address);
  /** Sets a channel up without a trigger. */
  const channel = (/** @type {number} */ n, /** @type {number[]} */ [from, to, count, ctrl]) => {
    const base = DMA + 0x40 * n;
    write(base + READ, from);
    write(base + WRITE, to);
    write(base + COUNT, count);
    write(base + AL1_CTRL, ctrl);
  };
  const uart = () => {
    write(UART + 0x24, 2);
    write(UART + 0x28, 39);
    write(UART + 0x2c, 0x70);
    write(UART + 0x30, 0x301);
    write(UARTDMACR, 3);
    return chip.uarts[0];
  };
  return {
    write,
    read,
    channel,
    uart,
    sram: rp.sram,
    word: (/** @type {number} */ a) => rp.sramView.getUint32(a - RAM, true),
  };
}

function open() {
  const { chip, events } = idle().chip();
  chip.runTo(1_000);
  return { chip, events, ...access(chip) };
}

/** @param {number} data @param {number} bitNs */
const frame = (data, bitNs) => ({ data, startNs: 0, bitNs, bits: 10, isBreak: false });

test('an unpaced copy of words ends with its interrupt, after a few cycles a transfer', () => {
  const { chip, channel, read, sram, write } = open();
  for (let i = 0; i < 64; i++) sram[i] = i;
  write(INTE0, 1 << 2);
  channel(2, [RAM, RAM + 0x100, 16, EN | WORD | INCR_READ | INCR_WRITE | ALWAYS | chain(2)]);
  const start = chip.clock.nanos;
  write(MULTI, 1 << 2);
  assert.equal(read(DMA + 0x80 + CTRL_TRIG) & BUSY, BUSY);
  // One access a cycle once the first has been issued.
  chip.clock.advanceTo(start + (ISSUE_CYCLES + 15) * CYCLE_NS);
  assert.equal(read(INTR), 0);
  chip.clock.advanceTo(start + (ISSUE_CYCLES + 16) * CYCLE_NS);
  assert.deepEqual(
    [...sram.subarray(0x100, 0x140)],
    Array.from({ length: 64 }, (_, i) => i),
  );
  assert.equal(read(INTS0), 1 << 2);
  assert.equal(read(DMA + 0x80 + CTRL_TRIG) & BUSY, 0);
  assert.deepEqual(
    [read(DMA + 0x80 + READ), read(DMA + 0x80 + WRITE), read(DMA + 0x80 + COUNT)],
    [RAM + 64, RAM + 0x140, 0],
  );
  write(INTS0, 1 << 2);
  assert.equal(read(INTR), 0);
});

test('byte swap works on halfwords and words (datasheet 2.5, CTRL.BSWAP)', () => {
  const { chip, channel, sram, write } = open();
  sram.set([1, 2, 3, 4]);
  channel(0, [RAM, RAM + 16, 1, EN | WORD | BSWAP | ALWAYS]);
  channel(1, [RAM, RAM + 32, 2, EN | HALF | BSWAP | INCR_READ | INCR_WRITE | ALWAYS | chain(1)]);
  write(MULTI, 3);
  chip.runTo(5_000);
  assert.deepEqual([...sram.subarray(16, 20)], [4, 3, 2, 1]);
  assert.deepEqual([...sram.subarray(32, 36)], [2, 1, 4, 3]);
});

test('a null trigger raises the interrupt of a quiet channel and starts nothing (datasheet 2.5, triggers)', () => {
  const { channel, read, write } = open();
  channel(4, [RAM, RAM, 1, EN | QUIET | ALWAYS | chain(4)]);
  write(DMA + 0x100 + AL3_READ_TRIG, 0);
  assert.equal(read(INTR), 1 << 4);
  assert.equal(read(DMA + 0x100 + CTRL_TRIG) & BUSY, 0);
});

test('abort ends a transfer without an interrupt (datasheet 2.5)', () => {
  const { chip, channel, read, word, write } = open();
  channel(0, [RAM, RAM + 64, 1000, EN | WORD | INCR_WRITE | ALWAYS]);
  write(MULTI, 1);
  chip.clock.advanceTo(chip.clock.nanos + 100 * CYCLE_NS);
  write(ABORT, 1);
  const left = read(DMA + COUNT);
  assert.ok(left > 0 && left < 1000);
  chip.runTo(50_000);
  assert.equal(read(DMA + COUNT), left);
  assert.equal(read(INTR), 0);
  assert.equal(word(RAM), 0);
});

test('a pacing timer spaces transfers by Y / X cycles (datasheet 2.5)', () => {
  const { chip, channel, read, write } = open();
  write(TIMER0, (1 << 16) | 125);
  channel(0, [RAM, RAM + 64, 10, EN | treq(0x3b)]);
  const start = chip.clock.nanos;
  write(MULTI, 1);
  // One transfer a microsecond: ten are done after ten and a little, not before.
  chip.clock.advanceTo(start + 9_900);
  assert.equal(read(DMA + COUNT), 1);
  chip.clock.advanceTo(start + 10_100);
  assert.equal(read(INTR), 1);
});

test('a PWM wrap is one request', () => {
  const { chip, channel, read, write } = open();
  write(PWM + 0x10, 1249);
  channel(0, [RAM, RAM + 64, 5, EN | treq(24)]);
  write(MULTI, 1);
  write(PWM, 1);
  chip.clock.advanceTo(chip.clock.nanos + 45_000);
  assert.equal(read(DMA + COUNT), 1, 'four wraps of 10 us');
  assert.equal(read(INTR), 0);
  chip.clock.advanceTo(chip.clock.nanos + 10_000);
  assert.equal(read(INTR), 1);
});

test('a bus error stops the channel and is kept until it is cleared (datasheet 2.5, CTRL.AHB_ERROR)', () => {
  const { chip, channel, events, read, write } = open();
  channel(0, [0x30000000, RAM, 1, EN | WORD | ALWAYS]);
  write(MULTI, 1);
  chip.runTo(5_000);
  assert.equal(read(DMA + CTRL_TRIG) >>> 29, 0b110, 'AHB_ERROR and READ_ERROR');
  assert.equal(read(DMA + CTRL_TRIG) & BUSY, 0);
  assert.match(events[0].detail, /^DMA: read of 0x30000000/);
  write(DMA + AL1_CTRL, 3 << 29);
  assert.equal(read(DMA + CTRL_TRIG) >>> 29, 0);
});

/** The receive path: a byte from the UART into a ring of 64, then a stamp into a ring of 64 words, and so on. */
function receivePath(
  /** @type {ReturnType<typeof access>} */ { channel, uart, write },
  /** @type {number} */ stampFrom,
) {
  uart();
  const bytes = RAM + 0x400;
  const stamps = RAM + 0x800;
  channel(1, [stampFrom, stamps, 1, EN | WORD | INCR_WRITE | RING_WRITE | ring(8) | ALWAYS | chain(0) | QUIET]);
  channel(0, [UART, bytes, 1, EN | INCR_WRITE | RING_WRITE | ring(6) | UART0_RX | chain(1)]);
  write(INTE1, 1);
  write(MULTI, 1);
  return { bytes, stamps };
}

test('receive: byte into a ring, stamp into another, chained both ways, an interrupt a byte', () => {
  const opened = open();
  const { chip, read, sram, word, write } = opened;
  const { bytes, stamps } = receivePath(opened, TIMERAWL);
  const { uart } = { uart: chip.uarts[0] };
  const at = [];
  // 150 characters back to back: the byte ring goes round twice and the stamp ring too.
  for (let i = 0; i < 150; i++) {
    chip.clock.advanceTo(chip.clock.nanos + 10 * BIT_NS);
    uart.receive(frame(i, uart.bitNs));
    at.push(chip.clock.nanos);
    // Byte: issue, read over APB 3; stamp: issue, read over APB 3. Then everything is done.
    chip.clock.advanceTo(chip.clock.nanos + 2 * (ISSUE_CYCLES + 3) * CYCLE_NS);
    assert.equal(uart.rx.length, 0, 'drained byte by byte');
    assert.equal(read(INTS1), 1);
    write(INTS1, 1);
  }
  for (let i = 86; i < 150; i++) {
    assert.equal(sram[bytes - RAM + (i % 64)], i);
    // The stamp is taken within twelve cycles: 96 ns, so that it differs by one count at most.
    const late = word(stamps + 4 * (i % 64)) - Math.floor(at[i] / 1000);
    assert.ok(late === 0 || late === 1, `stamp ${i} is ${late} us late`);
  }
  assert.equal(chip.counters[0].overruns, 0);
  assert.ok(chip.counters[0].rxWaitNsMax <= (ISSUE_CYCLES + 3) * CYCLE_NS + 1e-6);
});

test('receive: the stamp may be a PWM counter, in cycles', () => {
  const opened = open();
  const { chip, word, write } = opened;
  write(PWM + 0x10, 0xffff);
  write(PWM, 1);
  const zero = chip.clock.nanos;
  const { stamps } = receivePath(opened, PWM + 0x08);
  const uart = chip.uarts[0];
  chip.clock.advanceTo(zero + 1000 * CYCLE_NS);
  uart.receive(frame(1, uart.bitNs));
  chip.clock.advanceTo(zero + 2000 * CYCLE_NS);
  assert.equal(word(stamps), 1000 + 2 * (ISSUE_CYCLES + 3));
});

test('receive: a chain of three stamps each byte to a sixteenth of a microsecond, as the Pico image has it', () => {
  const opened = open();
  const { channel, chip, read, sram, uart: setUp, word, write } = opened;
  const uart = setUp();
  const fine = PWM + 7 * 0x14;
  // The slice goes with TIMER: sixteen counts a microsecond, from an edge of it on.
  chip.clock.advanceTo(Math.ceil(chip.clock.nanos / 1000) * 1000);
  write(fine + 0x04, 125);
  write(fine + 0x08, (read(TIMERAWL) * 16) & 0xffff);
  write(fine, 1);
  const [bytes, counts, stamps] = [RAM + 0x400, RAM + 0x600, RAM + 0x800];
  const into = (/** @type {number} */ bits) => EN | HIGH_PRIORITY | INCR_WRITE | RING_WRITE | ring(bits);
  channel(1, [TIMERAWL, stamps, 1, into(8) | WORD | ALWAYS | chain(0) | QUIET]);
  channel(6, [fine + 0x08, counts, 1, into(6) | ALWAYS | chain(1) | QUIET]);
  channel(0, [UART, bytes, 1, into(6) | UART0_RX | chain(6)]);
  write(MULTI, 1);
  // Both transmitters' channels are busy beside it: they give way but for the transfer under way, 8 cycles at most.
  channel(4, [RAM, RAM + 0x4000, 0xffffffff, EN | WORD | ALWAYS | chain(4)]);
  channel(5, [TIMERAWL, RAM + 0x4004, 0xffffffff, EN | WORD | ALWAYS | chain(5)]);
  write(MULTI, 0b110000);
  let [least, most] = [Infinity, -Infinity];
  for (let i = 0; i < 64; i++) {
    // A step that meets every part of a microsecond.
    chip.clock.advanceTo(chip.clock.nanos + 10 * BIT_NS + 17.3);
    const cameNs = chip.clock.nanos;
    uart.receive(frame(i, uart.bitNs));
    chip.clock.advanceTo(cameNs + 60 * CYCLE_NS);
    const us = word(stamps + 4 * i);
    const past = ((sram[counts - RAM + i] - us * 16) << 24) >> 24;
    const late = (us * 16 + past) * 62.5 - cameNs;
    [least, most] = [Math.min(least, late), Math.max(most, late)];
    assert.equal(sram[bytes - RAM + i], i);
  }
  const own = 2 * (ISSUE_CYCLES + 3) * CYCLE_NS;
  // Less by an incomplete count and by the divisor's carry, less than a cycle; more by two transfers under way.
  assert.ok(least > own - 62.5 - CYCLE_NS && most < own + 2 * 8 * CYCLE_NS, `${least} to ${most} ns`);
});

test('receive: bytes that waited in the FIFO come out in order with a stamp each', () => {
  const opened = open();
  const { chip, sram, word, write } = opened;
  const uart = opened.uart();
  for (let i = 0; i < 8; i++) uart.receive(frame(0x30 + i, uart.bitNs));
  const { bytes, stamps } = receivePath(opened, TIMERAWL);
  chip.clock.advanceTo(chip.clock.nanos + 8 * 2 * (ISSUE_CYCLES + 3) * CYCLE_NS);
  assert.deepEqual([...sram.subarray(bytes - RAM, bytes - RAM + 8)], [0x30, 0x31, 0x32, 0x33, 0x34, 0x35, 0x36, 0x37]);
  assert.ok(word(stamps + 28) > 0);
  write(UARTDMACR, 0);
});

test('receive: the interrupt wakes a sleeping core for each byte', () => {
  const program = new Program()
    .poke(0xe000e100, 1 << 12)
    .label('end')
    .op(WFI)
    .branch('end');
  program
    .handler(16 + 12)
    .poke(INTS1, 1)
    .load(0, RAM)
    .op(ldr(1, 0), adds(1, 1), str(1, 0), BX_LR);
  const { chip, word } = program.chip();
  chip.runTo(2_000);
  const opened = access(chip);
  receivePath(opened, TIMERAWL);
  const uart = chip.uarts[0];
  chip.profile.reset(chip.clock.nanos);
  for (let i = 0; i < 20; i++) {
    uart.receive(frame(i, uart.bitNs));
    chip.runTo(chip.now + 10 * BIT_NS);
  }
  assert.equal(word(RAM), 20);
  const { sleep_cycles: sleep, cycles } = chip.report();
  assert.ok(sleep > cycles / 2, `asleep in ${sleep} of ${cycles} cycles`);
});

test('transmit: memory to UARTDR at the pace of the line, then the interrupt', () => {
  const { chip, channel, read, sram, uart: setUp, write } = open();
  const uart = setUp();
  /** @type {import('../src/pl011.mjs').Frame[]} */
  const frames = [];
  uart.onFrame = (f) => frames.push(f);
  const data = Array.from({ length: 100 }, (_, i) => (i * 37) & 0xff);
  sram.set(data, 0x200);
  write(INTE0, 1 << 5);
  channel(5, [RAM + 0x200, UART, 100, EN | INCR_READ | UART0_TX | chain(5)]);
  const start = chip.clock.nanos;
  write(MULTI, 1 << 5);
  // 67 characters must have left before the last finds room in the FIFO of 32: 32 behind the one in the shifter.
  chip.clock.advanceTo(start + 66 * 10 * BIT_NS);
  assert.equal(read(INTS0), 0);
  chip.clock.advanceTo(start + 68 * 10 * BIT_NS);
  assert.equal(read(INTS0), 1 << 5);
  chip.clock.advanceTo(start + 102 * 10 * BIT_NS);
  assert.deepEqual(
    frames.map((f) => f.data),
    data,
  );
  for (let i = 1; i < 100; i++) {
    assert.ok(Math.abs(frames[i].startNs - frames[i - 1].startNs - 10 * BIT_NS) < 1e-6, 'without a gap');
  }
});

test('interrupts of both lines are masked and forced apart (datasheet 2.5, interrupts)', () => {
  const { chip, channel, read, write } = open();
  channel(0, [RAM, RAM + 4, 1, EN | ALWAYS]);
  channel(1, [RAM, RAM + 4, 1, EN | ALWAYS | chain(1)]);
  write(INTE0, 1);
  write(INTE1, 2);
  write(MULTI, 3);
  chip.runTo(5_000);
  assert.deepEqual([read(INTR), read(INTS0), read(INTS1)], [3, 1, 2]);
  const { exceptions } = chip.machine;
  assert.equal((exceptions.lines >>> 11) & 3, 3);
  write(INTR, 3);
  assert.equal((exceptions.lines >>> 11) & 3, 0);
  write(DMA + 0x418, 4);
  assert.equal((exceptions.lines >>> 11) & 3, 2);
});

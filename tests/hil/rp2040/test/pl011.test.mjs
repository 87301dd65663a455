// The UART against RP2040 datasheet 4.2 and the PL011 manual (DDI 0183).
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { sample } from '../src/pl011.mjs';
import { idle } from './program.mjs';

const UART = 0x40034000;
const DR = UART;
const RSR = UART + 0x04;
const FR = UART + 0x18;
const IBRD = UART + 0x24;
const FBRD = UART + 0x28;
const LCR_H = UART + 0x2c;
const CR = UART + 0x30;
const IFLS = UART + 0x34;
const IMSC = UART + 0x38;
const RIS = UART + 0x3c;
const ICR = UART + 0x44;
const DMACR = UART + 0x48;

const FR_BUSY = 0x08;
const FR_RXFE = 0x10;
const FR_TXFF = 0x20;
const FR_RXFF = 0x40;
const FR_TXFE = 0x80;
const RX = 0x10;
const TX = 0x20;
const RT = 0x40;
const FE = 0x80;
const BE = 0x200;
const OE = 0x400;
const EIGHT_BITS = 0x60;
const FEN = 0x10;
const BRK = 0x01;

/** A chip whose UART0 runs at 125 MHz / (16 * (2 + 39/64)), 2.994 Mbaud; `line` is LCR_H. */
function open(line = EIGHT_BITS | FEN) {
  const { chip } = idle().chip();
  const { rp } = chip;
  const write = (/** @type {number} */ address, /** @type {number} */ value) => rp.writeUint32(address, value);
  const read = (/** @type {number} */ address) => rp.readUint32(address);
  write(IBRD, 2);
  write(FBRD, 39);
  write(LCR_H, line);
  write(CR, 0x301);
  const uart = chip.uarts[0];
  /** @type {import('../src/pl011.mjs').Frame[]} */
  const frames = [];
  uart.onFrame = (frame) => frames.push(frame);
  const feed = (/** @type {number} */ data, isBreak = false) =>
    uart.receive({ data, startNs: 0, bitNs: uart.bitNs, bits: 10, isBreak });
  return { chip, rp, uart, frames, write, read, feed };
}

const BIT_NS = (16 * (2 + 39 / 64) * 1e9) / 125e6;

test('a character lasts ten bits of 16 * (IBRD + FBRD / 64) peripheral clocks (datasheet 4.2)', () => {
  const { chip, frames, write } = open();
  for (const byte of [0x55, 0xaa, 0x0f]) write(DR, byte);
  chip.runTo(100_000);
  assert.deepEqual(
    frames.map((f) => f.data),
    [0x55, 0xaa, 0x0f],
  );
  assert.ok(Math.abs(frames[0].bitNs - BIT_NS) < 1e-9);
  for (let i = 1; i < 3; i++) assert.ok(Math.abs(frames[i].startNs - frames[i - 1].startNs - 10 * BIT_NS) < 1e-6);
});

test('word length, parity and stop bits lengthen the character (datasheet 4.2, UARTLCR_H)', () => {
  const bits = (/** @type {number} */ line) => open(line).uart.frameBits;
  assert.equal(bits(EIGHT_BITS), 10);
  assert.equal(bits(EIGHT_BITS | 0x02), 11);
  assert.equal(bits(EIGHT_BITS | 0x02 | 0x08), 12);
  assert.equal(bits(0x00), 7);
});

test('the divisor takes effect with the next write of UARTLCR_H (datasheet 4.2, UARTIBRD)', () => {
  const { uart, write } = open();
  write(IBRD, 67);
  write(FBRD, 52);
  assert.ok(Math.abs(uart.bitNs - BIT_NS) < 1e-9);
  write(LCR_H, EIGHT_BITS | FEN);
  assert.ok(Math.abs(1e9 / uart.bitNs - 115_200) < 12);
});

test('with FIFOs 32 characters wait behind the shifter, without them one (datasheet 4.2, UARTLCR_H.FEN)', () => {
  for (const [line, depth] of [
    [EIGHT_BITS | FEN, 32],
    [EIGHT_BITS, 1],
  ]) {
    const { chip, frames, read, write } = open(line);
    assert.equal(read(FR), FR_TXFE | FR_RXFE);
    for (let i = 0; i < depth; i++) write(DR, i);
    assert.equal(read(FR) & FR_TXFF, 0, 'the shifter holds one more');
    write(DR, depth);
    assert.equal(read(FR) & (FR_TXFF | FR_BUSY | FR_TXFE), FR_TXFF | FR_BUSY);
    write(DR, 0xff);
    chip.runTo(1e6);
    assert.deepEqual(
      frames.map((f) => f.data),
      Array.from({ length: depth + 1 }, (_, i) => i),
      'a full FIFO takes nothing',
    );
    assert.equal(read(FR), FR_TXFE | FR_RXFE);
  }
});

test('the receive interrupt comes at the level of UARTIFLS and goes below it (datasheet 4.2, UARTRXINTR)', () => {
  for (const [select, level] of [
    [0, 4],
    [1, 8],
    [2, 16],
    [3, 24],
    [4, 28],
  ]) {
    const { feed, read, write } = open();
    write(IFLS, select << 3);
    for (let i = 0; i < level - 1; i++) feed(i);
    assert.equal(read(RIS) & RX, 0, `below ${level}`);
    feed(0);
    assert.equal(read(RIS) & RX, RX, `at ${level}`);
    read(DR);
    assert.equal(read(RIS) & RX, 0, 'below again');
  }
});

test('without FIFOs every character raises the receive interrupt', () => {
  const { feed, read } = open(EIGHT_BITS);
  feed(7);
  assert.equal(read(RIS) & RX, RX);
  assert.equal(read(FR) & FR_RXFF, FR_RXFF);
  assert.equal(read(DR), 7);
  assert.equal(read(RIS) & RX, 0);
});

test('the transmit interrupt comes when the FIFO falls to its level, not before anything was sent', () => {
  const { chip, read, write } = open();
  write(IFLS, 0);
  chip.runTo(1_000);
  assert.equal(read(RIS) & TX, 0);
  for (let i = 0; i < 8; i++) write(DR, i);
  // One is shifted out, seven wait; three characters later four are left.
  chip.runTo(1_000 + 29 * BIT_NS);
  assert.equal(read(RIS) & TX, 0);
  chip.runTo(1_000 + 31 * BIT_NS);
  assert.equal(read(RIS) & TX, TX);
  write(ICR, TX);
  assert.equal(read(RIS) & TX, 0);
  chip.runTo(1e6);
  assert.equal(read(RIS) & TX, 0, 'cleared, and not raised again further down');
});

test('the receive time-out comes 32 bits after the last character, and goes when the FIFO is empty', () => {
  const { chip, feed, read } = open();
  feed(1);
  chip.runTo(20 * BIT_NS);
  feed(2);
  chip.runTo(51 * BIT_NS);
  assert.equal(read(RIS) & RT, 0, 'the second character restarts it');
  chip.runTo(53 * BIT_NS);
  assert.equal(read(RIS) & RT, RT);
  read(DR);
  assert.equal(read(RIS) & RT, RT);
  read(DR);
  assert.equal(read(RIS) & RT, 0);
});

test('a full FIFO keeps its characters; OE comes with the first that finds room (PL011 manual, overrun bit)', () => {
  const { chip, feed, read, write } = open();
  for (let i = 0; i < 34; i++) feed(i);
  assert.equal(read(RIS) & OE, OE);
  assert.equal(chip.counters[0].overruns, 2);
  for (let i = 0; i < 32; i++) assert.equal(read(DR), i);
  assert.equal(read(FR) & FR_RXFE, FR_RXFE);
  feed(0x42);
  assert.equal(read(DR), 0x842);
  feed(0x43);
  assert.equal(read(DR), 0x43);
  write(ICR, OE);
  assert.equal(read(RIS) & OE, 0);
});

test('a break reads as zero with BE and FE, a wrong stop bit as FE; writing UARTRSR clears it', () => {
  const { uart, feed, read, write } = open();
  feed(0, true);
  assert.equal(read(RIS) & (BE | FE), BE | FE);
  assert.equal(read(DR), 0x500);
  assert.equal(read(RSR), 0x05);
  write(RSR, 0);
  assert.equal(read(RSR), 0);
  // A sender at half the rate: the stop bit is sampled in the fourth data bit.
  uart.receive({ data: 0x00, startNs: 0, bitNs: 2 * uart.bitNs, bits: 10, isBreak: false });
  assert.equal(read(DR) & 0x100, 0x100);
});

test('a receiver samples in the middle of its own bits: up to 4 % off is read right, 7 % is not', () => {
  const frame = { data: 0xa5, startNs: 0, bitNs: 100, bits: 10, isBreak: false };
  for (const off of [-4.5, -2, 0, 2, 4.5]) assert.equal(sample(frame, 100 + off, 8), 0xa5, `${off} %`);
  for (const off of [-7, 7]) assert.notEqual(sample(frame, 100 + off, 8), 0xa5, `${off} %`);
});

test('UARTLCR_H.BRK sends one break, and characters after it', () => {
  const { chip, frames, write } = open();
  write(LCR_H, EIGHT_BITS | FEN | BRK);
  chip.runTo(20_000);
  write(LCR_H, EIGHT_BITS | FEN);
  write(DR, 0x31);
  chip.runTo(40_000);
  assert.deepEqual(
    frames.map((f) => [f.data, f.isBreak]),
    [
      [0, true],
      [0x31, false],
    ],
  );
});

test('the interrupt line is UARTRIS under UARTIMSC', () => {
  const { chip, feed, read, write } = open(EIGHT_BITS);
  const pended = () => (read(0xe000e200) >>> 20) & 1;
  feed(1);
  assert.equal(pended(), 0);
  write(IMSC, RX);
  assert.equal(pended(), 1);
  assert.equal(chip.machine.exceptions.lines >>> 20, 1);
  read(DR);
  assert.equal(chip.machine.exceptions.lines, 0);
});

test('requests follow the FIFOs while UARTDMACR enables them (datasheet 4.2, UARTDMACR)', () => {
  const { chip, feed, read, write } = open();
  const { dreq } = chip.machine.dma;
  write(DMACR, 3);
  assert.deepEqual([dreq[20], dreq[21]], [true, false], 'room to send, nothing received');
  feed(1);
  assert.equal(dreq[21], true);
  read(DR);
  assert.equal(dreq[21], false);
  for (let i = 0; i < 33; i++) write(DR, i);
  assert.equal(dreq[20], false);
  chip.runTo(12 * BIT_NS);
  assert.equal(dreq[20], true);
  write(DMACR, 0);
  assert.equal(dreq[20], false);
});

test('nothing is received or sent while the UART is off, and RESETS clears it (datasheet 2.14)', () => {
  const { chip, frames, feed, read, write } = open();
  write(CR, 0);
  feed(1);
  write(DR, 2);
  chip.runTo(10_000);
  assert.equal(read(FR) & FR_RXFE, FR_RXFE);
  assert.equal(frames.length, 0);
  write(0x4000c000, 1 << 22);
  write(0x4000c000, 0);
  assert.deepEqual([read(IBRD), read(LCR_H), read(CR), read(IFLS)], [0, 0, 0x300, 0x12]);
});

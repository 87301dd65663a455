// The boot ROM, the flash behind it and execute-in-place. RP2040 datasheet 2.8, 2.6.3, 4.10; W25Q16JV datasheet.
import assert from 'node:assert/strict';
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { test } from 'node:test';
import { Flash, FLASH_BYTES } from '../src/flash.mjs';
import { adds, BX_LR, CPSID, idle, ldr, movs, Program, RAM, str, WFI } from './program.mjs';

const CODE = RAM + 0x1000;
const SSI = 0x18000000;
const blx = (/** @type {number} */ rm) => 0x4780 | (rm << 3);
const ldrh = (/** @type {number} */ rt, /** @type {number} */ rn) => 0x8800 | (rn << 3) | rt;
const mov = (/** @type {number} */ rd, /** @type {number} */ rm) => (rm << 3) | rd;

/** Looks a code up as rp2040-hal does; the function's address is in r0 then. Uses r0 to r3. */
const lookup = (/** @type {Program} */ program, /** @type {string} */ code, table = 0x14) =>
  program
    .op(movs(0, table), ldrh(0, 0))
    .load(1, code.charCodeAt(0) | (code.charCodeAt(1) << 8))
    .op(movs(3, 0x18), ldrh(3, 3), blx(3));

/** Calls a ROM function. @param {Program} program @param {string} code @param {number[]} parameters */
function call(program, code, ...parameters) {
  lookup(program, code).op(mov(4, 0));
  parameters.forEach((value, i) => program.load(i, value));
  return program.op(blx(4));
}

const finish = (/** @type {Program} */ program) =>
  program
    .poke(RAM + 0x40, 1)
    .label('end')
    .op(WFI)
    .branch('end');

test('the ROM has its magic, version and tables where the datasheet says (2.8.3)', () => {
  const { chip } = idle().chip();
  assert.deepEqual(
    [0x10, 0x11, 0x12].map((a) => chip.rp.readUint8(a)),
    [0x4d, 0x75, 1],
  );
  assert.ok(chip.rp.readUint8(0x13) >= 1);
});

test('rom_table_lookup finds what there is and returns 0 for what is not (2.8.3)', () => {
  const program = new Program();
  lookup(program, 'RE').op(mov(5, 0)).keep(RAM, 5);
  lookup(program, 'zz')
    .op(mov(5, 0))
    .keep(RAM + 4, 5);
  lookup(program, 'SF', 0x16)
    .op(mov(5, 0))
    .keep(RAM + 8, 5);
  const { chip, events, word } = finish(program).chip();
  chip.rp.sramView.setUint32(4, 7, true);
  chip.rp.sramView.setUint32(8, 7, true);
  chip.runTo(20_000);
  assert.deepEqual(events, []);
  assert.equal(word(RAM) & 1, 1, 'a Thumb function');
  assert.ok(word(RAM) < 0x4000);
  assert.deepEqual([word(RAM + 4), word(RAM + 8), word(RAM + 0x40)], [0, 0, 1]);
});

test('memory and bit functions do their work', () => {
  const program = new Program();
  call(program, 'C4', RAM + 0x100, RAM + 0x80, 8);
  call(program, 'MS', RAM + 0x110, 0xab, 3);
  for (const [i, [code, value]] of Object.entries([
    ['P3', 0xf0f00001],
    ['L3', 0x00010000],
    ['T3', 0x00010000],
    ['R3', 1],
  ])) {
    call(program, String(code), Number(value))
      .op(mov(5, 0))
      .keep(RAM + 4 * Number(i), 5);
  }
  const { chip, word } = finish(program).chip();
  chip.sram.set([1, 2, 3, 4, 5, 6, 7, 8], 0x80);
  chip.runTo(50_000);
  assert.deepEqual([...chip.sram.subarray(0x100, 0x108)], [1, 2, 3, 4, 5, 6, 7, 8]);
  assert.deepEqual([...chip.sram.subarray(0x110, 0x114)], [0xab, 0xab, 0xab, 0]);
  assert.deepEqual(
    [0, 4, 8, 12].map((o) => word(RAM + o)),
    [9, 15, 16, 0x80000000],
  );
});

/** A program in RAM that erases `count` bytes at 1 MiB and programs a page from RAM + 0x200. */
function rewrite(/** @type {Program} */ program, count = 4096, block = 0x80000000, command = 0) {
  for (const code of ['IF', 'EX']) call(program, code);
  call(program, 'RE', 0x100000, count, block, command);
  program.poke(RAM + 0x44, 1);
  call(program, 'RP', 0x100000, RAM + 0x200, 256);
  for (const code of ['FC', 'CX']) call(program, code);
  program
    .load(2, 0x10100000)
    .op(ldr(2, 2))
    .keep(RAM + 0x48, 2);
  return finish(program);
}

test('erase takes 45 ms a sector, programming 0.4 ms a page, and programming only clears bits', () => {
  const { chip, events, word } = rewrite(new Program(CODE).op(CPSID)).chip();
  chip.flash.array.fill(0, 0x100000, 0x102000);
  chip.sram.set([0x12, 0x34, 0x56, 0x78], 0x200);
  chip.runTo(44.9e6);
  assert.equal(word(RAM + 0x44), 0, 'still erasing');
  assert.equal(chip.flash.array[0x100000], 0);
  chip.runTo(45.1e6);
  assert.equal(word(RAM + 0x44), 1);
  chip.runTo(45.38e6);
  assert.equal(word(RAM + 0x40), 0, 'still programming');
  assert.equal(chip.report().sleep_cycles, 0, 'waiting in the ROM is not sleep');
  chip.runTo(45.5e6);
  assert.deepEqual(events, []);
  assert.equal(word(RAM + 0x40), 1);
  assert.equal(word(RAM + 0x48), 0x78563412, 'read back through XIP');
  assert.equal(chip.flash.array[0x100fff], 0xff);
  assert.equal(chip.flash.array[0x101000], 0, 'the next sector is as it was');
  // Programming again without an erase: bits can only go to 0.
  chip.flash.programSteps(0x100000, new Uint8Array(256).fill(0xf0)).forEach((step) => step.apply());
  assert.deepEqual([...chip.flash.array.subarray(0x100000, 0x100004)], [0x10, 0x30, 0x50, 0x70]);
});

test('a 64 KiB block takes 150 ms where the caller allows block erase', () => {
  const { chip, word } = rewrite(new Program(CODE).op(CPSID), 0x11000, 0x10000, 0xd8).chip();
  chip.runTo(194.9e6);
  assert.equal(word(RAM + 0x44), 0, 'one block and one sector: 195 ms');
  chip.runTo(195.1e6);
  assert.equal(word(RAM + 0x44), 1);
});

test('interrupts are taken during an erase if their code is in RAM', () => {
  // TIMER alarm 0 each millisecond: the handler acknowledges, counts and sets the next.
  const timer = 0x40054000;
  const program = new Program(CODE)
    .poke(timer + 0x38, 1)
    .poke(timer + 0x10, 1000)
    .poke(0xe000ed08, RAM + 0x2000);
  program.poke(0xe000e100, 1);
  rewrite(program);
  program
    .handler(16)
    .poke(timer + 0x34, 1)
    .load(0, RAM)
    .op(ldr(1, 0), adds(1, 1), str(1, 0));
  program
    .load(0, timer + 0x10)
    .op(ldr(1, 0))
    .load(2, 1000)
    .op(0x1889, str(1, 0), BX_LR);
  const { chip, events, word } = program.chip();
  chip.rp.sramView.setUint32(0x2000 + 4 * 16, program.address('exception 16') | 1, true);
  chip.runTo(45.02e6);
  assert.deepEqual(events, []);
  assert.equal(word(RAM), 45);
  chip.runTo(46e6);
  assert.equal(word(RAM + 0x40), 1);
});

test('while XIP is off a fetch or a read of flash is a fault with its PC and address', () => {
  const read = new Program(CODE).op(CPSID);
  call(read, 'EX').load(2, 0x10000100).label('read').op(ldr(3, 2)).label('end').branch('end');
  const { chip, events } = read.chip();
  chip.runTo(20_000);
  assert.match(events[0].detail, /^read of 0x10000100 while the flash is not in XIP mode/);
  assert.match(events[0].detail, new RegExp(`PC 0x${read.address('read').toString(16)}`));

  const fetch = new Program();
  call(fetch, 'EX').label('next').branch('next');
  const { chip: second, events: secondEvents } = fetch.chip();
  second.runTo(20_000);
  assert.match(secondEvents[0].detail, /^instruction fetch from 0x1000.*not in XIP mode/);
  assert.match(secondEvents[0].detail, new RegExp(`PC 0x${fetch.address('next').toString(16)}`));
});

test('erasing in XIP mode, and writing through the XIP window, are faults', () => {
  const program = new Program(CODE).op(CPSID);
  call(program, 'RE', 0x100000, 4096, 0x80000000, 0).label('end').branch('end');
  const { chip, events } = program.chip();
  chip.runTo(20_000);
  assert.match(events[0].detail, /call flash_exit_xip first/);
  const write = new Program().poke(0x10000100, 0).label('end').branch('end').chip();
  write.chip.runTo(20_000);
  assert.match(write.events[0].detail, /^write to 0x10000100, which is read-only/);
});

test('the SSI reads the unique id and the JEDEC id as flash drivers do, and boot2 brings XIP back', () => {
  const { chip } = idle().chip({ uniqueId: '0123456789abcdef' });
  const { rp } = chip;
  const write = (/** @type {number} */ offset, /** @type {number} */ value) => rp.writeUint32(SSI + offset, value);
  const read = (/** @type {number} */ offset) => rp.readUint32(SSI + offset);
  const command = (/** @type {number} */ byte, /** @type {number} */ dummies, /** @type {number} */ count) => {
    write(0x08, 0);
    write(0x00, (7 << 16) | 0x300);
    write(0x04, dummies + count - 1);
    write(0x08, 1);
    rp.writeUint8(SSI + 0x60, byte);
    const bytes = [];
    for (let i = 0; i < dummies + count; i++) {
      assert.equal(read(0x28) & 0x08, 0x08, 'SR.RFNE');
      bytes.push(rp.readUint8(SSI + 0x60));
    }
    assert.equal(read(0x28) & 0x08, 0);
    return Buffer.from(bytes.slice(dummies)).toString('hex');
  };
  assert.equal(chip.machine.bus.xip, true);
  assert.equal(command(0x4b, 4, 8), '0123456789abcdef');
  assert.equal(command(0x9f, 0, 3), 'ef7015');
  assert.equal(chip.machine.bus.xip, false);
  // boot2 for this chip: read status register 2 (QE is set, nothing to program), then the XIP format.
  write(0x08, 0);
  write(0x00, 7 << 16);
  write(0x08, 1);
  write(0x60, 0x35);
  write(0x60, 0x35);
  assert.equal(read(0x28) & 0x05, 0x04, 'SR.TFE, not BUSY');
  read(0x60);
  assert.equal(read(0x60), 0x02);
  write(0x08, 0);
  write(0x00, (2 << 21) | (31 << 16) | 0x300);
  write(0x08, 1);
  assert.equal(chip.machine.bus.xip, true);
});

test('the flash keeps its content in its file; the image is loaded over it', () => {
  const folder = mkdtempSync(join(tmpdir(), 'cosim-'));
  try {
    const path = join(folder, 'flash.bin');
    const { chip } = idle().chip({ flashPath: path });
    chip.flash.array[0x180000] = 0x5a;
    chip.flash.array[0x100] ^= 0xff;
    chip.flash.save();
    assert.equal(readFileSync(path).length, FLASH_BYTES);
    const { chip: again } = idle().chip({ flashPath: path });
    assert.equal(again.flash.array[0x180000], 0x5a);
    assert.notEqual(again.flash.array[0x100], chip.flash.array[0x100]);
    writeFileSync(path, 'short');
    assert.throws(() => new Flash(path, '0000000000000000'), /5 bytes; a flash file has 2097152/);
  } finally {
    rmSync(folder, { recursive: true });
  }
});

test('reset_to_usb_boot stops the chip until it is reset', () => {
  const program = new Program().load(0, RAM).op(ldr(1, 0), adds(1, 1), str(1, 0));
  call(program, 'UB', 0, 0);
  const { chip, events, word } = finish(program).chip();
  chip.runTo(20_000);
  assert.deepEqual(events, [{ chip: 'chip', event: 'reset', detail: 'USB boot loader' }]);
  assert.equal(word(RAM + 0x40), 0);
  chip.reset(chip.now);
  chip.runTo(400_000);
  assert.equal(word(RAM), 2);
});

// The server as a process: one answer a command, in order, and errors that leave it up.
import assert from 'node:assert/strict';
import { spawn } from 'node:child_process';
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { createInterface } from 'node:readline';
import { after, before, test } from 'node:test';
import { fileURLToPath } from 'node:url';
import { readElf } from '../src/elf.mjs';
import { elfFile } from './elf-file.mjs';
import { BX_LR, ldr, Program, RAM, str, WFI } from './program.mjs';

const UART0 = 0x40034000;
const SERVER = fileURLToPath(new URL('../src/server.mjs', import.meta.url));
let folder = '';
let elf = '';

/** Puts the system clock and so the peripheral clock on the crystal, 12 MHz: 750 kbaud at most. */
function echoImage() {
  const program = new Program();
  program.poke(0x40008030, 2).poke(0x40008048, 1 << 11);
  program
    .poke(UART0 + 0x24, 1)
    .poke(UART0 + 0x28, 0)
    .poke(UART0 + 0x2c, 0x60)
    .poke(UART0 + 0x30, 0x301);
  program
    .poke(UART0 + 0x38, 0x10)
    .poke(0xe000e100, 1 << 20)
    .label('end')
    .op(WFI)
    .branch('end');
  program
    .handler(16 + 20)
    .load(0, UART0)
    .op(ldr(1, 0), str(1, 0))
    .load(0, RAM + 0x20)
    .op(str(1, 0), BX_LR);
  const image = program.image();
  image.symbols.set('LAST', { address: RAM + 0x20, size: 4 });
  return image;
}

before(() => {
  folder = mkdtempSync(join(tmpdir(), 'cosim-'));
  elf = join(folder, 'echo.elf');
  writeFileSync(elf, elfFile(echoImage()));
});
after(() => rmSync(folder, { recursive: true }));

/** Sends commands to a server of its own and returns the answers. @param {(object | string)[]} commands */
async function session(commands) {
  const child = spawn(process.execPath, [SERVER], { stdio: ['pipe', 'pipe', 'inherit'] });
  const lines = createInterface({ input: child.stdout })[Symbol.asyncIterator]();
  /** @type {any[]} */
  const answers = [];
  for (const command of commands) {
    child.stdin.write(`${typeof command === 'string' ? command : JSON.stringify(command)}\n`);
    const { value, done } = await lines.next();
    assert.ok(!done, 'the server has ended');
    answers.push(JSON.parse(value));
  }
  child.stdin.end();
  return answers;
}

test('the ELF reader places segments by their physical address and knows the symbols', () => {
  const { segments, symbols } = readElf(elf);
  assert.deepEqual(
    segments.map((s) => s.address),
    [0x10000100, 0x100001c0],
  );
  assert.deepEqual(symbols.get('LAST'), { address: RAM + 0x20, size: 4 });
  writeFileSync(join(folder, 'text'), 'no image');
  assert.throws(() => readElf(join(folder, 'text')), /not an ELF file/);
});

test('a whole session', async () => {
  const flash = join(folder, 'flash.bin');
  const chip = {
    cmd: 'chip',
    name: 'a',
    elf,
    ppm: 10,
    start_ns: 0,
    unique_id: 'e661a4d41723262a',
    flash,
    straps: { 15: true },
  };
  const answers = await session([
    chip,
    { cmd: 'port', name: 'p', to: ['a', 0], baud: 750_000, delay_ns: 0, faults: null },
    { cmd: 'run', until_ns: 1e6 },
    { cmd: 'send', port: 'p', bytes: '0102fe00', at_ns: 1_100_000 },
    { cmd: 'run', until_ns: 1e9, stop: true },
    { cmd: 'peek', chip: 'a', symbol: 'LAST', bytes: 1 },
    { cmd: 'poke', chip: 'a', symbol: 'LAST', hex: '2a' },
    { cmd: 'peek', chip: 'a', address: RAM + 0x20, bytes: 1 },
    { cmd: 'profile', chip: 'a', reset: true },
    { cmd: 'profile', chip: 'a' },
    { cmd: 'wires' },
    { cmd: 'reset', chip: 'a' },
    { cmd: 'run', until_ns: 3e6, stop: true },
    { cmd: 'stop', chip: 'a' },
    { cmd: 'start', chip: 'a' },
    { cmd: 'cut', wire: 'p', cut: true },
    { cmd: 'save' },
    { cmd: 'run', until_ns: 3e6 },
    { cmd: 'reset', chip: 'a' },
    { cmd: 'time', chip: 'a', at_ns: 3_500_000 },
    { cmd: 'crystal', chip: 'a', ppm: -20, ramp_ppm_per_s: 0.5 },
    { cmd: 'run', until_ns: 2_003e6 },
    { cmd: 'time', chip: 'a' },
    { cmd: 'time', chip: 'a', local_ns: 1e9 },
    { cmd: 'pins', chip: 'a', mask: 1 << 15 },
    { cmd: 'edges', chip: 'a' },
    { cmd: 'pwm', chip: 'a' },
    { cmd: 'quit' },
  ]);
  for (const i of [0, 1, 6, 11, 13, 14, 15, 16, 18, 27]) assert.deepEqual(answers[i], { ok: true }, `answer ${i}`);
  assert.deepEqual(answers[2], { now_ns: 1e6, events: [] });
  const bitNs = 1e9 / 750_000;
  assert.ok(Math.abs(answers[3].end_ns - 1_100_000 - 40 * bitNs) < 1e-6);
  assert.equal(answers[4].events.length, 1);
  const [event] = answers[4].events;
  assert.deepEqual([event.port, event.bytes], ['p', '0102fe00']);
  // The echo of the last byte ends a character and the way through the interrupt after it, at 12 MHz.
  assert.ok(event.end_ns > answers[3].end_ns + 9.5 * bitNs && event.end_ns < answers[3].end_ns + 9.5 * bitNs + 5_000);
  assert.equal(answers[5].hex, '00');
  assert.equal(answers[7].hex, '2a');
  const [uart] = answers[8].exceptions;
  assert.deepEqual([uart.number, uart.count], [16 + 20, 4]);
  assert.deepEqual(answers[8].uarts[0].rx_bytes, 4);
  assert.deepEqual([answers[9].exceptions, answers[9].uarts[0].rx_bytes], [[], 0]);
  assert.deepEqual(answers[10].wires, [
    { name: 'p', bytes_ab: 4, bytes_ba: 4, errors_ab: 0, errors_ba: 0, lost_ab: 0, lost_ba: 0 },
  ]);
  assert.deepEqual(answers[12].events, [{ chip: 'a', event: 'reset', detail: 'RUN pin' }]);
  assert.deepEqual(answers[19], { global_ns: 3_500_000, local_ns: 500_005, ppm: 10, boot_ns: 3_000_000 });
  assert.deepEqual(answers[20], { ppm: -20, ramp_ppm_per_s: 0.5 });
  // Two seconds at -20 ppm, and half of two seconds times the 1 ppm that the ramp made.
  assert.ok(Math.abs(answers[22].local_ns - (2e9 - 40_000 + 1_000)) < 1e-3);
  assert.equal(answers[22].ppm, -19);
  assert.ok(Math.abs(answers[23].global_ns - 1_003_019_750) < 1);
  assert.deepEqual(answers.slice(24, 26), [{ high: 0, open: 1 << 15 }, { edges: [], lost: 0 }]);
  assert.equal(answers[26].slices.length, 8);
  assert.equal(readFileSync(flash).length, 2 * 1024 * 1024);
});

test('every mistake is answered, and the session goes on', async () => {
  const chip = { cmd: 'chip', name: 'a', elf };
  const mistakes = [
    ['{', /JSON/],
    [{ cmd: 'fly' }, /unknown command; there are: chip, /],
    [{ cmd: 'chip', name: 'a', elf: join(folder, 'nothing.elf') }, /nothing\.elf/],
    [{ cmd: 'chip', name: 'b', elf, unique_id: 'xyz' }, /16 hexadecimal digits/],
    [{ cmd: 'chip', name: 'b' }, /"elf" must be a string/],
    [{ cmd: 'peek', chip: 'b', address: RAM, bytes: 4 }, /no chip "b"; there are: none/],
    [{ cmd: 'send', port: 'q', bytes: '00' }, /no port "q"/],
    [{ cmd: 'run' }, /"until_ns" must be a number/],
  ];
  const later = [
    [chip, /exists already/],
    [{ cmd: 'peek', chip: 'a', symbol: 'NONE', bytes: 4 }, /no symbol "NONE"/],
    [{ cmd: 'peek', chip: 'a', address: 0x40000000, bytes: 4 }, /not in RAM or flash/],
    [{ cmd: 'port', name: 'p', to: ['a', 2], baud: 1e6 }, /no UART 2/],
    [{ cmd: 'port', name: 'p', to: ['a', 0], baud: 0 }, /must be positive/],
    [{ cmd: 'wire', name: 'w', a: ['a', 0], b: ['a', 1], delay_ns: -1 }, /must not be negative/],
    [{ cmd: 'start', chip: 'a' }, /chip a is on/],
    [{ cmd: 'time', chip: 'a', at_ns: 1, local_ns: 1 }, /not both/],
    [{ cmd: 'time', chip: 'a', at_ns: -1 }, /booted at 0 ns/],
    [{ cmd: 'crystal', chip: 'a', ppm: '3' }, /"ppm" must be a number/],
    [{ cmd: 'crystal', chip: 'a', ppm: -1e6 }, /-1000000 ppm/],
    [{ cmd: 'poke', chip: 'a', address: RAM, hex: '1' }, /in pairs/],
    [{ cmd: 'pins', chip: 'a', mask: -1 }, /"mask" is -1/],
    [{ cmd: 'edges', chip: 'c' }, /no chip "c"/],
  ];
  const commands = [...mistakes.map(([c]) => c), chip, ...later.map(([c]) => c)];
  const answers = await session(/** @type {any} */ ([...commands, { cmd: 'run', until_ns: 1000 }]));
  const expected = [...mistakes, [chip, null], ...later];
  expected.forEach(([command, pattern], i) => {
    if (pattern === null) assert.deepEqual(answers[i], { ok: true });
    else assert.match(answers[i].error, /** @type {RegExp} */ (pattern), JSON.stringify(command));
  });
  assert.deepEqual(answers.at(-1), { now_ns: 1000, events: [] });
});

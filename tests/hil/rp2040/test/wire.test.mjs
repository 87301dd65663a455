// Wires and outside endpoints: times, drift, faults, cuts, resets; the same run twice is the same.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { Port, Wire } from '../src/wire.mjs';
import { World } from '../src/world.mjs';
import { BX_LR, idle, ldr, Program, setClock, str, WFI } from './program.mjs';

const UART1 = 0x40038000;
const BIT_NS = (16 * (2 + 39 / 64) * 1e9) / 125e6;

/** UART1 at 2.994 Mbaud with FIFOs off and a receive interrupt. Uses r0 and r1. */
const openUart = (/** @type {Program} */ program) =>
  program
    .poke(UART1 + 0x24, 2)
    .poke(UART1 + 0x28, 39)
    .poke(UART1 + 0x2c, 0x60)
    .poke(UART1 + 0x30, 0x301)
    .poke(UART1 + 0x38, 0x10);

/** Sends each received byte back plus one. */
function echo() {
  const program = openUart(new Program())
    .poke(0xe000e100, 1 << 21)
    .label('end')
    .op(WFI)
    .branch('end');
  program
    .handler(16 + 21)
    .load(0, UART1)
    .op(ldr(1, 0), 0x3101, str(1, 0), BX_LR);
  return program;
}

/** A world of chips that are made by hand. @param {Record<string, ReturnType<Program['chip']>['chip']>} chips */
function world(chips) {
  const made = new World();
  for (const [name, chip] of Object.entries(chips)) {
    chip.name = name;
    chip.onEvent = (event) => made.events.push(event);
    made.chips.set(name, chip);
  }
  return made;
}

/**
 * @param {World} made @param {string} name @param {string} chip
 * @param {import('../src/wire.mjs').Faults | null} [faults]
 */
function outside(made, name, chip, faults = null, delayNs = 0) {
  made.ports.set(name, new Port(name, made.chip(chip), 1, 1e9 / BIT_NS, delayNs, faults));
}

test('a byte and its echo: ten bits each, half a bit less at the receiver, the interrupt between', () => {
  const made = world({ a: echo().chip().chip });
  outside(made, 'p', 'a');
  made.run(100_000, false);
  // 0xff comes back as 0, the delimiter.
  const sent = made.send('p', Uint8Array.of(0xff), 150_000);
  assert.deepEqual(sent, { start_ns: 150_000, end_ns: 150_000 + 10 * BIT_NS });
  const { now_ns: now, events } = made.run(1e6, true);
  assert.equal(events.length, 1);
  const event = /** @type {import('../src/wire.mjs').PortEvent} */ (events[0]);
  assert.equal(event.bytes, '00');
  assert.ok(Math.abs(event.end_ns - event.start_ns - 10 * BIT_NS) < 1e-3);
  // Read in the middle of the stop bit; entry 15 cycles, LDR of the address 2, LDR 4, ADDS 1; waking costs at most one.
  const cycles = (event.start_ns - 150_000 - 9.5 * BIT_NS) / 8;
  assert.ok(cycles >= 22 && cycles <= 23.01, `${cycles} cycles`);
  assert.ok(now >= event.end_ns && now < event.end_ns + 2_001, 'stops in the quantum of the delimiter');
});

test('bytes without a delimiter stay buffered; queued bytes follow back to back', () => {
  const made = world({ a: echo().chip().chip });
  outside(made, 'p', 'a');
  made.run(50_000, false);
  made.send('p', Uint8Array.of(1, 2), undefined);
  const second = made.send('p', Uint8Array.of(0xff), undefined);
  assert.ok(Math.abs(second.start_ns - 50_000 - 20 * BIT_NS) < 1e-6);
  assert.deepEqual(made.run(50_000 + 35 * BIT_NS, true).events, []);
  const { events } = made.run(1e6, true);
  assert.equal(/** @type {any} */ (events[0]).bytes, '020300');
});

test('a wire delays both ways, and drift does not lose a byte', () => {
  // b echoes to a; a holds what it receives in its FIFO.
  const a = openUart(new Program())
    .poke(UART1 + 0x2c, 0x70)
    .label('end')
    .op(WFI)
    .branch('end')
    .chip({ ppm: -200 }).chip;
  const b = echo().chip({ ppm: 200, startNs: 3_333 }).chip;
  const made = world({ a, b });
  made.wires.set('w', new Wire('w', [a, 1], [b, 1], 700, null));
  made.run(100_000, false);
  const uart = a.uarts[1];
  /** @type {number[]} */
  const echoed = [];
  for (let i = 0; i < 20; i++) {
    a.rp.writeUint32(UART1, i);
    made.run(made.nowNs + 30_000, false);
    echoed.push(a.rp.readUint32(UART1));
  }
  assert.deepEqual(
    echoed,
    Array.from({ length: 20 }, (_, i) => i + 1),
  );
  const [ab, ba] = made.wires.get('w')?.lines ?? [];
  assert.deepEqual([ab.bytes, ba.bytes, ab.late, ba.late], [20, 20, 0, 0]);
  // One more round trip, timed: two characters to the stop bit's middle, twice the delay, the echo's 23 cycles.
  const from = a.now;
  a.rp.writeUint32(UART1, 1);
  while (uart.rx.length === 0) a.runTo((b.runTo((made.nowNs += 100)), made.nowNs));
  const took = a.toGlobal(uart.rxAt[0]) - from;
  const expected = 2 * (9.5 * BIT_NS + 700) + 23 * 8;
  assert.ok(Math.abs(took - expected) < 20, `${took} against ${expected}`);
});

test('the quantum does not change what happens', () => {
  const results = [500, 1000, 2000].map((quantum) => {
    const made = world({ a: echo().chip({ ppm: 60 }).chip });
    outside(made, 'p', 'a');
    Object.defineProperty(made, 'quantumNs', { get: () => quantum });
    made.run(100_000, false);
    made.send(
      'p',
      Uint8Array.from({ length: 200 }, (_, i) => (i % 7 === 6 ? 0xff : i)),
      110_000,
    );
    return made.run(2e6, false).events;
  });
  assert.ok(results[0].length > 20);
  assert.deepEqual(results[1], results[0]);
  assert.deepEqual(results[2], results[0]);
});

test('faults are counted, seeded and within their rates', () => {
  const run = (/** @type {number} */ seed) => {
    const a = openUart(new Program()).label('end').op(WFI).branch('end').chip().chip;
    const made = world({ a });
    outside(made, 'p', 'a', { seed, byte_error: 0.01, byte_loss: 0.02 });
    made.run(50_000, false);
    /** @type {number[]} */
    const seen = [];
    const uart = a.uarts[1];
    uart.receive = (frame) => seen.push(frame.data);
    made.send('p', new Uint8Array(20_000).fill(0x55), undefined);
    made.run(200e6, false);
    const [wire] = made.report().wires;
    assert.equal(wire.bytes_ab, 20_000);
    assert.equal(seen.length, 20_000 - wire.lost_ab);
    const wrong = seen.filter((byte) => byte !== 0x55);
    assert.equal(wrong.length, wire.errors_ab);
    // One bit each.
    for (const byte of wrong) assert.equal(Math.log2(byte ^ 0x55) % 1, 0);
    return { ...wire, seen: seen.join() };
  };
  const first = run(7);
  // Five standard deviations of a binomial: 400 +- 5 * 19.8 and 196 +- 5 * 13.9.
  assert.ok(Math.abs(first.lost_ab - 400) < 99, `${first.lost_ab} lost`);
  assert.ok(Math.abs(first.errors_ab - 196) < 70, `${first.errors_ab} wrong`);
  assert.deepEqual(run(7), first);
  assert.notDeepEqual(run(8), first);
});

test('a tap tells what passes on a wire, both ways, and stops nothing', () => {
  const a = openUart(new Program()).label('end').op(WFI).branch('end').chip().chip;
  const made = world({ a, b: echo().chip().chip });
  made.wires.set('w', new Wire('w', [a, 1], [made.chip('b'), 1], 700, null));
  made.tap('w');
  made.run(100_000, false);
  const from = a.now;
  a.rp.writeUint32(UART1, 0);
  a.rp.writeUint32(UART1, 0xff);
  const { now_ns: now, events } = made.run(200_000, true);
  assert.equal(now, 200_000);
  const [ab, ba] = /** @type {import('../src/wire.mjs').PortEvent[]} */ (events);
  // The echo adds one: 0 comes back as 1, 0xff as the delimiter.
  assert.deepEqual([ab.port, ab.bytes, ba.port, ba.bytes], ['w:ab', '00', 'w:ba', '0100']);
  assert.ok(Math.abs(ab.start_ns - from - 700) < 1e-6);
  assert.ok(Math.abs(ab.end_ns - ab.start_ns - 10 * BIT_NS) < 1e-6);
  assert.throws(() => made.tap('x'), /"x"/);
});

test('a tapped port tells what the chip sends before any fault', () => {
  const made = world({ a: echo().chip().chip });
  outside(made, 'p', 'a');
  made.tap('p');
  made.run(50_000, false);
  const [, fromChip] = made.port('p').lines;
  Object.assign(fromChip, { lossRate: 1 });
  made.send('p', Uint8Array.of(7, 0xff, 0), undefined);
  const events = /** @type {import('../src/wire.mjs').PortEvent[]} */ (made.run(200_000, false).events);
  assert.deepEqual(
    events.map(({ port, bytes }) => [port, bytes]),
    [
      ['p:ab', '07ff00'],
      ['p:ba', '0800'],
    ],
  );
  assert.equal(fromChip.lost, 3);
});

test('a cut wire carries nothing, and carries again', () => {
  const made = world({ a: echo().chip().chip });
  outside(made, 'p', 'a');
  made.run(50_000, false);
  made.cut('p', true);
  made.send('p', Uint8Array.of(1, 2, 3, 0xff), undefined);
  assert.deepEqual(made.run(200_000, true).events, []);
  assert.equal(made.report().wires[0].lost_ab, 4);
  made.cut('p', false);
  made.send('p', Uint8Array.of(0xff), undefined);
  assert.equal(made.run(300_000, true).events.length, 1);
});

test('a chip that is off or resets receives what begins after its boot', () => {
  const made = world({ a: echo().chip().chip });
  const chip = made.chip('a');
  outside(made, 'p', 'a');
  made.run(50_000, false);
  chip.powerOff();
  made.send('p', Uint8Array.of(0xff), 60_000);
  made.run(100_000, false);
  chip.powerOn(100_000);
  setClock(chip);
  made.send('p', Uint8Array.of(0xff), 200_000);
  const { events } = made.run(1e6, false);
  assert.equal(events.length, 1);
  assert.equal(made.report().wires[0].bytes_ab, 2);
  assert.equal(chip.counters[1].rxBytes, 1);
});

test('a character that is under way during a reset is not received', () => {
  const made = world({ a: echo().chip().chip });
  const chip = made.chip('a');
  outside(made, 'p', 'a');
  made.run(50_000, false);
  made.send('p', Uint8Array.of(1, 2), 50_000);
  made.run(50_000 + 4_500, false);
  chip.reset(made.nowNs);
  /** @type {number[]} */
  const seen = [];
  chip.uarts[1].receive = (frame) => seen.push(frame.data);
  made.run(100_000, false);
  assert.deepEqual(seen, [], 'the first was received before, the second had begun');
  made.send('p', Uint8Array.of(3), undefined);
  made.run(200_000, false);
  assert.deepEqual(seen, [3]);
});

test('idle chips are skipped over: a second of sleep is few steps', () => {
  const made = world({ a: idle().chip().chip, b: idle().chip().chip });
  let steps = 0;
  const chip = made.chip('a');
  const runTo = chip.runTo.bind(chip);
  chip.runTo = (until) => {
    steps++;
    runTo(until);
  };
  made.run(1e9, false);
  assert.equal(made.nowNs, 1e9);
  assert.ok(steps < 10, `${steps} steps`);
});

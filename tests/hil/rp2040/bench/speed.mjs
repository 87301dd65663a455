// How fast the co-simulation runs: processor seconds of the host, not wall-clock, so that other work does not count.
// Prints figures and checks nothing. Run by `npm run bench`.
import { Port } from '../src/wire.mjs';
import { World } from '../src/world.mjs';
import { adds, BX_LR, ldr, Program, RAM, str, subs, WFI } from '../test/program.mjs';

const UART = 0x40034000;
const DMA = 0x50000000;
const TIMER = 0x40054000;
const BAUD = 125e6 / (16 * (2 + 39 / 64));

/** @param {string} name @param {number} virtualNs @param {World} world */
function measure(name, virtualNs, world) {
  world.run(1e6, false);
  const before = [...world.chips.values()].map((chip) => chip.report().instructions);
  const from = process.cpuUsage();
  world.run(1e6 + virtualNs, false);
  const { user, system } = process.cpuUsage(from);
  const seconds = (user + system) / 1e6;
  const instructions = [...world.chips.values()].reduce(
    (sum, chip, i) => sum + chip.report().instructions - before[i],
    0,
  );
  const rate = instructions > 1e5 ? `, ${(instructions / seconds / 1e6).toFixed(1)} M instructions/s` : '';
  console.log(`${name}: ${(virtualNs / 1e9 / seconds).toFixed(2)} virtual seconds a processor second${rate}`);
}

/** @param {Program[]} programs */
function worldOf(...programs) {
  const world = new World();
  programs.forEach((program, i) => {
    const { chip } = program.chip();
    chip.name = `chip${i}`;
    world.chips.set(chip.name, chip);
  });
  return world;
}

/** Loads, stores, arithmetic and branches in RAM. */
function busy() {
  const program = new Program(RAM + 0x1000).load(0, RAM).label('loop');
  for (let i = 0; i < 4; i++) program.op(ldr(1, 0), adds(1, 3), 0x004a, 0x4051, str(1, 0, 4), subs(1, 1));
  return program.branch('loop');
}

/** Alarm 0 each millisecond. */
function ticking() {
  const program = new Program()
    .poke(TIMER + 0x38, 1)
    .poke(TIMER + 0x10, 500)
    .poke(0xe000e100, 1);
  program.label('end').op(WFI).branch('end');
  return program
    .handler(16)
    .poke(TIMER + 0x34, 1)
    .load(0, TIMER)
    .op(ldr(1, 0, 0x10))
    .load(2, 1000)
    .op(0x1889, str(1, 0, 0x10), BX_LR);
}

/** The receive path: a byte and its stamp by DMA into rings, an interrupt a byte. */
function receiving() {
  const program = new Program();
  const uart = [
    [0x24, 2],
    [0x28, 39],
    [0x2c, 0x70],
    [0x48, 3],
    [0x30, 0x301],
  ];
  for (const [offset, value] of uart) program.poke(UART + offset, value);
  const stamp = [
    [0x40, TIMER + 0x28],
    [0x44, RAM + 0x800],
    [0x48, 1],
    [0x50, 0x003f8000 | (1 << 21) | (1 << 10) | (8 << 6) | 0x29],
  ];
  const byte = [
    [0x00, UART],
    [0x04, RAM + 0x400],
    [0x08, 1],
    [0x0c, (21 << 15) | (1 << 11) | (1 << 10) | (6 << 6) | 0x21],
  ];
  for (const [offset, value] of [...stamp, [0x414, 1], ...byte]) program.poke(DMA + offset, value);
  program
    .poke(0xe000e100, 1 << 12)
    .label('end')
    .op(WFI)
    .branch('end');
  return program
    .handler(16 + 12)
    .poke(DMA + 0x41c, 1)
    .load(0, RAM)
    .op(ldr(1, 0), adds(1, 1), str(1, 0), BX_LR);
}

measure('one busy chip', 0.2e9, worldOf(busy()));
measure('two idle chips with a 1 ms timer interrupt', 20e9, worldOf(ticking(), ticking()));
const world = worldOf(receiving());
const port = new Port('in', world.chip('chip0'), 0, BAUD, 0, null);
world.ports.set('in', port);
port.send(new Uint8Array(Math.ceil((1.1 * BAUD) / 10)).fill(0x55), 0);
measure('one chip with a saturated 3 Mbaud receive by DMA, an interrupt a byte', 1e9, world);
const [received] = world.chip('chip0').report().uarts;
console.log(`  ${received.rx_bytes} bytes, ${received.overruns} overruns`);

// The co-simulation server: one JSON command a line on stdin, one JSON answer a line on stdout, in order.
// Any failure answers {"error": ...} and leaves the process up. Logs go to stderr. README.md lists the commands.
import { createInterface } from 'node:readline';
import { World } from './world.mjs';

/** @typedef {Record<string, any>} Command */

const OK = { ok: true };

/** @param {Command} command @param {string} key @param {string} type @param {any} [fallback] */
function field(command, key, type, fallback) {
  const value = command[key];
  if ((value === undefined || value === null) && fallback !== undefined) return fallback;
  if (typeof value !== type) throw new Error(`"${key}" must be a ${type}, not ${JSON.stringify(value)}`);
  return value;
}

/** @param {Command} command @param {string} key @returns {number | undefined} */
function optional(command, key) {
  return command[key] === undefined || command[key] === null ? undefined : field(command, key, 'number');
}

/** @param {Command} command @param {string} key @returns {[string, number]} */
function end(command, key) {
  const value = command[key];
  if (!Array.isArray(value) || typeof value[0] !== 'string' || typeof value[1] !== 'number') {
    throw new Error(`"${key}" must be [chip, uart], not ${JSON.stringify(value)}`);
  }
  return [value[0], value[1]];
}

/** @param {Command} command @param {string} key */
function hex(command, key) {
  const text = field(command, key, 'string');
  if (!/^([0-9a-f]{2})*$/i.test(text)) throw new Error(`"${key}" must be hexadecimal digits in pairs`);
  return Uint8Array.from(Buffer.from(text, 'hex'));
}

/** @param {Command} command */
function delay(command) {
  const delayNs = field(command, 'delay_ns', 'number', 0);
  if (!(delayNs >= 0)) throw new Error(`"delay_ns" is ${delayNs}; it must not be negative`);
  return delayNs;
}

/** @param {World} world @param {Command} command @param {number} count */
function memory(world, command, count) {
  const symbol = command.symbol === undefined ? undefined : field(command, 'symbol', 'string');
  const address = command.address === undefined ? undefined : field(command, 'address', 'number');
  return world.chip(field(command, 'chip', 'string')).locate(symbol, address, count);
}

/** @type {Record<string, (world: World, command: Command) => object>} */
const COMMANDS = {
  chip(world, command) {
    world.addChip({
      name: field(command, 'name', 'string'),
      elf: field(command, 'elf', 'string'),
      ppm: field(command, 'ppm', 'number', 0),
      startNs: field(command, 'start_ns', 'number', 0),
      uniqueId: field(command, 'unique_id', 'string', '0000000000000000'),
      flashPath: command.flash ?? null,
      straps: command.straps ?? {},
    });
    return OK;
  },
  wire(world, command) {
    const name = field(command, 'name', 'string');
    world.addWire(name, end(command, 'a'), end(command, 'b'), delay(command), command.faults ?? null);
    return OK;
  },
  port(world, command) {
    const baud = field(command, 'baud', 'number');
    if (!(baud > 0)) throw new Error(`"baud" is ${baud}; it must be positive`);
    world.addPort(field(command, 'name', 'string'), end(command, 'to'), baud, delay(command), command.faults ?? null);
    return OK;
  },
  usb(world, command) {
    world.addUsb(field(command, 'name', 'string'), field(command, 'chip', 'string'));
    return OK;
  },
  tap(world, command) {
    world.tap(field(command, 'wire', 'string'));
    return OK;
  },
  send(world, command) {
    const atNs = command.at_ns === undefined ? undefined : field(command, 'at_ns', 'number');
    return world.send(field(command, 'port', 'string'), hex(command, 'bytes'), atNs);
  },
  crystal(world, command) {
    const [ppm, ramp] = ['ppm', 'ramp_ppm_per_s'].map((key) => optional(command, key));
    return world.setCrystal(field(command, 'chip', 'string'), ppm, ramp);
  },
  time(world, command) {
    const [atNs, localNs] = ['at_ns', 'local_ns'].map((key) => optional(command, key));
    if (atNs !== undefined && localNs !== undefined) throw new Error('give "at_ns" or "local_ns", not both');
    return world.time(field(command, 'chip', 'string'), atNs, localNs);
  },
  run(world, command) {
    return world.run(field(command, 'until_ns', 'number'), field(command, 'stop', 'boolean', false));
  },
  cut(world, command) {
    world.cut(field(command, 'wire', 'string'), field(command, 'cut', 'boolean'));
    return OK;
  },
  stop(world, command) {
    world.chip(field(command, 'chip', 'string')).powerOff();
    return OK;
  },
  start(world, command) {
    world.chip(field(command, 'chip', 'string')).powerOn(world.nowNs);
    return OK;
  },
  reset(world, command) {
    world.chip(field(command, 'chip', 'string')).reset(world.nowNs);
    return OK;
  },
  peek(world, command) {
    return { hex: Buffer.from(memory(world, command, field(command, 'bytes', 'number'))).toString('hex') };
  },
  poke(world, command) {
    const bytes = hex(command, 'hex');
    memory(world, command, bytes.length).set(bytes);
    return OK;
  },
  profile(world, command) {
    const chip = world.chip(field(command, 'chip', 'string'));
    const report = chip.report();
    if (field(command, 'reset', 'boolean', false)) chip.resetProfile();
    return report;
  },
  pins(world, command) {
    return world.chip(field(command, 'chip', 'string')).pins.watch(field(command, 'mask', 'number'));
  },
  edges(world, command) {
    return world.chip(field(command, 'chip', 'string')).pins.take();
  },
  pwm(world, command) {
    return { slices: world.chip(field(command, 'chip', 'string')).machine.pwm.report() };
  },
  wires(world) {
    return world.report();
  },
  save(world) {
    world.save();
    return OK;
  },
  quit(world) {
    world.save();
    return OK;
  },
};

/** One command to one answer. @param {World} world @param {string} line */
export function answer(world, line) {
  let name = '?';
  try {
    const command = JSON.parse(line);
    name = String(command?.cmd);
    if (!Object.hasOwn(COMMANDS, name)) {
      throw new Error(`unknown command; there are: ${Object.keys(COMMANDS).join(', ')}`);
    }
    return { quit: name === 'quit', result: COMMANDS[name](world, command) };
  } catch (error) {
    return { quit: false, result: { error: `${name}: ${/** @type {Error} */ (error).message}` } };
  }
}

async function main() {
  const world = new World();
  for await (const line of createInterface({ input: process.stdin })) {
    if (line.trim() === '') continue;
    const { quit, result } = answer(world, line);
    process.stdout.write(`${JSON.stringify(result)}\n`);
    if (quit) break;
  }
}

if (process.argv[1] && import.meta.url === new URL(`file://${process.argv[1]}`).href) await main();

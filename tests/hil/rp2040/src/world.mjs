// All chips, wires and outside endpoints, run in lock-step: each chip in turn for one quantum of global time.
// A quantum is shorter than the shortest character, so that what one chip sends within it reaches another one's future.
import { Chip } from './chip.mjs';
import { readElf } from './elf.mjs';
import { UsbPort } from './usb.mjs';
import { Port, Wire } from './wire.mjs';

const QUANTUM_NS = 2000;
/** Part of a character's time that a quantum may take; the rest covers the last instruction's overrun. */
const QUANTUM_PART = 0.8;
/** No oscillator is a tenth off; far from standing still, so that time goes on. */
const PPM_MAX = 100_000;

/** @typedef {import('./chip.mjs').ChipEvent} ChipEvent */
/** @typedef {import('./wire.mjs').PortEvent} PortEvent */

export class World {
  constructor() {
    this.nowNs = 0;
    /** @type {Map<string, Chip>} */
    this.chips = new Map();
    /** @type {Map<string, Wire>} */
    this.wires = new Map();
    /** @type {Map<string, Port | UsbPort>} */
    this.ports = new Map();
    /** @type {(ChipEvent | PortEvent)[]} */
    this.events = [];
    /** @type {Map<string, import('./elf.mjs').Image>} */
    this.images = new Map();
  }

  /** @param {string} name */
  chip(name) {
    const chip = this.chips.get(name);
    if (!chip) throw new Error(`no chip "${name}"; there are: ${[...this.chips.keys()].join(', ') || 'none'}`);
    return chip;
  }

  /** @param {string} name */
  port(name) {
    const port = this.ports.get(name);
    if (!port) throw new Error(`no port "${name}"; there are: ${[...this.ports.keys()].join(', ') || 'none'}`);
    return port;
  }

  /** @param {string} name */
  #nameLine(name) {
    if (this.wires.has(name) || this.ports.has(name)) throw new Error(`a wire or port "${name}" exists already`);
  }

  /** @param {Omit<import('./chip.mjs').ChipOptions, 'image' | 'onEvent'> & { elf: string }} options */
  addChip(options) {
    if (this.chips.has(options.name)) throw new Error(`a chip "${options.name}" exists already`);
    let image = this.images.get(options.elf);
    if (!image) this.images.set(options.elf, (image = readElf(options.elf)));
    const onEvent = (/** @type {ChipEvent} */ event) => this.events.push(event);
    const startNs = Math.max(options.startNs ?? 0, this.nowNs);
    this.chips.set(options.name, new Chip({ ...options, startNs, image, onEvent }));
  }

  /** @typedef {[string, number]} End a chip's name and the number of its UART */

  /** @param {End} end @returns {[Chip, number]} */
  #end([name, uart]) {
    if (uart !== 0 && uart !== 1) throw new Error(`chip ${name}: no UART ${uart}; there are 0 and 1`);
    const chip = this.chip(name);
    if (chip.uarts[uart].onFrame) throw new Error(`chip ${name}: UART ${uart} is connected already`);
    return [chip, uart];
  }

  /**
   * @param {string} name @param {End} a @param {End} b
   * @param {number} delayNs @param {import('./wire.mjs').Faults | null} faults
   */
  addWire(name, a, b, delayNs, faults) {
    this.#nameLine(name);
    this.wires.set(name, new Wire(name, this.#end(a), this.#end(b), delayNs, faults));
  }

  /**
   * @param {string} name @param {End} to @param {number} baud
   * @param {number} delayNs @param {import('./wire.mjs').Faults | null} faults
   */
  addPort(name, to, baud, delayNs, faults) {
    this.#nameLine(name);
    const [chip, uart] = this.#end(to);
    this.ports.set(name, new Port(name, chip, uart, baud, delayNs, faults));
  }

  /** @param {string} name @param {string} chip */
  addUsb(name, chip) {
    this.#nameLine(name);
    this.ports.set(name, new UsbPort(name, this.chip(chip)));
  }

  /** @param {string} name @param {Uint8Array} bytes @param {number | undefined} atNs */
  send(name, bytes, atNs) {
    return this.port(name).send(bytes, Math.max(atNs ?? 0, this.nowNs));
  }

  /**
   * The crystal of a chip from now on; what is left out stays as it is.
   * @param {string} name @param {number | undefined} ppm @param {number | undefined} rampPpmPerS
   */
  setCrystal(name, ppm, rampPpmPerS) {
    const { crystal } = this.chip(name);
    if (Math.abs(ppm ?? 0) > PPM_MAX) throw new Error(`chip ${name}: ${ppm} ppm; there are ${PPM_MAX} at most`);
    crystal.set(this.nowNs, ppm ?? crystal.ppmAt(this.nowNs), rampPpmPerS ?? crystal.last.rampPpmPerS);
    return { ppm: crystal.last.ppm, ramp_ppm_per_s: crystal.last.rampPpmPerS };
  }

  /**
   * Truth about a chip's clock, of an instant of global time or of its own, since its last boot.
   * @param {string} name @param {number | undefined} atNs global; else now @param {number | undefined} localNs
   */
  time(name, atNs, localNs) {
    const { crystal, bootNs, isOn } = this.chip(name);
    if (!isOn) throw new Error(`chip ${name} is off: it has no time`);
    const globalNs = localNs === undefined ? (atNs ?? this.nowNs) : crystal.toGlobal(localNs);
    if (globalNs < bootNs) throw new Error(`chip ${name} booted at ${bootNs} ns: there is no earlier time of it`);
    return {
      global_ns: globalNs,
      local_ns: localNs ?? crystal.toLocal(globalNs),
      ppm: crystal.ppmAt(globalNs),
      boot_ns: bootNs,
    };
  }

  /** @param {string} name @param {boolean} isCut */
  cut(name, isCut) {
    const line = this.wires.get(name) ?? this.ports.get(name);
    if (!line) throw new Error(`no wire or port "${name}"`);
    line.cut = isCut;
  }

  /** @param {string} name */
  tap(name) {
    const line = this.wires.get(name) ?? this.ports.get(name);
    if (!line || line instanceof UsbPort) throw new Error(`no wire or UART port "${name}"`);
    line.tap();
  }

  /** @returns {number} the longest quantum that is safe at the rates now set */
  get quantumNs() {
    let quantum = QUANTUM_NS;
    for (const chip of this.chips.values()) {
      for (const uart of chip.uarts) {
        if (uart.divisor > 0 && uart.onFrame) quantum = Math.min(quantum, QUANTUM_PART * uart.receiveNs);
      }
    }
    return quantum;
  }

  /** Up to when nothing can happen but the passing of time. @param {number} nowNs */
  #horizon(nowNs) {
    let horizon = Infinity;
    for (const chip of this.chips.values()) horizon = Math.min(horizon, chip.nextNs(nowNs));
    for (const port of this.ports.values()) horizon = Math.min(horizon, port.nextNs);
    return horizon;
  }

  /**
   * @param {number} untilNs
   * @param {boolean} stop at the end of a quantum in which something was received outside or happened to a chip; what
   *   taps see stops nothing
   */
  run(untilNs, stop) {
    while (this.nowNs < untilNs) {
      const next = Math.min(untilNs, Math.max(this.nowNs + this.quantumNs, this.#horizon(this.nowNs)));
      for (const port of this.ports.values()) port.pump(next);
      for (const chip of this.chips.values()) chip.runTo(next);
      for (const port of this.ports.values()) this.events.push(...port.collect(next));
      this.nowNs = next;
      if (stop && this.events.length > 0) break;
    }
    for (const line of [...this.wires.values(), ...this.ports.values()]) {
      if (!(line instanceof UsbPort)) this.events.push(...line.tapped());
    }
    return { now_ns: this.nowNs, events: this.events.splice(0) };
  }

  report() {
    const all = [...this.wires.values(), ...this.ports.values()].filter((line) => line.lines.length === 2);
    const wires = all.map(({ name, lines: [ab, ba] }) => ({
      name,
      bytes_ab: ab.bytes,
      bytes_ba: ba.bytes,
      errors_ab: ab.errors,
      errors_ba: ba.errors,
      lost_ab: ab.lost,
      lost_ba: ba.lost,
    }));
    return { wires };
  }

  save() {
    for (const chip of this.chips.values()) chip.flash.save();
  }
}

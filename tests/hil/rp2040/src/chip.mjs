// One RP2040: the package's model with its mends, our UARTs, DMA, watchdog, flash and boot ROM, run in virtual time.
// A chip has a local clock that starts at 0 with each boot and goes as its crystal does.
import { RAM_BYTES, XIP } from './bus.mjs';
import { ENTRY_CYCLES } from './core.mjs';
import { Crystal } from './crystal.mjs';
import { Flash, FLASH_BYTES } from './flash.mjs';
import { PinRecorder } from './gpio.mjs';
import { Machine } from './machine.mjs';
import { UartCounters } from './pl011.mjs';
import { Profile } from './profile.mjs';
import { HAD_POR, HAD_RUN, REASON_TIMER, WatchdogMemory } from './watchdog.mjs';

const RAM = 0x20000000;
/** Any stage up to the processor's restarts it (datasheet 2.13: each stage waits for the one before). */
const PSM_UP_TO_PROC0 = 0xffff;

/**
 * @typedef {object} ChipOptions
 * @property {string} name
 * @property {import('./elf.mjs').Image} image
 * @property {number} [ppm] of the crystal
 * @property {number} [startNs] global time of power-on
 * @property {string} [uniqueId] of the flash, 16 hexadecimal digits
 * @property {string | null} [flashPath]
 * @property {Record<string, boolean>} [straps] levels of pins held from outside, by number
 * @property {(event: ChipEvent) => void} [onEvent]
 */
/** @typedef {{ chip: string, event: 'watchdog' | 'reset' | 'fault', detail: string }} ChipEvent */

export class Chip {
  /** @param {ChipOptions} options */
  constructor(options) {
    this.name = options.name;
    this.image = options.image;
    this.straps = options.straps ?? {};
    this.onEvent = options.onEvent ?? (() => {});
    this.flash = new Flash(options.flashPath ?? null, options.uniqueId ?? '0000000000000000');
    this.sram = new Uint8Array(RAM_BYTES);
    this.watchdogMemory = new WatchdogMemory(HAD_POR);
    this.counters = [new UartCounters(), new UartCounters()];
    this.profile = new Profile();
    /** Called after each boot: lines and USB attach to the new model. @type {(() => void)[]} */
    this.onBoot = [];
    this.isOn = true;
    /** Why the core stands still until the next reset; null: it runs. @type {string | null} */
    this.halted = null;
    /** A reset that comes at the next boundary of instructions. @type {ChipEvent | null} */
    this.pendingReset = null;
    /** The last instruction returned from an exception. */
    this.returned = false;
    /** Global time of the last boot, the local clock's 0. */
    this.bootNs = options.startNs ?? 0;
    this.crystal = new Crystal(options.ppm ?? 0, this.bootNs);
    this.#load();
    this.machine = this.#build();
    this.pins = new PinRecorder(this);
  }

  /** Places the image at its load addresses. What it does not cover keeps its content. */
  #load() {
    for (const { address, data } of this.image.segments) {
      const target = address >= XIP && address + data.length <= XIP + FLASH_BYTES ? this.flash.array : this.sram;
      const offset = address - (target === this.sram ? RAM : XIP);
      if (offset < 0 || offset + data.length > target.length) {
        throw new Error(`${this.name}: segment at 0x${address.toString(16)} is neither in flash nor in RAM`);
      }
      target.set(data, offset);
    }
  }

  /**
   * Resets the chip: RAM and flash stay as they are.
   * @param {number} globalNs
   */
  #boot(globalNs) {
    this.bootNs = globalNs;
    this.crystal.restart(globalNs);
    this.halted = null;
    this.pendingReset = null;
    this.machine = this.#build();
    for (const attach of this.onBoot) attach();
  }

  #build() {
    return new Machine({
      name: this.name,
      sram: this.sram,
      flash: this.flash,
      watchdogMemory: this.watchdogMemory,
      counters: this.counters,
      straps: this.straps,
      events: this.#coreEvents(),
      onWatchdog: (reason) => this.#watchdogFired(reason),
      onUsbBoot: () => this.#halt('reset', 'USB boot loader'),
    });
  }

  get clock() {
    return this.machine.clock;
  }

  get rp() {
    return this.machine.rp;
  }

  get uarts() {
    return this.machine.uarts;
  }

  #coreEvents() {
    const { profile } = this;
    return {
      onPend: (/** @type {number} */ irq, /** @type {boolean} */ isEnabled) =>
        profile.onPend(irq, isEnabled, this.clock.nanos),
      onEnable: (/** @type {number} */ irq) => profile.onEnable(irq, this.clock.nanos),
      onEntry: (/** @type {number} */ n) => profile.onEntry(n, this.clock.nanos, ENTRY_CYCLES * this.machine.cycleNs),
      onReturn: () => (this.returned = true),
      onMask: (/** @type {boolean} */ masked) => profile.onMask(masked, this.clock.nanos),
      onSysReset: () => this.#requestReset({ chip: this.name, event: 'reset', detail: 'AIRCR.SYSRESETREQ' }),
      onFault: (/** @type {string} */ detail) => this.onEvent({ chip: this.name, event: 'fault', detail }),
      onLockup: (/** @type {string} */ detail) => this.#halt('fault', `lockup: ${detail}`),
    };
  }

  /** @param {'reset' | 'fault'} event @param {string} detail */
  #halt(event, detail) {
    this.halted = detail;
    this.machine.core.waiting = true;
    this.onEvent({ chip: this.name, event, detail });
  }

  /** @param {number} reason */
  #watchdogFired(reason) {
    const cause = reason === REASON_TIMER ? 'timer' : 'CTRL.TRIGGER';
    if (!(this.machine.watchdogSelection & PSM_UP_TO_PROC0)) {
      console.error(`${this.name}: watchdog (${cause}), but PSM_WDSEL selects nothing that restarts the processor`);
      return;
    }
    this.#requestReset({ chip: this.name, event: 'watchdog', detail: cause });
  }

  /** @param {ChipEvent} event */
  #requestReset(event) {
    this.pendingReset ??= event;
    this.machine.core.waiting = false;
    this.machine.core.interruptsUpdated = true;
  }

  /** @param {number} global nanoseconds */
  toLocal(global) {
    return this.crystal.toLocal(global);
  }

  /** @param {number} local nanoseconds since the last boot */
  toGlobal(local) {
    return this.crystal.toGlobal(local);
  }

  /** How much faster than global time its clock goes now. */
  get rate() {
    return 1 + this.crystal.ppmAt(this.now) * 1e-6;
  }

  /** Global time that the chip has reached. */
  get now() {
    return this.toGlobal(this.clock.nanos);
  }

  /** Global time at which something may happen here: now while the core runs. @param {number} nowNs */
  nextNs(nowNs) {
    if (!this.isOn) return Infinity;
    if (!this.machine.core.waiting) return Math.max(nowNs, this.bootNs);
    const alarm = this.clock.first;
    return alarm ? this.toGlobal(alarm.nanos) : Infinity;
  }

  /** Runs until the local clock has reached a global time; the last instruction may end a few cycles later. */
  runTo(/** @type {number} */ globalNs) {
    if (!this.isOn || globalNs <= this.bootNs) return;
    while (this.#runLocal(this.toLocal(globalNs))) this.#restart();
  }

  /** True: a reset is due. @param {number} end local time */
  #runLocal(end) {
    const { machine, profile } = this;
    const { clock, core, cpu, exceptions } = machine;
    let executed = 0;
    while (clock.nanos < end) {
      if (core.waiting) {
        this.#sleep(end);
        continue;
      }
      if (core.interruptsUpdated) {
        if (this.pendingReset) break;
        if (exceptions.takeException()) {
          clock.advanceTo(clock.nanos + ENTRY_CYCLES * this.machine.cycleNs);
          continue;
        }
      }
      const cycles = cpu.step() + exceptions.extraCycles;
      exceptions.extraCycles = 0;
      executed++;
      const next = clock.nanos + cycles * machine.cycleNs;
      if (clock.first !== null && clock.first.nanos <= next) clock.advanceTo(next);
      else clock.nanos = next;
      if (this.returned) {
        this.returned = false;
        profile.onReturn(next);
      }
      if (core.waiting && !this.halted && exceptions.wakes()) core.waiting = false;
    }
    profile.instructions += executed;
    return this.pendingReset !== null && clock.nanos < end;
  }

  /** Goes to the next alarm, or to `end` if none comes before. @param {number} end local time */
  #sleep(end) {
    const { machine } = this;
    const { clock, core } = machine;
    const alarm = clock.first;
    const from = clock.nanos;
    clock.advanceTo(alarm && alarm.nanos < end ? Math.max(alarm.nanos, from) : end);
    if (this.halted && !this.pendingReset) core.waiting = true;
    // The core wakes with its own clock, whatever the quantum.
    if (!core.waiting) clock.advanceTo(Math.ceil(clock.nanos / machine.cycleNs) * machine.cycleNs);
    if (!machine.exceptions.polling) this.profile.sleepNs += clock.nanos - from;
  }

  #restart() {
    const event = this.pendingReset;
    const globalNs = this.now;
    this.profile.reboot(this.clock.nanos);
    this.#boot(globalNs);
    if (event) this.onEvent(event);
  }

  /** The RUN pin: everything but RAM is reset, the watchdog's memory too. @param {number} globalNs */
  reset(globalNs) {
    if (!this.isOn) throw new Error(`chip ${this.name} is off`);
    this.watchdogMemory = new WatchdogMemory(HAD_RUN);
    this.profile.reboot(this.clock.nanos);
    this.#boot(globalNs);
    this.onEvent({ chip: this.name, event: 'reset', detail: 'RUN pin' });
  }

  powerOff() {
    this.isOn = false;
    this.pins.powerOff();
  }

  /** RAM comes up as noise: a fixed pattern here, so that a run can be repeated. @param {number} globalNs */
  powerOn(globalNs) {
    if (this.isOn) throw new Error(`chip ${this.name} is on`);
    this.isOn = true;
    fillWithNoise(this.sram);
    this.watchdogMemory = new WatchdogMemory(HAD_POR);
    this.profile.reboot(this.clock.nanos);
    this.#boot(globalNs);
  }

  /** @param {string | undefined} symbol @param {number | undefined} address @param {number} count */
  locate(symbol, address, count) {
    let at = address;
    if (symbol !== undefined) {
      const found = this.image.symbols.get(symbol);
      if (!found) throw new Error(`chip ${this.name}: no symbol "${symbol}" in its image`);
      at = found.address + (address ?? 0);
    }
    if (at === undefined) throw new Error('give a symbol or an address');
    const memory = at >= RAM ? this.sram : this.flash.array;
    const offset = at - (at >= RAM ? RAM : XIP);
    if (offset < 0 || offset + count > memory.length) {
      throw new Error(`chip ${this.name}: 0x${at.toString(16)} and ${count} bytes are not in RAM or flash`);
    }
    return memory.subarray(offset, offset + count);
  }

  resetProfile() {
    this.profile.reset(this.clock.nanos);
    for (const counters of this.counters) Object.assign(counters, new UartCounters());
  }

  report() {
    return {
      now_ns: this.now,
      ...this.profile.report(this.clock.nanos, this.machine.cycleNs),
      uarts: this.counters.map((c) => ({
        rx_bytes: c.rxBytes,
        tx_bytes: c.txBytes,
        overruns: c.overruns,
        rx_wait_ns_max: Math.round(c.rxWaitNsMax),
      })),
    };
  }
}

/** xorshift32. @param {Uint8Array} bytes */
function fillWithNoise(bytes) {
  let state = 0x2545f491;
  for (let i = 0; i < bytes.length; i++) {
    state ^= state << 13;
    state ^= state >>> 17;
    state ^= state << 5;
    bytes[i] = state;
  }
}

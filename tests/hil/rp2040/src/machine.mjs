// The model of one RP2040 between two resets: the package's parts, their mends and what replaces them.
import { RP2040 } from 'rp2040js';
import { BootRom } from './bootrom.mjs';
import { installBus, XIP } from './bus.mjs';
import { VirtualClock } from './clock.mjs';
import { Exceptions } from './core.mjs';
import { Dma } from './dma.mjs';
import { mendResets, mendTimerAlarms, stopPio } from './mends.mjs';
import { Pl011 } from './pl011.mjs';
import { Pwm } from './pwm.mjs';
import { Ssi, XipControl } from './ssi.mjs';
import { ChipReset, Watchdog } from './watchdog.mjs';

/** The vector table behind boot2's 256 bytes. */
const VECTORS = XIP + 0x100;
const SSI_PAGE = 0x18000;
const PSM_PAGE = 0x40010;
const WATCHDOG_PAGE = 0x40058;
const CHIP_RESET_PAGE = 0x40064;
const XIP_CTRL_PAGE = 0x14000;
const DMA_PAGE = 0x50000;
const PWM_PAGE = 0x40050;
const PSM_WDSEL = 0x08;
const UARTS = [
  { irq: 20, dreq: { tx: 20, rx: 21 }, page: 0x40034 },
  { irq: 21, dreq: { tx: 22, rx: 23 }, page: 0x40038 },
];

/**
 * What outlives a reset, and whom to tell.
 * @typedef {object} MachineParts
 * @property {string} name
 * @property {Uint8Array} sram
 * @property {import('./flash.mjs').Flash} flash
 * @property {import('./watchdog.mjs').WatchdogMemory} watchdogMemory
 * @property {import('./pl011.mjs').UartCounters[]} counters
 * @property {Record<string, boolean>} straps
 * @property {import('./core.mjs').CoreEvents} events
 * @property {(reason: number) => void} onWatchdog
 * @property {() => void} onUsbBoot
 */

export class Machine {
  /**
   * Every register at its reset value. Starts at the image's reset vector with XIP on, as boot2 leaves it, and with the
   * ring oscillator as clock.
   * @param {MachineParts} parts
   */
  constructor(parts) {
    this.name = parts.name;
    this.events = parts.events;
    this.clock = new VirtualClock();
    const rp = (this.rp = new RP2040(this.clock));
    this.core = rp.core;
    rp.logger = this.#logger();
    Object.assign(rp, { sram: parts.sram, sramView: new DataView(parts.sram.buffer) });
    /** @type {import('./bus.mjs').BusState} */
    this.bus = { xip: true, flash: parts.flash.array, onError: (detail, isFetch) => this.#busError(detail, isFetch) };
    installBus(rp, this.bus);
    this.dma = new Dma(rp);
    Object.assign(rp, { dma: this.dma });
    rp.peripherals[DMA_PAGE] = this.dma;
    this.pwm = new Pwm(rp);
    Object.assign(rp, { pwm: this.pwm });
    rp.peripherals[PWM_PAGE] = this.pwm;
    this.exceptions = new Exceptions(rp, this.bus, parts.events);
    this.cpu = this.exceptions.cpu;
    this.uarts = UARTS.map(({ irq, dreq }, i) => new Pl011(rp, `UART${i}`, irq, dreq, parts.counters[i]));
    UARTS.forEach(({ page }, i) => (rp.peripherals[page] = this.uarts[i]));
    this.ssi = new Ssi(rp, parts.flash, (on) => (this.bus.xip = on));
    rp.peripherals[SSI_PAGE] = this.ssi;
    this.watchdog = new Watchdog(rp, parts.watchdogMemory, parts.onWatchdog);
    rp.peripherals[WATCHDOG_PAGE] = this.watchdog;
    rp.peripherals[CHIP_RESET_PAGE] = new ChipReset(rp, parts.watchdogMemory);
    rp.peripherals[XIP_CTRL_PAGE] = new XipControl(rp, 'XIP_CTRL');
    this.rom = new BootRom(rp, this.exceptions, parts.flash, this.ssi, parts.onUsbBoot);
    mendTimerAlarms(rp);
    mendResets(rp, this.uarts, this.dma, this.pwm);
    stopPio(rp, (message) => rp.logger.warn('PIO', message));
    for (const [pin, level] of Object.entries(parts.straps)) rp.gpio[Number(pin)].setInputValue(level);
    rp.addClockListener((hz) => (this.cycleNs = 1e9 / hz));
    rp.clkSys = rp.clkPeri = rp.roscFreq;
    this.cycleNs = 1e9 / rp.clkSys;
    rp.core.VTOR = VECTORS;
    rp.core.reset();
  }

  /** Warnings of the package once each on stderr; an instruction that it does not know is a fault. */
  #logger() {
    const seen = new Set();
    const log = (/** @type {string} */ component, /** @type {string} */ message) => {
      if (component === 'CortexM0Core') {
        if (message.startsWith('Warning: Instruction at')) {
          this.exceptions.raise('undefined instruction', this.core.PC - 2);
        }
        return;
      }
      // rp2040-hal clears these registers at its start, and the package has none of them; see the README.
      if (component === 'USB' && message.startsWith('Unimplemented peripheral')) return;
      const line = `${this.name}: ${component}: ${message}`;
      if (seen.has(line)) return;
      seen.add(line);
      console.error(line);
    };
    return { debug() {}, info() {}, warn: log, error: log };
  }

  /** @param {string} detail @param {boolean} isFetch */
  #busError(detail, isFetch = false) {
    if (this.dma.isMaster) {
      this.dma.busError = true;
      this.events.onFault(`DMA: ${detail}`);
      return;
    }
    // Under execution the PC is two past the instruction; while one is fetched it is at it.
    this.exceptions.raise(detail, isFetch ? this.core.PC : this.core.PC - 2);
  }

  /** The stages of the power-on state machine that the watchdog restarts (datasheet 2.13, WDSEL). */
  get watchdogSelection() {
    return this.rp.peripherals[PSM_PAGE].readUint32(PSM_WDSEL);
  }
}

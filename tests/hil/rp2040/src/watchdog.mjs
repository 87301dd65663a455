// The watchdog. RP2040 datasheet 4.7. The package's own counts, but resets nothing and reads back neither REASON after
// a reset nor a stopped tick. Errata RP2040-E1: the counter goes down by two each tick of 1 us.
import { BasePeripheral } from 'rp2040js';

const CTRL = 0x00;
const LOAD = 0x04;
const REASON = 0x08;
const SCRATCH0 = 0x0c;
const SCRATCH7 = 0x28;
const TICK = 0x2c;

const CTRL_TRIGGER = 1 << 31;
const CTRL_ENABLE = 1 << 30;
const CTRL_PAUSES = 7 << 24;
const COUNT_MASK = 0xffffff;
const TICK_RUNNING = 1 << 10;
const TICK_ENABLE = 1 << 9;

const VREG = 0x00;
const BROWN_OUT = 0x04;
const VREG_STABLE = 1 << 12;
/** CHIP_RESET: power-on or brown-out, and the RUN pin. */
export const HAD_POR = 1 << 8;
export const HAD_RUN = 1 << 16;

export const REASON_TIMER = 1;
export const REASON_FORCE = 2;

/** What outlives a reset by the watchdog: cleared by the RUN pin and at power-on only (datasheet 4.7). */
export class WatchdogMemory {
  /** @param {number} chipReset why the chip was reset last: `HAD_POR` or `HAD_RUN` */
  constructor(chipReset) {
    this.chipReset = chipReset;
  }

  reason = 0;
  scratch = new Uint32Array(8);
}

/** Regulator and reset cause (datasheet 2.10); the package answers all ones. Only CHIP_RESET means something here. */
export class ChipReset extends BasePeripheral {
  /** @param {import('rp2040js').RP2040} rp @param {WatchdogMemory} memory */
  constructor(rp, memory) {
    super(rp, 'VREG_AND_CHIP_RESET');
    this.memory = memory;
    this.vreg = 0xb1;
    this.brownOut = 0x91;
  }

  /** @param {number} offset */
  readUint32(offset) {
    if (offset === VREG) return this.vreg | VREG_STABLE;
    return offset === BROWN_OUT ? this.brownOut : this.memory.chipReset;
  }

  /** @param {number} offset @param {number} value */
  writeUint32(offset, value) {
    if (offset === VREG) this.vreg = value & 0xf3;
    else if (offset === BROWN_OUT) this.brownOut = value & 0xf1;
  }
}

export class Watchdog extends BasePeripheral {
  /**
   * @param {import('rp2040js').RP2040} rp
   * @param {WatchdogMemory} memory
   * @param {(reason: number) => void} onReset
   */
  constructor(rp, memory, onReset) {
    super(rp, 'WATCHDOG');
    this.clock = rp.clock;
    this.memory = memory;
    this.onReset = onReset;
    this.enabled = false;
    this.pauses = CTRL_PAUSES;
    /** Enabled by reset, with no length before software gives one. */
    this.tick = TICK_ENABLE;
    /** Counter at `sinceNs`; it runs down from there. */
    this.count = 0;
    this.sinceNs = 0;
    this.alarm = this.clock.createAlarm(() => this.#expire());
  }

  get running() {
    return this.enabled && (this.tick & TICK_ENABLE) !== 0;
  }

  /** Length of a tick: CYCLES of clk_ref (datasheet 4.7, tick). */
  get tickNs() {
    const { rp2040 } = this;
    return ((this.tick & 0x1ff || 1) * 1e9) / (rp2040.clocks.refFreq || rp2040.xoscFreq);
  }

  get counter() {
    if (!this.running) return this.count;
    return Math.max(0, this.count - 2 * Math.floor((this.clock.nanos - this.sinceNs) / this.tickNs));
  }

  #restart() {
    this.sinceNs = this.clock.nanos;
    this.alarm.cancel();
    if (this.running) this.alarm.schedule(Math.ceil(this.count / 2) * this.tickNs);
  }

  #expire() {
    if (this.running) this.#fire(REASON_TIMER);
  }

  /** @param {number} reason */
  #fire(reason) {
    this.memory.reason = reason;
    this.onReset(reason);
  }

  /** @param {number} offset */
  readUint32(offset) {
    if (offset >= SCRATCH0 && offset <= SCRATCH7) return this.memory.scratch[(offset - SCRATCH0) >> 2];
    switch (offset) {
      case CTRL:
        return (this.enabled ? CTRL_ENABLE : 0) | this.pauses | this.counter;
      case LOAD:
        return 0;
      case REASON:
        return this.memory.reason;
      case TICK:
        return this.tick | (this.tick & TICK_ENABLE ? TICK_RUNNING : 0);
    }
    return super.readUint32(offset);
  }

  /** @param {number} offset @param {number} value */
  writeUint32(offset, value) {
    if (offset >= SCRATCH0 && offset <= SCRATCH7) {
      this.memory.scratch[(offset - SCRATCH0) >> 2] = value;
      return;
    }
    switch (offset) {
      case CTRL:
        this.count = this.counter;
        this.enabled = (value & CTRL_ENABLE) !== 0;
        this.pauses = value & CTRL_PAUSES;
        this.#restart();
        if (value & CTRL_TRIGGER) this.#fire(REASON_FORCE);
        break;
      case LOAD:
        this.count = value & COUNT_MASK;
        this.#restart();
        break;
      case TICK:
        this.count = this.counter;
        this.tick = value & 0x3ff;
        this.#restart();
        break;
      default:
        super.writeUint32(offset, value);
    }
  }
}

// The PWM block as a set of counters: eight slices with divisor, TOP and wrap interrupt. RP2040 datasheet 4.5.
// In whole cycles of the system clock, so that no counter ever drifts from another. The package's own counts in
// floating point, rounds reads to the nearest count and lets its wraps drift with a fractional divisor.
// Outputs are what TOP and CC say: `report` tells which values are in use and at which pins; edges of these pins are not made.
// Not modelled: phase-correct mode, PH_ADV, PH_RET, and counting by pin B.
import { BasePeripheral } from 'rp2040js';

// Registers of a slice, then those of the block (datasheet 4.5, list of registers).
const CSR = 0x00;
const DIV = 0x04;
const CTR = 0x08;
const CC = 0x0c;
const TOP = 0x10;
const SLICE_BYTES = 0x14;
const SLICES = 8;
const EN = 0xa0;
const INTR = 0xa4;
const INTE = 0xa8;
const INTF = 0xac;
const INTS = 0xb0;

const CSR_EN = 1 << 0;
const CSR_PH_CORRECT = 1 << 1;
const CSR_DIVMODE = 3 << 4;
const CSR_INVERT_A = 1 << 2;
const CSR_INVERT_B = 1 << 3;
const CSR_PHASE = 3 << 6;
const CSR_WRITABLE = 0x3f;
/** INT at 0 divides by 256. */
const DIV_WHOLE = 256 << 4;

const IRQ_WRAP = 4;
const DREQ_WRAP0 = 24;
/** IO_BANK0's function that leads a slice's outputs to a pin (datasheet 2.19.2). */
const FUNCTION_PWM = 4;
/** A whole cycle may be a hair below itself in floating point. */
const HAIR = 1e-6;

/** One counter. Its state is that of an instant, its base, and what follows from it. */
class Slice {
  csr = 0;
  div = 0x10;
  cc = 0;
  top = 0xffff;
  /** What the counter wraps behind: TOP as it was at the last wrap. */
  topInUse = 0xffff;
  /** What the outputs are compared with: CC as it was at the last wrap. */
  ccInUse = 0;
  baseNs = 0;
  baseCount = 0;
  /** The divisor's accumulator at the base, sixteenths of a cycle. */
  carry = 0;

  get isRunning() {
    return (this.csr & CSR_EN) !== 0 && (this.csr & (CSR_DIVMODE | CSR_PH_CORRECT)) === 0;
  }

  /** Sixteenths of a cycle a count takes. */
  get sixteenths() {
    return this.div >= 0x10 ? this.div : this.div + DIV_WHOLE;
  }

  /**
   * The cycle after the base with which its n-th count is complete. Each period has INT cycles, and one more whenever
   * the sum of FRAC carries: first-order sigma-delta (datasheet 4.5.2.4). @param {number} n
   */
  cycleOf(n) {
    return Math.floor((n * this.sixteenths + this.carry) / 16);
  }

  /** Counts that are complete so many cycles after the base. @param {number} cycles */
  counts(cycles) {
    return Math.floor((16 * (cycles + 1) - this.carry - 1) / this.sixteenths);
  }
}

/** Takes the place of the package's `RPPWM`. */
export class Pwm extends BasePeripheral {
  /** Fields that the package's GPIO and clocks look at: no output, and no timers of its own. */
  gpioValue = 0;
  gpioDirection = 0;
  /** @type {never[]} */
  channels = [];
  intRaw = 0;
  intEnable = 0;
  intForce = 0;

  /** @param {import('rp2040js').RP2040} rp */
  constructor(rp) {
    super(rp, 'PWM');
    this.rp = rp;
    this.clock = /** @type {import('./clock.mjs').VirtualClock} */ (rp.clock);
    this.slices = Array.from({ length: SLICES }, () => new Slice());
    this.wraps = this.slices.map((_, i) => this.clock.createAlarm(() => this.#wrap(i)));
    rp.addClockListener((_hz, before) => {
      for (const slice of this.slices) this.#rebase(slice, 1e9 / before);
      this.slices.forEach((_, i) => this.#arm(i));
    });
  }

  /** Input of a pin: no slice counts by one. */
  gpioOnInput() {}

  reset() {
    for (const alarm of this.wraps) alarm.cancel();
    this.slices.forEach((slice) => Object.assign(slice, new Slice()));
    Object.assign(this, { intRaw: 0, intEnable: 0, intForce: 0 });
    this.#interrupts();
  }

  get #cycleNs() {
    return 1e9 / this.rp.clkSys;
  }

  /** Counts since the base. @param {Slice} slice @param {number} [cycleNs] */
  #counts(slice, cycleNs = this.#cycleNs) {
    if (!slice.isRunning) return 0;
    return slice.counts(Math.floor((this.clock.nanos - slice.baseNs) / cycleNs + HAIR));
  }

  /** @param {Slice} slice @param {number} n counts since the base */
  #counterAt(slice, n) {
    return (slice.baseCount + n) % (slice.topInUse + 1);
  }

  /**
   * Takes now as the base: before anything changes that the counts depend on.
   * @param {Slice} slice @param {number} [cycleNs]
   */
  #rebase(slice, cycleNs) {
    slice.baseCount = this.#counterAt(slice, this.#counts(slice, cycleNs));
    slice.baseNs = this.clock.nanos;
    slice.carry = 0;
  }

  /** Has the next wrap come. @param {number} i */
  #arm(i) {
    const slice = this.slices[i];
    this.wraps[i].cancel();
    if (!slice.isRunning) return;
    const period = slice.topInUse + 1;
    const n = this.#counts(slice);
    const next = n + period - ((slice.baseCount + n) % period);
    this.wraps[i].scheduleAt(slice.baseNs + slice.cycleOf(next) * this.#cycleNs);
  }

  /** @param {number} i */
  #wrap(i) {
    const slice = this.slices[i];
    slice.ccInUse = slice.cc;
    if (slice.topInUse !== slice.top) {
      const n = this.#counts(slice);
      const sixteenths = n * slice.sixteenths + slice.carry;
      slice.baseNs += Math.floor(sixteenths / 16) * this.#cycleNs;
      slice.carry = sixteenths % 16;
      slice.baseCount = 0;
      slice.topInUse = slice.top;
    }
    this.intRaw |= 1 << i;
    this.#interrupts();
    this.rp.dma.setDREQ(DREQ_WRAP0 + i);
    this.#arm(i);
  }

  #interrupts() {
    this.rp.setInterrupt(IRQ_WRAP, this.#status !== 0);
  }

  get #status() {
    return (this.intRaw & this.intEnable) | this.intForce;
  }

  /**
   * What each slice puts out: high for `a` of `top` + 1 counts, and what it will from its next wrap on. `pins_a` and `pins_b` are
   * the pins that IO_BANK0 has select it.
   */
  report() {
    return this.slices.map((slice, i) => {
      const pins = (/** @type {number} */ channel) =>
        this.rp.gpio.filter((pin) => pin.functionSelect === FUNCTION_PWM && (pin.index & 15) === 2 * i + channel);
      const values = (/** @type {number} */ top, /** @type {number} */ cc) => ({ top, a: cc & 0xffff, b: cc >>> 16 });
      return {
        enabled: (slice.csr & CSR_EN) !== 0,
        invert_a: (slice.csr & CSR_INVERT_A) !== 0,
        invert_b: (slice.csr & CSR_INVERT_B) !== 0,
        count_cycles: slice.sixteenths / 16,
        ...values(slice.topInUse, slice.ccInUse),
        next: values(slice.top, slice.cc),
        pins_a: pins(0).map((pin) => pin.index),
        pins_b: pins(1).map((pin) => pin.index),
      };
    });
  }

  /** @param {number} offset */
  readUint32(offset) {
    if (offset < EN) {
      const slice = this.slices[Math.floor(offset / SLICE_BYTES)];
      switch (offset % SLICE_BYTES) {
        case CSR:
          return slice.csr;
        case DIV:
          return slice.div;
        case CTR:
          return this.#counterAt(slice, this.#counts(slice));
        case CC:
          return slice.cc;
        case TOP:
          return slice.top;
      }
    }
    switch (offset) {
      case EN:
        return this.slices.reduce((all, slice, i) => all | ((slice.csr & CSR_EN) << i), 0);
      case INTR:
        return this.intRaw;
      case INTE:
        return this.intEnable;
      case INTF:
        return this.intForce;
      case INTS:
        return this.#status;
    }
    return super.readUint32(offset);
  }

  /** @param {number} offset @param {number} value */
  writeUint32(offset, value) {
    if (offset < EN) {
      this.#writeSlice(Math.floor(offset / SLICE_BYTES), offset % SLICE_BYTES, value >>> 0);
      return;
    }
    switch (offset) {
      case EN:
        this.slices.forEach((slice, i) => this.#control(i, (slice.csr & ~CSR_EN) | ((value >> i) & 1)));
        return;
      case INTR:
        this.intRaw &= ~this.rawWriteValue;
        break;
      case INTE:
        this.intEnable = value & 0xff;
        break;
      case INTF:
        this.intForce = value & 0xff;
        break;
      default:
        super.writeUint32(offset, value);
        return;
    }
    this.#interrupts();
  }

  /** @param {number} i @param {number} register @param {number} value */
  #writeSlice(i, register, value) {
    const slice = this.slices[i];
    if (register === CSR) {
      this.#control(i, value);
      return;
    }
    if (register === CC) {
      slice.cc = value;
      // Taken with the next wrap, or at once where the slice stands (datasheet 4.5.2.3).
      if (!slice.isRunning) slice.ccInUse = slice.cc;
      return;
    }
    if (register === TOP) {
      slice.top = value & 0xffff;
      // Taken with the next wrap, or at once where the slice stands (datasheet 4.5.2.3).
      if (slice.isRunning) return;
      slice.topInUse = slice.top;
    } else if (register === CTR) {
      this.#rebase(slice);
      slice.baseCount = value & 0xffff;
    } else if (register === DIV) {
      this.#rebase(slice);
      slice.div = value & 0xfff;
    }
    this.#arm(i);
  }

  /** @param {number} i @param {number} value */
  #control(i, value) {
    const slice = this.slices[i];
    if (value & (CSR_DIVMODE | CSR_PH_CORRECT | CSR_PHASE)) {
      this.rp.logger.warn('PWM', `slice ${i}: CSR 0x${value.toString(16)}: only free-running counters are modelled`);
    }
    if (slice.csr === (value & CSR_WRITABLE)) return;
    this.#rebase(slice);
    slice.csr = value & CSR_WRITABLE;
    this.#arm(i);
  }
}

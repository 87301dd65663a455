// The DMA controller. RP2040 datasheet 2.5. The package's own moves every word in no time, orders transfers of the same
// instant backwards and never re-arms a pulsed request; here each transfer takes bus cycles and channels take turns.
// Not modelled: the sniffer (2.5), and more than one transfer in flight.
import { BasePeripheral } from 'rp2040js';

const CHANNELS = 12;
const FIRST_TIMER = 0x3b;
const PERMANENT = 0x3f;
const PWM_WRAP_FIRST = 24;
const PWM_WRAP_LAST = 31;
/** Counters of pulsed requests saturate (datasheet 2.5, CHx_DBG_CTDREQ: six bits). */
const CREDIT_MAX = 63;

const IRQ_0 = 11;
const IRQ_1 = 12;

const CTRL_EN = 1 << 0;
const CTRL_HIGH_PRIORITY = 1 << 1;
const CTRL_INCR_READ = 1 << 4;
const CTRL_INCR_WRITE = 1 << 5;
const CTRL_RING_SEL = 1 << 10;
const CTRL_IRQ_QUIET = 1 << 21;
const CTRL_BSWAP = 1 << 22;
const CTRL_BUSY = 1 << 24;
const CTRL_WRITE_ERROR = 1 << 29;
const CTRL_READ_ERROR = 1 << 30;
const CTRL_AHB_ERROR = 1 << 31;
const CTRL_WRITABLE = 0xffffff;

const INTR = 0x400;
const INTE0 = 0x404;
const INTF0 = 0x408;
const INTS0 = 0x40c;
const INTE1 = 0x414;
const INTF1 = 0x418;
const INTS1 = 0x41c;
const TIMER0 = 0x420;
const TIMER3 = 0x42c;
const MULTI_CHAN_TRIGGER = 0x430;
const CHAN_ABORT = 0x444;
const N_CHANNELS = 0x448;
const DBG = 0x800;

/**
 * Cycles from a request to the issue of its first access: request synchroniser, arbitration, address generation.
 * The datasheet gives no figure; three register stages are assumed.
 */
export const ISSUE_CYCLES = 3;

/** The registers of a channel in the order of each alias (datasheet 2.5, CHx_AL1 to CHx_AL3). */
const ALIASES = [
  ['readAddr', 'writeAddr', 'count', 'ctrl'],
  ['ctrl', 'readAddr', 'writeAddr', 'count'],
  ['ctrl', 'count', 'readAddr', 'writeAddr'],
  ['ctrl', 'writeAddr', 'count', 'readAddr'],
];

export class Channel {
  /** @param {number} index */
  constructor(index) {
    this.index = index;
    this.readAddr = 0;
    this.writeAddr = 0;
    this.count = 0;
    this.reload = 0;
    this.ctrl = index << 11;
    /** Requests of a pulsed source (PWM wrap, pacing timer) not yet served. */
    this.credit = 0;
    /** Local time of a pacing timer's next request. */
    this.nextPaceNs = 0;
  }

  get request() {
    return (this.ctrl >> 15) & 0x3f;
  }

  get chainTo() {
    return (this.ctrl >> 11) & 0xf;
  }

  get sizeLog2() {
    return Math.min(2, (this.ctrl >> 2) & 3);
  }

  get running() {
    return (this.ctrl & (CTRL_EN | CTRL_BUSY)) === (CTRL_EN | CTRL_BUSY);
  }

  /** An address after one transfer; a ring of 2^n bytes changes the low n bits only (datasheet 2.5, CTRL.RING_SIZE). */
  advance(/** @type {number} */ address, /** @type {boolean} */ isWrite) {
    const ringBits = (this.ctrl >> 6) & 0xf;
    const next = address + (1 << this.sizeLog2);
    if (ringBits === 0 || ((this.ctrl & CTRL_RING_SEL) !== 0) !== isWrite) return next >>> 0;
    const mask = (1 << ringBits) - 1;
    return ((address & ~mask) | (next & mask)) >>> 0;
  }
}

export class Dma extends BasePeripheral {
  /** @param {import('rp2040js').RP2040} rp */
  constructor(rp) {
    super(rp, 'DMA');
    this.rp = rp;
    this.clock = /** @type {import('./clock.mjs').VirtualClock} */ (rp.clock);
    this.channels = Array.from({ length: CHANNELS }, (_, i) => new Channel(i));
    /** Requests that are held, by number (datasheet 2.5, DREQ table). @type {boolean[]} */
    this.dreq = new Array(64).fill(false);
    this.intr = 0;
    this.inte = [0, 0];
    this.intf = [0, 0];
    this.pace = [0, 0, 0, 0];
    /** @type {Channel | null} whose transfer is on the bus */
    this.current = null;
    this.last = CHANNELS - 1;
    /** Set by the bus during a transfer that fails. */
    this.busError = false;
    this.isMaster = false;
    this.done = this.clock.createAlarm(() => this.#complete());
    this.paceAlarm = this.clock.createAlarm(() => this.#arbitrate());
  }

  reset() {
    this.done.cancel();
    this.paceAlarm.cancel();
    this.current = null;
    this.channels.forEach((_, i) => (this.channels[i] = new Channel(i)));
    this.intr = 0;
    this.inte.fill(0);
    this.intf.fill(0);
    this.#interrupts();
  }

  /** A request line rises, or pulses. @param {number} number */
  setDREQ(number) {
    if (number >= PWM_WRAP_FIRST && number <= PWM_WRAP_LAST) {
      for (const channel of this.channels) {
        if (channel.request === number && channel.running) channel.credit = Math.min(CREDIT_MAX, channel.credit + 1);
      }
    } else if (this.dreq[number]) {
      return;
    } else {
      this.dreq[number] = true;
    }
    this.#arbitrate();
  }

  /** @param {number} number */
  clearDREQ(number) {
    this.dreq[number] = false;
  }

  /** Whether a channel's request allows its next transfer now. @param {Channel} channel */
  #ready(channel) {
    if (!channel.running) return false;
    const { request } = channel;
    if (request === PERMANENT) return true;
    if (request >= FIRST_TIMER) return this.#paced(channel);
    return this.dreq[request] || channel.credit > 0;
  }

  /**
   * A pacing timer requests X / Y times a system clock cycle (datasheet 2.5, pacing timers).
   * @param {Channel} channel
   */
  #paced(channel) {
    const timer = this.pace[channel.request - FIRST_TIMER];
    const x = timer >>> 16;
    const y = timer & 0xffff;
    if (x === 0 || y === 0) return false;
    const periodNs = Math.max(1, y / x) * this.#cycleNs;
    const now = this.clock.nanos;
    if (channel.nextPaceNs === 0) channel.nextPaceNs = now + periodNs;
    if (channel.nextPaceNs > now) {
      if (!this.paceAlarm.scheduled || this.paceAlarm.nanos > channel.nextPaceNs) {
        this.paceAlarm.scheduleAt(channel.nextPaceNs);
      }
      return false;
    }
    return true;
  }

  get #cycleNs() {
    return 1e9 / this.rp.clkSys;
  }

  /**
   * Puts the next transfer on the bus if it is free: high priority first, then in turn (datasheet 2.5,
   * CTRL.HIGH_PRIORITY).
   * @param {Channel | null} previous the channel whose transfer has just ended; its pipeline is full
   */
  #arbitrate(previous = null) {
    if (this.current) return;
    let chosen = null;
    for (let i = 1; i <= CHANNELS; i++) {
      const channel = this.channels[(this.last + i) % CHANNELS];
      if (!this.#ready(channel)) continue;
      if (channel.ctrl & CTRL_HIGH_PRIORITY) {
        chosen = channel;
        break;
      }
      chosen ??= channel;
    }
    if (!chosen) return;
    this.current = chosen;
    this.last = chosen.index;
    const issue = chosen === previous ? 0 : ISSUE_CYCLES;
    const cycles = issue + Math.max(accessCycles(chosen.readAddr, false), accessCycles(chosen.writeAddr, true));
    this.done.schedule(cycles * this.#cycleNs);
  }

  #complete() {
    const channel = this.current;
    if (channel?.running) this.#transfer(channel);
    this.current = null;
    this.#arbitrate(channel);
  }

  /** @param {Channel} channel */
  #transfer(channel) {
    if (channel.credit > 0) channel.credit--;
    if (channel.nextPaceNs > 0) {
      const timer = this.pace[channel.request - FIRST_TIMER] ?? 0;
      channel.nextPaceNs += Math.max(1, (timer & 0xffff) / (timer >>> 16 || 1)) * this.#cycleNs;
    }
    this.isMaster = true;
    this.busError = false;
    const value = this.#read(channel);
    const readFailed = this.busError;
    if (!readFailed) this.#write(channel, value);
    this.isMaster = false;
    if (this.busError) {
      channel.ctrl |= CTRL_AHB_ERROR | (readFailed ? CTRL_READ_ERROR : CTRL_WRITE_ERROR);
      channel.ctrl &= ~CTRL_BUSY;
      return;
    }
    if (channel.ctrl & CTRL_INCR_READ) channel.readAddr = channel.advance(channel.readAddr, false);
    if (channel.ctrl & CTRL_INCR_WRITE) channel.writeAddr = channel.advance(channel.writeAddr, true);
    channel.count = (channel.count - 1) >>> 0;
    if (channel.count === 0) this.#finish(channel);
  }

  /** @param {Channel} channel */
  #read(channel) {
    const { rp } = this;
    const { readAddr, sizeLog2 } = channel;
    const value =
      sizeLog2 === 0 ? rp.readUint8(readAddr) : sizeLog2 === 1 ? rp.readUint16(readAddr) : rp.readUint32(readAddr);
    if (!(channel.ctrl & CTRL_BSWAP) || sizeLog2 === 0) return value;
    const swapped = ((value & 0xff) << 8) | ((value >> 8) & 0xff);
    return sizeLog2 === 1 ? swapped : ((swapped << 16) | ((value >>> 8) & 0xff00) | (value >>> 24)) >>> 0;
  }

  /** @param {Channel} channel @param {number} value */
  #write(channel, value) {
    const { rp } = this;
    if (channel.sizeLog2 === 0) rp.writeUint8(channel.writeAddr, value);
    else if (channel.sizeLog2 === 1) rp.writeUint16(channel.writeAddr, value);
    else rp.writeUint32(channel.writeAddr, value);
  }

  /**
   * The transfer count has run out: interrupt, then chain (datasheet 2.5, chaining, interrupts).
   * @param {Channel} channel
   */
  #finish(channel) {
    channel.ctrl &= ~CTRL_BUSY;
    if (!(channel.ctrl & CTRL_IRQ_QUIET)) {
      this.intr |= 1 << channel.index;
      this.#interrupts();
    }
    if (channel.chainTo !== channel.index) this.#trigger(channel.chainTo);
  }

  /** @param {number} index */
  #trigger(index) {
    const channel = this.channels[index];
    if (!channel || !(channel.ctrl & CTRL_EN) || channel.ctrl & CTRL_BUSY) return;
    channel.count = channel.reload;
    channel.credit = 0;
    channel.nextPaceNs = 0;
    if (channel.count === 0) {
      // A trigger with nothing to do ends at once.
      this.#finish(channel);
      return;
    }
    channel.ctrl |= CTRL_BUSY;
    this.#arbitrate();
  }

  #interrupts() {
    this.rp.setInterrupt(IRQ_0, ((this.intr & this.inte[0]) | this.intf[0]) !== 0);
    this.rp.setInterrupt(IRQ_1, ((this.intr & this.inte[1]) | this.intf[1]) !== 0);
  }

  /** @param {number} offset */
  readUint32(offset) {
    if (offset < CHANNELS * 0x40) {
      const channel = this.channels[offset >> 6];
      const field = ALIASES[(offset >> 4) & 3][(offset >> 2) & 3];
      return (field === 'ctrl' ? channel.ctrl : /** @type {any} */ (channel)[field]) >>> 0;
    }
    if (offset >= DBG && offset < DBG + CHANNELS * 0x40) {
      const channel = this.channels[(offset - DBG) >> 6];
      return (offset & 0x3f) === 4 ? channel.reload : channel.credit;
    }
    if (offset >= TIMER0 && offset <= TIMER3) return this.pace[(offset - TIMER0) >> 2];
    switch (offset) {
      case INTR:
        return this.intr;
      case INTE0:
        return this.inte[0];
      case INTE1:
        return this.inte[1];
      case INTF0:
        return this.intf[0];
      case INTF1:
        return this.intf[1];
      case INTS0:
        return (this.intr & this.inte[0]) | this.intf[0];
      case INTS1:
        return (this.intr & this.inte[1]) | this.intf[1];
      case MULTI_CHAN_TRIGGER:
        return 0;
      case CHAN_ABORT:
        return 0;
      case N_CHANNELS:
        return CHANNELS;
    }
    return super.readUint32(offset);
  }

  /** @param {number} offset @param {number} value */
  writeUint32(offset, value) {
    if (offset < CHANNELS * 0x40) {
      this.#writeChannel(this.channels[offset >> 6], (offset >> 4) & 3, (offset >> 2) & 3, value >>> 0);
      return;
    }
    if (offset >= TIMER0 && offset <= TIMER3) {
      this.pace[(offset - TIMER0) >> 2] = value >>> 0;
      this.#arbitrate();
      return;
    }
    switch (offset) {
      case INTR:
      case INTS0:
      case INTS1:
        this.intr &= ~this.rawWriteValue;
        break;
      case INTE0:
        this.inte[0] = value & 0xffff;
        break;
      case INTE1:
        this.inte[1] = value & 0xffff;
        break;
      case INTF0:
        this.intf[0] = value & 0xffff;
        break;
      case INTF1:
        this.intf[1] = value & 0xffff;
        break;
      case MULTI_CHAN_TRIGGER:
        for (const channel of this.channels) if ((value >> channel.index) & 1) this.#trigger(channel.index);
        break;
      case CHAN_ABORT:
        for (const channel of this.channels) if ((value >> channel.index) & 1) channel.ctrl &= ~CTRL_BUSY;
        break;
      default:
        super.writeUint32(offset, value);
        return;
    }
    this.#interrupts();
  }

  /**
   * The last register of each alias is a trigger; writing 0 to it is a null trigger, which raises the interrupt of a
   * quiet channel (datasheet 2.5, triggers).
   * @param {Channel} channel @param {number} alias @param {number} slot @param {number} value
   */
  #writeChannel(channel, alias, slot, value) {
    const field = ALIASES[alias][slot];
    if (field === 'count') {
      channel.reload = value;
    } else if (field === 'ctrl') {
      const cleared = value & (CTRL_READ_ERROR | CTRL_WRITE_ERROR);
      channel.ctrl = (channel.ctrl & ~CTRL_WRITABLE & ~cleared) | (value & CTRL_WRITABLE);
      if (!(channel.ctrl & (CTRL_READ_ERROR | CTRL_WRITE_ERROR))) channel.ctrl &= ~CTRL_AHB_ERROR;
    } else if (field === 'readAddr') {
      channel.readAddr = value;
    } else {
      channel.writeAddr = value;
    }
    if (slot !== 3) {
      this.#arbitrate();
    } else if (value !== 0) {
      this.#trigger(channel.index);
    } else if (channel.ctrl & CTRL_IRQ_QUIET) {
      this.intr |= 1 << channel.index;
      this.#interrupts();
    }
  }
}

/**
 * Cycles of one access: three (read) and four (write) over the APB bridge, as the core's own (datasheet 2.1), else
 * one.
 * @param {number} address @param {boolean} isWrite
 */
function accessCycles(address, isWrite) {
  if (address >>> 28 !== 4) return 1;
  return isWrite ? 4 : 3;
}

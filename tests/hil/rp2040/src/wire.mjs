// What lies between UARTs: one `Line` a direction, with delay, injected faults and a switch; and the outside endpoint.
// Times are global virtual nanoseconds.
import { sample } from './pl011.mjs';

/** @typedef {import('./pl011.mjs').Frame} Frame */
/** @typedef {import('./chip.mjs').Chip} Chip */
/** Probabilities per byte. @typedef {{ seed?: number, byte_error?: number, byte_loss?: number }} Faults */
/** @typedef {{ port: string, bytes: string, start_ns: number, end_ns: number }} PortEvent */

/** A seeded generator (mulberry32) of numbers in [0, 1). @param {number} seed */
export function generator(seed) {
  let state = seed >>> 0;
  return () => {
    state = (state + 0x6d2b79f5) >>> 0;
    let t = Math.imul(state ^ (state >>> 15), state | 1);
    t ^= t + Math.imul(t ^ (t >>> 7), t | 61);
    return ((t ^ (t >>> 14)) >>> 0) / 2 ** 32;
  };
}

/** Gathers received bytes into frames that end with a zero byte. */
export class Delimiter {
  /** @param {string} port */
  constructor(port) {
    this.port = port;
    /** @type {number[]} */
    this.bytes = [];
    this.startNs = 0;
  }

  /** @param {number} byte @param {number} startNs @param {number} endNs @returns {PortEvent | null} */
  push(byte, startNs, endNs) {
    if (this.bytes.length === 0) this.startNs = startNs;
    this.bytes.push(byte);
    if (byte !== 0) return null;
    const event = {
      port: this.port,
      bytes: Buffer.from(this.bytes).toString('hex'),
      start_ns: this.startNs,
      end_ns: endNs,
    };
    this.bytes = [];
    return event;
  }
}

/** Carries frames one way: from `frame` to `arrive`, a delay later, unless it is cut or the frame is lost. */
export class Line {
  /**
   * @param {number} delayNs
   * @param {Faults | null} faults
   * @param {number} direction 0 or 1; gives each direction its own random numbers
   */
  constructor(delayNs, faults, direction) {
    this.delayNs = delayNs;
    this.errorRate = faults?.byte_error ?? 0;
    this.lossRate = faults?.byte_loss ?? 0;
    this.random = generator((faults?.seed ?? 1) ^ (direction * 0x9e3779b9));
    this.isCut = false;
    this.bytes = 0;
    this.errors = 0;
    this.lost = 0;
    /** @type {Delimiter | null} gathers what passes, once somebody wants to see it */
    this.tap = null;
    /** @type {PortEvent[]} */
    this.tapped = [];
  }

  /** Notes what passes, where the line is tapped. @param {Frame} frame @param {number} shiftNs */
  observe(frame, shiftNs = 0) {
    if (!this.tap) return;
    const startNs = frame.startNs + this.delayNs + shiftNs;
    const event = this.tap.push(frame.data & 0xff, startNs, startNs + frame.bits * frame.bitNs);
    if (event) this.tapped.push(event);
  }

  /** A frame begins at its start, global. @param {Frame} _frame */
  frame(_frame) {
    throw new Error('a line needs an end');
  }

  /**
   * What becomes of a frame: null if it is lost, else the frame, perhaps with one data bit turned over.
   * @param {Frame} frame @returns {Frame | null}
   */
  pass(frame) {
    this.bytes++;
    if (this.isCut || (this.lossRate > 0 && this.random() < this.lossRate)) {
      this.lost++;
      return null;
    }
    if (this.errorRate === 0 || this.random() >= this.errorRate) return frame;
    this.errors++;
    return { ...frame, data: frame.data ^ (1 << Math.floor(this.random() * 8)) };
  }
}

/** A line that ends at a chip's UART. */
export class LineToChip extends Line {
  /**
   * @param {Chip} chip @param {number} uart
   * @param {number} delayNs @param {Faults | null} faults @param {number} direction
   */
  constructor(chip, uart, delayNs, faults, direction) {
    super(delayNs, faults, direction);
    this.chip = chip;
    this.uart = uart;
    /** @type {{ frame: Frame, dueNs: number }[]} on the way, in order */
    this.queue = [];
    /** Frames that came too late for the receiver's time: the quantum was too long for the rate. */
    this.late = 0;
    this.alarm = chip.clock.createAlarm(() => this.#arrive());
    chip.onBoot.push(() => this.#reattach());
  }

  /** The chip has a new clock. A frame that began before its boot is not recognised. */
  #reattach() {
    this.queue = this.queue.filter(({ frame }) => frame.startNs + this.delayNs >= this.chip.bootNs);
    this.alarm = this.chip.clock.createAlarm(() => this.#arrive());
    this.#arm();
  }

  /** @param {Frame} frame */
  frame(frame) {
    const { chip } = this;
    if (!chip.isOn || frame.startNs + this.delayNs < chip.bootNs) {
      this.bytes++;
      return;
    }
    const uart = chip.uarts[this.uart];
    const length = uart.divisor > 0 ? uart.receiveNs / chip.rate : frame.bits * frame.bitNs;
    const dueNs = frame.startNs + this.delayNs + length;
    this.queue.push({ frame, dueNs });
    if (chip.toLocal(dueNs) < chip.clock.nanos && this.late++ === 0) {
      console.error(`${chip.name}: UART${this.uart}: a character came late; its rate changed within a quantum`);
    }
    if (this.queue.length === 1) this.#arm();
  }

  #arm() {
    if (this.queue.length > 0)
      this.alarm.scheduleAt(Math.max(this.chip.toLocal(this.queue[0].dueNs), this.chip.clock.nanos));
  }

  #arrive() {
    const next = this.queue.shift();
    const frame = next && this.pass(next.frame);
    if (frame) {
      this.observe(frame);
      this.chip.uarts[this.uart].receive(frame);
    }
    this.#arm();
  }
}

/** A line that ends outside, at an endpoint with perfect timing. */
class LineOutside extends Line {
  /** @param {number} bitNs @param {number} delayNs @param {Faults | null} faults */
  constructor(bitNs, delayNs, faults) {
    super(delayNs, faults, 1);
    this.bitNs = bitNs;
    /** @type {Frame[]} */
    this.queue = [];
  }

  /** @param {Frame} frame */
  frame(frame) {
    this.queue.push({ ...frame, startNs: frame.startNs + this.delayNs });
  }

  get nextNs() {
    const [first] = this.queue;
    return first ? first.startNs + first.bits * first.bitNs : Infinity;
  }

  /** Bytes that are complete by `nowNs`. @param {number} nowNs */
  *arrived(nowNs) {
    while (this.nextNs <= nowNs) {
      const endNs = this.nextNs;
      this.observe(this.queue[0], -this.delayNs);
      const frame = this.pass(/** @type {Frame} */ (this.queue.shift()));
      if (frame) yield { byte: sample(frame, this.bitNs, 8) & 0xff, startNs: frame.startNs, endNs };
    }
  }
}

/** An endpoint outside of the chips: sends and receives 8N1 at its own exact rate. */
export class Port {
  /**
   * @param {string} name @param {Chip} chip @param {number} uart @param {number} baud
   * @param {number} delayNs @param {Faults | null} faults
   */
  constructor(name, chip, uart, baud, delayNs, faults) {
    this.name = name;
    this.bitNs = 1e9 / baud;
    this.toChip = new LineToChip(chip, uart, delayNs, faults, 0);
    this.outside = new LineOutside(this.bitNs, delayNs, faults);
    connect(chip, uart, this.outside);
    /** @type {{ bytes: Uint8Array, next: number, startNs: number }[]} what is still to be sent */
    this.sending = [];
    this.busyUntilNs = 0;
    this.delimiter = new Delimiter(name);
  }

  get lines() {
    return [this.toChip, this.outside];
  }

  /** @param {boolean} isCut */
  set cut(isCut) {
    for (const line of this.lines) line.isCut = isCut;
  }

  /** From now on what reaches the chip is told as `name:ab`, and what it sends, before any fault, as `name:ba`. */
  tap() {
    this.toChip.tap ??= new Delimiter(`${this.name}:ab`);
    this.outside.tap ??= new Delimiter(`${this.name}:ba`);
  }

  /** What passed since the last call. @returns {PortEvent[]} */
  tapped() {
    return this.lines.flatMap((line) => line.tapped.splice(0));
  }

  /** @param {Uint8Array} bytes @param {number} earliestNs */
  send(bytes, earliestNs) {
    const startNs = Math.max(earliestNs, this.busyUntilNs);
    const endNs = startNs + bytes.length * 10 * this.bitNs;
    if (bytes.length > 0) this.sending.push({ bytes, next: 0, startNs });
    this.busyUntilNs = endNs;
    return { start_ns: startNs, end_ns: endNs };
  }

  /** When something happens here next. */
  get nextNs() {
    const [first] = this.sending;
    const sends = first ? first.startNs + first.next * 10 * this.bitNs : Infinity;
    return Math.min(sends, this.outside.nextNs);
  }

  /** Puts on the line what starts before `untilNs`. @param {number} untilNs */
  pump(untilNs) {
    for (let [first] = this.sending; first; [first] = this.sending) {
      const startNs = first.startNs + first.next * 10 * this.bitNs;
      if (startNs >= untilNs) return;
      this.toChip.frame({ data: first.bytes[first.next], startNs, bitNs: this.bitNs, bits: 10, isBreak: false });
      if (++first.next === first.bytes.length) this.sending.shift();
    }
  }

  /** @param {number} nowNs @returns {PortEvent[]} */
  collect(nowNs) {
    /** @type {PortEvent[]} */
    const events = [];
    if (this.outside.nextNs > nowNs) return events;
    for (const { byte, startNs, endNs } of this.outside.arrived(nowNs)) {
      const event = this.delimiter.push(byte, startNs, endNs);
      if (event) events.push(event);
    }
    return events;
  }
}

/** Two UARTs, each one's transmitter to the other's receiver. */
export class Wire {
  /**
   * @param {string} name
   * @param {[Chip, number]} a @param {[Chip, number]} b
   * @param {number} delayNs @param {Faults | null} faults
   */
  constructor(name, a, b, delayNs, faults) {
    this.name = name;
    this.lines = [new LineToChip(...b, delayNs, faults, 0), new LineToChip(...a, delayNs, faults, 1)];
    connect(...a, this.lines[0]);
    connect(...b, this.lines[1]);
  }

  /** From now on what passes is told: frames up to their delimiters, as from ports called `name:ab` and `name:ba`. */
  tap() {
    for (const [n, line] of this.lines.entries()) line.tap ??= new Delimiter(`${this.name}:${n === 0 ? 'ab' : 'ba'}`);
  }

  /** What passed since the last call. @returns {PortEvent[]} */
  tapped() {
    return this.lines.flatMap((line) => line.tapped.splice(0));
  }

  /** @param {boolean} isCut */
  set cut(isCut) {
    for (const line of this.lines) line.isCut = isCut;
  }
}

/**
 * Leads a UART's transmitter into a line, now and after each boot.
 * @param {Chip} chip @param {number} uart @param {Line} line
 */
function connect(chip, uart, line) {
  const attach = () => {
    chip.uarts[uart].onFrame = (frame) =>
      line.frame({ ...frame, startNs: chip.toGlobal(frame.startNs), bitNs: frame.bitNs / chip.rate });
  };
  chip.onBoot.push(attach);
  attach();
}

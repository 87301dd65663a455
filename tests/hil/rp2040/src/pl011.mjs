// The UART of the RP2040: an Arm PL011 (r1p5) with 32-deep FIFOs. RP2040 datasheet 4.2; PL011 TRM (Arm DDI 0183).
// The package's own UART has no bit times, no FIFO levels, no overrun, no time-out interrupt and no receive DREQ.
import { BasePeripheral } from 'rp2040js';

// Registers (datasheet 4.2).
const UARTDR = 0x00;
const UARTRSR = 0x04;
const UARTFR = 0x18;
const UARTIBRD = 0x24;
const UARTFBRD = 0x28;
const UARTLCR_H = 0x2c;
const UARTCR = 0x30;
const UARTIFLS = 0x34;
const UARTIMSC = 0x38;
const UARTRIS = 0x3c;
const UARTMIS = 0x40;
const UARTICR = 0x44;
const UARTDMACR = 0x48;
const UARTPERIPHID0 = 0xfe0;
const IDENTIFICATION = [0x11, 0x10, 0x34, 0x00, 0x0d, 0xf0, 0x05, 0xb1];

// UARTDR and, shifted down by 8, UARTRSR.
const DR_FE = 1 << 8;
const DR_PE = 1 << 9;
const DR_BE = 1 << 10;
const DR_OE = 1 << 11;

const FR_BUSY = 1 << 3;
const FR_RXFE = 1 << 4;
const FR_TXFF = 1 << 5;
const FR_RXFF = 1 << 6;
const FR_TXFE = 1 << 7;

const LCR_BRK = 1 << 0;
const LCR_PEN = 1 << 1;
const LCR_STP2 = 1 << 3;
const LCR_FEN = 1 << 4;

const CR_UARTEN = 1 << 0;
const CR_LBE = 1 << 7;
const CR_TXE = 1 << 8;
const CR_RXE = 1 << 9;

const INT_RX = 1 << 4;
const INT_TX = 1 << 5;
const INT_RT = 1 << 6;
const INT_FE = 1 << 7;
const INT_PE = 1 << 8;
const INT_BE = 1 << 9;
const INT_OE = 1 << 10;
const INT_ERRORS = INT_FE | INT_PE | INT_BE | INT_OE;

const DMACR_RXDMAE = 1 << 0;
const DMACR_TXDMAE = 1 << 1;
const DMACR_DMAONERR = 1 << 2;

const FIFO_DEPTH = 32;
/** Levels of UARTIFLS: an eighth, a quarter, half, three quarters, seven eighths. */
const LEVELS = [4, 8, 16, 24, 28];
/** Bit periods without a new byte after which the receive time-out interrupt comes (PL011 TRM, UARTRTINTR). */
const TIMEOUT_BITS = 32;

/**
 * What a transmitter puts on the wire: one character.
 * @typedef {{ data: number, startNs: number, bitNs: number, bits: number, isBreak: boolean }} Frame
 */

/** Counters of one UART since the last profile reset. */
export class UartCounters {
  rxBytes = 0;
  txBytes = 0;
  overruns = 0;
  rxWaitNsMax = 0;
}

export class Pl011 extends BasePeripheral {
  ibrd = 0;
  fbrd = 0;
  /** Of the baud rate in 64ths, as it was latched. */
  divisor = 0;
  lcr = 0;
  cr = 0;
  ifls = 0;
  imsc = 0;
  ris = 0;
  dmacr = 0;
  rsr = 0;
  shifting = false;
  /** A character was lost since the last one that found room. */
  overrun = false;
  breakSent = false;
  looped = 0;

  /**
   * @param {import('rp2040js').RP2040} rp
   * @param {string} name
   * @param {number} irq
   * @param {{ rx: number, tx: number }} dreq
   * @param {UartCounters} [counters] kept over resets of the chip
   */
  constructor(rp, name, irq, dreq, counters = new UartCounters()) {
    super(rp, name);
    this.rp = rp;
    this.irq = irq;
    this.dreq = dreq;
    this.clock = rp.clock;
    this.counters = counters;
    /** @type {((frame: Frame) => void) | null} called at the start of a frame's first bit, in local time */
    this.onFrame = null;
    this.timeout = this.clock.createAlarm(() => this.#receiveTimeout());
    this.shiftEnd = this.clock.createAlarm(() => this.#nextFrame());
    this.loopback = this.clock.createAlarm(() => this.#loopbackEnd());
    /** @type {number[]} */
    this.rx = [];
    /** @type {number[]} arrival times of what is in `rx` */
    this.rxAt = [];
    /** @type {number[]} */
    this.tx = [];
    this.reset();
  }

  /** Reset values of datasheet 4.2. */
  reset() {
    this.ibrd = 0;
    this.fbrd = 0;
    this.divisor = 0;
    this.lcr = 0;
    this.cr = CR_TXE | CR_RXE;
    this.ifls = 0x12;
    this.imsc = 0;
    this.ris = 0;
    this.dmacr = 0;
    this.rsr = 0;
    this.rx.length = 0;
    this.rxAt.length = 0;
    this.tx.length = 0;
    this.shifting = false;
    this.overrun = false;
    this.breakSent = false;
    this.looped = 0;
    this.timeout.cancel();
    this.shiftEnd.cancel();
    this.loopback.cancel();
    this.#update();
  }

  /** One bit in local nanoseconds: 16 / (IBRD + FBRD / 64) of clk_peri (datasheet 4.2, baud rate calculation). */
  get bitNs() {
    return (16e9 * (this.divisor / 64)) / this.rp.clkPeri;
  }

  get dataBits() {
    return 5 + ((this.lcr >> 5) & 3);
  }

  /** Bits of a character: start, data, parity, stop. */
  get frameBits() {
    return 1 + this.dataBits + (this.lcr & LCR_PEN ? 1 : 0) + (this.lcr & LCR_STP2 ? 2 : 1);
  }

  /** From a start bit's edge to the first stop bit's middle, where a character is complete (PL011 TRM). */
  get receiveNs() {
    return (1 + this.dataBits + (this.lcr & LCR_PEN ? 1 : 0) + 0.5) * this.bitNs;
  }

  get depth() {
    return this.lcr & LCR_FEN ? FIFO_DEPTH : 1;
  }

  get rxLevel() {
    return this.lcr & LCR_FEN ? (LEVELS[(this.ifls >> 3) & 7] ?? 16) : 1;
  }

  get txLevel() {
    return this.lcr & LCR_FEN ? (LEVELS[this.ifls & 7] ?? 16) : 0;
  }

  get receiving() {
    return (this.cr & (CR_UARTEN | CR_RXE)) === (CR_UARTEN | CR_RXE) && this.divisor > 0;
  }

  /**
   * A character is complete: at its stop bit.
   * @param {Frame} frame
   */
  receive(frame) {
    if (!this.receiving) return;
    let entry = frame.isBreak ? DR_BE | DR_FE : sample(frame, this.bitNs, this.dataBits);
    if (this.rx.length >= this.depth) {
      // The FIFO keeps its content, the character is lost (PL011 TRM, overrun bit).
      this.overrun = true;
      this.counters.overruns++;
      this.ris |= INT_OE;
      this.timeout.schedule(TIMEOUT_BITS * this.bitNs);
      this.#update();
      return;
    }
    if (entry & DR_FE) this.ris |= INT_FE;
    if (entry & DR_BE) this.ris |= INT_BE;
    if (this.overrun) {
      entry |= DR_OE;
      this.overrun = false;
    }
    this.rx.push(entry);
    this.rxAt.push(this.clock.nanos);
    this.counters.rxBytes++;
    if (this.rx.length === this.rxLevel) this.ris |= INT_RX;
    this.timeout.schedule(TIMEOUT_BITS * this.bitNs);
    this.#update();
  }

  #receiveTimeout() {
    if (this.rx.length === 0) return;
    this.ris |= INT_RT;
    this.#update();
  }

  #update() {
    this.rp.setInterrupt(this.irq, (this.ris & this.imsc) !== 0);
    const blocked = this.dmacr & DMACR_DMAONERR && this.ris & this.imsc & INT_ERRORS;
    const { dma } = this.rp;
    if (this.dmacr & DMACR_RXDMAE && this.rx.length > 0 && !blocked) dma.setDREQ(this.dreq.rx);
    else dma.clearDREQ(this.dreq.rx);
    if (this.dmacr & DMACR_TXDMAE && this.tx.length < this.depth) dma.setDREQ(this.dreq.tx);
    else dma.clearDREQ(this.dreq.tx);
  }

  #readData() {
    const entry = this.rx.shift();
    const arrived = this.rxAt.shift();
    if (entry === undefined || arrived === undefined) return 0;
    const waited = this.clock.nanos - arrived;
    if (waited > this.counters.rxWaitNsMax) this.counters.rxWaitNsMax = waited;
    this.rsr = entry >> 8;
    if (this.rx.length < this.rxLevel) this.ris &= ~INT_RX;
    if (this.rx.length === 0) {
      this.ris &= ~INT_RT;
      this.timeout.cancel();
    }
    this.#update();
    return entry;
  }

  /** @param {number} data */
  #writeData(data) {
    if (this.tx.length >= this.depth) return;
    this.tx.push(data & 0xff);
    if (this.tx.length > this.txLevel) this.ris &= ~INT_TX;
    if (!this.shifting) this.#nextFrame();
    else this.#update();
  }

  /** The shift register is free: send a break, or the FIFO's first byte. */
  #nextFrame() {
    this.shifting = false;
    const enabled = (this.cr & (CR_UARTEN | CR_TXE)) === (CR_UARTEN | CR_TXE) && this.divisor > 0;
    if (!enabled) return;
    if (this.lcr & LCR_BRK) {
      // One break is one event for the receiver, however long the line stays low.
      if (!this.breakSent) this.#shiftOut(0, true);
      this.breakSent = true;
      return;
    }
    const data = this.tx.shift();
    if (data === undefined) return;
    this.counters.txBytes++;
    this.#shiftOut(data, false);
    // On the way down through the level, and once only (PL011 TRM, UARTTXINTR).
    if (this.tx.length === this.txLevel) this.ris |= INT_TX;
    this.#update();
  }

  /** @param {number} data @param {boolean} isBreak */
  #shiftOut(data, isBreak) {
    const { bitNs, frameBits } = this;
    this.shifting = true;
    this.shiftEnd.schedule(frameBits * bitNs);
    if (this.cr & CR_LBE) {
      this.looped = data;
      this.loopback.schedule(this.receiveNs);
    } else {
      this.onFrame?.({ data, startNs: this.clock.nanos, bitNs, bits: frameBits, isBreak });
    }
  }

  #loopbackEnd() {
    this.receive({ data: this.looped, startNs: 0, bitNs: this.bitNs, bits: this.frameBits, isBreak: false });
  }

  get flags() {
    return (
      (this.tx.length === 0 ? FR_TXFE : 0) |
      (this.rx.length >= this.depth ? FR_RXFF : 0) |
      (this.tx.length >= this.depth ? FR_TXFF : 0) |
      (this.rx.length === 0 ? FR_RXFE : 0) |
      (this.shifting || this.tx.length > 0 ? FR_BUSY : 0)
    );
  }

  /** @param {number} offset */
  readUint32(offset) {
    switch (offset) {
      case UARTDR:
        return this.#readData();
      case UARTRSR:
        return this.rsr;
      case UARTFR:
        return this.flags;
      case UARTIBRD:
        return this.ibrd;
      case UARTFBRD:
        return this.fbrd;
      case UARTLCR_H:
        return this.lcr;
      case UARTCR:
        return this.cr;
      case UARTIFLS:
        return this.ifls;
      case UARTIMSC:
        return this.imsc;
      case UARTRIS:
        return this.ris;
      case UARTMIS:
        return this.ris & this.imsc;
      case UARTICR:
        return 0;
      case UARTDMACR:
        return this.dmacr;
    }
    if (offset >= UARTPERIPHID0 && offset <= 0xffc) return IDENTIFICATION[(offset - UARTPERIPHID0) >> 2];
    return super.readUint32(offset);
  }

  /** @param {number} offset @param {number} value */
  writeUint32(offset, value) {
    switch (offset) {
      case UARTDR:
        this.#writeData(value);
        return;
      case UARTRSR:
        this.rsr = 0;
        return;
      case UARTIBRD:
        this.ibrd = value & 0xffff;
        return;
      case UARTFBRD:
        this.fbrd = value & 0x3f;
        return;
      case UARTLCR_H:
        this.#writeLineControl(value & 0xff);
        break;
      case UARTCR:
        this.cr = value & 0xff87;
        if (!this.shifting) this.#nextFrame();
        break;
      case UARTIFLS:
        this.ifls = value & 0x3f;
        break;
      case UARTIMSC:
        this.imsc = value & 0x7ff;
        break;
      case UARTICR:
        this.ris &= ~this.rawWriteValue;
        break;
      case UARTDMACR:
        this.dmacr = value & 7;
        break;
      default:
        super.writeUint32(offset, value);
        return;
    }
    this.#update();
  }

  /** The divisor takes effect with a write of this register only (datasheet 4.2, UARTIBRD). */
  #writeLineControl(/** @type {number} */ value) {
    const wasBuffered = (this.lcr & LCR_FEN) !== 0;
    this.lcr = value;
    this.divisor = this.ibrd * 64 + this.fbrd;
    // Clearing FEN flushes the transmit FIFO (PL011 TRM, UARTLCR_H).
    if (wasBuffered && !(value & LCR_FEN)) this.tx.length = 0;
    if (!(value & LCR_BRK)) this.breakSent = false;
    if (!this.shifting) this.#nextFrame();
  }
}

/**
 * What a receiver with bit time `bitNs` reads of a frame: it samples each bit's middle, counted from the start edge.
 * @param {Frame} frame
 * @param {number} bitNs
 * @param {number} dataBits
 * @returns {number} data, with DR_FE where the stop bit is not high
 */
export function sample(frame, bitNs, dataBits) {
  const ratio = bitNs / frame.bitNs;
  // Half a bit over ten bits: below this every sample falls into its own bit.
  if (Math.abs(ratio - 1) < 0.04 && frame.bits === dataBits + 2) return frame.data & ((1 << dataBits) - 1);
  // Start bit, data, and everything after as the idle line.
  const line = (frame.data << 1) | (-1 << (frame.bits - 1));
  const bit = (/** @type {number} */ i) => (line >> Math.min(31, Math.floor((i + 0.5) * ratio))) & 1;
  let data = 0;
  for (let i = 0; i < dataBits; i++) data |= bit(i + 1) << i;
  return data | (bit(dataBits + 1) ? 0 : DR_FE);
}

/** @param {number} entry an entry of the receive FIFO */
export function isFramingError(entry) {
  return (entry & DR_FE) !== 0;
}

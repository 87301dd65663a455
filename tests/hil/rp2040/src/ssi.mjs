// The serial interface to the flash, as far as boot2 and flash drivers use it. RP2040 datasheet 4.10.
// Transfers take no time. Whether memory reads reach the flash is decided here: the interface must be enabled in the
// frame format of execute-in-place (32-bit frames, "EEPROM read" mode), which boot2 and flash_enter_cmd_xip set up.
import { BasePeripheral } from 'rp2040js';

const CTRLR0 = 0x00;
const CTRLR1 = 0x04;
const SSIENR = 0x08;
const SER = 0x10;
const BAUDR = 0x14;
const TXFLR = 0x20;
const RXFLR = 0x24;
const SR = 0x28;
const IDR = 0x58;
const VERSION = 0x5c;
const DR_FIRST = 0x60;
const DR_LAST = 0xec;

const SR_TFNF = 1 << 1;
const SR_TFE = 1 << 2;
const SR_RFNE = 1 << 3;

const XIP_FLUSH = 0x04;
const XIP_STAT = 0x08;
const XIP_FLUSH_READY = 1 << 0;
const XIP_FIFO_EMPTY = 1 << 1;

const EEPROM_READ = 3;
/** 8-bit frames, transmit and receive: what the boot ROM's flash_exit_xip leaves. */
export const CTRLR0_SERIAL = 7 << 16;
/** 32-bit frames, EEPROM read: what flash_enter_cmd_xip leaves. */
export const CTRLR0_XIP = (31 << 16) | (EEPROM_READ << 8);

export class Ssi extends BasePeripheral {
  /**
   * @param {import('rp2040js').RP2040} rp
   * @param {import('./flash.mjs').Flash} flash
   * @param {(on: boolean) => void} onXip
   */
  constructor(rp, flash, onXip) {
    super(rp, 'SSI');
    this.flash = flash;
    this.onXip = onXip;
    this.ctrlr0 = CTRLR0_XIP;
    this.ctrlr1 = 0;
    this.enabled = true;
    /** @type {Map<number, number>} registers that are only stored */
    this.stored = new Map();
    /** @type {number[]} */
    this.rx = [];
    this.command = 0;
    this.index = 0;
  }

  get mode() {
    return (this.ctrlr0 >> 8) & 3;
  }

  get isXip() {
    return this.enabled && this.mode === EEPROM_READ && ((this.ctrlr0 >> 16) & 0x1f) === 31;
  }

  /** @param {number} ctrlr0 @param {boolean} enabled */
  configure(ctrlr0, enabled) {
    this.ctrlr0 = ctrlr0;
    this.enabled = enabled;
    this.#endCommand();
    this.rx.length = 0;
    this.onXip(this.isXip);
  }

  /** Chip select goes high when the transmit FIFO has drained. */
  #endCommand() {
    this.index = 0;
  }

  /** @param {number} byte */
  #shift(byte) {
    if (this.index === 0) this.command = byte;
    const answer = this.flash.respond(this.command, this.index);
    this.index++;
    return answer;
  }

  /** The command has been sent: in EEPROM read mode CTRLR1 + 1 frames follow, else it ends. */
  #drain() {
    if (this.index === 0) return;
    if (this.mode === EEPROM_READ && !this.isXip) {
      for (let i = 0; i <= this.ctrlr1; i++) this.rx.push(this.#shift(0));
    }
    this.#endCommand();
  }

  /** @param {number} offset */
  readUint32(offset) {
    if (offset >= DR_FIRST && offset <= DR_LAST) {
      this.#drain();
      return this.rx.shift() ?? 0;
    }
    switch (offset) {
      case CTRLR0:
        return this.ctrlr0;
      case CTRLR1:
        return this.ctrlr1;
      case SSIENR:
        return this.enabled ? 1 : 0;
      case TXFLR:
        return 0;
      case RXFLR:
        this.#drain();
        return this.rx.length;
      case SR:
        this.#drain();
        return SR_TFE | SR_TFNF | (this.rx.length > 0 ? SR_RFNE : 0);
      case IDR:
        return 0x51535049;
      case VERSION:
        return 0x3430312a;
    }
    return this.stored.get(offset) ?? 0;
  }

  /** @param {number} offset @param {number} value */
  writeUint32(offset, value) {
    if (offset >= DR_FIRST && offset <= DR_LAST) {
      if (!this.enabled || this.isXip) return;
      const answer = this.#shift(value & 0xff);
      if (this.mode !== EEPROM_READ) this.rx.push(answer);
      return;
    }
    switch (offset) {
      case CTRLR0:
        if (!this.enabled) this.ctrlr0 = value;
        break;
      case CTRLR1:
        if (!this.enabled) this.ctrlr1 = value & 0xffff;
        break;
      case SSIENR:
        this.configure(this.ctrlr0, (value & 1) !== 0);
        break;
      case SER:
      case BAUDR:
      default:
        this.stored.set(offset, value);
    }
  }
}

/** Control of the XIP cache (datasheet 2.6.3): there is no cache, so that a flush is always done. */
export class XipControl extends BasePeripheral {
  /** @type {number[]} */
  stored = [3];

  /** @param {number} offset */
  readUint32(offset) {
    return offset === XIP_STAT ? XIP_FIFO_EMPTY | XIP_FLUSH_READY : (this.stored[offset >> 2] ?? 0);
  }

  /** @param {number} offset @param {number} value */
  writeUint32(offset, value) {
    if (offset !== XIP_FLUSH) this.stored[offset >> 2] = value;
  }
}

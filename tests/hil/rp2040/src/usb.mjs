// An outside endpoint over USB-CDC. The host class of the package enumerates the device; packets take the package's
// fixed times, so nothing about USB timing follows from here. The firmware must use max_packet_size_0(64).
import { USBCDC } from 'rp2040js';
import { Delimiter } from './wire.mjs';

const BULK_BYTES = 64;
/** The terminal is open: wValue of SET_CONTROL_LINE_STATE. */
const DTR_AND_RTS = 3;

export class UsbPort {
  /** @param {string} name @param {import('./chip.mjs').Chip} chip */
  constructor(name, chip) {
    this.name = name;
    this.chip = chip;
    this.lines = [];
    this.isCut = false;
    this.delimiter = new Delimiter(name);
    /** @type {{ bytes: Uint8Array, startNs: number }[]} */
    this.sending = [];
    /** @type {number[]} due, but not yet taken by the device */
    this.outgoing = [];
    /** @type {import('./wire.mjs').PortEvent[]} */
    this.events = [];
    /**
     * Bytes that each endpoint of the device is ready to take; without an entry it answers NAK. The device arms its
     * buffers before the host knows which one is the serial port's.
     * @type {Map<number, number>}
     */
    this.ready = new Map();
    this.isConnected = false;
    /** The bulk endpoint towards the device, private in the package; -1 before the device is known. */
    this.outEndpoint = () => -1;
    chip.onBoot.push(() => this.#attach());
    this.#attach();
  }

  /** @param {boolean} isCut */
  set cut(isCut) {
    this.isCut = isCut;
  }

  #attach() {
    const usb = this.chip.rp.usbCtrl;
    const cdc = new USBCDC(usb);
    this.outEndpoint = () => /** @type {any} */ (cdc).outEndpoint;
    this.ready = new Map();
    this.isConnected = false;
    this.outgoing = [];
    cdc.onDeviceConnected = () => {
      this.isConnected = true;
      this.#feed();
    };
    // The package asks the device and not its interface (USB CDC PSTN 1.2, 6.3.12), which firmware may refuse; a real host asks the latter.
    Object.assign(cdc, {
      cdcSetControlLineState() {
        usb.sendSetupPacket(Uint8Array.from([0x21, 0x22, DTR_AND_RTS, 0, 0, 0, 0, 0]));
        Object.assign(cdc, { initialized: true });
      },
    });
    cdc.onSerialData = (data) => this.#received(data);
    // The package answers each buffer at once, with an empty packet if need be, for ever; a real host sends nothing.
    usb.onEndpointRead = (endpoint, size) => {
      this.ready.set(endpoint, size);
      this.#feed();
    };
  }

  #feed() {
    const endpoint = this.outEndpoint();
    const size = this.ready.get(endpoint);
    if (size === undefined || !this.isConnected || this.outgoing.length === 0) return;
    const packet = Uint8Array.from(this.outgoing.splice(0, Math.min(size, BULK_BYTES)));
    this.ready.delete(endpoint);
    this.chip.rp.usbCtrl.endpointReadDone(endpoint, packet);
  }

  /** @param {Uint8Array} data */
  #received(data) {
    if (this.isCut) return;
    const now = this.chip.now;
    for (const byte of data) {
      const event = this.delimiter.push(byte, now, now);
      if (event) this.events.push(event);
    }
  }

  /** @param {Uint8Array} bytes @param {number} earliestNs */
  send(bytes, earliestNs) {
    this.sending.push({ bytes, startNs: earliestNs });
    return { start_ns: earliestNs, end_ns: earliestNs };
  }

  get nextNs() {
    return this.sending[0]?.startNs ?? Infinity;
  }

  /** @param {number} untilNs */
  pump(untilNs) {
    while (this.sending.length > 0 && this.sending[0].startNs < untilNs) {
      const { bytes } = /** @type {{ bytes: Uint8Array }} */ (this.sending.shift());
      if (this.isCut || !this.chip.isOn) continue;
      this.outgoing.push(...bytes);
      this.#feed();
    }
  }

  /** @param {number} _nowNs */
  collect(_nowNs) {
    return this.events.splice(0);
  }
}

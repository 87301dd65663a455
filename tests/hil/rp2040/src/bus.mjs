// The memory map as the core and the DMA see it. The package's own accessors let any address pass, let firmware write
// flash through the XIP window, and look a peripheral up before they try RAM; here RAM comes first and errors fault.
// RP2040 datasheet 2.2 (address map), 2.6.3 (XIP); ARMv6-M ARM A3.2 (alignment).

/** @typedef {import('rp2040js').RP2040} RP2040 */

const RAM = 0x20000000;
export const RAM_BYTES = 264 * 1024;
export const XIP = 0x10000000;
const XIP_END = 0x14000000;
const ROM_BYTES = 16 * 1024;
/** A harmless opcode in place of an instruction that could not be fetched: NOP. */
const NOP = 0xbf00;

/**
 * @typedef {object} BusState
 * @property {boolean} xip whether the flash answers memory reads
 * @property {Uint8Array} flash what the XIP window shows; it repeats every `flash.length` bytes (a power of two)
 * @property {(detail: string, isFetch?: boolean) => void} onError a bus error of whoever is the master
 */

/** @param {number} address */
const isXip = (address) => address >= XIP && address < XIP_END;

/** @param {number} address */
const hex = (address) => `0x${(address >>> 0).toString(16).padStart(8, '0')}`;

/**
 * Replaces the accessors of `rp` and of its core.
 * @param {RP2040} rp @param {BusState} state
 */
export function installBus(rp, state) {
  installReads(rp, state);
  installWrites(rp, state);
}

/** @param {RP2040} rp @param {BusState} state */
function installReads(rp, state) {
  const { core, bootrom } = rp;
  const { sram, sramView } = rp;
  const flashView = new DataView(state.flash.buffer, state.flash.byteOffset, state.flash.length);
  const flashMask = state.flash.length - 1;
  const readOther = rp.readUint32.bind(rp);

  /** @param {number} address */
  const slow32 = (address) => {
    if (address < ROM_BYTES) return bootrom[address >>> 2] >>> 0;
    if (isXip(address)) {
      if (state.xip) return flashView.getUint32(address & flashMask & ~3, true);
      state.onError(`read of ${hex(address)} while the flash is not in XIP mode`);
      return 0;
    }
    if (!isMapped(rp, address)) {
      state.onError(`read of ${hex(address)}, where nothing is`);
      return 0;
    }
    return readOther(address) >>> 0;
  };

  /** @param {number} address */
  const read32 = (address) => {
    address >>>= 0;
    const offset = (address - RAM) >>> 0;
    if (address & 3) {
      state.onError(`word read of ${hex(address)}, which is not aligned`);
      return 0;
    }
    return offset < RAM_BYTES ? sramView.getUint32(offset, true) : slow32(address);
  };

  /** @param {number} address */
  const read16 = (address) => {
    address >>>= 0;
    const offset = (address - RAM) >>> 0;
    if (offset < RAM_BYTES) {
      if (!(offset & 1)) return sramView.getUint16(offset, true);
    } else if (isXip(address) && state.xip) {
      if (!(address & 1)) return flashView.getUint16(address & flashMask, true);
    }
    if (address & 1) {
      state.onError(`halfword read of ${hex(address)}, which is not aligned`);
      return 0;
    }
    if (address === core.PC >>> 0 && address >= ROM_BYTES && !(state.xip && isXip(address))) {
      state.onError(
        `instruction fetch from ${hex(address)}${isXip(address) ? ', the flash is not in XIP mode' : ''}`,
        true,
      );
      return NOP;
    }
    const word = slow32((address & ~3) >>> 0);
    return address & 2 ? word >>> 16 : word & 0xffff;
  };

  /** @param {number} address */
  const read8 = (address) => {
    address >>>= 0;
    const offset = (address - RAM) >>> 0;
    if (offset < RAM_BYTES) return sram[offset];
    return (slow32((address & ~3) >>> 0) >>> (8 * (address & 3))) & 0xff;
  };

  rp.readUint32 = core.readUint32 = read32;
  rp.readUint16 = core.readUint16 = read16;
  rp.readUint8 = core.readUint8 = read8;
}

/** @param {RP2040} rp @param {BusState} state */
function installWrites(rp, state) {
  const { core, sram, sramView } = rp;
  const other = [8, 16, 32].map((bits) => {
    const write = bits === 8 ? rp.writeUint8 : bits === 16 ? rp.writeUint16 : rp.writeUint32;
    return write.bind(rp);
  });

  /** @param {number} address @param {number} value @param {number} log2 of the width in bytes */
  const slow = (address, value, log2) => {
    if (address < ROM_BYTES || isXip(address)) {
      state.onError(`write to ${hex(address)}, which is read-only; flash is written through the ROM's functions`);
    } else if (!isMapped(rp, address)) {
      state.onError(`write to ${hex(address)}, where nothing is`);
    } else {
      other[log2](address, value);
    }
  };

  /** @param {number} address @param {number} value */
  const write32 = (address, value) => {
    address >>>= 0;
    const offset = (address - RAM) >>> 0;
    if (address & 3) state.onError(`word write to ${hex(address)}, which is not aligned`);
    else if (offset < RAM_BYTES) sramView.setUint32(offset, value, true);
    else slow(address, value, 2);
  };

  /** @param {number} address @param {number} value */
  const write16 = (address, value) => {
    address >>>= 0;
    const offset = (address - RAM) >>> 0;
    if (address & 1) state.onError(`halfword write to ${hex(address)}, which is not aligned`);
    else if (offset < RAM_BYTES) sramView.setUint16(offset, value, true);
    else slow(address, value, 1);
  };

  /** @param {number} address @param {number} value */
  const write8 = (address, value) => {
    address >>>= 0;
    const offset = (address - RAM) >>> 0;
    if (offset < RAM_BYTES) sram[offset] = value;
    else slow(address, value, 0);
  };

  rp.writeUint32 = core.writeUint32 = write32;
  rp.writeUint16 = core.writeUint16 = write16;
  rp.writeUint8 = core.writeUint8 = write8;
}

/** Whether a peripheral, the USB RAM, SIO or the private bus answers. @param {RP2040} rp @param {number} address */
function isMapped(rp, address) {
  if (address >>> 28 === 0xd || address >>> 12 === 0xe000e) return true;
  if (address >= 0x50100000 && address < 0x50101000) return true;
  return rp.findPeripheral(address) !== undefined;
}

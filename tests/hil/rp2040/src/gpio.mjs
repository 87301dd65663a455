// What an outside sees at the GPIO pins: the edges of chosen ones, to the cycle. RP2040 datasheet 2.3.1.2 (SIO), 2.19 (GPIO).
// The level is what the pad drives: by the function that IO_BANK0 selects, its overrides, and the pad's output disable, which the
// package does not look at. Not modelled: pads of the PWM and the UARTs, which count as not driven; see the command `pwm`.

/** Pins of bank 0. */
export const PINS = 30;
/** Edges kept between two questions; what comes on top is counted and lost. */
export const EDGES_MAX = 1 << 20;
/** The level of a pin that nothing here drives. */
export const OPEN = 2;

/** @typedef {import('rp2040js').RP2040['gpio'][number]} Pin */
/** @typedef {[globalNs: number, localNs: number, pin: number, level: number]} Edge */

/** @param {Pin} pin @returns {number} 0, 1 or OPEN */
export function levelOf(pin) {
  // OD has priority over what the peripheral says (datasheet 2.19.6.3, GPIO0 to GPIO29).
  if (!pin.outputEnable || pin.outputDisable) return OPEN;
  return pin.outputValue ? 1 : 0;
}

/** Records the edges of a chip's pins. It outlives the chip's resets, which are edges too. */
export class PinRecorder {
  /** @param {import('./chip.mjs').Chip} chip */
  constructor(chip) {
    this.chip = chip;
    this.mask = 0;
    this.lost = 0;
    /** @type {Edge[]} */
    this.edges = [];
    this.levels = new Uint8Array(PINS).fill(OPEN);
    chip.onBoot.push(() => this.#attach());
  }

  /**
   * From now on these pins alone are recorded; what was kept is dropped.
   * @param {number} mask one bit a pin @returns {{ high: number, open: number }} the levels now, a bit a pin
   */
  watch(mask) {
    if (!Number.isInteger(mask) || mask < 0 || mask >= 2 ** PINS) {
      throw new Error(`"mask" is ${mask}; it has a bit for each of the pins 0 to ${PINS - 1}`);
    }
    // Of this machine those that are watched no longer; a new one begins with none.
    for (const pin of this.#watched()) Reflect.deleteProperty(pin, 'checkForUpdates');
    this.mask = mask;
    this.#attach();
    Object.assign(this, { edges: [], lost: 0 });
    const bits = (/** @type {number} */ level) =>
      this.#watched().reduce((all, { index }) => (this.levels[index] === level ? all | (1 << index) : all), 0);
    return { high: bits(1), open: bits(OPEN) };
  }

  /** What was recorded since the last question, in order, and how many edges there was no room for. */
  take() {
    const taken = { edges: this.edges, lost: this.lost };
    Object.assign(this, { edges: [], lost: 0 });
    return taken;
  }

  /** Without power nothing drives a pin. */
  powerOff() {
    for (const pin of this.#watched()) this.#note(pin.index, OPEN, this.chip.clock.nanos);
  }

  #watched() {
    return this.chip.rp.gpio.filter((pin) => (this.mask >> pin.index) & 1);
  }

  /** SIO, IO_BANK0 and the pads call `checkForUpdates` of a pin whose output may have changed. */
  #attach() {
    const { clock, isOn, machine } = this.chip;
    for (const pin of this.#watched()) {
      // The store that an instruction makes is done with its first cycle, one for SIO; the clock stands at its beginning.
      pin.checkForUpdates = () => this.#note(pin.index, levelOf(pin), clock.nanos + machine.cycleNs);
      this.#note(pin.index, isOn ? levelOf(pin) : OPEN, clock.nanos);
    }
  }

  /** @param {number} pin @param {number} level @param {number} localNs */
  #note(pin, level, localNs) {
    if (this.levels[pin] === level) return;
    this.levels[pin] = level;
    if (this.edges.length < EDGES_MAX) this.edges.push([this.chip.toGlobal(localNs), localNs, pin, level]);
    else this.lost++;
  }
}

// The crystal of one chip: how its own time goes against global time. A rate, or one that changes steadily
// (temperature), or at once; what was before is kept, so that instants of the past can be asked for too.

/**
 * From `globalNs` on: the rate is `1 + (ppm + rampPpmPerS * seconds) * 1e-6`.
 * @typedef {{ globalNs: number, localNs: number, ppm: number, rampPpmPerS: number }} Piece
 */

export class Crystal {
  /** @param {number} ppm @param {number} globalNs where local time is 0 */
  constructor(ppm, globalNs) {
    /** @type {Piece[]} */
    this.pieces = [{ globalNs, localNs: 0, ppm, rampPpmPerS: 0 }];
    this.last = this.pieces[0];
  }

  /** Local time begins anew, as with a boot; the crystal goes on. @param {number} globalNs */
  restart(globalNs) {
    const ppm = this.ppmAt(globalNs);
    this.last = { globalNs, localNs: 0, ppm, rampPpmPerS: this.last.rampPpmPerS };
    this.pieces = [this.last];
  }

  /** From now on. @param {number} globalNs @param {number} ppm @param {number} rampPpmPerS */
  set(globalNs, ppm, rampPpmPerS) {
    // Before the first boot nothing has passed that would have to be kept.
    const atNs = Math.max(globalNs, this.pieces[0].globalNs);
    const piece = { globalNs: atNs, localNs: this.toLocal(atNs), ppm, rampPpmPerS };
    if (this.last.globalNs === atNs) this.pieces.pop();
    this.pieces.push(piece);
    this.last = piece;
  }

  /** @param {number} globalNs */
  ppmAt(globalNs) {
    const piece = this.#from('globalNs', globalNs);
    return piece.ppm + (piece.rampPpmPerS * (globalNs - piece.globalNs)) / 1e9;
  }

  /** @param {number} globalNs */
  toLocal(globalNs) {
    const { globalNs: from, localNs, ppm, rampPpmPerS } = this.#from('globalNs', globalNs);
    const passed = globalNs - from;
    // Whole and deviation apart: each keeps its digits.
    return localNs + passed + passed * (ppm * 1e-6) + (rampPpmPerS === 0 ? 0 : passed * passed * half(rampPpmPerS));
  }

  /** @param {number} localNs */
  toGlobal(localNs) {
    const piece = this.#from('localNs', localNs);
    const passed = localNs - piece.localNs;
    const rate = 1 + piece.ppm * 1e-6;
    if (piece.rampPpmPerS === 0) return piece.globalNs + passed / rate;
    // The root of a·x² + rate·x = passed that is near passed / rate, without a difference of nearly equal numbers.
    return piece.globalNs + (2 * passed) / (rate + Math.sqrt(rate * rate + 4 * half(piece.rampPpmPerS) * passed));
  }

  /**
   * The piece that an instant lies in, or the first.
   * @param {'globalNs' | 'localNs'} kind @param {number} ns @returns {Piece}
   */
  #from(kind, ns) {
    let i = this.pieces.length - 1;
    while (i > 0 && this.pieces[i][kind] > ns) i--;
    return this.pieces[i];
  }
}

/** Half of a ramp, in 1 / ns. @param {number} rampPpmPerS */
function half(rampPpmPerS) {
  return rampPpmPerS * 0.5e-15;
}

// Where a chip's time goes: per exception, under PRIMASK, from pending to the handler's first instruction.
// Everything is stamped with the chip's local clock at exception entry, return and PRIMASK changes, so that an ordinary
// instruction costs nothing more.

/**
 * Of one exception; times are nanoseconds of the chip's clock.
 * @typedef {object} Entry
 * @property {number} count
 * @property {number} ownNsMax without what preempted
 * @property {number} ownNsTotal
 * @property {number} spanNsMax from entry to return
 * @property {number} latencyNsMax from pended and enabled
 * @property {number} pendedNsMax from pended
 * @property {Map<number, number>} latencies how often each latency below LATENCY_NS_MAX was, by whole nanoseconds
 */

/** Longer latencies are told by their maximum alone. */
const LATENCY_NS_MAX = 8192;

export class Profile {
  constructor() {
    this.instructions = 0;
    this.sleepNs = 0;
    this.startNs = 0;
    /** Time of earlier boots since the last reset of the profile. */
    this.earlierNs = 0;
    this.maskedNsMax = 0;
    this.maskedSinceNs = -1;
    /** @type {Map<number, Entry>} */
    this.entries = new Map();
    /** Exceptions in service, outermost first. @type {{ number: number, sinceNs: number, innerNs: number }[]} */
    this.stack = [];
    /** When each interrupt became pending and enabled; -1: it is not. */
    this.pendingSinceNs = new Float64Array(32).fill(-1);
    /** When each became pending, enabled or not. */
    this.pendedSinceNs = new Float64Array(32).fill(-1);
  }

  /** Forgets the figures, but not what is in service. @param {number} now */
  reset(now) {
    this.instructions = 0;
    this.sleepNs = 0;
    this.startNs = now;
    this.earlierNs = 0;
    this.maskedNsMax = 0;
    this.entries.clear();
  }

  /** The chip boots anew: its clock starts at 0 and nothing is in service. @param {number} now of the old clock */
  reboot(now) {
    this.earlierNs += now - this.startNs;
    this.startNs = 0;
    this.maskedSinceNs = -1;
    this.stack.length = 0;
    this.pendingSinceNs.fill(-1);
    this.pendedSinceNs.fill(-1);
  }

  /** @param {number} irq @param {boolean} isEnabled @param {number} now */
  onPend(irq, isEnabled, now) {
    this.pendedSinceNs[irq] = now;
    this.pendingSinceNs[irq] = isEnabled ? now : -1;
  }

  /** A pending interrupt was enabled. @param {number} irq @param {number} now */
  onEnable(irq, now) {
    this.pendingSinceNs[irq] = now;
  }

  /** @param {number} number @returns {Entry} */
  #entry(number) {
    let entry = this.entries.get(number);
    if (!entry) {
      entry = { count: 0, ownNsMax: 0, ownNsTotal: 0, spanNsMax: 0, latencyNsMax: 0, pendedNsMax: 0, latencies: new Map() };
      this.entries.set(number, entry);
    }
    return entry;
  }

  /** @param {number} number @param {number} now @param {number} entryNs how long the entry takes from now */
  onEntry(number, now, entryNs) {
    this.stack.push({ number, sinceNs: now, innerNs: 0 });
    if (number < 16) return;
    const entry = this.#entry(number);
    const since = this.pendingSinceNs[number - 16];
    const pended = this.pendedSinceNs[number - 16];
    if (since >= 0) {
      const latencyNs = now + entryNs - since;
      entry.latencyNsMax = Math.max(entry.latencyNsMax, latencyNs);
      const key = Math.round(latencyNs);
      if (key < LATENCY_NS_MAX) entry.latencies.set(key, (entry.latencies.get(key) ?? 0) + 1);
    }
    if (pended >= 0) entry.pendedNsMax = Math.max(entry.pendedNsMax, now + entryNs - pended);
    this.pendingSinceNs[number - 16] = -1;
    this.pendedSinceNs[number - 16] = -1;
  }

  /** @param {number} now after the return's last cycle */
  onReturn(now) {
    const top = this.stack.pop();
    if (!top) return;
    const spanNs = now - top.sinceNs;
    const ownNs = spanNs - top.innerNs;
    const below = this.stack[this.stack.length - 1];
    if (below) below.innerNs += spanNs;
    const entry = this.#entry(top.number);
    entry.count++;
    entry.ownNsTotal += ownNs;
    entry.ownNsMax = Math.max(entry.ownNsMax, ownNs);
    entry.spanNsMax = Math.max(entry.spanNsMax, spanNs);
  }

  /** @param {boolean} masked @param {number} now */
  onMask(masked, now) {
    if (masked) {
      this.maskedSinceNs = now;
    } else if (this.maskedSinceNs >= 0) {
      this.maskedNsMax = Math.max(this.maskedNsMax, now - this.maskedSinceNs);
      this.maskedSinceNs = -1;
    }
  }

  /**
   * The figures in cycles of the present system clock.
   * @param {number} now local @param {number} cycleNs
   */
  report(now, cycleNs) {
    const cycles = (/** @type {number} */ ns) => Math.round(ns / cycleNs);
    const masked = this.maskedSinceNs < 0 ? 0 : now - this.maskedSinceNs;
    return {
      cycles: cycles(this.earlierNs + now - this.startNs),
      sleep_cycles: cycles(this.sleepNs),
      instructions: this.instructions,
      exceptions: [...this.entries]
        .sort(([a], [b]) => a - b)
        .map(([number, e]) => ({
          number,
          count: e.count,
          cycles_max: cycles(e.ownNsMax),
          cycles_total: cycles(e.ownNsTotal),
          latency_cycles_max: cycles(e.latencyNsMax),
          pended_cycles_max: cycles(e.pendedNsMax),
          span_cycles_max: cycles(e.spanNsMax),
          latencies: [...e.latencies].sort(([a], [b]) => a - b).map(([ns, count]) => [cycles(ns), count]),
        })),
      primask_cycles_max: cycles(Math.max(this.maskedNsMax, masked)),
    };
  }
}

// Mends of rp2040js 1.4.1's other peripherals, each on one instance.

/** @typedef {import('rp2040js').RP2040} RP2040 */

const TIMER = 0x40054;
const RESETS = 0x4000c;
const ALARM0 = 0x10;
const ALARM3 = 0x1c;
const RESET_DMA = 1 << 2;
const RESET_PWM = 1 << 14;
const RESET_UART0 = 22;

/**
 * An alarm fires when the low word of the microsecond counter equals it (datasheet 4.6). The package counts whole
 * microseconds from the instant of the write, so that it fires up to one too early, with the counter not yet there.
 * @param {RP2040} rp
 */
export function mendTimerAlarms(rp) {
  const timer = /** @type {any} */ (rp.peripherals[TIMER]);
  const write = timer.writeUint32.bind(timer);
  timer.writeUint32 = (/** @type {number} */ offset, /** @type {number} */ value) => {
    write(offset, value);
    if (offset < ALARM0 || offset > ALARM3) return;
    const now = rp.clock.nanos;
    const counter = Math.floor(now / 1000);
    const delta = (value - counter) >>> 0;
    timer.alarms[(offset - ALARM0) >> 2].clockAlarm.schedule(delta === 0 ? 0 : (counter + delta) * 1000 - now);
  };
}

/**
 * Bits that become set hold a peripheral in reset, which clears its registers (datasheet 2.14). The package only stores
 * them. Done for what is replaced here.
 * @param {RP2040} rp
 * @param {import('./pl011.mjs').Pl011[]} uarts
 * @param {import('./dma.mjs').Dma} dma
 * @param {import('./pwm.mjs').Pwm} pwm
 */
export function mendResets(rp, uarts, dma, pwm) {
  const resets = /** @type {any} */ (rp.peripherals[RESETS]);
  const write = resets.writeUint32.bind(resets);
  resets.writeUint32 = (/** @type {number} */ offset, /** @type {number} */ value) => {
    const before = resets.reset;
    write(offset, value);
    const fresh = resets.reset & ~before;
    if (offset !== 0 || fresh === 0) return;
    uarts.forEach((uart, i) => {
      if ((fresh >> (RESET_UART0 + i)) & 1) uart.reset();
    });
    if (fresh & RESET_DMA) dma.reset();
    if (fresh & RESET_PWM) pwm.reset();
  };
}

/**
 * The package steps PIO from `setTimeout`, that is, in the host's time. PIO is not modelled: it stands still.
 * @param {RP2040} rp @param {(message: string) => void} warn
 */
export function stopPio(rp, warn) {
  rp.pio.forEach((pio, i) => {
    /** @type {any} */ (pio).run = () => warn(`PIO${i} was started: it is not modelled and stands still`);
  });
}

// Mends of rp2040js 1.4.1's Cortex-M0+ core, applied to one instance: exceptions, NVIC, faults.
// References: ARMv6-M Architecture Reference Manual (DDI 0419), Cortex-M0+ TRM (DDI 0484), Cortex-M0+ Devices Generic
// User Guide (DUI 0662), RP2040 datasheet. What the package does instead is said at each function.

import { Cpu } from './cpu.mjs';

/** @typedef {import('rp2040js').RP2040} RP2040 */
/** @typedef {RP2040['core']} Core */

export const HARD_FAULT = 3;
const NMI = 2;
const SVCALL = 11;
const PENDSV = 14;
const SYSTICK = 15;
const THREAD_PRIORITY = 4;

/** Cycles from the boundary of an instruction to the handler's first (Cortex-M0+ TRM 3.6.1: 15 without wait states). */
export const ENTRY_CYCLES = 15;
/** Cycles of unstacking eight words and refilling the pipeline, beyond the branch's own. */
export const RETURN_CYCLES = 12;

const NVIC_ISER = 0x100;
const NVIC_ISPR = 0x200;
const NVIC_ICPR = 0x280;
const SCB_AIRCR = 0xd0c;
const SCB_SCR = 0xd10;
const AIRCR_KEY = 0x05fa;
const AIRCR_SYSRESETREQ = 1 << 2;

/**
 * What the chip wants to hear of its core.
 * @typedef {object} CoreEvents
 * @property {(irq: number, isEnabled: boolean) => void} onPend an interrupt became pending
 * @property {(irq: number) => void} onEnable a pending interrupt became enabled
 * @property {(exception: number) => void} onEntry
 * @property {(exception: number) => void} onReturn
 * @property {(masked: boolean) => void} onMask PRIMASK changed
 * @property {() => void} onSysReset AIRCR.SYSRESETREQ
 * @property {(detail: string) => void} onFault
 * @property {(detail: string) => void} onLockup
 */

/** The interrupt controller and exception logic of one core. */
export class Exceptions {
  /** @param {RP2040} rp @param {import('./bus.mjs').BusState} bus @param {CoreEvents} events */
  constructor(rp, bus, events) {
    this.rp = rp;
    this.core = rp.core;
    this.events = events;
    /** Lines that peripherals hold high, one bit each. */
    this.lines = 0;
    /** Interrupts whose handler runs or was preempted. */
    this.active = 0;
    /** Cycles to add for what the last instruction did besides itself. */
    this.extraCycles = 0;
    /** @type {{ pc: number, detail: string } | null} */
    this.fault = null;
    this.scr = 0;
    /** The core waits in a ROM function, which an interrupt leaves only if it is not masked. */
    this.polling = false;
    this.cpu = new Cpu(rp.core, this, bus, rp.sram);
    const { core } = this;
    this.enter = core.exceptionEntry.bind(core);
    this.leave = core.exceptionReturn.bind(core);
    core.setInterrupt = (irq, value) => this.setLine(irq, value);
    core.checkForInterrupts = () => this.takeException();
    core.exceptionReturn = (value) => this.returnFrom(value);
    watchPrimask(core, events.onMask);
    this.mendControlSpace();
  }

  /**
   * A peripheral's interrupt line. A rising line pends; a line that falls leaves the pending state as it is
   * (DUI 0662, level-sensitive and pulse interrupts). The package treats the line itself as the pending state.
   * @param {number} irq @param {boolean} high
   */
  setLine(irq, high) {
    const bit = 1 << irq;
    if (!high) {
      this.lines &= ~bit;
    } else if (!(this.lines & bit)) {
      this.lines |= bit;
      this.pend(bit);
    }
  }

  /** @param {number} bits */
  pend(bits) {
    const { core } = this;
    const fresh = bits & ~core.pendingInterrupts;
    core.pendingInterrupts |= bits;
    for (let rest = fresh; rest; rest &= rest - 1) {
      const irq = 31 - Math.clz32(rest & -rest);
      this.events.onPend(irq, ((core.enabledInterrupts >>> irq) & 1) === 1);
    }
    this.noticed();
  }

  /** Something has become pending or enabled. */
  noticed() {
    const { core } = this;
    core.interruptsUpdated = true;
    if (core.waiting && this.wakes()) core.waiting = false;
  }

  /** Priority of execution without PRIMASK; 4 in thread mode. */
  get executionPriority() {
    return this.core.IPSR === 0 ? THREAD_PRIORITY : this.core.exceptionPriority(this.core.IPSR);
  }

  /** Exceptions of a lower priority value are taken; PRIMASK raises execution to 0. */
  get takenBelow() {
    return this.core.PM ? Math.min(0, this.executionPriority) : this.executionPriority;
  }

  /**
   * Number of the pending exception that preempts `priority`, 0 if none: lowest priority value first, then lowest
   * number (ARMv6-M ARM, exception priorities).
   * @param {number} priority
   */
  best(priority) {
    const { core } = this;
    if (core.pendingNMI && priority > -2) return NMI;
    const enabled = core.pendingInterrupts & core.enabledInterrupts;
    if (enabled === 0 && !core.pendingSVCall && !core.pendingPendSV && !core.pendingSystick) return 0;
    for (let level = 0; level < priority; level++) {
      if (core.pendingSVCall && core.svCallPriority === level) return SVCALL;
      if (core.pendingPendSV && core.pendSVPriority === level) return PENDSV;
      if (core.pendingSystick && core.systickPriority === level) return SYSTICK;
      const bits = enabled & core.interruptPriorities[level];
      if (bits) return 16 + 31 - Math.clz32(bits & -bits);
    }
    return 0;
  }

  /**
   * Whether a sleeping core wakes: PRIMASK does not count (ARMv6-M ARM, Wait For Interrupt).
   * The package enters the handler in spite of PRIMASK.
   */
  wakes() {
    return this.fault !== null || this.best(this.polling ? this.takenBelow : this.executionPriority) !== 0;
  }

  /** Enters the exception that is due; false if none is. Called at the boundary of two instructions. */
  takeException() {
    const { core } = this;
    if (this.fault) return this.takeFault(this.fault);
    const number = this.best(this.takenBelow);
    if (number === 0) {
      core.interruptsUpdated = false;
      return false;
    }
    if (number === NMI) core.pendingNMI = false;
    else if (number === SVCALL) core.pendingSVCall = false;
    else if (number === PENDSV) core.pendingPendSV = false;
    else if (number === SYSTICK) core.pendingSystick = false;
    else this.activate(1 << (number - 16));
    this.enterException(number);
    return true;
  }

  /**
   * Entry clears the pending state of every interrupt (DUI 0662, level-sensitive interrupts); the package does so above
   * 25 only.
   * @param {number} bit
   */
  activate(bit) {
    this.core.pendingInterrupts &= ~bit;
    this.active |= bit;
  }

  /**
   * The vector's bit 0 goes to EPSR.T and is no part of the PC (ARMv6-M ARM, ExceptionTaken()). The package leaves
   * it in the PC, so that `ADD Rd, PC` of a jump table in a handler is one too high.
   * @param {number} number
   */
  enterException(number) {
    const { core } = this;
    core.waiting = false;
    this.cpu.stack(number);
    if (!(core.PC & 1)) this.raise(`vector ${number} has no Thumb bit`, core.PC);
    core.PC = (core.PC & ~1) >>> 0;
    this.events.onEntry(number);
  }

  /**
   * A line that is still high at the return pends again (DUI 0662, level-sensitive interrupts).
   * @param {number} excReturn
   */
  returnFrom(excReturn) {
    const { core } = this;
    const number = core.IPSR;
    this.cpu.unstack(excReturn);
    this.extraCycles += RETURN_CYCLES;
    if (number >= 16) {
      const bit = 1 << (number - 16);
      this.active &= ~bit;
      if (this.lines & bit) this.pend(bit);
    }
    this.events.onReturn(number);
  }

  /**
   * BX, and POP with the PC: in a handler a target of 0xf....... is the exception return.
   * @param {number} address
   */
  branchExchange(address) {
    const target = address >>> 0;
    if (this.core.IPSR !== 0 && target >>> 28 === 0xf) this.core.exceptionReturn(target & 0x0fffffff);
    else this.branchLink(target);
  }

  /**
   * A target with bit 0 clear leaves the Thumb state, which ARMv6-M does not have (ARMv6-M ARM, BXWritePC and
   * BLXWritePC).
   * @param {number} address
   */
  branchLink(address) {
    const { core } = this;
    if (!(address & 1)) this.raise(`branch to 0x${(address >>> 0).toString(16)} without the Thumb bit`, core.PC - 2);
    core.PC = (address & ~1) >>> 0;
  }

  /**
   * A fault of the instruction at `pc` (ARMv6-M ARM, fault behavior: every fault is a HardFault).
   * @param {string} detail @param {number} pc
   */
  raise(detail, pc) {
    if (this.fault) return;
    this.fault = { pc: pc >>> 0, detail };
    this.core.interruptsUpdated = true;
    this.core.waiting = false;
  }

  /**
   * A fault in HardFault or NMI locks the core up (ARMv6-M ARM, lockup).
   * @param {{ pc: number, detail: string }} fault
   */
  takeFault(fault) {
    const { core } = this;
    const where = `${fault.detail}, PC 0x${fault.pc.toString(16)}, LR 0x${core.LR.toString(16)}`;
    this.fault = null;
    if (core.IPSR === HARD_FAULT || core.IPSR === NMI) {
      this.events.onLockup(where);
      return true;
    }
    this.events.onFault(where);
    core.PC = fault.pc;
    this.enterException(HARD_FAULT);
    return true;
  }

  /**
   * NVIC set-pending and clear-pending, and the SCB registers that the package does not know.
   * Clearing does not touch a line that is high and not in service (DUI 0662, hardware and software control of
   * interrupts).
   */
  mendControlSpace() {
    const { core } = this;
    const { ppb } = this.rp;
    const read = ppb.readUint32.bind(ppb);
    const write = ppb.writeUint32.bind(ppb);
    ppb.readUint32 = (offset) => {
      if (offset === SCB_AIRCR) return 0xfa050000;
      if (offset === SCB_SCR) return this.scr;
      return read(offset) >>> 0;
    };
    ppb.writeUint32 = (offset, value) => {
      switch (offset) {
        case NVIC_ISER: {
          const fresh = value & ~core.enabledInterrupts & core.pendingInterrupts;
          core.enabledInterrupts |= value;
          for (let rest = fresh; rest; rest &= rest - 1) this.events.onEnable(31 - Math.clz32(rest & -rest));
          this.noticed();
          return;
        }
        case NVIC_ISPR:
          this.pend(value);
          return;
        case NVIC_ICPR:
          core.pendingInterrupts &= ~value | (this.lines & ~this.active);
          return;
        case SCB_AIRCR:
          if (value >>> 16 === AIRCR_KEY && value & AIRCR_SYSRESETREQ) this.events.onSysReset();
          return;
        case SCB_SCR:
          this.scr = value & 0x16;
          return;
        default:
          write(offset, value);
      }
    };
  }
}

/** @param {Core} core @param {(masked: boolean) => void} onMask */
function watchPrimask(core, onMask) {
  let masked = core.PM;
  Object.defineProperty(core, 'PM', {
    get: () => masked,
    set: (/** @type {boolean} */ value) => {
      if (value === masked) return;
      masked = value;
      onMask(value);
    },
  });
}

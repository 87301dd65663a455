// The local clock of one chip: virtual nanoseconds since its last boot, and alarms in order of time.
// Alarms of the same instant fire in the order in which they were set, which the package's own clock reverses.

/** One alarm; it fires once for each `schedule`. Implements rp2040js' `IAlarm`. */
export class Alarm {
  /** @param {VirtualClock} clock @param {() => void} callback */
  constructor(clock, callback) {
    this.clock = clock;
    this.callback = callback;
    /** @type {Alarm | null} */
    this.next = null;
    this.nanos = 0;
    this.scheduled = false;
  }

  /** @param {number} deltaNanos from now; a negative delta fires at once */
  schedule(deltaNanos) {
    this.scheduleAt(this.clock.nanos + Math.max(0, deltaNanos));
  }

  /** @param {number} nanos local time */
  scheduleAt(nanos) {
    if (this.scheduled) this.cancel();
    this.nanos = nanos;
    this.scheduled = true;
    this.clock.link(this);
  }

  cancel() {
    if (!this.scheduled) return;
    this.scheduled = false;
    this.clock.unlink(this);
  }
}

/** Implements rp2040js' `IClock`. */
export class VirtualClock {
  constructor() {
    this.nanos = 0;
    /** @type {Alarm | null} the earliest alarm */
    this.first = null;
  }

  get micros() {
    return this.nanos / 1000;
  }

  /** @param {() => void} callback */
  createAlarm(callback) {
    return new Alarm(this, callback);
  }

  /** @param {Alarm} alarm */
  link(alarm) {
    let before = null;
    let after = this.first;
    while (after && after.nanos <= alarm.nanos) {
      before = after;
      after = after.next;
    }
    alarm.next = after;
    if (before) before.next = alarm;
    else this.first = alarm;
  }

  /** @param {Alarm} alarm */
  unlink(alarm) {
    if (this.first === alarm) {
      this.first = alarm.next;
      return;
    }
    for (let a = this.first; a; a = a.next) {
      if (a.next === alarm) {
        a.next = alarm.next;
        return;
      }
    }
  }

  /** Moves to `target`, firing what is due on the way. @param {number} target local time, not before now */
  advanceTo(target) {
    let alarm = this.first;
    while (alarm && alarm.nanos <= target) {
      this.first = alarm.next;
      alarm.scheduled = false;
      if (alarm.nanos > this.nanos) this.nanos = alarm.nanos;
      alarm.callback();
      alarm = this.first;
    }
    this.nanos = target;
  }
}

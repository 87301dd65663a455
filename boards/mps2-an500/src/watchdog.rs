//! The watchdog: resets the device where routing stands still.
//!
//! - **Walk:** routing → [`Watchdog::feed`]; else, after [`WATCHDOG_US`], the non-maskable interrupt, whose handler writes a report and
//!   resets; and where even that one hangs, after as long again the watchdog resets of itself.
//! - **Invariant:** serving and idle do not feed it, so that a user function that never returns resets nothing.
//! - **Context:** start-up and the routing task.

use crate::clock::TICKS_A_US;
use crate::pac::{Registers, WATCHDOG_UNLOCK, WatchdogRegisters};

/// How long routing may stand still, µs. Long, since an emulator on a busy machine stands still itself now and then.
pub const WATCHDOG_US: u32 = 2_000_000;

/// Interrupt and reset.
const ON: u32 = 0b11;

/// The watchdog.
pub struct Watchdog {
    registers: Registers<WatchdogRegisters>,
}

impl Watchdog {
    pub(crate) const fn new(registers: Registers<WatchdogRegisters>) -> Self {
        Self { registers }
    }

    /// Starts it.
    #[must_use]
    pub fn start(self) -> Self {
        self.registers.lock.set(WATCHDOG_UNLOCK);
        self.registers.load.set(WATCHDOG_US * TICKS_A_US);
        self.registers.control.set(ON);
        self
    }

    /// Begins anew.
    pub fn feed(&mut self) {
        self.registers.interrupt_clear.set(1);
    }
}

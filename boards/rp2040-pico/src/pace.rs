//! A steady beat: the wrap of a PWM slice, every 64 µs, 15.625 kHz.
//!
//! - **Walk:** [`Pace::start`] → interrupt `PWM_IRQ_WRAP` every [`PERIOD_US`] → [`Pace::clear`] in it.
//! - **Invariants:** the slice counts whole cycles of the system clock, so that beats neither drift nor depend on how late the last one was
//!   served. It drives no pin. Of the PWM's slices only this one interrupts.
//! - **Context:** [`Pace::start`] in `init`, [`Pace::clear`] in the interrupt.

use crate::CORE_HZ;
use rp2040_hal::pac;

/// From one beat to the next, µs.
pub const PERIOD_US: u32 = 64;
/// From one beat to the next, cycles.
pub const PERIOD_CYCLES: u32 = PERIOD_US * (CORE_HZ / 1_000_000);
const _: () = assert!(PERIOD_CYCLES <= 1 << 16, "the slice has 16 bits");

/// The PWM's slice that beats.
const SLICE: usize = 0;

/// The beat. It stands still until it is started.
pub struct Pace(());

impl Pace {
    /// Of a PWM that is out of its reset.
    pub(crate) const fn new() -> Self {
        Self(())
    }

    /// Starts it: the first beat comes in [`PERIOD_US`].
    pub fn start(self) {
        let slice = registers().ch(SLICE);
        // SAFETY: TOP takes 16 bits, which the period has; INTE is this module's alone
        unsafe {
            slice.top().write(|w| w.bits(PERIOD_CYCLES - 1));
            registers().inte().write(|w| w.bits(1 << SLICE));
        }
        slice.csr().write(|w| w.en().set_bit());
    }

    /// Ends the interrupt. In the interrupt.
    pub fn clear() {
        // SAFETY: clearing the flag of this module's slice
        registers().intr().write(|w| unsafe { w.bits(1 << SLICE) });
    }
}

fn registers() -> &'static pac::pwm::RegisterBlock {
    // SAFETY: the block is there for good; its slice, INTE and the slice's flag in INTR belong to the one `Pace`
    unsafe { &*pac::PWM::ptr() }
}

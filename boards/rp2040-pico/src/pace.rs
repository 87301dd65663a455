//! The beat of interpolation: the wrap of a PWM slice, every 64, 32, 16 or 8 µs, which may be trimmed to follow another clock.
//!
//! - **Walk:** [`Pace::start`] → interrupt `PWM_IRQ_WRAP` at every wrap → [`Pace::clear`] and [`Pace::wrap_stamp`] in it → who locks beats to
//!   system time → [`Pace::set_period`].
//! - **Invariants:** the slice counts whole cycles of the system clock, so that beats neither drift nor depend on how late the last one was
//!   served; no cycle is lost where a period changes. It drives no pin. Of the PWM's slices only this one interrupts. Two wraps before one
//!   interrupt are one beat: [`Pace::wrap_stamp`] is then that of the later.
//! - **Context:** [`Pace::start`] in `init` or in the interrupt, the rest in the interrupt, which nothing preempts.

use crate::clock::{self, Stamp};
use crate::{CORE_HZ, pac};
use fixed_math::time::{FRACTION_BITS, LocalTicks};

/// Cycles of the counter a microsecond: those of the processor.
pub const CYCLES_A_US: u32 = CORE_HZ / 1_000_000;
/// Periods that there are, µs.
pub const PERIODS_US: [u32; 4] = [64, 32, 16, 8];
const _: () = assert!(2 * PERIODS_US[0] * CYCLES_A_US <= 1 << 16, "the slice has 16 bits");

/// The PWM's slice that beats.
const SLICE: usize = 0;
/// Cycles from the reading of a stamp's sixteenths to that of the count: one load from a peripheral. The compiler may put another
/// instruction in between, of two cycles, a quarter of a sixteenth.
const STAMP_TO_COUNT_CYCLES: u32 = 4;

/// The beat. It stands still until it is started.
pub struct Pace {
    nominal_cycles: u32,
    /// The microsecond timer at the last stamp, µs.
    last_us: u64,
}

impl Pace {
    /// Of a PWM that is out of its reset.
    pub(crate) const fn new() -> Self {
        Self { nominal_cycles: PERIODS_US[0] * CYCLES_A_US, last_us: 0 }
    }

    /// Starts it, or starts it anew: the first beat comes in `period_us`.
    ///
    /// # Panics
    /// Where the period is none of [`PERIODS_US`], which is a mistake of the image.
    pub fn start(&mut self, period_us: u32) {
        assert!(PERIODS_US.contains(&period_us), "no such period");
        self.nominal_cycles = period_us * CYCLES_A_US;
        self.last_us = clock::now_us();
        let slice = registers().ch(SLICE);
        slice.csr().write(|w| w.en().clear_bit());
        // SAFETY: any count is valid; INTE is this module's alone
        unsafe {
            slice.ctr().write(|w| w.bits(0));
            registers().inte().write(|w| w.bits(1 << SLICE));
        }
        self.set_period(self.nominal_cycles);
        slice.csr().write(|w| w.en().set_bit());
    }

    /// From one beat to the next where it is not trimmed, cycles.
    #[must_use]
    pub const fn nominal_cycles(&self) -> u32 {
        self.nominal_cycles
    }

    /// Makes the next period, which begins with the next wrap, and those after it `cycles` long; the one under way stays as it is. Taken to
    /// within half and twice the nominal period; gives back what it is.
    pub fn set_period(&mut self, cycles: u32) -> u32 {
        let cycles = cycles.max(self.nominal_cycles / 2).min(2 * self.nominal_cycles);
        // SAFETY: TOP takes 16 bits, which twice the longest period has; the hardware takes it with the wrap
        registers().ch(SLICE).top().write(|w| unsafe { w.bits(cycles - 1) });
        cycles
    }

    /// Cycles since the last wrap: the counter itself.
    #[inline]
    #[must_use]
    pub fn cycles_since_wrap(&self) -> u32 {
        registers().ch(SLICE).ctr().read().bits()
    }

    /// When the last wrap was, by the same clock as the stamps of frames: to a sixteenth of a microsecond, rounded down, and never earlier
    /// than the call before. To be called at least once in 71 minutes. Some 75 cycles.
    pub fn wrap_stamp(&mut self) -> LocalTicks {
        let (stamp, since) = (clock::stamp(), self.cycles_since_wrap());
        let (us, wrap) = wrap_instant(self.last_us, stamp, since);
        self.last_us = us;
        wrap
    }

    /// Ends the interrupt. First thing in the interrupt.
    #[inline]
    pub fn clear(&mut self) {
        // SAFETY: clearing the flag of this module's slice
        registers().intr().write(|w| unsafe { w.bits(1 << SLICE) });
    }
}

/// All 64 bits of a stamp's microseconds and the instant of the wrap, from the microseconds of an earlier stamp, a stamp, and the cycles since
/// the wrap a moment after it.
fn wrap_instant(last_us: u64, stamp: Stamp, since_cycles: u32) -> (u64, LocalTicks) {
    let us = last_us + u64::from(stamp.us.wrapping_sub(last_us as u32));
    let since_stamp = stamp.fraction() + steps(STAMP_TO_COUNT_CYCLES).cast_signed() - steps(since_cycles).cast_signed();
    // a beat is later than the start, so that this does not go below it
    (us, LocalTicks::from_steps((us << FRACTION_BITS).wrapping_add_signed(since_stamp.into())))
}

/// Steps of a [`LocalTicks`] that `cycles` take, 256/125 each, up to 2^16 of them: less than a step off, without a division.
const fn steps(cycles: u32) -> u32 {
    // 6/125 is 3145.73 parts of 2^16, of which there are whole ones
    2 * cycles + ((cycles * 3146) >> 16)
}
const _: () = assert!(steps(0) == 0 && steps(125) == 256 && steps(8_000) == 16_384 && steps(1 << 16) == 134_218);

fn registers() -> &'static pac::pwm::RegisterBlock {
    // SAFETY: the block is there for good; its slice, INTE and the slice's flag in INTR belong to the one `Pace`
    unsafe { &*pac::PWM::ptr() }
}

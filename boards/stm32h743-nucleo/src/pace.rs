//! The beat of interpolation: TIM3 at 192 MHz, every 64, 32, 16 or 8 µs, which may be trimmed to follow another clock.
//!
//! - **Walk:** [`Pace::start`] → interrupt `TIM3` at every wrap → [`Pace::clear`] and [`Pace::wrap_stamp`] in it → who locks beats to system
//!   time → [`Pace::set_period`].
//! - **Invariants:** the counter counts whole cycles of the timers' clock, half the processor's, so that beats neither drift nor depend on how
//!   late the last one was served; no cycle is lost where a period changes. Two wraps before one interrupt are one beat:
//!   [`Pace::wrap_stamp`] is then that of the later. It drives no pin.
//! - **Context:** [`Pace::start`] in `init` or in the interrupt, the rest in the interrupt, which nothing preempts.
//!
//! Registers: RM0433 (rev 7), chapter 39, TIM2 to TIM5; the buffered period in 39.3.1, `ARPE`. Never run on hardware, as this whole crate.

use crate::clock::now;
use fixed_math::time::LocalTicks;
use stm32h7xx_hal::pac;
use stm32h7xx_hal::prelude::*;
use stm32h7xx_hal::rcc::{CoreClocks, rec};

/// Cycles of the counter a microsecond.
pub const CYCLES_A_US: u32 = TIMER_HZ / 1_000_000;
/// Periods that there are, µs.
pub const PERIODS_US: [u32; 4] = [64, 32, 16, 8];
const _: () = assert!(2 * PERIODS_US[0] * CYCLES_A_US <= 1 << 16, "the counter has 16 bits");

/// The clock of the timers: twice that of their bus.
const TIMER_HZ: u32 = crate::BUS_HZ;

/// The beat. It stands still until it is started.
pub struct Pace {
    nominal_cycles: u32,
}

/// Gives the timer its clock. It stands still.
pub(crate) fn set_up(timer: pac::TIM3, rec: rec::Tim3, clocks: &CoreClocks) -> Pace {
    let mut timer = timer.tick_timer(TIMER_HZ.Hz(), rec, clocks);
    timer.pause();
    Pace { nominal_cycles: PERIODS_US[0] * CYCLES_A_US }
}

impl Pace {
    /// Starts it, or starts it anew: the first beat comes in `period_us`.
    ///
    /// # Panics
    /// Where the period is none of [`PERIODS_US`], which is a mistake of the image.
    pub fn start(&mut self, period_us: u32) {
        assert!(PERIODS_US.contains(&period_us), "no such period");
        self.nominal_cycles = period_us * CYCLES_A_US;
        let timer = registers();
        // TIMx_CR1: stopped, the period buffered, and only a wrap is an update that interrupts
        timer.cr1.write(|w| w.arpe().set_bit().urs().set_bit());
        self.set_period(self.nominal_cycles);
        // TIMx_EGR.UG begins at 0 and takes the period, without an interrupt as URS says
        timer.egr.write(|w| w.ug().set_bit());
        self.clear();
        timer.dier.write(|w| w.uie().set_bit());
        timer.cr1.modify(|_, w| w.cen().set_bit());
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
        // SAFETY: TIMx_ARR takes 16 bits, which twice the longest period has
        registers().arr.write(|w| unsafe { w.bits(cycles - 1) });
        cycles
    }

    /// Cycles since the last wrap: the counter itself.
    #[inline]
    #[must_use]
    pub fn cycles_since_wrap(&self) -> u32 {
        registers().cnt.read().bits()
    }

    /// When the last wrap was, by the same clock as the stamps of frames: to a tick of 16 ns and what two readings take.
    #[must_use]
    pub fn wrap_stamp(&self) -> LocalTicks {
        let (now, since) = (now(), self.cycles_since_wrap());
        LocalTicks::from_steps(now.steps().saturating_sub(steps(since).into()))
    }

    /// Ends the interrupt. First thing in the interrupt, or its end may come too late for the processor.
    #[inline]
    pub fn clear(&mut self) {
        // SAFETY: TIMx_SR: a zero clears a flag and a one leaves it
        registers().sr.write(|w| unsafe { w.bits(!1) });
    }
}

/// Steps of a [`LocalTicks`] that `cycles` take, rounded down.
const fn steps(cycles: u32) -> u32 {
    cycles * 256 / CYCLES_A_US
}

fn registers() -> &'static pac::tim3::RegisterBlock {
    // SAFETY: the block is there for good; it belongs to the one `Pace`
    unsafe { &*pac::TIM3::ptr() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cycles_are_rounded_down_to_steps() {
        assert_eq!([0, 2, 3, 192, 12_288, 65_535].map(steps), [0, 2, 4, 256, 16_384, 87_380]);
    }
}

//! The beat of interpolation: `SysTick`, every 64, 32, 16 or 8 µs, which may be trimmed to follow another clock.
//!
//! - **Walk:** [`Pace::start`] → exception `SysTick` at every wrap → [`Pace::clear`] and [`Pace::wrap_stamp`] in it → who locks beats to system
//!   time → [`Pace::set_period`].
//! - **Invariants:** the counter counts whole ticks, so that beats neither drift nor depend on how late the last one was served; none is lost
//!   where a period changes. A wrap is the instant at which the count comes to 0; a tick later it begins anew, with the period set before.
//!   Two wraps before one exception are one beat: [`Pace::wrap_stamp`] is then that of the later.
//! - **Context:** [`Pace::start`] in `init` or in the exception, the rest in the exception, which nothing preempts.
//!
//! QEMU lets no timer come more often than every 10 µs, unless it counts instructions: 8 µs need `-icount`. Without it each beat is as late as
//! the host makes it, and two that it brings together are one: of beats of 64 µs a busy host brought 7.7 to 15.5 thousand a second. With
//! `-icount …,sleep=off` beats are exact while the processor runs; out of a WFI only every second one comes, with QEMU 7.2 and whatever timer.

use crate::clock::{STEPS_A_US, TICKS_A_US, now};
use crate::pac::{Registers, SystickRegisters};
use fixed_math::time::LocalTicks;

/// Cycles of the counter a microsecond: those of the processor.
pub const CYCLES_A_US: u32 = TICKS_A_US;
/// Periods that there are, µs.
pub const PERIODS_US: [u32; 4] = [64, 32, 16, 8];
const _: () = assert!(2 * PERIODS_US[0] * CYCLES_A_US <= 1 << 24, "the counter has 24 bits");

/// Counts, interrupts, by the processor's clock.
const ON: u32 = 0b111;

/// The beat. It stands still until it is started.
pub struct Pace {
    timer: Registers<SystickRegisters>,
    nominal_cycles: u32,
    /// Of the period under way.
    cycles: u32,
    /// Of the next.
    next_cycles: u32,
}

impl Pace {
    pub(crate) const fn new(timer: Registers<SystickRegisters>) -> Self {
        let cycles = PERIODS_US[0] * CYCLES_A_US;
        Self { timer, nominal_cycles: cycles, cycles, next_cycles: cycles }
    }

    /// Starts it, or starts it anew: the first beat comes in `period_us`.
    ///
    /// # Panics
    /// Where the period is none of [`PERIODS_US`], which is a mistake of the image.
    pub fn start(&mut self, period_us: u32) {
        assert!(PERIODS_US.contains(&period_us), "no such period");
        self.nominal_cycles = period_us * CYCLES_A_US;
        self.timer.control.set(0);
        self.cycles = self.set_period(self.nominal_cycles);
        // any write sets the count to 0, from which it begins anew
        self.timer.value.set(0);
        self.timer.control.set(ON);
    }

    /// From one beat to the next where it is not trimmed, cycles.
    #[must_use]
    pub const fn nominal_cycles(&self) -> u32 {
        self.nominal_cycles
    }

    /// Makes the next period, which begins with the next wrap, and those after it `cycles` long; the one under way stays as it is. Taken to
    /// within half and twice the nominal period; gives back what it is.
    pub fn set_period(&mut self, cycles: u32) -> u32 {
        self.next_cycles = cycles.max(self.nominal_cycles / 2).min(2 * self.nominal_cycles);
        self.timer.reload.set(self.next_cycles - 1);
        self.next_cycles
    }

    /// Cycles since the last wrap. To be called behind [`Pace::clear`]: before it, it is wrong by the trim where the period was changed.
    #[inline]
    #[must_use]
    pub fn cycles_since_wrap(&self) -> u32 {
        since_wrap(self.cycles, self.timer.value.get())
    }

    /// When the last wrap was, by the same clock as the stamps of frames: to a tick of 40 ns.
    #[must_use]
    pub fn wrap_stamp(&self) -> LocalTicks {
        let (now, since) = (now(), self.cycles_since_wrap());
        LocalTicks::from_steps(now.steps().saturating_sub((since * STEPS_A_US / CYCLES_A_US).into()))
    }

    /// Takes note of the beat; the exception ends by itself. First thing in the exception.
    #[inline]
    pub fn clear(&mut self) {
        self.cycles = self.next_cycles;
    }
}

/// Cycles since the count came to 0, of a period of `cycles` that counts down.
const fn since_wrap(cycles: u32, value: u32) -> u32 {
    if value == 0 { 0 } else { cycles.saturating_sub(value) }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::boxed::Box;
    use vcell::VolatileCell;

    #[test]
    fn a_wrap_is_where_the_count_comes_to_0() {
        assert_eq!([0, 199, 198, 1].map(|value| since_wrap(200, value)), [0, 1, 2, 199]);
    }

    #[test]
    fn the_next_period_is_trimmed_and_the_one_under_way_is_not() {
        let word = || VolatileCell::new(0);
        let memory = SystickRegisters { control: word(), reload: word(), value: word() };
        let mut pace = Pace::new(Registers::of(Box::leak(Box::new(memory))));
        pace.start(8);
        assert_eq!((pace.timer.reload.get(), pace.timer.control.get(), pace.nominal_cycles()), (199, 7, 200));
        pace.timer.value.set(150);
        assert_eq!(pace.set_period(203), 203);
        assert_eq!((pace.cycles_since_wrap(), pace.timer.reload.get()), (50, 202));
        pace.timer.value.set(202);
        pace.clear();
        assert_eq!(pace.cycles_since_wrap(), 1);
        assert_eq!((pace.set_period(0), pace.set_period(u32::MAX)), (100, 400));
    }
}

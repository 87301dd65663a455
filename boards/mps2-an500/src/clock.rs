//! Time: a counter of 25 MHz that never ends, and a wake-up.
//!
//! - **Walk:** a receive interrupt asks [`now`] for its stamp; routing asks it for the present and keeps the count with [`keep`].
//! - **Invariants:** [`now`] never goes back and is the same at every priority, interrupts masked or not: it takes no lock, and needs no
//!   interrupt of its own. The timer goes round in 134 s, which is two halves of 2^26 µs. [`keep`] writes down how many halves have
//!   passed; the timer itself tells in which half of its round it is, so that a reader sees by their parity whether one more half has
//!   passed since. That holds as long as [`keep`] is called at least once in each half, and no reader is held up between its two loads
//!   for longer than one: 67 s, where routing calls it every 100 ms.
//! - **Context:** [`now`] any; [`keep`] the routing task alone, as there is one writer.
//!
//! A step of [`LocalTicks`] is 1/256 µs and a tick 40 ns: the conversion rounds down, by less than one step, and does not add up.

use crate::pac::{Registers, TimerRegisters, clock_value};
use core::sync::atomic::{AtomicU32, Ordering};
use fixed_math::time::LocalTicks;

/// Ticks of every timer a microsecond.
pub const TICKS_A_US: u32 = 25;
/// Half a round is `1 << HALF_US_LOG2` µs.
const HALF_US_LOG2: u32 = 26;
/// Ticks of half a round.
const HALF_TICKS: u32 = TICKS_A_US << HALF_US_LOG2;
/// Steps of `LocalTicks` a microsecond.
pub(crate) const STEPS_A_US: u32 = 256;

/// Bits of a timer's control register.
const COUNTS: u32 = 1;
const INTERRUPTS: u32 = 1 << 3;

/// Half rounds that had passed when routing ran last.
static HALVES: AtomicU32 = AtomicU32::new(0);

/// Sets the timer going. The counter begins at its start, near 0.
#[expect(clippy::needless_pass_by_value, reason = "nobody else shall have the timer")]
pub(crate) fn start(timer: Registers<TimerRegisters>) {
    timer.reload.set(2 * HALF_TICKS - 1);
    timer.value.set(2 * HALF_TICKS - 1);
    timer.control.set(COUNTS);
}

/// The present.
#[must_use]
pub fn now() -> LocalTicks {
    // the kept number first: with it the count may be from one half later, never from one before
    let halves = HALVES.load(Ordering::Relaxed);
    core::sync::atomic::compiler_fence(Ordering::SeqCst);
    let (halves, ticks) = place(halves, (2 * HALF_TICKS - 1).wrapping_sub(clock_value()));
    instant(halves, ticks)
}

/// Writes down how far the clock has come. To be called by one task, at least every 67 s.
pub fn keep() {
    let (halves, _) = place(HALVES.load(Ordering::Relaxed), (2 * HALF_TICKS - 1).wrapping_sub(clock_value()));
    HALVES.store(halves, Ordering::Relaxed);
}

/// Half rounds passed and ticks since the last, from the halves kept and the ticks of this round.
const fn place(kept: u32, ticks: u32) -> (u32, u32) {
    let (half, ticks) = if ticks < HALF_TICKS { (0, ticks) } else { (1, ticks - HALF_TICKS) };
    (kept.wrapping_add((kept & 1) ^ half), ticks)
}

/// The instant `ticks` after `halves` half rounds. Dividing 32 bits by a constant is a multiplication to the compiler.
const fn instant(halves: u32, ticks: u32) -> LocalTicks {
    let (us, rest) = (ticks / TICKS_A_US, ticks % TICKS_A_US);
    let us = ((halves as u64) << HALF_US_LOG2) + us as u64;
    LocalTicks::from_steps(us * STEPS_A_US as u64 + (rest * STEPS_A_US / TICKS_A_US) as u64)
}

/// The timer that wakes routing.
pub struct Wake {
    timer: Registers<TimerRegisters>,
}

/// Clears the wake-up's interrupt.
pub struct WakeInterrupt {
    timer: Registers<TimerRegisters>,
}

impl Wake {
    pub(crate) const fn new(timer: Registers<TimerRegisters>) -> Self {
        Self { timer }
    }

    /// What the timer's interrupt needs.
    #[must_use]
    pub fn split(self) -> (Self, WakeInterrupt) {
        // SAFETY: the interrupt's half writes the clearing register alone, where a write of either half means the same.
        let timer = unsafe { self.timer.share() };
        (self, WakeInterrupt { timer })
    }

    /// Has the interrupt come at `at`, or at once where that is past; not later than a second after `now`.
    pub fn set(&mut self, at: LocalTicks, now: LocalTicks) {
        self.timer.control.set(0);
        self.timer.interrupts.set(1);
        self.timer.value.set(wake_ticks(at, now));
        self.timer.control.set(COUNTS | INTERRUPTS);
    }
}

impl WakeInterrupt {
    /// The body of the timer's interrupt.
    pub fn on_interrupt(&mut self) {
        self.timer.interrupts.set(1);
    }
}

/// Ticks from `now` until not before `at`, from 1 to a second's.
fn wake_ticks(at: LocalTicks, now: LocalTicks) -> u32 {
    let second = TICKS_A_US * 1_000_000;
    let steps = at.since(now).steps().min(u64::from(STEPS_A_US) * 1_000_000);
    let ticks = (steps * u64::from(TICKS_A_US)).div_ceil(u64::from(STEPS_A_US));
    u32::try_from(ticks).map_or(second, |ticks| ticks.max(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// However late the halves are kept, within one, the clock goes on; and it is exact at whole microseconds.
    #[test]
    fn time_goes_on_over_rounds() {
        let mut kept = 0;
        let mut last = LocalTicks::ZERO;
        for step in 0..40u64 {
            // 0.45 of a half at a time, kept every second time only
            let ticks = step * u64::from(HALF_TICKS) * 45 / 100;
            let (halves, within) = place(kept, u32::try_from(ticks % (2 * u64::from(HALF_TICKS))).unwrap());
            let now = instant(halves, within);
            assert_eq!(now.as_us(), ticks / 25, "step {step}");
            assert!(now >= last);
            last = now;
            if step % 2 == 0 {
                kept = halves;
            }
        }
        assert!(kept >= 16);
    }

    #[test]
    fn ticks_are_rounded_down_to_steps() {
        assert_eq!(instant(0, 1).steps(), 10); // 10.24
        assert_eq!(instant(0, 24).steps(), 245); // 245.76
        assert_eq!(instant(1, 25).steps(), ((1 << 26) + 1) * 256);
        assert_eq!(instant((1 << 20) - 1, HALF_TICKS - 1).as_us(), (1 << 46) - 1); // two million years short of the end
    }

    #[test]
    fn a_wake_up_is_never_early_and_always_comes() {
        let now = LocalTicks::from_steps(1000);
        let ticks = |steps| wake_ticks(LocalTicks::from_steps(steps), now);
        assert_eq!((ticks(0), ticks(1000), ticks(1001)), (1, 1, 1));
        assert_eq!((ticks(1010), ticks(1011)), (1, 2)); // 0.98 and 1.07 ticks
        assert_eq!(ticks(u64::MAX), 25_000_000);
    }
}

//! Time: TIM5 at 64 MHz, which is four steps of [`LocalTicks`] a tick, exactly; and a wake-up by its first compare channel.
//!
//! - **Walk:** an interrupt asks [`now`] for its stamp; routing asks it for the present, keeps the count with [`keep`] and sets [`Wake`].
//! - **Invariants:** [`now`] never goes back and takes no lock, at any priority. The counter goes round in 67 s. [`keep`] writes down
//!   how many half rounds have passed; the counter's top bit tells in which half it is, so that a reader sees by their parity whether
//!   one more has passed since. That holds as long as [`keep`] is called at least once in each half, and no reader is held up between
//!   its two loads for longer than one: 33 s, where routing calls it every 100 ms.
//! - **Context:** [`now`] any; [`keep`] and [`Wake`] the routing task alone; [`WakeInterrupt`] in `TIM5`.
//!
//! Registers: RM0433 (rev 7), chapter 39, TIM2 to TIM5.

use core::sync::atomic::{AtomicU32, Ordering, compiler_fence};
use fixed_math::time::LocalTicks;
use stm32h7xx_hal::pac;
use stm32h7xx_hal::prelude::*;
use stm32h7xx_hal::rcc::{CoreClocks, rec};

/// Ticks a second.
pub const TICK_HZ: u32 = 64_000_000;
/// Steps of `LocalTicks` a tick.
const STEPS_A_TICK: u64 = 256_000_000 / TICK_HZ as u64;
const _: () = assert!(256_000_000 % TICK_HZ == 0, "a tick is a whole number of steps");
/// Half a round of the counter, ticks, is two to this.
const HALF_BITS: u32 = 31;
/// A wake-up further away than this, ticks, comes after so many: a quarter of a round, 17 s.
const AHEAD_TICKS_MAX: u64 = 1 << 30;

/// Half rounds that had passed when routing ran last.
static HALVES: AtomicU32 = AtomicU32::new(0);

/// Sets the timer going. The counter begins at 0.
pub(crate) fn start(timer: pac::TIM5, rec: rec::Tim5, clocks: &CoreClocks) -> (Wake, WakeInterrupt) {
    let mut timer = timer.tick_timer(TICK_HZ.Hz(), rec, clocks);
    // TIMx_DIER: the compare channel alone. Its mode is "frozen" after reset: it compares and drives no pin.
    timer.inner_mut().dier.write(|w| w.cc1ie().set_bit());
    (Wake(()), WakeInterrupt(()))
}

/// The present.
#[must_use]
pub fn now() -> LocalTicks {
    // the kept number first: with it the count may be from one half later, never from one before
    let kept = HALVES.load(Ordering::Relaxed);
    compiler_fence(Ordering::SeqCst);
    let count = counter();
    instant(halves(kept, count), count)
}

/// Writes down how far the clock has come. To be called by one task, at least every 33 s.
pub fn keep() {
    HALVES.store(halves(HALVES.load(Ordering::Relaxed), counter()), Ordering::Relaxed);
}

/// Half rounds that have passed, from those kept and the counter.
const fn halves(kept: u32, count: u32) -> u32 {
    kept.wrapping_add((kept & 1) ^ (count >> HALF_BITS))
}

/// The instant at which the counter stands at `count` after `halves` half rounds.
const fn instant(halves: u32, count: u32) -> LocalTicks {
    let within = count & ((1 << HALF_BITS) - 1);
    LocalTicks::from_steps(((halves as u64) << HALF_BITS | within as u64) * STEPS_A_TICK)
}

/// What the counter shows at `at`, or at [`AHEAD_TICKS_MAX`] from `now` where that is earlier; never before `at`.
fn count_at(at: LocalTicks, now: LocalTicks) -> u32 {
    let latest = now.steps().saturating_add(AHEAD_TICKS_MAX * STEPS_A_TICK);
    #[expect(clippy::cast_possible_truncation, reason = "the counter is the low word of all ticks")]
    let count = at.steps().min(latest).div_ceil(STEPS_A_TICK) as u32;
    count
}

/// Sets when routing is woken.
pub struct Wake(());

impl Wake {
    /// Has the interrupt come at `at`, at once where that is past, within 17 s in any case.
    pub fn set(&mut self, at: LocalTicks) {
        let count = count_at(at, now());
        let timer = registers();
        timer.ccr1().write(|w| w.ccr().bits(count));
        // TIMx_EGR.CC1G makes the event by hand, where the counter has passed it; should it come twice, routing runs twice
        if count.wrapping_sub(counter()).cast_signed() <= 0 {
            timer.egr.write(|w| w.cc1g().set_bit());
        }
    }
}

/// Ends the wake-up's interrupt.
pub struct WakeInterrupt(());

impl WakeInterrupt {
    /// The body of the timer's interrupt.
    pub fn on_interrupt(&mut self) {
        // TIMx_SR: a zero clears a flag and a one leaves it
        registers().sr.modify(|_, w| w.cc1if().clear_bit());
    }
}

fn counter() -> u32 {
    registers().cnt.read().bits()
}

fn registers() -> &'static pac::tim5::RegisterBlock {
    // SAFETY: the block is there for good. The counter is only read; the compare channel is written by the one `Wake`, its flag by the
    // one `WakeInterrupt`
    unsafe { &*pac::TIM5::ptr() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// However late the halves are kept, within one, the clock goes on, exactly.
    #[test]
    fn time_goes_on_over_rounds() {
        let mut kept = 0;
        let mut last = None;
        for step in 0..40u64 {
            // 0.45 of a half at a time, kept every second time only
            let ticks = step * (1 << HALF_BITS) * 45 / 100;
            let count = u32::try_from(ticks & u64::from(u32::MAX)).unwrap();
            let halves = halves(kept, count);
            let now = instant(halves, count);
            assert_eq!(now.steps(), ticks * 4, "step {step}");
            assert!(last < Some(now));
            last = Some(now);
            if step % 2 == 0 {
                kept = halves;
            }
        }
        assert_eq!(kept, 17); // 38 times 0.45
    }

    #[test]
    fn a_wake_up_is_never_early_and_wraps_with_the_counter() {
        let now = LocalTicks::from_steps(4000);
        let count = |steps| count_at(LocalTicks::from_steps(steps), now);
        assert_eq!((count(4000), count(4001), count(4004), count(4005)), (1000, 1001, 1001, 1002));
        assert_eq!(count(u64::MAX), 1000 + (1 << 30));
        let late = LocalTicks::from_steps(((1 << 32) - 1) * 4);
        assert_eq!(count_at(late + fixed_math::time::Span::from_steps(8), late), 1);
    }
}

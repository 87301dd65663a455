//! The microsecond timer: what time it is, and waking at one.
//!
//! - **Invariants:** 64 bits, never set, so it neither wraps nor jumps.
//! - **Context:** [`now`] anywhere; [`Alarm`] in the routing task and the interrupt `TIMER_IRQ_0`.

use fixed_math::time::{FRACTION_BITS, LocalTicks};
use rp2040_hal::clocks::ClocksManager;
use rp2040_hal::pac;
use rp2040_hal::timer::Timer;

/// An alarm further away than this is set again when it has come: half the counter's low word.
const AHEAD_US_MAX: u64 = 1 << 31;

/// The timer's low word, to be copied by DMA as a stamp.
#[must_use]
pub fn stamp_address() -> u32 {
    registers().timerawl().as_ptr() as u32
}

/// The time since start-up.
#[must_use]
pub fn now() -> LocalTicks {
    LocalTicks::from_us(now_us())
}

/// The time since start-up, µs.
#[must_use]
pub fn now_us() -> u64 {
    let timer = registers();
    loop {
        let high = timer.timerawh().read().bits();
        let low = timer.timerawl().read().bits();
        if timer.timerawh().read().bits() == high {
            return u64::from(high) << 32 | u64::from(low);
        }
    }
}

/// Instant of a stamp's low word that lies less than 16 seconds before `now`.
#[must_use]
pub fn at_stamp(stamp: u32, now: LocalTicks) -> LocalTicks {
    #[expect(clippy::cast_possible_truncation, reason = "the low word is what a stamp is compared with")]
    let age_us = (now.as_us() as u32).wrapping_sub(stamp);
    // a stamp that came after `now` was read is of now
    let age_us = if age_us.cast_signed() < 0 { 0 } else { age_us };
    LocalTicks::from_steps(now.steps().saturating_sub(u64::from(age_us << FRACTION_BITS)))
}

/// Starts the timer.
pub(crate) fn start(timer: pac::TIMER, resets: &mut pac::RESETS, clocks: &ClocksManager) -> Alarm {
    let _counts = Timer::new(timer, resets, clocks);
    registers().inte().modify(|_, w| w.alarm_0().set_bit());
    Alarm(())
}

/// Alarm 0, interrupt `TIMER_IRQ_0`.
pub struct Alarm(());

impl Alarm {
    /// Has the interrupt come at `at`, or soon where that is past; it may come early.
    pub fn set(&mut self, at: LocalTicks) {
        let now = now_us();
        // a whole microsecond after `at`, as the counter may be about to count; at least two ahead, or it would be missed
        let us = (at.as_us() + 1).clamp(now + 2, now + AHEAD_US_MAX);
        #[expect(clippy::cast_possible_truncation, reason = "the alarm compares the low word")]
        registers().alarm0().write(|w| unsafe {
            // SAFETY: any word is an instant
            w.bits(us as u32)
        });
    }

    /// Ends the interrupt. In the interrupt.
    pub fn clear() {
        registers().intr().write(|w| w.alarm_0().clear_bit_by_one());
    }
}

fn registers() -> &'static pac::timer::RegisterBlock {
    // SAFETY: the block is there for good; `timeraw` is read only and changes nothing, alarm 0 belongs to the one `Alarm`
    unsafe { &*pac::TIMER::ptr() }
}

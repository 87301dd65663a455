//! The time: the microsecond timer, sixteenths of its microsecond by a slice of the PWM, and waking at an instant.
//!
//! The timer counts microseconds of the crystal; a slice counts the system clock by 7 13/16, which makes 16 counts of 125 cycles. Both come
//! from the one crystal by whole numbers, so that neither gains on the other, and the slice begins with a count that fits the timer. What
//! is read of both is an instant to a sixteenth; which of the two was read first does not matter, within 8 µs.
//!
//! - **Walk:** DMA and [`stamp`] take a [`Stamp`] → [`at_stamp`] → [`LocalTicks`].
//! - **Invariants:** 64 bits, never set, so it neither wraps nor jumps. The low bits are the slice's: later readings are never smaller.
//!   Against the timer's edges they are
//!   shifted by a count or so, the same from a start to the next one.
//! - **Context:** [`now`] anywhere; [`Alarm`] in the routing task and the interrupt `TIMER_IRQ_0`.

use crate::CORE_HZ;
use fixed_math::time::{FRACTION_BITS, LocalTicks};
use rp2040_hal::clocks::ClocksManager;
use rp2040_hal::pac;
use rp2040_hal::timer::Timer;

/// An alarm further away than this is set again when it has come: half the counter's low word.
const AHEAD_US_MAX: u64 = 1 << 31;
/// The PWM's slice that counts sixteenths of a microsecond. Its pins are not led out by it.
const SLICE: usize = 7;
/// Its divisor, sixteenths of a cycle: so many as a microsecond has cycles.
const DIVISOR: u32 = CORE_HZ / 1_000_000;
/// Its counts a microsecond, as a power of two.
const COUNT_BITS: u32 = 4;
/// Counts from the timer's edge to the slice's first cycle, in [`start`]: some 29 cycles.
const START_COUNTS: u32 = 4;
/// How far a stamp may lie after the instant it is compared with, µs: a second.
const AFTER_US: u32 = 1 << 20;

/// A reading of both counters at once, or of one soon after the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamp {
    /// Low word of the timer, µs.
    pub us: u32,
    /// Low byte of the slice's counter, 1/16 µs.
    pub sixteenths: u8,
}

impl Stamp {
    /// Steps of a [`LocalTicks`] from the timer's microsecond to the instant itself, of either sign where the counters were not read at once.
    pub(crate) const fn fraction(self) -> i32 {
        let of_timer = (self.us << COUNT_BITS).to_le_bytes()[0];
        (self.sixteenths.wrapping_sub(of_timer).cast_signed() as i32) << (FRACTION_BITS - COUNT_BITS)
    }
}

/// The timer's low word, to be copied by DMA as a stamp's microseconds.
#[must_use]
pub(crate) fn us_address() -> u32 {
    registers().timerawl().as_ptr() as u32
}

/// The slice's counter, whose low byte is to be copied by DMA as a stamp's sixteenths.
#[must_use]
pub(crate) fn sixteenths_address() -> u32 {
    slices().ch(SLICE).ctr().as_ptr() as u32
}

/// Both counters now, sixteenths last.
#[must_use]
pub fn stamp() -> Stamp {
    let us = registers().timerawl().read().bits();
    Stamp { us, sixteenths: slices().ch(SLICE).ctr().read().bits().to_le_bytes()[0] }
}

/// The time since start-up, to a sixteenth of a microsecond.
#[must_use]
pub fn now() -> LocalTicks {
    let timer = registers();
    loop {
        let high = timer.timerawh().read().bits();
        let Stamp { us, sixteenths } = stamp();
        // an interrupt in between could part the two by more than they can be told apart by
        let is_close = timer.timerawl().read().bits().wrapping_sub(us) <= 1;
        if is_close && timer.timerawh().read().bits() == high {
            let steps = (u64::from(high) << 32 | u64::from(us)) << FRACTION_BITS;
            return LocalTicks::from_steps(steps.saturating_add_signed(Stamp { us, sixteenths }.fraction().into()));
        }
    }
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

/// Instant of a stamp that lies less than 71 minutes before `now`, or less than a second after it: of a byte that came since `now` was read.
/// Taken for `now` itself, such a one would have a clock believe that the byte was early.
#[must_use]
pub fn at_stamp(stamp: Stamp, now: LocalTicks) -> LocalTicks {
    let after_us = now.as_us() + u64::from(AFTER_US);
    let us = after_us.saturating_sub(u64::from((after_us as u32).wrapping_sub(stamp.us)));
    LocalTicks::from_steps((us << FRACTION_BITS).saturating_add_signed(stamp.fraction().into()))
}

/// Starts timer and slice.
pub(crate) fn start(timer: pac::TIMER, resets: &mut pac::RESETS, clocks: &ClocksManager) -> Alarm {
    let _counts = Timer::new(timer, resets, clocks);
    registers().inte().modify(|_, w| w.alarm_0().set_bit());
    resets.reset().modify(|_, w| w.pwm().clear_bit());
    while resets.reset_done().read().pwm().bit_is_clear() {}
    let slice = slices().ch(SLICE);
    // SAFETY: any divisor and any count are valid; out of reset TOP is 0xffff, which a whole number of microseconds fits into
    unsafe {
        slice.div().write(|w| w.bits(DIVISOR));
        let before = registers().timerawl().read().bits();
        let us = loop {
            let us = registers().timerawl().read().bits();
            if us != before {
                break us;
            }
        };
        slice.ctr().write(|w| w.bits((us << COUNT_BITS).wrapping_add(START_COUNTS) & 0xffff));
    }
    slice.csr().write(|w| w.en().set_bit());
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

fn slices() -> &'static pac::pwm::RegisterBlock {
    // SAFETY: the block is there for good; this module writes its own slice only, and only in `start`
    unsafe { &*pac::PWM::ptr() }
}

//! The workstation's counter: the one place where links read a clock.
//!
//! - **Walk:** a link's reader stamps a frame's first byte with it; the node's thread asks it for the time of its calls.
//! - **Invariant:** never goes back. All clones count from the same origin, so that their readings compare.
//! - **Clause:** `[FRM-08]`.
//!
//! ```
//! let clock = osap::link::Clock::new();
//! let earlier = clock.now();
//! assert!(clock.clone().now() >= earlier);
//! ```

use fixed_math::time::{LocalTicks, Span};
use std::time::{Duration, Instant};

/// Readings from which the tick is known; some tens of microseconds.
const TICK_READINGS: u32 = 1_000;
/// What a clock is taken for that stood still over all of them: the coarsest that systems have.
const COARSE_TICK: Span = Span::from_us(20_000);

/// A monotonic counter that starts at zero when it is made.
#[derive(Clone, Debug)]
pub struct Clock {
    origin: Instant,
    /// What it showed then.
    offset: Span,
    /// How much faster than the system's it is, parts per 10⁹.
    ppb: i32,
}

impl Clock {
    /// A clock that reads zero now.
    #[must_use]
    pub fn new() -> Self {
        Self::synthetic(Span::ZERO, 0)
    }

    /// A clock that reads `offset` now and is faster than this computer's by `ppb` parts in 10⁹, down to −500,000,000: another device's, as
    /// far as a measurement with one kernel can have one.
    #[must_use]
    pub fn synthetic(offset: Span, ppb: i32) -> Self {
        Self { origin: Instant::now(), offset, ppb: ppb.max(-500_000_000) }
    }

    /// Its reading.
    #[must_use]
    pub fn now(&self) -> LocalTicks {
        LocalTicks::ZERO + self.offset + span_of(shown(self.origin.elapsed(), self.ppb))
    }

    /// Its tick: the least that two of its readings were seen to differ by, which is no less than what they are rounded to.
    #[must_use]
    pub fn tick(&self) -> Span {
        let mut before = self.now();
        let steps = (0..TICK_READINGS).map(|_| {
            let now = self.now();
            now.since(std::mem::replace(&mut before, now))
        });
        steps.filter(|step| *step > Span::ZERO).min().unwrap_or(COARSE_TICK)
    }

    /// How long until `at`; zero where it is past.
    #[must_use]
    pub fn until(&self, at: LocalTicks) -> Duration {
        awaited(duration_of(at.since(self.now())), self.ppb)
    }
}

impl Default for Clock {
    fn default() -> Self {
        Self::new()
    }
}

const BILLION: u128 = 1_000_000_000;

/// What a clock shows that is faster by so many parts in 10⁹, rounded down.
fn shown(duration: Duration, ppb: i32) -> Duration {
    nanoseconds(duration.as_nanos().saturating_mul(faster(ppb)) / BILLION)
}

/// The time in which such a clock shows `duration`, rounded up.
fn awaited(duration: Duration, ppb: i32) -> Duration {
    nanoseconds(duration.as_nanos().saturating_mul(BILLION).div_ceil(faster(ppb)))
}

/// What such a clock shows in 10⁹ of the system's.
fn faster(ppb: i32) -> u128 {
    u128::from((1_000_000_000 + i64::from(ppb)).unsigned_abs())
}

fn nanoseconds(ns: u128) -> Duration {
    Duration::from_nanos(u64::try_from(ns).unwrap_or(u64::MAX))
}

/// Rounded down to 1/256 µs; 1000 ns are 256 steps, so 125 ns are 32.
fn span_of(duration: Duration) -> Span {
    Span::from_steps(u64::try_from(duration.as_nanos() * 32 / 125).unwrap_or(u64::MAX))
}

/// Rounded up to a nanosecond, so that who waits this long does not come early.
fn duration_of(span: Span) -> Duration {
    nanoseconds((u128::from(span.steps()) * 125).div_ceil(32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_microsecond_is_256_steps_both_ways() {
        assert_eq!(span_of(Duration::from_micros(3)), Span::from_us(3));
        assert_eq!(duration_of(Span::from_us(3)), Duration::from_micros(3));
    }

    #[test]
    fn a_faster_clock_shows_more_and_waits_less_but_never_too_little() {
        let second = Duration::from_secs(1);
        assert_eq!(shown(second, 40_000), Duration::from_micros(1_000_040));
        for ppb in [-400_000_000, -40_000, 0, 1, 40_000, 900_000_000] {
            let waits = awaited(second, ppb);
            assert!(shown(waits, ppb) >= second, "{ppb}: {waits:?}");
            // both roundings are of a nanosecond, and no rate is above 2
            assert!(shown(waits, ppb) <= second + Duration::from_nanos(2), "{ppb}: {waits:?}");
        }
        let ahead = Clock::synthetic(Span::from_us(5_000_000), 0);
        assert!(ahead.now() >= LocalTicks::from_us(5_000_000));
    }

    #[test]
    fn a_tick_is_something_and_no_more_than_what_a_coarse_system_has() {
        let tick = Clock::new().tick();
        assert!(tick > Span::ZERO && tick <= COARSE_TICK, "{tick:?}");
    }

    /// One step is 3.90625 ns: down to whole steps, up to whole nanoseconds.
    #[test]
    fn rounding_never_wakes_anybody_early() {
        assert_eq!(span_of(Duration::from_nanos(3)), Span::ZERO);
        assert_eq!(duration_of(Span::from_steps(1)), Duration::from_nanos(4));
        assert_eq!(duration_of(Span::MAX), Duration::from_nanos(u64::MAX));
    }
}

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
}

impl Clock {
    /// A clock that reads zero now.
    #[must_use]
    pub fn new() -> Self {
        Self { origin: Instant::now() }
    }

    /// Its reading.
    #[must_use]
    pub fn now(&self) -> LocalTicks {
        LocalTicks::ZERO + span_of(self.origin.elapsed())
    }

    /// Its tick: the least that two of its readings were seen to differ by, which is no less than what they are rounded to.
    #[must_use]
    pub fn tick(&self) -> Span {
        let mut least = None;
        let mut last = self.now();
        for _ in 0..TICK_READINGS {
            let now = self.now();
            if now > last {
                let step = now.since(last);
                least = Some(least.map_or(step, |least: Span| least.min(step)));
            }
            last = now;
        }
        least.unwrap_or(COARSE_TICK)
    }

    /// How long until `at`; zero where it is past.
    #[must_use]
    pub fn until(&self, at: LocalTicks) -> Duration {
        duration_of(at.since(self.now()))
    }
}

impl Default for Clock {
    fn default() -> Self {
        Self::new()
    }
}

/// Rounded down to 1/256 µs; 1000 ns are 256 steps, so 125 ns are 32.
fn span_of(duration: Duration) -> Span {
    Span::from_steps(u64::try_from(duration.as_nanos() * 32 / 125).unwrap_or(u64::MAX))
}

/// Rounded up to a nanosecond, so that who waits this long does not come early.
fn duration_of(span: Span) -> Duration {
    let ns = (u128::from(span.steps()) * 125).div_ceil(32);
    Duration::from_nanos(u64::try_from(ns).unwrap_or(u64::MAX))
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

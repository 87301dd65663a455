//! The shortest round trip lately, and what a longer one says of an exchange.
//!
//! - **Walk:** [`LinkClock::observe`](super::LinkClock::observe) → [`ShortestRoundTrip::excess`] → the variance of that exchange.
//! - **Invariants:** the shortest is that of the last [`WINDOW`] to twice as many exchanges, so one that can no longer be reached is
//!   forgotten after that, and not before.
//! - **Context:** once an exchange.
//!
//! Why 512: an exchange is as short as any when nothing delays it and when rounding of its stamps takes off most of what it can. With
//! 30 % of stamps delayed 0.24 of all exchanges are not, and four roundings, each uniform, take off all but one tick of the four with
//! a probability of 1/24. So one in a hundred qualifies, and a window without any is one in 170. Longer, and a path that became slower
//! would be weighted down for longer: 51 s at most at 20 Hz.

/// Exchanges in a window.
pub(super) const WINDOW: u16 = 512;

/// Of two windows, in steps.
#[derive(Clone, Copy, Debug)]
pub(super) struct ShortestRoundTrip {
    before: i64,
    lately: i64,
    seen: u16,
}

impl ShortestRoundTrip {
    pub(super) const NONE: Self = Self { before: i64::MAX, lately: i64::MAX, seen: 0 };

    /// The shortest known; `i64::MAX` before any.
    pub(super) fn steps(&self) -> i64 {
        self.before.min(self.lately)
    }

    /// Takes one more round trip.
    pub(super) fn take(&mut self, steps: i64) {
        if self.seen >= WINDOW {
            *self = Self { before: self.lately, lately: i64::MAX, seen: 0 };
        }
        self.seen += 1;
        self.lately = self.lately.min(steps);
    }

    /// How much longer than the shortest `steps` is.
    pub(super) fn excess(&self, steps: i64) -> i64 {
        steps.saturating_sub(self.steps()).max(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A path that became 100 steps slower is judged by what it is now after two windows at most, and not before one.
    #[test]
    fn a_shorter_path_is_forgotten_in_time() {
        let mut shortest = ShortestRoundTrip::NONE;
        shortest.take(1_000);
        assert_eq!((shortest.excess(1_100), shortest.excess(900)), (100, 0));
        let forgotten = (1..=3 * WINDOW).find(|_| {
            shortest.take(1_100);
            shortest.excess(1_100) == 0
        });
        assert!((WINDOW..=2 * WINDOW).contains(&forgotten.unwrap()), "{forgotten:?}");
    }
}

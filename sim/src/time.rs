//! True time, and the counters of nodes, which run a little faster or slower.
//!
//! - **Walk:** the world's events stand on [`TrueTime`]; each call of an endpoint is given its [`Clock`]'s reading.
//! - **Invariants:** a clock never runs backwards; [`Clock::truth`] is the first instant at which [`Clock::local`] reads at least that much.
//!   Both are exact in integers.
//! - **Context:** the thread that steps the world. **Clause:** `[NOD-12]`.
//!
//! ```
//! use osap_sim::time::{Clock, ClockModel, TrueTime};
//!
//! let clock = Clock::new(ClockModel { rate_ppm: 50.0, offset_us: 7 }, TrueTime::ZERO);
//! assert_eq!(clock.local(TrueTime::from_us(1_000_000)).as_us(), 1_000_057);
//! ```

use fixed_math::time::{FRACTION_BITS, LocalTicks, Span};
use std::ops::Add;

/// An instant of the world, which no node can read: steps of 1/256 µs since the world began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TrueTime(u64);

impl TrueTime {
    /// The world's beginning.
    pub const ZERO: Self = Self(0);
    /// The last instant there is.
    pub const MAX: Self = Self(u64::MAX);

    /// The instant `us` microseconds after the beginning; saturates.
    #[must_use]
    pub const fn from_us(us: u64) -> Self {
        Self(us.saturating_mul(1 << FRACTION_BITS))
    }

    /// The instant `steps` of 1/256 µs after the beginning.
    #[must_use]
    pub const fn from_steps(steps: u64) -> Self {
        Self(steps)
    }

    /// Steps of 1/256 µs since the beginning.
    #[must_use]
    pub const fn steps(self) -> u64 {
        self.0
    }

    /// Whole microseconds since the beginning, rounded down.
    #[must_use]
    pub const fn as_us(self) -> u64 {
        self.0 >> FRACTION_BITS
    }

    /// Time from `earlier` to `self`; zero where `earlier` is the later of the two.
    #[must_use]
    pub const fn since(self, earlier: Self) -> Span {
        Span::from_steps(self.0.saturating_sub(earlier.0))
    }

    /// The instant `span` before, or the beginning.
    #[must_use]
    pub const fn before(self, span: Span) -> Self {
        Self(self.0.saturating_sub(span.steps()))
    }
}

impl Add<Span> for TrueTime {
    type Output = Self;
    fn add(self, span: Span) -> Self {
        Self(self.0.saturating_add(span.steps()))
    }
}

/// What a node's counter is like.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ClockModel {
    /// How much faster than true time it runs, parts per million; within ±500,000.
    pub rate_ppm: f64,
    /// What it reads when its node is added, µs. After a reset it begins at zero.
    pub offset_us: u64,
}

impl ClockModel {
    /// Runs with true time.
    pub const PERFECT: Self = Self { rate_ppm: 0.0, offset_us: 0 };
}

/// Fractional bits of a clock's rate: one part in 2^48 is 0.3 µs in a year.
const RATE_BITS: u32 = 48;

/// A node's counter.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    origin: TrueTime,
    /// What it reads at its origin, steps.
    offset: u64,
    /// Its steps for each step of true time, in units of 2^−48.
    rate: u64,
}

impl Clock {
    /// A counter that begins at `origin`. A rate outside ±500,000 ppm is cut.
    #[must_use]
    pub fn new(model: ClockModel, origin: TrueTime) -> Self {
        let one = 2f64.powi(48);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0.5 to 1.5 times 2^48")]
        let rate = (one + (model.rate_ppm.clamp(-5e5, 5e5) * 1e-6 * one).round()) as u64;
        Self { origin, offset: TrueTime::from_us(model.offset_us).steps(), rate }
    }

    /// The same counter after a reset at `origin`: it begins at zero again.
    #[must_use]
    pub const fn restarted(self, origin: TrueTime) -> Self {
        Self { origin, offset: 0, rate: self.rate }
    }

    /// What it reads at `at`; before its origin, what it reads there.
    #[must_use]
    pub fn local(&self, at: TrueTime) -> LocalTicks {
        let passed = (u128::from(at.since(self.origin).steps()) * u128::from(self.rate)) >> RATE_BITS;
        LocalTicks::from_steps(saturate(u128::from(self.offset) + passed))
    }

    /// The first instant at which it reads `local` or more.
    #[must_use]
    pub fn truth(&self, local: LocalTicks) -> TrueTime {
        let passed = u128::from(local.steps().saturating_sub(self.offset)) << RATE_BITS;
        self.origin + Span::from_steps(saturate(passed.div_ceil(u128::from(self.rate))))
    }
}

fn saturate(steps: u128) -> u64 {
    u64::try_from(steps).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// `[NOD-12]`: 50 ppm is 50 µs a second, to the step.
    #[test]
    fn fifty_ppm_are_fifty_microseconds_a_second() {
        for (rate_ppm, expected_us) in [(50.0, 1_000_050), (-50.0, 999_950), (0.0, 1_000_000)] {
            let clock = Clock::new(ClockModel { rate_ppm, offset_us: 0 }, TrueTime::ZERO);
            let off = clock.local(TrueTime::from_us(1_000_000)).steps().abs_diff(expected_us << 8);
            assert!(off <= 1, "{rate_ppm} ppm: {off} steps off");
        }
    }

    proptest! {
        /// A wake at `truth(local)` finds its time come, and one step earlier it would not have.
        #[test]
        fn truth_is_the_first_instant(ppm in -4e5..4e5, offset_us in 0u64..1 << 40, origin in 0u64..1 << 50, after in 1u64..1 << 55) {
            let clock = Clock::new(ClockModel { rate_ppm: ppm, offset_us }, TrueTime::from_steps(origin));
            let local = LocalTicks::from_steps((offset_us << 8) + after);
            let at = clock.truth(local);
            prop_assert!(clock.local(at) >= local);
            prop_assert!(clock.local(at.before(Span::from_steps(1))) < local);
        }

        #[test]
        fn clocks_never_run_backwards(ppm in -4e5..4e5, at in 0u64..1 << 60, step in 0u64..100) {
            let clock = Clock::new(ClockModel { rate_ppm: ppm, offset_us: 0 }, TrueTime::ZERO);
            prop_assert!(clock.local(TrueTime::from_steps(at)) <= clock.local(TrueTime::from_steps(at + step)));
        }
    }
}

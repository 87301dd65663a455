//! True time, and the counters of nodes, which run a little faster or slower.
//!
//! - **Walk:** the world's events stand on [`TrueTime`]; each call of an endpoint is given its [`Clock`]'s reading.
//! - **Invariant:** instants of the world and readings of a node are two types: nothing that a node sees is true time.
//! - **Context:** the thread that steps the world. **Clause:** `[NOD-12]`.
//!
//! ```
//! use osap_sim::time::{Clock, ClockModel, TrueTime};
//!
//! let clock = Clock::new(ClockModel { offset_us: 7, ..ClockModel::off_by(50.0) }, TrueTime::ZERO);
//! assert_eq!(clock.local(TrueTime::from_us(1_000_000)).as_us(), 1_000_057);
//! ```

mod clock;

pub use clock::{Clock, ClockModel, Ramp, RateStep, Wander};

use fixed_math::time::{FRACTION_BITS, Span};
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

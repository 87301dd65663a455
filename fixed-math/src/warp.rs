//! A stop along the path: track time runs slower until it stands, the same on every node that knows the epoch.
//!
//! - **Walk:** a halt's epoch → once a beat [`Warp::stopped`] or [`Warp::resumed`] → track time → every axis evaluates its spline there.
//! - **Invariants:** track time never runs backwards and is continuous; a stop uses up T/2 of it and its resume, the mirror, as much, both
//!   to the step; between, it is off the exact curve by less than one step.
//! - **Context:** once a beat for all axes; four products, no division.
//!
//! With s = (t − epoch)/T the rate is τ̇ = 1 − 2s² up to s = ½ and 2(1 − s)² from there. So τ̈ is at most 2/T, τ⃛ is ±4/T², and
//! of a path p(τ): velocity is p′τ̇, acceleration p″τ̇² + p′τ̈, at most A + 2V/T; jerk p‴τ̇³ + 3p″τ̇τ̈ + p′τ⃛, at most
//! J + (8/√6)·A/T + 4V/T², since τ̇|τ̈| has its maximum at s = 1/√6. [`Warp::reserve`] is what that adds to a path's own.

use crate::limits::{Limits, LimitsError};
use crate::spline::IntervalLog2;
use crate::time::Span;
use crate::widening::product;

/// Shortest stop: 3·2^8 µs.
pub const WARP_LOG2_MIN: u32 = 8;
/// Longest stop: 3·2^22 µs, 12.6 s.
pub const WARP_LOG2_MAX: u32 = 22;
/// The rate of a time that is not warped, 2^−16.
pub const RATE_ONE: u32 = 1 << 16;

/// Steps of 1/256 µs in a microsecond, base-two logarithm.
const STEPS_LOG2: u32 = crate::time::FRACTION_BITS;

/// How a stop's time passes: it takes 3·2^n µs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Warp {
    /// T/3 is 2 to this, steps.
    third_log2: u32,
}

/// What a warp adds to a path's own acceleration and jerk, in differences.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reserve {
    /// Per interval².
    pub acceleration: i32,
    /// Per interval³.
    pub jerk: i32,
}

/// A stop would break limits, or leave nothing of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WarpTooShort {
    /// What is wrong with what would be left.
    pub error: LimitsError,
    /// The n of the shortest stop of 3·2^n µs that is long enough, where there is one.
    pub least_log2: Option<u32>,
}

impl Warp {
    /// The shortest there is.
    pub const SHORTEST: Self = Self { third_log2: WARP_LOG2_MIN + STEPS_LOG2 };

    /// A stop of 3·2^`log2` µs; `None` outside [`WARP_LOG2_MIN`]..=[`WARP_LOG2_MAX`].
    #[must_use]
    pub const fn new(log2: u32) -> Option<Self> {
        if log2 >= WARP_LOG2_MIN && log2 <= WARP_LOG2_MAX { Some(Self { third_log2: log2 + STEPS_LOG2 }) } else { None }
    }

    /// The n of 3·2^n µs.
    #[must_use]
    pub const fn log2(&self) -> u32 {
        self.third_log2 - STEPS_LOG2
    }

    /// How long a stop takes.
    #[must_use]
    pub const fn duration(&self) -> Span {
        Span::from_steps(2 * self.half() as u64)
    }

    /// Track time that a stop uses up: half of its duration.
    #[must_use]
    pub const fn used(&self) -> Span {
        Span::from_steps(self.half() as u64)
    }

    /// Track time since the epoch of a stop, `since` it.
    #[must_use]
    pub const fn stopped(&self, since: Span) -> Span {
        let half = self.half();
        let Some(since) = self.within(since) else { return self.used() };
        let steps = if since <= half { since - self.lost(since) } else { half - self.lost(2 * half - since) };
        Span::from_steps(steps as u64)
    }

    /// Track time since the epoch of a resume, `since` it: a stop's backwards, then time as it is.
    #[must_use]
    pub const fn resumed(&self, since: Span) -> Span {
        let Some(within) = self.within(since) else { return since.saturating_sub(self.used()) };
        let left = Span::from_steps((2 * self.half() - within) as u64);
        self.used().saturating_sub(self.stopped(left))
    }

    /// How fast track time runs `since` the epoch of a stop, 2^−16.
    #[must_use]
    pub const fn stop_rate(&self, since: Span) -> u32 {
        let half = self.half();
        let Some(since) = self.within(since) else { return 0 };
        if since <= half { RATE_ONE - self.twice_squared(since) } else { self.twice_squared(2 * half - since) }
    }

    /// How fast track time runs `since` the epoch of a resume, 2^−16.
    #[must_use]
    pub const fn resume_rate(&self, since: Span) -> u32 {
        match self.within(since) {
            Some(within) => self.stop_rate(Span::from_steps((2 * self.half() - within) as u64)),
            None => RATE_ONE,
        }
    }

    /// What to keep free of an axis's limits, in differences of `interval`, for paths within `velocity` and `acceleration`; rounded up.
    #[must_use]
    pub const fn reserve(&self, interval: IntervalLog2, velocity: i32, acceleration: i32) -> Reserve {
        // T in intervals is 3·2^n / 2^k
        let (h, n) = (interval.us() as u64, self.log2());
        let (velocity, acceleration) = (velocity.unsigned_abs() as u64, acceleration.unsigned_abs() as u64);
        let of_velocity = (2 * velocity * h).div_ceil(3 << n);
        // 8/√6 is 3.26599
        let of_acceleration = (327 * acceleration * h).div_ceil(300 << n);
        let of_both = (4 * velocity * h * h).div_ceil(9 << (2 * n));
        Reserve { acceleration: cut(of_velocity), jerk: cut(of_acceleration + of_both) }
    }

    /// The limits that points have to keep so that a stop keeps `limits`.
    ///
    /// # Errors
    /// [`WarpTooShort`] where nothing is left of them, with the least duration that leaves enough.
    pub fn limits_within(&self, limits: &Limits, interval: IntervalLog2) -> Result<Limits, WarpTooShort> {
        self.try_within(limits, interval).map_err(|error| {
            let mut longer = (self.log2() + 1..=WARP_LOG2_MAX).filter_map(Self::new);
            let least = longer.find(|warp| warp.try_within(limits, interval).is_ok());
            WarpTooShort { error, least_log2: least.map(|warp| warp.log2()) }
        })
    }

    fn try_within(self, limits: &Limits, interval: IntervalLog2) -> Result<Limits, LimitsError> {
        let reserve = self.reserve(interval, limits.velocity(), limits.acceleration().at_rest());
        let (acceleration, jerk) = (limits.acceleration().less(reserve.acceleration), limits.jerk().less(reserve.jerk));
        Limits::new(limits.positions(), limits.velocity(), acceleration, jerk)
    }

    /// T/2, steps.
    const fn half(self) -> u32 {
        3 << (self.third_log2 - 1)
    }

    /// `since` in steps where it is within the stop.
    #[expect(clippy::cast_possible_truncation, reason = "checked before")]
    const fn within(self, since: Span) -> Option<u32> {
        if since.steps() < 2 * self.half() as u64 { Some(since.steps() as u32) } else { None }
    }

    /// `steps` ≤ T/2 over T/3, 2^−30, and its square.
    #[expect(clippy::cast_possible_truncation, reason = "1.5² of 2^30 is below 2^32")]
    const fn squared(self, steps: u32) -> (u32, u32) {
        let part = steps << (30 - self.third_log2);
        (part, (product(part, part) >> 30) as u32)
    }

    /// 2x³/3T² for x ≤ T/2, to the nearest step: what track time has fallen behind since the rate was one. At T/2 it is T/12 exactly.
    #[expect(clippy::cast_possible_truncation, reason = "1.5³ of 2^30, and T/12, are below 2^32")]
    const fn lost(self, steps: u32) -> u32 {
        // 2/27, 2^−35
        const FACTOR: u32 = ((1_u64 << 37) / 27).div_ceil(2) as u32;
        let (part, squared) = self.squared(steps);
        let cubed = (product(squared, part) >> 30) as u32;
        let shift = 65 - self.third_log2;
        ((product(cubed, FACTOR) + (1 << (shift - 1))) >> shift) as u32
    }

    /// 2x²/T² for x ≤ T/2, 2^−16, to the nearest.
    #[expect(clippy::cast_possible_truncation, reason = "at most one half")]
    const fn twice_squared(self, steps: u32) -> u32 {
        // 2/9, 2^−34
        const FACTOR: u32 = ((1_u64 << 36) / 9).div_ceil(2) as u32;
        let (_, squared) = self.squared(steps);
        ((product(squared, FACTOR) + (1 << 47)) >> 48) as u32
    }
}

#[expect(clippy::cast_possible_truncation, reason = "checked before")]
const fn cut(value: u64) -> i32 {
    if value > i32::MAX as u64 { i32::MAX } else { value as i32 }
}

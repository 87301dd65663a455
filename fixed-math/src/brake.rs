//! A jerk-limited stop in differences: the points that an axis makes by itself when it has none to follow.
//!
//! - **Walk:** a queue ran dry, or its clock cannot be trusted: [`Brake::next`] once an interval → the point that the spline goes on with.
//! - **Invariants:** with J and A the brake's jerk and acceleration: |α′ − α| ≤ J at every step; |α′| ≤ max(|α|, A), and above A only
//!   against the movement; from anywhere it comes to δ = 0, α = 0 and stays there. [`Limits`](crate::limits::Limits) says from
//!   where it keeps the other limits as well, and accepts no point from which it would not.
//! - **Context:** once an interval, in the highest-priority task: at most ten 32-bit products to 64 bits, as many as n has bits; no division.
//!
//! Let n be the largest with J·n(n+1)/2 ≤ |δ|: then J·n, J·(n−1), … J take |δ| to a remainder below J·(n+1), so J·n is the strongest
//! deceleration that can still be let go of in time, and it never falls by more than one J from one step to the next. What is left
//! below J is taken off in one step.

use crate::limits::Knot;
use crate::widening::product;

/// Least power of two that a deceleration's steps stay below: [`STOP_INTERVALS_MAX`](crate::limits::STOP_INTERVALS_MAX) twice.
const STEPS_LOG2: u32 = 10;

/// How hard to brake, in differences.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Brake {
    /// Most that the acceleration changes in an interval.
    jerk: u32,
    /// Most deceleration that is built up.
    acceleration: u32,
}

impl Brake {
    /// A brake of `jerk` per interval³ and `acceleration` per interval²; what is not positive is taken as 1.
    #[must_use]
    pub const fn new(jerk: i32, acceleration: i32) -> Self {
        Self { jerk: at_least_one(jerk), acceleration: at_least_one(acceleration) }
    }

    /// Most that the acceleration changes in an interval.
    #[must_use]
    pub const fn jerk(&self) -> i32 {
        self.jerk.cast_signed()
    }

    /// Most deceleration that is built up.
    #[must_use]
    pub const fn acceleration(&self) -> i32 {
        self.acceleration.cast_signed()
    }

    /// The point after `knot`.
    #[must_use]
    pub const fn next(&self, knot: Knot) -> Knot {
        let Knot { position, velocity, acceleration } = knot;
        if velocity == 0 && acceleration == 0 {
            return knot;
        }
        let speed = velocity.unsigned_abs();
        let steps = self.steps(speed);
        // below one step of jerk, what is left goes at once
        let wanted = if steps == 0 { speed } else { self.jerk * steps };
        let wanted = min(wanted, max(self.acceleration, acceleration.unsigned_abs()));
        let wanted = if velocity > 0 { wanted.cast_signed().saturating_neg() } else { wanted.cast_signed() };
        let jerk = self.jerk.cast_signed();
        let acceleration = clamp(wanted, acceleration.saturating_sub(jerk), acceleration.saturating_add(jerk));
        let velocity = velocity.saturating_add(acceleration);
        Knot { position: position.saturating_add(velocity), velocity, acceleration }
    }

    /// The largest n with J·n(n+1)/2 ≤ `speed`.
    const fn steps(self, speed: u32) -> u32 {
        // n² < 2·speed/J, where speed is below 2^s and J at least 2^(j−1): n is below 2^((s + 2 − j)/2)
        let bits = (34 - speed.leading_zeros()).saturating_sub(32 - self.jerk.leading_zeros()).div_ceil(2);
        let mut steps = 0;
        let mut bit = min(bits, STEPS_LOG2);
        while bit > 0 {
            bit -= 1;
            let more = steps + (1 << bit);
            if product(self.jerk, more * (more + 1) / 2) <= speed as u64 {
                steps = more;
            }
        }
        steps
    }
}

const fn at_least_one(value: i32) -> u32 {
    if value > 0 { value.unsigned_abs() } else { 1 }
}

const fn min(a: u32, b: u32) -> u32 {
    if a < b { a } else { b }
}

const fn max(a: u32, b: u32) -> u32 {
    if a > b { a } else { b }
}

const fn clamp(value: i32, low: i32, high: i32) -> i32 {
    if value < low {
        low
    } else if value > high {
        high
    } else {
        value
    }
}

//! One interval of a uniform cubic B-spline by Horner's rule in 32-bit integers: position, velocity and acceleration at any part of it.
//!
//! - **Walk:** four control points → [`Cubic::new`], once an interval → [`Cubic::position_velocity`], once a beat.
//! - **Invariants:** nothing overflows, since [`Cubic::new`] refuses points further apart than [`DIFFERENCE_MAX`](super::DIFFERENCE_MAX). A position is less than
//!   29/48 of a unit (0.604) from the exact one, so it never leaves the hull of its four points either, and a constant comes out as itself.
//! - **Context:** any, interrupts included: 32-bit sums, shifts and products of 16 by 16 bits, of which a Cortex-M0+ does one a cycle.
//!
//! # The bound
//!
//! Coefficients are those of the position less the second control point, in guard units of 2^-4 ([`GUARD_BITS`]): with differences δ of
//! the points, c₁ = 8(δ₁+δ₂) and c₂ = 8δ² are integers as they stand; c₀ = 8δ²/3 and c₃ = 8δ³/3 are rounded to the nearest, so they are off by
//! ε₀, ε₃ ∈ {−⅓, 0, ⅓}. A product with the part u is rounded down, off by f ∈ (−1, 0]. With m = c₃u + f₁, b₂ = c₂ + m, b₁ = c₁ + b₂u + f₂ and
//! p = c₀ + b₁u + f₃ the sum is off by ε₀ + ε₃u³ + f₁u² + f₂u + f₃, which lies in (−3⅔, ⅔]. To it comes the constant 9, in c₀: 8 that make
//! the last shift by four a rounding, 1 that centres the rest, for that shift takes 0 to 15 guard units away. Off in all: (9 − 3⅔ − 15,
//! 9 + ⅔ − 0) = (−9⅔, 9⅔) guard units, 29/48 of a unit. On a line δ² = δ³ = 0 and
//! only f₃ is left: at most 9/16 of a unit. Where nothing moves that is 0 too, and the constant is shifted out.
//!
//! Velocity is v = b₁ + (b₂ + m)u: off by 3ε₃u² + 3f₁u + f₂ + f₄ ∈ (−6, 1] guard units. On a line all of these are 0 and it is exact.
//! Acceleration is 16δ² + ⌊16δ³u⌋: off by (−1, 0] guard units, exact at the knot. Jerk is exact: 3c₃/8 is within ⅛ of the integer δ³.

use super::TooFar;
use super::reach::difference;

/// Fractional bits of velocity and acceleration, and of what is summed up to a position.
pub const GUARD_BITS: u32 = 4;

/// What is in c₀ beyond the spline: one half of a unit, so that the last shift rounds, and one guard unit to centre the floors.
const ROUND: i32 = (1 << (GUARD_BITS - 1)) + 1;

/// The interval between the second and the third of four control points, ready to be evaluated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cubic {
    /// c₀ with [`ROUND`], c₁, c₂, c₃ in guard units; c₀ is relative to `base`.
    coefficients: [i32; 4],
    /// The second control point.
    base: i32,
}

impl Cubic {
    /// The segment that `points`, oldest first, span.
    ///
    /// # Errors
    ///
    /// [`TooFar`] where neighbours are more than [`DIFFERENCE_MAX`](super::DIFFERENCE_MAX) apart.
    pub fn new(points: [i32; 4]) -> Result<Self, TooFar> {
        let first = difference(points[0], points[1], 0)?;
        let second = difference(points[1], points[2], 1)?;
        let third = difference(points[2], points[3], 2)?;
        // at most 2^26 and 2^27: eight times them is 2^29 and 2^30
        let bend = second - first;
        let jerk = (third - second) - bend;
        let coefficients = [eight_thirds(bend) + ROUND, (first + second) << 3, bend << 3, eight_thirds(jerk)];
        Ok(Self { coefficients, base: points[1] })
    }

    /// Position at `part`, in 2^-16 of the interval: within 29/48 of the exact one.
    #[must_use]
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "a call costs a Cortex-M0+ as much as two of the three products")]
    pub fn position(&self, part: u16) -> i32 {
        let [c0, c1, c2, c3] = self.coefficients;
        let part = u32::from(part);
        let b2 = c2 + scale(c3, part);
        let b1 = c1 + scale(b2, part);
        self.base + ((c0 + scale(b1, part)) >> GUARD_BITS)
    }

    /// Position as of [`position`](Self::position), and velocity an interval in 2^-4 ([`GUARD_BITS`]) of a unit: from 6 below to 1 above the exact one.
    #[must_use]
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "a call costs a Cortex-M0+ as much as two of the four products")]
    pub fn position_velocity(&self, part: u16) -> (i32, i32) {
        let [c0, c1, c2, c3] = self.coefficients;
        let part = u32::from(part);
        // Two Horner's rules in one pass: the derivative's d₁ is b₂ + c₃u, and that product is there already.
        let cubic = scale(c3, part);
        let b2 = c2 + cubic;
        let d1 = b2 + cubic;
        let b1 = c1 + scale(b2, part);
        let velocity = b1 + scale(d1, part);
        (self.base + ((c0 + scale(b1, part)) >> GUARD_BITS), velocity)
    }

    /// Acceleration an interval², in 2^-4 ([`GUARD_BITS`]) of a unit, rounded down: exact at part 0.
    #[must_use]
    #[inline]
    pub fn acceleration(&self, part: u16) -> i32 {
        let [_, _, c2, _] = self.coefficients;
        let (jerk, part) = (self.jerk(), u32::from(part));
        // ⌊16·δ³·part/2^16⌋ as in `scale`, split at 12 bits: 16·δ³ itself may need one bit more than there are
        let high = (jerk >> 12) * part.cast_signed();
        let low = ((jerk.cast_unsigned() & 0xfff) * part) >> 12;
        2 * c2 + high + low.cast_signed()
    }

    /// Jerk an interval³, the third difference of the points: exact.
    #[must_use]
    #[inline]
    pub fn jerk(&self) -> i32 {
        let [_, _, _, c3] = self.coefficients;
        (3 * c3 + 4) >> 3
    }

    /// Position at the interval's end, where the next begins: within 29/48 of the exact one.
    #[must_use]
    #[inline]
    pub fn end(&self) -> i32 {
        let [c0, c1, c2, c3] = self.coefficients;
        self.base + ((c0 + c1 + c2 + c3) >> GUARD_BITS)
    }
}

/// ⌊value·part/2^16⌋ for a `part` below 2^16, without a product of more than 32 bits: |value >> 16| ≤ 2^15 and the other half is unsigned.
#[inline(always)]
#[expect(clippy::inline_always, reason = "six cycles of a Cortex-M0+, fewer than a call takes")]
fn scale(value: i32, part: u32) -> i32 {
    let high = (value >> 16) * part.cast_signed();
    let low = ((value.cast_unsigned() & 0xffff) * part) >> 16;
    high + low.cast_signed()
}

/// The integer nearest to 8·value/3, for |value| ≤ 2^27; no ties, as a third is never a half.
fn eight_thirds(value: i32) -> i32 {
    (8 * value + 1).div_euclid(3)
}

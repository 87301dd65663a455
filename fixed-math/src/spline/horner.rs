//! One interval of a uniform cubic B-spline by Horner's rule in 32-bit integers: position, velocity and acceleration at any part of it.
//!
//! - **Walk:** four control points → [`Cubic::new`], once an interval → [`Cubic::position_velocity`], once a beat.
//! - **Invariants:** nothing overflows, since [`Cubic::new`] refuses points further apart than [`DIFFERENCE_MAX`](super::DIFFERENCE_MAX). A
//!   position is less than one unit from the exact one, so it never leaves the hull of its points either. A constant comes out as itself.
//! - **Context:** any, interrupts included: 32-bit sums, shifts and products of 16 by 16 bits, of which a Cortex-M0+ does one a cycle.
//!
//! # The bound
//!
//! With differences δ of the points p, the position at the start is p₁ + δ²/6. It is kept as an integer base; what is left, r, is one of
//! −1, 0, 1, 2, 3, 4 sixths of a unit and is dropped, as a word for it costs a Cortex-M0+ two cycles. The rest is in guard units of 2^-4
//! ([`GUARD_BITS`]). c₁ = 8(δ₁+δ₂) and c₂ = 8δ² are integers as they stand; c₃ = 8δ³/3 is rounded to the nearest, off by ε ∈ {−⅓, 0, ⅓}.
//! A product with the part u is rounded down, off by f ∈ (−1, 0]. With m = c₃u + f₁, b₂ = c₂ + m, b₁ = c₁ + b₂u + f₂ and p = b₁u + f₃
//! the sum is off by εu³ + f₁u² + f₂u + f₃ ∈ (−3⅓, ⅓). The last shift by four bits takes 0 to 15 guard units away and r takes −2⅔ to 10⅔.
//! With the constant 13 (`CENTRE`), in all: (13 − 3⅓ − 15 − 10⅔, 13 + ⅓ − 0 + 2⅔) = (−16, 16) guard units, one unit, ends excluded.
//! On a line δ² = δ³ = r = 0 and only f₃ is left: (−3/16, 13/16]. Where nothing moves that is 0 too, and the constant is shifted out.
//!
//! Velocity is v = b₁ + (b₂ + m)u: off by 3εu² + 3f₁u + f₂ + f₄ ∈ (−6, 1) guard units. On a line all of these are 0 and it is exact.
//! Acceleration is 16δ² + ⌊16δ³u⌋: off by (−1, 0] guard units, exact at the knot. Jerk is exact: 3c₃/8 is within ⅛ of the integer δ³.

use super::TooFar;
use super::reach::difference;

/// Fractional bits of velocity and acceleration, and of what is summed up to a position.
pub const GUARD_BITS: u32 = 4;

/// What centres all that is rounded: see the bound.
const CENTRE: i32 = 13;

/// The same at the end, where no product rounds: what is off is in [11 − ⅓ − 15 − 10⅔, 11 + ⅓ + 2⅔] = [−15, 14] guard units.
const CENTRE_OF_END: i32 = 11;

/// The interval between the second and the third of four control points, ready to be evaluated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cubic {
    /// c₃, c₂, c₁ in guard units.
    coefficients: [i32; 3],
    /// The position at the start, from 1/6 above to 4/6 below it.
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
        // the base is an integer in the hull, or less than one from it: no overflow
        let base = points[1] + floor_third((bend + 1) >> 1);
        // 8·jerk/3 to the nearest; no ties, as a third is never a half
        Ok(Self { coefficients: [floor_third(8 * jerk + 1), bend << 3, (first + second) << 3], base })
    }

    /// Position at `part`, in 2^-16 of the interval: less than one unit from the exact one. Of a slow move the next may be one unit back, so what
    /// counts units takes hysteresis. 31 cycles of a Cortex-M0+ by its table, the four loads included.
    #[must_use]
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "a call costs a Cortex-M0+ as much as two of the three products")]
    pub fn position(&self, part: u16) -> i32 {
        let [c3, c2, c1] = self.coefficients;
        let part = u32::from(part);
        let b2 = c2 + scale(c3, part);
        let b1 = c1 + scale(b2, part);
        self.base + ((scale(b1, part) + CENTRE) >> GUARD_BITS)
    }

    /// Position as of [`position`](Self::position), and velocity an interval in 2^-4 ([`GUARD_BITS`]) of a unit: from 6 below to 1 above the exact
    /// one. 39 cycles of a Cortex-M0+ by its table, the four loads included.
    #[must_use]
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "a call costs a Cortex-M0+ as much as two of the four products")]
    pub fn position_velocity(&self, part: u16) -> (i32, i32) {
        let [c3, c2, c1] = self.coefficients;
        let part = u32::from(part);
        // Two Horner's rules in one pass: the derivative's d₁ is b₂ + c₃u, and that product is there already.
        let cubic = scale(c3, part);
        let b2 = c2 + cubic;
        let d1 = b2 + cubic;
        let b1 = c1 + scale(b2, part);
        let velocity = b1 + scale(d1, part);
        (self.base + ((scale(b1, part) + CENTRE) >> GUARD_BITS), velocity)
    }

    /// Acceleration an interval², in 2^-4 ([`GUARD_BITS`]) of a unit, rounded down: exact at part 0.
    #[must_use]
    #[inline]
    pub fn acceleration(&self, part: u16) -> i32 {
        let [_, c2, _] = self.coefficients;
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
        let [c3, ..] = self.coefficients;
        (3 * c3 + 4) >> 3
    }

    /// Position at the interval's end, where the next begins: at most 15/16 of a unit from the exact one.
    #[must_use]
    #[inline]
    pub fn end(&self) -> i32 {
        let [c3, c2, c1] = self.coefficients;
        self.base + ((c1 + c2 + c3 + CENTRE_OF_END) >> GUARD_BITS)
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

/// ⌊value/3⌋ for values above −2^31 + 15: a division costs a Cortex-M0+ three hundred cycles, and an interval takes two.
fn floor_third(value: i32) -> i32 {
    // ⅓ less its 2^-32nd part is (2^-2 + 2^-4)·(1 + 2^-4)·(1 + 2^-8)·(1 + 2^-16); with the shifts' floors what remains is 0 to 15
    let mut quotient = (value >> 2) + (value >> 4);
    quotient += quotient >> 4;
    quotient += quotient >> 8;
    quotient += quotient >> 16;
    let rest = value - 3 * quotient;
    // 11/32 instead of ⅓: the same floor up to 31
    quotient + ((11 * rest) >> 5)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every value near where bits turn over, and one in 65,537 of all others.
    #[test]
    fn a_third_is_rounded_down() {
        let turns = (0..31).flat_map(|bit| (-100..=100).map(move |near| (1i32 << bit).saturating_add(near)));
        let least = i32::MIN + 15;
        let all = (least..i32::MAX).step_by(65_537);
        for value in
            turns.flat_map(|value| [value, -value]).chain(all).chain([least, i32::MAX]).filter(|value| *value >= least)
        {
            assert_eq!(floor_third(value), value.div_euclid(3), "{value}");
        }
    }
}

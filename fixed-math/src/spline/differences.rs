//! One interval after the other of a uniform cubic B-spline by forward differences: equally spaced samples by sums alone, all of them exact.
//!
//! - **Walk:** four control points → [`Differences::new`] → [`Differences::advance`] or [`Differences::block`] once a sample, and
//!   [`Differences::knot`] with the next point once an interval.
//! - **Invariants:** at scale 6N³, with N samples an interval, everything is an integer, so no sample and no knot rounds and nothing drifts.
//!   Nothing overflows, since points whose first differences exceed [`DIFFERENCE_MAX`] or whose second ones exceed
//!   [`second_difference_max`] are refused, and the position is relative to the control point at the interval's start: 2^26 · 6 · 2^33 < 2^62.
//!   Samples beyond a knot are refused, not extrapolated.
//! - **Context:** any, interrupts included. A sample is two sums of 64 bits and one of 32, which is why second differences are bounded: a
//!   Cortex-M0+ has registers for no more. In a block of 16 a sample takes it 19.3 cycles by its table, call and 64-bit store included.
//!
//! # Why it is exact
//!
//! With δ the points' differences, t the sample's number and P relative to the second point,
//! 6N³·P = N³δ² + 3N²(δ₁+δ₂)·t + 3Nδ²·t² + δ³·t³. Its third difference over t is 6δ³. At a knot the next segment continues position, slope
//! and curvature, so the two polynomials differ by e·t³, e = δ³ − δ³ of before, with t counted from the knot: its first difference is e, its second 6e, its third 6e.

use super::reach::difference;
use super::{DIFFERENCE_MAX, TooFar};
use core::fmt;

/// Most samples an interval, as a base-two logarithm: 8 µs at the longest interval.
pub const SAMPLES_LOG2_MAX: u32 = 11;

/// Why [`Differences`] refuses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// Control points are too far apart.
    TooFar(TooFar),
    /// A second difference of control points is more than [`second_difference_max`].
    TooCurved {
        /// The one about the point `index + 1` of the four, 0 or 1.
        index: u8,
        /// The later first difference less the earlier.
        value: i32,
        /// The largest magnitude that is taken.
        bound: i32,
    },
    /// More samples an interval than 2^[`SAMPLES_LOG2_MAX`].
    TooManySamples {
        /// What was asked for, as a base-two logarithm.
        samples_log2: u32,
    },
    /// The next control point was given before the interval's end.
    KnotEarly {
        /// Samples to go.
        left: u32,
    },
}

impl From<TooFar> for Refusal {
    fn from(too_far: TooFar) -> Self {
        Self::TooFar(too_far)
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooFar(too_far) => too_far.fmt(f),
            Self::TooCurved { index, value, bound } => write!(
                f,
                "the second difference about control point {} of a segment is {value}, more than the {bound} that fits: take fewer samples \
                 an interval, shorter intervals or less acceleration",
                index + 1
            ),
            Self::TooManySamples { samples_log2 } => {
                write!(
                    f,
                    "2^{samples_log2} samples an interval, more than 2^{SAMPLES_LOG2_MAX}: take a longer beat or a shorter interval"
                )
            }
            Self::KnotEarly { left } => {
                write!(f, "a knot {left} samples before the interval's end: advance to it first")
            }
        }
    }
}

impl core::error::Error for Refusal {}

/// The interval has fewer samples left than were asked for: give the next control point to [`Differences::knot`] first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KnotDue {
    /// Samples up to the knot.
    pub left: u32,
}

impl fmt::Display for KnotDue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the knot is {} samples ahead: go no further than it, then give the next control point", self.left)
    }
}

impl core::error::Error for KnotDue {}

/// A spline that is sampled 2^m times an interval. It stands at a sample; at first at the knot of the second of its four points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Differences {
    /// 6N³ times the position less `base`.
    position: i64,
    /// First difference of `position`: what the next sample adds.
    velocity: i64,
    /// Second difference.
    acceleration: i32,
    /// A sixth of the third difference, which is 6δ³ over the whole interval: 2^27 at most.
    cubic: i32,
    /// Samples up to the knot at the interval's end.
    left: u32,
    /// The control point of the interval's start, that of its end and the one after.
    points: [i32; 3],
    samples_log2: u32,
}

impl Differences {
    /// At the knot of the second of `points`, oldest first, with 2^`samples_log2` samples to the next.
    ///
    /// # Errors
    ///
    /// [`Refusal::TooManySamples`] above [`SAMPLES_LOG2_MAX`], [`Refusal::TooFar`] where neighbours are more than
    /// [`DIFFERENCE_MAX`] apart, [`Refusal::TooCurved`] where a second difference exceeds [`second_difference_max`].
    pub fn new(points: [i32; 4], samples_log2: u32) -> Result<Self, Refusal> {
        if samples_log2 > SAMPLES_LOG2_MAX {
            return Err(Refusal::TooManySamples { samples_log2 });
        }
        let [p0, p1, p2, p3] = points;
        let first = difference(p0, p1, 0)?;
        let second = difference(p1, p2, 1)?;
        let third = difference(p2, p3, 2)?;
        let m = samples_log2;
        let earlier = second_difference(first, second, 0, m)?;
        let later = second_difference(second, third, 1, m)?;
        let cubic = later - earlier;
        Ok(Self {
            position: i64::from(earlier) << (3 * m),
            velocity: (i64::from(3 * (first + second)) << (2 * m)) + (i64::from(3 * earlier) << m) + i64::from(cubic),
            acceleration: ((6 * earlier) << m) + 6 * cubic,
            cubic,
            left: 1 << m,
            points: [p1, p2, p3],
            samples_log2: m,
        })
    }

    /// Goes on by one sample.
    ///
    /// # Errors
    ///
    /// [`KnotDue`] at the interval's end; nothing has moved.
    #[inline]
    pub fn advance(&mut self) -> Result<(), KnotDue> {
        self.block::<1>(|_| ())
    }

    /// Goes on by `COUNT` samples and gives each one's [`scaled`](Self::scaled) to `each`; the first that it gives is one sample on.
    ///
    /// # Errors
    ///
    /// [`KnotDue`] where fewer are left of the interval; nothing has moved.
    #[inline(always)]
    #[expect(
        clippy::inline_always,
        reason = "its point is that state stays in registers over the block, beside what `each` keeps"
    )]
    pub fn block<const COUNT: u32>(&mut self, mut each: impl FnMut(i64)) -> Result<(), KnotDue> {
        let Some(left) = self.left.checked_sub(COUNT) else {
            return Err(KnotDue { left: self.left });
        };
        let Self { mut position, mut velocity, mut acceleration, .. } = *self;
        let jerk = 6 * self.cubic;
        macro_rules! samples {
            ($($_:literal)*) => {
                $( position += velocity; velocity += i64::from(acceleration); acceleration += jerk; each(position); let _ = $_; )*
            };
        }
        // written out, since code that is compiled for size is not unrolled: 41 cycles a sample on a Cortex-M0+ instead of 19
        for _ in 0..COUNT / 16 {
            samples!(0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15);
        }
        for _ in 0..COUNT % 16 {
            samples!(0);
        }
        *self = Self { position, velocity, acceleration, left, ..*self };
        Ok(())
    }

    /// At the interval's end: goes over to the next interval, whose last control point is `next`, and takes its first point as [`base`](Self::base).
    /// The position does not change, but [`scaled`](Self::scaled) does, as it is relative to the base.
    ///
    /// # Errors
    ///
    /// [`Refusal::KnotEarly`] before the interval's end, [`Refusal::TooFar`] where `next` is more than
    /// [`DIFFERENCE_MAX`] from the point before, [`Refusal::TooCurved`] where the second difference that it makes
    /// exceeds [`second_difference_max`]; nothing has changed.
    pub fn knot(&mut self, next: i32) -> Result<(), Refusal> {
        if self.left > 0 {
            return Err(Refusal::KnotEarly { left: self.left });
        }
        let [p0, p1, p2] = self.points;
        let third = difference(p2, next, 2)?;
        let (first, second) = (p1 - p0, p2 - p1);
        let later = second_difference(second, third, 1, self.samples_log2)?;
        let cubic = later - (second - first);
        let change = cubic - self.cubic;
        self.velocity += i64::from(change);
        self.acceleration += 6 * change;
        self.cubic = cubic;
        self.position -= i64::from(6 * first) << (3 * self.samples_log2);
        self.left = 1 << self.samples_log2;
        self.points = [p1, p2, next];
        Ok(())
    }

    /// 6N³ times the position less [`base`](Self::base); less than 2^62.
    #[must_use]
    #[inline]
    pub const fn scaled(&self) -> i64 {
        self.position
    }

    /// 6N³: what one unit of position is in [`scaled`](Self::scaled).
    #[must_use]
    #[inline]
    pub const fn scale(&self) -> i64 {
        scale(self.samples_log2)
    }

    /// The control point at the interval's start, which [`scaled`](Self::scaled) is relative to. It changes at a [`knot`](Self::knot) alone.
    #[must_use]
    #[inline]
    pub const fn base(&self) -> i32 {
        self.points[0]
    }

    /// Samples up to the knot at the interval's end; at 0 it takes a [`knot`](Self::knot).
    #[must_use]
    #[inline]
    pub const fn left(&self) -> u32 {
        self.left
    }

    /// The position, rounded to the nearest, halves up: what the reference says. Not for hot code: it divides.
    #[must_use]
    pub fn position(&self) -> i32 {
        // the floor of a floor: by N³ first, after which 32 bits are enough for the rest
        let sixths = (self.position >> (3 * self.samples_log2)) + 3;
        #[expect(clippy::cast_possible_truncation, reason = "at most 6·2^26 + 3 in magnitude")]
        let sixths = sixths as i32;
        self.points[0] + sixths.div_euclid(6)
    }
}

/// 6N³ for 2^`samples_log2` samples an interval; more than 2^[`SAMPLES_LOG2_MAX`] are taken as that many.
#[must_use]
pub const fn scale(samples_log2: u32) -> i64 {
    6 << (3 * if samples_log2 > SAMPLES_LOG2_MAX { SAMPLES_LOG2_MAX } else { samples_log2 })
}

/// Largest second difference of control points that is taken at 2^`samples_log2` samples an interval, N: (2^31 − 1)/(6(N+2)), so that the second
/// difference of samples, which is at most 6Nδ² + 6δ³ with |δ³| ≤ 2|δ²|, fits 32 bits. At most 2^26, as neighbours allow no more.
///
/// At 2^-16 mm a unit, 4.096 ms an interval and 8 µs a sample it is 633 m/s²; at 16.384 ms and 8 µs, its least, 9.9 m/s².
#[must_use]
pub const fn second_difference_max(samples_log2: u32) -> i32 {
    SECOND_DIFFERENCE_MAX[if samples_log2 > SAMPLES_LOG2_MAX { SAMPLES_LOG2_MAX } else { samples_log2 } as usize]
}

/// [`second_difference_max`] as a table: a knot has no time for a division.
const SECOND_DIFFERENCE_MAX: [i32; SAMPLES_LOG2_MAX as usize + 1] = {
    let mut table = [0; SAMPLES_LOG2_MAX as usize + 1];
    let mut log2 = 0;
    while log2 < table.len() {
        let fits = i32::MAX / (6 * ((1 << log2) + 2));
        table[log2] = if fits > 2 * DIFFERENCE_MAX { 2 * DIFFERENCE_MAX } else { fits };
        log2 += 1;
    }
    table
};

/// `second - first`, where no more than [`second_difference_max`]; `index` is that of the second difference among a segment's two.
fn second_difference(first: i32, second: i32, index: u8, samples_log2: u32) -> Result<i32, Refusal> {
    let (value, bound) = (second - first, second_difference_max(samples_log2));
    if value.abs() <= bound { Ok(value) } else { Err(Refusal::TooCurved { index, value, bound }) }
}

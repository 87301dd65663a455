//! One interval of a uniform cubic B-spline of time: position and its three derivatives, exact until one rounding.
//!
//! - **Walk:** a control point's last step before limits and outputs: track queue → *this module* → step, phase or set point.
//! - **Invariants:** the weights are the integers 1, 4, 1 over 6, never rounded fractions of them, so a constant input comes out as
//!   itself. The n-th derivative carries 1/Tⁿ. What does not fit saturates towards its own sign.
//! - **Context:** the reference of every faster evaluator: 128-bit integers, so workstation and tests, not interrupts. Interrupts
//!   take [`horner`] for any instant and [`differences`] for instants that are equally far apart.
//!
//! ```
//! use fixed_math::spline::{IntervalLog2, Segment};
//!
//! // a straight line that rises 4096 a 4.096 ms interval: one a microsecond
//! let segment = Segment::new([0, 4096, 8192, 12288], IntervalLog2::new(12).unwrap());
//! let sample = segment.sample(1024);
//! assert_eq!(sample.position, 4096 + 1024);
//! assert_eq!(sample.velocity_per_s, 1_000_000);
//! assert_eq!((sample.acceleration_per_s2, sample.jerk_per_s3), (0, 0));
//! ```

pub mod differences;
pub mod horner;
mod reach;

pub use reach::{DIFFERENCE_MAX, TooFar};

/// Shortest interval: 2^8 µs.
pub const INTERVAL_LOG2_MIN: u32 = 8;
/// Longest interval: 2^14 µs.
pub const INTERVAL_LOG2_MAX: u32 = 14;

/// Microseconds in a second, the T of 1/Tⁿ.
const US_PER_S: i128 = 1_000_000;

/// Base-two logarithm of the time between control points in µs, 8 to 14.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IntervalLog2(u32);

impl IntervalLog2 {
    /// `None` outside [`INTERVAL_LOG2_MIN`]..=[`INTERVAL_LOG2_MAX`].
    #[must_use]
    pub const fn new(log2: u32) -> Option<Self> {
        if log2 >= INTERVAL_LOG2_MIN && log2 <= INTERVAL_LOG2_MAX { Some(Self(log2)) } else { None }
    }

    /// The interval, µs.
    #[must_use]
    pub const fn us(self) -> u32 {
        1 << self.0
    }

    /// Base-two logarithm of the interval in µs, 8 to 14.
    #[must_use]
    pub const fn log2(self) -> u32 {
        self.0
    }

    /// The interval in steps of 1/256 µs, the resolution of system time.
    #[must_use]
    pub const fn steps(self) -> u32 {
        1 << (self.0 + 8)
    }

    /// The part of an interval, in 2^-16 of it, that has gone by `since_knot_steps` steps of 1/256 µs after the knot: rounded down, which
    /// moves the instant by less than 2^(k−16) µs, a quarter of a µs at most. At or past the next knot it is the last part before that one.
    #[must_use]
    #[inline]
    #[expect(clippy::cast_possible_truncation, reason = "the minimum fits by its right side")]
    pub const fn part(self, since_knot_steps: u32) -> u16 {
        let part = since_knot_steps >> (self.0 - 8);
        if part > u16::MAX as u32 { u16::MAX } else { part as u16 }
    }
}

/// What a spline says of one instant. The unit is the control points' own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// Rounded to the nearest, halves up.
    pub position: i32,
    /// Units a second, rounded likewise.
    pub velocity_per_s: i64,
    /// Units a second², rounded likewise.
    pub acceleration_per_s2: i64,
    /// Units a second³, rounded likewise; saturates, since 2^31 units in 2^8 µs go past 64 bits.
    pub jerk_per_s3: i64,
}

/// The interval between the second and the third of four control points.
#[derive(Clone, Copy, Debug)]
pub struct Segment {
    /// Coefficients of 6·P in powers of u = t/N.
    numerators: [i128; 4],
    interval: IntervalLog2,
}

impl Segment {
    /// The segment that `points`, oldest first, span.
    #[must_use]
    pub fn new(points: [i32; 4], interval: IntervalLog2) -> Self {
        let [p0, p1, p2, p3] = points.map(i128::from);
        Self {
            numerators: [p0 + 4 * p1 + p2, 3 * (p2 - p0), 3 * (p0 - 2 * p1 + p2), p3 - p0 + 3 * (p1 - p2)],
            interval,
        }
    }

    /// Evaluates at `t_us` after the segment's start; a `t_us` past its end is taken as its end.
    #[must_use]
    pub fn sample(&self, t_us: u32) -> Sample {
        let n = i128::from(self.interval.us());
        let t = i128::from(t_us.min(self.interval.us()));
        let [c0, c1, c2, c3] = self.numerators;
        let whole = 6 * n * n * n;
        let position = c0 * n * n * n + c1 * n * n * t + c2 * n * t * t + c3 * t * t * t;
        let velocity = c1 * n * n + 2 * c2 * n * t + 3 * c3 * t * t;
        let acceleration = 2 * c2 * n + 6 * c3 * t;
        let jerk = 6 * c3;
        Sample {
            position: clamp_i32(div_round(position, whole)),
            velocity_per_s: clamp_i64(div_round(velocity * US_PER_S, whole)),
            acceleration_per_s2: clamp_i64(div_round(acceleration * US_PER_S.pow(2), whole)),
            jerk_per_s3: clamp_i64(div_round(jerk * US_PER_S.pow(3), whole)),
        }
    }
}

/// Nearest integer to `numerator / denominator`, halves up; `denominator` is positive.
const fn div_round(numerator: i128, denominator: i128) -> i128 {
    (2 * numerator + denominator).div_euclid(2 * denominator)
}

fn clamp_i64(value: i128) -> i64 {
    i64::try_from(value).unwrap_or(if value > 0 { i64::MAX } else { i64::MIN })
}

fn clamp_i32(value: i128) -> i32 {
    i32::try_from(value).unwrap_or(if value > 0 { i32::MAX } else { i32::MIN })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ALL: core::ops::RangeInclusive<u32> = INTERVAL_LOG2_MIN..=INTERVAL_LOG2_MAX;

    /// An earlier implementation scaled acceleration and jerk by 1/T where 1/T² and 1/T³ belong: halving T must give 4 and 8 times.
    #[test]
    fn derivatives_scale_with_their_own_power_of_the_interval() {
        let points = [0, 600, 4_800, 16_200]; // 600·k³: jerk is constant
        for log2 in INTERVAL_LOG2_MIN..INTERVAL_LOG2_MAX {
            let short = Segment::new(points, IntervalLog2(log2)).sample(0);
            let long = Segment::new(points, IntervalLog2(log2 + 1)).sample(0);
            assert_close(short.velocity_per_s, 2 * long.velocity_per_s, 2);
            assert_close(short.acceleration_per_s2, 4 * long.acceleration_per_s2, 4);
            assert_close(short.jerk_per_s3, 8 * long.jerk_per_s3, 8);
        }
    }

    /// Each side was rounded by at most one half, and the longer interval's half is multiplied by `factor`.
    fn assert_close(a: i64, b: i64, factor: i64) {
        assert!((a - b).abs() <= factor.div_euclid(2) + 1, "{a} and {b}");
    }

    /// Worked by hand: N = 1024 µs, points 0, 0, 0, 6 at the end of the segment: u = 1, 6·P = 6 → P = 1; 6·P' = 18/T → 3/T.
    #[test]
    fn a_hand_worked_end_of_segment() {
        let sample = Segment::new([0, 0, 0, 6], IntervalLog2(10)).sample(1024);
        assert_eq!(sample.position, 1);
        assert_eq!(sample.velocity_per_s, 2_930); // 3 / 1.024e-3 = 2929.69
        assert_eq!(sample.acceleration_per_s2, 5_722_046); // 6 / 1.048576e-6 = 5722045.9
        assert_eq!(sample.jerk_per_s3, 5_587_935_448); // 6 / 1.073741824e-9 = 5587935447.7
    }

    /// A positive overflow must not end at the negative limit.
    #[test]
    fn jerk_saturates_to_its_own_sign() {
        let up = Segment::new([i32::MIN, i32::MAX, i32::MIN, i32::MAX], IntervalLog2(8)).sample(0);
        let down = Segment::new([i32::MAX, i32::MIN, i32::MAX, i32::MIN], IntervalLog2(8)).sample(0);
        assert_eq!((up.jerk_per_s3, down.jerk_per_s3), (i64::MAX, i64::MIN));
    }

    proptest! {
        /// The weights sum to one: a constant comes out as itself, over the whole range (truncated weights lose 30 ppm).
        #[test]
        fn a_constant_has_no_gain_error(value in any::<i32>(), log2 in ALL, t in 0u32..=16_384) {
            let sample = Segment::new([value; 4], IntervalLog2(log2)).sample(t);
            prop_assert_eq!(sample, Sample { position: value, velocity_per_s: 0, acceleration_per_s2: 0, jerk_per_s3: 0 });
        }

        /// Neighbouring segments share their knot: position, velocity and acceleration agree to the one rounding.
        #[test]
        fn knots_are_continuous(p in proptest::array::uniform5(-1_000_000_000i32..1_000_000_000), log2 in ALL) {
            let interval = IntervalLog2(log2);
            let end = Segment::new([p[0], p[1], p[2], p[3]], interval).sample(interval.us());
            let start = Segment::new([p[1], p[2], p[3], p[4]], interval).sample(0);
            prop_assert_eq!((end.position, end.velocity_per_s), (start.position, start.velocity_per_s));
            prop_assert_eq!(end.acceleration_per_s2, start.acceleration_per_s2);
        }

        /// The spline stays in the hull of its control points.
        #[test]
        fn position_stays_in_the_hull(p in any::<[i32; 4]>(), log2 in ALL, t in 0u32..=16_384) {
            let position = Segment::new(p, IntervalLog2(log2)).sample(t).position;
            prop_assert!(p.iter().min().unwrap() <= &position && &position <= p.iter().max().unwrap());
        }
    }
}

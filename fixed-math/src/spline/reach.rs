//! How far apart control points may be for 32-bit evaluators, and what is said of those that are further.

use core::fmt;

/// Largest distance of neighbouring control points that the evaluators of the device path take, in units of the points: 2^25.
///
/// At 2^-16 mm a unit and 4.096 ms an interval it is 125 m/s. With it no intermediate of [`horner`](super::horner) exceeds 2^30 and none of
/// [`differences`](super::differences) 2^62.
pub const DIFFERENCE_MAX: i32 = 1 << 25;

/// Two neighbouring control points are further apart than [`DIFFERENCE_MAX`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooFar {
    /// The difference between the points `index` and `index + 1` of the four, 0 to 2.
    pub index: u8,
    /// The later point less the earlier.
    pub value: i64,
    /// The largest magnitude that is taken.
    pub bound: i32,
}

impl fmt::Display for TooFar {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { index, value, bound } = self;
        write!(
            f,
            "control points {index} and {} of a segment are {value} units apart, more than the {bound} that can be played: send points \
             that are closer in time, or take a coarser unit",
            index + 1
        )
    }
}

impl core::error::Error for TooFar {}

/// `to - from`, where no further than [`DIFFERENCE_MAX`]; `index` is that of the difference among a segment's three.
pub(super) fn difference(from: i32, to: i32, index: u8) -> Result<i32, TooFar> {
    match to.checked_sub(from) {
        Some(difference) if difference.unsigned_abs() <= DIFFERENCE_MAX.unsigned_abs() => Ok(difference),
        _ => Err(TooFar { index, value: i64::from(to) - i64::from(from), bound: DIFFERENCE_MAX }),
    }
}

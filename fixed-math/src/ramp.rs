//! Linear ramps: a value at a start, a value at an end, and a straight line between.
//!
//! - **Walk:** a ramp as it was sent ([`Ramp`]) → [`RampSegment::following`] or [`RampSegment::new`], once → [`RampSegment::value`] at
//!   each beat.
//! - **Invariants:** within 0.501 LSB of the exact line at any instant, monotone, exact at both ends, and never outside of them. The
//!   division is done once, at making.
//! - **Context:** making takes about 1,800 cycles of a Cortex-M0+ and is for a task that may be interrupted; reading takes about 120 and is for a
//!   beat.
//!
//! The elapsed time is scaled to the 32 bits of its ramp's length, so that a microsecond and a week are read alike:
//! `T' = T·2^n` (or `T/2^s`, its low bits kept aside) lies in 2^31 ≤ T' < 2^32, and the slope is `|Δ|·2^47/T'`, rounded once, 48 bits.
//! Of the product of the two, parts of less than 2^−14 LSB are left out.

use crate::time::NetTime;
use crate::widening::product;
use core::fmt;

/// Longest ramp: 2^48 − 1 steps of 1/256 µs, 12 days.
pub const RAMP_STEPS_MAX: u64 = (1 << 48) - 1;

/// A ramp as it is sent. What is left out is taken from the end of the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ramp {
    /// First instant; left out: the end of the ramp before.
    pub start: Option<NetTime>,
    /// Last instant, from which on the end value holds.
    pub end: NetTime,
    /// Value at the start, LSB; left out: the end value of the ramp before.
    pub start_value: Option<i32>,
    /// Value at the end, LSB.
    pub end_value: i32,
}

/// Why a ramp was refused. Nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RampError {
    /// It ends no later than it starts. Give it a length; for a jump, send a level.
    EndNotAfterStart {
        /// Its start, given or taken over.
        start: NetTime,
        /// Its end.
        end: NetTime,
    },
    /// It starts before the one before it ends. Start it there or later.
    StartBeforePreviousEnd {
        /// Its start.
        start: NetTime,
        /// The end of the one before.
        previous_end: NetTime,
    },
    /// It is longer than [`RAMP_STEPS_MAX`]. Send it in parts.
    TooLong {
        /// Its start.
        start: NetTime,
        /// Its end.
        end: NetTime,
    },
    /// The start time is left out and there is no ramp before. Send the first one with its start.
    NoStart {
        /// Its end.
        end: NetTime,
    },
    /// The start value is left out and there is no ramp before. Send the first one with its start value.
    NoStartValue {
        /// Its end.
        end: NetTime,
        /// Its end value.
        end_value: i32,
    },
}

impl fmt::Display for RampError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::EndNotAfterStart { start, end } => {
                write!(
                    f,
                    "a ramp from {} to {} us has no length: end it later than it starts, or send a level",
                    start.as_us(),
                    end.as_us()
                )
            }
            Self::StartBeforePreviousEnd { start, previous_end } => {
                write!(
                    f,
                    "a ramp from {} us, before the last one ends at {} us: start it there or later",
                    start.as_us(),
                    previous_end.as_us()
                )
            }
            Self::TooLong { start, end } => {
                write!(
                    f,
                    "a ramp from {} to {} us is longer than 2^40 us: send it in parts",
                    start.as_us(),
                    end.as_us()
                )
            }
            Self::NoStart { end } => {
                write!(f, "the first ramp, to {} us, leaves its start out: send it with one", end.as_us())
            }
            Self::NoStartValue { end, end_value } => {
                write!(
                    f,
                    "the first ramp, to {end_value} at {} us, leaves its start value out: send it with one",
                    end.as_us()
                )
            }
        }
    }
}

impl core::error::Error for RampError {}

/// A ramp that can be read.
///
/// ```
/// use fixed_math::ramp::{Ramp, RampSegment};
/// use fixed_math::time::NetTime;
///
/// let us = NetTime::from_us;
/// let up = RampSegment::new(us(1_000), us(2_000), -50, 50).unwrap();
/// assert_eq!(up.value(us(1_250)), -25);
/// // the next begins where this one ends
/// let short = Ramp { start: None, end: us(2_100), start_value: None, end_value: 0 };
/// let down = RampSegment::following(Some(&up), &short).unwrap();
/// assert_eq!((down.value(us(2_000)), down.value(us(2_050)), down.value(us(9_999))), (50, 25, 0));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RampSegment {
    start: NetTime,
    end: NetTime,
    start_value: i32,
    end_value: i32,
    /// |end − start value| · 2^47 / T', its upper 32 bits
    slope_high: u32,
    /// and its lower 16
    slope_low: u16,
    /// T' = T·2^up / 2^down, one of them none
    up: u8,
    down: u8,
}

impl RampSegment {
    /// The line from `start_value` at `start` to `end_value` at `end`.
    ///
    /// # Errors
    ///
    /// [`RampError::EndNotAfterStart`], [`RampError::TooLong`].
    pub fn new(start: NetTime, end: NetTime, start_value: i32, end_value: i32) -> Result<Self, RampError> {
        if end <= start {
            return Err(RampError::EndNotAfterStart { start, end });
        }
        let length = end.since(start).steps();
        if length > RAMP_STEPS_MAX {
            return Err(RampError::TooLong { start, end });
        }
        // at most 48 bits and at least one: 31 up to 16 down
        let bits = 64 - length.leading_zeros();
        let (up, down) = (32u32.saturating_sub(bits), bits.saturating_sub(32));
        let slope = ratio(start_value.abs_diff(end_value), length << up, down);
        #[expect(clippy::cast_possible_truncation, reason = "48 bits in two parts, and shifts below 32")]
        Ok(Self {
            start,
            end,
            start_value,
            end_value,
            slope_high: (slope >> 16) as u32,
            slope_low: slope as u16,
            up: up as u8,
            down: down as u8,
        })
    }

    /// The ramp that was sent as `ramp` after `previous`.
    ///
    /// # Errors
    ///
    /// Any [`RampError`].
    pub fn following(previous: Option<&Self>, ramp: &Ramp) -> Result<Self, RampError> {
        let end = ramp.end;
        let start = ramp.start.or(previous.map(|previous| previous.end)).ok_or(RampError::NoStart { end })?;
        let start_value = ramp.start_value.or(previous.map(|previous| previous.end_value));
        let start_value = start_value.ok_or(RampError::NoStartValue { end, end_value: ramp.end_value })?;
        match previous {
            Some(previous) if start < previous.end => {
                Err(RampError::StartBeforePreviousEnd { start, previous_end: previous.end })
            }
            _ => Self::new(start, end, start_value, ramp.end_value),
        }
    }

    /// First instant.
    #[must_use]
    pub const fn start(&self) -> NetTime {
        self.start
    }

    /// Last instant.
    #[must_use]
    pub const fn end(&self) -> NetTime {
        self.end
    }

    /// Value at the start, LSB.
    #[must_use]
    pub const fn start_value(&self) -> i32 {
        self.start_value
    }

    /// Value at the end and after it, LSB.
    #[must_use]
    pub const fn end_value(&self) -> i32 {
        self.end_value
    }

    /// The value at `at`, LSB, rounded to the nearest. Before the start it is the start value, from the end on the end value.
    #[must_use]
    #[inline]
    pub fn value(&self, at: NetTime) -> i32 {
        if at >= self.end {
            return self.end_value;
        }
        let elapsed = at.since(self.start).steps();
        #[expect(clippy::cast_possible_truncation, reason = "the halves; no more than 16 bits are in the upper")]
        let (high, low) = ((elapsed >> 32) as u32, elapsed as u32);
        // T' has 32 bits, so has what is elapsed of it; the rest is kept
        let (part, rest) = if self.down == 0 {
            (low << self.up, 0)
        } else {
            ((high << (32 - self.down)) | (low >> self.down), low & ((1 << self.down) - 1))
        };
        // in 2^−31 LSB: each summand grows with its own factor and the last stays below one step of `part`, so the sum is monotone
        let fine = u32::from(self.slope_low) * (part >> 16);
        let finer = ((self.slope_high >> 16) * rest) << (16 - self.down);
        let sum = product(self.slope_high, part) + u64::from(fine) + u64::from(finer) + (1 << 30);
        #[expect(clippy::cast_possible_truncation, reason = "no more than the change of value, which has 32 bits")]
        let change = (sum >> 31) as u32;
        if self.end_value >= self.start_value {
            self.start_value.wrapping_add_unsigned(change)
        } else {
            self.start_value.wrapping_sub_unsigned(change)
        }
    }
}

/// `change · 2^(47 + down) / length`, to the nearest; 2^31 ≤ length / 2^down < 2^32, so that it has 48 bits.
const fn ratio(change: u32, length: u64, down: u32) -> u64 {
    let mut rest = (change as u64) << down;
    let mut quotient = 0;
    let mut bit = 0;
    // one of the integer and 47 after the point; the rest stays below twice the length, so below 2^49
    while bit < 48 {
        quotient <<= 1;
        if rest >= length {
            rest -= length;
            quotient |= 1;
        }
        rest <<= 1;
        bit += 1;
    }
    // what is left is doubled already; a quotient of all ones has nothing left
    quotient + (rest >= length) as u64
}

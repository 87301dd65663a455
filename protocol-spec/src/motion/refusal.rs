//! Why a motion port refuses, with what it refuses by.
//!
//! - **Walk:** a track's error → *here* → a person. **Invariant:** every refusal has the operands that tell what would have been taken.
//! - **Clauses:** `[MOT-01]`, `[MOT-04]`, `[MOT-06]`, `[MOT-09]`.

use super::Fault;
use serde::{Deserialize, Serialize};

/// Why a motion port refuses, `[MOT-01]`, `[MOT-04]`, `[MOT-09]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum MotionRefusal {
    /// The message is none of these, or of another version.
    Malformed,
    /// There is no such axis, track, node, output, channel or trigger.
    NoSuch {
        /// What was named.
        index: u8,
        /// How many there are.
        count: u8,
    },
    /// The axis has not been armed.
    NotArmed,
    /// The axis moves.
    Moving,
    /// The point would be used already.
    Late {
        /// Its time, 1/256 µs.
        point_steps: u64,
        /// The earliest that could still be taken.
        earliest_steps: u64,
    },
    /// The queue is full.
    Full {
        /// Points of the message that were taken.
        taken: u8,
        /// Points it holds.
        capacity: u16,
    },
    /// Too many points are missing before it.
    Gap {
        /// Points missing.
        missing: u32,
        /// Points rebuilt in a row.
        missing_max: u8,
    },
    /// Its time is not after the last one's.
    NonMonotonic {
        /// Its time, 1/256 µs.
        point_steps: u64,
        /// The last point's.
        last_steps: u64,
    },
    /// Its time is no multiple of the interval.
    OffGrid {
        /// Its time, 1/256 µs.
        point_steps: u64,
        /// Logarithm to base two of the interval in µs.
        interval_log2: u8,
    },
    /// A limit is broken by it: the fault is latched now.
    Limit(Fault),
    /// A fault was latched before.
    Latched(Fault),
    /// A setting is out of its range.
    Setting {
        /// Which field of [`AxisSettings`](super::AxisSettings), from 0.
        field: u8,
        /// What was wanted.
        value: i32,
        /// The nearest that could be.
        bound: i32,
    },
    /// A stop would take more intervals than there may be, `[MOT-09]`.
    StopTooLong {
        /// Intervals.
        intervals: u32,
        /// The most.
        most: u16,
    },
    /// A halt's time leaves no acceleration or no jerk, `[MOT-25]`.
    HaltTooShort {
        /// As wanted.
        stop_log2: u8,
        /// The least that would do.
        least: u8,
    },
    /// That time is not in the history.
    NotInHistory {
        /// The earliest that is, 1/256 µs.
        earliest_steps: u64,
        /// The latest.
        latest_steps: u64,
    },
    /// A halt is on its way; this waits for its end.
    Halting,
    /// The clock is not settled, or not sure enough.
    Clock {
        /// Its bound, µs.
        bound_us: u32,
    },
    /// A ramp that ends before it starts, or starts before the former ends.
    Order {
        /// Start, 1/256 µs.
        start_steps: u64,
        /// End, or what is before it.
        end_steps: u64,
    },
    /// A node of the signals that cannot be.
    Node {
        /// Its operation.
        operation: u8,
        /// The operand at fault.
        operand: u8,
    },
    /// What was asked before is not done yet: ask again.
    Busy,
}

impl MotionRefusal {
    /// Its bytes in `out`; `None` where that is shorter than [`REPLY_BYTES_MAX`](super::REPLY_BYTES_MAX) and it does not fit.
    pub fn encode<'o>(&self, out: &'o mut [u8]) -> Option<&'o [u8]> {
        postcard::to_slice(self, out).ok().map(|bytes| &*bytes)
    }
}

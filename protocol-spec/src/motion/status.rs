//! How an axis does, and what went wrong with it.
//!
//! - **Walk:** a device's counters and latches → *here* → a person. **Clauses:** `[MOT-06]`, `[MOT-07]`, `[MOT-11]`.

use serde::{Deserialize, Serialize};

/// What an axis is doing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum AxisState {
    /// Not armed.
    #[default]
    Idle,
    /// Armed, at rest, waiting for its first point.
    Armed,
    /// Playing points.
    Playing,
    /// Coming to rest by itself for want of points.
    Stopping,
    /// At rest for want of points.
    Starved,
    /// The same, with its motor let go.
    Released,
}

/// Which limit a point broke.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum LimitKind {
    /// Position, or the way a stop would take.
    Position,
    /// First difference, or what it would become by the time acceleration is taken back.
    Velocity,
    /// Second difference.
    Acceleration,
    /// Third difference.
    Jerk,
}

/// A limit broken, `[MOT-06]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Fault {
    /// Time of the point, 1/256 µs.
    pub point_steps: u64,
    /// Which limit.
    pub limit: LimitKind,
    /// What it would have been.
    pub value: i32,
    /// What it may be.
    pub bound: i32,
}

/// Why a device halted all motion by itself, `[MOT-06]`, `[MOT-11]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum HaltReason {
    /// An axis broke a limit.
    Fault {
        /// Which axis.
        axis: u8,
    },
    /// No fresh point came for [`FRESH_US_MAX`](super::FRESH_US_MAX).
    Silence {
        /// For which axis.
        axis: u8,
    },
    /// The clock could not be relied on.
    Clock,
}

/// How an axis does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AxisStatus {
    /// What it is doing.
    pub state: AxisState,
    /// Where it was at the last beat that was told.
    pub position: i32,
    /// Room for points.
    pub free: u16,
    /// Time of the last point held, 1/256 µs; 0 before the first.
    pub last_steps: u64,
    /// System time less the time that tracks are played at, 1/256 µs, `[MOT-24]`.
    pub delay_steps: u64,
    /// The fault that is latched.
    pub fault: Option<Fault>,
    /// Points taken.
    pub accepted: u32,
    /// Points refused.
    pub refused: u32,
    /// Points rebuilt.
    pub rebuilt: u32,
    /// Times it was starved.
    pub starved: u32,
    /// Steps that were due in a beat beyond the one there is.
    pub steps_late: u32,
    /// Why the device last halted all motion by itself.
    pub halted: Option<HaltReason>,
}

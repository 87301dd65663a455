//! What an axis and a trigger are told to be.
//!
//! - **Walk:** a request's body → *here* → the device's own types, which check ranges. **Invariant:** integers per interval.
//! - **Clauses:** `[MOT-02]`, `[MOT-06]`, `[MOT-07]`, `[MOT-09]`, `[MOT-14]`, `[MOT-25]`.

use serde::{Deserialize, Serialize};

/// What a device does with an axis that has come to rest for want of points, `[MOT-07]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum StarvedPolicy {
    /// Stays where it is, held by its motor.
    #[default]
    Stop,
    /// The same, and what comes to rest on its own is held too.
    Hold,
    /// Lets go of the motor: least energy.
    Relax,
}

/// A limit that may fall as the velocity rises: `at_rest` up to a velocity of `knee`, then in a straight line to `at_full` at the velocity limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct CurveSettings {
    /// At velocities up to `knee`.
    pub at_rest: i32,
    /// At the velocity limit; not above `at_rest`.
    pub at_full: i32,
    /// First difference up to which `at_rest` holds.
    pub knee: i32,
}

/// What an axis is to be, `[MOT-02]`, `[MOT-06]`, `[MOT-25]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct AxisSettings {
    /// Logarithm to base two of the interval in µs, 8 to 14.
    pub interval_log2: u8,
    /// Logarithm to base two of a step's size in LSB; of a phase's for a motor driven by phases.
    pub step_log2: u8,
    /// What follows where points are missing.
    pub policy: StarvedPolicy,
    /// Most missing points rebuilt in a row.
    pub missing_max: u8,
    /// Time of a halt: 3·2^n µs.
    pub stop_log2: u8,
    /// Least position.
    pub position_min: i32,
    /// Greatest position.
    pub position_max: i32,
    /// Greatest first difference.
    pub velocity: i32,
    /// Greatest second difference.
    pub acceleration: CurveSettings,
    /// Greatest third difference.
    pub jerk: CurveSettings,
}

/// When a channel is read, `[MOT-14]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum TriggerSettings {
    /// Never.
    #[default]
    Off,
    /// Every so many beats.
    Interval {
        /// Beats from one reading to the next, at least 1.
        beats: u32,
    },
    /// When a node becomes true, becomes false, or either.
    Edge {
        /// Which node.
        node: u8,
        /// On becoming true.
        rising: bool,
        /// On becoming false.
        falling: bool,
    },
    /// Every so many beats while a node is true.
    Window {
        /// Which node.
        node: u8,
        /// Beats from one reading to the next, at least 1.
        beats: u32,
    },
}

//! MAXL on a device: time-stamped tracks, played on synchronised time and safe whatever arrives. Sans-IO, in static memory.
//!
//! - **Walk:** a control point → [`Feeder::offer`] in the task `serve` (late, full, gap, non-monotonic, limits: refused with operands) → a ring
//!   without a lock → [`Player::beat`] in the highest-priority task, at the track time that [`BeatClock::advance`] gives for all axes →
//!   position, velocity and acceleration for an output.
//! - **Invariants:** the player needs nobody: without points it brakes by itself within the limits. No allocation, no panic on
//!   any byte, no float.
//! - **Context:** halves named `…Feeder` or `…Clock` belong to one task each; nothing is shared but rings.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod axis;
pub mod beat;
pub mod clock;
pub mod device;
pub mod feeder;
pub mod player;
pub mod tracks;
pub mod triggers;
pub mod watch;

mod history;
mod ring;

pub use axis::{ArmError, AxisConfig, AxisRings, ConfigError, Fault, Point, StarvedCause, StarvedPolicy};
pub use beat::{Beat, BeatLock};
pub use clock::{BeatClock, ClockRings, HaltError, MotionClock, MotionState, TrackTime};
pub use feeder::{Accepted, Feeder, FeederCounters, FeederState, Motion, Refusal};
pub use player::{Output, Player, PlayerState};
pub use tracks::{LevelTrack, RampTrack, TrackCounters, TrackRefusal};
pub use triggers::{Edge, Reading, ReadingRing, ReadingsIn, ReadingsOut, Trigger};
pub use watch::{ClockFault, ClockGuard, ClockHealth, Watchdog};

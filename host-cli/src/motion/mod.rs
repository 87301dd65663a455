//! Motion on the workstation: control points played as a device plays them, and how far that is from the path they came from.
//!
//! - **Walk:** a file → [`table`] → [`points`] → [`curve`] is what a device does with points; a file → [`table`] → [`path`] →
//!   [`fit`] → [`curve`] → [`deviation`], beside its [`bound`], is what comes of a path.
//! - **Invariants:** positions and their derivatives come from `fixed_math::spline::horner`, the evaluator of the devices. Times are µs,
//!   intervals powers of two.
//! - **Context:** floats and memory as needed: nothing of this runs on a device.

pub mod bound;
pub mod curve;
pub mod deviation;
pub mod fit;
pub mod path;
pub mod paths;
pub mod points;
pub mod table;

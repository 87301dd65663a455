//! The backstops against an arithmetic that shares nothing with them: limits, the stop that they promise, and the stop along the path.

mod braking;
mod limiting;
mod truth;
mod warping;

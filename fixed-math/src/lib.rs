//! Fixed-point arithmetic of the device path: time, clocks compared by it, and splines with exact derivatives.
//!
//! - **Walk:** every stamp of a packet and every instant of a control point is one of the types in [`time`].
//! - **Invariants:** no float, no allocation, no panic; what would overflow saturates towards the side that was overflown.
//! - **Context:** any, interrupts included, but for what [`clock`] says of its estimator: every call is a handful of integer
//!   instructions.
#![no_std]
#![forbid(unsafe_code)]

pub mod brake;
pub mod clock;
#[cfg(any(feature = "kernels", test))]
pub mod kernels;
pub mod lag;
pub mod level;
pub mod limits;
pub mod logic;
pub mod phase;
pub mod ramp;
pub mod servo;
pub mod spline;
pub mod steps;
pub mod time;
pub mod warp;
mod widening;

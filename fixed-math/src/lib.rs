//! Fixed-point arithmetic of the device path: time today, splines with exact derivatives beside it.
//!
//! - **Walk:** every stamp of a packet and every instant of a control point is one of the types in [`time`].
//! - **Invariants:** no float, no allocation, no panic; what would overflow saturates towards the side that was overflown.
//! - **Context:** any, interrupts included: every call is a handful of integer instructions.
#![no_std]
#![forbid(unsafe_code)]

pub mod spline;
pub mod time;

//! A deterministic discrete-event world of real OSAP nodes.
#![forbid(unsafe_code)]

pub mod capture;
pub mod endpoint;
pub mod faults;

//! A deterministic discrete-event world of real OSAP nodes: virtual time, drifting clocks, wires with rates and faults.
//!
//! - **Walk:** [`world`] lets time pass; [`endpoint`] is what it calls; [`device`] is the firmware's own application behind it;
//!   [`machines`] builds whole machines. [`faults`] and [`capture`] serve real links as well.
//! - **Invariants:** no wall clock and no randomness but from the seed: a run repeats itself, byte for byte.
//! - **Context:** one thread steps a world.
#![forbid(unsafe_code)]

pub mod capture;
pub mod device;
pub mod endpoint;
pub mod faults;
pub mod machines;
pub mod processor;
pub mod time;
pub mod walk;
pub mod world;

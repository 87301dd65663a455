//! Real images in emulators and, where one is attached, on boards: one front for all.
//!
//! - **Walk:** a [`scenario`] → [`cosim`] (RP2040, virtual time) or [`qemu`] (Cortex-M7, real time) → real images → what the
//!   host's own session finds → a [`report`].
//! - **Invariants:** figures about time come from virtual time only; no figure is taken anywhere but from a real image. What did not run
//!   says so. Processes that were started are ended.
//! - **Context:** a workstation with QEMU and Node.js; `cargo xtask hil` makes sure of both.
#![forbid(unsafe_code)]

pub mod account;
pub mod bridge;
pub mod cosim;
pub mod gdb;
pub mod images;
pub mod machine;
pub mod network;
pub mod pico;
pub mod pins;
pub mod qemu;
pub mod report;
pub mod rta;
pub mod scenario;
pub mod tasks;
pub mod traffic;

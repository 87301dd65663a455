//! QEMU's `mps2-an386`: a Cortex-M4 with the peripherals of `mps2-an500` at the same addresses, and its RAM elsewhere.
//!
//! - **Walk:** as [`board_mps2_an500`]'s, whose parts these are.
//! - **Invariant:** what differs stands here, and is [`REGION`] alone.
//! - **Context:** as the parts say. **Clauses:** `[NOD-08]`, `[DSC-05]`.
#![no_std]
#![forbid(unsafe_code)]

pub use board_mps2_an500::{
    Board, Uart, UartRx, UartTx, clock, kept, motors, now, outputs, pac, pace, signals, uart, watchdog,
};

/// Where this board keeps what outlives a reset: its pseudo-static RAM, 16 MiB, which QEMU calls `mps.ram`.
pub const REGION: kept::Region = kept::Region::at(0x2100_0000);

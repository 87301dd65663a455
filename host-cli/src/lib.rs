//! The workstation side of OSAP.
#![forbid(unsafe_code)]

pub mod bench;
pub mod cli;
pub mod clocks;
pub mod core;
pub mod error;
pub mod explain;
pub mod link;
pub mod map;
pub mod motion;
pub mod network;
pub mod ping;
pub mod scan;
pub mod session;

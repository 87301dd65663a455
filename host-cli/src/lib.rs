//! The workstation side of OSAP.
#![forbid(unsafe_code)]

pub mod cli;
pub mod explain;
pub mod link;

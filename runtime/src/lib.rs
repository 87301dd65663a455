//! Crate root.
#![no_std]
#![forbid(unsafe_code)]

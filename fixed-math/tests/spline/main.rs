//! The evaluators of the device path against the exact reference, against rational numbers and against floats.
#![forbid(unsafe_code)]

mod differences;
mod exact;
mod horner;

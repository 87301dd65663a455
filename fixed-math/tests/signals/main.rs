//! Signals of tracks against exact arithmetic: ramps, levels, logic, steps, phases, a servo and the motor that is not there.
#![expect(clippy::cast_possible_truncation, reason = "the truth is kept in longer integers")]

mod levels;
mod logic;
mod phase;
mod ramp;
mod servo;
mod steps;

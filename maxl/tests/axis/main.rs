//! An axis, its clock and its beats, as a board would run them.

mod beats;
mod halts;
mod playing;
mod refusals;
mod world;

//! The exchange of time, node by node: `[TIM-01]` to `[TIM-17]`.

#[path = "../common/mod.rs"]
mod common;
mod exchange;
mod network;
mod refusals;
mod steering;

//! One OSAP node, sans-IO, in static memory: what is between a link's bytes and a port's handler.
//!
//! - **Walk:** [`Node::receive`] (ingress: valid, or one named drop) → [`route`] (pure) → [`pool`] and [`stack`] → [`Node::transmit`] or
//!   [`Mailbox::take`] → a handler → [`Mailbox::reply`] on the reversed route → the stack again.
//! - **Invariants:** no allocation, no clock of its own, no panic on a peer's bytes; every slot claimed is relinquished.
//! - **Context:** one node belongs to one context (the routing task, or a host's node thread); user ports reach it through [`Mailbox`].
//! - **Clauses:** `protocol-spec/spec/node.md`.
#![no_std]
#![forbid(unsafe_code)]

pub mod clock;
pub mod counters;
pub mod debug;
pub mod gateway;
pub mod mailbox;
pub mod netresponder;
pub mod node;
pub mod pool;
pub mod port;
pub mod ring;
pub mod route;
pub mod segmented;
pub mod sequenced;
pub mod stack;

mod announce;
mod egress;
mod exchange;
mod halt;
mod ingress;
mod peer;

pub use clock::SystemTime;
pub use egress::{Departure, Outgoing};
pub use gateway::{GatewayConfig, Stamps};
pub use mailbox::{Delivery, Mailbox, Outbound, SendError};
pub use node::{Identity, Node};
pub use peer::{
    BURST, BURST_INTERVAL_US, BURST_MISSES_MAX, BUS_FACTOR, BUS_MEMBERS_MAX, MISSES_MAX, OUTLIERS_MAX, SEARCH_EVERY,
    SEARCH_US, SLOW_FACTOR,
};
pub use port::PortConfig;

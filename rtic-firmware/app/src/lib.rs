//! What a device does: a node with its ports, without interrupts, tasks or hardware, so that it runs unchanged in simulation.
//!
//! - **Walk:** an image's tasks call [`Device::receive`], [`Device::route`], [`Device::serve`] and [`Device::transmit`]; the simulator's
//!   world calls the same.
//! - **Invariants:** static memory, time as an argument, no panic on a peer's bytes.
//! - **Context:** one device belongs to one resource, shared by the routing and the serving task; every call is bounded.
//! - **Clauses:** `protocol-spec/spec/app.md`.
#![no_std]
#![forbid(unsafe_code)]

pub mod beats;
pub mod device;
pub mod echo;
pub mod kind;
pub mod link;
pub mod lock;
pub mod motion;
pub mod report;
pub mod routing;
pub mod services;
pub mod servo;
pub mod settings;
pub mod spin;
pub mod stream;

pub use device::Device;
pub use kind::Kind;
pub use link::{Link, Wire};
pub use services::Services;

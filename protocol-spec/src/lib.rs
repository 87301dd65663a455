//! The OSAP wire protocol: what stands in a packet, how packets stand on a link, and the messages that every node serves.
//!
//! - **Walk:** [`framing`] finds packets in bytes → [`header`] says where they go and rewrites them on the way → [`transport`] says
//!   how the payload is answered → [`discovery`] and [`system`] are the payloads that belong to the network itself.
//! - **Invariants:** no allocation, no panic on a peer's bytes; every reason to refuse some is a [`DropCause`].
//! - **Clauses:** `spec/*.md` beside this crate; hand-written bytes in `vectors/*.toml`.
#![no_std]
#![forbid(unsafe_code)]

pub mod address;
pub mod discovery;
pub mod drops;
pub mod framing;
pub mod halt;
pub mod header;
pub mod motion;
pub mod route;
pub mod system;
pub mod time;
pub mod transport;
pub mod ttl;

pub use address::{BusDrop, GatewayIndex, PortIndex};
pub use drops::DropCause;
pub use header::{HeaderError, Instruction, Packet};
pub use route::{Route, RouteBuf, Step};

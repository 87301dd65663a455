//! A node's end of software: what it is, and how many packets it may hold.
//!
//! - **Walk:** the last step of a packet, and the first. **Clause:** `[NOD-01]`.

use osap_protocol::discovery::{Name, PortInfo};

/// What does not change about a port.
#[derive(Clone, Copy, Debug)]
pub struct PortConfig {
    /// What software it leads to; cut to `NAME_BYTES_MAX`.
    pub type_name: &'static str,
    /// What it is called; often empty.
    pub name: &'static str,
    /// Packets it may hold in the pool at once.
    pub packet_hold_max: u8,
}

/// One port of a node.
#[derive(Debug)]
pub struct Port {
    pub(crate) config: PortConfig,
    /// Slots it owns.
    pub(crate) held: u8,
    /// Packets in the stack for it.
    pub(crate) waiting: u16,
    pub(crate) received: u32,
    pub(crate) sent: u32,
}

impl Port {
    pub(crate) const fn new(config: PortConfig) -> Self {
        Self { config, held: 0, waiting: 0, received: 0, sent: 0 }
    }

    /// Answer to query 6.
    #[must_use]
    pub fn info(&self) -> PortInfo {
        PortInfo {
            type_name: name_of(self.config.type_name),
            name: name_of(self.config.name),
            packet_hold_max: self.config.packet_hold_max,
            received: self.received,
            sent: self.sent,
        }
    }
}

/// `text` as a name, cut at the last character that fits.
pub(crate) fn name_of(text: &str) -> Name {
    let mut name = Name::new();
    for character in text.chars() {
        if name.push(character).is_err() {
            break;
        }
    }
    name
}

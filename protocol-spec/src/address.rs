//! Indices that fit the fields of an instruction: gateways, bus drops and ports.
//!
//! - **Walk:** everywhere; a value of these types needs no further check before it is written into a packet.
//! - **Clauses:** `[PKT-03]` widths, `[PKT-15]` broadcast, `[LNK-03]` drops.

/// Index of a gateway, to a point-to-point link or a bus, within one node: 0 to 63.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct GatewayIndex(u8);

impl GatewayIndex {
    /// Gateways a node can have: six bits, `[PKT-03]`.
    pub const COUNT: u8 = 1 << 6;

    /// `None` where `index` does not fit six bits.
    #[must_use]
    pub const fn new(index: u8) -> Option<Self> {
        if index < Self::COUNT { Some(Self(index)) } else { None }
    }

    /// The low six bits of an instruction's first byte.
    #[must_use]
    pub const fn from_low_bits(byte: u8) -> Self {
        Self(byte & (Self::COUNT - 1))
    }

    /// The index as a number.
    #[must_use]
    pub const fn get(self) -> u8 {
        self.0
    }

    /// The index into a table of gateways.
    #[must_use]
    pub const fn at(self) -> usize {
        self.0 as usize
    }
}

/// Address of a node on a bus, 0 to 254, or 255 for all of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BusDrop(pub u8);

impl BusDrop {
    /// Every node on the bus, `[PKT-15]`.
    pub const BROADCAST: Self = Self(255);
}

/// Index of a port within one node: 0 to 2047. Port 0 is the netresponder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PortIndex(u16);

impl PortIndex {
    /// Ports a node can have: eleven bits, `[PKT-03]`.
    pub const COUNT: u16 = 1 << 11;
    /// Port 0 of every node answers queries, `[DSC-01]`.
    pub const NETRESPONDER: Self = Self(0);

    /// `None` where `index` does not fit eleven bits.
    #[must_use]
    pub const fn new(index: u16) -> Option<Self> {
        if index < Self::COUNT { Some(Self(index)) } else { None }
    }

    /// The low eleven bits of a port instruction's field.
    #[must_use]
    pub const fn from_low_bits(bits: u32) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "masked to eleven bits")]
        Self((bits & (Self::COUNT as u32 - 1)) as u16)
    }

    /// The index as a number.
    #[must_use]
    pub const fn get(self) -> u16 {
        self.0
    }

    /// The index into a table of ports.
    #[must_use]
    pub const fn at(self) -> usize {
        self.0 as usize
    }
}

//! Nodes of a graph of signals, and the plain numbers that a message describes them by.
//!
//! - **Walk:** twelve bytes of a message → [`Node::decode`] → [`Graph::set`](super::Graph::set).
//! - **Invariants:** decoding and encoding are each other's inverse: what a node does not use is 0, or it is refused.
//! - **Context:** any; not for a beat.
//!
//! | byte | is |
//! |------|----|
//! | 0 | operation |
//! | 1 | source a: 0 to 127 an input, 128 to 255 a node |
//! | 2 | source b |
//! | 3 | shift |
//! | 4 to 7 | x, `i32`, low byte first |
//! | 8 to 11 | y, likewise |

use core::fmt;

/// Bytes of an encoded node.
pub const NODE_BYTES: usize = 12;

/// Bit that tells a node from an input.
const IS_NODE: u8 = 0x80;

/// Largest shift of a product: of two i32 that are fractions of 2^31, the product is one too.
const SHIFT_MAX: u8 = 31;

/// What a node reads: an input of its graph, or a node before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Source(u8);

impl Source {
    /// Input `index`; `None` from 128 on.
    #[must_use]
    pub const fn input(index: u8) -> Option<Self> {
        if index < IS_NODE { Some(Self(index)) } else { None }
    }

    /// Node `index`; `None` from 128 on.
    #[must_use]
    pub const fn node(index: u8) -> Option<Self> {
        if index < IS_NODE { Some(Self(index | IS_NODE)) } else { None }
    }

    /// As a message has it.
    #[must_use]
    pub const fn from_byte(byte: u8) -> Self {
        Self(byte)
    }

    /// As a message has it.
    #[must_use]
    pub const fn to_byte(self) -> u8 {
        self.0
    }

    /// The input's index, if it is one.
    #[must_use]
    #[inline]
    pub const fn as_input(self) -> Option<u8> {
        if self.0 & IS_NODE == 0 { Some(self.0) } else { None }
    }

    /// The node's index, if it is one.
    #[must_use]
    pub const fn as_node(self) -> Option<u8> {
        if self.0 & IS_NODE == 0 { None } else { Some(self.0 & !IS_NODE) }
    }

    #[inline]
    pub(super) const fn index(self) -> usize {
        (self.0 & !IS_NODE) as usize
    }
}

/// One operation on signals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Node {
    /// 0: `value` (x), always.
    Constant {
        /// It.
        value: i32,
    },
    /// 1: true from `a ≥ threshold` (x) on, false again at `a < threshold − hysteresis` (y).
    Above {
        /// What is compared.
        a: Source,
        /// From where on it is true.
        threshold: i32,
        /// How much further back it becomes false, ≥ 0.
        hysteresis: i32,
    },
    /// 2: true from `a ≥ b` on, false again at `a < b − hysteresis` (x).
    Greater {
        /// What is compared.
        a: Source,
        /// What it is compared with.
        b: Source,
        /// How much further back it becomes false, ≥ 0.
        hysteresis: i32,
    },
    /// 3: `low ≤ a ≤ high` (x, y).
    Inside {
        /// What is looked at.
        a: Source,
        /// Lowest that is inside.
        low: i32,
        /// Highest that is inside.
        high: i32,
    },
    /// 4: not that.
    Outside {
        /// What is looked at.
        a: Source,
        /// Lowest that is inside.
        low: i32,
        /// Highest that is inside.
        high: i32,
    },
    /// 5: `a` while `open` (b) is true, else `otherwise` (x).
    Gate {
        /// What is let through.
        a: Source,
        /// When it is.
        open: Source,
        /// What there is when it is not.
        otherwise: i32,
    },
    /// 6: `a + b`, saturating.
    Sum {
        /// One.
        a: Source,
        /// The other.
        b: Source,
    },
    /// 7: `a − b`, saturating.
    Difference {
        /// From what.
        a: Source,
        /// What is taken away.
        b: Source,
    },
    /// 8: `a · b / 2^shift` to the nearest, halves up, saturating: with `b` in 2^−shift, `a` scaled by it.
    Product {
        /// One.
        a: Source,
        /// The other.
        b: Source,
        /// Fractional bits that are taken off, 0 to 31.
        shift: u8,
    },
    /// 9: both.
    And {
        /// One.
        a: Source,
        /// The other.
        b: Source,
    },
    /// 10: one or both.
    Or {
        /// One.
        a: Source,
        /// The other.
        b: Source,
    },
    /// 11: one and not both.
    ExclusiveOr {
        /// One.
        a: Source,
        /// The other.
        b: Source,
    },
    /// 12: `a` is 0.
    Not {
        /// What is denied.
        a: Source,
    },
    /// 13: true for the one pass in which `a` has become true. The first pass finds no edge.
    Rising {
        /// What is looked at.
        a: Source,
    },
    /// 14: the same for false.
    Falling {
        /// What is looked at.
        a: Source,
    },
    /// 15: either of the two.
    Edge {
        /// What is looked at.
        a: Source,
    },
}

/// Why a node makes no sense.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NodeError {
    /// No operation has this code.
    UnknownOperation {
        /// The code.
        operation: u8,
    },
    /// A window whose lower end is above its upper one holds nothing. Exchange them.
    EmptyWindow {
        /// Its lower end.
        low: i32,
        /// Its upper end.
        high: i32,
    },
    /// A hysteresis is a distance: 0 or more.
    NegativeHysteresis {
        /// It.
        hysteresis: i32,
    },
    /// More fractional bits than 31.
    ShiftTooLarge {
        /// It.
        shift: u8,
    },
    /// A field that the operation does not use is not 0. A newer sender means something by it that is not known here.
    UnusedField {
        /// The operation's code.
        operation: u8,
        /// First byte of the field, as the table has them.
        byte: u8,
        /// What it holds.
        value: i32,
    },
}

impl fmt::Display for NodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UnknownOperation { operation } => {
                write!(f, "operation {operation} of a node is not known: use 0 to 15")
            }
            Self::EmptyWindow { low, high } => {
                write!(f, "a window from {low} to {high} holds nothing: exchange its ends")
            }
            Self::NegativeHysteresis { hysteresis } => {
                write!(f, "a hysteresis of {hysteresis}: it is a distance, 0 or more")
            }
            Self::ShiftTooLarge { shift } => {
                write!(f, "a product shifted by {shift} bits: use {SHIFT_MAX} or less")
            }
            Self::UnusedField { operation, byte, value } => {
                write!(f, "operation {operation} does not use byte {byte}, which holds {value}: set it to 0")
            }
        }
    }
}

impl core::error::Error for NodeError {}

impl Node {
    /// The node that twelve bytes describe.
    ///
    /// # Errors
    ///
    /// Any [`NodeError`].
    pub fn decode(bytes: &[u8; NODE_BYTES]) -> Result<Self, NodeError> {
        let [operation, a, b, shift, x0, x1, x2, x3, y0, y1, y2, y3] = *bytes;
        let (x, y) = (i32::from_le_bytes([x0, x1, x2, x3]), i32::from_le_bytes([y0, y1, y2, y3]));
        let (a, b) = (Source(a), Source(b));
        let node = match operation {
            0 => Self::Constant { value: x },
            1 => Self::Above { a, threshold: x, hysteresis: y },
            2 => Self::Greater { a, b, hysteresis: x },
            3 => Self::Inside { a, low: x, high: y },
            4 => Self::Outside { a, low: x, high: y },
            5 => Self::Gate { a, open: b, otherwise: x },
            6 => Self::Sum { a, b },
            7 => Self::Difference { a, b },
            8 => Self::Product { a, b, shift },
            9 => Self::And { a, b },
            10 => Self::Or { a, b },
            11 => Self::ExclusiveOr { a, b },
            12 => Self::Not { a },
            13 => Self::Rising { a },
            14 => Self::Falling { a },
            15 => Self::Edge { a },
            _ => return Err(NodeError::UnknownOperation { operation }),
        };
        node.check()?;
        // what is not used comes back as 0
        let (_, used_a, used_b, used_shift, used_x, used_y) = node.fields();
        let fields = [
            (1, i32::from(a.0), i32::from(used_a)),
            (2, i32::from(b.0), i32::from(used_b)),
            (3, i32::from(shift), i32::from(used_shift)),
            (4, x, used_x),
            (8, y, used_y),
        ];
        match fields.into_iter().find(|(_, given, used)| given != used) {
            Some((byte, value, _)) => Err(NodeError::UnusedField { operation, byte, value }),
            None => Ok(node),
        }
    }

    /// Its twelve bytes.
    #[must_use]
    pub fn encode(&self) -> [u8; NODE_BYTES] {
        let (operation, a, b, shift, x, y) = self.fields();
        let mut bytes = [0; NODE_BYTES];
        bytes[..4].copy_from_slice(&[operation, a, b, shift]);
        bytes[4..8].copy_from_slice(&x.to_le_bytes());
        bytes[8..].copy_from_slice(&y.to_le_bytes());
        bytes
    }

    /// Operation, a, b, shift, x and y.
    const fn fields(&self) -> (u8, u8, u8, u8, i32, i32) {
        match *self {
            Self::Constant { value } => (0, 0, 0, 0, value, 0),
            Self::Above { a, threshold, hysteresis } => (1, a.0, 0, 0, threshold, hysteresis),
            Self::Greater { a, b, hysteresis } => (2, a.0, b.0, 0, hysteresis, 0),
            Self::Inside { a, low, high } => (3, a.0, 0, 0, low, high),
            Self::Outside { a, low, high } => (4, a.0, 0, 0, low, high),
            Self::Gate { a, open, otherwise } => (5, a.0, open.0, 0, otherwise, 0),
            Self::Sum { a, b } => (6, a.0, b.0, 0, 0, 0),
            Self::Difference { a, b } => (7, a.0, b.0, 0, 0, 0),
            Self::Product { a, b, shift } => (8, a.0, b.0, shift, 0, 0),
            Self::And { a, b } => (9, a.0, b.0, 0, 0, 0),
            Self::Or { a, b } => (10, a.0, b.0, 0, 0, 0),
            Self::ExclusiveOr { a, b } => (11, a.0, b.0, 0, 0, 0),
            Self::Not { a } => (12, a.0, 0, 0, 0, 0),
            Self::Rising { a } => (13, a.0, 0, 0, 0, 0),
            Self::Falling { a } => (14, a.0, 0, 0, 0, 0),
            Self::Edge { a } => (15, a.0, 0, 0, 0, 0),
        }
    }

    /// Whether it makes sense in itself.
    pub(super) const fn check(&self) -> Result<(), NodeError> {
        match *self {
            Self::Inside { low, high, .. } | Self::Outside { low, high, .. } if low > high => {
                Err(NodeError::EmptyWindow { low, high })
            }
            Self::Above { hysteresis, .. } | Self::Greater { hysteresis, .. } if hysteresis < 0 => {
                Err(NodeError::NegativeHysteresis { hysteresis })
            }
            Self::Product { shift, .. } if shift > SHIFT_MAX => Err(NodeError::ShiftTooLarge { shift }),
            _ => Ok(()),
        }
    }

    /// What it reads.
    pub(super) const fn sources(&self) -> [Option<Source>; 2] {
        match *self {
            Self::Constant { .. } => [None, None],
            Self::Above { a, .. }
            | Self::Inside { a, .. }
            | Self::Outside { a, .. }
            | Self::Not { a }
            | Self::Rising { a }
            | Self::Falling { a }
            | Self::Edge { a } => [Some(a), None],
            Self::Gate { a, open, .. } => [Some(a), Some(open)],
            Self::Greater { a, b, .. }
            | Self::Sum { a, b }
            | Self::Difference { a, b }
            | Self::Product { a, b, .. }
            | Self::And { a, b }
            | Self::Or { a, b }
            | Self::ExclusiveOr { a, b } => [Some(a), Some(b)],
        }
    }
}

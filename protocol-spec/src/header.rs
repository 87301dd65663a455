//! The packet header: a checked view over received bytes, and how a forwarding step or a reply rewrites it in place.
//!
//! - **Walk:** `framing` hands over a whole packet → *this module* says whether it can be routed → the node's `route` decides.
//! - **Invariant:** while a [`Packet`] exists, its pointer names a whole instruction inside it, and a port instruction is followed by
//!   its transport key.
//! - **Context:** routing task. Every call is O(1) but [`Packet::turn_back`], which is O(route); none allocates or panics on any input.
//! - **Clauses:** `[PKT-01]` layout, `[PKT-02]` pointer, `[PKT-03]` instructions, `[PKT-05]` transport key, `[PKT-07]` forwarding,
//!   `[PKT-09]` reversal.
//!
//! ```
//! use osap_protocol::{header::Arrival, GatewayIndex, Instruction, Packet};
//!
//! // pointer 5, 1000 µs to live, MTU 64, link(1), port(3 → 0), datagram, one byte of payload
//! let mut bytes = [5, 0xe8, 0x03, 64, 0, 0b01_000001, 0b11_000000, 0b00011_000, 0b0000_0000, 0, 0x2a];
//! let mut packet = Packet::check(&mut bytes[..])?;
//! assert_eq!(packet.instruction(), Instruction::Link(GatewayIndex::new(1).unwrap()));
//!
//! packet.advance(Arrival::Link(GatewayIndex::new(4).unwrap()))?; // it came in on our link 4
//! assert_eq!(bytes[5], 0b01_000100); // the way back now stands where the way out was
//! # Ok::<(), osap_protocol::HeaderError>(())
//! ```

use crate::address::{BusDrop, GatewayIndex, PortIndex};
use crate::drops::DropCause;
use crate::route::{Route, Step};

/// Byte offsets of the fixed header, `[PKT-01]`.
mod field {
    use core::ops::Range;
    pub(super) const POINTER: usize = 0;
    pub(super) const TTL_US: Range<usize> = 1..3;
    pub(super) const MTU_BYTES: Range<usize> = 3..5;
    pub(super) const ROUTE: usize = 5;
}

/// Offset of a route's first byte.
pub const ROUTE_OFFSET: usize = field::ROUTE;
/// Bytes of a header around its forwarding steps where it ends at a port: 5 before, 3 for the port, 1 transport key.
pub const PORT_HEADER_BYTES: usize = field::ROUTE + 3 + 1;
/// Bytes of a header around its forwarding steps where it ends in a system message.
pub const SYSTEM_HEADER_BYTES: usize = field::ROUTE + 1;

/// One step of a source route, `[PKT-03]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Instruction {
    /// Handled by the node itself; six-bit message key.
    System(u8),
    /// Send out on a point-to-point link.
    Link(GatewayIndex),
    /// Send to one drop of a bus, 255 for all of them.
    Bus {
        /// Bus gateway.
        gateway: GatewayIndex,
        /// Address on the bus.
        drop: BusDrop,
    },
    /// Deliver to a port of this node.
    Port {
        /// Port that sent the packet, in the sender's node.
        source: PortIndex,
        /// Port that shall receive it, in this node.
        destination: PortIndex,
    },
}

const OPCODE_SYSTEM: u8 = 0b00 << 6;
const OPCODE_LINK: u8 = 0b01 << 6;
const OPCODE_BUS: u8 = 0b10 << 6;
const OPCODE_PORT: u32 = 0b11 << 22;
/// System message keys: six bits.
pub const SYSTEM_KEY_MAX: u8 = 0x3f;

impl Instruction {
    /// Bytes an instruction takes, told by the top two bits of its first byte.
    #[must_use]
    #[inline]
    pub const fn width(first: u8) -> usize {
        match first >> 6 {
            0 | 1 => 1,
            2 => 2,
            _ => 3,
        }
    }

    /// Reads the instruction at the start of `bytes`; `None` where it is cut short.
    #[must_use]
    #[inline]
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let first = *bytes.first()?;
        Some(match first >> 6 {
            0 => Self::System(first & SYSTEM_KEY_MAX),
            1 => Self::Link(GatewayIndex::from_low_bits(first)),
            2 => Self::Bus { gateway: GatewayIndex::from_low_bits(first), drop: BusDrop(*bytes.get(1)?) },
            _ => {
                // 11 ssssss | sssss ddd | dddddddd: eleven bits each, most significant first
                let bits = u32::from_be_bytes([0, first, *bytes.get(1)?, *bytes.get(2)?]);
                Self::Port { source: PortIndex::from_low_bits(bits >> 11), destination: PortIndex::from_low_bits(bits) }
            }
        })
    }

    /// Writes the instruction into the first bytes of `out` and returns how many; a system key is cut to six bits.
    #[inline]
    pub fn encode(self, out: &mut [u8; 3]) -> usize {
        match self {
            Self::System(key) => out[0] = OPCODE_SYSTEM | (key & SYSTEM_KEY_MAX),
            Self::Link(gateway) => out[0] = OPCODE_LINK | gateway.get(),
            Self::Bus { gateway, drop } => {
                out[0] = OPCODE_BUS | gateway.get();
                out[1] = drop.0;
            }
            Self::Port { source, destination } => {
                let bits = OPCODE_PORT | u32::from(source.get()) << 11 | u32::from(destination.get());
                out.copy_from_slice(&bits.to_be_bytes()[1..]);
            }
        }
        Self::width(out[0])
    }
}

/// Why bytes are not a routable packet. Each is also a [`DropCause`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeaderError {
    /// Fewer bytes than a header with one instruction needs.
    Short {
        /// Bytes received.
        len: usize,
    },
    /// The pointer names a byte before the route or past the packet.
    PointerOutside {
        /// The pointer as received.
        pointer: u8,
        /// Bytes received.
        len: usize,
    },
    /// The instruction at the pointer runs past the packet's end.
    InstructionCut {
        /// The pointer as received.
        pointer: u8,
        /// Bytes the instruction needs.
        need: usize,
        /// Bytes that are left.
        left: usize,
    },
    /// The packet ends where its transport key should be.
    TransportMissing {
        /// Bytes received.
        len: usize,
    },
    /// The instruction at the pointer is not one that leads over the kind of gateway the packet came by.
    NotForwarding {
        /// The instruction found.
        found: Instruction,
    },
}

impl From<HeaderError> for DropCause {
    fn from(error: HeaderError) -> Self {
        match error {
            HeaderError::Short { .. } => Self::Short,
            HeaderError::PointerOutside { .. } => Self::PointerOutside,
            HeaderError::InstructionCut { .. } => Self::InstructionCut,
            HeaderError::TransportMissing { .. } => Self::TransportMissing,
            HeaderError::NotForwarding { .. } => Self::NotForwarding,
        }
    }
}

impl core::fmt::Display for HeaderError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Short { len } => write!(f, "{len} bytes; a header with one instruction has at least 6"),
            Self::PointerOutside { pointer, len } => {
                write!(
                    f,
                    "the pointer is {pointer}; the route of this packet lies in bytes 5 to {}",
                    len.saturating_sub(1)
                )
            }
            Self::InstructionCut { pointer, need, left } => {
                write!(f, "the instruction at byte {pointer} needs {need} bytes, {left} are left")
            }
            Self::TransportMissing { len } => {
                write!(f, "the packet ends after its port instruction, at {len} bytes; a transport key belongs there")
            }
            Self::NotForwarding { found } => write!(f, "the pointer is on {found:?}, which leads over no such gateway"),
        }
    }
}

impl core::error::Error for HeaderError {}

/// What a packet came in by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// Our gateway to a point-to-point link.
    Link(GatewayIndex),
    /// Our gateway to a bus.
    Bus {
        /// The gateway.
        gateway: GatewayIndex,
        /// The drop that sent it.
        from: BusDrop,
    },
}

impl Arrival {
    /// Our gateway.
    #[must_use]
    pub const fn gateway(self) -> GatewayIndex {
        match self {
            Self::Link(gateway) | Self::Bus { gateway, .. } => gateway,
        }
    }
}

/// How a route ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Terminal {
    /// At a port.
    Port {
        /// The sender's port.
        source: PortIndex,
        /// The receiver's port.
        destination: PortIndex,
        /// Transport key that follows, `[PKT-05]`.
        transport: u8,
    },
    /// In the node itself.
    System {
        /// Message key, 0 to 63.
        key: u8,
    },
}

/// A packet whose header was checked.
#[derive(Debug)]
pub struct Packet<B> {
    bytes: B,
}

impl<B: AsRef<[u8]>> Packet<B> {
    /// Checks the header once, so that the accessors below need no result.
    ///
    /// # Errors
    /// Any [`HeaderError`] but `NotForwarding`.
    #[inline]
    pub fn check(bytes: B) -> Result<Self, HeaderError> {
        let raw = bytes.as_ref();
        let len = raw.len();
        if len <= field::ROUTE {
            return Err(HeaderError::Short { len });
        }
        check_pointer(raw, raw[field::POINTER])?;
        Ok(Self { bytes })
    }

    /// All bytes of the packet.
    pub fn bytes(&self) -> &[u8] {
        self.bytes.as_ref()
    }

    /// Offset of the instruction to be carried out here.
    #[inline]
    pub fn pointer(&self) -> u8 {
        self.bytes()[field::POINTER]
    }

    /// Time left when the sender let go of the packet, µs.
    #[inline]
    pub fn ttl_us(&self) -> u16 {
        u16_at(self.bytes(), field::TTL_US.start)
    }

    /// Smallest packet size of the links on the route, bytes.
    #[inline]
    pub fn mtu_bytes(&self) -> u16 {
        u16_at(self.bytes(), field::MTU_BYTES.start)
    }

    /// The instruction to be carried out here.
    #[inline]
    pub fn instruction(&self) -> Instruction {
        let at = usize::from(self.pointer());
        // whole by the invariant; an unreachable `None` reads as a message nobody serves
        Instruction::decode(&self.bytes()[at..]).unwrap_or(Instruction::System(SYSTEM_KEY_MAX))
    }

    /// Offset of what follows the instruction at the pointer: the transport key of a port, the payload of a system message.
    #[inline]
    pub fn after_instruction(&self) -> usize {
        let at = usize::from(self.pointer());
        at + Instruction::width(self.bytes()[at])
    }

    /// Transport key and payload of a packet whose pointer is on a port instruction.
    pub fn transport(&self) -> Option<(u8, &[u8])> {
        match self.instruction() {
            Instruction::Port { .. } => {
                self.bytes()[self.after_instruction()..].split_first().map(|(key, rest)| (*key, rest))
            }
            _ => None,
        }
    }

    /// The steps already taken; after [`Packet::turn_back`], none.
    #[inline]
    pub fn taken(&self) -> &[u8] {
        self.bytes().get(field::ROUTE..usize::from(self.pointer())).unwrap_or_default()
    }
}

impl<B: AsRef<[u8]> + AsMut<[u8]>> Packet<B> {
    /// Writes the time left, µs.
    #[inline]
    pub fn set_ttl_us(&mut self, ttl_us: u16) {
        self.bytes.as_mut()[field::TTL_US].copy_from_slice(&ttl_us.to_le_bytes());
    }

    /// Takes one forwarding step at the receiver: the instruction just used becomes one of the way back, and the pointer moves past
    /// it, `[PKT-07]`, `[PKT-08]`. Nothing is changed where it fails.
    ///
    /// # Errors
    /// `NotForwarding` where the pointer is not on an instruction for this kind of gateway; otherwise as [`Packet::check`] for the
    /// next step.
    pub fn advance(&mut self, arrival: Arrival) -> Result<(), HeaderError> {
        let back = match (self.instruction(), arrival) {
            (Instruction::Link(_), Arrival::Link(gateway)) => Instruction::Link(gateway),
            (Instruction::Bus { .. }, Arrival::Bus { gateway, from }) => Instruction::Bus { gateway, drop: from },
            (found, _) => return Err(HeaderError::NotForwarding { found }),
        };
        let at = usize::from(self.pointer());
        let mut encoded = [0; 3];
        let width = back.encode(&mut encoded);
        let Ok(next) = u8::try_from(at + width) else {
            return Err(HeaderError::PointerOutside { pointer: u8::MAX, len: self.bytes().len() });
        };
        check_pointer(self.bytes(), next)?;
        let bytes = self.bytes.as_mut();
        bytes[at..at + width].copy_from_slice(&encoded[..width]);
        bytes[field::POINTER] = next;
        Ok(())
    }

    /// Turns a packet that arrived at a port into one that goes back the way it came, `[PKT-09]`: same length, steps in reverse
    /// order, ports swapped, pointer on the first step. Returns the offset of the transport key, or `None`, with nothing changed,
    /// where the pointer is on no port instruction or the steps before it are not whole.
    pub fn turn_back(&mut self) -> Option<usize> {
        let Instruction::Port { source, destination } = self.instruction() else { return None };
        let end = usize::from(self.pointer());
        Route::check(self.taken()).ok()?;
        let bytes = self.bytes.as_mut();
        let steps = &mut bytes[field::ROUTE..end];
        // each two-byte step is turned around first, so that turning the whole leaves it the right way round
        let mut at = 0;
        while at < steps.len() {
            let width = Instruction::width(steps[at]);
            steps[at..at + width].reverse();
            at += width;
        }
        steps.reverse();
        let mut port = [0; 3];
        Instruction::Port { source: destination, destination: source }.encode(&mut port);
        bytes[end..end + 3].copy_from_slice(&port);
        #[expect(clippy::cast_possible_truncation, reason = "5 fits")]
        let start = field::ROUTE as u8;
        bytes[field::POINTER] = start;
        Some(end + 3)
    }
}

/// The header did not fit, or a TTL of zero was asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BufferTooSmall {
    /// Bytes needed.
    pub need: usize,
    /// Bytes there are.
    pub have: usize,
}

/// Writes a header into the start of `out` and returns where the payload begins.
///
/// # Errors
/// [`BufferTooSmall`] with both lengths.
pub fn emit(
    out: &mut [u8],
    ttl_us: u16,
    mtu_bytes: u16,
    route: Route<'_>,
    terminal: Terminal,
) -> Result<usize, BufferTooSmall> {
    let steps = route.bytes();
    let need = steps.len()
        + match terminal {
            Terminal::Port { .. } => PORT_HEADER_BYTES,
            Terminal::System { .. } => SYSTEM_HEADER_BYTES,
        };
    if out.len() < need {
        return Err(BufferTooSmall { need, have: out.len() });
    }
    #[expect(clippy::cast_possible_truncation, reason = "5 fits")]
    let pointer = field::ROUTE as u8;
    out[field::POINTER] = pointer;
    out[field::TTL_US].copy_from_slice(&ttl_us.to_le_bytes());
    out[field::MTU_BYTES].copy_from_slice(&mtu_bytes.to_le_bytes());
    let end = field::ROUTE + steps.len();
    out[field::ROUTE..end].copy_from_slice(steps);
    let mut encoded = [0; 3];
    match terminal {
        Terminal::Port { source, destination, transport } => {
            Instruction::Port { source, destination }.encode(&mut encoded);
            out[end..end + 3].copy_from_slice(&encoded);
            out[end + 3] = transport;
        }
        Terminal::System { key } => {
            Instruction::System(key).encode(&mut encoded);
            out[end] = encoded[0];
        }
    }
    Ok(need)
}

/// The steps that lead back from where `taken` steps led: reverse order, each as its receiver rewrote it.
pub fn way_back(taken: Route<'_>) -> impl Iterator<Item = Step> {
    let count = taken.steps().count();
    (0..count).rev().filter_map(move |n| taken.steps().nth(n))
}

/// `[PKT-02]`, `[PKT-05]`: a pointer is good where a whole instruction stands, with the transport key after it if it is a port.
fn check_pointer(bytes: &[u8], pointer: u8) -> Result<(), HeaderError> {
    let (at, len) = (usize::from(pointer), bytes.len());
    if at < field::ROUTE || at >= len {
        return Err(HeaderError::PointerOutside { pointer, len });
    }
    let (need, left) = (Instruction::width(bytes[at]), len - at);
    if need > left {
        return Err(HeaderError::InstructionCut { pointer, need, left });
    }
    if need == 3 && left == 3 {
        return Err(HeaderError::TransportMissing { len });
    }
    Ok(())
}

fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn gateway(index: u8) -> GatewayIndex {
        GatewayIndex::new(index).unwrap()
    }

    /// `[PKT-03]`, worked by hand: `port(3 → 0)` is `11 000000 | 00011 000 | 00000000`. The destination was once shifted wrongly.
    #[test]
    fn a_port_instruction_carries_two_eleven_bit_indices() {
        for (source, destination, encoded) in [
            (3, 0, [0xc0, 0x18, 0x00]),
            (0, 3, [0xc0, 0x00, 0x03]),
            (1024, 2047, [0xe0, 0x07, 0xff]),
            (2047, 256, [0xff, 0xf9, 0x00]),
        ] {
            let port = Instruction::Port {
                source: PortIndex::new(source).unwrap(),
                destination: PortIndex::new(destination).unwrap(),
            };
            let mut out = [0; 3];
            assert_eq!((port.encode(&mut out), out), (3, encoded));
            assert_eq!(Instruction::decode(&encoded), Some(port));
        }
    }

    /// `[PKT-02]`: an instruction cut off by the end names what was missing.
    #[test]
    fn a_port_instruction_cut_short_is_refused() {
        assert_eq!(
            Packet::check(&[5, 0, 0, 0, 0, 0xc0, 0][..]).unwrap_err(),
            HeaderError::InstructionCut { pointer: 5, need: 3, left: 2 }
        );
    }

    /// `[PKT-05]`
    #[test]
    fn a_packet_that_ends_before_its_transport_key_is_refused() {
        assert_eq!(
            Packet::check(&[5, 0, 0, 0, 0, 0xc0, 0, 0][..]).unwrap_err(),
            HeaderError::TransportMissing { len: 8 }
        );
    }

    /// `[PKT-02]`: a pointer into the fixed header would let a forwarding step overwrite TTL or MTU.
    #[test]
    fn a_pointer_into_the_fixed_header_is_refused() {
        for pointer in 0..5 {
            let bytes = [pointer, 0x41, 0x41, 0x41, 0x41, 0x41, 0x42, 0x00];
            assert_eq!(Packet::check(&bytes[..]).unwrap_err(), HeaderError::PointerOutside { pointer, len: 8 });
        }
    }

    /// `[PKT-09]`: a bus step stays a bus step on the way back; an earlier implementation wrote a link key there.
    #[test]
    fn a_bus_step_comes_back_as_a_bus_step() {
        let mut bytes = [8, 0, 1, 64, 0, 0x42, 0x85, 7, 0xc0, 0x18, 0x00, 0, 9];
        let mut packet = Packet::check(&mut bytes[..]).unwrap();
        assert_eq!(packet.turn_back(), Some(11));
        assert_eq!(bytes, [5, 0, 1, 64, 0, 0x85, 7, 0x42, 0xc0, 0x00, 0x03, 0, 9]);
    }

    /// `[PKT-08]`: a bus instruction that came over a link leads nowhere.
    #[test]
    fn the_instruction_must_match_the_gateway() {
        let mut bytes = [5, 0, 1, 64, 0, 0x82, 7, 0x02, 1];
        let mut packet = Packet::check(&mut bytes[..]).unwrap();
        let found = Instruction::Bus { gateway: gateway(2), drop: BusDrop(7) };
        assert_eq!(packet.advance(Arrival::Link(gateway(0))), Err(HeaderError::NotForwarding { found }));
        packet.advance(Arrival::Bus { gateway: gateway(9), from: BusDrop(3) }).unwrap();
        assert_eq!(bytes, [7, 0, 1, 64, 0, 0x89, 3, 0x02, 1]);
    }

    fn any_step() -> impl Strategy<Value = (Step, Arrival)> {
        (0u8..64, 0u8..64, any::<Option<(u8, u8)>>()).prop_map(|(out, ours, bus)| match bus {
            None => (Step::Link(gateway(out)), Arrival::Link(gateway(ours))),
            Some((to, from)) => (
                Step::Bus { gateway: gateway(out), drop: BusDrop(to) },
                Arrival::Bus { gateway: gateway(ours), from: BusDrop(from) },
            ),
        })
    }

    proptest! {
        /// `[PKT-07]`: whatever the bytes, a refused step leaves them as they were, a taken one rewrites one instruction.
        #[test]
        fn advance_is_all_or_nothing(mut bytes in proptest::collection::vec(any::<u8>(), 0..40), link in 0..GatewayIndex::COUNT) {
            let before = bytes.clone();
            let taken = Packet::check(&mut bytes[..]).and_then(|mut p| p.advance(Arrival::Link(gateway(link))));
            if taken.is_ok() {
                let at = usize::from(before[0]);
                let mut expected = before;
                expected[0] += 1;
                expected[at] = 0x40 | link;
                prop_assert_eq!(bytes, expected);
            } else {
                prop_assert_eq!(bytes, before);
            }
        }

        /// `[PKT-09]`: there and back again, over any mix of links and buses, the reply retraces the arrivals in reverse.
        #[test]
        fn a_reply_retraces_its_route(steps in proptest::collection::vec(any_step(), 0..60), source in 0u16..2048, destination in 0u16..2048) {
            let (source, destination) = (PortIndex::new(source).unwrap(), PortIndex::new(destination).unwrap());
            let mut route = crate::RouteBuf::new();
            for (step, _) in &steps {
                route.push(*step).unwrap();
            }
            let mut bytes = std::vec![0; 400];
            let end = emit(&mut bytes, 1000, 400, route.as_route(), Terminal::Port { source, destination, transport: 0 }).unwrap();
            bytes.truncate(end);
            let mut packet = Packet::check(&mut bytes[..]).unwrap();
            for (_, arrival) in &steps {
                packet.advance(*arrival).unwrap();
            }
            let back: Vec<Step> = way_back(Route::check(packet.taken()).unwrap()).collect();
            let expected: Vec<Step> = steps.iter().rev().map(|(_, arrival)| match *arrival {
                Arrival::Link(ours) => Step::Link(ours),
                Arrival::Bus { gateway, from } => Step::Bus { gateway, drop: from },
            }).collect();
            prop_assert_eq!(&back, &expected);
            prop_assert_eq!(packet.turn_back(), Some(end - 1));
            prop_assert_eq!((packet.pointer(), packet.ttl_us(), packet.mtu_bytes()), (5, 1000, 400));
            for step in expected {
                prop_assert_eq!(packet.instruction(), step.instruction());
                let arrival = match step {
                    Step::Link(_) => Arrival::Link(gateway(0)),
                    Step::Bus { .. } => Arrival::Bus { gateway: gateway(0), from: BusDrop(0) },
                };
                packet.advance(arrival).unwrap();
            }
            prop_assert_eq!(packet.instruction(), Instruction::Port { source: destination, destination: source });
        }

        /// No bytes make any accessor panic, and turning back never changes a length.
        #[test]
        fn no_bytes_panic(mut bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            if let Ok(mut packet) = Packet::check(&mut bytes[..]) {
                let _ = (packet.instruction(), packet.transport(), packet.taken().len(), packet.after_instruction());
                let _ = packet.turn_back();
                let _ = (packet.instruction(), packet.transport());
            }
        }
    }
}

//! Questions to port 0 of every node, and their answers.
//!
//! - **Walk:** a scanner's sequenced request → the node's netresponder → the same packet, turned back.
//! - **Invariant:** a body is `postcard` behind `key u8, version u8`; every name, list and number has a bound here.
//! - **Context:** the node answers in its routing context, in bounded time and memory.
//! - **Clauses:** `[DSC-01]` to `[DSC-07]`.
//!
//! ```
//! use osap_protocol::discovery::{decode, encode, Query, ScanId, Message};
//!
//! let mut bytes = [0; 16];
//! let len = encode(Query::RuntimeInfo.key(), &ScanId { scan: 7, visit: 1 }, &mut bytes)?;
//! let Message { key, body } = decode(&bytes[..len])?;
//! assert_eq!(Query::from_key(key)?, Query::RuntimeInfo);
//! assert_eq!(body.read::<ScanId>()?, ScanId { scan: 7, visit: 1 });
//! # Ok::<(), osap_protocol::discovery::Refusal>(())
//! ```

mod clock;

pub use clock::{
    KEPT_LINKS_MAX, KeptLink, KeptTime, ServoKind, TIER_FREE_RUNNING, TimeAsymmetry, TimeControl, TimeLink,
    TimeSettings, TimeStatus,
};

use crate::drops::DropCause;
use crate::framing::Check;
use serde::{Deserialize, Serialize};

/// Version of the bodies below; another one is refused, `[DSC-02]`.
pub const VERSION: u8 = 1;
/// Longest name of a node or port, bytes of UTF-8, `[DSC-05]`.
pub const NAME_BYTES_MAX: usize = 32;
/// Longest line of text in a debug event, bytes of UTF-8.
pub const TEXT_BYTES_MAX: usize = 40;
/// Counters in one page, `[DSC-06]`.
pub const COUNTERS_A_PAGE: usize = 16;
/// Debug events in one page, `[DSC-06]`.
pub const EVENTS_A_PAGE: usize = 4;
/// Longest body of any answer here, bytes: a page of events, each all text.
pub const BODY_BYTES_MAX: usize = 256;

/// A node's or port's name.
pub type Name = heapless::String<NAME_BYTES_MAX>;
/// A line of text in a debug event.
pub type Text = heapless::String<TEXT_BYTES_MAX>;

/// The queries, `[DSC-01]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Query {
    /// [`ScanId`] → [`RuntimeInfo`].
    RuntimeInfo = 1,
    /// Nothing → [`Name`].
    TypeName = 2,
    /// Nothing → [`Name`].
    RuntimeName = 3,
    /// [`Name`] → nothing.
    SetRuntimeName = 4,
    /// `u8` gateway → [`LinkInfo`].
    LinkInfo = 5,
    /// `u16` port → [`PortInfo`].
    PortInfo = 6,
    /// `u32` cursor → [`DebugPage`].
    DebugMessages = 7,
    /// [`Verbosity`] → nothing.
    SetDebugVerbosity = 8,
    /// Nothing → [`TimeControl`].
    TimeControl = 9,
    /// [`TimeSettings`] → nothing.
    SetTimeControl = 10,
    /// `u8` first index → [`CounterPage`].
    Counters = 11,
    /// Nothing → [`TimeStatus`].
    TimeStatus = 12,
    /// `u8` gateway → [`TimeLink`].
    TimeLink = 13,
    /// [`TimeAsymmetry`] → nothing.
    SetTimeAsymmetry = 14,
}

impl Query {
    /// All of them, in the order of their keys.
    pub const ALL: [Self; 14] = [
        Self::RuntimeInfo,
        Self::TypeName,
        Self::RuntimeName,
        Self::SetRuntimeName,
        Self::LinkInfo,
        Self::PortInfo,
        Self::DebugMessages,
        Self::SetDebugVerbosity,
        Self::TimeControl,
        Self::SetTimeControl,
        Self::Counters,
        Self::TimeStatus,
        Self::TimeLink,
        Self::SetTimeAsymmetry,
    ];

    /// The byte that stands for it.
    #[must_use]
    pub const fn key(self) -> u8 {
        self as u8
    }

    /// The query of a key.
    ///
    /// # Errors
    /// [`Refusal::UnknownKey`].
    pub fn from_key(key: u8) -> Result<Self, Refusal> {
        Self::ALL.get(usize::from(key).wrapping_sub(1)).copied().ok_or(Refusal::UnknownKey)
    }

    /// Its name, for people.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::RuntimeInfo => "runtime information",
            Self::TypeName => "runtime type name",
            Self::RuntimeName => "runtime name",
            Self::SetRuntimeName => "set runtime name",
            Self::LinkInfo => "link information",
            Self::PortInfo => "port information",
            Self::DebugMessages => "debug messages",
            Self::SetDebugVerbosity => "set debug verbosity",
            Self::TimeControl => "time controller configuration",
            Self::SetTimeControl => "set time controller configuration",
            Self::Counters => "counters",
            Self::TimeStatus => "time status",
            Self::TimeLink => "time of a link",
            Self::SetTimeAsymmetry => "set time asymmetry",
        }
    }
}

/// Why a query was not answered, `[DSC-02]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Refusal {
    /// No query has this key.
    UnknownKey = 1,
    /// The body is of a version that is not served.
    Version = 2,
    /// The body does not decode.
    Body = 3,
    /// There is no gateway or port of this index.
    Index = 4,
    /// A value is outside its range.
    Range = 5,
    /// The answer does not fit the route's MTU.
    TooLong = 6,
}

impl Refusal {
    /// The byte that stands for it.
    #[must_use]
    pub const fn code(self) -> u8 {
        self as u8
    }

    /// The refusal of a byte, where this version knows it.
    #[must_use]
    pub const fn from_code(code: u8) -> Option<Self> {
        Some(match code {
            1 => Self::UnknownKey,
            2 => Self::Version,
            3 => Self::Body,
            4 => Self::Index,
            5 => Self::Range,
            6 => Self::TooLong,
            _ => return None,
        })
    }

    /// What it says, for people.
    #[must_use]
    pub const fn meaning(self) -> &'static str {
        match self {
            Self::UnknownKey => "the device does not know this query",
            Self::Version => "the device speaks another version of this query",
            Self::Body => "the device could not read the query's body",
            Self::Index => "the device has no gateway or port of this index",
            Self::Range => "a value is outside its range",
            Self::TooLong => "the answer does not fit the route's packet size",
        }
    }
}

impl core::fmt::Display for Refusal {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.meaning())
    }
}

impl core::error::Error for Refusal {}

/// A message's key and its body, not yet read.
#[derive(Clone, Copy, Debug)]
pub struct Message<'a> {
    /// Key as received.
    pub key: u8,
    /// The rest.
    pub body: Body<'a>,
}

/// Bytes behind key and version.
#[derive(Clone, Copy, Debug)]
pub struct Body<'a>(&'a [u8]);

impl<'a> Body<'a> {
    /// Reads the body as `T`; bytes left over are a fault.
    ///
    /// # Errors
    /// [`Refusal::Body`].
    pub fn read<T: Deserialize<'a>>(self) -> Result<T, Refusal> {
        match postcard::take_from_bytes(self.0) {
            Ok((value, [])) => Ok(value),
            _ => Err(Refusal::Body),
        }
    }
}

/// Writes key, version and `body` into `out`; returns the length.
///
/// # Errors
/// [`Refusal::TooLong`] where it does not fit.
pub fn encode<T: Serialize>(key: u8, body: &T, out: &mut [u8]) -> Result<usize, Refusal> {
    let (head, rest) = out.split_first_chunk_mut::<2>().ok_or(Refusal::TooLong)?;
    *head = [key, VERSION];
    let len = postcard::to_slice(body, rest).map_err(|_| Refusal::TooLong)?.len();
    Ok(2 + len)
}

/// Reads key and version.
///
/// # Errors
/// [`Refusal::Body`] where they are missing, [`Refusal::Version`] where the version is another.
pub fn decode(bytes: &[u8]) -> Result<Message<'_>, Refusal> {
    match bytes {
        [key, VERSION, body @ ..] => Ok(Message { key: *key, body: Body(body) }),
        [_, _, ..] => Err(Refusal::Version),
        _ => Err(Refusal::Body),
    }
}

/// A query without a key is no query at all.
///
/// # Errors
/// [`DropCause::QueryMalformed`] where there are not even key and version.
pub fn check_query(bytes: &[u8]) -> Result<u8, DropCause> {
    match bytes {
        [key, _, ..] => Ok(*key),
        _ => Err(DropCause::QueryMalformed),
    }
}

/// Names one visit of one scan, `[DSC-03]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ScanId {
    /// Drawn at random by the scanner for each scan.
    pub scan: u32,
    /// Counts the scan's visits, from 1.
    pub visit: u16,
}

/// A device's own number, from its silicon; the same after every boot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct UniqueId(pub [u8; 12]);

impl core::fmt::Display for UniqueId {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// What a node's runtime was built for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum BuildKind {
    /// Firmware on a microcontroller.
    Firmware,
    /// A process on a workstation.
    Host,
    /// A node of the simulator.
    Simulated,
}

/// Answer to [`Query::RuntimeInfo`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RuntimeInfo {
    /// The scan id of the visit before this one, `[DSC-03]`.
    pub previous: ScanId,
    /// Which device.
    pub unique_id: UniqueId,
    /// Another number after each boot.
    pub boot_epoch: u32,
    /// Version of the runtime: major, minor, patch.
    pub version: [u8; 3],
    /// What it was built for.
    pub build: BuildKind,
    /// Gateways, with indices below this.
    pub gateways: u8,
    /// Ports, with indices below this.
    pub ports: u16,
    /// Largest packet a slot holds, bytes.
    pub packet_bytes_max: u16,
    /// Slots in the pool.
    pub slots: u16,
    /// Goes up with every neighbour that appears, is lost, swapped or rebooted.
    pub topology_generation: u32,
    /// Time since boot, µs.
    pub uptime_us: u64,
}

/// What a gateway leads to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum GatewayKind {
    /// One neighbour.
    Link,
    /// A shared bus.
    Bus {
        /// This node's address on it, 0 to 254.
        drop: u8,
    },
}

/// Who announced itself on a gateway.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Neighbour {
    /// Which device.
    pub unique_id: UniqueId,
    /// Its boot.
    pub boot_epoch: u32,
    /// Its own index for the shared link.
    pub gateway: u8,
}

/// Answer to [`Query::LinkInfo`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkInfo {
    /// Kind of hardware, such as `uart` or `usb-cdc`.
    pub type_name: Name,
    /// Link or bus.
    pub kind: GatewayKind,
    /// Whether it can carry packets.
    pub open: bool,
    /// Largest packet, bytes.
    pub mtu_bytes: u16,
    /// Bits a second on the wire; 0 where unknown.
    pub bit_rate: u32,
    /// Bits each byte takes: 10 on a UART, 8 elsewhere.
    pub bits_a_byte: u8,
    /// Guard of its frames; `None` on links that carry datagrams.
    pub check: Check,
    /// On a point-to-point link, who announced itself last.
    pub neighbour: Option<Neighbour>,
    /// Packets it may hold at once.
    pub packet_hold_max: u8,
    /// Packets received and accepted.
    pub received: u32,
    /// Packets sent.
    pub sent: u32,
    /// Packets and frames dropped that came in here.
    pub dropped: u32,
}

/// Answer to [`Query::PortInfo`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PortInfo {
    /// What software the port leads to.
    pub type_name: Name,
    /// What it is called; often empty.
    pub name: Name,
    /// Packets it may hold at once.
    pub packet_hold_max: u8,
    /// Packets delivered to it.
    pub received: u32,
    /// Packets it sent, replies included.
    pub sent: u32,
}

/// How much a node writes into its debug ring.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Verbosity {
    /// Nothing.
    Silent,
    /// Drops.
    Drops,
    /// And what happens to gateways, neighbours and names, and the application's lines.
    Events,
    /// And each stage of each packet.
    Packets,
}

/// A change in who is at the other end of a gateway, `[SYS-04]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum NeighbourChange {
    /// There was none.
    Appeared,
    /// Another device is there now.
    Swapped,
    /// The same device, booted again.
    Rebooted,
    /// Nothing was heard for too long, or the gateway closed.
    Lost,
}

/// A stage of a packet's walk through one node, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Stage {
    /// Accepted by ingress: header valid, step rewritten.
    Ingress,
    /// Routed: its taker is known.
    Route,
    /// In its place in the deadline stack.
    Stack,
    /// Taken from the stack by a gateway that is clear to send.
    Egress,
    /// Taken from the stack by a port.
    Deliver,
    /// Turned back as a reply.
    Reply,
}

/// What a debug event tells.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Event {
    /// A packet or frame was dropped.
    Dropped {
        /// Why.
        cause: DropCause,
        /// The gateway it came in by, if any.
        gateway: Option<u8>,
    },
    /// A gateway opened or closed.
    Gateway {
        /// Which.
        gateway: u8,
        /// Whether it is open now.
        open: bool,
    },
    /// A neighbour changed.
    Neighbour {
        /// On which gateway.
        gateway: u8,
        /// How.
        change: NeighbourChange,
    },
    /// The node was given a new name.
    Renamed,
    /// A packet passed a stage.
    Stage {
        /// Which.
        stage: Stage,
        /// Gateway or port concerned.
        index: u16,
    },
    /// A line from the application.
    Text(Text),
    /// The node's clock changed whom it follows, or how well.
    Clock {
        /// How.
        change: ClockChange,
        /// Steps to its root now; 255 without one.
        tier: u8,
    },
}

/// A change of a node's clock, `[TIM-12]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ClockChange {
    /// It follows another root, or is one.
    Root,
    /// Its time was set anew, `[TIM-10]`.
    SetAnew,
    /// Nothing is heard of its root any more.
    RootLost,
    /// Programs may rely on it from now on.
    Settled,
}

impl ClockChange {
    /// What it says, for people.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Root => "another root",
            Self::SetAnew => "time set anew",
            Self::RootLost => "root lost",
            Self::Settled => "settled",
        }
    }
}

/// One entry of a node's debug ring.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DebugEvent {
    /// The node's own clock, µs.
    pub at_us: u64,
    /// What happened.
    pub event: Event,
}

/// Answer to [`Query::DebugMessages`]: the query's cursor is the number of the first event wanted, 0 for the oldest kept.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DebugPage {
    /// Number of the first event here.
    pub first: u32,
    /// Cursor for the next page; equal to `first` plus the number of events.
    pub next: u32,
    /// Number that the newest event will be followed by: nothing more to read once `next` is this.
    pub end: u32,
    /// What is written down at present.
    pub verbosity: Verbosity,
    /// System time against the node's own clock, where it is valid, `[TIM-15]`.
    pub clock: Option<ClockMark>,
    /// The events.
    pub events: heapless::Vec<DebugEvent, EVENTS_A_PAGE>,
}

/// One instant by two clocks, `[TIM-15]`: makes system time of stamps near it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClockMark {
    /// The node's own clock, 1/256 µs.
    pub local_steps: u64,
    /// System time at that instant, 1/256 µs.
    pub system_steps: u64,
    /// Of system time against the node's own clock, parts per 10⁹.
    pub rate_ppb: i32,
    /// Largest possible error of the system time, 1/256 µs.
    pub bound_steps: u32,
}

/// Answer to [`Query::Counters`], `[DSC-06]`: the counters of [`DropCause`], in order of their numbers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CounterPage {
    /// Index of the first counter here.
    pub first: u8,
    /// How many the node has.
    pub total: u8,
    /// Their values; they stop at `u32::MAX`.
    pub values: heapless::Vec<u32, COUNTERS_A_PAGE>,
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;

    /// `[DSC-07]`: 65 bytes with sequence, key and version, whatever the values.
    #[test]
    fn the_time_controllers_answer_has_fixed_width() {
        for value in [
            TimeControl::default(),
            TimeControl { system_time_steps: u64::MAX, skew_ppb: -1, tier: 255, ..Default::default() },
        ] {
            let mut out = [0; 80];
            let len = encode(Query::TimeControl.key(), &value, &mut out).unwrap();
            assert_eq!(crate::transport::SequencedHeader::LEN + len, 65);
            assert_eq!(decode(&out[..len]).unwrap().body.read::<TimeControl>(), Ok(value));
        }
    }

    /// `[DSC-02]`: bytes left over, bytes missing, other versions and unknown keys are refused.
    #[test]
    fn bad_messages_are_refused() {
        let mut out = [0; 16];
        let len = encode(1, &ScanId { scan: 300, visit: 2 }, &mut out).unwrap();
        assert_eq!(decode(&out[..=len]).unwrap().body.read::<ScanId>(), Err(Refusal::Body));
        assert_eq!(decode(&out[..len - 1]).unwrap().body.read::<ScanId>(), Err(Refusal::Body));
        out[1] = 2;
        assert_eq!(decode(&out[..len]).unwrap_err(), Refusal::Version);
        assert_eq!(Query::from_key(0), Err(Refusal::UnknownKey));
        assert_eq!(Query::from_key(15), Err(Refusal::UnknownKey));
        assert_eq!(check_query(&[1]), Err(DropCause::QueryMalformed));
    }

    /// The largest answers fit [`BODY_BYTES_MAX`].
    #[test]
    fn the_largest_answers_fit() {
        let text: Text = core::iter::repeat_n('x', TEXT_BYTES_MAX).collect();
        let name: Name = core::iter::repeat_n('x', NAME_BYTES_MAX).collect();
        let event = DebugEvent { at_us: u64::MAX, event: Event::Text(text) };
        let page = DebugPage {
            first: u32::MAX,
            next: u32::MAX,
            end: u32::MAX,
            verbosity: Verbosity::Packets,
            clock: Some(ClockMark {
                local_steps: u64::MAX,
                system_steps: u64::MAX,
                rate_ppb: i32::MIN,
                bound_steps: u32::MAX,
            }),
            events: core::iter::repeat_n(event, EVENTS_A_PAGE).collect(),
        };
        let neighbour = Neighbour { unique_id: UniqueId([255; 12]), boot_epoch: u32::MAX, gateway: 63 };
        let link = LinkInfo {
            type_name: name,
            kind: GatewayKind::Bus { drop: 254 },
            open: true,
            mtu_bytes: u16::MAX,
            bit_rate: u32::MAX,
            bits_a_byte: 10,
            check: Check::Crc32,
            neighbour: Some(neighbour),
            packet_hold_max: u8::MAX,
            received: u32::MAX,
            sent: u32::MAX,
            dropped: u32::MAX,
        };
        let counters =
            CounterPage { first: 255, total: 255, values: core::iter::repeat_n(u32::MAX, COUNTERS_A_PAGE).collect() };
        let mut out = [0; 2 + BODY_BYTES_MAX];
        encode(7, &page, &mut out).unwrap();
        encode(5, &link, &mut out).unwrap();
        encode(11, &counters, &mut out).unwrap();
    }
}

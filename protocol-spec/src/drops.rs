//! Every reason to discard a packet, under one name for code, counters, traces and people.
//!
//! - **Walk:** any stage may end here; the name tells which.
//! - **Invariant:** the numbers are wire format (query 11 and debug events): append, never reorder.
//! - **Clause:** `[NOD-09]`.
//!
//! ```
//! use osap_protocol::DropCause;
//! assert_eq!(DropCause::FrameCheck.name(), "frame-check");
//! assert_eq!(DropCause::from_index(3), Some(DropCause::FrameCheck));
//! ```

use serde::{Deserialize, Serialize};

macro_rules! drop_causes {
    ($($(#[doc = $doc:literal])* $variant:ident = $name:literal,)*) => {
        /// Why a packet or frame was discarded.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[repr(u8)]
        pub enum DropCause { $($(#[doc = $doc])* $variant,)* }

        impl DropCause {
            /// All of them, in the order of their numbers.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)*];
            /// How many there are.
            pub const COUNT: usize = Self::ALL.len();

            /// The name that counters, traces and the CLI show.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)* }
            }

            /// What happened, in a few words.
            #[must_use]
            pub const fn meaning(self) -> &'static str {
                match self { $(Self::$variant => concat!($($doc),*).trim_ascii_start(),)* }
            }
        }
    };
}

drop_causes! {
    /// The receiver's ring was full before anybody read it.
    RxOverrun = "rx-overrun",
    /// A frame's byte stuffing was wrong.
    FrameMalformed = "frame-malformed",
    /// A frame was shorter than its check.
    FrameTooShort = "frame-too-short",
    /// A frame's check did not match its bytes.
    FrameCheck = "frame-check",
    /// A frame did not fit the receiver's buffer.
    FrameTooLong = "frame-too-long",
    /// Fewer bytes than a header with one instruction.
    Short = "short",
    /// The pointer names a byte before the route or past the packet.
    PointerOutside = "pointer-outside",
    /// The instruction at the pointer runs past the packet's end.
    InstructionCut = "instruction-cut",
    /// The packet came in on a link or bus without the instruction that leads over one.
    NotForwarding = "not-forwarding",
    /// The route names a bus as a link or a link as a bus.
    WrongGatewayKind = "wrong-gateway-kind",
    /// The route names a gateway that this node does not have.
    NoSuchGateway = "no-such-gateway",
    /// The route names a gateway that is closed.
    GatewayClosed = "gateway-closed",
    /// The route names a port that this node does not have.
    NoSuchPort = "no-such-port",
    /// The packet ends before its transport key.
    TransportMissing = "transport-missing",
    /// The packet is longer than its MTU field or than the gateway it shall leave by.
    OverMtu = "over-mtu",
    /// The packet's time to live ran out.
    Expired = "expired",
    /// No slot was free in the pool.
    PoolFull = "pool-full",
    /// The gateway or port already held as many packets as it may.
    HoldFull = "hold-full",
    /// An earlier deadline of the same owner took this packet's slot.
    Displaced = "displaced",
    /// The transport key is none that is served.
    UnknownTransport = "unknown-transport",
    /// The transport's own header is cut short or contradicts itself.
    TransportMalformed = "transport-malformed",
    /// A reply that no request waits for.
    ReplyUnmatched = "reply-unmatched",
    /// A segment's index is not below its count, or the count changed.
    SegmentInvalid = "segment-invalid",
    /// A segment other than the one wanted next.
    SegmentOutOfOrder = "segment-out-of-order",
    /// The system message key is none that is served.
    UnknownSystemKey = "unknown-system-key",
    /// A system message that cannot be decoded.
    SystemMalformed = "system-malformed",
    /// A packet for the netresponder that is not a query.
    QueryMalformed = "query-malformed",
    /// The port's application did not want the packet.
    PortRefused = "port-refused",
    /// A sender asked for what cannot be sent.
    SendRefused = "send-refused",
    /// A peer beyond loopback did not have the key.
    PeerRefused = "peer-refused",
    /// A time reply that nobody asked for, or asked too long ago.
    TimeUnasked = "time-unasked",
    /// A time reply whose stamps are from the past or contradict each other.
    TimeOrder = "time-order",
    /// A time reply too far off from what is known.
    TimeAbsurd = "time-absurd",
    /// A time reply whose sender cannot have the tier or the root that it says.
    TimeTier = "time-tier",
}

impl DropCause {
    /// The number that stands for it on the wire.
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }

    /// The cause of a number, where this version knows it.
    #[must_use]
    pub fn from_index(index: usize) -> Option<Self> {
        Self::ALL.get(index).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_distinct_and_numbers_round_trip() {
        for (index, cause) in DropCause::ALL.iter().enumerate() {
            assert_eq!(DropCause::from_index(index), Some(*cause));
            assert_eq!(cause.index(), index);
            assert!(DropCause::ALL.iter().filter(|other| other.name() == cause.name()).count() == 1);
            assert!(!cause.meaning().is_empty());
        }
        assert_eq!(DropCause::from_index(DropCause::COUNT), None);
    }
}

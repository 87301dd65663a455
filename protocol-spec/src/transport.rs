//! The headers of the three transports.
//!
//! - **Walk:** after a port instruction: key, then one of these, then the port's own bytes.
//! - **Invariant:** fixed lengths; what is shorter is refused, never read past.
//! - **Clauses:** `[TRN-01]` keys, `[TRN-03]` sequenced, `[TRN-07]`, `[TRN-08]` segmented.

use crate::drops::DropCause;

/// Times a request or a window is repeated before it fails, `[TRN-05]`, `[TRN-10]`.
pub const RETRIES_MAX: u8 = 3;
/// Segments a sender may have unacknowledged, `[TRN-10]`.
pub const SEGMENT_WINDOW: u16 = 4;
/// Silence after which a half-received message makes way for another sender, µs, `[TRN-09]`.
pub const SEGMENT_IDLE_US: u64 = 500_000;

/// Which transport a packet's payload is in, `[TRN-01]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Transport {
    /// The payload as it is, `[TRN-02]`.
    Datagram = 0,
    /// Requests and their replies.
    Sequenced = 1,
    /// Messages over one MTU.
    Segmented = 2,
}

impl Transport {
    /// The transport of a key.
    ///
    /// # Errors
    /// [`DropCause::UnknownTransport`].
    pub const fn from_key(key: u8) -> Result<Self, DropCause> {
        match key {
            0 => Ok(Self::Datagram),
            1 => Ok(Self::Sequenced),
            2 => Ok(Self::Segmented),
            _ => Err(DropCause::UnknownTransport),
        }
    }

    /// The byte that stands for it.
    #[must_use]
    pub const fn key(self) -> u8 {
        self as u8
    }
}

/// Sequence number of a request: 0 to 16,383.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Sequence(u16);

impl Sequence {
    /// Fourteen bits of it.
    const MASK: u16 = (1 << 14) - 1;

    /// The number's low fourteen bits.
    #[must_use]
    pub const fn new(number: u16) -> Self {
        Self(number & Self::MASK)
    }

    /// The number.
    #[must_use]
    pub const fn get(self) -> u16 {
        self.0
    }

    /// The next one; after the last comes 0.
    #[must_use]
    pub const fn next(self) -> Self {
        Self::new(self.0 + 1)
    }
}

/// What a sequenced packet is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SequencedKind {
    /// Asks for a reply.
    Request,
    /// Answers a request.
    Reply,
    /// Answers a request with a reason not to.
    Refusal,
}

/// Header of the sequenced transport, `[TRN-03]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SequencedHeader {
    /// Request, reply or refusal.
    pub kind: SequencedKind,
    /// Number that a reply shares with its request.
    pub sequence: Sequence,
}

impl SequencedHeader {
    /// Bytes it takes.
    pub const LEN: usize = 2;

    /// Splits `bytes` into header and the rest.
    ///
    /// # Errors
    /// [`DropCause::TransportMalformed`] where it is cut short or of kind 3.
    pub fn parse(bytes: &[u8]) -> Result<(Self, &[u8]), DropCause> {
        let (head, rest) = bytes.split_first_chunk().ok_or(DropCause::TransportMalformed)?;
        let word = u16::from_le_bytes(*head);
        let kind = match word >> 14 {
            0 => SequencedKind::Request,
            1 => SequencedKind::Reply,
            2 => SequencedKind::Refusal,
            _ => return Err(DropCause::TransportMalformed),
        };
        Ok((Self { kind, sequence: Sequence::new(word) }, rest))
    }

    /// The header's bytes.
    #[must_use]
    pub const fn encode(self) -> [u8; Self::LEN] {
        let kind = match self.kind {
            SequencedKind::Request => 0,
            SequencedKind::Reply => 1,
            SequencedKind::Refusal => 2,
        };
        (kind << 14 | self.sequence.get()).to_le_bytes()
    }
}

/// Why a receiver will not take a message, `[TRN-07]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SegmentRefusal {
    /// It is receiving another one.
    Busy,
    /// The message would not fit its buffer.
    TooLong,
}

/// Header of the segmented transport, `[TRN-07]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SegmentHeader {
    /// One segment.
    Data {
        /// Number of the message.
        message: u8,
        /// Which segment, below `count`.
        index: u16,
        /// How many there are, at least 1.
        count: u16,
    },
    /// All segments below `next` have come.
    Acknowledge {
        /// Number of the message.
        message: u8,
        /// The segment wanted next.
        next: u16,
    },
    /// The message is not taken.
    Refuse {
        /// Number of the message.
        message: u8,
        /// Why.
        reason: SegmentRefusal,
    },
}

impl SegmentHeader {
    /// Most bytes one takes.
    pub const LEN_MAX: usize = 6;
    /// Bytes before a segment.
    pub const DATA_LEN: usize = 6;

    /// Splits `bytes` into header and the rest.
    ///
    /// # Errors
    /// `TransportMalformed` where it is cut short or of an unknown control or reason; `SegmentInvalid` where the index is not below
    /// the count, `[TRN-08]`.
    pub fn parse(bytes: &[u8]) -> Result<(Self, &[u8]), DropCause> {
        let ([control, message], rest) = bytes.split_first_chunk().ok_or(DropCause::TransportMalformed)?;
        let message = *message;
        let u16_of = |rest: &[u8], at: usize| {
            rest.get(at..at + 2).map(|b| u16::from_le_bytes([b[0], b[1]])).ok_or(DropCause::TransportMalformed)
        };
        match control {
            0 => {
                let (index, count) = (u16_of(rest, 0)?, u16_of(rest, 2)?);
                if index >= count {
                    return Err(DropCause::SegmentInvalid);
                }
                Ok((Self::Data { message, index, count }, &rest[4..]))
            }
            1 => Ok((Self::Acknowledge { message, next: u16_of(rest, 0)? }, &rest[2..])),
            2 => {
                let reason = match rest.first() {
                    Some(1) => SegmentRefusal::Busy,
                    Some(2) => SegmentRefusal::TooLong,
                    _ => return Err(DropCause::TransportMalformed),
                };
                Ok((Self::Refuse { message, reason }, &rest[1..]))
            }
            _ => Err(DropCause::TransportMalformed),
        }
    }

    /// Writes the header and returns its length.
    pub fn encode(self, out: &mut [u8; Self::LEN_MAX]) -> usize {
        match self {
            Self::Data { message, index, count } => {
                out[..2].copy_from_slice(&[0, message]);
                out[2..4].copy_from_slice(&index.to_le_bytes());
                out[4..6].copy_from_slice(&count.to_le_bytes());
                6
            }
            Self::Acknowledge { message, next } => {
                out[..2].copy_from_slice(&[1, message]);
                out[2..4].copy_from_slice(&next.to_le_bytes());
                4
            }
            Self::Refuse { message, reason } => {
                let reason = match reason {
                    SegmentRefusal::Busy => 1,
                    SegmentRefusal::TooLong => 2,
                };
                out[..3].copy_from_slice(&[2, message, reason]);
                3
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `[TRN-01]`
    #[test]
    fn only_three_transport_keys_are_served() {
        assert_eq!(Transport::from_key(1), Ok(Transport::Sequenced));
        for key in 3..=255 {
            assert_eq!(Transport::from_key(key), Err(DropCause::UnknownTransport));
        }
    }

    /// `[TRN-03]`: every word but those of kind 3 reads and writes as itself.
    #[test]
    fn sequenced_headers_round_trip() {
        for word in 0..=u16::MAX {
            let bytes = word.to_le_bytes();
            match SequencedHeader::parse(&bytes) {
                Ok((header, rest)) => assert_eq!((header.encode(), rest), (bytes, &[][..])),
                Err(cause) => assert!(word >= 0xc000 && cause == DropCause::TransportMalformed),
            }
        }
        assert_eq!(SequencedHeader::parse(&[1]), Err(DropCause::TransportMalformed));
    }

    /// `[TRN-08]`: an index equal to its count was once let through.
    #[test]
    fn an_index_must_be_below_its_count() {
        let data = |index: u16, count: u16| {
            let mut out = [0; 6];
            SegmentHeader::Data { message: 9, index, count }.encode(&mut out);
            SegmentHeader::parse(&out).map(|(header, _)| header)
        };
        assert!(data(0, 1).is_ok() && data(65_534, 65_535).is_ok());
        for (index, count) in [(0, 0), (1, 1), (4, 4), (5, 4), (65_535, 65_535)] {
            assert_eq!(data(index, count), Err(DropCause::SegmentInvalid));
        }
    }

    /// `[TRN-07]`
    #[test]
    fn segment_headers_cut_short_are_malformed() {
        for bytes in [&[][..], &[0], &[0, 1, 2, 3, 4], &[1, 1, 2], &[2, 1], &[2, 1, 9], &[3, 1, 1, 1, 1, 1]] {
            assert_eq!(SegmentHeader::parse(bytes).unwrap_err(), DropCause::TransportMalformed, "{bytes:?}");
        }
        let refuse = SegmentHeader::Refuse { message: 3, reason: SegmentRefusal::Busy };
        let mut out = [0; 6];
        let len = refuse.encode(&mut out);
        assert_eq!(SegmentHeader::parse(&out[..len]), Ok((refuse, &[][..])));
    }
}

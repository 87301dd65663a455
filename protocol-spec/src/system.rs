//! Messages between nodes themselves, first of all the link announcement.
//!
//! - **Walk:** made by an egress when a gateway is free, taken by the neighbour's ingress; never forwarded.
//! - **Clauses:** `[SYS-01]` keys, `[SYS-02]` and `[SYS-05]` the announcement.

use crate::discovery::UniqueId;
use crate::drops::DropCause;
use serde::{Deserialize, Serialize};

/// Time between announcements on an open gateway, µs, `[SYS-03]`.
pub const ANNOUNCE_INTERVAL_US: u64 = 250_000;
/// Silence after which a neighbour is lost, µs: three announcements and a half, so that two may be lost, `[SYS-04]`.
pub const NEIGHBOUR_TIMEOUT_US: u64 = 875_000;
/// Time to live of an announcement, µs: it is sent at once or not at all.
pub const ANNOUNCE_TTL_US: u16 = u16::MAX;
/// Version of the announcement.
pub const ANNOUNCEMENT_VERSION: u8 = 1;

/// Keys of the system messages, `[SYS-01]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum SystemKey {
    /// Asks a neighbour for its time.
    TimeRequest = 0,
    /// Answers it.
    TimeReply = 1,
    /// Says who is at this end of a link.
    Announcement = 2,
    /// Gathers stamps along a route.
    Trace = 3,
    /// A line of text for everybody.
    Log = 4,
    /// Firmware in pieces.
    Firmware = 5,
    /// A stop of all motion or its resume, told on by every node.
    Halt = 6,
}

impl SystemKey {
    /// All of them, in the order of their keys.
    pub const ALL: [Self; 7] =
        [Self::TimeRequest, Self::TimeReply, Self::Announcement, Self::Trace, Self::Log, Self::Firmware, Self::Halt];

    /// The number that stands for it.
    #[must_use]
    pub const fn key(self) -> u8 {
        self as u8
    }

    /// The message of a key.
    #[must_use]
    pub fn from_key(key: u8) -> Option<Self> {
        Self::ALL.get(usize::from(key)).copied()
    }

    /// Its name, for people.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::TimeRequest => "time request",
            Self::TimeReply => "time reply",
            Self::Announcement => "link announcement",
            Self::Trace => "trace",
            Self::Log => "log",
            Self::Firmware => "firmware",
            Self::Halt => "halt",
        }
    }
}

/// Who is at the sending end of a link, `[SYS-02]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Announcement {
    /// [`ANNOUNCEMENT_VERSION`].
    pub version: u8,
    /// Which device.
    pub unique_id: UniqueId,
    /// Its boot.
    pub boot_epoch: u32,
    /// Whether the sender does not know its neighbour yet.
    pub wants_answer: bool,
    /// On a bus, the sender's own address.
    pub drop: Option<u8>,
}

impl Announcement {
    /// Most bytes one takes: 1 + 12 + 5 + 1 + 2.
    pub const LEN_MAX: usize = 21;

    /// Writes it into `out`; returns its length.
    ///
    /// # Errors
    /// [`DropCause::SendRefused`] where it does not fit.
    pub fn encode(&self, out: &mut [u8]) -> Result<usize, DropCause> {
        postcard::to_slice(self, out).map(|bytes| bytes.len()).map_err(|_| DropCause::SendRefused)
    }

    /// Reads one, `[SYS-05]`.
    ///
    /// # Errors
    /// [`DropCause::SystemMalformed`].
    pub fn decode(bytes: &[u8]) -> Result<Self, DropCause> {
        match postcard::take_from_bytes::<Self>(bytes) {
            Ok((it, [])) if it.version == ANNOUNCEMENT_VERSION => Ok(it),
            _ => Err(DropCause::SystemMalformed),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `[SYS-05]`, and the stated length is the most there is.
    #[test]
    fn announcements_round_trip_and_bad_ones_are_refused() {
        let it = Announcement {
            version: ANNOUNCEMENT_VERSION,
            unique_id: UniqueId([9; 12]),
            boot_epoch: u32::MAX,
            wants_answer: true,
            drop: Some(254),
        };
        let mut out = [0; Announcement::LEN_MAX];
        let len = it.encode(&mut out).unwrap();
        assert_eq!(len, Announcement::LEN_MAX);
        assert_eq!(Announcement::decode(&out), Ok(it));
        assert_eq!(Announcement::decode(&out[..len - 1]), Err(DropCause::SystemMalformed));
        out[0] = 2;
        assert_eq!(Announcement::decode(&out), Err(DropCause::SystemMalformed));
    }

    /// `[SYS-01]`
    #[test]
    fn keys_are_their_numbers() {
        for (key, expected) in (0u8..).zip(SystemKey::ALL) {
            assert_eq!((SystemKey::from_key(key), expected.key()), (Some(expected), key));
        }
        assert_eq!(SystemKey::from_key(7), None);
    }
}

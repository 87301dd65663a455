//! Asking a neighbour for its time: two messages, four stamps.
//!
//! - **Walk:** the egress makes a [`TimeRequest`] or [`TimeReply`] when a gateway is free → whoever puts its first byte on the wire writes
//!   the [stamp slot](stamp) → the neighbour's ingress; never forwarded.
//! - **Invariants:** fixed width, so that a message is as long whatever it says; the slot is the last [`SLOT_BYTES`] bytes.
//! - **Context:** the routing task; no division, no float. **Clauses:** `[TIM-01]`, `[TIM-02]`, `[TIM-03]`.
//!
//! ```
//! use fixed_math::time::LocalTicks;
//! use osap_protocol::time::{ANYBODY, TimeRequest, stamp, unwrap_stamp};
//!
//! let mut payload = [0; TimeRequest::LEN];
//! TimeRequest { sequence: 7, below: ANYBODY }.encode(&mut payload).unwrap();
//! let departed = LocalTicks::from_us(123_456_789);
//! stamp(&mut payload, departed);
//! let (request, slot) = TimeRequest::decode(&payload).unwrap();
//! assert_eq!(request.sequence, 7);
//! assert_eq!(unwrap_stamp(slot, LocalTicks::from_us(123_460_000)), departed);
//! ```

use crate::discovery::UniqueId;
use crate::drops::DropCause;
use fixed_math::time::{LocalTicks, NetTime, PeerTicks, Rate};

/// Version of both messages.
pub const TIME_VERSION: u8 = 1;
/// Bytes of the stamp slot.
pub const SLOT_BYTES: usize = 4;
/// The highest tier that is believed: no route has more steps, `[TIM-08]`.
pub const TIER_MAX: u8 = 64;
/// A priority that never becomes root, `[TIM-07]`.
pub const PRIORITY_NEVER: u8 = u8::MAX;
/// Priority of a device that nobody set, `[TIM-07]`.
pub const PRIORITY_DEVICE: u8 = 128;
/// A bound that is none.
pub const NO_BOUND: u32 = u32::MAX;

/// Writes a departure into a time message's slot, `[TIM-03]`: the stamp's low 32 bits in steps, which wrap after 16.7 s.
pub fn stamp(packet: &mut [u8], departed: LocalTicks) {
    if let Some(slot) = packet.last_chunk_mut::<SLOT_BYTES>() {
        *slot = low(departed.steps()).to_le_bytes();
    }
}

/// The latest reading not after `near` whose low bits are `slot`: a stamp made at most 16.7 s before.
#[must_use]
pub const fn unwrap_stamp(slot: u32, near: LocalTicks) -> LocalTicks {
    let back = low(near.steps()).wrapping_sub(slot);
    LocalTicks::from_steps(near.steps().saturating_sub(back as u64))
}

#[expect(clippy::cast_possible_truncation, reason = "the low bits are what is wanted")]
const fn low(steps: u64) -> u32 {
    steps as u32
}

/// Asks a neighbour for its time, `[TIM-01]`: `version u8, sequence u8, below u8, slot u32`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimeRequest {
    /// Comes back in the reply.
    pub sequence: u8,
    /// Only nodes of a lower tier answer, `[TIM-18]`; [`ANYBODY`] for all.
    pub below: u8,
}

/// A request that is answered whatever the tier.
pub const ANYBODY: u8 = u8::MAX;

impl TimeRequest {
    /// Its bytes, slot included.
    pub const LEN: usize = 3 + SLOT_BYTES;

    /// Writes it into `out` with an empty slot; its length, or `None` where it does not fit.
    pub fn encode(self, out: &mut [u8]) -> Option<usize> {
        let mut out = Writer(out);
        out.put([TIME_VERSION, self.sequence, self.below])?;
        out.put([0; SLOT_BYTES])?;
        Some(Self::LEN)
    }

    /// Reads one and its slot.
    ///
    /// # Errors
    /// [`DropCause::SystemMalformed`] for another length or version.
    pub fn decode(bytes: &[u8]) -> Result<(Self, u32), DropCause> {
        let mut bytes = Reader(bytes);
        let read = |bytes: &mut Reader<'_>| {
            let [version, sequence, below] = bytes.take()?;
            let slot = u32::from_le_bytes(bytes.take()?);
            (version == TIME_VERSION && bytes.0.is_empty()).then_some((Self { sequence, below }, slot))
        };
        read(&mut bytes).ok_or(DropCause::SystemMalformed)
    }
}

/// Who a timescale comes from, `[TIM-07]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Root {
    /// Lower goes before higher.
    pub priority: u8,
    /// Which device.
    pub unique_id: UniqueId,
}

/// A UNIX time offered by a host, `[TIM-14]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UnixOffset {
    /// UNIX time less system time, µs.
    pub offset_us: i64,
    /// Steps to the host that said so.
    pub hops: u8,
}

/// A neighbour's answer, `[TIM-02]`, in the order of its bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TimeReply {
    /// The request's.
    pub sequence: u8,
    /// The request's slot.
    pub asked_slot: u32,
    /// When the request's first byte came, by the sender's counter.
    pub heard: PeerTicks,
    /// The system time that its counter stood for then, as it knows best: what it slews to, not what it is slewed to.
    pub system: NetTime,
    /// Of system time against its counter.
    pub rate: Rate,
    /// One standard deviation of that system time, steps.
    pub error_steps: u32,
    /// Its greatest possible error, steps; [`NO_BOUND`] where there is none.
    pub bound_steps: u32,
    /// How fast the bound grows, 2^−32.
    pub drift_bits: u32,
    /// Time since the root itself was heard, over all steps, µs.
    pub age_us: u32,
    /// What a stamp of the sender may be off: its counter's tick, steps.
    pub tick_steps: u16,
    /// Steps to the root, 0 for the root itself; 255 without one.
    pub tier: u8,
    /// The root.
    pub root: Root,
    /// The receiver is where the sender has its time from: not to be believed by it, `[TIM-08]`.
    pub is_yours: bool,
    /// The sender's programs may rely on its time.
    pub is_settled: bool,
    /// The sender's counter runs on no crystal, `[TIM-09]`.
    pub is_rc: bool,
    /// UNIX time, where a host offered it.
    pub unix: Option<UnixOffset>,
    /// When the reply's first byte left, by the sender's counter, low bits: the slot.
    pub answered_slot: u32,
}

/// Bits of the flags.
mod flag {
    pub(super) const YOURS: u8 = 1;
    pub(super) const SETTLED: u8 = 2;
    pub(super) const UNIX: u8 = 4;
    pub(super) const RC: u8 = 8;
}

impl TimeReply {
    /// Its bytes, slot included.
    pub const LEN: usize = 6 + 16 + 5 * 4 + 2 + 14 + 1 + 9 + SLOT_BYTES;

    /// Writes it into `out`; its length, or `None` where it does not fit.
    pub fn encode(&self, out: &mut [u8]) -> Option<usize> {
        let flags = [
            (self.is_yours, flag::YOURS),
            (self.is_settled, flag::SETTLED),
            (self.unix.is_some(), flag::UNIX),
            (self.is_rc, flag::RC),
        ];
        let flags = flags.iter().filter(|(set, _)| *set).fold(0, |all, (_, bit)| all | bit);
        let UnixOffset { offset_us, hops } = self.unix.unwrap_or_default();
        let mut out = Writer(out);
        out.put([TIME_VERSION, self.sequence])?;
        out.put(self.asked_slot.to_le_bytes())?;
        out.put(self.heard.steps().to_le_bytes())?;
        out.put(self.system.steps().to_le_bytes())?;
        out.put(self.rate.bits().to_le_bytes())?;
        for value in [self.error_steps, self.bound_steps, self.drift_bits, self.age_us] {
            out.put(value.to_le_bytes())?;
        }
        out.put(self.tick_steps.to_le_bytes())?;
        out.put([self.tier, self.root.priority])?;
        out.put(self.root.unique_id.0)?;
        out.put([flags])?;
        out.put(offset_us.to_le_bytes())?;
        out.put([hops])?;
        out.put(self.answered_slot.to_le_bytes())?;
        Some(Self::LEN)
    }

    /// Reads one.
    ///
    /// # Errors
    /// [`DropCause::SystemMalformed`] for another length or version, unknown flags, and tiers that nobody has.
    pub fn decode(bytes: &[u8]) -> Result<Self, DropCause> {
        Self::read(&mut Reader(bytes)).ok_or(DropCause::SystemMalformed)
    }

    fn read(bytes: &mut Reader<'_>) -> Option<Self> {
        let [TIME_VERSION, sequence] = bytes.take()? else { return None };
        let asked_slot = u32::from_le_bytes(bytes.take()?);
        let heard = PeerTicks::from_steps(u64::from_le_bytes(bytes.take()?));
        let system = NetTime::from_steps(u64::from_le_bytes(bytes.take()?));
        let rate = Rate::from_bits(i32::from_le_bytes(bytes.take()?));
        let mut words = [0; 4];
        for word in &mut words {
            *word = u32::from_le_bytes(bytes.take()?);
        }
        let [error_steps, bound_steps, drift_bits, age_us] = words;
        let tick_steps = u16::from_le_bytes(bytes.take()?);
        let [tier, priority] = bytes.take()?;
        let root = Root { priority, unique_id: UniqueId(bytes.take()?) };
        let [flags] = bytes.take()?;
        let offset_us = i64::from_le_bytes(bytes.take()?);
        let [hops] = bytes.take()?;
        let answered_slot = u32::from_le_bytes(bytes.take()?);
        let known = flags & !(flag::YOURS | flag::SETTLED | flag::UNIX | flag::RC) == 0;
        if !known || !bytes.0.is_empty() || (tier > TIER_MAX && tier != u8::MAX) {
            return None;
        }
        Some(Self {
            sequence,
            asked_slot,
            heard,
            system,
            rate,
            error_steps,
            bound_steps,
            drift_bits,
            age_us,
            tick_steps,
            tier,
            root,
            is_yours: flags & flag::YOURS != 0,
            is_settled: flags & flag::SETTLED != 0,
            is_rc: flags & flag::RC != 0,
            unix: (flags & flag::UNIX != 0).then_some(UnixOffset { offset_us, hops }),
            answered_slot,
        })
    }

    /// When the reply's first byte left: its slot, which is at most 16.7 s after [`TimeReply::heard`].
    #[must_use]
    pub const fn answered(&self) -> PeerTicks {
        let after = self.answered_slot.wrapping_sub(low(self.heard.steps()));
        PeerTicks::from_steps(self.heard.steps().saturating_add(after as u64))
    }
}

/// Room that is filled from its start.
struct Writer<'a>(&'a mut [u8]);

impl Writer<'_> {
    fn put<const N: usize>(&mut self, bytes: [u8; N]) -> Option<()> {
        let (head, rest) = core::mem::take(&mut self.0).split_first_chunk_mut::<N>()?;
        *head = bytes;
        self.0 = rest;
        Some(())
    }
}

/// Bytes that are taken from their start.
struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (head, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*head)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn reply() -> TimeReply {
        TimeReply {
            sequence: 9,
            asked_slot: 0x0102_0304,
            heard: PeerTicks::from_steps(0x1_0000_0010),
            system: NetTime::from_us(77),
            rate: Rate::from_ppb(-40_000),
            error_steps: 60,
            bound_steps: 700,
            drift_bits: 3,
            age_us: 51_000,
            tick_steps: 256,
            tier: 2,
            root: Root { priority: 128, unique_id: UniqueId([3; 12]) },
            is_yours: true,
            is_settled: true,
            is_rc: true,
            unix: Some(UnixOffset { offset_us: 1_790_000_000_000_000, hops: 1 }),
            answered_slot: 0x30,
        }
    }

    /// `[TIM-02]`: what is written is read, whole and no longer.
    #[test]
    fn replies_round_trip() {
        for reply in [reply(), TimeReply { unix: None, is_yours: false, tier: 255, ..reply() }] {
            let mut out = [0; TimeReply::LEN + 1];
            assert_eq!(reply.encode(&mut out), Some(TimeReply::LEN));
            assert_eq!(TimeReply::decode(&out[..TimeReply::LEN]), Ok(reply));
            for len in 0..=TimeReply::LEN + 1 {
                let whole = len == TimeReply::LEN;
                assert_eq!(TimeReply::decode(&out[..len]).is_ok(), whole, "{len} bytes");
            }
            assert_eq!(reply.encode(&mut out[..TimeReply::LEN - 1]), None);
        }
    }

    /// `[TIM-02]`, `[TIM-08]`: another version, a flag nobody has, a tier beyond the last.
    #[test]
    fn replies_that_cannot_be_are_refused() {
        let mut good = [0; TimeReply::LEN];
        reply().encode(&mut good).unwrap();
        for (at, value) in [(0, 2), (58, 16), (44, TIER_MAX + 1), (44, 254)] {
            let mut bad = good;
            bad[at] = value;
            assert_eq!(TimeReply::decode(&bad), Err(DropCause::SystemMalformed), "byte {at}");
        }
    }

    /// `[TIM-03]`: the slot is what was written last, and a reply's is read forward from the request's arrival.
    #[test]
    fn the_slot_is_the_departure() {
        let mut bytes = [0; TimeReply::LEN];
        let mut said = reply();
        said.encode(&mut bytes).unwrap();
        stamp(&mut bytes, LocalTicks::from_steps(0x1_0000_0500));
        said = TimeReply::decode(&bytes).unwrap();
        assert_eq!(said.answered(), PeerTicks::from_steps(0x1_0000_0500));
        // across the wrap of the low bits
        said.heard = PeerTicks::from_steps(0x1_ffff_fff0);
        said.answered_slot = 0x20;
        assert_eq!(said.answered(), PeerTicks::from_steps(0x2_0000_0020));
    }

    proptest! {
        /// `[TIM-03]`: a stamp comes back whole within 16.7 s.
        #[test]
        fn stamps_unwrap(at in any::<u64>(), later in 0..u64::from(u32::MAX)) {
            let near = LocalTicks::from_steps(at.saturating_add(later));
            prop_assume!(at.checked_add(later).is_some());
            prop_assert_eq!(unwrap_stamp(low(at), near), LocalTicks::from_steps(at));
        }

        /// `[TIM-01]`, `[TIM-02]`: no bytes are a fault of ours.
        #[test]
        fn any_bytes_are_read_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..90)) {
            if let Ok(reply) = TimeReply::decode(&bytes) {
                let mut again = [0; TimeReply::LEN];
                reply.encode(&mut again).unwrap();
                let unix_is_read = reply.unix.is_some();
                prop_assert!(unix_is_read || again[..59] == bytes[..59]);
                let _any: PeerTicks = reply.answered();
            }
            let _either = TimeRequest::decode(&bytes);
        }
    }
}

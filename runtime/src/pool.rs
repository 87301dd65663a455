//! Packet memory: a fixed number of slots, claimed and relinquished.
//!
//! - **Walk:** ingress and senders claim, egress and ports relinquish.
//! - **Invariants:** a slot is free, stacked or held, and exactly one of these; free slots form a list, so claiming is O(1).
//! - **Context:** the node's. **Clauses:** `[NOD-01]`, `[NOD-02]`.

use fixed_math::time::LocalTicks;
use osap_protocol::{GatewayIndex, PortIndex};

/// No slot.
const NIL: u16 = u16::MAX;

/// Names a slot of one pool. Not `Copy`, so that one claim is relinquished once.
#[derive(Debug, PartialEq, Eq)]
pub struct SlotId(pub(crate) u16);

impl SlotId {
    pub(crate) const fn at(&self) -> usize {
        self.0 as usize
    }
}

/// Who wrote a packet into the pool, and against whose hold it counts, `[NOD-01]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Owner {
    /// It came in here.
    Gateway(GatewayIndex),
    /// It was made here.
    Port(PortIndex),
}

/// Who must be free before a packet leaves the stack, `[NOD-06]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taker {
    /// It goes out here.
    Gateway(GatewayIndex),
    /// It is delivered here.
    Port(PortIndex),
}

/// What is known of the packet in a slot.
#[derive(Clone, Copy, Debug)]
pub struct Tag {
    /// Who holds it.
    pub owner: Owner,
    /// Who shall take it.
    pub taker: Taker,
    /// When its frame ended, or it was made.
    pub arrived: LocalTicks,
    /// TTL at that instant, µs.
    pub ttl_us: u16,
    /// `arrived` plus TTL.
    pub deadline: LocalTicks,
}

impl Tag {
    const BLANK: Self = Self {
        owner: Owner::Port(PortIndex::NETRESPONDER),
        taker: Taker::Port(PortIndex::NETRESPONDER),
        arrived: LocalTicks::ZERO,
        ttl_us: 0,
        deadline: LocalTicks::ZERO,
    };
}

/// One packet's place.
#[derive(Debug)]
pub(crate) struct Slot<const BYTES: usize> {
    bytes: [u8; BYTES],
    len: u16,
    pub(crate) tag: Tag,
    /// Neighbours in the deadline stack, or in the list of free slots.
    pub(crate) next: u16,
    pub(crate) previous: u16,
}

/// `SLOTS` packets of up to `BYTES` bytes.
#[derive(Debug)]
pub struct Pool<const SLOTS: usize, const BYTES: usize> {
    pub(crate) slots: [Slot<BYTES>; SLOTS],
    free: u16,
    free_count: u16,
}

impl<const SLOTS: usize, const BYTES: usize> Pool<SLOTS, BYTES> {
    /// All slots free. Sizes that the 16-bit indices and lengths cannot say do not compile.
    #[must_use]
    pub const fn new() -> Self {
        const { assert!(SLOTS > 0 && SLOTS < NIL as usize, "a pool has 1 to 65,534 slots") };
        const { assert!(BYTES <= u16::MAX as usize, "a packet has at most 65,535 bytes") };
        let mut slots =
            [const { Slot { bytes: [0; BYTES], len: 0, tag: Tag::BLANK, next: NIL, previous: NIL } }; SLOTS];
        let mut at = 0;
        while at + 1 < SLOTS {
            #[expect(clippy::cast_possible_truncation, reason = "checked above")]
            {
                slots[at].next = at as u16 + 1;
            }
            at += 1;
        }
        #[expect(clippy::cast_possible_truncation, reason = "checked above")]
        Self { slots, free: 0, free_count: SLOTS as u16 }
    }

    /// Slots nobody has claimed.
    #[must_use]
    pub const fn free_count(&self) -> usize {
        self.free_count as usize
    }

    /// Takes a free slot; its bytes are what the last packet left there.
    pub fn claim(&mut self, tag: Tag) -> Option<SlotId> {
        let id = SlotId(self.free);
        let slot = self.slots.get_mut(id.at())?;
        self.free = slot.next;
        self.free_count -= 1;
        slot.tag = tag;
        slot.len = 0;
        Some(id)
    }

    /// Gives a slot back.
    #[expect(clippy::needless_pass_by_value, reason = "giving the name away is what makes it once")]
    pub fn relinquish(&mut self, id: SlotId) {
        let slot = &mut self.slots[id.at()];
        slot.next = self.free;
        self.free = id.0;
        self.free_count += 1;
    }

    /// The packet.
    #[must_use]
    pub fn bytes(&self, id: &SlotId) -> &[u8] {
        let slot = &self.slots[id.at()];
        &slot.bytes[..usize::from(slot.len)]
    }

    /// The packet, to be rewritten.
    pub fn bytes_mut(&mut self, id: &SlotId) -> &mut [u8] {
        let slot = &mut self.slots[id.at()];
        &mut slot.bytes[..usize::from(slot.len)]
    }

    /// The whole room of a slot, for a packet that is being made.
    pub fn room_mut(&mut self, id: &SlotId) -> &mut [u8; BYTES] {
        &mut self.slots[id.at()].bytes
    }

    /// Sets the packet's length once it stands in the slot; at most `BYTES`.
    pub fn set_len(&mut self, id: &SlotId, len: usize) {
        #[expect(clippy::cast_possible_truncation, reason = "BYTES fits sixteen bits")]
        {
            self.slots[id.at()].len = len.min(BYTES) as u16;
        }
    }

    /// What is known of the packet.
    #[must_use]
    pub fn tag(&self, id: &SlotId) -> &Tag {
        &self.slots[id.at()].tag
    }

    /// What is known of the packet, to be changed.
    pub fn tag_mut(&mut self, id: &SlotId) -> &mut Tag {
        &mut self.slots[id.at()].tag
    }
}

impl<const SLOTS: usize, const BYTES: usize> Default for Pool<SLOTS, BYTES> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `[NOD-01]`: there are as many slots as there are, and each comes back.
    #[test]
    fn slots_run_out_and_come_back() {
        let mut pool = Pool::<3, 8>::new();
        let ids = [pool.claim(Tag::BLANK).unwrap(), pool.claim(Tag::BLANK).unwrap(), pool.claim(Tag::BLANK).unwrap()];
        assert!(pool.claim(Tag::BLANK).is_none());
        assert_eq!(pool.free_count(), 0);
        for id in ids {
            pool.relinquish(id);
        }
        assert_eq!(pool.free_count(), 3);
        assert!(pool.claim(Tag::BLANK).is_some());
    }
}

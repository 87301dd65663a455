//! The deadline stack: packets that wait for their takers, earliest deadline first.
//!
//! - **Walk:** after routing, before output.
//! - **Invariants:** from head to tail no deadline is earlier than the one before it; equal ones stand in order of arrival.
//! - **Context:** the node's, never an interrupt: insertion walks from the tail, which is one step where senders use one TTL.
//! - **Clauses:** `[NOD-03]`, `[NOD-06]`.

use crate::pool::{Owner, Pool, Slot, SlotId, Taker};
use fixed_math::time::LocalTicks;

const NIL: u16 = u16::MAX;

/// Ends of the list; the list itself runs through the pool's slots.
#[derive(Debug)]
pub struct Stack {
    head: u16,
    tail: u16,
    len: u16,
}

impl Stack {
    /// Nothing waits.
    #[must_use]
    pub const fn new() -> Self {
        Self { head: NIL, tail: NIL, len: 0 }
    }

    /// Packets waiting.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.len as usize
    }

    /// Whether nothing waits.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Puts a packet in its place by its tag's deadline, behind equal ones.
    #[expect(
        clippy::needless_pass_by_value,
        reason = "the stack holds the packet now; whoever takes it out gets its name"
    )]
    pub fn insert<const S: usize, const B: usize>(&mut self, pool: &mut Pool<S, B>, id: SlotId) {
        let slots = &mut pool.slots;
        let deadline = slots[id.at()].tag.deadline;
        let mut after = self.tail;
        while let Some(slot) = slots.get(usize::from(after)) {
            if slot.tag.deadline <= deadline {
                break;
            }
            after = slot.previous;
        }
        let before = match slots.get_mut(usize::from(after)) {
            Some(slot) => core::mem::replace(&mut slot.next, id.0),
            None => core::mem::replace(&mut self.head, id.0),
        };
        match slots.get_mut(usize::from(before)) {
            Some(slot) => slot.previous = id.0,
            None => self.tail = id.0,
        }
        slots[id.at()].previous = after;
        slots[id.at()].next = before;
        self.len += 1;
    }

    /// The earliest deadline of all.
    #[must_use]
    pub fn earliest_deadline<const S: usize, const B: usize>(&self, pool: &Pool<S, B>) -> Option<LocalTicks> {
        pool.slots.get(usize::from(self.head)).map(|slot| slot.tag.deadline)
    }

    /// Takes out the packet with the earliest deadline, where that has come.
    pub fn take_expired<const S: usize, const B: usize>(
        &mut self,
        pool: &mut Pool<S, B>,
        now: LocalTicks,
    ) -> Option<SlotId> {
        if self.earliest_deadline(pool)? <= now { Some(self.unlink(&mut pool.slots, self.head)) } else { None }
    }

    /// Takes out the earliest packet for `taker`.
    pub fn take_for<const S: usize, const B: usize>(&mut self, pool: &mut Pool<S, B>, taker: Taker) -> Option<SlotId> {
        let mut at = self.head;
        while let Some(slot) = pool.slots.get(usize::from(at)) {
            if slot.tag.taker == taker {
                return Some(self.unlink(&mut pool.slots, at));
            }
            at = slot.next;
        }
        None
    }

    /// Takes out the latest packet of `owner`, or of all, where it is due after `deadline`, `[NOD-05]`.
    pub fn take_latest_of<const S: usize, const B: usize>(
        &mut self,
        pool: &mut Pool<S, B>,
        owner: Option<Owner>,
        deadline: LocalTicks,
    ) -> Option<SlotId> {
        let mut at = self.tail;
        while let Some(slot) = pool.slots.get(usize::from(at)) {
            if slot.tag.deadline <= deadline {
                return None;
            }
            if owner.is_none_or(|owner| slot.tag.owner == owner) {
                return Some(self.unlink(&mut pool.slots, at));
            }
            at = slot.previous;
        }
        None
    }

    fn unlink<const B: usize>(&mut self, slots: &mut [Slot<B>], at: u16) -> SlotId {
        let (previous, next) = (slots[usize::from(at)].previous, slots[usize::from(at)].next);
        match slots.get_mut(usize::from(previous)) {
            Some(slot) => slot.next = next,
            None => self.head = next,
        }
        match slots.get_mut(usize::from(next)) {
            Some(slot) => slot.previous = previous,
            None => self.tail = previous,
        }
        self.len -= 1;
        SlotId(at)
    }
}

impl Default for Stack {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::pool::Tag;
    use osap_protocol::{GatewayIndex, PortIndex};
    use proptest::prelude::*;
    use std::vec::Vec;

    fn tag(owner: u8, taker: u8, deadline_us: u64, number: u16) -> Tag {
        Tag {
            owner: Owner::Gateway(GatewayIndex::new(owner).unwrap()),
            taker: if taker == 0 {
                Taker::Port(PortIndex::NETRESPONDER)
            } else {
                Taker::Gateway(GatewayIndex::new(taker).unwrap())
            },
            arrived: LocalTicks::ZERO,
            ttl_us: number,
            deadline: LocalTicks::from_us(deadline_us),
        }
    }

    proptest! {
        /// `[NOD-03]`, against a sorted vector: every way to take gives what a stable sort by deadline would.
        #[test]
        fn order_is_that_of_a_stable_sort(
            packets in proptest::collection::vec((0u8..3, 0u8..3, 0u64..20), 0..16),
            takes in proptest::collection::vec((0u8..4, 0u64..20), 0..24),
        ) {
            let mut pool = Pool::<16, 4>::new();
            let mut stack = Stack::new();
            let mut model: Vec<Tag> = Vec::new();
            for (number, (owner, taker, deadline)) in packets.into_iter().enumerate() {
                let tag = tag(owner, taker, deadline, u16::try_from(number).unwrap());
                let id = pool.claim(tag).unwrap();
                stack.insert(&mut pool, id);
                model.push(tag);
            }
            model.sort_by_key(|tag| tag.deadline);
            for (what, value) in takes {
                let at = LocalTicks::from_us(value);
                let wanted = tag(u8::try_from(value % 3).unwrap(), u8::try_from(value % 3).unwrap(), 0, 0);
                let (got, place) = match what {
                    0 => (stack.take_expired(&mut pool, at), model.iter().position(|t| t.deadline <= at)),
                    1 => (stack.take_latest_of(&mut pool, Some(wanted.owner), at), model.iter().rposition(|t| t.owner == wanted.owner && t.deadline > at)),
                    _ => (stack.take_for(&mut pool, wanted.taker), model.iter().position(|t| t.taker == wanted.taker)),
                };
                let expected = place.map(|place| model.remove(place).ttl_us);
                prop_assert_eq!(got.as_ref().map(|id| pool.tag(id).ttl_us), expected);
                if let Some(id) = got {
                    pool.relinquish(id);
                }
                prop_assert_eq!(stack.len(), model.len());
                prop_assert_eq!(stack.earliest_deadline(&pool), model.first().map(|t| t.deadline));
            }
            prop_assert_eq!(pool.free_count() + stack.len(), 16);
        }
    }
}

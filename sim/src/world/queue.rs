//! What is to happen, in order of time; equal times in the order in which they were planned.
//!
//! - **Walk:** every part of the world plans events here; [`World::step`](super::World::step) takes them.
//! - **Invariant:** the order depends on nothing but times and the order of the calls, so a world repeats itself.

use super::NodeId;
use crate::time::TrueTime;
use osap_protocol::GatewayIndex;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// What happens. Tokens tell events that were overtaken by a reset or an unplugged cable from those that still count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum What {
    /// The last byte of a frame reaches its receiver.
    Arrive { flight: u32 },
    /// The last byte of a frame has left: the gateway is clear to send.
    Sent { node: NodeId, gateway: GatewayIndex, token: u32 },
    /// The processor has finished a job.
    Job { node: NodeId, token: u32 },
    /// A node's own next time.
    Wake { node: NodeId },
    /// A fault layer gives out a frame.
    Faults { link: u32, way: u8 },
    /// The last byte of a frame has left a bus.
    BusFree { bus: u32 },
    /// A bus's fault layer gives out a frame.
    BusFaults { bus: u32 },
    /// The last byte of a frame reaches those who listen to a bus.
    Hear { bus: u32 },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Planned {
    at: TrueTime,
    number: u64,
    what: What,
}

/// The events to come.
#[derive(Debug, Default)]
pub(super) struct Queue {
    heap: BinaryHeap<Reverse<Planned>>,
    next_number: u64,
}

impl Queue {
    pub(super) fn plan(&mut self, at: TrueTime, what: What) {
        self.heap.push(Reverse(Planned { at, number: self.next_number, what }));
        self.next_number += 1;
    }

    pub(super) fn next_at(&self) -> Option<TrueTime> {
        self.heap.peek().map(|Reverse(planned)| planned.at)
    }

    pub(super) fn pop(&mut self) -> Option<(TrueTime, What)> {
        self.heap.pop().map(|Reverse(planned)| (planned.at, planned.what))
    }
}

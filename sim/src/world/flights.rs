//! Frames between a sender's last byte and a receiver's processor.
//!
//! - **Walk:** the wire → [`Flights::launch`] → arrival → the receiver's ring → [`Flights::land`]. A frame on a bus is launched by the
//!   interrupt of each receiver that it is for.
//! - **Invariant:** a flight lands once; its buffer is used again, so that a long run allocates nothing.

use super::NodeId;
use crate::time::TrueTime;
use fixed_math::time::LocalTicks;
use osap_protocol::{BusDrop, GatewayIndex};

/// Buffers kept for later frames. Fault layers hand out frames in buffers of their own: without a bound, a long run would keep each.
const BUFFERS_MAX: usize = 1024;

/// What a frame comes over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Over {
    /// A link, as it was when the frame left; a link that was unplugged since is another.
    Link { link: u32, way: u8, epoch: u32 },
    /// A bus: its receiver's interrupt has unstuffed and checked it and taken the addresses off; the bytes are the packet. `stamp` is its
    /// first byte's, by the receiver's counter.
    Bus { from: BusDrop, stamp: LocalTicks },
    /// From outside the world.
    Outside,
}

/// A frame under way or captured.
#[derive(Debug)]
pub(super) struct Flight {
    pub(super) to: NodeId,
    pub(super) gateway: GatewayIndex,
    pub(super) over: Over,
    /// When its first byte reaches the receiver.
    pub(super) started: TrueTime,
    /// Its sender was reset before all of it had left.
    pub(super) cut: bool,
    /// It is the link's own, an announcement or about time: not part of any packet's walk.
    pub(super) quiet: bool,
    pub(super) bytes: Vec<u8>,
}

/// All frames under way.
#[derive(Debug, Default)]
pub(super) struct Flights {
    places: Vec<Option<Flight>>,
    free: Vec<u32>,
    buffers: Vec<Vec<u8>>,
}

impl Flights {
    /// An empty buffer for a frame.
    pub(super) fn buffer(&mut self) -> Vec<u8> {
        self.buffers.pop().unwrap_or_default()
    }

    /// Gives a buffer back.
    pub(super) fn recycle(&mut self, mut buffer: Vec<u8>) {
        if self.buffers.len() < BUFFERS_MAX {
            buffer.clear();
            self.buffers.push(buffer);
        }
    }

    pub(super) fn launch(&mut self, flight: Flight) -> u32 {
        if let Some(id) = self.free.pop() {
            self.places[id as usize] = Some(flight);
            return id;
        }
        self.places.push(Some(flight));
        u32::try_from(self.places.len() - 1).expect("fewer than 2^32 frames at once")
    }

    pub(super) fn get(&self, id: u32) -> &Flight {
        self.places[id as usize].as_ref().expect("a flight is named until it lands")
    }

    pub(super) fn get_mut(&mut self, id: u32) -> &mut Flight {
        self.places[id as usize].as_mut().expect("a flight is named until it lands")
    }

    pub(super) fn land(&mut self, id: u32) -> Flight {
        self.free.push(id);
        self.places[id as usize].take().expect("a flight lands once")
    }
}

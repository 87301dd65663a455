//! Bytes and stamps from an interrupt to the node's context.
//!
//! - **Walk:** receive interrupt → [`Capture::push`] → *this ring* → [`HandOver::drain`] → deframer → ingress.
//! - **Invariants:** the interrupt's half has no way to reach the node: a push is a fixed number of loads and stores, however much waits
//!   there. A stamp is that of a frame's first byte. A byte that finds the ring full is lost with the rest of its frame, and
//!   counted; what there is of that frame ends as one that fails its check.
//!   So it is for streams that carry a check: without one, a frame cut where a run ends would pass for a whole one.
//! - **Context:** [`Capture`] in the interrupt, [`HandOver`] in the task below it; single producer, single consumer, no locks.
//!   `heapless` has its halves learn the queue's length as they run, so a push divides by it whatever the length is: 12 cycles at the
//!   most on the Cortex-M7s whose boards use this ring, as against hundreds on a Cortex-M0+, which should take its bytes by DMA.
//! - **Clauses:** `[NOD-08]`, `[FRM-08]`.
//!
//! ```
//! use fixed_math::time::LocalTicks;
//! use osap_protocol::framing::{encode, Check, Deframer};
//! use osap_runtime::ring::RxRing;
//!
//! let mut ring = RxRing::<64, 4>::new();
//! let (mut interrupt, mut task) = ring.split();
//! let mut wire = [0; 16];
//! let len = encode(&[5, 6, 7], Check::Crc16, &mut wire)?;
//! for (n, byte) in wire[..len].iter().enumerate() {
//!     interrupt.push(*byte, LocalTicks::from_us(100 + n as u64));
//! }
//! let mut deframer = Deframer::<32>::new(Check::Crc16);
//! let mut got = None;
//! task.drain(&mut deframer, |frame| got = frame.ok().map(|frame| (frame.packet.len(), frame.started.as_us())));
//! assert_eq!(got, Some((3, 100)));
//! # Ok::<(), osap_protocol::framing::FrameError>(())
//! ```

use core::sync::atomic::{AtomicU32, Ordering};
use fixed_math::time::LocalTicks;
use heapless::spsc::{Consumer, Producer, Queue};
use osap_protocol::framing::{DELIMITER, Deframer, Frame, FrameError};

/// Room for `BYTES` − 1 bytes of up to `FRAMES` − 1 frames begun.
#[derive(Debug)]
pub struct RxRing<const BYTES: usize, const FRAMES: usize> {
    bytes: Queue<u8, BYTES>,
    stamps: Queue<LocalTicks, FRAMES>,
    /// Frames lost for want of room; written by the interrupt alone.
    overruns: AtomicU32,
}

impl<const BYTES: usize, const FRAMES: usize> RxRing<BYTES, FRAMES> {
    /// An empty ring.
    #[must_use]
    pub const fn new() -> Self {
        Self { bytes: Queue::new(), stamps: Queue::new(), overruns: AtomicU32::new(0) }
    }

    /// The interrupt's half and the task's half.
    pub fn split(&mut self) -> (Capture<'_>, HandOver<'_>) {
        let (bytes_in, bytes_out) = self.bytes.split();
        let (stamps_in, stamps_out) = self.stamps.split();
        let overruns = &self.overruns;
        (
            Capture {
                bytes: bytes_in,
                stamps: stamps_in,
                overruns,
                between_frames: true,
                losing: false,
                unfinished: false,
            },
            HandOver {
                bytes: bytes_out,
                stamps: stamps_out,
                overruns,
                seen: 0,
                between_frames: true,
                started: LocalTicks::ZERO,
            },
        )
    }
}

impl<const BYTES: usize, const FRAMES: usize> Default for RxRing<BYTES, FRAMES> {
    fn default() -> Self {
        Self::new()
    }
}

/// The interrupt's half.
pub struct Capture<'a> {
    bytes: Producer<'a, u8>,
    stamps: Producer<'a, LocalTicks>,
    overruns: &'a AtomicU32,
    between_frames: bool,
    /// The rest of this frame is not written, since some of it could not be.
    losing: bool,
    /// The ring ends in a frame without its delimiter.
    unfinished: bool,
}

impl Capture<'_> {
    /// Takes one byte that came at `now`. O(1), whatever the ring or the node hold.
    pub fn push(&mut self, byte: u8, now: LocalTicks) {
        if byte == DELIMITER {
            self.between_frames = true;
            self.losing = false;
            self.finish();
            return;
        }
        if core::mem::take(&mut self.between_frames) {
            // a delimiter that found no room is made up for, so that a frame cut short does not spoil this one
            self.finish();
            if self.unfinished || !self.bytes.ready() || self.stamps.enqueue(now).is_err() {
                self.lose();
            }
        }
        if self.losing {
            return;
        }
        if self.bytes.enqueue(byte).is_ok() {
            self.unfinished = true;
        } else {
            self.lose();
        }
    }

    /// Ends the frame in the ring, if there is one and there is room.
    fn finish(&mut self) {
        if self.unfinished {
            self.unfinished = self.bytes.enqueue(DELIMITER).is_err();
        }
    }

    fn lose(&mut self) {
        self.losing = true;
        // one writer, so no read-modify-write is needed, which a Cortex-M0+ does not have
        self.overruns.store(self.overruns.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
    }
}

/// The task's half.
pub struct HandOver<'a> {
    bytes: Consumer<'a, u8>,
    stamps: Consumer<'a, LocalTicks>,
    overruns: &'a AtomicU32,
    seen: u32,
    between_frames: bool,
    started: LocalTicks,
}

impl HandOver<'_> {
    /// Feeds what has come to `deframer` and gives each frame it ends, or what was wrong with it, to `take`.
    pub fn drain<const N: usize>(
        &mut self,
        deframer: &mut Deframer<N>,
        mut take: impl FnMut(Result<Frame<'_>, FrameError>),
    ) {
        self.bytes(|byte, started| {
            if let Some(frame) = deframer.push(byte, started) {
                take(frame);
            }
        });
    }

    /// Gives each byte that has come to `take`, with the stamp of its frame's first byte.
    pub fn bytes(&mut self, mut take: impl FnMut(u8, LocalTicks)) {
        while let Some(byte) = self.bytes.dequeue() {
            if self.between_frames && byte != DELIMITER {
                // a stamp is written before its byte, so there is one; were there none, the last is the best known
                self.started = self.stamps.dequeue().unwrap_or(self.started);
            }
            self.between_frames = byte == DELIMITER;
            take(byte, self.started);
        }
    }

    /// Frames lost for want of room since last asked, to be counted as `rx-overrun`.
    pub fn take_overruns(&mut self) -> u32 {
        let overruns = self.overruns.load(Ordering::Relaxed);
        overruns.wrapping_sub(core::mem::replace(&mut self.seen, overruns))
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use osap_protocol::framing::{Check, encode, encoded_len_max};
    use proptest::prelude::*;
    use std::vec::Vec;

    fn framed(packet: &[u8]) -> Vec<u8> {
        let mut out = std::vec![0; encoded_len_max(packet.len(), Check::Crc16)];
        let len = encode(packet, Check::Crc16, &mut out).unwrap();
        out.truncate(len);
        out
    }

    proptest! {
        /// `[NOD-08]`, `[FRM-08]`: with the task draining whenever it pleases, each frame arrives whole with the stamp of its first byte, or is
        /// counted; none arrives wrong, and one that had room from beginning to end always arrives.
        #[test]
        fn frames_arrive_whole_or_are_counted(
            packets in proptest::collection::vec((proptest::collection::vec(any::<u8>(), 1..20), any::<bool>()), 1..20),
        ) {
            let mut ring = RxRing::<48, 4>::new();
            let (mut interrupt, mut task) = ring.split();
            let mut deframer = Deframer::<64>::new(Check::Crc16);
            let (mut now, mut sent, mut got, mut bad) = (0, Vec::new(), Vec::new(), 0u32);
            for (packet, drains) in &packets {
                sent.push((packet.clone(), LocalTicks::from_us(now)));
                for byte in framed(packet) {
                    interrupt.push(byte, LocalTicks::from_us(now));
                    now += 1;
                }
                if *drains {
                    task.drain(&mut deframer, |frame| match frame {
                        Ok(frame) => got.push((frame.packet.to_vec(), frame.started)),
                        Err(_) => bad += 1,
                    });
                }
            }
            // twice: a delimiter that finds no room is made up for by the next one
            for _ in 0..2 {
                interrupt.push(DELIMITER, LocalTicks::from_us(now));
                task.drain(&mut deframer, |frame| match frame {
                    Ok(frame) => got.push((frame.packet.to_vec(), frame.started)),
                    Err(_) => bad += 1,
                });
            }
            let lost = task.take_overruns();
            prop_assert_eq!(got.len() + usize::try_from(lost).unwrap(), sent.len());
            prop_assert!(bad <= lost, "a frame was spoiled that was not counted as lost");
            let mut from = sent.iter();
            for one in &got {
                prop_assert!(from.any(|sent| sent == one), "{one:?} was never sent, or out of order");
            }
            prop_assert_eq!(task.take_overruns(), 0);
        }
    }

    /// A burst that the ring holds is not lost, and one byte more is.
    #[test]
    fn the_ring_holds_what_it_says() {
        let frame = framed(&[1, 2, 3]); // 7 bytes
        for (frames, lost) in [(1, 0), (2, 0), (3, 1)] {
            let mut ring = RxRing::<16, 4>::new();
            let (mut interrupt, mut task) = ring.split();
            for byte in core::iter::repeat_n(&frame, frames).flatten() {
                interrupt.push(*byte, LocalTicks::ZERO);
            }
            assert_eq!(task.take_overruns(), lost, "{frames} frames");
        }
    }
}

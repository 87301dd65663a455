//! Frames in a stream of bytes: where they begin and end, and when each began.
//!
//! - **Walk:** serial port, pseudo-terminal or TCP → [`StreamSource`] → the link's reader, which unstuffs and checks. The link's writer →
//!   [`StreamSink`] → the stream.
//! - **Invariants:** a frame's stamp is the time at which the read that brought its first byte returned. Memory is bounded: a frame
//!   without an end is handed on in pieces, which the reader then refuses as too long.
//! - **Clauses:** `[FRM-05]` delimiters between frames, `[FRM-08]` stamps.

use super::pump::{Ending, Incoming, Session, Sink, Source};
use super::{Clock, MTU_BYTES_MAX};
use fixed_math::time::LocalTicks;
use osap_protocol::framing::{Check, DELIMITER, encoded_len_max};
use std::io;
use std::time::Duration;

/// Longest frame of the longest packet; what is longer is no frame.
const PIECE_BYTES_MAX: usize = encoded_len_max(MTU_BYTES_MAX as usize, Check::Crc32);
/// Bytes a read takes at most.
const CHUNK_BYTES: usize = 4096;

/// A stream of bytes whose waits end.
pub(super) trait ByteStream: Send {
    /// Bytes read: at least one, or none where `wait` went by. A stream that was closed is an error.
    fn read_some(&mut self, into: &mut [u8], wait: Duration) -> io::Result<usize>;

    /// Bytes taken: at least one, or none where [`WAIT_MAX`](super::pump::WAIT_MAX) went by.
    fn write_some(&mut self, bytes: &[u8]) -> io::Result<usize>;
}

/// Whether a read or write merely ran out of time.
pub(super) fn is_wait_over(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted)
}

/// Writes all of `bytes`, unless the link ends before.
pub(super) fn write_all(stream: &mut impl ByteStream, mut bytes: &[u8], ending: &Ending<'_>) -> io::Result<()> {
    while !bytes.is_empty() {
        if ending.is_set() {
            return Err(io::Error::new(io::ErrorKind::ConnectionAborted, "the link ended"));
        }
        let taken = stream.write_some(bytes)?;
        bytes = bytes.get(taken..).unwrap_or_default();
    }
    Ok(())
}

/// Both halves over two handles of one stream.
pub(super) fn session<S: ByteStream + 'static>(reading: S, writing: S, clock: &Clock) -> Session {
    Session {
        source: Box::new(StreamSource {
            stream: reading,
            clock: clock.clone(),
            cutter: Cutter::default(),
            chunk: vec![0; CHUNK_BYTES],
        }),
        sink: Box::new(StreamSink { stream: writing, begun: false }),
    }
}

struct StreamSource<S> {
    stream: S,
    clock: Clock,
    cutter: Cutter,
    chunk: Vec<u8>,
}

impl<S: ByteStream> Source for StreamSource<S> {
    fn read(&mut self, wait: Duration, out: &mut Vec<Incoming>) -> io::Result<()> {
        let len = self.stream.read_some(&mut self.chunk, wait)?;
        let at = self.clock.now();
        self.cutter.push(self.chunk.get(..len).unwrap_or_default(), at, out);
        Ok(())
    }
}

struct StreamSink<S> {
    stream: S,
    begun: bool,
}

impl<S: ByteStream> Sink for StreamSink<S> {
    fn write(&mut self, frame: &[u8], ending: &Ending<'_>) -> io::Result<()> {
        if !self.begun {
            // `[FRM-05]`: ends what the peer may have half of.
            write_all(&mut self.stream, &[DELIMITER], ending)?;
            self.begun = true;
        }
        write_all(&mut self.stream, frame, ending)
    }
}

/// Cuts a stream behind each delimiter.
#[derive(Debug, Default)]
struct Cutter {
    piece: Vec<u8>,
    started: LocalTicks,
    /// Between a frame's first byte and its delimiter, even where what came of it was handed on.
    inside: bool,
}

impl Cutter {
    fn push(&mut self, chunk: &[u8], at: LocalTicks, out: &mut Vec<Incoming>) {
        for byte in chunk {
            if !self.inside {
                if *byte == DELIMITER {
                    continue;
                }
                self.inside = true;
                self.started = at;
            }
            self.piece.push(*byte);
            self.inside = *byte != DELIMITER;
            if !self.inside || self.piece.len() == PIECE_BYTES_MAX {
                out.push(Incoming::Frame { bytes: std::mem::take(&mut self.piece), started: self.started });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn frame(bytes: &[u8], us: u64) -> Incoming {
        Incoming::Frame { bytes: bytes.to_vec(), started: LocalTicks::from_us(us) }
    }

    /// `[FRM-08]`: the stamp is that of the read with the first byte, whichever read brings the rest. `[FRM-05]`: idle zeros are none.
    #[test]
    fn a_frame_has_the_stamp_of_its_first_byte() {
        let mut cutter = Cutter::default();
        let mut out = Vec::new();
        cutter.push(&[0, 0, 3, 7], LocalTicks::from_us(10), &mut out);
        assert_eq!(out, []);
        cutter.push(&[8, 0, 2], LocalTicks::from_us(20), &mut out);
        cutter.push(&[9, 0], LocalTicks::from_us(30), &mut out);
        assert_eq!(out, [frame(&[3, 7, 8, 0], 10), frame(&[2, 9, 0], 20)]);
    }

    /// A stream without an end takes no more memory than one frame, and its delimiter still ends it.
    #[test]
    fn an_endless_frame_is_handed_on_in_pieces() {
        let mut cutter = Cutter::default();
        let mut out = Vec::new();
        cutter.push(&vec![1; PIECE_BYTES_MAX], LocalTicks::ZERO, &mut out);
        cutter.push(&[0, 2, 0], LocalTicks::from_us(5), &mut out);
        assert_eq!(out[1..], [frame(&[0], 0), frame(&[2, 0], 5)]);
        assert!(cutter.piece.capacity() < 16);
    }

    proptest! {
        /// However a stream is cut into reads, the frames are the same and no byte but idle zeros is lost.
        #[test]
        fn reads_do_not_matter(bytes in proptest::collection::vec(0u8..4, 0..200), reads in 1usize..20) {
            let run = |size: usize| {
                let (mut cutter, mut out) = (Cutter::default(), Vec::new());
                for chunk in bytes.chunks(size) {
                    cutter.push(chunk, LocalTicks::ZERO, &mut out);
                }
                (out, cutter.piece)
            };
            let (frames, rest) = run(reads);
            prop_assert_eq!(run(200), (frames, rest));
            let non_zero = |bytes: &[u8]| bytes.iter().filter(|byte| **byte != 0).count();
            let (frames, rest) = run(reads);
            let kept: usize = frames.iter().map(|item| match item {
                Incoming::Frame { bytes, .. } => non_zero(bytes),
                Incoming::Bad(_) => 0,
            }).sum();
            prop_assert_eq!(kept + non_zero(&rest), non_zero(&bytes));
        }
    }
}

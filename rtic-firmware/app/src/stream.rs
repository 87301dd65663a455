//! The stream port: sends datagrams at an interval to whoever asked, as a sensor would.
//!
//! - **Walk:** a sequenced request → *here* → datagrams back along its way, one an interval.
//! - **Invariants:** one stream at a time; due instants are `start + n × interval` however late the calls come; each datagram is sent
//!   or counted as shed, never both.
//! - **Context:** the serving task; at most [`BURST_MAX`] packets a call. **Clauses:** `[APP-05]` to `[APP-09]`.
//!
//! ```
//! use firmware_app::stream::StreamRequest;
//!
//! let request = StreamRequest { interval_us: 1_000, payload_bytes: 12, count: 3, ttl_us: 5_000 };
//! assert_eq!(request.encode(), [0xe8, 3, 0, 0, 12, 0, 3, 0, 0, 0, 0x88, 0x13]);
//! assert_eq!(StreamRequest::decode(&request.encode()), Some(request));
//! ```

use crate::echo::route_back;
use fixed_math::time::{LocalTicks, Span};
use osap_protocol::header::PORT_HEADER_BYTES;
use osap_protocol::transport::{Sequence, SequencedHeader, SequencedKind, Transport};
use osap_protocol::{DropCause, PortIndex, RouteBuf};
use osap_runtime::{Delivery, Mailbox, Outbound};

/// Shortest interval, µs, `[APP-06]`.
pub const INTERVAL_US_MIN: u32 = 50;
/// Longest interval, µs: ten seconds, `[APP-06]`.
pub const INTERVAL_US_MAX: u32 = 10_000_000;
/// Bytes of a datagram's number and stamp, the shortest payload, `[APP-07]`.
pub const HEAD_BYTES: usize = 12;
/// Datagrams made in one call; what is due beyond them is shed.
pub const BURST_MAX: u32 = 4;

/// What a stream is asked for, `[APP-05]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StreamRequest {
    /// Time between datagrams, µs.
    pub interval_us: u32,
    /// Bytes of each payload.
    pub payload_bytes: u16,
    /// Datagrams in all; 0 stops the stream there is.
    pub count: u32,
    /// Time to live of each, µs.
    pub ttl_us: u16,
}

impl StreamRequest {
    /// Bytes a request takes.
    pub const LEN: usize = 12;

    /// The request's bytes.
    #[must_use]
    pub fn encode(&self) -> [u8; Self::LEN] {
        let mut out = [0; Self::LEN];
        out[..4].copy_from_slice(&self.interval_us.to_le_bytes());
        out[4..6].copy_from_slice(&self.payload_bytes.to_le_bytes());
        out[6..10].copy_from_slice(&self.count.to_le_bytes());
        out[10..].copy_from_slice(&self.ttl_us.to_le_bytes());
        out
    }

    /// Reads a request; `None` where it has another length.
    #[must_use]
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let [i0, i1, i2, i3, p0, p1, c0, c1, c2, c3, t0, t1] = *bytes.as_array::<{ Self::LEN }>()?;
        Some(Self {
            interval_us: u32::from_le_bytes([i0, i1, i2, i3]),
            payload_bytes: u16::from_le_bytes([p0, p1]),
            count: u32::from_le_bytes([c0, c1, c2, c3]),
            ttl_us: u16::from_le_bytes([t0, t1]),
        })
    }

    /// Whether every value is in its range, for packets with `room` bytes of payload, `[APP-06]`.
    fn in_range(&self, room: usize) -> bool {
        self.count == 0
            || (INTERVAL_US_MIN..=INTERVAL_US_MAX).contains(&self.interval_us)
                && (HEAD_BYTES..=room).contains(&usize::from(self.payload_bytes))
                && self.ttl_us > 0
    }
}

/// What became of the stream that a request ended, or of the one it repeats, `[APP-08]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StreamAnswer {
    /// Datagrams sent.
    pub sent: u32,
    /// Datagrams shed.
    pub shed: u32,
}

impl StreamAnswer {
    /// Bytes an answer takes.
    pub const LEN: usize = 8;

    /// The answer's bytes.
    #[must_use]
    pub fn encode(&self) -> [u8; Self::LEN] {
        let mut out = [0; Self::LEN];
        out[..4].copy_from_slice(&self.sent.to_le_bytes());
        out[4..].copy_from_slice(&self.shed.to_le_bytes());
        out
    }

    /// Reads an answer; `None` where it has another length.
    #[must_use]
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let [s0, s1, s2, s3, d0, d1, d2, d3] = *bytes.as_array::<{ Self::LEN }>()?;
        Some(Self { sent: u32::from_le_bytes([s0, s1, s2, s3]), shed: u32::from_le_bytes([d0, d1, d2, d3]) })
    }
}

/// Why a request was refused, `[APP-06]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum StreamRefusal {
    /// It has another length than a request.
    Malformed = 1,
    /// A value is outside its range.
    Range = 2,
}

/// A datagram's number and when it was made, `[APP-07]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StreamHead {
    /// Which one, from 0; numbers that are missing were shed or lost.
    pub number: u32,
    /// The sender's own counter.
    pub made: LocalTicks,
}

impl StreamHead {
    /// The head's bytes.
    #[must_use]
    pub fn encode(&self) -> [u8; HEAD_BYTES] {
        let mut out = [0; HEAD_BYTES];
        out[..4].copy_from_slice(&self.number.to_le_bytes());
        out[4..].copy_from_slice(&self.made.steps().to_le_bytes());
        out
    }

    /// Reads the head of a payload; `None` where it is cut short.
    #[must_use]
    pub fn decode(payload: &[u8]) -> Option<Self> {
        let (number, rest) = payload.split_first_chunk::<4>()?;
        let (made, _) = rest.split_first_chunk::<8>()?;
        let made = LocalTicks::from_steps(u64::from_le_bytes(*made));
        Some(Self { number: u32::from_le_bytes(*number), made })
    }
}

/// Which request started a stream: the same one again is a retry, `[APP-08]`.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Asker {
    back: RouteBuf,
    port: PortIndex,
    sequence: Sequence,
}

/// A stream under way, or the last one there was.
#[derive(Debug)]
struct Run {
    asker: Asker,
    request: StreamRequest,
    mtu_bytes: u16,
    /// Number of the next datagram.
    next: u32,
    /// When it is due.
    due: LocalTicks,
    /// What its request was answered.
    answer: StreamAnswer,
    so_far: StreamAnswer,
}

impl Run {
    const fn is_over(&self) -> bool {
        self.next >= self.request.count
    }

    /// Passes over one due instant.
    fn advance(&mut self) {
        self.next += 1;
        self.due = self.due + Span::from_us(u64::from(self.request.interval_us));
    }

    /// Passes over all that is due at `now`, unsent.
    fn shed_due(&mut self, now: LocalTicks) {
        if self.is_over() || self.due > now {
            return;
        }
        let interval = Span::from_us(u64::from(self.request.interval_us));
        let late = now.since(self.due).steps() / interval.steps() + 1;
        let skipped = u32::try_from(late).unwrap_or(u32::MAX).min(self.request.count - self.next);
        self.next += skipped;
        self.due = self.due + interval.saturating_mul(u64::from(skipped));
        self.so_far.shed = self.so_far.shed.saturating_add(skipped);
    }
}

/// The stream service.
#[derive(Debug, Default)]
pub struct Stream {
    run: Option<Run>,
}

impl Stream {
    /// No stream.
    #[must_use]
    pub const fn new() -> Self {
        Self { run: None }
    }

    /// Answers one packet; only requests are served. The node's packets have at most `packet_bytes_max` bytes.
    pub fn accept(&mut self, node: &mut impl Mailbox, delivery: Delivery, packet_bytes_max: usize, now: LocalTicks) {
        match delivery.sequenced {
            Some(SequencedHeader { kind: SequencedKind::Request, sequence }) => {
                self.answer(node, delivery, sequence, packet_bytes_max, now);
            }
            Some(_) => node.release(delivery, Some(DropCause::ReplyUnmatched), now),
            None => node.release(delivery, Some(DropCause::PortRefused), now),
        }
    }

    /// Sends from `port` what is due, with payloads out of `scratch`.
    pub fn poll(&mut self, node: &mut impl Mailbox, port: PortIndex, scratch: &mut [u8], now: LocalTicks) {
        let Some(run) = &mut self.run else { return };
        for _ in 0..BURST_MAX {
            if run.is_over() || run.due > now {
                return;
            }
            let payload = &mut scratch[..usize::from(run.request.payload_bytes)];
            payload.fill(0);
            payload[..HEAD_BYTES].copy_from_slice(&StreamHead { number: run.next, made: now }.encode());
            let to = Outbound {
                route: run.asker.back.as_route(),
                mtu_bytes: run.mtu_bytes,
                ttl_us: run.request.ttl_us,
                destination: run.asker.port,
                transport: Transport::Datagram,
            };
            // a datagram that finds no slot is shed, and counted by the node under its cause as well, `[APP-09]`
            let count = match node.send(port, to, &[payload], now) {
                Ok(()) => &mut run.so_far.sent,
                Err(_) => &mut run.so_far.shed,
            };
            *count = count.saturating_add(1);
            run.advance();
        }
        run.shed_due(now);
    }

    /// When the next datagram is due.
    #[must_use]
    pub fn next_wake(&self) -> Option<LocalTicks> {
        self.run.as_ref().filter(|run| !run.is_over()).map(|run| run.due)
    }

    fn answer(
        &mut self,
        node: &mut impl Mailbox,
        delivery: Delivery,
        sequence: Sequence,
        packet_bytes_max: usize,
        now: LocalTicks,
    ) {
        let mtu_bytes = delivery.mtu_bytes;
        let asker = Asker { back: route_back(node, &delivery), port: delivery.source, sequence };
        // a sender may name a larger packet size than this node's own packets have
        let packet_bytes = usize::from(mtu_bytes).min(packet_bytes_max);
        let room = packet_bytes.saturating_sub(PORT_HEADER_BYTES + asker.back.as_route().bytes().len());
        let refusal = match node.with_payload(&delivery, StreamRequest::decode) {
            None => StreamRefusal::Malformed,
            Some(request) if !request.in_range(room) => StreamRefusal::Range,
            Some(request) => {
                let answer = self.begin(asker, request, mtu_bytes, now);
                // an answer that does not get away is counted by the node, and the request comes again
                let _counted = node.reply(delivery, &[&answer.encode()], now);
                return;
            }
        };
        let _counted = node.refuse(delivery, &[&[refusal as u8]], now);
    }

    /// Starts a stream in place of the one there was, and tells what became of that; a retry changes nothing.
    fn begin(&mut self, asker: Asker, request: StreamRequest, mtu_bytes: u16, now: LocalTicks) -> StreamAnswer {
        match &self.run {
            Some(run) if run.asker == asker && run.request == request => run.answer,
            last => {
                let answer = last.as_ref().map(|run| run.so_far).unwrap_or_default();
                let so_far = StreamAnswer::default();
                self.run = Some(Run { asker, request, mtu_bytes, next: 0, due: now, answer, so_far });
                answer
            }
        }
    }
}

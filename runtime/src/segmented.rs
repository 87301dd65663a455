//! Messages longer than a packet: cut, sent in a window, acknowledged, put together.
//!
//! - **Walk:** an application's message → [`Sender`] → packets → [`Receiver`] → the message again.
//! - **Invariants:** the receiver holds one message in fixed memory; a message arrives whole and in order or not at all.
//! - **Context:** the port's. **Clauses:** `[TRN-07]` to `[TRN-10]`.

use crate::mailbox::{Delivery, Mailbox, Outbound, SendError};
use fixed_math::time::{LocalTicks, Span};
use osap_protocol::header::PORT_HEADER_BYTES;
use osap_protocol::transport::{
    RETRIES_MAX, SEGMENT_IDLE_US, SEGMENT_WINDOW, SegmentHeader, SegmentRefusal, Transport,
};
use osap_protocol::{DropCause, PortIndex, Route, RouteBuf};

/// How a message ended, or that it has not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// Segments are under way.
    Sending {
        /// Segments acknowledged.
        done: u16,
        /// Segments in all.
        count: u16,
    },
    /// All segments were acknowledged.
    Done,
    /// The receiver would not take it.
    Refused(SegmentRefusal),
    /// Nothing moved for all tries.
    Failed {
        /// Segments acknowledged.
        done: u16,
        /// Segments in all.
        count: u16,
    },
}

/// Why a message cannot be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MessageError {
    /// It is empty.
    Empty,
    /// A packet of this route has no room for any of it.
    NoRoom {
        /// The route's packet size, bytes.
        mtu_bytes: u16,
    },
    /// It would take more than 65,535 segments.
    TooLong {
        /// Its length, bytes.
        len: usize,
        /// The most this route can carry.
        limit: usize,
    },
}

/// The sending side of one message. The message itself stays with the caller, who hands it in again at each call.
#[derive(Debug)]
pub struct Sender {
    port: PortIndex,
    route: RouteBuf,
    mtu_bytes: u16,
    ttl_us: u16,
    destination: PortIndex,
    message: u8,
    segment_bytes: usize,
    count: u16,
    /// Segments acknowledged.
    done: u16,
    /// Next segment to send.
    next: u16,
    /// When something last moved, or the window was last sent again.
    moved: LocalTicks,
    tries: u8,
    progress: Progress,
}

impl Sender {
    /// Prepares a message of `len` bytes, numbered `message`, from `port`. Numbers go up from message to message, from a first one that differs
    /// from boot to boot: the receiver tells a repeated segment from a new message by them.
    ///
    /// # Errors
    /// [`MessageError`].
    pub fn new(
        port: PortIndex,
        to: &Outbound<'_>,
        message: u8,
        len: usize,
        now: LocalTicks,
    ) -> Result<Self, MessageError> {
        let head = PORT_HEADER_BYTES + to.route.bytes().len() + SegmentHeader::DATA_LEN;
        let segment_bytes = usize::from(to.mtu_bytes).saturating_sub(head);
        if segment_bytes == 0 {
            return Err(MessageError::NoRoom { mtu_bytes: to.mtu_bytes });
        }
        if len == 0 {
            return Err(MessageError::Empty);
        }
        let limit = segment_bytes * usize::from(u16::MAX);
        let count = u16::try_from(len.div_ceil(segment_bytes)).map_err(|_| MessageError::TooLong { len, limit })?;
        Ok(Self {
            port,
            route: RouteBuf::from(to.route),
            mtu_bytes: to.mtu_bytes,
            ttl_us: to.ttl_us,
            destination: to.destination,
            message,
            segment_bytes,
            count,
            done: 0,
            next: 0,
            moved: now,
            tries: 0,
            progress: Progress::Sending { done: 0, count },
        })
    }

    /// How far it is.
    #[must_use]
    pub const fn progress(&self) -> Progress {
        self.progress
    }

    /// Takes an acknowledgement or refusal that came to the port; `false` where it is not for this message.
    pub fn accept(&mut self, header: SegmentHeader, now: LocalTicks) -> bool {
        let Progress::Sending { .. } = self.progress else {
            // what ended it may come again, and is no more than that
            return matches!(
                header,
                SegmentHeader::Acknowledge { message, .. } | SegmentHeader::Refuse { message, .. } if message == self.message
            );
        };
        match header {
            SegmentHeader::Acknowledge { message, next } if message == self.message => {
                if next > self.done && next <= self.next {
                    self.done = next;
                    self.moved = now;
                    self.tries = 0;
                    self.progress = Progress::Sending { done: self.done, count: self.count };
                }
                if self.done == self.count {
                    self.progress = Progress::Done;
                }
                true
            }
            SegmentHeader::Refuse { message, reason } if message == self.message => {
                self.progress = Progress::Refused(reason);
                true
            }
            _ => false,
        }
    }

    /// Sends what the window lets through, `[TRN-10]`. `message` is all of the message.
    pub fn poll(&mut self, node: &mut impl Mailbox, message: &[u8], now: LocalTicks) -> Progress {
        let Progress::Sending { .. } = self.progress else { return self.progress };
        if now.since(self.moved) >= Span::from_us(u64::from(self.ttl_us)) {
            if self.tries == RETRIES_MAX {
                self.progress = Progress::Failed { done: self.done, count: self.count };
                return self.progress;
            }
            self.tries += 1;
            self.moved = now;
            self.next = self.done;
        }
        while self.next < self.count && self.next - self.done < SEGMENT_WINDOW {
            if self.send_next(node, message, now).is_err() {
                break; // the hold is full for now; the window goes on when asked again
            }
            self.next += 1;
        }
        self.progress
    }

    /// When [`Sender::poll`] has something to do even if nothing comes.
    #[must_use]
    pub fn next_wake(&self) -> LocalTicks {
        self.moved + Span::from_us(u64::from(self.ttl_us))
    }

    fn send_next(&mut self, node: &mut impl Mailbox, message: &[u8], now: LocalTicks) -> Result<(), SendError> {
        let start = usize::from(self.next) * self.segment_bytes;
        let segment = message.get(start..).unwrap_or_default();
        let segment = &segment[..segment.len().min(self.segment_bytes)];
        let mut head = [0; SegmentHeader::LEN_MAX];
        let len = SegmentHeader::Data { message: self.message, index: self.next, count: self.count }.encode(&mut head);
        let to = Outbound {
            route: self.route.as_route(),
            mtu_bytes: self.mtu_bytes,
            ttl_us: self.ttl_us,
            destination: self.destination,
            transport: Transport::Segmented,
        };
        node.send(self.port, to, &[&head[..len], segment], now)
    }
}

/// Who is sending a message, and which.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Source {
    back: RouteBuf,
    port: PortIndex,
    message: u8,
}

/// What a data packet did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// The message goes on.
    Partial,
    /// The message is whole: read [`Receiver::message`] before the next packet.
    Whole,
    /// It was dropped or refused, and counted.
    Dropped,
    /// It is for a [`Sender`]: an acknowledgement or refusal.
    ForSender(SegmentHeader),
}

/// The receiving side: one message of up to `BYTES` bytes at a time.
#[derive(Debug)]
pub struct Receiver<const BYTES: usize> {
    buffer: heapless::Vec<u8, BYTES>,
    source: Option<Source>,
    count: u16,
    next: u16,
    segment_bytes: usize,
    heard: LocalTicks,
}

impl<const BYTES: usize> Receiver<BYTES> {
    /// Waits for a first segment.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            buffer: heapless::Vec::new(),
            source: None,
            count: 0,
            next: 0,
            segment_bytes: 0,
            heard: LocalTicks::ZERO,
        }
    }

    /// The message, once it is whole, or what there is of it.
    #[must_use]
    pub fn message(&self) -> &[u8] {
        &self.buffer
    }

    /// Takes a segmented packet and answers it in its own slot.
    pub fn accept(&mut self, node: &mut impl Mailbox, delivery: Delivery, now: LocalTicks) -> Received {
        let parsed = node.with_payload(&delivery, |payload| {
            SegmentHeader::parse(payload).map(|(header, data)| (header, payload.len() - data.len()))
        });
        let (message, index, count, head) = match parsed {
            Ok((SegmentHeader::Data { message, index, count }, head)) => (message, index, count, head),
            Ok((other, _)) => {
                node.release(delivery, None, now);
                return Received::ForSender(other);
            }
            Err(cause) => {
                node.release(delivery, Some(cause), now);
                return Received::Dropped;
            }
        };
        let back =
            node.with_taken_steps(&delivery, |taken| Route::check(taken).map(RouteBuf::from).unwrap_or_default());
        let source = Source { back, port: delivery.source, message };
        let idle = now.since(self.heard) >= Span::from_us(SEGMENT_IDLE_US);
        let same = self.is_same(&source, index, count, idle);
        if !same && self.in_progress() && !idle {
            return refuse(node, delivery, message, SegmentRefusal::Busy, now);
        }
        if !same && (index > 0 || (!idle && self.is_older(&source))) {
            // the middle of a message that is not under way here, or one that was whole before the last: it claims nothing
            node.release(delivery, Some(DropCause::SegmentOutOfOrder), now);
            return Received::Dropped;
        }
        if !same {
            self.begin(source, count);
        }
        let verdict =
            node.with_payload(&delivery, |payload| self.append(index, count, payload.get(head..).unwrap_or_default()));
        if let Ok(()) | Err(DropCause::SegmentOutOfOrder) = verdict {
            self.heard = now;
        }
        match verdict {
            Ok(()) => {
                let whole = self.next == self.count;
                acknowledge(node, delivery, message, self.next, now);
                if whole { Received::Whole } else { Received::Partial }
            }
            Err(DropCause::SegmentOutOfOrder) => {
                acknowledge(node, delivery, message, self.next, now);
                node.count_drop(DropCause::SegmentOutOfOrder, now);
                Received::Dropped
            }
            Err(DropCause::OverMtu) => {
                self.source = None;
                refuse(node, delivery, message, SegmentRefusal::TooLong, now)
            }
            Err(cause) => {
                node.release(delivery, Some(cause), now);
                Received::Dropped
            }
        }
    }

    /// Whether a segment belongs to the message that is, or was last, received here. A message already whole is only repeated while its
    /// last acknowledgement may have been lost; later, or of another length, it is a new one of the same number.
    fn is_same(&self, source: &Source, index: u16, count: u16, idle: bool) -> bool {
        let anew = !self.in_progress() && (idle || (index == 0 && count != self.count));
        self.source.as_ref() == Some(source) && !anew
    }

    /// Whether a message is one of the sender's before the last: numbers go up, and around.
    fn is_older(&self, source: &Source) -> bool {
        self.source.as_ref().is_some_and(|last| {
            let same_sender = last.port == source.port && last.back == source.back;
            same_sender && source.message.wrapping_sub(last.message).cast_signed() < 0
        })
    }

    fn in_progress(&self) -> bool {
        self.source.is_some() && self.next < self.count
    }

    fn begin(&mut self, source: Source, count: u16) {
        self.buffer.clear();
        self.source = Some(source);
        self.count = count;
        self.next = 0;
        self.segment_bytes = 0;
    }

    /// Puts a segment in its place, `[TRN-08]`, `[TRN-09]`; `OverMtu` stands for a message over `BYTES`.
    fn append(&mut self, index: u16, count: u16, data: &[u8]) -> Result<(), DropCause> {
        if count != self.count {
            return Err(DropCause::SegmentInvalid);
        }
        if index != self.next {
            return Err(DropCause::SegmentOutOfOrder);
        }
        let last = index + 1 == count;
        if index == 0 {
            self.segment_bytes = data.len();
        }
        // all but the last are of one length, so the first one tells whether the whole will fit
        if index == 0 && usize::from(count - 1) * data.len() > BYTES {
            return Err(DropCause::OverMtu);
        }
        let fits = if last { data.len() <= self.segment_bytes } else { data.len() == self.segment_bytes };
        if !fits || data.is_empty() {
            return Err(DropCause::SegmentInvalid);
        }
        self.buffer.extend_from_slice(data).map_err(|_| DropCause::OverMtu)?;
        self.next += 1;
        Ok(())
    }
}

impl<const BYTES: usize> Default for Receiver<BYTES> {
    fn default() -> Self {
        Self::new()
    }
}

fn acknowledge(node: &mut impl Mailbox, delivery: Delivery, message: u8, next: u16, now: LocalTicks) {
    answer(node, delivery, SegmentHeader::Acknowledge { message, next }, now);
}

fn refuse(
    node: &mut impl Mailbox,
    delivery: Delivery,
    message: u8,
    reason: SegmentRefusal,
    now: LocalTicks,
) -> Received {
    answer(node, delivery, SegmentHeader::Refuse { message, reason }, now);
    Received::Dropped
}

fn answer(node: &mut impl Mailbox, delivery: Delivery, header: SegmentHeader, now: LocalTicks) {
    let mut out = [0; SegmentHeader::LEN_MAX];
    let len = header.encode(&mut out);
    // an answer that does not get away is counted by the node; the sender will send again
    let _counted = node.reply(delivery, &[&out[..len]], now);
}

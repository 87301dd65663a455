//! One message longer than a packet, sent to a port that sends one back.
//!
//! - **Walk:** [`HostCore::start_message`] → segments out, acknowledgements in → segments of the answer in → [`MessageOutcome`].
//! - **Invariants:** one message at a time; it ends once, at the latest at its deadline, however little comes.
//! - **Context:** the host's node. **Clauses:** `[TRN-07]` to `[TRN-10]`.

use super::{HostCore, outbound};
use fixed_math::time::{LocalTicks, Span};
use osap_protocol::header::way_back;
use osap_protocol::transport::{SegmentHeader, SegmentRefusal, Transport};
use osap_protocol::{DropCause, PortIndex, Route, RouteBuf};
use osap_runtime::segmented::{MessageError, Progress, Received, Receiver, Sender};
use osap_runtime::sequenced::Destination;
use osap_runtime::{Delivery, Mailbox};

/// Longest message the host takes, bytes.
pub const MESSAGE_BYTES_MAX: usize = 64 << 10;

/// What came of a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum MessageOutcome {
    /// It arrived, and this came back.
    Answered {
        /// The answer.
        message: Vec<u8>,
        /// From the start of the one to the end of the other.
        round_trip: Span,
    },
    /// The receiver would not take it.
    Refused(SegmentRefusal),
    /// Nothing moved for all tries.
    Stuck {
        /// Segments acknowledged.
        done: u16,
        /// Segments in all.
        count: u16,
    },
    /// It arrived; nothing came back in time.
    NoAnswer,
}

#[derive(Debug)]
struct Active {
    sender: Sender,
    /// Who it goes to, and who alone may acknowledge and answer it.
    peer: (RouteBuf, PortIndex),
    number: u8,
    message: Vec<u8>,
    started: LocalTicks,
    deadline: LocalTicks,
}

/// The message under way, if any, and what comes back.
#[derive(Debug, Default)]
pub(super) struct Exchange {
    active: Option<Active>,
    receiver: Box<Receiver<MESSAGE_BYTES_MAX>>,
    outcome: Option<MessageOutcome>,
    /// Number of the next message, so that a late acknowledgement of the one before counts for nothing.
    number: u8,
}

impl Exchange {
    /// Nothing under way; `first` differs from process to process, `[TRN-09]`.
    pub(super) fn new(first: u8) -> Self {
        Self { number: first, ..Self::default() }
    }

    pub(super) fn next_wake(&self) -> Option<LocalTicks> {
        let active = self.active.as_ref()?;
        match active.sender.progress() {
            Progress::Sending { .. } => Some(active.sender.next_wake().min(active.deadline)),
            _ => Some(active.deadline),
        }
    }

    /// Sends what the window lets through; tells whether the message ended by it.
    pub(super) fn run(&mut self, node: &mut impl Mailbox, now: LocalTicks) -> bool {
        let Some(active) = &mut self.active else { return false };
        let outcome = match active.sender.poll(node, &active.message, now) {
            Progress::Refused(reason) => MessageOutcome::Refused(reason),
            Progress::Failed { done, count } => MessageOutcome::Stuck { done, count },
            Progress::Sending { done, count } if active.deadline <= now => MessageOutcome::Stuck { done, count },
            Progress::Done if active.deadline <= now => MessageOutcome::NoAnswer,
            Progress::Sending { .. } | Progress::Done => return false,
        };
        self.end(outcome);
        true
    }

    /// Takes a segmented packet.
    pub(super) fn accept(&mut self, node: &mut impl Mailbox, delivery: Delivery, now: LocalTicks) {
        let arrived = delivery.arrived;
        if !self.is_from_peer(node, &delivery) {
            node.release(delivery, Some(DropCause::ReplyUnmatched), now);
            return;
        }
        match self.receiver.accept(node, delivery, now) {
            Received::ForSender(header) => {
                if let Some(active) = &mut self.active {
                    active.sender.accept(header, now);
                }
            }
            Received::Whole => {
                if let Some(active) = &self.active {
                    let round_trip = arrived.since(active.started);
                    let message = self.receiver.message().to_vec();
                    self.end(MessageOutcome::Answered { message, round_trip });
                }
            }
            Received::Partial | Received::Dropped => {}
        }
    }

    /// Whether a segmented packet comes by the way, from the port and under the number of the message under way.
    fn is_from_peer(&self, node: &mut impl Mailbox, delivery: &Delivery) -> bool {
        let Some(active) = &self.active else { return false };
        let parsed = node.with_payload(delivery, |payload| SegmentHeader::parse(payload).map(|(header, _)| header));
        let Ok(header) = parsed else { return false };
        let (SegmentHeader::Data { message, .. }
        | SegmentHeader::Acknowledge { message, .. }
        | SegmentHeader::Refuse { message, .. }) = header;
        let (route, port) = &active.peer;
        let by_the_way = node.with_taken_steps(delivery, |taken| {
            way_back(Route::check(taken).unwrap_or(Route::LOCAL)).eq(route.as_route().steps())
        });
        message == active.number && delivery.source == *port && by_the_way
    }

    fn end(&mut self, outcome: MessageOutcome) {
        self.active = None;
        self.outcome = Some(outcome);
    }
}

impl HostCore {
    /// Starts a message from the stream port; another one that is under way is given up.
    ///
    /// # Errors
    /// [`MessageError`].
    pub fn start_message(
        &mut self,
        to: &Destination,
        message: &[u8],
        within: Span,
        now: LocalTicks,
    ) -> Result<(), MessageError> {
        let exchange = &mut self.exchange;
        let outbound = outbound(to, Transport::Segmented);
        let sender = Sender::new(self.stream, &outbound, exchange.number, message.len(), now)?;
        let number = exchange.number;
        exchange.number = number.wrapping_add(1);
        exchange.outcome = None;
        let peer = (to.route.clone(), to.port);
        exchange.active =
            Some(Active { sender, peer, number, message: message.to_vec(), started: now, deadline: now + within });
        self.run(now);
        Ok(())
    }

    /// What came of the message, once it has ended.
    pub fn take_message_outcome(&mut self) -> Option<MessageOutcome> {
        self.exchange.outcome.take()
    }
}

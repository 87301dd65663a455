//! The echo port: sends back what comes, in the transport it came in.
//!
//! - **Walk:** stack → *here* → a reply in the same slot, or for a message its segments, one window at a time.
//! - **Invariants:** one message is received at a time and one is sent back; who comes in between is told that it is busy.
//! - **Context:** the serving task; O(packet), and O(window) where a message goes back. **Clauses:** `[APP-02]`, `[APP-03]`, `[APP-04]`.

use fixed_math::time::LocalTicks;
use osap_protocol::header::way_back;
use osap_protocol::transport::{SegmentHeader, SegmentRefusal, SequencedKind, Transport};
use osap_protocol::{DropCause, PortIndex, Route, RouteBuf};
use osap_runtime::segmented::{Progress, Received, Receiver, Sender};
use osap_runtime::{Delivery, Mailbox, Outbound};

/// Time to live of the segments of a message that goes back, µs, `[APP-04]`.
pub const ECHO_TTL_US: u16 = 50_000;

/// Who sent the message that goes back: ports and numbers alone are the same on many nodes.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Asker {
    back: RouteBuf,
    port: PortIndex,
    message: u8,
}

/// The echo service, for messages of up to `MESSAGE_BYTES` bytes.
#[derive(Debug)]
pub struct Echo<const MESSAGE_BYTES: usize> {
    receiver: Receiver<MESSAGE_BYTES>,
    /// The message that goes back: the receiver's buffer is free for the next one.
    outbox: heapless::Vec<u8, MESSAGE_BYTES>,
    sending: Option<(Asker, Sender)>,
}

impl<const MESSAGE_BYTES: usize> Echo<MESSAGE_BYTES> {
    /// Nothing under way.
    #[must_use]
    pub const fn new() -> Self {
        Self { receiver: Receiver::new(), outbox: heapless::Vec::new(), sending: None }
    }

    /// Answers one packet. `scratch` holds the longest packet.
    pub fn accept(&mut self, node: &mut impl Mailbox, delivery: Delivery, scratch: &mut [u8], now: LocalTicks) {
        match (delivery.transport, delivery.sequenced.map(|header| header.kind)) {
            (Transport::Segmented, _) => {
                let packet_bytes_max = u16::try_from(scratch.len()).unwrap_or(u16::MAX);
                self.accept_segment(node, delivery, packet_bytes_max, now);
            }
            (_, Some(SequencedKind::Reply | SequencedKind::Refusal)) => {
                node.release(delivery, Some(DropCause::ReplyUnmatched), now);
            }
            (Transport::Datagram | Transport::Sequenced, _) => {
                let copied = node.with_payload(&delivery, |payload| {
                    let copy = scratch.get_mut(..payload.len())?;
                    copy.copy_from_slice(payload);
                    Some(&*copy)
                });
                let Some(copy) = copied else {
                    node.release(delivery, Some(DropCause::PortRefused), now);
                    return;
                };
                // an answer that does not get away is counted by the node
                let _counted = node.reply(delivery, &[copy], now);
            }
        }
    }

    /// Sends on what a message under way lets through.
    pub fn poll(&mut self, node: &mut impl Mailbox, now: LocalTicks) {
        if let Some((_, sender)) = &mut self.sending
            && !matches!(sender.poll(node, &self.outbox, now), Progress::Sending { .. })
        {
            self.sending = None;
        }
    }

    /// When [`Echo::poll`] has something to do even if nothing comes.
    #[must_use]
    pub fn next_wake(&self) -> Option<LocalTicks> {
        self.sending.as_ref().map(|(_, sender)| sender.next_wake())
    }

    fn accept_segment(&mut self, node: &mut impl Mailbox, delivery: Delivery, packet_bytes_max: u16, now: LocalTicks) {
        let header = node.with_payload(&delivery, |payload| SegmentHeader::parse(payload).map(|(header, _)| header));
        let (port, back) = (delivery.port, route_back(node, &delivery));
        let asker = match header {
            Ok(
                SegmentHeader::Data { message, .. }
                | SegmentHeader::Acknowledge { message, .. }
                | SegmentHeader::Refuse { message, .. },
            ) => Some(Asker { back, port: delivery.source, message }),
            Err(_) => None,
        };
        let of_another = matches!((&asker, &self.sending), (Some(asker), Some((served, _))) if asker != served);
        if of_another && !matches!(header, Ok(SegmentHeader::Data { .. })) {
            // only who is served may say what has arrived
            node.release(delivery, Some(DropCause::ReplyUnmatched), now);
            return;
        }
        if let Some(asker) = asker.as_ref().filter(|_| of_another) {
            // `[APP-04]`: the outbox is not free
            let mut out = [0; SegmentHeader::LEN_MAX];
            let len = SegmentHeader::Refuse { message: asker.message, reason: SegmentRefusal::Busy }.encode(&mut out);
            let _counted = node.reply(delivery, &[&out[..len]], now);
            return;
        }
        // a sender may name a larger packet size than this node's own packets have
        let mtu_bytes = delivery.mtu_bytes.min(packet_bytes_max);
        match self.receiver.accept(node, delivery, now) {
            Received::Whole => {
                if let Some(asker) = asker {
                    self.send_back(asker, port, mtu_bytes, now);
                }
            }
            Received::ForSender(header) => {
                if !self.sending.as_mut().is_some_and(|(_, sender)| sender.accept(header, now)) {
                    node.count_drop(DropCause::ReplyUnmatched, now);
                }
            }
            Received::Partial | Received::Dropped => {}
        }
    }

    /// Begins to send the message just received back, `[APP-03]`.
    fn send_back(&mut self, asker: Asker, port: PortIndex, mtu_bytes: u16, now: LocalTicks) {
        self.outbox.clear();
        // as long as the receiver's own buffer, so it always fits
        let fits = self.outbox.extend_from_slice(self.receiver.message());
        debug_assert!(fits.is_ok());
        let to = Outbound {
            route: asker.back.as_route(),
            mtu_bytes,
            ttl_us: ECHO_TTL_US,
            destination: asker.port,
            transport: Transport::Segmented,
        };
        // what came in segments by this route's packets can go back by them
        let sender = Sender::new(port, &to, asker.message, self.outbox.len(), now);
        self.sending = sender.ok().map(|sender| (asker, sender));
    }
}

impl<const MESSAGE_BYTES: usize> Default for Echo<MESSAGE_BYTES> {
    fn default() -> Self {
        Self::new()
    }
}

/// The route from here to a delivery's sender, to be kept after the delivery has gone.
pub(crate) fn route_back(node: &mut impl Mailbox, delivery: &Delivery) -> RouteBuf {
    let taken = node.with_taken_steps(delivery, |taken| Route::check(taken).map(RouteBuf::from).unwrap_or_default());
    let mut back = RouteBuf::new();
    for step in way_back(taken.as_route()) {
        // as long as the way here, which fitted
        let fits = back.push(step);
        debug_assert!(fits.is_ok());
    }
    back
}

//! The asking side of the sequenced transport: numbers requests, repeats them, matches what comes back.
//!
//! - **Walk:** a netrunner or caller → [`Client::request`] → the network → [`Client::accept`] from its port.
//! - **Invariants:** each request ends once: answered, refused or failed; at most `REQUESTS` are open. A number is not used again
//!   while its request is open.
//! - **Context:** the port's. **Clauses:** `[TRN-04]`, `[TRN-05]`, `[NOD-12]`.

use crate::mailbox::{Delivery, Mailbox, Outbound, SendError};
use fixed_math::time::{LocalTicks, Span};
use osap_protocol::transport::{RETRIES_MAX, Sequence, SequencedHeader, SequencedKind, Transport};
use osap_protocol::{DropCause, PortIndex, RouteBuf};

/// Where a request goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Destination {
    /// Steps to the node.
    pub route: RouteBuf,
    /// Smallest packet size of the links on the route, bytes.
    pub mtu_bytes: u16,
    /// Time for the whole exchange, µs; after that it is tried again.
    pub ttl_us: u16,
    /// The port asked.
    pub port: PortIndex,
}

/// Which request an outcome belongs to: the number it was sent under.
pub type Ticket = Sequence;

/// Whether one reply ends a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Expect {
    /// It does.
    One,
    /// A broadcast: everything that comes until the TTL has run out; sent once.
    Many,
}

#[derive(Debug)]
struct Pending<const REQUEST_BYTES: usize> {
    ticket: Ticket,
    to: Destination,
    expect: Expect,
    payload: heapless::Vec<u8, REQUEST_BYTES>,
    /// When it was last sent.
    sent: LocalTicks,
    tries: u8,
}

impl<const REQUEST_BYTES: usize> Pending<REQUEST_BYTES> {
    fn due(&self) -> LocalTicks {
        self.sent + Span::from_us(u64::from(self.to.ttl_us))
    }
}

/// What came of a delivery to the client's port.
#[derive(Debug)]
pub enum Accepted {
    /// An answer; read its payload, then release it.
    Answer {
        /// Of which request.
        ticket: Ticket,
        /// Reply or refusal.
        kind: SequencedKind,
        /// Time since the request was last sent.
        round_trip: Span,
        /// How often it was sent.
        tries: u8,
        /// The packet.
        delivery: Delivery,
    },
    /// None of ours: counted and released.
    Unmatched,
    /// Not an answer at all: the port may serve it itself.
    Other(Delivery),
}

/// Why a request was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RequestError {
    /// As many requests are open as there may be.
    Busy {
        /// How many that is.
        limit: usize,
    },
    /// The request is longer than the client can keep for a retry.
    TooLong {
        /// Its length, bytes.
        len: usize,
        /// The most there may be.
        limit: usize,
    },
    /// The node could not send it.
    Send(SendError),
}

/// A request that ended without one answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ended {
    /// Which.
    pub ticket: Ticket,
    /// How often it was sent.
    pub tries: u8,
    /// `Expect::One`: it failed. `Expect::Many`: its time is over.
    pub expect: Expect,
}

/// Up to `REQUESTS` open requests of up to `REQUEST_BYTES` bytes each, from one port.
#[derive(Debug)]
pub struct Client<const REQUESTS: usize, const REQUEST_BYTES: usize> {
    port: PortIndex,
    next: Sequence,
    pending: heapless::Vec<Pending<REQUEST_BYTES>, REQUESTS>,
}

impl<const REQUESTS: usize, const REQUEST_BYTES: usize> Client<REQUESTS, REQUEST_BYTES> {
    /// A client that sends from `port`. `first` should differ from boot to boot, so that late replies of an earlier life match nothing.
    #[must_use]
    pub const fn new(port: PortIndex, first: Sequence) -> Self {
        const { assert!(REQUESTS < 1 << 13, "numbers of open requests stay distinct") };
        Self { port, next: first, pending: heapless::Vec::new() }
    }

    /// Open requests.
    #[must_use]
    pub fn open(&self) -> usize {
        self.pending.len()
    }

    /// Sends a request and keeps it until it ends.
    ///
    /// # Errors
    /// [`RequestError`]; nothing is kept then.
    pub fn request(
        &mut self,
        node: &mut impl Mailbox,
        to: Destination,
        expect: Expect,
        payload: &[u8],
        now: LocalTicks,
    ) -> Result<Ticket, RequestError> {
        if self.pending.is_full() {
            return Err(RequestError::Busy { limit: REQUESTS });
        }
        let too_long = RequestError::TooLong { len: payload.len(), limit: REQUEST_BYTES };
        let payload = heapless::Vec::from_slice(payload).map_err(|_| too_long)?;
        while self.pending.iter().any(|pending| pending.ticket == self.next) {
            self.next = self.next.next();
        }
        let pending = Pending { ticket: self.next, to, expect, payload, sent: now, tries: 1 };
        send(node, self.port, &pending, now).map_err(RequestError::Send)?;
        self.next = self.next.next();
        let ticket = pending.ticket;
        self.pending.push(pending).map_err(|_| RequestError::Busy { limit: REQUESTS })?;
        Ok(ticket)
    }

    /// Matches what the port took, `[TRN-04]`.
    pub fn accept(&mut self, node: &mut impl Mailbox, delivery: Delivery, now: LocalTicks) -> Accepted {
        let Some(SequencedHeader { kind: kind @ (SequencedKind::Reply | SequencedKind::Refusal), sequence }) =
            delivery.sequenced
        else {
            return Accepted::Other(delivery);
        };
        let of = |pending: &Pending<REQUEST_BYTES>| pending.ticket == sequence && pending.to.port == delivery.source;
        let Some(at) = self.pending.iter().position(of) else {
            node.release(delivery, Some(DropCause::ReplyUnmatched), now);
            return Accepted::Unmatched;
        };
        let (round_trip, tries) = (now.since(self.pending[at].sent), self.pending[at].tries);
        if self.pending[at].expect == Expect::One {
            self.pending.swap_remove(at);
        }
        Accepted::Answer { ticket: sequence, kind, round_trip, tries, delivery }
    }

    /// Sends again what has waited for its TTL, `[TRN-05]`, and tells of one request that has ended so; call until `None`.
    pub fn poll(&mut self, node: &mut impl Mailbox, now: LocalTicks) -> Option<Ended> {
        for at in 0..self.pending.len() {
            let pending = &mut self.pending[at];
            if pending.due() > now {
                continue;
            }
            if pending.expect == Expect::Many || pending.tries > RETRIES_MAX {
                let Pending { ticket, tries, expect, .. } = self.pending.swap_remove(at);
                return Some(Ended { ticket, tries, expect });
            }
            pending.tries += 1;
            pending.sent = now;
            // a try that could not be sent is counted by the node, and waits like one that was lost
            let _counted = send(node, self.port, pending, now);
        }
        None
    }

    /// When [`Client::poll`] has something to do.
    #[must_use]
    pub fn next_wake(&self) -> Option<LocalTicks> {
        self.pending.iter().map(Pending::due).min()
    }
}

fn send<const N: usize>(
    node: &mut impl Mailbox,
    port: PortIndex,
    pending: &Pending<N>,
    now: LocalTicks,
) -> Result<(), SendError> {
    let header = SequencedHeader { kind: SequencedKind::Request, sequence: pending.ticket }.encode();
    let to = Outbound {
        route: pending.to.route.as_route(),
        mtu_bytes: pending.to.mtu_bytes,
        ttl_us: pending.to.ttl_us,
        destination: pending.to.port,
        transport: Transport::Sequenced,
    };
    node.send(port, to, &[&header, &pending.payload], now)
}

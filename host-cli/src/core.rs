//! The host's own node, sans-IO: one runtime, the netrunner that asks on it, and a port for streams of datagrams and long messages.
//!
//! - **Walk:** [`HostCore::request`] → the node's stack → a link → … → a reply at the netrunner's port → [`HostCore::take_completion`].
//! - **Invariants:** every request ends in exactly one [`Completion`] that says `last`. Every queue is bounded: requests are refused
//!   before a completion could be lost; what streams in beyond the bound, and events that nobody asks for, are counted.
//! - **Context:** one: the node's thread over real links, or the thread that steps a simulated world. Time is an argument.
//! - **Clauses:** `[TRN-04]`, `[TRN-05]`, `[NOD-12]`, `[TIM-07]`, `[TIM-14]`, `[PKT-14]` (the host asks its own node as it asks any other).

mod endpoint;
mod message;

pub use message::{MESSAGE_BYTES_MAX, MessageOutcome};

use fixed_math::time::{LocalTicks, Span};
use message::Exchange;
use osap_protocol::discovery::{BuildKind, LinkInfo, Neighbour, NeighbourChange, TimeSettings, UniqueId};
use osap_protocol::time::PRIORITY_NEVER;
use osap_protocol::transport::{Sequence, SequencedKind, Transport};
use osap_protocol::{DropCause, GatewayIndex, PortIndex, Route, RouteBuf};
use osap_runtime::sequenced::{Accepted, Client, Destination, Ended, Expect, RequestError, Ticket};
use osap_runtime::{Delivery, GatewayConfig, Identity, Mailbox, Node, Outbound, PortConfig, SendError, SystemTime};
use std::collections::VecDeque;

/// Packets the host's node holds at once.
pub const SLOTS: usize = 256;
/// Largest packet the host's node takes, bytes.
pub const PACKET_BYTES_MAX: usize = 2048;
/// Links the host can have: one number is kept, see `network::real`.
pub const LINKS_MAX: usize = 63;
/// Requests open at once.
pub const REQUESTS_MAX: usize = 64;
/// Longest request, bytes.
pub const REQUEST_BYTES_MAX: usize = 512;
/// Completions and datagrams kept for whoever asks.
pub const QUEUE_MAX: usize = 1024;
/// Events kept; the oldest make way.
pub const EVENTS_MAX: usize = 256;

/// Packets that either port of the host may hold.
const PORT_HOLD: u8 = 64;
/// Packets that may come in by one link before the host has served them.
const LINK_HOLD: u8 = 64;

type HostNode = Node<SLOTS, PACKET_BYTES_MAX, 64, 8>;

/// Who the host is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HostIdentity {
    /// Which host; another one for each process that scans at a time.
    pub unique_id: UniqueId,
    /// Another number for each run.
    pub boot_epoch: u32,
    /// Its name in the map.
    pub name: String,
}

/// An answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reply {
    /// Its payload, behind the transport's header.
    pub payload: Vec<u8>,
    /// The steps that the answer took, turned back: a route to whoever answered.
    pub route: RouteBuf,
    /// When the answer's frame ended, by the host's clock.
    pub arrived: LocalTicks,
    /// From the last time the request was sent to then.
    pub round_trip: Span,
    /// How often it was sent.
    pub tries: u8,
}

/// What came of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Answered.
    Reply(Reply),
    /// Refused; the payload says why.
    Refusal(Reply),
    /// `Expect::One`: nobody answered any try.
    Timeout {
        /// How often it was sent.
        tries: u8,
    },
    /// `Expect::Many`: its time is over.
    Ended,
}

/// A request came to something.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Completion {
    /// Which.
    pub ticket: Ticket,
    /// Whether it has ended with this.
    pub last: bool,
    /// What.
    pub outcome: Outcome,
}

/// A datagram that came to the port for streams.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Datagram {
    /// Steps that lead to the sender.
    pub route: RouteBuf,
    /// The sender's port.
    pub port: PortIndex,
    /// When its frame ended.
    pub arrived: LocalTicks,
    /// What it carries.
    pub payload: Vec<u8>,
}

/// Something happened at one of the host's links.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NetworkEvent {
    /// When, by the host's clock.
    pub at: LocalTicks,
    /// Which link.
    pub gateway: GatewayIndex,
    /// What.
    pub kind: EventKind,
}

/// What happened at a link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum EventKind {
    /// It can carry packets.
    Up,
    /// It cannot; for people.
    Down(String),
    /// Another device is, or is no longer, at its other end, `[SYS-04]`.
    Neighbour {
        /// How it changed.
        change: NeighbourChange,
        /// Who is there now.
        now: Option<Neighbour>,
    },
}

/// What went over the host's links since it was made.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Packets sent.
    pub sent: u64,
    /// Packets received and accepted.
    pub received: u64,
    /// Packets and frames dropped, by cause; only those that happened.
    pub dropped: Vec<(DropCause, u32)>,
    /// Requests sent for the first time.
    pub requests: u64,
    /// Requests sent again.
    pub retries: u64,
    /// Requests that nobody answered.
    pub timeouts: u64,
    /// Events that made way for newer ones before anybody asked.
    pub events_missed: u64,
}

/// The host's node and what runs on it.
#[derive(Debug)]
pub struct HostCore {
    node: Box<HostNode>,
    netrunner: PortIndex,
    stream: PortIndex,
    client: Box<Client<REQUESTS_MAX, REQUEST_BYTES_MAX>>,
    completions: VecDeque<Completion>,
    datagrams: VecDeque<Datagram>,
    events: VecDeque<NetworkEvent>,
    exchange: Exchange,
    statistics: Statistics,
    turn: u64,
}

impl HostCore {
    /// A host without links.
    #[must_use]
    pub fn new(identity: &HostIdentity) -> Self {
        let (node, [netrunner, stream]) = boxed_node(identity);
        let first = Sequence::new(u16::from_le_bytes([identity.unique_id.0[4], identity.unique_id.0[5]]));
        let mut core = Self {
            node,
            netrunner,
            stream,
            client: Box::new(Client::new(netrunner, first)),
            completions: VecDeque::new(),
            datagrams: VecDeque::new(),
            events: VecDeque::new(),
            exchange: Exchange::new(identity.unique_id.0[6]),
            statistics: Statistics::default(),
            turn: 0,
        };
        core.set_root(PRIORITY_NEVER);
        core
    }

    /// Goes up with all that happens here: who waits for something need not look before.
    #[must_use]
    pub const fn turn(&self) -> u64 {
        self.turn
    }

    /// Adds a link, closed; `None` where there are [`LINKS_MAX`]. What it may hold is the host's to say.
    pub fn add_link(&mut self, config: GatewayConfig) -> Option<GatewayIndex> {
        if self.node.gateway_indices().count() >= LINKS_MAX {
            return None;
        }
        self.node.add_gateway(GatewayConfig { packet_hold_max: LINK_HOLD, ..config })
    }

    /// A link opened, or closed for the reason given.
    pub fn set_link(&mut self, gateway: GatewayIndex, down: Option<String>, now: LocalTicks) {
        let was_open = self.node.gateway(gateway).is_some_and(osap_runtime::gateway::Gateway::is_open);
        self.node.set_open(gateway, down.is_none(), now);
        match down {
            None if !was_open => self.note(NetworkEvent { at: now, gateway, kind: EventKind::Up }),
            Some(reason) => self.note(NetworkEvent { at: now, gateway, kind: EventKind::Down(reason) }),
            None => {}
        }
    }

    /// The host's links as any scanner would see them.
    #[must_use]
    pub fn links(&self) -> Vec<LinkInfo> {
        self.node.gateway_indices().filter_map(|index| Some(self.node.gateway(index)?.info())).collect()
    }

    /// Who the host is.
    #[must_use]
    pub fn unique_id(&self) -> UniqueId {
        self.node.identity().unique_id
    }

    /// The port that datagrams and long messages leave from and come back to.
    #[must_use]
    pub const fn stream_port(&self) -> PortIndex {
        self.stream
    }

    /// Requests that have not ended.
    #[must_use]
    pub fn open_requests(&self) -> usize {
        self.client.open()
    }

    /// Sends a request; what comes of it is a [`Completion`].
    ///
    /// # Errors
    /// [`RequestError`]; `Busy` also where completions were not taken for too long.
    pub fn request(
        &mut self,
        to: Destination,
        expect: Expect,
        payload: &[u8],
        now: LocalTicks,
    ) -> Result<Ticket, RequestError> {
        if self.completions.len() >= QUEUE_MAX {
            return Err(RequestError::Busy { limit: QUEUE_MAX });
        }
        let ticket = self.client.request(&mut *self.node, to, expect, payload, now)?;
        self.statistics.requests += 1;
        self.run(now); // a request to the host itself needs no link to be answered
        Ok(ticket)
    }

    /// What came of a request, in order of arrival.
    pub fn take_completion(&mut self) -> Option<Completion> {
        self.completions.pop_front()
    }

    /// Sends a datagram from the stream port.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn send_datagram(&mut self, to: &Destination, payload: &[u8], now: LocalTicks) -> Result<(), SendError> {
        self.node.send(self.stream, outbound(to, Transport::Datagram), &[payload], now)
    }

    /// A datagram that came to the stream port.
    pub fn take_datagram(&mut self) -> Option<Datagram> {
        self.datagrams.pop_front()
    }

    /// What happened at the links, in order.
    pub fn take_event(&mut self) -> Option<NetworkEvent> {
        self.events.pop_front()
    }

    /// What went over the links so far.
    #[must_use]
    pub fn statistics(&self) -> Statistics {
        let links = self.links();
        let counters = self.node.counters();
        let count = |cause: &DropCause| Some((*cause, counters.of(*cause))).filter(|(_, n)| *n > 0);
        Statistics {
            sent: links.iter().map(|link| u64::from(link.sent)).sum(),
            received: links.iter().map(|link| u64::from(link.received)).sum(),
            dropped: DropCause::ALL.iter().filter_map(count).collect(),
            ..self.statistics.clone()
        }
    }

    /// Does what is due: the node's own duties, answers to open requests, retries, the message under way.
    pub fn run(&mut self, now: LocalTicks) {
        self.turn = self.turn.wrapping_add(1);
        loop {
            self.node.run(now);
            // what is sent to the host itself is delivered in the next round
            if !(self.serve_netrunner(now) | self.serve_stream(now) | self.poll_requests(now)) {
                break;
            }
        }
        while let Some((gateway, change)) = self.node.take_neighbour_change() {
            let now_there = self.node.gateway(gateway).and_then(osap_runtime::gateway::Gateway::neighbour);
            self.note(NetworkEvent { at: now, gateway, kind: EventKind::Neighbour { change, now: now_there } });
        }
    }

    /// System time at `at` by the host's clock.
    #[must_use]
    pub fn system_time(&self, at: LocalTicks) -> SystemTime {
        self.node.system_time(at)
    }

    /// Offers itself as root by `priority`, `[TIM-07]`; a host that nobody told follows others only.
    pub fn set_root(&mut self, priority: u8) {
        let settings = TimeSettings { priority, ..self.node.clock().settings() };
        // the settings it has are within their ranges, and every priority is
        let _in_range = self.node.clock_mut().set(settings);
    }

    /// Offers UNIX time, µs since 1970 at `now`, once its own time is settled, `[TIM-14]`; tells whether it did.
    pub fn offer_unix(&mut self, unix_us: i64, now: LocalTicks) -> bool {
        let is_settled = self.node.clock().is_settled();
        if is_settled {
            self.node.clock_mut().offer_unix(unix_us, now);
        }
        is_settled
    }

    /// When [`HostCore::run`], or a link's transmitter, has something to do even if no packet comes.
    #[must_use]
    pub fn next_wake(&self) -> Option<LocalTicks> {
        [self.node.next_wake(), self.client.next_wake(), self.exchange.next_wake()].into_iter().flatten().min()
    }

    /// Takes what came to the netrunner, as long as there is room for what comes of it.
    fn serve_netrunner(&mut self, now: LocalTicks) -> bool {
        let mut served = false;
        while self.completions.len() < QUEUE_MAX
            && let Some(delivery) = self.node.take(self.netrunner, now)
        {
            served = true;
            // the frame's own stamp, so that the host's scheduling is no part of a round trip
            let arrived = delivery.arrived;
            let open = self.client.open();
            match self.client.accept(&mut *self.node, delivery, arrived) {
                Accepted::Answer { ticket, kind, round_trip, tries, delivery } => {
                    let last = self.client.open() < open;
                    let reply = self.read_reply(delivery, round_trip, tries, now);
                    let outcome = match kind {
                        SequencedKind::Refusal => Outcome::Refusal(reply),
                        SequencedKind::Reply | SequencedKind::Request => Outcome::Reply(reply),
                    };
                    self.completions.push_back(Completion { ticket, last, outcome });
                }
                Accepted::Unmatched => {}
                Accepted::Other(delivery) => self.node.release(delivery, Some(DropCause::PortRefused), now),
            }
        }
        served
    }

    /// Takes what came to the stream port: datagrams, and the segments of messages.
    fn serve_stream(&mut self, now: LocalTicks) -> bool {
        let mut served = self.exchange.run(&mut *self.node, now);
        while let Some(delivery) = self.node.take(self.stream, now) {
            served = true;
            match delivery.transport {
                Transport::Segmented => self.exchange.accept(&mut *self.node, delivery, now),
                Transport::Datagram if self.datagrams.len() < QUEUE_MAX => {
                    let datagram = Datagram {
                        route: self.way_back(&delivery),
                        port: delivery.source,
                        arrived: delivery.arrived,
                        payload: self.node.payload(&delivery).to_vec(),
                    };
                    self.datagrams.push_back(datagram);
                    self.node.release(delivery, None, now);
                }
                Transport::Datagram | Transport::Sequenced => {
                    self.node.release(delivery, Some(DropCause::PortRefused), now);
                }
            }
        }
        served
    }

    /// Sends again what waited too long; tells whether something was sent or ended.
    fn poll_requests(&mut self, now: LocalTicks) -> bool {
        let due = self.client.next_wake().is_some_and(|at| at <= now);
        while let Some(Ended { ticket, tries, expect }) = self.client.poll(&mut *self.node, now) {
            let outcome = match expect {
                Expect::One => Outcome::Timeout { tries },
                Expect::Many => Outcome::Ended,
            };
            self.statistics.timeouts += u64::from(expect == Expect::One);
            self.statistics.retries += u64::from(tries.saturating_sub(1));
            self.completions.push_back(Completion { ticket, last: true, outcome });
        }
        due
    }

    fn read_reply(&mut self, delivery: Delivery, round_trip: Span, tries: u8, now: LocalTicks) -> Reply {
        let reply = Reply {
            payload: self.node.payload(&delivery).to_vec(),
            route: self.way_back(&delivery),
            arrived: delivery.arrived,
            round_trip,
            tries,
        };
        self.statistics.retries += u64::from(tries.saturating_sub(1));
        self.node.release(delivery, None, now);
        reply
    }

    /// The steps a delivery took, turned back, `[PKT-09]`.
    fn way_back(&self, delivery: &Delivery) -> RouteBuf {
        let taken = Route::check(self.node.taken_steps(delivery)).unwrap_or(Route::LOCAL);
        let steps: Vec<_> = taken.steps().collect();
        let mut back = RouteBuf::new();
        for step in steps.into_iter().rev() {
            // a route that came in is no longer than one that goes out
            let _fits = back.push(step);
        }
        back
    }

    fn note(&mut self, event: NetworkEvent) {
        if self.events.len() >= EVENTS_MAX {
            self.events.pop_front();
            self.statistics.events_missed += 1;
        }
        self.events.push_back(event);
    }
}

fn outbound(to: &Destination, transport: Transport) -> Outbound<'_> {
    Outbound { route: to.route.as_route(), mtu_bytes: to.mtu_bytes, ttl_us: to.ttl_us, destination: to.port, transport }
}

/// Makes the node on a thread with room for it: half a megabyte may pass over the stack on its way into the box, which is more than
/// what a test's thread has to spare.
fn boxed_node(identity: &HostIdentity) -> (Box<HostNode>, [PortIndex; 2]) {
    let make = || {
        let config = Identity {
            type_name: "osap-host",
            unique_id: identity.unique_id,
            boot_epoch: identity.boot_epoch,
            version: VERSION,
            build: BuildKind::Host,
        };
        let mut node = Box::new(HostNode::new(config, &identity.name));
        let port = |type_name| PortConfig { type_name, name: "", packet_hold_max: PORT_HOLD };
        let ports =
            ["netrunner", "stream"].map(|name| node.add_port(port(name)).expect("a node has room for three ports"));
        (node, ports)
    };
    std::thread::scope(|scope| {
        let maker = std::thread::Builder::new().name("osap-core".into()).stack_size(16 << 20);
        let thread = maker.spawn_scoped(scope, make).expect("the system has memory for one more thread");
        thread.join().expect("making a node does not panic")
    })
}

/// Version of this crate: major, minor, patch.
const VERSION: [u8; 3] = [0, 1, 0];

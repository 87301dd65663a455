//! A workstation for tests: asks, sends messages, and keeps what comes.
#![allow(dead_code, reason = "each test file uses a part")]

use fixed_math::time::{LocalTicks, Span};
use osap_protocol::discovery::{BuildKind, Query, TimeSettings, UniqueId};
use osap_protocol::header::{Arrival, SYSTEM_HEADER_BYTES};
use osap_protocol::system::ANNOUNCE_TTL_US;
use osap_protocol::time::TimeReply;
use osap_protocol::transport::{SegmentHeader, Sequence, SequencedKind, Transport};
use osap_protocol::{DropCause, GatewayIndex, Packet, PortIndex, RouteBuf, Step};
use osap_runtime::debug::DebugRing;
use osap_runtime::segmented::{Progress, Received, Receiver, Sender};
use osap_runtime::sequenced::{Accepted, Client, Destination, Expect};
use osap_runtime::{Delivery, GatewayConfig, Identity, Mailbox, Node, Outbound, Outgoing, PortConfig, SendError};
use osap_sim::device::SimDevice;
use osap_sim::endpoint::Endpoint;
use osap_sim::processor::Processor;
use osap_sim::time::ClockModel;
use osap_sim::world::{NodeId, World};

pub(crate) const SLOTS: usize = 32;
pub(crate) const PORT: PortConfig = PortConfig { type_name: "probe", name: "", packet_hold_max: 16 };

/// An answer that came.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Answer {
    pub(crate) ticket: Sequence,
    pub(crate) kind: SequencedKind,
    pub(crate) round_trip: Span,
    pub(crate) tries: u8,
    pub(crate) payload: Vec<u8>,
}

/// The workstation.
pub(crate) struct Probe {
    pub(crate) node: Node<SLOTS, 256, 4, 2>,
    pub(crate) port: PortIndex,
    client: Client<16, 64>,
    sending: Option<(Sender, Vec<u8>)>,
    receiver: Receiver<8192>,
    pub(crate) answers: Vec<Answer>,
    pub(crate) failed: usize,
    pub(crate) datagrams: Vec<(LocalTicks, Vec<u8>)>,
    pub(crate) messages: Vec<Vec<u8>>,
    pub(crate) progress: Option<Progress>,
    /// Time to live of each packet that came in, announcements left out.
    pub(crate) ttls_us: Vec<u16>,
    /// Stamp of the first byte, and hand-over, of each of these.
    pub(crate) stamps: Vec<(LocalTicks, LocalTicks)>,
}

impl Probe {
    pub(crate) fn new(gateways: &[GatewayConfig]) -> Box<Self> {
        Self::numbered(0, gateways)
    }

    /// One of several in a world: a time that comes from one's own id is not believed.
    pub(crate) fn numbered(number: u8, gateways: &[GatewayConfig]) -> Box<Self> {
        let mut unique_id = UniqueId(*b"probe.......");
        unique_id.0[11] = number;
        let identity =
            Identity { type_name: "probe", unique_id, boot_epoch: 1, version: [0, 1, 0], build: BuildKind::Simulated };
        let mut node = Node::new(identity, "probe");
        let port = node.add_port(PORT).unwrap();
        for config in gateways {
            node.add_gateway(*config).unwrap();
        }
        Box::new(Self {
            node,
            port,
            client: Client::new(port, Sequence::new(7)),
            sending: None,
            receiver: Receiver::new(),
            answers: Vec::new(),
            failed: 0,
            datagrams: Vec::new(),
            messages: Vec::new(),
            progress: None,
            ttls_us: Vec::new(),
            stamps: Vec::new(),
        })
    }

    pub(crate) fn ask(&mut self, to: Destination, payload: &[u8], now: LocalTicks) -> Sequence {
        self.client.request(&mut self.node, to, Expect::One, payload, now).unwrap()
    }

    pub(crate) fn ask_all(&mut self, to: Destination, payload: &[u8], now: LocalTicks) -> Sequence {
        self.client.request(&mut self.node, to, Expect::Many, payload, now).unwrap()
    }

    pub(crate) fn datagram(&mut self, to: &Destination, payload: &[u8], now: LocalTicks) -> Result<(), SendError> {
        let to = outbound(to, Transport::Datagram);
        self.node.send(self.port, to, &[payload], now)
    }

    pub(crate) fn message(&mut self, to: &Destination, number: u8, message: Vec<u8>, now: LocalTicks) {
        let sender = Sender::new(self.port, &outbound(to, Transport::Segmented), number, message.len(), now).unwrap();
        self.sending = Some((sender, message));
    }

    fn take_in(&mut self, delivery: Delivery, now: LocalTicks) {
        match delivery.transport {
            Transport::Datagram => {
                self.datagrams.push((now, self.node.payload(&delivery).to_vec()));
                self.node.release(delivery, None, now);
            }
            Transport::Sequenced => match self.client.accept(&mut self.node, delivery, now) {
                Accepted::Answer { ticket, kind, round_trip, tries, delivery } => {
                    let payload = self.node.payload(&delivery).to_vec();
                    self.answers.push(Answer { ticket, kind, round_trip, tries, payload });
                    self.node.release(delivery, None, now);
                }
                Accepted::Unmatched => {}
                Accepted::Other(delivery) => self.node.release(delivery, Some(DropCause::PortRefused), now),
            },
            Transport::Segmented => match self.receiver.accept(&mut self.node, delivery, now) {
                Received::Whole => self.messages.push(self.receiver.message().to_vec()),
                Received::ForSender(header) => self.acknowledge(header, now),
                Received::Partial | Received::Dropped => {}
            },
        }
    }

    fn acknowledge(&mut self, header: SegmentHeader, now: LocalTicks) {
        if let Some((sender, _)) = &mut self.sending {
            sender.accept(header, now);
        }
    }
}

fn outbound(to: &Destination, transport: Transport) -> Outbound<'_> {
    Outbound { route: to.route.as_route(), mtu_bytes: to.mtu_bytes, ttl_us: to.ttl_us, destination: to.port, transport }
}

impl Endpoint for Probe {
    fn receive(&mut self, arrival: Arrival, packet: &mut [u8], started: LocalTicks, now: LocalTicks) {
        let ttl_us = Packet::check(&*packet).map(|view| view.ttl_us());
        if let (Ok(()), Ok(ttl_us)) = (self.node.receive(arrival, packet, started, now), ttl_us)
            && ttl_us != ANNOUNCE_TTL_US
        {
            self.ttls_us.push(ttl_us);
            self.stamps.push((started, now));
        }
    }

    fn run(&mut self, now: LocalTicks) {
        self.node.run(now);
        while let Some(delivery) = self.node.take(self.port, now) {
            self.take_in(delivery, now);
        }
        while self.client.poll(&mut self.node, now).is_some() {
            self.failed += 1;
        }
        if let Some((sender, message)) = &mut self.sending {
            let progress = sender.poll(&mut self.node, message, now);
            self.progress = Some(progress);
            if !matches!(progress, Progress::Sending { .. }) {
                self.sending = None;
            }
        }
    }

    fn waiting(&self, _now: LocalTicks) -> usize {
        self.node.waiting(PortIndex::NETRESPONDER) + self.node.waiting(self.port)
    }

    fn transmit(&mut self, gateway: GatewayIndex, now: LocalTicks, out: &mut [u8]) -> Option<Outgoing> {
        self.node.transmit(gateway, now, out)
    }

    fn has_output(&self, gateway: GatewayIndex, now: LocalTicks) -> bool {
        self.node.has_output(gateway, now)
    }

    fn next_wake(&self) -> Option<LocalTicks> {
        let sending = self.sending.as_ref().map(|(sender, _)| sender.next_wake());
        [self.node.next_wake(), self.client.next_wake(), sending].into_iter().flatten().min()
    }

    fn set_open(&mut self, gateway: GatewayIndex, open: bool, now: LocalTicks) {
        self.node.set_open(gateway, open, now);
    }

    fn count(&mut self, cause: DropCause, gateway: Option<GatewayIndex>, now: LocalTicks) {
        self.node.count(cause, gateway, now);
    }

    fn gateway_config(&self, gateway: GatewayIndex) -> Option<GatewayConfig> {
        self.node.gateway(gateway).map(|it| *it.config())
    }

    fn debug(&self) -> &DebugRing {
        self.node.debug()
    }

    fn debug_mut(&mut self) -> &mut DebugRing {
        self.node.debug_mut()
    }

    fn free_slots(&self) -> usize {
        self.node.free_slots()
    }
}

pub(crate) fn gateway(index: u8) -> GatewayIndex {
    GatewayIndex::new(index).unwrap()
}

pub(crate) fn port(index: u16) -> PortIndex {
    PortIndex::new(index).unwrap()
}

/// Over links with these gateways, to `port`.
pub(crate) fn over(links: &[u8], port_index: u16, ttl_us: u16) -> Destination {
    let mut route = RouteBuf::new();
    for link in links {
        route.push(Step::Link(gateway(*link))).unwrap();
    }
    Destination { route, mtu_bytes: 256, ttl_us, port: port(port_index) }
}

/// A query without a body.
pub(crate) fn query(key: Query) -> [u8; 2] {
    [key.key(), osap_protocol::discovery::VERSION]
}

/// Adds a probe whose processor takes no time.
pub(crate) fn add_probe(world: &mut World, gateways: &[GatewayConfig]) -> NodeId {
    let number = u8::try_from(world.nodes().count()).unwrap();
    world.add_node(Probe::numbered(number, gateways), Processor::INSTANT, ClockModel::PERFECT)
}

/// Does something with the probe now, and lets the world see to what that left to do.
pub(crate) fn with_probe<T>(world: &mut World, id: NodeId, act: impl FnOnce(&mut Probe, LocalTicks) -> T) -> T {
    let now = world.local_now(id);
    let result = act(world.endpoint_mut::<Probe>(id).unwrap(), now);
    let probe = world.endpoint_mut::<Probe>(id).unwrap();
    probe.run(now);
    world.poke(id);
    result
}

/// A gateway whose MTU is one byte too small for a reply about time over a link, and so too small for one over a bus as well: its node
/// neither asks nor answers there. All that is on its wire then is what a test sends, which has to be shorter, and announcements.
pub(crate) fn timeless(config: GatewayConfig) -> GatewayConfig {
    let reply_bytes = SYSTEM_HEADER_BYTES + 1 + TimeReply::LEN;
    GatewayConfig { mtu_bytes: u16::try_from(reply_bytes - 1).unwrap(), ..config }
}

/// How long [`hush`] takes. A burst is 200 requests, 5 ms apart and ±1/8, so it ends within 1.125 s, `[TIM-05]`; the few exchanges after
/// which it begins again, where a time is set anew, fit as well. The last announcement then was 10 ms ago.
pub(crate) const HUSH: Span = us(1_260_000);

/// Lets nodes on links find each other and ask each other for the time, and has them ask again in 8.75 s at the earliest, so that until
/// then no message but an announcement, four times a second, is on any wire. Buses are not hushed: roots search on, `[TIM-18]`.
pub(crate) fn hush(world: &mut World) {
    for node in world.nodes() {
        let clock = if let Some(probe) = world.endpoint_mut::<Probe>(node) {
            probe.node.clock_mut()
        } else if let Some(device) = world.endpoint_mut::<SimDevice>(node) {
            device.node_mut().clock_mut()
        } else {
            continue;
        };
        clock.set(TimeSettings { interval_us: 10_000_000, ..clock.settings() }).unwrap();
    }
    world.run_for(HUSH);
}

pub(crate) fn probe(world: &World, id: NodeId) -> &Probe {
    world.endpoint::<Probe>(id).unwrap()
}

pub(crate) const fn us(us: u64) -> Span {
    Span::from_us(us)
}

/// Nobody holds a slot, `[NOD-02]`: to be asked when everything has expired.
pub(crate) fn assert_all_slots_home(world: &World) {
    for node in world.nodes() {
        let slots = if world.endpoint::<Probe>(node).is_some() { SLOTS } else { osap_sim::device::SIM_SLOTS };
        assert_eq!(world.node(node).free_slots(), slots, "node {} at {:?}", node.at(), world.now());
    }
}

//! What inputs are fed to, and what must hold after each.

use fixed_math::time::LocalTicks;
use osap_protocol::discovery::{BuildKind, GatewayKind, UniqueId};
use osap_protocol::framing::{Check, Deframer, decode};
use osap_protocol::header::Arrival;
use osap_protocol::{BusDrop, DropCause, GatewayIndex, Packet, PortIndex, Route};
use osap_runtime::segmented::Receiver;
use osap_runtime::{GatewayConfig, Identity, Mailbox, Node, PortConfig, Stamps};

/// Something to feed.
pub(crate) trait Target {
    fn name(&self) -> &'static str;
    /// Takes one input; the error says which invariant it broke.
    fn feed(&mut self, bytes: &[u8]) -> Result<(), String>;
    /// How far inputs got.
    fn reached(&self) -> String;
}

pub(crate) fn ensure(holds: bool, what: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(what()) }
}

/// Frames byte by byte and by slice: both must agree, and what is accepted must carry its check.
pub(crate) struct FrameTarget {
    whole: u64,
    refused: u64,
}

/// Room of the receivers: smaller than the longest inputs.
const FRAME_ROOM: usize = 300;

impl FrameTarget {
    pub(crate) const fn new() -> Self {
        Self { whole: 0, refused: 0 }
    }

    #[cfg(test)]
    pub(crate) const fn whole(&self) -> u64 {
        self.whole
    }
}

impl Target for FrameTarget {
    fn name(&self) -> &'static str {
        "frame"
    }

    fn feed(&mut self, bytes: &[u8]) -> Result<(), String> {
        for check in [Check::None, Check::Crc16, Check::Crc32] {
            let mut deframer = Deframer::<FRAME_ROOM>::new(check);
            let mut begun = None;
            for (at, byte) in bytes.iter().enumerate() {
                if begun.is_none() && *byte != 0 {
                    begun = Some(at);
                }
                let Some(result) = deframer.push(*byte, LocalTicks::from_us(at as u64)) else { continue };
                let start = begun.take().ok_or("a frame ended that never began")?;
                let mut out = [0; FRAME_ROOM];
                let by_slice = decode(&bytes[start..=at], check, &mut out);
                match (result, by_slice) {
                    (Ok(frame), Ok(len)) => {
                        self.whole += 1;
                        ensure(frame.packet == &out[..len], || format!("{check:?}: stream and slice differ"))?;
                        ensure(frame.started == LocalTicks::from_us(start as u64), || {
                            "the stamp is not the first byte's".into()
                        })?;
                    }
                    (Err(_), Err(_)) => self.refused += 1,
                    (stream, slice) => {
                        return Err(format!("{check:?}: stream {:?}, slice {slice:?}", stream.map(|f| f.started)));
                    }
                }
            }
        }
        Ok(())
    }

    fn reached(&self) -> String {
        format!("{} frames whole, {} refused", self.whole, self.refused)
    }
}

/// Headers: checked views never panic, steps are all or nothing, turning back keeps length and way.
pub(crate) struct HeaderTarget {
    routable: u64,
    advanced: u64,
    turned: u64,
}

impl HeaderTarget {
    pub(crate) const fn new() -> Self {
        Self { routable: 0, advanced: 0, turned: 0 }
    }

    #[cfg(test)]
    pub(crate) const fn routable(&self) -> u64 {
        self.routable
    }
}

impl Target for HeaderTarget {
    fn name(&self) -> &'static str {
        "header"
    }

    fn feed(&mut self, bytes: &[u8]) -> Result<(), String> {
        let mut buffer = bytes.to_vec();
        let Ok(packet) = Packet::check(&mut buffer[..]) else { return Ok(()) };
        self.routable += 1;
        let _ = (packet.ttl_us(), packet.mtu_bytes(), packet.transport().map(|(_, rest)| rest.len()));
        let gateway = GatewayIndex::from_low_bits(bytes[1]);
        for arrival in [Arrival::Link(gateway), Arrival::Bus { gateway, from: BusDrop(bytes[2]) }] {
            let before = buffer.clone();
            let mut packet = Packet::check(&mut buffer[..]).map_err(|e| format!("no longer routable: {e}"))?;
            if packet.advance(arrival).is_ok() {
                self.advanced += 1;
                ensure(Packet::check(&buffer[..]).is_ok(), || "a step led to an unroutable packet".into())?;
                ensure(buffer[1..5] == before[1..5], || "a step wrote into the fixed header".into())?;
            } else {
                ensure(buffer == before, || "a refused step changed the packet".into())?;
            }
        }
        let before = buffer.clone();
        let mut packet = Packet::check(&mut buffer[..]).map_err(|e| format!("no longer routable: {e}"))?;
        let steps: Vec<_> = Route::check(packet.taken()).map(|route| route.steps().collect()).unwrap_or_default();
        if let Some(at) = packet.turn_back() {
            self.turned += 1;
            ensure(buffer.len() == before.len() && buffer[at..] == before[at..], || {
                "turning back touched the payload".into()
            })?;
            ensure(buffer[0] == 5, || "turning back left the pointer astray".into())?;
            let mut back: Vec<_> = Route::check(&buffer[5..at - 3]).map_err(|e| format!("{e:?}"))?.steps().collect();
            back.reverse();
            ensure(back == steps, || "the way back is not the way".into())?;
        } else {
            ensure(buffer == before, || "a refused turn changed the packet".into())?;
        }
        Ok(())
    }

    fn reached(&self) -> String {
        format!("{} routable, {} steps taken, {} turned back", self.routable, self.advanced, self.turned)
    }
}

type FuzzNode = Node<8, 256, 4, 4>;

/// A node with two links, a bus and a user port that answers: no panic, no slot lost, every packet accounted for.
pub(crate) struct NodeTarget {
    node: FuzzNode,
    deframer: Deframer<{ 256 + 2 }>,
    receiver: Receiver<300>,
    now_us: u64,
    inputs: u64,
    accepted: u64,
    sent: u64,
}

impl NodeTarget {
    pub(crate) fn new() -> Self {
        let identity = Identity {
            type_name: "fuzzed",
            unique_id: UniqueId([1; 12]),
            boot_epoch: 1,
            version: [0, 0, 1],
            build: BuildKind::Simulated,
        };
        let mut node = FuzzNode::new(identity, "fuzzed");
        let uart = GatewayConfig {
            type_name: "uart",
            kind: GatewayKind::Link,
            mtu_bytes: 256,
            bit_rate: 3_000_000,
            bits_a_byte: 10,
            check: Check::Crc16,
            packet_hold_max: 4,
            stamps: Stamps::SOFTWARE,
        };
        for config in [uart, uart, GatewayConfig { kind: GatewayKind::Bus { drop: 3 }, ..uart }] {
            if let Some(index) = node.add_gateway(config) {
                node.set_open(index, true, LocalTicks::ZERO);
            }
        }
        node.add_port(PortConfig { type_name: "answers", name: "", packet_hold_max: 4 });
        Self {
            node,
            deframer: Deframer::new(Check::Crc16),
            receiver: Receiver::new(),
            now_us: 1,
            inputs: 0,
            accepted: 0,
            sent: 0,
        }
    }

    #[cfg(test)]
    pub(crate) const fn accepted(&self) -> u64 {
        self.accepted
    }

    #[cfg(test)]
    pub(crate) fn causes_seen(&self) -> usize {
        DropCause::ALL.iter().filter(|cause| self.node.counters().of(**cause) > 0).count()
    }

    fn now(&self) -> LocalTicks {
        LocalTicks::from_us(self.now_us)
    }

    fn receive(&mut self, arrival: Arrival, packet: &mut [u8]) -> Result<(), String> {
        let before = self.node.counters().total();
        let now = self.now();
        match self.node.receive(arrival, packet, now, now) {
            Ok(()) => self.accepted += 1,
            Err(_) => ensure(self.node.counters().total() > before, || "a drop was not counted".into())?,
        }
        Ok(())
    }

    /// Lets the node and its port work off what waits, all of it or a part.
    fn work(&mut self, thoroughly: bool) {
        let now = self.now();
        self.node.run(now);
        if let Some(user) = PortIndex::new(1) {
            while let Some(delivery) = self.node.take(user, now) {
                if delivery.transport == osap_protocol::transport::Transport::Segmented {
                    self.receiver.accept(&mut self.node, delivery, now);
                } else {
                    let echo = self.node.payload(&delivery).to_vec();
                    let _counted = self.node.reply(delivery, &[&echo], now);
                }
                if !thoroughly {
                    break;
                }
            }
        }
        let mut out = [0; 256];
        for index in self.node.gateway_indices() {
            while self.node.transmit(index, now, &mut out).is_some() {
                self.sent += 1;
                if !thoroughly {
                    break;
                }
            }
        }
    }
}

impl Target for NodeTarget {
    fn name(&self) -> &'static str {
        "node"
    }

    fn feed(&mut self, bytes: &[u8]) -> Result<(), String> {
        self.inputs += 1;
        self.now_us += 1 + u64::from(bytes.first().copied().unwrap_or(0));
        let gateway = GatewayIndex::from_low_bits(u8::from(self.inputs.is_multiple_of(5)));
        let mut packet = bytes.to_vec();
        self.receive(Arrival::Link(gateway), &mut packet)?;
        let mut packet = bytes.to_vec();
        self.receive(Arrival::Bus { gateway: GatewayIndex::from_low_bits(2), from: BusDrop(9) }, &mut packet)?;
        for byte in bytes {
            let now = self.now();
            let frame = match self.deframer.push(*byte, now) {
                Some(Ok(frame)) => Some(frame.packet.to_vec()),
                Some(Err(error)) => {
                    self.node.count(error.into(), Some(gateway), now);
                    None
                }
                None => None,
            };
            if let Some(mut packet) = frame {
                self.receive(Arrival::Link(gateway), &mut packet)?;
            }
        }
        ensure(self.node.free_slots() + self.node.stacked() == 8, || "a slot is neither free nor stacked".into())?;
        self.work(!self.inputs.is_multiple_of(3));
        ensure(self.node.free_slots() + self.node.stacked() == 8, || "a slot was lost while working".into())?;
        if self.inputs.is_multiple_of(1_000) {
            self.now_us += 70_000;
            self.node.run(self.now());
            ensure(self.node.free_slots() == 8, || "a slot did not come home".into())?;
        }
        Ok(())
    }

    fn reached(&self) -> String {
        let seen: Vec<_> = DropCause::ALL
            .iter()
            .filter(|cause| self.node.counters().of(**cause) > 0)
            .map(|cause| format!("{} {}", cause.name(), self.node.counters().of(*cause)))
            .collect();
        format!("{} accepted, {} sent; drops: {}", self.accepted, self.sent, seen.join(", "))
    }
}

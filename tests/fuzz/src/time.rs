//! A node whose neighbour tells it anything about time: honest answers to its requests, and these with fields and bytes changed.
//!
//! - **Invariants asserted:** no panic; what is refused is counted; while something is live, settled time never runs backwards, and no
//!   faster than its slew allows; it is still settled. **Clauses:** `[TIM-06]`, `[TIM-10]`.

use crate::targets::{Target, ensure};
use fixed_math::time::{LocalTicks, NetTime, PeerTicks, Rate};
use osap_protocol::discovery::{BuildKind, GatewayKind, UniqueId};
use osap_protocol::framing::Check;
use osap_protocol::header::{Arrival, SYSTEM_HEADER_BYTES, Terminal, emit};
use osap_protocol::system::{ANNOUNCE_TTL_US, ANNOUNCEMENT_VERSION, Announcement, SystemKey};
use osap_protocol::time::{Root, TimeReply, TimeRequest, UnixOffset};
use osap_protocol::{DropCause, GatewayIndex, RouteBuf, Step};
use osap_runtime::{GatewayConfig, Identity, Node, Stamps};

const IT: UniqueId = UniqueId([9; 12]);
const GATEWAY: GatewayIndex = GatewayIndex::from_low_bits(0);
/// How far the neighbour's counter is ahead.
const AHEAD_US: u64 = 10_000_000;
/// Fastest that a map may be against its counter: a slew of a quarter against a line of three halves, `fixed_math::clock`; twice is above both.
const FASTEST: u64 = 2;

/// Answers about time.
pub(crate) struct TimeTarget {
    node: Node<8, 256, 1, 1>,
    at: LocalTicks,
    fed: u64,
    asked: u64,
    believed: u64,
    refused: u64,
}

/// Numbers out of an input, as many as are wanted.
struct Draws<'a>(&'a [u8]);

impl Draws<'_> {
    fn byte(&mut self) -> u8 {
        let (first, rest) = self.0.split_first().unwrap_or((&0, &[]));
        self.0 = rest;
        *first
    }

    /// Of all magnitudes.
    fn number(&mut self) -> u64 {
        let bytes = [0; 8].map(|_: u8| self.byte());
        u64::from_le_bytes(bytes) >> (self.byte() % 64)
    }
}

#[expect(clippy::cast_possible_truncation, reason = "any number will do")]
const fn low(number: u64) -> u32 {
    number as u32
}

impl TimeTarget {
    pub(crate) fn new() -> Self {
        let identity = Identity {
            type_name: "fuzzed",
            unique_id: UniqueId([5; 12]),
            boot_epoch: 1,
            version: [0, 1, 0],
            build: BuildKind::Simulated,
        };
        let mut node = Node::new(identity, "fuzzed");
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
        if let Some(index) = node.add_gateway(uart) {
            node.set_open(index, true, LocalTicks::ZERO);
        }
        node.clock_mut().set_live(true);
        Self { node, at: LocalTicks::from_us(1_000), fed: 0, asked: 0, believed: 0, refused: 0 }
    }

    #[cfg(test)]
    pub(crate) const fn outcomes(&self) -> (u64, u64) {
        (self.believed, self.refused)
    }

    fn message(&mut self, key: SystemKey, payload: &[u8]) -> Result<bool, String> {
        let mut packet = [0; 1024];
        let mut route = RouteBuf::new();
        let _fits = route.push(Step::Link(GATEWAY));
        let terminal = Terminal::System { key: key.key() };
        let at = emit(&mut packet, ANNOUNCE_TTL_US, 256, route.as_route(), terminal).map_err(|_| "no header")?;
        let room = packet.get_mut(at..at + payload.len()).ok_or("an input too long")?;
        room.copy_from_slice(payload);
        let before = self.node.counters().total();
        let result = self.node.receive(Arrival::Link(GATEWAY), &mut packet[..at + payload.len()], self.at, self.at);
        let counted = self.node.counters().total() - before;
        ensure(counted == u64::from(result.is_err()), || format!("{result:?} was counted {counted} times"))?;
        Ok(result.is_ok())
    }

    fn announce(&mut self, boot_epoch: u32) -> Result<(), String> {
        let announcement =
            Announcement { version: ANNOUNCEMENT_VERSION, unique_id: IT, boot_epoch, wants_answer: false, drop: None };
        let mut payload = [0; 64];
        let len = announcement.encode(&mut payload).map_err(|_| "no announcement")?;
        self.message(SystemKey::Announcement, &payload[..len]).map(drop)
    }

    /// The node's next request, if it has one now: its sequence and slot.
    fn request(&mut self) -> Option<(u8, u32)> {
        let mut packet = [0; 256];
        while let Some(out) = self.node.transmit(GATEWAY, self.at, &mut packet) {
            let payload = packet.get(SYSTEM_HEADER_BYTES + 1..out.len)?;
            if out.is_stamped
                && let Ok((TimeRequest { sequence, .. }, slot)) = TimeRequest::decode(payload)
            {
                return Some((sequence, slot));
            }
        }
        None
    }

    /// An honest answer: 20 µs there, 50 to answer, 20 back.
    fn honest(&mut self, (sequence, asked_slot): (u8, u32)) -> TimeReply {
        let heard = self.at.steps() + ((AHEAD_US + 20) << 8);
        self.at = self.at + fixed_math::time::Span::from_us(90);
        TimeReply {
            sequence,
            asked_slot,
            heard: PeerTicks::from_steps(heard),
            system: NetTime::from_steps(heard),
            tick_steps: 256,
            root: Root { priority: 128, unique_id: IT },
            is_settled: true,
            answered_slot: low(heard + (50 << 8)),
            ..TimeReply::default()
        }
    }
}

/// Changes one field, by a little or altogether.
fn change(it: &mut TimeReply, draws: &mut Draws<'_>) {
    let number = draws.number();
    let signed = if draws.byte() & 1 == 0 { number.cast_signed() } else { number.cast_signed().wrapping_neg() };
    match draws.byte() % 16 {
        0 => it.sequence = low(number).to_le_bytes()[0],
        1 => it.asked_slot = it.asked_slot.wrapping_add(low(number)),
        2 => it.heard = it.heard.shifted(signed),
        3 => {
            it.heard = it.heard.shifted(signed);
            it.answered_slot = low(it.heard.steps()).wrapping_add(50 << 8);
        }
        4 => it.system = it.system.shifted(signed),
        5 => it.rate = Rate::saturated(signed),
        6 => it.error_steps = low(number),
        7 => it.bound_steps = low(number),
        8 => it.drift_bits = low(number),
        9 => it.age_us = low(number),
        10 => it.tick_steps = u16::from_le_bytes([draws.byte(), draws.byte()]),
        11 => it.tier = draws.byte(),
        12 => it.root = Root { priority: draws.byte(), unique_id: UniqueId([draws.byte() % 10; 12]) },
        13 => (it.is_yours, it.is_settled) = (number & 1 != 0, number & 2 != 0),
        14 => it.unix = Some(UnixOffset { offset_us: signed, hops: draws.byte() }),
        _ => it.answered_slot = it.answered_slot.wrapping_add(low(number)),
    }
}

impl Target for TimeTarget {
    fn name(&self) -> &'static str {
        "time"
    }

    fn feed(&mut self, bytes: &[u8]) -> Result<(), String> {
        let mut draws = Draws(bytes);
        let _either = (TimeRequest::decode(bytes), TimeReply::decode(bytes));
        self.fed += 1;
        let (from, was_settled) = (self.at, self.node.clock().is_settled());
        let was = self.node.system_time(from).at;
        self.at = self.at + fixed_math::time::Span::from_us(60_000);
        // now and then it boots anew
        self.announce(u32::try_from(self.fed / 1_000).unwrap_or(0))?;
        if let Some(request) = self.request() {
            self.asked += 1;
            let mut reply = self.honest(request);
            // most are honest, or nothing would be settled for long
            for _ in 0..[1, 2, 3][..].get(usize::from(draws.byte() % 32)).copied().unwrap_or(0) {
                change(&mut reply, &mut draws);
            }
            let mut payload = [0; TimeReply::LEN];
            reply.encode(&mut payload).ok_or("no reply")?;
            if draws.byte() == 1 {
                let at = usize::from(draws.byte()) % payload.len();
                payload[at] = draws.byte();
            }
            let ok = self.message(SystemKey::TimeReply, &payload)?;
            *(if ok { &mut self.believed } else { &mut self.refused }) += 1;
        }
        let raw = bytes.get(..bytes.len().min(TimeReply::LEN + 2)).unwrap_or_default();
        let key = if self.fed.is_multiple_of(2) { SystemKey::TimeRequest } else { SystemKey::TimeReply };
        self.message(key, raw)?;
        self.node.run(self.at);
        while self.node.transmit(GATEWAY, self.at, &mut [0; 256]).is_some() {}
        let wake = self.node.next_wake().ok_or("nothing will ever be due")?;
        ensure(wake > self.at, || format!("still due at {wake:?} when it is {:?}", self.at))?;
        if !was_settled {
            return Ok(());
        }
        ensure(self.node.clock().is_settled(), || "what was settled and is live is so no more".into())?;
        let mut last = was;
        for part in 0..=8 {
            let now = from + fixed_math::time::Span::from_steps(self.at.since(from).steps() * part / 8);
            let time = self.node.system_time(now).at;
            // the part before the last answer was another map's
            ensure(part < 8 || time >= was, || format!("{was:?} became {time:?}"))?;
            last = last.max(time);
        }
        let passed = self.at.since(from).steps();
        let gained = last.steps_after(was);
        ensure(gained.unsigned_abs() <= FASTEST * passed + 4, || format!("{gained} steps in {passed}"))
    }

    fn reached(&self) -> String {
        let causes = [DropCause::TimeUnasked, DropCause::TimeOrder, DropCause::TimeAbsurd, DropCause::TimeTier];
        let counted = causes.map(|cause| format!("{} {}", cause.name(), self.node.counters().of(cause))).join(", ");
        let tier = self.node.clock().tier();
        format!("{} asked, {} believed, {} refused: {counted}; tier {tier}", self.asked, self.believed, self.refused)
    }
}

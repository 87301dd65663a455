//! A motion port that is told anything: random bytes, requests and points with fields of all sizes, halts, at any time.
//!
//! - **Invariants asserted:** no panic; every request is answered and no slot is lost; whatever was taken, no beat moves the first axis
//!   further than its velocity limit allows, nor out of its positions. **Clauses:** `[MOT-01]`, `[MOT-04]`, `[MOT-06]`.

use crate::targets::{Target, ensure};
use firmware_app::kind;
use firmware_app::motion::{MotionService, MotionTraits};
use firmware_app::services::Services;
use fixed_math::time::{LocalTicks, NetTime, Span};
use osap_maxl::device::{BeatOutput, BeatTraits, DeviceRings, Interpolator};
use osap_maxl::player::PlayerState;
use osap_protocol::discovery::{BuildKind, GatewayKind, UniqueId};
use osap_protocol::framing::Check;
use osap_protocol::halt::{Action, Halt};
use osap_protocol::header::{Arrival, Terminal, emit};
use osap_protocol::motion::{
    AxisSettings, CurveSettings, Message, MotionRequest, POINTS_MAX, Points, REPLY_BYTES_MAX, StarvedPolicy,
    TriggerSettings,
};
use osap_protocol::system::{ANNOUNCE_TTL_US, SystemKey};
use osap_protocol::transport::{Sequence, SequencedHeader, SequencedKind, Transport};
use osap_protocol::{GatewayIndex, PortIndex, RouteBuf, Step};
use osap_runtime::{GatewayConfig, Identity, Node, Stamps};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const GATEWAY: GatewayIndex = GatewayIndex::from_low_bits(0);
const PORT: PortIndex = PortIndex::from_low_bits(4);
const SLOTS: usize = 8;
/// A new device after so many inputs.
const ANEW: u64 = 100;
/// From one beat to the next, µs.
const BEAT_US: u64 = 64;

/// A motor that takes messages.
pub(crate) struct MotionTarget {
    node: Node<SLOTS, 256, 1, { kind::PORTS_MAX }>,
    services: Services<256, 64>,
    interpolator: Interpolator<'static>,
    at: LocalTicks,
    was: BeatOutput,
    /// What the first axis was last told to be.
    settings: Option<AxisSettings>,
    /// What it was told when it was last armed out of idleness.
    moves_by: Option<AxisSettings>,
    sequence: u16,
    fed: u64,
    /// What was sent last was refused.
    was_refused: bool,
    /// Where points go on, and where those that were taken do.
    next_us: u64,
    taken_us: u64,
    requests: u64,
    done: u64,
    refused: u64,
    moved: u64,
}

/// Numbers out of an input, as many as are wanted.
struct Draws<'a>(&'a [u8]);

impl Draws<'_> {
    fn byte(&mut self) -> u8 {
        let (first, rest) = self.0.split_first().unwrap_or((&0, &[]));
        self.0 = rest;
        *first
    }

    /// Of all magnitudes and both signs.
    #[expect(clippy::cast_possible_truncation, reason = "any number will do")]
    fn number(&mut self) -> i32 {
        let bytes = [0; 8].map(|_: u8| self.byte());
        (i64::from_le_bytes(bytes) >> (self.byte() % 64)) as i32
    }

    fn steps(&mut self) -> u64 {
        u64::from_le_bytes([0; 8].map(|_: u8| self.byte())) >> (self.byte() % 64)
    }
}

/// Settings that are mostly taken.
fn settings(draws: &mut Draws<'_>) -> AxisSettings {
    let flat = |value| CurveSettings { at_rest: value, at_full: value, knee: 0 };
    let good = AxisSettings {
        interval_log2: 10 + draws.byte() % 3,
        step_log2: 8,
        policy: [StarvedPolicy::Stop, StarvedPolicy::Hold, StarvedPolicy::Relax][usize::from(draws.byte() % 3)],
        missing_max: draws.byte() % 4,
        stop_log2: 16,
        position_min: -1_000_000,
        position_max: 1_000_000,
        velocity: 5_000,
        acceleration: flat(1_000),
        jerk: flat(400),
    };
    match draws.byte() {
        0 => AxisSettings { velocity: draws.number(), ..good },
        1 => AxisSettings { acceleration: flat(draws.number()), jerk: flat(draws.number()), ..good },
        2 => AxisSettings { position_min: draws.number(), position_max: draws.number(), ..good },
        3 => AxisSettings { interval_log2: draws.byte(), stop_log2: draws.byte(), ..good },
        _ => good,
    }
}

impl MotionTarget {
    pub(crate) fn new() -> Self {
        let unique_id = UniqueId([5; 12]);
        let identity =
            Identity { type_name: "fuzzed", unique_id, boot_epoch: 1, version: [0, 1, 0], build: BuildKind::Simulated };
        let mut node = Node::new(identity, "fuzzed");
        let uart = GatewayConfig {
            type_name: "uart",
            kind: GatewayKind::Link,
            mtu_bytes: 256,
            bit_rate: 0,
            bits_a_byte: 10,
            check: Check::Crc16,
            packet_hold_max: 6,
            stamps: Stamps::SOFTWARE,
        };
        for entry in kind::MOTOR.ports {
            let _fits = node.add_port(entry.config());
        }
        if let Some(index) = node.add_gateway(uart) {
            node.set_open(index, true, LocalTicks::ZERO);
        }
        // what plays tracks has its memory for good
        let rings = Box::leak(Box::new(DeviceRings::new()));
        let (motion, interpolator) = rings.split(BeatTraits { period_log2: 6, nominal_cycles: 8_000 });
        let mut services = Services::new(&kind::MOTOR);
        services.set_motion(MotionService::new(motion, MotionTraits { beat_us: 64, channels: 1, has_phases: false }));
        let mut it = Self {
            node,
            services,
            interpolator,
            at: LocalTicks::ZERO,
            was: BeatOutput::default(),
            settings: None,
            moves_by: None,
            sequence: 0,
            fed: 0,
            was_refused: false,
            next_us: 0,
            taken_us: 0,
            requests: 0,
            done: 0,
            refused: 0,
            moved: 0,
        };
        // until it is the root of its own time
        let _settled = it.pass(500_000 / BEAT_US);
        it
    }

    #[cfg(test)]
    pub(crate) const fn outcomes(&self) -> (u64, u64, u64) {
        (self.done, self.refused, self.moved)
    }

    /// Lets beats pass, and looks at each.
    fn pass(&mut self, beats: u64) -> Result<(), String> {
        for _ in 0..beats {
            self.at = self.at + Span::from_us(BEAT_US);
            self.node.run(self.at);
            self.services.serve(&mut self.node, self.at);
            let out = self.interpolator.beat(self.at, |_| 7);
            self.judge(&out)?;
            self.was = out;
        }
        Ok(())
    }

    fn judge(&mut self, out: &BeatOutput) -> Result<(), String> {
        let (was, is) = (self.was.first, out.first);
        if is.state == PlayerState::Idle || is.origin != was.origin || was.state == PlayerState::Idle {
            self.moves_by = self.settings;
            return Ok(());
        }
        let rested = matches!(was.state, PlayerState::Resting | PlayerState::Holding | PlayerState::Released);
        if rested && is.state == PlayerState::Following {
            // settings that came while it rested hold from here on: it was armed by them, and may rest where they would not let it
            self.moves_by = self.settings;
        }
        let Some(settings) = self.moves_by else { return Ok(()) };
        let way = u64::from(is.position.abs_diff(was.position));
        self.moved += u64::from(way > 0);
        let interval = 1_u64 << settings.interval_log2;
        // a position is off by less than one each time
        let most = (u64::from(settings.velocity.unsigned_abs()) * BEAT_US).div_ceil(interval) + 2;
        ensure(way <= most, || format!("{} to {} in a beat, where {most} is the most", was.position, is.position))?;
        let range = settings.position_min..=settings.position_max;
        ensure(range.contains(&is.position), || format!("{} is outside of {range:?}", is.position))
    }

    /// A message to the motion port; whether it was answered well, refused, or told nothing.
    fn send(&mut self, payload: &[u8], is_request: bool) -> Result<(), String> {
        let mut packet = [0; 512];
        let mut route = RouteBuf::new();
        let _fits = route.push(Step::Link(GATEWAY));
        let transport = if is_request { Transport::Sequenced } else { Transport::Datagram };
        let terminal =
            Terminal::Port { source: PortIndex::from_low_bits(9), destination: PORT, transport: transport.key() };
        let mut at = emit(&mut packet, 60_000, 256, route.as_route(), terminal).map_err(|_| "no header")?;
        if is_request {
            self.sequence = self.sequence.wrapping_add(1);
            let header = SequencedHeader { kind: SequencedKind::Request, sequence: Sequence::new(self.sequence) };
            packet[at..at + SequencedHeader::LEN].copy_from_slice(&header.encode());
            at += SequencedHeader::LEN;
        }
        let len = payload.len().min(256 - at);
        packet[at..at + len].copy_from_slice(&payload[..len]);
        let taken = self.node.receive(Arrival::Link(GATEWAY), &mut packet[..at + len], self.at, self.at);
        ensure(taken.is_ok(), || format!("{taken:?}"))?;
        self.services.serve(&mut self.node, self.at);
        let (mut answered, mut came_back) = (None, false);
        let mut out = [0; 256];
        while let Some(outgoing) = self.node.transmit(GATEWAY, self.at, &mut out) {
            // pointer 5, TTL, MTU, link, port; then the transport's key and its header
            let kind = out.get(9..12).filter(|_| outgoing.len > 12 && out[6] >> 6 == 3);
            came_back |= kind.is_some_and(|kind| kind[0] == Transport::Datagram.key());
            if let Some([1, low, high]) = kind {
                answered = Some(u16::from_le_bytes([*low, *high]) >> 14);
            }
        }
        ensure(!is_request || answered.is_some(), || "a request without an answer".to_owned())?;
        ensure(self.node.free_slots() == SLOTS, || format!("{} slots are left", self.node.free_slots()))?;
        self.was_refused = answered == Some(2) || came_back;
        self.requests += u64::from(is_request);
        self.done += u64::from(answered == Some(1));
        self.refused += u64::from(answered == Some(2));
        if let (Some(1), Some(Message::Request(MotionRequest::Configure { axis: 0, settings }))) =
            (answered, Message::decode(&payload[..len]))
        {
            self.settings = Some(settings);
        }
        Ok(())
    }

    fn request(&mut self, request: &MotionRequest) -> Result<(), String> {
        let mut bytes = [0; REPLY_BYTES_MAX];
        let len = request.encode(&mut bytes).ok_or("a request too long")?;
        self.send(&bytes[..len], true)
    }

    fn system_now(&self) -> NetTime {
        self.node.system_time(self.at).at
    }

    /// Points near where they are wanted, most of them small steps.
    fn points(&mut self, draws: &mut Draws<'_>) -> Result<(), String> {
        let interval = 1 << self.settings.map_or(12, |it| it.interval_log2);
        let stands = self.was.first.state != PlayerState::Following;
        if draws.byte() < 12 || (stands && self.next_us < self.system_now().as_us()) {
            self.next_us = (self.system_now().as_us() + u64::from(draws.byte()) * 1_000).next_multiple_of(interval);
        }
        let count = usize::from(draws.byte() % 8) + 1;
        let mut positions = [0; POINTS_MAX];
        let mut position = self.was.first.position;
        for point in &mut positions[..count] {
            position = position.saturating_add(i32::from(draws.byte().cast_signed()) >> (draws.byte() % 4));
            if draws.byte() == 0 {
                position = draws.number();
            }
            *point = position;
        }
        let late = match draws.byte() {
            0 => draws.steps(),
            1 => 2 * interval * 256,
            _ => 0,
        };
        let time = NetTime::from_us(self.next_us) + Span::from_steps(late);
        let mut bytes = [0; Points::HEAD_BYTES + 4 * POINTS_MAX];
        let points = Points { axis: (draws.byte() % 5) & 4, time, positions: &positions[..count] };
        let len = points.encode(&mut bytes).ok_or("points too long")?;
        self.send(&bytes[..len], draws.byte().is_multiple_of(2))?;
        if !self.was_refused {
            self.next_us += interval * count as u64;
            self.taken_us = self.next_us;
        } else if draws.byte() < 224 {
            self.next_us = self.taken_us;
        }
        Ok(())
    }

    fn halt(&mut self, draws: &mut Draws<'_>) -> Result<(), String> {
        // a device stops by itself often enough
        let action = if draws.byte() < 64 { Action::Stop } else { Action::Resume };
        let sequence = self.node.halt().map_or(1, |it| it.sequence).saturating_add((draws.byte() % 8).min(1).into());
        let epoch = match draws.byte() {
            0 => NetTime::from_steps(draws.steps()),
            _ => self.system_now() + Span::from_us(u64::from(draws.byte()) * 100),
        };
        let halt = Halt { action, sequence, epoch, origin: UniqueId([draws.byte(); 12]) };
        let mut packet = [0; 64];
        let mut route = RouteBuf::new();
        let _fits = route.push(Step::Link(GATEWAY));
        let terminal = Terminal::System { key: SystemKey::Halt.key() };
        let at = emit(&mut packet, ANNOUNCE_TTL_US, 256, route.as_route(), terminal).map_err(|_| "no header")?;
        packet[at..at + Halt::LEN].copy_from_slice(&halt.encode());
        let heard = self.node.receive(Arrival::Link(GATEWAY), &mut packet[..at + Halt::LEN], self.at, self.at);
        ensure(heard.is_ok(), || format!("{heard:?}"))
    }

    fn other(&mut self, draws: &mut Draws<'_>) -> Result<(), String> {
        let axis = (draws.byte() % 5) & 4;
        let request = match draws.byte() % 20 {
            0 => MotionRequest::Describe,
            1..=3 => MotionRequest::Configure { axis, settings: settings(draws) },
            4 => MotionRequest::Arm { axis, position: draws.number() >> 12 },
            12..=15 => MotionRequest::Arm { axis, position: self.was.first.position },
            5 => MotionRequest::Status { axis },
            6 => {
                let back = Span::from_us(u64::from(draws.byte()) * 3_000);
                let at = NetTime::from_steps(self.system_now().steps().saturating_sub(back.steps()));
                MotionRequest::MotionAt { axis, time_steps: at.steps() }
            }
            7 | 16..=18 => MotionRequest::ClearFault { axis },
            8 => MotionRequest::Halt { resume: draws.byte() > 64, lead_us: draws.byte().into() },
            9 => MotionRequest::Ramp {
                track: draws.byte() % 3,
                start_steps: (draws.byte().is_multiple_of(2))
                    .then(|| self.system_now().steps() + draws.steps() % (1 << 30)),
                end_steps: self.system_now().steps() + draws.steps() % (1 << 31),
                from: (draws.byte().is_multiple_of(2)).then(|| draws.number()),
                to: draws.number(),
            },
            10 => {
                let mut bytes = [0; 12].map(|_: u8| draws.byte());
                bytes[0] %= 20;
                MotionRequest::SetNode { node: draws.byte() % 20, bytes }
            }
            _ => MotionRequest::SetTrigger {
                trigger: draws.byte() % 5,
                channel: draws.byte() % 2,
                settings: TriggerSettings::Window { node: draws.byte() % 20, beats: draws.byte().into() },
            },
        };
        self.request(&request)
    }
}

impl Target for MotionTarget {
    fn name(&self) -> &'static str {
        "motion"
    }

    fn feed(&mut self, bytes: &[u8]) -> Result<(), String> {
        self.fed += 1;
        if self.fed.is_multiple_of(ANEW) {
            // a device that was halted or is at fault seldom comes to move again by chance
            let Self { fed, requests, done, refused, moved, .. } = *self;
            *self = Self { fed, requests, done, refused, moved, ..Self::new() };
            self.request(&MotionRequest::Configure { axis: 0, settings: settings(&mut Draws(&[0, 0, 2, 9])) })?;
            self.request(&MotionRequest::Arm { axis: 0, position: 0 })?;
        }
        // what is a good packet's header is a poor choice of settings: an input is a seed as well
        let seed = bytes
            .iter()
            .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3));
        let mut stream = [0; 256];
        Pcg64::seed_from_u64(seed).fill(&mut stream);
        let mut draws = Draws(&stream);
        match draws.byte() {
            0..16 => self.send(bytes, true)?,
            16..40 => self.halt(&mut draws)?,
            40..96 => self.other(&mut draws)?,
            _ => self.points(&mut draws)?,
        }
        // now and then long enough for a stop, or for what is sent to run out
        let beats = u64::from(draws.byte() % 64);
        self.pass(if draws.byte() < 4 { beats * 64 } else { beats })
    }

    fn reached(&self) -> String {
        let Self { requests, done, refused, moved, .. } = self;
        format!("{requests} requests, {done} of them done, {refused} refused, the axis moved at {moved} beats")
    }
}

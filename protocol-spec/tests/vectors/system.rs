//! System messages: `[SYS-01]` to `[SYS-05]`, `[TIM-01]` to `[TIM-03]`.

use crate::headers::{Said, route};
use crate::{Clauses, Hex, each, vector_file, vectors};
use fixed_math::time::{LocalTicks, NetTime, PeerTicks, Rate};
use osap_protocol::discovery::UniqueId;
use osap_protocol::halt::{Action, Halt};
use osap_protocol::header::{Terminal, emit};
use osap_protocol::system::{ANNOUNCEMENT_VERSION, Announcement, SystemKey};
use osap_protocol::time::{Root, TimeReply, TimeRequest, UnixOffset, stamp, unwrap_stamp};
use osap_protocol::{DropCause, Instruction};
use serde::Deserialize;

pub(crate) const SYSTEM: &str = "system.toml";

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SystemFile {
    key: Vec<NamedKey>,
    announcement: Vec<Announced>,
    time_request: Vec<Asked>,
    time_reply: Vec<Answered>,
    halt: Vec<Halted>,
    refused: Vec<RefusedSystem>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NamedKey {
    name: String,
    clause: Clauses,
    bytes: Hex,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Announced {
    name: String,
    clause: Clauses,
    bytes: Hex,
    step: Said,
    ttl_us: u16,
    mtu_bytes: u16,
    unique_id: Hex,
    boot_epoch: u32,
    wants_answer: bool,
    drop: Option<u8>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Asked {
    name: String,
    clause: Clauses,
    bytes: Hex,
    step: Said,
    ttl_us: u16,
    mtu_bytes: u16,
    sequence: u8,
    below: u8,
    departed_steps: u64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Answered {
    name: String,
    clause: Clauses,
    bytes: Hex,
    step: Said,
    ttl_us: u16,
    mtu_bytes: u16,
    sequence: u8,
    asked_slot: u32,
    heard_steps: u64,
    system_steps: u64,
    rate_bits: i32,
    error_steps: u32,
    bound_steps: u32,
    drift_bits: u32,
    age_us: u32,
    tick_steps: u16,
    tier: u8,
    root_priority: u8,
    root: Hex,
    is_yours: bool,
    is_settled: bool,
    is_rc: bool,
    unix: Option<Offset>,
    departed_steps: u64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Offset {
    offset_us: i64,
    hops: u8,
}

impl Answered {
    /// What the payload says; its slot as it is read.
    fn value(&self) -> TimeReply {
        let answered_slot = self.departed_steps & u64::from(u32::MAX);
        TimeReply {
            sequence: self.sequence,
            asked_slot: self.asked_slot,
            heard: PeerTicks::from_steps(self.heard_steps),
            system: NetTime::from_steps(self.system_steps),
            rate: Rate::from_bits(self.rate_bits),
            error_steps: self.error_steps,
            bound_steps: self.bound_steps,
            drift_bits: self.drift_bits,
            age_us: self.age_us,
            tick_steps: self.tick_steps,
            tier: self.tier,
            root: Root { priority: self.root_priority, unique_id: unique_id(&self.root) },
            is_yours: self.is_yours,
            is_settled: self.is_settled,
            is_rc: self.is_rc,
            unix: self.unix.as_ref().map(|it| UnixOffset { offset_us: it.offset_us, hops: it.hops }),
            answered_slot: u32::try_from(answered_slot).expect("32 bits"),
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Halted {
    name: String,
    clause: Clauses,
    bytes: Hex,
    step: Said,
    ttl_us: u16,
    mtu_bytes: u16,
    action: String,
    sequence: u32,
    /// TOML has 64 bits with a sign: as two's complement.
    epoch_steps: i64,
    origin: Hex,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RefusedSystem {
    name: String,
    clause: Clauses,
    key: u8,
    bytes: Hex,
    cause: String,
}

vectors!(NamedKey, Announced, Asked, Answered, Halted, RefusedSystem);

fn unique_id(bytes: &Hex) -> UniqueId {
    UniqueId(bytes.0[..].try_into().expect("a unique id has twelve bytes"))
}

/// A whole message of `key` by `step`: its header, and what `payload` writes behind it.
fn packet(
    (step, ttl_us, mtu_bytes): (Said, u16, u16),
    key: SystemKey,
    payload: impl FnOnce(&mut [u8]) -> usize,
) -> (Vec<u8>, usize) {
    let mut out = [0; 128];
    let terminal = Terminal::System { key: key.key() };
    let start = emit(&mut out, ttl_us, mtu_bytes, route(&[step]).as_route(), terminal).expect("room for a header");
    let len = payload(&mut out[start..]);
    (out[..start + len].to_vec(), start)
}

#[test]
fn system_messages() {
    let file: SystemFile = vector_file(SYSTEM);
    each(SYSTEM, &file.key, |at, v| {
        let Some(Instruction::System(key)) = Instruction::decode(&v.bytes.0) else {
            panic!("{at}: no system instruction")
        };
        assert_eq!(SystemKey::from_key(key).map(SystemKey::name), Some(&v.name[..]), "{at}");
    });
    each(SYSTEM, &file.announcement, |at, v| {
        let announcement = Announcement {
            version: ANNOUNCEMENT_VERSION,
            unique_id: unique_id(&v.unique_id),
            boot_epoch: v.boot_epoch,
            wants_answer: v.wants_answer,
            drop: v.drop,
        };
        let head = (v.step, v.ttl_us, v.mtu_bytes);
        let (out, start) = packet(head, SystemKey::Announcement, |room| announcement.encode(room).expect("room"));
        assert_eq!(out, v.bytes.0, "{at}: written");
        assert_eq!(Announcement::decode(&v.bytes.0[start..]), Ok(announcement), "{at}: read");
    });
    each(SYSTEM, &file.time_request, |at, v| {
        let request = TimeRequest { sequence: v.sequence, below: v.below };
        let departed = LocalTicks::from_steps(v.departed_steps);
        let head = (v.step, v.ttl_us, v.mtu_bytes);
        let (mut out, start) = packet(head, SystemKey::TimeRequest, |room| request.encode(room).expect("room"));
        stamp(&mut out, departed);
        assert_eq!(out, v.bytes.0, "{at}: written");
        let (read, slot) = TimeRequest::decode(&v.bytes.0[start..]).expect("a request");
        assert_eq!((read, unwrap_stamp(slot, departed)), (request, departed), "{at}: read");
    });
    each(SYSTEM, &file.time_reply, |at, v| {
        let (reply, head) = (v.value(), (v.step, v.ttl_us, v.mtu_bytes));
        let (mut out, start) = packet(head, SystemKey::TimeReply, |room| {
            TimeReply { answered_slot: 0, ..reply }.encode(room).expect("room")
        });
        stamp(&mut out, LocalTicks::from_steps(v.departed_steps));
        assert_eq!(out, v.bytes.0, "{at}: written");
        assert_eq!(TimeReply::decode(&v.bytes.0[start..]), Ok(reply), "{at}: read");
        assert_eq!(reply.answered(), PeerTicks::from_steps(v.departed_steps), "{at}: departure");
    });
    each(SYSTEM, &file.halt, |at, v| {
        let action = match &v.action[..] {
            "stop" => Action::Stop,
            "resume" => Action::Resume,
            other => panic!("{at}: there is no action `{other}`"),
        };
        let epoch = NetTime::from_steps(v.epoch_steps.cast_unsigned());
        let halt = Halt { action, sequence: v.sequence, epoch, origin: unique_id(&v.origin) };
        let (out, start) = packet((v.step, v.ttl_us, v.mtu_bytes), SystemKey::Halt, |room| {
            room[..Halt::LEN].copy_from_slice(&halt.encode());
            Halt::LEN
        });
        assert_eq!(out, v.bytes.0, "{at}: written");
        assert_eq!(Halt::decode(&v.bytes.0[start..]), Ok(halt), "{at}: read");
    });
    each(SYSTEM, &file.refused, |at, v| {
        let cause = match SystemKey::from_key(v.key) {
            Some(SystemKey::TimeRequest) => TimeRequest::decode(&v.bytes.0).expect_err(&at.to_string()),
            Some(SystemKey::TimeReply) => TimeReply::decode(&v.bytes.0).expect_err(&at.to_string()),
            Some(SystemKey::Announcement) => Announcement::decode(&v.bytes.0).expect_err(&at.to_string()),
            Some(SystemKey::Halt) => Halt::decode(&v.bytes.0).expect_err(&at.to_string()),
            Some(other) => panic!("{at}: {} is not read here", other.name()),
            None => DropCause::UnknownSystemKey,
        };
        assert_eq!(cause.name(), v.cause, "{at}");
    });
}

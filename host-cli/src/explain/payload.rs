//! What follows a route: transport headers, queries and answers, system messages. `[PKT-05]`, `[TRN-01]` to `[TRN-08]`,
//! `[SYS-01]` to `[SYS-05]`, `[DSC-01]` to `[DSC-03]`, `[TIM-01]` to `[TIM-03]`.

use super::body::{self, Shown};
use super::packet::whose;
use super::shapes::{self, Item};
use super::{Pen, count, hex};
use osap_protocol::discovery::{self, Query, Refusal, TimeSettings, VERSION, check_query};
use osap_protocol::halt::{HALT_VERSION, Halt};
use osap_protocol::system::{Announcement, SystemKey};
use osap_protocol::time::{TIER_MAX, TIME_VERSION, TimeReply, TimeRequest};
use osap_protocol::transport::{SegmentHeader, SegmentRefusal, SequencedHeader, SequencedKind, Transport};
use osap_protocol::{DropCause, Instruction, PortIndex};

/// Steps of the route that led here.
#[derive(Clone, Copy)]
pub(super) struct Steps {
    /// All of them.
    pub(super) all: usize,
    /// Those not taken yet: a problem behind them is noticed that far on.
    pub(super) to_come: usize,
}

/// Notes what stands from `at` on, behind the terminal instruction.
pub(super) fn explain(pen: &mut Pen<'_>, terminal: Instruction, at: usize, steps: Steps) {
    match terminal {
        Instruction::System(key) => system(pen, key, at, steps),
        Instruction::Port { source, destination } => {
            let rest = pen.bytes.get(at..).unwrap_or_default();
            match rest.split_first() {
                Some((key, payload)) => transport(pen, *key, payload, at, (source, destination), steps),
                // where the pointer is on this instruction, the header's check has said so
                None if steps.to_come == 0 => {}
                None => fault(
                    pen,
                    at,
                    DropCause::TransportMissing,
                    "PKT-05",
                    "the packet ends before its transport key",
                    steps,
                ),
            }
        }
        Instruction::Link(_) | Instruction::Bus { .. } => {}
    }
}

fn fault(pen: &mut Pen<'_>, at: usize, cause: DropCause, rule: &'static str, what: impl Into<String>, steps: Steps) {
    pen.problem(at, Some(cause), rule, what, whose(steps.to_come, cause));
}

/// Bytes that only the software at the port, or nobody, can read.
fn opaque(pen: &mut Pen<'_>, at: usize, name: &str, note: &str) {
    let end = pen.bytes.len();
    if at < end {
        pen.field(at, end, name, count(end - at), note);
    }
}

fn transport(
    pen: &mut Pen<'_>,
    key: u8,
    payload: &[u8],
    at: usize,
    (source, destination): (PortIndex, PortIndex),
    steps: Steps,
) {
    let note = |transport| match transport {
        Transport::Datagram => ("datagram", "nothing answers for its arrival"),
        Transport::Sequenced => ("sequenced", "requests, replies and refusals"),
        Transport::Segmented => ("segmented", "messages over one packet"),
    };
    let Ok(transport) = Transport::from_key(key) else {
        pen.field(at, at + 1, "transport", key.to_string(), "not served");
        fault(pen, at, DropCause::UnknownTransport, "TRN-01", format!("there is no transport {key}"), steps);
        return opaque(pen, at + 1, "payload", "");
    };
    let (name, meaning) = note(transport);
    pen.field(at, at + 1, "transport", name, meaning);
    match transport {
        Transport::Datagram if destination == PortIndex::NETRESPONDER => {
            opaque(pen, at + 1, "payload", "");
            fault(pen, at, DropCause::QueryMalformed, "DSC-02", "port 0 takes sequenced requests only", steps);
        }
        Transport::Datagram => opaque(pen, at + 1, "payload", "read by the software at the port"),
        Transport::Sequenced => sequenced(pen, payload, at + 1, (source, destination), steps),
        Transport::Segmented => segmented(pen, payload, at + 1, steps),
    }
}

fn sequenced(
    pen: &mut Pen<'_>,
    payload: &[u8],
    at: usize,
    (source, destination): (PortIndex, PortIndex),
    steps: Steps,
) {
    let (header, rest) = match SequencedHeader::parse(payload) {
        Ok(parsed) => parsed,
        Err(cause) => {
            let what = match payload.len() {
                0 | 1 => "the sequence word has two bytes, and the packet ends before",
                _ => "kind 3 means nothing",
            };
            opaque(pen, at, "sequence", "");
            return fault(pen, at, cause, "TRN-03", what, steps);
        }
    };
    let (kind, note) = match header.kind {
        SequencedKind::Request => ("request", "its reply has the same number"),
        SequencedKind::Reply => ("reply", "to the request of the same number"),
        SequencedKind::Refusal => ("refusal", "of the request of the same number"),
    };
    pen.field(at, at + 2, "sequence", format!("{kind} {}", header.sequence.get()), note);
    let at = at + 2;
    match header.kind {
        SequencedKind::Request if destination == PortIndex::NETRESPONDER => query(pen, rest, at, steps),
        SequencedKind::Reply if source == PortIndex::NETRESPONDER => answer(pen, rest, at),
        SequencedKind::Refusal if source == PortIndex::NETRESPONDER => refusal(pen, rest, at),
        _ => opaque(pen, at, "payload", "read by the software at the port"),
    }
}

/// Key and version of a message of the netresponder; `None` where they are not those of this version.
fn key_and_version(pen: &mut Pen<'_>, message: &[u8], at: usize) -> Option<Query> {
    let query = message.first().map(|key| (*key, Query::from_key(*key).ok()));
    if let Some((key, query)) = query {
        let name = query.map_or_else(|| key.to_string(), |query| query.name().to_owned());
        pen.field(at, at + 1, "query", name, format!("key {key}"));
    }
    if let Some(version) = message.get(1) {
        let note = if *version == VERSION { "" } else { "another one than is served" };
        pen.field(at + 1, at + 2, "version", version.to_string(), note);
    }
    query.and_then(|(_, query)| query).filter(|_| message.get(1) == Some(&VERSION))
}

/// A request to port 0, read as its node reads it: one that is answered by a refusal is no drop.
fn query(pen: &mut Pen<'_>, message: &[u8], at: usize, steps: Steps) {
    let query = key_and_version(pen, message, at);
    if let Err(cause) = check_query(message) {
        return fault(pen, at, cause, "DSC-02", "a query has at least a key and a version", steps);
    }
    let refused = match (query, discovery::decode(message)) {
        (Some(query), Ok(read)) => {
            let shown = body::show(pen, at + 2, shapes::request(query));
            let in_range =
                query != Query::SetTimeControl || read.body.read().is_ok_and(|it: TimeSettings| it.in_range());
            match shown {
                Shown::Whole if in_range => return,
                Shown::Whole => (at + 2, Refusal::Range, "a value is outside its range".to_owned()),
                Shown::Wrong { at, what } => (at, Refusal::Body, what),
            }
        }
        (_, Err(refusal)) => (at + 1, refusal, format!("the version is {}, not {VERSION}", message[1])),
        (None, Ok(_)) => (at, Refusal::UnknownKey, format!("no query has the key {}", message[0])),
    };
    if !matches!(refused.1, Refusal::Body | Refusal::Range) {
        opaque(pen, at + 2, "body", "not read");
    }
    let then = format!("the node answers with refusal {} ({}) and changes nothing", refused.1.code(), refused.1);
    pen.problem(refused.0, None, "DSC-02", refused.2, then);
}

const UNREADABLE: &str = "whoever asked cannot read the answer";

fn answer(pen: &mut Pen<'_>, message: &[u8], at: usize) {
    let Some(query) = key_and_version(pen, message, at) else {
        opaque(pen, at + 2, "body", "not read");
        return pen.problem(at, None, "DSC-01", "an answer begins with a known key and its version", UNREADABLE);
    };
    if let Shown::Wrong { at, what } = body::show(pen, at + 2, shapes::answer(query)) {
        pen.problem(at, None, "DSC-01", what, UNREADABLE);
    }
}

fn refusal(pen: &mut Pen<'_>, message: &[u8], at: usize) {
    // a refused query need not be one that is known
    let _known = key_and_version(pen, message, at);
    match message {
        [_, _, code, rest @ ..] => {
            let reason = Refusal::from_code(*code);
            let meaning = reason.map_or("a reason of another version", Refusal::meaning);
            pen.field(at + 2, at + 3, "reason", code.to_string(), meaning);
            if !rest.is_empty() {
                opaque(pen, at + 3, "more", "nothing belongs here");
                pen.problem(at + 3, None, "DSC-02", "a refusal ends with its reason", UNREADABLE);
            }
        }
        _ => pen.problem(at + message.len(), None, "DSC-02", "a refusal has a key, a version and a reason", UNREADABLE),
    }
}

fn segmented(pen: &mut Pen<'_>, payload: &[u8], at: usize, steps: Steps) {
    let control = payload.first().map(|control| match control {
        0 => "data".to_owned(),
        1 => "acknowledgement".to_owned(),
        2 => "refusal".to_owned(),
        other => format!("{other}: means nothing"),
    });
    if let Some(control) = control {
        pen.field(at, at + 1, "control", control, "");
    }
    if let Some(message) = payload.get(1) {
        pen.field(at + 1, at + 2, "message", message.to_string(), "its number with this sender");
    }
    match SegmentHeader::parse(payload) {
        Ok((SegmentHeader::Data { index, count, .. }, _)) => {
            pen.field(at + 2, at + 4, "index", index.to_string(), "counts from 0");
            pen.field(at + 4, at + 6, "count", count.to_string(), "segments of the message");
            opaque(pen, at + 6, "segment", "");
        }
        Ok((SegmentHeader::Acknowledge { next, .. }, rest)) => {
            pen.field(at + 2, at + 4, "next", next.to_string(), "the segment wanted next");
            opaque(pen, pen.bytes.len() - rest.len(), "more", "nothing belongs here");
        }
        Ok((SegmentHeader::Refuse { reason, .. }, rest)) => {
            let reason = match reason {
                SegmentRefusal::Busy => "busy with another message",
                SegmentRefusal::TooLong => "the message is too long",
            };
            pen.field(at + 2, at + 3, "reason", reason, "");
            opaque(pen, pen.bytes.len() - rest.len(), "more", "nothing belongs here");
        }
        Err(cause) => {
            opaque(pen, at + payload.len().min(2), "more", "");
            let (rule, what) = match cause {
                DropCause::SegmentInvalid => ("TRN-08", "a segment's index is below its count"),
                _ => ("TRN-07", "the segment header is cut short, or means nothing"),
            };
            fault(pen, at, cause, rule, what, steps);
        }
    }
}

fn system(pen: &mut Pen<'_>, key: u8, at: usize, steps: Steps) {
    let payload = pen.bytes.get(at..).unwrap_or_default();
    match SystemKey::from_key(key) {
        Some(SystemKey::Announcement) => announcement(pen, payload, at, steps),
        Some(key @ (SystemKey::TimeRequest | SystemKey::TimeReply)) => time(pen, key, payload, at, steps),
        Some(SystemKey::Halt) => halt(pen, payload, at, steps),
        Some(other) => {
            opaque(pen, at, other.name(), "a node that does not serve it counts one more unknown-system-key");
        }
        None => {
            opaque(pen, at, "payload", "");
            fault(
                pen,
                at.saturating_sub(1),
                DropCause::UnknownSystemKey,
                "SYS-01",
                format!("system message {key} means nothing"),
                steps,
            );
        }
    }
}

fn announcement(pen: &mut Pen<'_>, payload: &[u8], at: usize, steps: Steps) {
    const ITEMS: &[Item] = shapes::ANNOUNCEMENT;
    let shown = body::show(pen, at, ITEMS);
    if let Err(cause) = Announcement::decode(payload) {
        let (at, what) = match shown {
            Shown::Wrong { at, what } => (at, what),
            Shown::Whole => (at, format!("version {} of the announcement is not served", hex::hex_of(&payload[..1]))),
        };
        fault(pen, at, cause, "SYS-05", what, steps);
    } else if steps.all != 1 {
        let what = format!("an announcement has a route of one step, this one has {}", steps.all);
        pen.problem(at, None, "SYS-02", what, "it tells a node of a neighbour that is none");
    }
}

/// A stop of all motion, or its resume: fixed width too.
fn halt(pen: &mut Pen<'_>, payload: &[u8], at: usize, steps: Steps) {
    let shown = body::show(pen, at, shapes::HALT);
    if let Err(cause) = Halt::decode(payload) {
        let (at, what) = match shown {
            Shown::Wrong { at, what } => (at, what),
            Shown::Whole if payload.first() != Some(&HALT_VERSION) => {
                (at, format!("version {} is not served", hex::hex_of(&payload[..1])))
            }
            Shown::Whole => (at + 1, "an action that means nothing: 0 is stop, 1 is resume".to_owned()),
        };
        fault(pen, at, cause, "MOT-20", what, steps);
    } else if steps.all != 1 {
        let what = format!("a halt has a route of one step, this one has {}", steps.all);
        fault(pen, at, DropCause::SystemMalformed, "MOT-20", what, steps);
    }
}

/// Two clocks' stamps: fixed width, and judged by the code that nodes run.
fn time(pen: &mut Pen<'_>, key: SystemKey, payload: &[u8], at: usize, steps: Steps) {
    let (items, clause, read) = match key {
        SystemKey::TimeRequest => (shapes::TIME_REQUEST, "TIM-01", TimeRequest::decode(payload).map(|_| ())),
        _ => (shapes::TIME_REPLY, "TIM-02", TimeReply::decode(payload).map(|_| ())),
    };
    let shown = body::show(pen, at, items);
    if let Err(cause) = read {
        let (at, what) = match shown {
            Shown::Wrong { at, what } => (at, what),
            Shown::Whole if payload.first() != Some(&TIME_VERSION) => {
                (at, format!("version {} is not served", hex::hex_of(&payload[..1])))
            }
            Shown::Whole => (at, format!("a flag that means nothing, or a tier beyond {TIER_MAX} that is not 255")),
        };
        fault(pen, at, cause, clause, what, steps);
    } else if steps.all != 1 {
        let what = format!("a {} has a route of one step, this one has {}", key.name(), steps.all);
        fault(pen, at, DropCause::SystemMalformed, clause, what, steps);
    }
}

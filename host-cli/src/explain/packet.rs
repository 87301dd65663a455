//! Header and route of a packet: `[PKT-01]` to `[PKT-12]`.

use super::{Pen, count, payload};
use osap_protocol::header::ROUTE_OFFSET;
use osap_protocol::route::Route;
use osap_protocol::system::SystemKey;
use osap_protocol::{BusDrop, DropCause, HeaderError, Instruction, Packet};

/// Where the packet was seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// In a frame between two gateways.
    OnWire,
    /// Anywhere.
    Unknown,
}

/// What the route ends in, with the offset behind it, and what the walk there counted.
struct Walked {
    taken: usize,
    to_come: usize,
    end: Option<(Instruction, usize)>,
}

/// Notes all of a packet; returns the verdict for the case that nothing is wrong.
pub(super) fn explain(pen: &mut Pen<'_>, place: Place) -> String {
    let bytes = pen.bytes;
    fixed_fields(pen);
    let mut has_pointer = true;
    let walked = match Packet::check(bytes) {
        Ok(packet) => {
            limits(pen, &packet);
            let pointer = usize::from(packet.pointer());
            let current = packet.instruction();
            let is_terminal = matches!(current, Instruction::System(_) | Instruction::Port { .. });
            if place == Place::OnWire && is_terminal {
                let what = format!("the pointer is on {}, which leads over no link: nobody sends that", name(current));
                pen.dropped(pointer, DropCause::NotForwarding, "PKT-08", what);
            }
            let taken = taken(pen, pointer);
            route_from(pen, pointer, Some(pointer), taken)
        }
        Err(error) => {
            refuse(pen, error);
            match error {
                HeaderError::TransportMissing { .. } | HeaderError::InstructionCut { .. } => {
                    let pointer = bytes.first().map_or(ROUTE_OFFSET, |pointer| usize::from(*pointer));
                    let taken = taken(pen, pointer);
                    route_from(pen, pointer, Some(pointer), taken)
                }
                // where the pointer should be is not known: the route is shown from its beginning, but not judged
                _ => {
                    has_pointer = false;
                    route_from(pen, ROUTE_OFFSET, None, 0)
                }
            }
        }
    };
    let judged = pen.problems.len();
    if let Some((terminal, after)) = walked.end {
        payload::explain(
            pen,
            terminal,
            after,
            payload::Steps { all: walked.taken + walked.to_come, to_come: walked.to_come },
        );
    }
    if !has_pointer {
        pen.problems.truncate(judged);
    }
    let end = pen.noted_to(0);
    if end < bytes.len() {
        pen.field(end, bytes.len(), "rest", count(bytes.len() - end), "never reached");
    }
    verdict(&walked)
}

fn verdict(walked: &Walked) -> String {
    let steps = |count: usize| if count == 1 { "1 step".to_owned() } else { format!("{count} steps") };
    let Some((terminal, _)) = walked.end else { return String::new() };
    let there = match walked.to_come {
        0 => "at its destination".to_owned(),
        to_come => format!("{} to come", steps(to_come)),
    };
    format!("a whole packet: {} taken, {there}, for {}", steps(walked.taken), name(terminal))
}

/// An instruction in words.
fn name(instruction: Instruction) -> String {
    match instruction {
        Instruction::System(key) => match SystemKey::from_key(key) {
            Some(known) => format!("system message {key}, {}", known.name()),
            None => format!("system message {key}"),
        },
        Instruction::Link(gateway) => format!("link {}", gateway.get()),
        Instruction::Bus { gateway, drop: BusDrop::BROADCAST } => format!("bus {}, all drops", gateway.get()),
        Instruction::Bus { gateway, drop } => format!("bus {}, drop {}", gateway.get(), drop.0),
        Instruction::Port { source, destination } => format!("port {} → port {}", source.get(), destination.get()),
    }
}

fn fixed_fields(pen: &mut Pen<'_>) {
    let bytes = pen.bytes;
    if let Some(pointer) = bytes.first() {
        pen.field(
            0,
            1,
            "pointer",
            pointer.to_string(),
            format!("the instruction at byte {pointer} is carried out next"),
        );
    }
    for (at, name, unit, note) in
        [(1, "TTL", "µs", "time to live"), (3, "MTU", "bytes", "smallest packet size on the route")]
    {
        match bytes.get(at..at + 2) {
            Some(pair) => {
                let value = u16::from_le_bytes([pair[0], pair[1]]);
                pen.field(at, at + 2, name, format!("{value} {unit}"), note);
            }
            None if bytes.len() > at => pen.field(at, at + 2, name, "cut", "two bytes belong here"),
            None => {}
        }
    }
}

/// `[PKT-10]`, `[PKT-12]`: what the header says about the packet as a whole.
fn limits(pen: &mut Pen<'_>, packet: &Packet<&[u8]>) {
    let len = pen.bytes.len();
    if len > usize::from(packet.mtu_bytes()) {
        let what = format!("the packet has {len} bytes, its MTU field allows {}", packet.mtu_bytes());
        pen.dropped(3, DropCause::OverMtu, "PKT-12", what);
    }
    if packet.ttl_us() == 0 {
        pen.dropped(1, DropCause::Expired, "PKT-10", "the time to live is used up");
    }
}

fn refuse(pen: &mut Pen<'_>, error: HeaderError) {
    let len = pen.bytes.len();
    let (at, clause) = match error {
        HeaderError::Short { .. } => (len, "PKT-02"),
        HeaderError::PointerOutside { .. } => (0, "PKT-02"),
        HeaderError::InstructionCut { pointer, .. } => (usize::from(pointer), "PKT-02"),
        HeaderError::TransportMissing { .. } => (len, "PKT-05"),
        HeaderError::NotForwarding { .. } => (0, "PKT-08"),
    };
    pen.dropped(at, DropCause::from(error), clause, error.to_string());
}

/// Notes the steps before the pointer, as the way back that they are; returns how many.
fn taken(pen: &mut Pen<'_>, pointer: usize) -> usize {
    let bytes = pen.bytes.get(ROUTE_OFFSET..pointer).unwrap_or_default();
    let steps = match Route::check(bytes) {
        Ok(route) => route.steps().count(),
        Err(fault) => {
            let at = ROUTE_OFFSET + fault.at;
            pen.field(
                ROUTE_OFFSET,
                pointer,
                "before pointer",
                "not whole link and bus steps",
                "there is no way back over them",
            );
            let what = format!("the bytes before the pointer are no steps taken, from byte {at} on");
            pen.problem(at, None, "PKT-09", what, "the packet goes its way, but nobody can answer it");
            return 0;
        }
    };
    let mut at = ROUTE_OFFSET;
    for n in 1..=steps {
        let Some(instruction) = pen.bytes.get(at..).and_then(Instruction::decode) else { break };
        let end = at + Instruction::width(pen.bytes[at]);
        let note = match steps - n {
            0 => "the way back leaves by it first".to_owned(),
            later => format!("the way back leaves by it after {later} more"),
        };
        pen.field(at, end, format!("step {n}, taken"), name(instruction), note);
        at = end;
    }
    steps
}

/// Notes the instructions from `at` to the end of the route, the one at `pointer` as the current one.
fn route_from(pen: &mut Pen<'_>, mut at: usize, pointer: Option<usize>, taken: usize) -> Walked {
    let mut to_come = 0;
    loop {
        let number = taken + to_come + 1;
        let is_current = pointer == Some(at);
        let Some(instruction) = pen.bytes.get(at..).and_then(Instruction::decode) else {
            cut(pen, at, pointer.is_some(), to_come);
            return Walked { taken, to_come, end: None };
        };
        let end = at + Instruction::width(pen.bytes[at]);
        let state = if is_current { ", current" } else { "" };
        match instruction {
            Instruction::Link(_) | Instruction::Bus { .. } => {
                let note = step_note(instruction, end, is_current);
                pen.field(at, end, format!("step {number}{state}"), name(instruction), note);
                to_come += 1;
                at = end;
                if pointer.is_some() && u8::try_from(at).is_err() {
                    let what = format!("the next instruction begins at byte {at}, which no pointer can say");
                    let cause = DropCause::PointerOutside;
                    pen.problem(at, Some(cause), "PKT-06", what, whose(to_come, cause));
                    return Walked { taken, to_come, end: None };
                }
            }
            Instruction::Port { .. } | Instruction::System(_) => {
                let note = match (instruction, is_current) {
                    (Instruction::Port { .. }, true) => "delivered here; a reply swaps the two ports",
                    (Instruction::Port { .. }, false) => "delivered where the steps end",
                    (_, true) => "for this node itself",
                    (_, false) => "for the node where the steps end",
                };
                pen.field(at, end, format!("end of route{state}"), name(instruction), note);
                return Walked { taken, to_come, end: Some((instruction, end)) };
            }
        }
    }
}

fn step_note(step: Instruction, end: usize, is_current: bool) -> String {
    match (step, is_current) {
        (_, false) => String::new(),
        (Instruction::Bus { .. }, true) => {
            format!("the receiver writes its own gateway and the sender's drop here and sets the pointer to {end}")
        }
        (_, true) => format!("the receiver writes its own gateway here and sets the pointer to {end}"),
    }
}

/// The route breaks off at `at`, where a good pointer will be after `steps` more steps.
fn cut(pen: &mut Pen<'_>, at: usize, has_pointer: bool, steps: usize) {
    let left = pen.bytes.len().saturating_sub(at);
    if left > 0 {
        pen.field(at, pen.bytes.len(), "instruction", "cut", "");
    }
    if !has_pointer || steps == 0 {
        return; // said already, of the pointer
    }
    let cause = if left > 0 { DropCause::InstructionCut } else { DropCause::PointerOutside };
    let what = match left {
        0 => "the route breaks off after a step: no instruction follows".to_owned(),
        _ => format!("the route breaks off in the instruction at byte {at}"),
    };
    pen.problem(at, Some(cause), "PKT-02", what, whose(steps, cause));
}

/// Who drops a packet that becomes bad after some more steps.
pub(super) fn whose(steps: usize, cause: DropCause) -> String {
    let who = match steps {
        0 | 1 => "the receiver".to_owned(),
        _ => format!("the node {steps} steps on"),
    };
    format!("{who} drops it and counts one more {}", cause.name())
}

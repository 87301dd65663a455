//! The stuffing and check of a frame: `[FRM-01]` to `[FRM-07]`.

use super::packet::{self, Place};
use super::{Explanation, Kind, Part, Pen, SCHEMA, check_name, check_title, count, hex, verdict_of};
use osap_protocol::DropCause;
use osap_protocol::framing::{Check, DELIMITER, FrameError, decode};

/// The packet of a frame, with or without delimiters around it.
pub(super) fn unframe(bytes: &[u8], check: Check) -> Result<Vec<u8>, FrameError> {
    let (body, _) = body_of(bytes);
    let mut out = vec![0; bytes.len()];
    let len = decode(body, check, &mut out)?;
    out.truncate(len);
    Ok(out)
}

/// The stuffed bytes between the delimiters, and how many delimiters stand before them.
fn body_of(bytes: &[u8]) -> (&[u8], usize) {
    let before = bytes.iter().take_while(|byte| **byte == DELIMITER).count();
    let after = bytes[before..].iter().rev().take_while(|byte| **byte == DELIMITER).count();
    (&bytes[before..bytes.len() - after], before)
}

pub(super) fn explain(bytes: &[u8], check: Check, why: String) -> Explanation {
    let mut pen = Pen::new(Part::Frame, bytes);
    stuffing(&mut pen, check);
    let result = unframe(bytes, check);
    if let Err(error) = &result {
        refuse(&mut pen, *error, check);
    }
    // with a wrong check the bytes are shown as they came, but nothing they say counts
    let contents = unframe(bytes, Check::None).unwrap_or_default();
    let packet_len = contents.len().saturating_sub(check.len());
    let (packet, trailer) = contents.split_at(packet_len);
    let mut inner = Pen::new(Part::Packet, packet);
    let mut sound = String::new();
    if !packet.is_empty() {
        sound = packet::explain(&mut inner, Place::OnWire);
        if result.is_ok() {
            pen.problems.append(&mut inner.problems);
        }
    }
    pen.fields.append(&mut inner.fields);
    if !trailer.is_empty() && !packet.is_empty() {
        let (mut shown, note) = (Pen::new(Part::Packet, &contents), check_note(packet, trailer, check));
        let value = format!("{:#0width$x}", little_endian(trailer), width = 2 + 2 * trailer.len());
        shown.field(packet_len, contents.len(), check_title(check), value, note);
        pen.fields.append(&mut shown.fields);
    }
    Explanation {
        schema: SCHEMA,
        kind: Kind::Frame,
        check: Some(check_name(check)),
        why,
        packet: (!packet.is_empty()).then(|| hex::hex_of(packet)),
        verdict: verdict_of(&pen.problems, sound),
        fields: pen.fields,
        problems: pen.problems,
    }
}

fn little_endian(bytes: &[u8]) -> u32 {
    bytes.iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte))
}

fn check_note(packet: &[u8], trailer: &[u8], check: Check) -> String {
    let computed = check.of(packet);
    let right = trailer.len() == check.len() && little_endian(trailer) == computed;
    if right { "right".to_owned() } else { format!("wrong: the bytes give {computed:#x}") }
}

/// Notes each run: its code byte, and the bytes before the zero it stands for.
fn stuffing(pen: &mut Pen<'_>, check: Check) {
    let (body, before) = body_of(pen.bytes);
    let end = before + body.len();
    if before > 0 && !body.is_empty() {
        pen.field(0, before, "idle", "delimiters before the frame", "ignored, [FRM-05]");
    }
    let (mut at, mut unstuffed) = (before, 0);
    while at < end {
        let code = usize::from(pen.bytes[at]);
        if code == 0 {
            pen.field(at, at + 1, "delimiter", "a zero inside the frame", "ends the frame here, [FRM-07]");
            at += 1;
            continue;
        }
        let run_end = at + code;
        let is_last = run_end >= end;
        let zero = if code == 255 || is_last { "" } else { ", then a zero" };
        let note = match (code, is_last) {
            (255, _) => "a full run, to which no zero belongs",
            (_, true) => "the last run: its zero is the end of the frame",
            _ => "",
        };
        pen.field(at, at + 1, "code", format!("{}{zero}", count(code - 1)), note);
        let data_end = run_end.min(end);
        if data_end > at + 1 {
            let last = unstuffed + data_end - at - 2;
            let range = if last == unstuffed { format!("byte {last}") } else { format!("bytes {unstuffed} to {last}") };
            let of = if check == Check::None { "of the packet" } else { "of packet and check" };
            pen.field(at + 1, data_end, "run", format!("{range} {of}"), "");
        }
        unstuffed += data_end - at - 1 + usize::from(!zero.is_empty());
        at = data_end;
    }
    let tail = pen.bytes.len().saturating_sub(end);
    match tail {
        0 => pen.field(end, end, "delimiter", "missing", "a receiver waits for it"),
        _ => pen.field(end, end + 1, "delimiter", "ends the frame", ""),
    }
    if tail > 1 {
        pen.field(end + 1, pen.bytes.len(), "idle", "delimiters after the frame", "ignored, [FRM-05]");
    }
}

fn refuse(pen: &mut Pen<'_>, error: FrameError, check: Check) {
    let end = pen.bytes.len();
    let what = error.to_string();
    match error {
        FrameError::Malformed => {
            let (at, what) = stumble(pen.bytes);
            pen.dropped(at, DropCause::from(error), "FRM-07", what);
        }
        FrameError::Check { .. } => {
            let others = [Check::Crc32, Check::Crc16].into_iter().filter(|other| *other != check);
            let fits = others.into_iter().find(|other| unframe(pen.bytes, *other).is_ok());
            let hint = fits
                .map(|other| format!("; its {} is right: set both ends of the link to the same", check_title(other)));
            let clause = if check == Check::Crc32 { "FRM-03" } else { "FRM-02" };
            pen.dropped(end, DropCause::from(error), clause, what + &hint.unwrap_or_default());
        }
        FrameError::TooShort { .. } | FrameError::TooLong { .. } | FrameError::BufferTooSmall { .. } => {
            pen.dropped(end, DropCause::from(error), "FRM-07", what);
        }
    }
}

/// Where the stuffing goes wrong, and how.
fn stumble(bytes: &[u8]) -> (usize, String) {
    let (body, before) = body_of(bytes);
    if let Some(at) = body.iter().position(|byte| *byte == DELIMITER) {
        let at = before + at;
        return (at, format!("a zero stands at byte {at}, inside the frame: two frames, or one that lost its end"));
    }
    let mut at = 0;
    while at < body.len() {
        let (code, left) = (usize::from(body[at]), body.len() - at);
        if code > left {
            let at = before + at;
            return (at, format!("the run at byte {at} says {}, {} are left", count(code - 1), left - 1));
        }
        at += code;
    }
    (bytes.len(), "the byte stuffing is wrong".to_owned())
}

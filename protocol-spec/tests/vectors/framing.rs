//! Frames on byte streams and buses: `[FRM-01]` to `[FRM-10]`.

use crate::{Clauses, Hex, each, vector_file, vectors};
use fixed_math::time::LocalTicks;
use osap_protocol::DropCause;
use osap_protocol::framing::{Check, Deframer, FrameError, decode, encode_parts, encoded_len_max};
use serde::Deserialize;

pub(crate) const FRAMING: &str = "framing.toml";

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Guard {
    None,
    Crc16,
    Crc32,
}

impl Guard {
    fn check(self) -> Check {
        match self {
            Self::None => Check::None,
            Self::Crc16 => Check::Crc16,
            Self::Crc32 => Check::Crc32,
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FramingFile {
    value: Vec<Known>,
    frame: Vec<Frame>,
    bus: Vec<BusFrame>,
    refused: Vec<Refused>,
    stream: Vec<Stream>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Known {
    name: String,
    clause: Clauses,
    check: Guard,
    bytes: Hex,
    value: u32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Frame {
    name: String,
    clause: Clauses,
    #[serde(default)]
    unstuff_only: bool,
    check: Guard,
    packet: Hex,
    bytes: Hex,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BusFrame {
    name: String,
    clause: Clauses,
    destination: u8,
    source: u8,
    check: Guard,
    packet: Hex,
    bytes: Hex,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Refused {
    name: String,
    clause: Clauses,
    check: Guard,
    bytes: Hex,
    cause: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Stream {
    name: String,
    clause: Clauses,
    check: Guard,
    room: usize,
    bytes: Hex,
    frames: Vec<Outcome>,
}

#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(untagged)]
enum Outcome {
    Taken(Taken),
    Dropped(Dropped),
}

#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Taken {
    packet: Hex,
    first: u64,
}

#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Dropped {
    cause: String,
}

vectors!(Known, Frame, BusFrame, Refused, Stream);

fn framed(parts: &[&[u8]], check: Check) -> Vec<u8> {
    let mut out = vec![0xee; encoded_len_max(parts.iter().map(|part| part.len()).sum(), check)];
    let len = encode_parts(parts, check, &mut out).expect("the stated bound suffices");
    out.truncate(len);
    out
}

fn unframed(frame: &[u8], check: Check) -> Result<Vec<u8>, FrameError> {
    let mut out = vec![0; frame.len()];
    decode(frame, check, &mut out).map(|len| out[..len].to_vec())
}

/// What a receiver makes of `bytes`, the stamp of each being its index.
fn received<const N: usize>(bytes: &[u8], check: Check) -> Vec<Outcome> {
    let mut deframer = Deframer::<N>::new(check);
    let mut outcomes = Vec::new();
    for (stamp, byte) in (0..).zip(bytes) {
        outcomes.extend(deframer.push(*byte, LocalTicks::from_us(stamp)).map(|result| match result {
            Ok(frame) => Outcome::Taken(Taken { packet: Hex(frame.packet.to_vec()), first: frame.started.as_us() }),
            Err(error) => Outcome::Dropped(Dropped { cause: DropCause::from(error).name().to_owned() }),
        }));
    }
    outcomes
}

#[test]
fn checks_and_frames() {
    let file: FramingFile = vector_file(FRAMING);
    each(FRAMING, &file.value, |at, v| assert_eq!(v.check.check().of(&v.bytes.0), v.value, "{at}"));
    each(FRAMING, &file.frame, |at, v| {
        let check = v.check.check();
        if !v.unstuff_only {
            assert_eq!(framed(&[&v.packet.0], check), v.bytes.0, "{at}: written");
        }
        assert_eq!(unframed(&v.bytes.0, check), Ok(v.packet.0.clone()), "{at}: read");
        let taken = Outcome::Taken(Taken { packet: v.packet.clone(), first: 0 });
        assert_eq!(received::<300>(&v.bytes.0, check), [taken], "{at}: read byte by byte");
    });
    each(FRAMING, &file.bus, |at, v| {
        let check = v.check.check();
        let drops = [v.destination, v.source];
        assert_eq!(framed(&[&drops, &v.packet.0], check), v.bytes.0, "{at}: written");
        assert_eq!(unframed(&v.bytes.0, check), Ok([&drops, &v.packet.0[..]].concat()), "{at}: read");
    });
    each(FRAMING, &file.refused, |at, v| {
        let error = unframed(&v.bytes.0, v.check.check()).expect_err(&at.to_string());
        assert_eq!(DropCause::from(error).name(), v.cause, "{at}");
    });
}

#[test]
fn streams() {
    let file: FramingFile = vector_file(FRAMING);
    each(FRAMING, &file.stream, |at, v| {
        let outcomes = match v.room {
            4 => received::<4>(&v.bytes.0, v.check.check()),
            16 => received::<16>(&v.bytes.0, v.check.check()),
            room => panic!("{at}: a receiver with room for {room} bytes is not built here"),
        };
        assert_eq!(outcomes, v.frames, "{at}");
    });
}

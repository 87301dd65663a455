//! Messages of a motion port: `[MOT-01]` to `[MOT-14]`.

use crate::{Clauses, Hex, each, vector_file, vectors};
use fixed_math::time::NetTime;
use osap_protocol::motion::{
    MOTION_VERSION, Message, MotionRefusal, MotionReply, POINTS_MAX, Points, READINGS_OPERATION, REPLY_BYTES_MAX,
    ReadingMessage, refusal, reply,
};
use serde::Deserialize;

pub(crate) const MOTION: &str = "motion.toml";

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MotionFile {
    points: Vec<SomePoints>,
    request: Vec<Said>,
    reply: Vec<Said>,
    refusal: Vec<Said>,
    readings: Vec<SomeReadings>,
    malformed: Vec<Malformed>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SomePoints {
    name: String,
    clause: Clauses,
    bytes: Hex,
    axis: u8,
    time_steps: u64,
    positions: Vec<i32>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Said {
    name: String,
    clause: Clauses,
    bytes: Hex,
    is: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SomeReadings {
    name: String,
    clause: Clauses,
    bytes: Hex,
    values: Vec<(u64, u8, i32)>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Malformed {
    name: String,
    clause: Clauses,
    bytes: Hex,
}

vectors!(SomePoints, Said, SomeReadings, Malformed);

#[test]
fn motion_messages() {
    let file: MotionFile = vector_file(MOTION);
    each(MOTION, &file.points, |at, v| {
        let time = NetTime::from_steps(v.time_steps);
        let mut out = [0; Points::HEAD_BYTES + 4 * POINTS_MAX];
        let len = Points { axis: v.axis, time, positions: &v.positions }.encode(&mut out).expect("room");
        assert_eq!(out[..len], v.bytes.0, "{at}: written");
        let Some(Message::Points(read)) = Message::decode(&v.bytes.0) else { panic!("{at}: no points") };
        assert_eq!((read.axis, read.time), (v.axis, time), "{at}");
        assert!(read.positions().eq(v.positions.iter().copied()), "{at}: positions");
    });
    each(MOTION, &file.request, |at, v| {
        let Some(Message::Request(request)) = Message::decode(&v.bytes.0) else { panic!("{at}: no request") };
        assert_eq!(format!("{request:?}"), v.is, "{at}: read");
        let mut out = [0; REPLY_BYTES_MAX];
        let len = request.encode(&mut out).expect("room");
        assert_eq!(out[..len], v.bytes.0, "{at}: written");
    });
    let written = |bytes: &Result<&mut [u8], postcard::Error>| bytes.as_ref().ok().map(|it| it.to_vec());
    each(MOTION, &file.reply, |at, v| {
        let read: MotionReply = reply(&v.bytes.0).unwrap_or_else(|| panic!("{at}: no reply"));
        assert_eq!(format!("{read:?}"), v.is, "{at}: read");
        let mut out = [0; REPLY_BYTES_MAX];
        assert_eq!(written(&postcard::to_slice(&read, &mut out)).as_ref(), Some(&v.bytes.0), "{at}: written");
    });
    each(MOTION, &file.refusal, |at, v| {
        let read: MotionRefusal = refusal(&v.bytes.0).unwrap_or_else(|| panic!("{at}: no refusal"));
        assert_eq!(format!("{read:?}"), v.is, "{at}: read");
        let mut out = [0; REPLY_BYTES_MAX];
        assert_eq!(written(&postcard::to_slice(&read, &mut out)).as_ref(), Some(&v.bytes.0), "{at}: written");
    });
    each(MOTION, &file.readings, |at, v| {
        let values = v.values.iter().map(|&(steps, channel, value)| ReadingMessage {
            time: NetTime::from_steps(steps),
            channel,
            value,
        });
        let mut out = vec![MOTION_VERSION, READINGS_OPERATION];
        out.extend(values.clone().flat_map(|value| value.encode()));
        assert_eq!(out, v.bytes.0, "{at}: written");
        assert!(ReadingMessage::decode_all(&v.bytes.0).expect("readings").eq(values), "{at}: read");
    });
    each(MOTION, &file.malformed, |at, v| assert_eq!(Message::decode(&v.bytes.0), None, "{at}"));
}

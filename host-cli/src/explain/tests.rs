//! Goldens out of `protocol-spec/vectors`, and properties that hold for any bytes.

use super::body::{Shown, show};
use super::*;
use fixed_math::time::{NetTime, Rate};
use osap_protocol::discovery::{
    self, CounterPage, DebugPage, LinkInfo, Name, PortInfo, Query, Refusal, RuntimeInfo, ScanId, TimeAsymmetry,
    TimeControl, TimeLink, TimeSettings, TimeStatus, Verbosity,
};
use osap_protocol::framing::{encode, encoded_len_max};
use osap_protocol::system::Announcement;
use osap_protocol::time::{TimeReply, TimeRequest, UnixOffset};
use proptest::prelude::*;
use serde::Deserialize;

/// A header that ends at port 0 and one that comes from there, both in the sequenced transport.
const TO_0: &str = "06 e8 03 00 01 41 c0 18 00 01 ";
const FROM_0: &str = "06 e8 03 00 01 41 c0 00 03 01 ";

fn explained(hex: &str, options: Options) -> Explanation {
    explain(&parse_hex(hex).unwrap(), options)
}

fn causes(explanation: &Explanation) -> Vec<Option<&'static str>> {
    explanation.problems.iter().map(|problem| problem.drop_cause).collect()
}

/// `[PKT-07]`, `[DSC-03]`
#[test]
fn a_packet_on_its_way_is_shown_step_by_step() {
    let text = render(&explained("08 e8 03 40 00 44 85 09 43 c0 18 00 01 05 00 01 01 ac 02 01", Options::Packet));
    let expected = "\
asked for as a packet
byte  hex       field            says
   0  08        pointer          8                    the instruction at byte 8 is carried out next
   1  e8 03     TTL              1000 µs              time to live
   3  40 00     MTU              64 bytes             smallest packet size on the route
   5  44        step 1, taken    link 4               the way back leaves by it after 1 more
   6  85 09     step 2, taken    bus 5, drop 9        the way back leaves by it first
   8  43        step 3, current  link 3               the receiver writes its own gateway here and sets the pointer to 9
   9  c0 18 00  end of route     port 3 → port 0      delivered where the steps end
  12  01        transport        sequenced            requests, replies and refusals
  13  05 00     sequence         request 5            its reply has the same number
  15  01        query            runtime information  key 1
  16  01        version          1
  17  ac 02     scan             300
  19  01        visit            1

a whole packet: 2 steps taken, 1 step to come, for port 3 → port 0
";
    assert_eq!(text, expected);
}

/// `[FRM-01]`, `[FRM-02]`
#[test]
fn a_frame_is_taken_apart_down_to_its_code_bytes() {
    let text = render(&explained("06 05 e8 03 40 00", Options::Frame(Check::Crc16)));
    assert!(text.contains("wrong at byte 0: the run at byte 0 says 5 bytes, 4 are left [FRM-07]"), "{text}");
    let text = render(&explained("00 05 05 e8 03 40 04 41 c0 18 01 04 2a b9 64 00", Options::Auto));
    let expected = "\
a frame: it ends in a delimiter and its CRC-16 is right

frame
byte  hex          field      says
   0  00           idle       delimiters before the frame         ignored, [FRM-05]
   1  05           code       4 bytes, then a zero
   2  05 e8 03 40  run        bytes 0 to 3 of packet and check
   6  04           code       3 bytes, then a zero
   7  41 c0 18     run        bytes 5 to 7 of packet and check
  10  01           code       0 bytes, then a zero
  11  04           code       3 bytes                             the last run: its zero is the end of the frame
  12  2a b9 64     run        bytes 10 to 12 of packet and check
  15  00           delimiter  ends the frame

packet in it
byte  hex       field            says
   0  05        pointer          5                the instruction at byte 5 is carried out next
   1  e8 03     TTL              1000 µs          time to live
   3  40 00     MTU              64 bytes         smallest packet size on the route
   5  41        step 1, current  link 1           the receiver writes its own gateway here and sets the pointer to 6
   6  c0 18 00  end of route     port 3 → port 0  delivered where the steps end
   9  00        transport        datagram         nothing answers for its arrival
  10  2a        payload          1 byte
  11  b9 64     CRC-16           0x64b9           right

wrong at byte 9 of the packet: port 0 takes sequenced requests only [DSC-02]
  then: the receiver drops it and counts one more query-malformed

dropped, query-malformed: port 0 takes sequenced requests only
";
    assert_eq!(text, expected);
}

/// The drop's name, `[NOD-09]`, and the clause for every way a header, a frame or a transport can be wrong.
#[test]
fn what_is_wrong_has_its_name_and_clause() {
    for (hex, cause, clause) in [
        ("", "short", "PKT-02"),
        ("05 e8 03 40 00", "short", "PKT-02"),
        ("04 e8 03 40 00 02", "pointer-outside", "PKT-02"),
        ("ff e8 03 40 00 41 02", "pointer-outside", "PKT-02"),
        ("05 e8 03 40 00 82", "instruction-cut", "PKT-02"),
        ("06 e8 03 40 00 41 c0 18", "instruction-cut", "PKT-02"),
        ("06 e8 03 40 00 41 c0 18 00", "transport-missing", "PKT-05"),
        ("05 e8 03 40 00 41", "pointer-outside", "PKT-02"),
        ("05 e8 03 40 00 41 41 82", "instruction-cut", "PKT-02"),
        ("05 e8 03 40 00 41 c0 18 00", "transport-missing", "PKT-05"),
        ("05 e8 03 0a 00 41 c0 18 01 00 2a", "over-mtu", "PKT-12"),
        ("05 00 00 40 00 41 c0 18 01 00 2a", "expired", "PKT-10"),
        ("06 e8 03 40 00 41 c0 18 01 03", "unknown-transport", "TRN-01"),
        ("06 e8 03 40 00 41 c0 18 01 01 05", "transport-malformed", "TRN-03"),
        ("06 e8 03 40 00 41 c0 18 01 01 05 c0", "transport-malformed", "TRN-03"),
        ("06 e8 03 40 00 41 c0 18 01 02 03 09 00 00 01 00", "transport-malformed", "TRN-07"),
        ("06 e8 03 40 00 41 c0 18 01 02 00 09 04 00 04 00", "segment-invalid", "TRN-08"),
        ("06 e8 03 40 00 41 07", "unknown-system-key", "SYS-01"),
        ("06 e8 03 40 00 41 06 01 00", "system-malformed", "MOT-20"),
        ("06 e8 03 40 00 41 02 01 01", "system-malformed", "SYS-05"),
        ("06 e8 03 40 00 41 02 02 01 02 03 04 05 06 07 08 09 0a 0b 0c 07 01 00", "system-malformed", "SYS-05"),
        ("06 e8 03 40 00 41 c0 18 00 01 05 00 01", "query-malformed", "DSC-02"),
        ("06 e8 03 40 00 41 00 01 07 ff 00 01 00", "system-malformed", "TIM-01"),
        ("06 e8 03 40 00 41 00 02 07 00 01 00 00", "system-malformed", "TIM-01"),
        ("06 e8 03 40 00 41 01 01 07 00 01 00 00", "system-malformed", "TIM-02"),
        ("07 e8 03 40 00 41 42 00 01 07 ff 00 01 00 00", "system-malformed", "TIM-01"),
    ] {
        let explanation = explained(hex, Options::Packet);
        let found: Vec<_> = explanation.problems.iter().map(|it| (it.drop_cause, it.clause)).collect();
        assert_eq!(found, [(Some(cause), clause)], "{hex}");
        assert!(explanation.verdict.starts_with(&format!("dropped, {cause}: ")), "{hex}: {}", explanation.verdict);
    }
    for (hex, cause, clause) in [
        ("00", "frame-too-short", "FRM-07"),
        ("03 ff ff 00", "frame-too-short", "FRM-07"),
        ("05 05 e8 03 40 04 41 c0 18 01 04 2b b9 64 00", "frame-check", "FRM-02"),
        ("04 2a 00 04 2a d8 64 00", "frame-malformed", "FRM-07"),
        // the pointer is on the port instruction; check 6ed3
        ("05 06 e8 03 40 05 40 c0 18 01 04 2a d3 6e 00", "not-forwarding", "PKT-08"),
    ] {
        let explanation = explained(hex, Options::Frame(Check::Crc16));
        let first = &explanation.problems[0];
        assert_eq!((first.drop_cause, first.clause), (Some(cause), clause), "{hex}");
    }
}

/// A step that only a later node stumbles over is not blamed on the next one.
#[test]
fn it_is_said_which_node_drops_it() {
    let explanation = explained("05 e8 03 40 00 41 44 46 82", Options::Packet);
    assert_eq!(explanation.problems[0].then, "the node 3 steps on drops it and counts one more instruction-cut");
    assert_eq!(
        explained("05 e8 03 40 00 41 82", Options::Packet).problems[0].then,
        "the receiver drops it and counts one more instruction-cut"
    );
}

/// `[PKT-06]`, `[PKT-09]`, `[SYS-02]`
#[test]
fn routes_that_lead_nowhere_are_found() {
    let mut long = vec![254, 0xe8, 3, 0xff, 1];
    long.resize(257, 0x41);
    long.push(2);
    assert_eq!(explain(&long, Options::Packet).problems[0].clause, "PKT-06");
    let halved = explained("06 e8 03 40 00 82 c0 18 01 00", Options::Packet);
    assert_eq!((halved.problems[0].drop_cause, halved.problems[0].clause), (None, "PKT-09"));
    let far = explained("05 ff ff 40 00 41 42 02 01 01 02 03 04 05 06 07 08 09 0a 0b 0c 07 01 00", Options::Packet);
    assert_eq!((far.problems[0].drop_cause, far.problems[0].clause), (None, "SYS-02"));
}

/// `[DSC-02]`: a refused query is answered, not dropped.
#[test]
fn refused_queries_and_refusals_are_told_apart() {
    for (body, refusal) in [
        ("05 00 00 01", Refusal::UnknownKey),
        ("05 00 01 02 ac 02 01", Refusal::Version),
        ("05 00 01 01 ac", Refusal::Body),
        ("05 00 04 01 02 c3 28", Refusal::Body),
        ("05 00 0a 01 00 be 14 80 80 08 00 c0 9a 0c 80 90 03 00 80", Refusal::Range),
    ] {
        let explanation = explained(&format!("{TO_0}{body}"), Options::Packet);
        assert_eq!(causes(&explanation), [None], "{body}");
        let expected = format!("the node answers with refusal {} ({refusal})", refusal.code());
        assert!(explanation.problems[0].then.starts_with(&expected), "{body}: {}", explanation.problems[0].then);
    }
    let explanation = explained(&format!("{FROM_0}08 80 05 01 04"), Options::Packet);
    assert_eq!(explanation.field("sequence").unwrap().value, "refusal 8");
    assert_eq!(explanation.field("reason").unwrap().note, Refusal::Index.meaning());
    assert!(explanation.problems.is_empty());
}

/// `[DSC-01]`: the same bytes are a question to port 0 and an answer from there.
#[test]
fn the_sequence_word_tells_questions_from_answers() {
    let asked = explained(&format!("{TO_0}05 00 03 01"), Options::Packet);
    assert!(asked.problems.is_empty() && asked.field("name").is_none());
    let answered = explained(&format!("{FROM_0}05 40 03 01 06 78 1b 61 78 69 73"), Options::Packet);
    // a name from a device cannot move the cursor of whoever reads it
    assert_eq!(answered.field("name").unwrap().value, "\"x\\u{1b}axis\"");
    let elsewhere = explained(&format!("{TO_0}05 40 03 01"), Options::Packet);
    assert_eq!(elsewhere.field("payload").unwrap().len, 2);
}

/// `[DSC-06]`, `[DSC-07]`: counters bear the names of their drops, times their µs.
#[test]
fn answers_are_read_down_to_their_values() {
    let page = "12 40 0b 01 10 1e 0e 00 01 ac 02 ff ff ff ff 0f 00 00 00 00 00 00 00 00 00 02";
    let counters = explained(&format!("{FROM_0}{page}"), Options::Packet);
    assert_eq!(counters.field("displaced count").unwrap().value, "300");
    assert_eq!(counters.field("peer-refused count").unwrap().value, "2");
    let control = "10 40 09 01 00 40 42 0f 00 00 00 00 00 41 42 0f 00 00 00 00 10 27 00 00 ff ff ff ff 20 4e 00 00 00 02 00 00 \
                   00 64 00 00 00 60 00 00 1f 05 00 00 00 00 01 00 00 00 00 00 a0 86 01 00 00 64 00 00 02";
    let control = explained(&format!("{FROM_0}{control}"), Options::Packet);
    let offset = control.field("offset").unwrap();
    assert_eq!((offset.value.as_str(), offset.note.as_str()), ("-1 steps", "-0.004 µs"));
    assert_eq!(control.field("system time").unwrap().note, "1000000.000 µs");
    assert!(control.problems.is_empty() && counters.problems.is_empty());
}

/// `[TIM-01]`, `[TIM-02]`: both messages down to their slots, with what stands in them in µs.
#[test]
fn messages_about_time_are_read_down_to_their_slots() {
    let asked = explained("06 ff ff 80 00 41 00 01 07 ff 00 01 00 00", Options::Packet);
    let slot = asked.field("departed").unwrap();
    assert_eq!((slot.value.as_str(), slot.note.as_str()), ("256 steps", "1.000 µs"));
    let said = TimeReply {
        sequence: 7,
        asked_slot: 256,
        system: NetTime::from_us(77),
        rate: Rate::from_bits(-3),
        tier: 1,
        unix: Some(UnixOffset { offset_us: -5, hops: 2 }),
        ..TimeReply::default()
    };
    let mut body = [0; TimeReply::LEN];
    said.encode(&mut body).unwrap();
    let mut packet = parse_hex("06 ff ff 80 00 41 01").unwrap();
    packet.extend(body);
    let answered = explain(&packet, Options::Packet);
    assert_eq!(answered.problems, []);
    for (name, value) in
        [("asked at", "256 steps"), ("system time", "19712 steps"), ("rate", "-3 / 2³²"), ("UNIX offset", "-5 µs")]
    {
        assert_eq!(answered.field(name).unwrap().value, value);
    }
    // a flag that nobody has
    let flags = packet.len() - 4 - 9 - 1;
    packet[flags] |= 16;
    assert_eq!(explain(&packet, Options::Packet).problems[0].clause, "TIM-02");
}

#[test]
fn what_is_taken_for_a_frame_is_said_with_its_reason() {
    let packet = parse_hex("05 e8 03 40 00 41 c0 18 01 00 2a").unwrap();
    for check in [Check::None, Check::Crc16, Check::Crc32] {
        let mut frame = vec![0; encoded_len_max(packet.len(), check)];
        let len = encode(&packet, check, &mut frame).unwrap();
        let explanation = explain(&frame[..len], Options::Auto);
        assert_eq!((explanation.kind, explanation.check), (Kind::Frame, Some(check_name(check))));
        assert_eq!(explanation.packet, Some(hex::hex_of(&packet)));
        assert!(explanation.problems.is_empty(), "{:?}", explanation.problems);
    }
    let ends_in_zero = explained("05 e8 03 40 00 41 c0 18 01 00 00", Options::Auto);
    assert_eq!((ends_in_zero.kind, ends_in_zero.problems.len()), (Kind::Packet, 0));
    let damaged = explained("04 05 d8 65 00", Options::Auto);
    assert!(damaged.why.contains("--as frame"), "{}", damaged.why);
}

/// A check that was set differently at both ends is the commonest cause of a dead link.
#[test]
fn another_check_that_is_right_is_mentioned() {
    let explanation = explained("05 05 e8 03 40 04 41 c0 18 01 04 2a b9 64 00", Options::Frame(Check::Crc32));
    assert!(explanation.verdict.contains("its CRC-16 is right"), "{}", explanation.verdict);
}

#[test]
fn the_json_names_its_schema_and_all_bytes() {
    let json = serde_json::to_value(explained("06 e8 03 40 00 41 02", Options::Packet)).unwrap();
    assert_eq!((&json["schema"], &json["kind"]), (&"osap.decode/1".into(), &"packet".into()));
    assert_eq!(json["problems"][0]["drop_cause"], "system-malformed");
    assert_eq!(
        json["fields"][1],
        serde_json::json!({
            "part": "packet", "offset": 1, "len": 2, "hex": "e8 03", "name": "TTL", "value": "1000 µs", "note": "time to live"
        })
    );
}

/// Bodies that are whole, by query and direction; the property below damages them.
const BODIES: [(Query, bool, &str); 17] = [
    (Query::RuntimeInfo, true, "ac 02 01"),
    (
        Query::RuntimeInfo,
        false,
        "ac 02 01 01 02 03 04 05 06 07 08 09 0a 0b 0c 07 00 01 00 02 03 80 01 80 02 10 02 c0 84 3d",
    ),
    (Query::SetRuntimeName, true, "07 47 72 c3 b6 c3 9f 65"),
    (
        Query::LinkInfo,
        false,
        "04 75 61 72 74 00 01 40 c0 8d b7 01 0a 01 01 01 02 03 04 05 06 07 08 09 0a 0b 0c 07 00 04 ac 02 ab 02 01",
    ),
    (Query::LinkInfo, false, "05 72 73 34 38 35 01 03 00 80 01 00 0a 02 00 02 00 00 00"),
    (Query::PortInfo, true, "c8 01"),
    (Query::PortInfo, false, "0c 6e 65 74 72 65 73 70 6f 6e 64 65 72 00 02 05 04"),
    (Query::DebugMessages, false, "00 04 07 02 00 04 e8 07 00 03 01 01 d0 0f 01 01 00 b8 17 02 00 03 a0 1f 03"),
    (
        Query::DebugMessages,
        false,
        "04 07 07 03 01 90 4e a8 46 07 ac 02 04 01 00 0f 00 02 04 03 ac 02 03 05 03 68 6f 74 04 06 03 01",
    ),
    (Query::SetDebugVerbosity, true, "03"),
    (Query::SetTimeControl, true, "90 4e be 14 80 80 08 00 c0 9a 0c 80 90 03 01 80"),
    (
        Query::TimeStatus,
        false,
        "90 4e be 14 80 80 08 00 c0 9a 0c 80 90 03 00 80 01 80 01 02 03 04 05 06 07 08 09 0a 0b 0c 01 00 01 3c ac 02 03 d0 0f 01 04 01 02",
    ),
    (Query::TimeLink, false, "00 01 02 03 04 05 06 07 08 09 0a 0b 0c ac 02 01 00 01 9f 9c 01 80 02 80 02 05 80 04 00"),
    (Query::TimeLink, true, "03"),
    (Query::SetTimeAsymmetry, true, "04 75 61 72 74 0f"),
    (Query::Counters, false, "10 1e 04 00 01 ac 02 ff ff ff ff 0f"),
    (Query::TypeName, true, ""),
];

/// Whether the code that nodes run reads `body`.
fn node_reads(query: Query, is_request: bool, body: &[u8]) -> bool {
    fn reads<'a, T: Deserialize<'a>>(message: &'a [u8]) -> bool {
        discovery::decode(message).is_ok_and(|message| message.body.read::<T>().is_ok())
    }
    let message = [&[query.key(), discovery::VERSION], body].concat();
    match (query, is_request) {
        (Query::RuntimeInfo, true) => reads::<ScanId>(&message),
        (Query::RuntimeInfo, false) => reads::<RuntimeInfo>(&message),
        (Query::TypeName | Query::RuntimeName, false) | (Query::SetRuntimeName, true) => reads::<Name>(&message),
        (Query::LinkInfo | Query::Counters | Query::TimeLink, true) => reads::<u8>(&message),
        (Query::LinkInfo, false) => reads::<LinkInfo>(&message),
        (Query::PortInfo, true) => reads::<u16>(&message),
        (Query::PortInfo, false) => reads::<PortInfo>(&message),
        (Query::DebugMessages, true) => reads::<u32>(&message),
        (Query::DebugMessages, false) => reads::<DebugPage>(&message),
        (Query::SetDebugVerbosity, true) => reads::<Verbosity>(&message),
        (Query::SetTimeControl, true) => reads::<TimeSettings>(&message),
        (Query::TimeControl, false) => reads::<TimeControl>(&message),
        (Query::TimeStatus, false) => reads::<TimeStatus>(&message),
        (Query::TimeLink, false) => reads::<TimeLink>(&message),
        (Query::SetTimeAsymmetry, true) => reads::<TimeAsymmetry>(&message),
        (Query::Counters, false) => reads::<CounterPage>(&message),
        _ => reads::<()>(&message),
    }
}

fn is_shown_whole(query: Query, is_request: bool, body: &[u8]) -> bool {
    let items = if is_request { shapes::request(query) } else { shapes::answer(query) };
    show(&mut Pen::new(Part::Packet, body), 0, items) == Shown::Whole
}

#[test]
fn the_bodies_are_whole_before_they_are_damaged() {
    for (query, is_request, hex) in BODIES {
        let body = parse_hex(hex).unwrap();
        assert!(node_reads(query, is_request, &body) && is_shown_whole(query, is_request, &body), "{query:?} {hex}");
    }
}

/// Bounds lie where chance does not find them: at each, the last value that fits and the first that does not.
#[test]
fn both_readers_stop_at_the_same_bounds() {
    let text = |len: u8| [&[len], &vec![b'x'; usize::from(len)][..]].concat();
    let events = |event: &[u8], count: u8| [&[0, 0, 0, 0, 0, count], &event.repeat(usize::from(count))[..]].concat();
    let counters = |count: u8| [&[0, 30, count], &vec![1; usize::from(count)][..]].concat();
    let said = |len: u8| events(&[&[1, 5], &text(len)[..]].concat(), 1);
    let after = |head: &[u8], number: &str| [head, &parse_hex(number).unwrap()].concat();
    let link = |rate: &str| [&text(4)[..], &[0, 1, 64], &after(&[], rate), &[10, 1, 0, 4, 0, 0, 0]].concat();
    for (query, is_request, fits, does_not) in [
        (Query::SetRuntimeName, true, text(32), text(33)),
        (Query::TypeName, false, text(32), text(33)),
        (Query::RuntimeInfo, true, after(&[1], "ff ff 03"), after(&[1], "80 80 04")),
        (Query::RuntimeInfo, true, after(&[], "ff ff ff ff 0f 01"), after(&[], "80 80 80 80 10 01")),
        (Query::PortInfo, true, after(&[], "ff ff 03"), after(&[], "ff ff 83 00")),
        (Query::DebugMessages, true, after(&[], "ff ff ff ff 0f"), after(&[], "ff ff ff ff 8f 00")),
        (Query::DebugMessages, false, events(&[1, 3], 4), events(&[1, 3], 5)),
        (Query::DebugMessages, false, said(40), said(41)),
        (Query::DebugMessages, false, events(&[1, 0, 33, 0], 1), events(&[1, 0, 34, 0], 1)),
        (Query::DebugMessages, false, events(&[1, 4, 5, 0], 1), events(&[1, 4, 6, 0], 1)),
        (Query::DebugMessages, false, events(&[1, 6, 3, 0], 1), events(&[1, 6, 4, 0], 1)),
        (Query::SetTimeControl, true, [&[1; 6][..], &[2, 255]].concat(), [&[1; 6][..], &[3, 255]].concat()),
        (Query::LinkInfo, false, link("ff ff ff ff 0f"), link("ff ff ff ff 1f")),
        (Query::SetDebugVerbosity, true, vec![3], vec![4]),
        (Query::SetTimeControl, true, vec![1; 8], [vec![1; 5], vec![255; 5], vec![1; 2]].concat()),
        (Query::Counters, false, counters(16), counters(17)),
    ] {
        for (body, whole) in [(fits, true), (does_not, false)] {
            let both = (node_reads(query, is_request, &body), is_shown_whole(query, is_request, &body));
            assert_eq!(both, (whole, whole), "{query:?} {body:02x?}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// No bytes panic; fields lie inside their part and never overlap.
    #[test]
    fn any_bytes_are_explained(bytes in proptest::collection::vec(any::<u8>(), 0..300), how in 0usize..5) {
        let options =
            [Options::Auto, Options::Packet, Options::Frame(Check::None), Options::Frame(Check::Crc16), Options::Frame(Check::Crc32)];
        let explanation = explain(&bytes, options[how]);
        prop_assert!(!render(&explanation).is_empty());
        for part in [Part::Frame, Part::Packet] {
            let mut end = 0;
            for field in explanation.fields.iter().filter(|field| field.part == part) {
                prop_assert!(field.offset >= end && field.offset + field.len <= bytes.len(), "{field:?} after {end}");
                end = field.offset + field.len;
            }
        }
        let all = explanation.fields.iter().filter(|it| matches!(explanation.kind, Kind::Packet) || it.part == Part::Frame);
        prop_assert_eq!(all.map(|field| field.len).sum::<usize>(), bytes.len(), "not every byte is explained");
    }

    /// As above for bytes that get past the header.
    #[test]
    fn any_payload_is_explained(
        route in "(41|82 07|44| ){0,3}",
        terminal in prop::sample::select(vec!["c0 18 00 01", "c0 00 03 01", "c0 18 01 02", "02", "c0 18 01 00"]),
        payload in proptest::collection::vec(any::<u8>(), 0..40),
        pointer in 5u8..12,
    ) {
        let mut bytes = vec![pointer, 0xe8, 3, 0xff, 0];
        bytes.extend(parse_hex(&format!("{route} {terminal}")).unwrap());
        bytes.extend(payload);
        let explanation = explain(&bytes, Options::Packet);
        prop_assert_eq!(explanation.fields.iter().map(|field| field.len).sum::<usize>(), bytes.len(), "{}", render(&explanation));
    }

    /// What is shown as whole is what a node reads, for bodies with a few bytes changed, cut off or added.
    #[test]
    fn both_readers_agree(
        which in any::<prop::sample::Index>(),
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..3),
        cut in 0usize..3,
        more in proptest::collection::vec(any::<u8>(), 0..2),
    ) {
        let (query, is_request, hex) = BODIES[which.index(BODIES.len())];
        let mut body = parse_hex(hex).unwrap();
        for (at, value) in changes {
            if !body.is_empty() {
                let at = at.index(body.len());
                body[at] = value;
            }
        }
        body.truncate(body.len().saturating_sub(cut));
        body.extend(more);
        prop_assert_eq!(is_shown_whole(query, is_request, &body), node_reads(query, is_request, &body), "{:?} {:02x?}", query, body);
    }

    /// The same for announcements.
    #[test]
    fn announcements_are_read_alike(
        change in any::<prop::sample::Index>(),
        value in prop_oneof![any::<u8>(), 0u8..3],
        cut in 0usize..3,
        extra in any::<bool>(),
    ) {
        let mut body = parse_hex("01 01 02 03 04 05 06 07 08 09 0a 0b 0c ac 02 01 01 03").unwrap();
        let at = change.index(body.len());
        body[at] = value;
        body.truncate(body.len() - cut);
        body.extend(extra.then_some(0));
        let whole = show(&mut Pen::new(Part::Packet, &body), 0, shapes::ANNOUNCEMENT) == Shown::Whole;
        prop_assert_eq!(whole && body[0] == 1, Announcement::decode(&body).is_ok(), "{:02x?}", body);
    }

    /// The same for messages about time; what is read has the version, the flags and the tier that there are.
    #[test]
    fn messages_about_time_are_read_alike(
        is_reply in any::<bool>(),
        change in any::<prop::sample::Index>(),
        value in any::<u8>(),
        cut in 0usize..2,
        extra in any::<bool>(),
    ) {
        let mut body = vec![0; if is_reply { TimeReply::LEN } else { TimeRequest::LEN }];
        body[0] = 1;
        let at = change.index(body.len());
        body[at] = value;
        body.truncate(body.len() - cut);
        body.extend(extra.then_some(0));
        let mut packet = parse_hex("06 ff ff 80 00 41").unwrap();
        packet.push(u8::from(is_reply));
        packet.extend(&body);
        let is_read = if is_reply { TimeReply::decode(&body).is_ok() } else { TimeRequest::decode(&body).is_ok() };
        prop_assert_eq!(explain(&packet, Options::Packet).problems.is_empty(), is_read, "{:02x?}", body);
    }

    /// Whether a packet is dropped at once is what the node's own check says.
    #[test]
    fn the_header_is_judged_as_a_node_does(bytes in proptest::collection::vec(0u8..16, 0..16)) {
        let cause = Packet::check(&bytes[..]).err().map(|error| DropCause::from(error).name());
        let explanation = explain(&bytes, Options::Packet);
        if cause.is_some() {
            prop_assert_eq!(explanation.problems[0].drop_cause, cause);
        }
    }
}

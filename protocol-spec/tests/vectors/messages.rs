//! Transports and discovery: `[TRN-01]` to `[TRN-09]`, `[DSC-01]` to `[DSC-07]`, `[TIM-11]` to `[TIM-15]`.

use crate::{At, Clauses, Hex, each, vector_file, vectors};
use osap_protocol::DropCause;
use osap_protocol::discovery::{
    self, CounterPage, DebugPage, LinkInfo, Message, Name, PortInfo, Query, Refusal, RuntimeInfo, ScanId,
    TimeAsymmetry, TimeControl, TimeLink, TimeSettings, TimeStatus, Verbosity,
};
use osap_protocol::transport::{SegmentHeader, SegmentRefusal, Sequence, SequencedHeader, SequencedKind, Transport};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::fmt::Debug;

pub(crate) const TRANSPORT: &str = "transport.toml";
pub(crate) const DISCOVERY: &str = "discovery.toml";

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TransportFile {
    key: Vec<TransportKey>,
    sequenced: Vec<Sequenced>,
    segment: Vec<Segment>,
    refused: Vec<RefusedTransport>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum TransportName {
    Datagram,
    Sequenced,
    Segmented,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TransportKey {
    name: String,
    clause: Clauses,
    bytes: Hex,
    transport: TransportName,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Kind {
    Request,
    Reply,
    Refusal,
}

impl Kind {
    fn kind(self) -> SequencedKind {
        match self {
            Self::Request => SequencedKind::Request,
            Self::Reply => SequencedKind::Reply,
            Self::Refusal => SequencedKind::Refusal,
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Sequenced {
    name: String,
    clause: Clauses,
    bytes: Hex,
    kind: Kind,
    sequence: u16,
    rest: Hex,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Segment {
    name: String,
    clause: Clauses,
    bytes: Hex,
    data: Option<SegmentData>,
    acknowledge: Option<SegmentAcknowledge>,
    refuse: Option<SegmentRefuse>,
    rest: Hex,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SegmentData {
    message: u8,
    index: u16,
    count: u16,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SegmentAcknowledge {
    message: u8,
    next: u16,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SegmentRefuse {
    message: u8,
    reason: SegmentReason,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum SegmentReason {
    Busy,
    TooLong,
}

impl Segment {
    fn header(&self, at: &At<'_>) -> SegmentHeader {
        match (&self.data, &self.acknowledge, &self.refuse) {
            (Some(it), None, None) => SegmentHeader::Data { message: it.message, index: it.index, count: it.count },
            (None, Some(it), None) => SegmentHeader::Acknowledge { message: it.message, next: it.next },
            (None, None, Some(it)) => {
                let reason = match it.reason {
                    SegmentReason::Busy => SegmentRefusal::Busy,
                    SegmentReason::TooLong => SegmentRefusal::TooLong,
                };
                SegmentHeader::Refuse { message: it.message, reason }
            }
            _ => panic!("{at}: a segment is one of data, acknowledge and refuse"),
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RefusedTransport {
    name: String,
    clause: Clauses,
    bytes: Hex,
    transport: Option<TransportName>,
    cause: String,
}

#[test]
fn transports() {
    let file: TransportFile = vector_file(TRANSPORT);
    each(TRANSPORT, &file.key, |at, v| {
        let transport = match v.transport {
            TransportName::Datagram => Transport::Datagram,
            TransportName::Sequenced => Transport::Sequenced,
            TransportName::Segmented => Transport::Segmented,
        };
        assert_eq!(v.bytes.0, [transport.key()], "{at}: written");
        assert_eq!(Transport::from_key(v.bytes.0[0]), Ok(transport), "{at}: read");
    });
    each(TRANSPORT, &file.sequenced, |at, v| {
        let header = SequencedHeader { kind: v.kind.kind(), sequence: Sequence::new(v.sequence) };
        assert_eq!(header.sequence.get(), v.sequence, "{at}: the number has more than fourteen bits");
        assert_eq!([&header.encode()[..], &v.rest.0].concat(), v.bytes.0, "{at}: written");
        assert_eq!(SequencedHeader::parse(&v.bytes.0), Ok((header, &v.rest.0[..])), "{at}: read");
    });
    each(TRANSPORT, &file.segment, |at, v| {
        let mut out = [0; SegmentHeader::LEN_MAX];
        let header = v.header(at);
        let len = header.encode(&mut out);
        assert_eq!([&out[..len], &v.rest.0].concat(), v.bytes.0, "{at}: written");
        assert_eq!(SegmentHeader::parse(&v.bytes.0), Ok((header, &v.rest.0[..])), "{at}: read");
    });
    each(TRANSPORT, &file.refused, |at, v| {
        let cause = match v.transport {
            None => Transport::from_key(v.bytes.0[0]).expect_err(&at.to_string()),
            Some(TransportName::Sequenced) => SequencedHeader::parse(&v.bytes.0).expect_err(&at.to_string()),
            Some(TransportName::Segmented) => SegmentHeader::parse(&v.bytes.0).expect_err(&at.to_string()),
            Some(TransportName::Datagram) => panic!("{at}: any payload is a datagram"),
        };
        assert_eq!(cause.name(), v.cause, "{at}");
    });
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DiscoveryFile {
    message: Vec<Exchange>,
    time_control: Vec<FixedWidth>,
    refusal: Vec<Refused>,
    unreadable: Vec<Unreadable>,
    dropped: Vec<Dropped>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Exchange {
    name: String,
    clause: Clauses,
    bytes: Hex,
    kind: Kind,
    sequence: u16,
    query: String,
    value: Option<toml::Value>,
}

/// [`TimeControl`] with numbers as numbers: the code's own serialisation of it is bytes.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FixedWidth {
    name: String,
    clause: Clauses,
    bytes: Hex,
    sequence: u16,
    system_time_steps: u64,
    local_ticks_steps: u64,
    interval_us: u32,
    offset_steps: i32,
    skew_ppb: i32,
    bound_steps: i32,
    round_trip_steps: i32,
    round_trip_min_steps: i32,
    filter_q16: i32,
    proportional_q16: i32,
    integral_q16: i32,
    skew_limit_ppb: i32,
    gate_steps: i32,
    tier: u8,
}

impl FixedWidth {
    fn value(&self) -> TimeControl {
        TimeControl {
            system_time_steps: self.system_time_steps,
            local_ticks_steps: self.local_ticks_steps,
            interval_us: self.interval_us,
            offset_steps: self.offset_steps,
            skew_ppb: self.skew_ppb,
            bound_steps: self.bound_steps,
            round_trip_steps: self.round_trip_steps,
            round_trip_min_steps: self.round_trip_min_steps,
            filter_q16: self.filter_q16,
            proportional_q16: self.proportional_q16,
            integral_q16: self.integral_q16,
            skew_limit_ppb: self.skew_limit_ppb,
            gate_steps: self.gate_steps,
            tier: self.tier,
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Refused {
    name: String,
    clause: Clauses,
    bytes: Hex,
    sequence: u16,
    key: u8,
    reason: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Unreadable {
    name: String,
    clause: Clauses,
    bytes: Hex,
    reason: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Dropped {
    name: String,
    clause: Clauses,
    bytes: Hex,
    cause: String,
}

vectors!(TransportKey, Sequenced, Segment, RefusedTransport);
vectors!(Exchange, FixedWidth, Refused, Unreadable, Dropped);

/// The sequence word's meaning, checked, and what follows it.
fn after_word<'a>(at: &At<'_>, bytes: &'a Hex, kind: SequencedKind, sequence: u16) -> &'a [u8] {
    let (header, rest) = SequencedHeader::parse(&bytes.0).unwrap_or_else(|cause| panic!("{at}: {}", cause.name()));
    assert_eq!((header.kind, header.sequence.get()), (kind, sequence), "{at}: sequence word");
    rest
}

/// `message` reads as `value`, and `value` writes as `message`.
fn agree_on<T: Serialize + DeserializeOwned + PartialEq + Debug>(at: &At<'_>, query: Query, message: &[u8], value: &T) {
    let mut out = [0; 2 + discovery::BODY_BYTES_MAX];
    let len = discovery::encode(query.key(), value, &mut out).expect("the stated bound suffices");
    assert_eq!(&out[..len], message, "{at}: written");
    let Message { key, body } = discovery::decode(message).unwrap_or_else(|refusal| panic!("{at}: {refusal}"));
    assert_eq!(Query::from_key(key), Ok(query), "{at}: key");
    assert_eq!(body.read::<T>().as_ref(), Ok(value), "{at}: read");
}

/// As [`agree_on`] for a value out of the file. That it goes back into the file unchanged shows that no field of it was passed over.
fn agree<T: Serialize + DeserializeOwned + PartialEq + Debug>(
    at: &At<'_>,
    query: Query,
    message: &[u8],
    said: Option<&toml::Value>,
) {
    let said = said.unwrap_or_else(|| panic!("{at}: no value"));
    let value: T = said.clone().try_into().unwrap_or_else(|error| panic!("{at}: {error}"));
    assert_eq!(toml::Value::try_from(&value).as_ref(), Ok(said), "{at}: a field that the code does not know");
    agree_on(at, query, message, &value);
}

#[test]
fn queries_and_answers() {
    let file: DiscoveryFile = vector_file(DISCOVERY);
    let mut seen = Vec::new();
    each(DISCOVERY, &file.message, |at, v| {
        let rest = after_word(at, &v.bytes, v.kind.kind(), v.sequence);
        let named = Query::ALL.into_iter().find(|query| query.name() == v.query);
        let query = named.unwrap_or_else(|| panic!("{at}: no query is called \"{}\"", v.query));
        seen.push((query, v.kind.kind()));
        let said = v.value.as_ref();
        match (query, v.kind) {
            (_, Kind::Refusal) => panic!("{at}: refusals are a kind of their own"),
            (Query::RuntimeInfo, Kind::Request) => agree::<ScanId>(at, query, rest, said),
            (Query::RuntimeInfo, Kind::Reply) => agree::<RuntimeInfo>(at, query, rest, said),
            (Query::TypeName | Query::RuntimeName, Kind::Reply) | (Query::SetRuntimeName, Kind::Request) => {
                agree::<Name>(at, query, rest, said);
            }
            (Query::LinkInfo | Query::Counters | Query::TimeLink, Kind::Request) => agree::<u8>(at, query, rest, said),
            (Query::LinkInfo, Kind::Reply) => agree::<LinkInfo>(at, query, rest, said),
            (Query::PortInfo, Kind::Request) => agree::<u16>(at, query, rest, said),
            (Query::PortInfo, Kind::Reply) => agree::<PortInfo>(at, query, rest, said),
            (Query::DebugMessages, Kind::Request) => agree::<u32>(at, query, rest, said),
            (Query::DebugMessages, Kind::Reply) => agree::<DebugPage>(at, query, rest, said),
            (Query::SetDebugVerbosity, Kind::Request) => agree::<Verbosity>(at, query, rest, said),
            (Query::SetTimeControl, Kind::Request) => agree::<TimeSettings>(at, query, rest, said),
            (Query::Counters, Kind::Reply) => agree::<CounterPage>(at, query, rest, said),
            (Query::TimeStatus, Kind::Reply) => agree::<TimeStatus>(at, query, rest, said),
            (Query::TimeLink, Kind::Reply) => agree::<TimeLink>(at, query, rest, said),
            (Query::SetTimeAsymmetry, Kind::Request) => agree::<TimeAsymmetry>(at, query, rest, said),
            (Query::TimeControl, Kind::Reply) => panic!("{at}: this answer is a kind of its own"),
            (Query::TypeName | Query::RuntimeName | Query::TimeControl | Query::TimeStatus, Kind::Request)
            | (
                Query::SetRuntimeName | Query::SetDebugVerbosity | Query::SetTimeControl | Query::SetTimeAsymmetry,
                Kind::Reply,
            ) => {
                assert!(said.is_none(), "{at}: a value where there is no body");
                agree_on(at, query, rest, &());
            }
        }
    });
    each(DISCOVERY, &file.time_control, |at, v| {
        assert_eq!(v.bytes.0.len(), 65, "{at}: [DSC-07]");
        agree_on(at, Query::TimeControl, after_word(at, &v.bytes, SequencedKind::Reply, v.sequence), &v.value());
        seen.push((Query::TimeControl, SequencedKind::Reply));
    });
    for query in Query::ALL {
        for kind in [SequencedKind::Request, SequencedKind::Reply] {
            assert!(seen.contains(&(query, kind)), "vectors/{DISCOVERY}: no {kind:?} of query {}", query.key());
        }
    }
}

/// Why a node refuses a request by looking at it alone.
fn refusal_of(message: &[u8]) -> Option<Refusal> {
    let read = || -> Result<(), Refusal> {
        let Message { key, body } = discovery::decode(message)?;
        match Query::from_key(key)? {
            Query::RuntimeInfo => body.read::<ScanId>().map(drop),
            Query::SetRuntimeName => body.read::<Name>().map(drop),
            Query::LinkInfo | Query::Counters | Query::TimeLink => body.read::<u8>().map(drop),
            Query::PortInfo => body.read::<u16>().map(drop),
            Query::DebugMessages => body.read::<u32>().map(drop),
            Query::SetDebugVerbosity => body.read::<Verbosity>().map(drop),
            Query::SetTimeControl => body.read::<TimeSettings>()?.in_range().then_some(()).ok_or(Refusal::Range),
            Query::TypeName | Query::RuntimeName | Query::TimeControl | Query::TimeStatus => body.read::<()>(),
            Query::SetTimeAsymmetry => body.read::<TimeAsymmetry>().map(drop),
        }
    };
    read().err()
}

#[test]
fn refusals() {
    let file: DiscoveryFile = vector_file(DISCOVERY);
    each(DISCOVERY, &file.refusal, |at, v| {
        let rest = after_word(at, &v.bytes, SequencedKind::Refusal, v.sequence);
        let Message { key, body } = discovery::decode(rest).unwrap_or_else(|refusal| panic!("{at}: {refusal}"));
        let reason = body.read::<u8>().ok().and_then(Refusal::from_code);
        assert_eq!((key, reason.map(Refusal::meaning)), (v.key, Some(&v.reason[..])), "{at}: read");
        let mut out = [0; 3];
        let written = discovery::encode(v.key, &reason.map_or(0, Refusal::code), &mut out);
        assert_eq!((written, &out[..]), (Ok(3), rest), "{at}: written");
    });
    each(DISCOVERY, &file.unreadable, |at, v| {
        let (_, rest) = SequencedHeader::parse(&v.bytes.0).unwrap_or_else(|cause| panic!("{at}: {}", cause.name()));
        assert!(discovery::check_query(rest).is_ok(), "{at}: no query at all");
        assert_eq!(refusal_of(rest).map(|refusal| format!("{refusal:?}")), Some(v.reason.clone()), "{at}");
    });
    each(DISCOVERY, &file.dropped, |at, v| {
        let (_, rest) = SequencedHeader::parse(&v.bytes.0).unwrap_or_else(|cause| panic!("{at}: {}", cause.name()));
        assert_eq!(discovery::check_query(rest).map_err(DropCause::name), Err(&v.cause[..]), "{at}");
    });
}

//! The bodies of `[DSC-01]` and `[SYS-02]` as tables: what stands in them, in the order of their bytes.
//!
//! The types themselves stand in `osap_protocol`; `postcard` writes no names, so they are said again here. The test
//! `both_readers_agree` fails where one of these tables and its type drift apart.

use osap_protocol::discovery::{COUNTERS_A_PAGE, EVENTS_A_PAGE, NAME_BYTES_MAX, Query, TEXT_BYTES_MAX};

/// One value of a body.
pub(super) struct Item {
    pub(super) name: &'static str,
    pub(super) shape: Shape,
}

/// A variant of an enum: its name and what follows it.
pub(super) type Variant = (&'static str, &'static [Item]);

/// How a value stands in bytes.
#[derive(Clone, Copy)]
pub(super) enum Shape {
    Byte,
    /// A byte that numbers the first of a list of counters.
    FirstCounter,
    Bool,
    Varint(Width, Unit),
    /// A signed number of 32 bits, doubled, as a varint.
    Zigzag(Unit),
    Fixed(Width, Unit),
    /// A length and that many bytes of UTF-8; at most so many.
    Text(usize),
    /// So many bytes, shown as digits.
    Digits(usize),
    /// Three bytes, shown as a version.
    Dotted,
    /// The number of a drop cause.
    Cause,
    Choice(&'static [Variant]),
    Maybe(&'static [Item]),
    /// At most so many of these.
    List(usize, &'static [Item]),
}

/// Width of a number.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Width {
    U16,
    U32,
    I32,
    U64,
}

impl Width {
    pub(super) const fn bits(self) -> usize {
        match self {
            Self::U16 => 16,
            Self::U32 | Self::I32 => 32,
            Self::U64 => 64,
        }
    }
}

/// What a number counts.
#[derive(Clone, Copy)]
pub(super) enum Unit {
    None,
    Named(&'static str),
    /// 1/256 µs.
    Steps,
}

const US: Unit = Unit::Named("µs");
const BYTES: Unit = Unit::Named("bytes");
const PPB: Unit = Unit::Named("/ 10⁹");
const Q16: Unit = Unit::Named("/ 65536");
/// Name of the list whose entries are called by their drop causes.
pub(super) const COUNTERS: &str = "counters";

const fn item(name: &'static str, shape: Shape) -> Item {
    Item { name, shape }
}

const fn varint(name: &'static str, width: Width) -> Item {
    item(name, Shape::Varint(width, Unit::None))
}

const fn fixed(name: &'static str, unit: Unit) -> Item {
    item(name, Shape::Fixed(Width::I32, unit))
}

const NAME: Shape = Shape::Text(NAME_BYTES_MAX);
const UNIQUE_ID: Item = item("unique id", Shape::Digits(12));
const BOOT_EPOCH: Item = varint("boot epoch", Width::U32);

/// Body of a link announcement.
pub(super) const ANNOUNCEMENT: &[Item] = &[
    item("version", Shape::Byte),
    UNIQUE_ID,
    BOOT_EPOCH,
    item("wants answer", Shape::Bool),
    item("own drop", Shape::Maybe(&[item("address", Shape::Byte)])),
];

const SCAN_ID: &[Item] = &[varint("scan", Width::U32), varint("visit", Width::U16)];

const RUNTIME_INFO: &[Item] = &[
    varint("previous scan", Width::U32),
    varint("previous visit", Width::U16),
    UNIQUE_ID,
    BOOT_EPOCH,
    item("runtime version", Shape::Dotted),
    item("build", Shape::Choice(&[("firmware", &[]), ("host", &[]), ("simulated", &[])])),
    item("gateways", Shape::Byte),
    varint("ports", Width::U16),
    item("largest packet", Shape::Varint(Width::U16, BYTES)),
    varint("slots", Width::U16),
    varint("topology generation", Width::U32),
    item("up for", Shape::Varint(Width::U64, US)),
];

const LINK_INFO: &[Item] = &[
    item("type name", NAME),
    item("kind", Shape::Choice(&[("link", &[]), ("bus", &[item("own drop", Shape::Byte)])])),
    item("open", Shape::Bool),
    item("largest packet", Shape::Varint(Width::U16, BYTES)),
    item("bit rate", Shape::Varint(Width::U32, Unit::Named("bit/s"))),
    item("bits a byte", Shape::Byte),
    item("check", Shape::Choice(&[("none", &[]), ("crc16", &[]), ("crc32", &[])])),
    item("neighbour", Shape::Maybe(&[UNIQUE_ID, BOOT_EPOCH, item("gateway", Shape::Byte)])),
    item("most packets held", Shape::Byte),
    varint("received", Width::U32),
    varint("sent", Width::U32),
    varint("dropped", Width::U32),
];

const PORT_INFO: &[Item] = &[
    item("type name", NAME),
    item("name", NAME),
    item("most packets held", Shape::Byte),
    varint("received", Width::U32),
    varint("sent", Width::U32),
];

const VERBOSITY: Item =
    item("verbosity", Shape::Choice(&[("silent", &[]), ("drops", &[]), ("events", &[]), ("packets", &[])]));

const STAGES: Shape = Shape::Choice(&[
    ("ingress", &[]),
    ("route", &[]),
    ("stack", &[]),
    ("egress", &[]),
    ("deliver", &[]),
    ("reply", &[]),
]);

const GATEWAY: Item = item("gateway", Shape::Byte);

const EVENTS: Shape = Shape::Choice(&[
    ("dropped", &[item("cause", Shape::Cause), item("came in by", Shape::Maybe(&[GATEWAY]))]),
    ("gateway", &[GATEWAY, item("open", Shape::Bool)]),
    (
        "neighbour",
        &[
            GATEWAY,
            item("change", Shape::Choice(&[("appeared", &[]), ("swapped", &[]), ("rebooted", &[]), ("lost", &[])])),
        ],
    ),
    ("renamed", &[]),
    ("stage", &[item("stage", STAGES), varint("index", Width::U16)]),
    ("text", &[item("text", Shape::Text(TEXT_BYTES_MAX))]),
]);

const DEBUG_PAGE: &[Item] = &[
    varint("first", Width::U32),
    varint("next", Width::U32),
    varint("end", Width::U32),
    VERBOSITY,
    item("event", Shape::List(EVENTS_A_PAGE, &[item("at", Shape::Varint(Width::U64, US)), item("tells of", EVENTS)])),
];

const COUNTER_PAGE: &[Item] = &[
    item("first", Shape::FirstCounter),
    item("of", Shape::Byte),
    item(COUNTERS, Shape::List(COUNTERS_A_PAGE, &[varint("count", Width::U32)])),
];

const TIME_CONTROL: &[Item] = &[
    item("system time", Shape::Fixed(Width::U64, Unit::Steps)),
    item("local counter", Shape::Fixed(Width::U64, Unit::Steps)),
    item("interval", Shape::Fixed(Width::U32, US)),
    fixed("offset", Unit::Steps),
    fixed("skew", PPB),
    fixed("bound", Unit::Steps),
    fixed("round trip", Unit::Steps),
    fixed("least round trip", Unit::Steps),
    fixed("filter", Q16),
    fixed("proportional gain", Q16),
    fixed("integral gain", Q16),
    fixed("skew limit", PPB),
    fixed("gate", Unit::Steps),
    item("tier", Shape::Byte),
];

const TIME_SETTINGS: &[Item] = &[
    item("interval", Shape::Varint(Width::U32, US)),
    item("filter", Shape::Zigzag(Q16)),
    item("proportional gain", Shape::Zigzag(Q16)),
    item("integral gain", Shape::Zigzag(Q16)),
    item("skew limit", Shape::Zigzag(PPB)),
    item("gate", Shape::Zigzag(Unit::Steps)),
];

const ONE_NAME: &[Item] = &[item("name", NAME)];
const ONE_GATEWAY: &[Item] = &[GATEWAY];
const ONE_PORT: &[Item] = &[varint("port", Width::U16)];
const ONE_CURSOR: &[Item] = &[varint("cursor", Width::U32)];
const ONE_VERBOSITY: &[Item] = &[VERBOSITY];
const ONE_COUNTER: &[Item] = &[item("first", Shape::Byte)];

/// Body of a request.
pub(super) const fn request(query: Query) -> &'static [Item] {
    match query {
        Query::RuntimeInfo => SCAN_ID,
        Query::TypeName | Query::RuntimeName | Query::TimeControl => &[],
        Query::SetRuntimeName => ONE_NAME,
        Query::LinkInfo => ONE_GATEWAY,
        Query::PortInfo => ONE_PORT,
        Query::DebugMessages => ONE_CURSOR,
        Query::SetDebugVerbosity => ONE_VERBOSITY,
        Query::SetTimeControl => TIME_SETTINGS,
        Query::Counters => ONE_COUNTER,
        Query::TimeStatus => &[],
        Query::TimeLink => ONE_GATEWAY,
        Query::SetTimeAsymmetry => &[],
    }
}

/// Body of an answer.
pub(super) const fn answer(query: Query) -> &'static [Item] {
    match query {
        Query::RuntimeInfo => RUNTIME_INFO,
        Query::TypeName | Query::RuntimeName => ONE_NAME,
        Query::SetRuntimeName | Query::SetDebugVerbosity | Query::SetTimeControl => &[],
        Query::LinkInfo => LINK_INFO,
        Query::PortInfo => PORT_INFO,
        Query::DebugMessages => DEBUG_PAGE,
        Query::TimeControl => TIME_CONTROL,
        Query::Counters => COUNTER_PAGE,
        Query::TimeStatus | Query::TimeLink | Query::SetTimeAsymmetry => &[],
    }
}

//! The bodies of `[DSC-01]`, `[SYS-02]`, `[TIM-01]` and `[TIM-02]` as tables: what stands in them, in the order of their bytes.
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
    /// A signed number of this width, doubled, as a varint.
    Zigzag(Width, Unit),
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
    /// These, one behind the other.
    Group(&'static [Item]),
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
    I64,
}

impl Width {
    pub(super) const fn bits(self) -> usize {
        match self {
            Self::U16 => 16,
            Self::U32 | Self::I32 => 32,
            Self::U64 | Self::I64 => 64,
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

const fn steps(name: &'static str, width: Width) -> Item {
    item(name, Shape::Varint(width, Unit::Steps))
}

const fn signed(name: &'static str, unit: Unit) -> Item {
    item(name, Shape::Zigzag(Width::U32, unit))
}

const NAME: Shape = Shape::Text(NAME_BYTES_MAX);
const UNIQUE_ID: Item = item("unique id", Shape::Digits(12));
const VERSION: Item = item("version", Shape::Byte);
const BOOT_EPOCH: Item = varint("boot epoch", Width::U32);

/// Body of a link announcement.
pub(super) const ANNOUNCEMENT: &[Item] = &[
    VERSION,
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
    ("clock", &[item("change", CLOCK_CHANGES), item("tier", Shape::Byte)]),
]);

const CLOCK_CHANGES: Shape =
    Shape::Choice(&[("another root", &[]), ("time set anew", &[]), ("root lost", &[]), ("settled", &[])]);

const CLOCK_MARK: &[Item] =
    &[steps("own", Width::U64), steps("system", Width::U64), signed("rate", PPB), steps("bound", Width::U32)];

const DEBUG_PAGE: &[Item] = &[
    varint("first", Width::U32),
    varint("next", Width::U32),
    varint("end", Width::U32),
    VERBOSITY,
    item("clock", Shape::Maybe(CLOCK_MARK)),
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
    signed("filter", Q16),
    signed("proportional gain", Q16),
    signed("integral gain", Q16),
    signed("skew limit", PPB),
    signed("gate", Unit::Steps),
    item("servo", Shape::Choice(&[("estimator", &[]), ("diffusion", &[]), ("oldest", &[])])),
    item("priority", Shape::Byte),
];

const ROOT: Item = item("root", Shape::Digits(12));

const TIME_STATUS: &[Item] = &[
    item("set", Shape::Group(TIME_SETTINGS)),
    item("tier", Shape::Byte),
    item("root priority", Shape::Byte),
    ROOT,
    item("settled", Shape::Bool),
    item("live", Shape::Bool),
    varint("sources", Width::U64),
    steps("error", Width::U32),
    item("drift", Shape::Varint(Width::U32, PPB)),
    item("behind", Shape::Zigzag(Width::U64, Unit::Steps)),
    item("age", Shape::Varint(Width::U32, US)),
    item("UNIX offset", Shape::Maybe(&[item("is", Shape::Zigzag(Width::U64, US))])),
    varint("set anew", Width::U16),
    varint("root changes", Width::U16),
];

const TIME_LINK: &[Item] = &[
    item("tier", Shape::Byte),
    ROOT,
    varint("exchanges", Width::U32),
    varint("unanswered", Width::U32),
    varint("refused", Width::U32),
    item("offset", Shape::Zigzag(Width::U64, Unit::Steps)),
    signed("rate", PPB),
    steps("round trip", Width::U32),
    steps("least round trip", Width::U32),
    steps("error", Width::U32),
    steps("bound", Width::U32),
    signed("asymmetry", Unit::Steps),
];

const TIME_ASYMMETRY: &[Item] = &[item("type name", NAME), signed("asymmetry", Unit::Steps)];

const SEQUENCE: Item = item("sequence", Shape::Byte);

/// Body of a time request, `[TIM-01]`.
pub(super) const TIME_REQUEST: &[Item] =
    &[VERSION, SEQUENCE, item("below tier", Shape::Byte), item("departed", Shape::Fixed(Width::U32, Unit::Steps))];

/// Body of a halt, `[MOT-20]`.
pub(super) const HALT: &[Item] = &[
    VERSION,
    item("action", Shape::Byte),
    item("sequence", Shape::Fixed(Width::U32, Unit::None)),
    item("epoch", Shape::Fixed(Width::U64, Unit::Steps)),
    item("origin", Shape::Digits(12)),
];

/// Body of a time reply, `[TIM-02]`.
pub(super) const TIME_REPLY: &[Item] = &[
    VERSION,
    SEQUENCE,
    item("asked at", Shape::Fixed(Width::U32, Unit::Steps)),
    item("heard at", Shape::Fixed(Width::U64, Unit::Steps)),
    item("system time", Shape::Fixed(Width::U64, Unit::Steps)),
    fixed("rate", Unit::Named("/ 2³²")),
    item("error", Shape::Fixed(Width::U32, Unit::Steps)),
    item("bound", Shape::Fixed(Width::U32, Unit::Steps)),
    item("drift", Shape::Fixed(Width::U32, Unit::Named("/ 2³²"))),
    item("age", Shape::Fixed(Width::U32, US)),
    item("tick", Shape::Fixed(Width::U16, Unit::Steps)),
    item("tier", Shape::Byte),
    item("root priority", Shape::Byte),
    ROOT,
    item("flags", Shape::Byte),
    item("UNIX offset", Shape::Fixed(Width::I64, US)),
    item("UNIX hops", Shape::Byte),
    item("departed", Shape::Fixed(Width::U32, Unit::Steps)),
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
        Query::TypeName | Query::RuntimeName | Query::TimeControl | Query::TimeStatus => &[],
        Query::SetRuntimeName => ONE_NAME,
        Query::LinkInfo | Query::TimeLink => ONE_GATEWAY,
        Query::PortInfo => ONE_PORT,
        Query::DebugMessages => ONE_CURSOR,
        Query::SetDebugVerbosity => ONE_VERBOSITY,
        Query::SetTimeControl => TIME_SETTINGS,
        Query::Counters => ONE_COUNTER,
        Query::SetTimeAsymmetry => TIME_ASYMMETRY,
    }
}

/// Body of an answer.
pub(super) const fn answer(query: Query) -> &'static [Item] {
    match query {
        Query::RuntimeInfo => RUNTIME_INFO,
        Query::TypeName | Query::RuntimeName => ONE_NAME,
        Query::SetRuntimeName | Query::SetDebugVerbosity | Query::SetTimeControl | Query::SetTimeAsymmetry => &[],
        Query::LinkInfo => LINK_INFO,
        Query::PortInfo => PORT_INFO,
        Query::DebugMessages => DEBUG_PAGE,
        Query::TimeControl => TIME_CONTROL,
        Query::Counters => COUNTER_PAGE,
        Query::TimeStatus => TIME_STATUS,
        Query::TimeLink => TIME_LINK,
    }
}

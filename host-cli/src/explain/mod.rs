//! Explains any packet or frame byte by byte: what each byte says, what is wrong, and what a receiver would do about it.
//!
//! - **Walk:** [`parse_hex`] → [`explain`] (`frame` takes the stuffing off, `packet` reads header and route, `payload` what follows the
//!   route, `body` with the tables in `shapes` the messages of a node) → [`render`], or JSON of the [`Explanation`].
//! - **Invariants:** no bytes make it panic. Whether something is right is asked of the code that nodes run; what is only shown
//!   is walked here, and a test holds the two together. A problem bears the name of the drop it causes and its clause.
//! - **Clauses:** all of `PKT`, `FRM`, `TRN`, `SYS` and `DSC` that bytes can show.
//!
//! ```
//! use osap::explain::{Options, explain, parse_hex};
//!
//! let bytes = parse_hex("05 e8 03 40 00 41 c0 18 01 00 2a")?;
//! let explanation = explain(&bytes, Options::Auto);
//! assert!(explanation.problems.is_empty());
//! assert_eq!(explanation.field("TTL").unwrap().value, "1000 µs");
//! # Ok::<(), osap::explain::HexError>(())
//! ```

mod body;
mod frame;
mod hex;
mod packet;
mod payload;
mod render;
mod shapes;
#[cfg(test)]
mod tests;

pub use hex::{HexError, parse_hex};
pub use render::render;

use osap_protocol::framing::{Check, DELIMITER, FrameError};
use osap_protocol::{DropCause, Packet};
use serde::Serialize;

/// Name and version of the JSON form.
pub const SCHEMA: &str = "osap.decode/1";

/// What the bytes are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Options {
    /// A frame as it stands on a byte stream, with this check.
    Frame(Check),
    /// A packet without framing, such as a datagram.
    Packet,
    /// Whatever they look like.
    Auto,
}

/// Which of the two the bytes were taken for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Stuffed bytes with a check.
    Frame,
    /// The packet itself.
    Packet,
}

/// What a field's offset counts in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Part {
    /// The frame as given.
    Frame,
    /// The packet: as given, or as it came out of the frame, followed by its check.
    Packet,
}

/// Some bytes and what they say.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Field {
    /// What the offset counts in.
    pub part: Part,
    /// First byte.
    pub offset: usize,
    /// How many; 0 for one that is missing.
    pub len: usize,
    /// The bytes.
    pub hex: String,
    /// What the field is called.
    pub name: String,
    /// What it says.
    pub value: String,
    /// What follows from it; may be empty.
    pub note: String,
}

/// Something that is wrong.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Problem {
    /// What the offset counts in.
    pub part: Part,
    /// Where it shows.
    pub offset: usize,
    /// Name of the drop, where it causes one.
    pub drop_cause: Option<&'static str>,
    /// What is wrong.
    pub what: String,
    /// What a receiver does about it.
    pub then: String,
    /// The clause that says so.
    pub clause: &'static str,
}

/// All there is to say about some bytes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Explanation {
    /// [`SCHEMA`].
    pub schema: &'static str,
    /// What the bytes were taken for.
    pub kind: Kind,
    /// The frame's check: `none`, `crc16` or `crc32`.
    pub check: Option<&'static str>,
    /// Why they were taken for that.
    pub why: String,
    /// The packet that a frame gave.
    pub packet: Option<String>,
    /// What the bytes say, in their order.
    pub fields: Vec<Field>,
    /// What is wrong, first what a receiver would stumble over first.
    pub problems: Vec<Problem>,
    /// All of it in one sentence.
    pub verdict: String,
}

impl Explanation {
    /// The first field of this name.
    #[must_use]
    pub fn field(&self, name: &str) -> Option<&Field> {
        self.fields.iter().find(|field| field.name == name)
    }
}

/// Explains `bytes`.
#[must_use]
pub fn explain(bytes: &[u8], options: Options) -> Explanation {
    match options {
        Options::Frame(check) => {
            frame::explain(bytes, check, format!("asked for as a frame with {}", check_title(check)))
        }
        Options::Packet => bare(bytes, "asked for as a packet".to_owned()),
        Options::Auto => match frame_check(bytes) {
            Ok((check, why)) => frame::explain(bytes, check, why),
            Err(why) => bare(bytes, why),
        },
    }
}

fn bare(bytes: &[u8], why: String) -> Explanation {
    let mut pen = Pen::new(Part::Packet, bytes);
    let verdict = packet::explain(&mut pen, packet::Place::Unknown);
    Explanation {
        schema: SCHEMA,
        kind: Kind::Packet,
        check: None,
        why,
        packet: None,
        verdict: verdict_of(&pen.problems, verdict),
        fields: pen.fields,
        problems: pen.problems,
    }
}

/// The check with which `bytes` are a good frame and why they are taken for one, or why they are not. The longest check that fits is
/// right: a wrong one fits by chance, and the shorter the sooner. Without a check the packet itself must look like one.
fn frame_check(bytes: &[u8]) -> Result<(Check, String), String> {
    if bytes.last() != Some(&DELIMITER) {
        return Err("a packet: it does not end in a delimiter, as a frame does".to_owned());
    }
    for check in [Check::Crc32, Check::Crc16] {
        if frame::unframe(bytes, check).is_ok() {
            return Ok((check, format!("a frame: it ends in a delimiter and its {} is right", check_title(check))));
        }
    }
    match frame::unframe(bytes, Check::None) {
        Ok(packet) if Packet::check(&packet[..]).is_ok() => {
            let doubt = "if its link has a check, the frame is damaged";
            Ok((
                Check::None,
                format!("a frame without a check: no check is right, but it unstuffs to a whole packet; {doubt}"),
            ))
        }
        Ok(_) if Packet::check(bytes).is_err() => {
            let hint = "if it is a damaged frame, say so (--as frame)";
            Err(format!("a packet: as a frame it unstuffs, but no check is right and no packet comes out; {hint}"))
        }
        Ok(_) => Err("a packet: as a frame no check is right and no packet comes out".to_owned()),
        Err(FrameError::Malformed) => Err("a packet: its bytes cannot be a frame's".to_owned()),
        Err(_) => Err("a packet: there is nothing in it that a frame could hold".to_owned()),
    }
}

/// The first problem that makes somebody drop the packet decides what becomes of it.
fn verdict_of(problems: &[Problem], sound: String) -> String {
    let dropped = problems.iter().find(|problem| problem.drop_cause.is_some());
    let Some(first) = dropped.or(problems.first()) else { return sound };
    let more = match problems.len() {
        1 => String::new(),
        2 => " (and 1 problem more)".to_owned(),
        count => format!(" (and {} problems more)", count - 1),
    };
    match first.drop_cause {
        Some(cause) => format!("dropped, {cause}: {}{more}", first.what),
        None => format!("{}; {}{more}", first.what, first.then),
    }
}

/// A check's name in options and JSON.
const fn check_name(check: Check) -> &'static str {
    match check {
        Check::None => "none",
        Check::Crc16 => "crc16",
        Check::Crc32 => "crc32",
    }
}

/// A check's name for people.
const fn check_title(check: Check) -> &'static str {
    match check {
        Check::None => "no check",
        Check::Crc16 => "CRC-16",
        Check::Crc32 => "CRC-32",
    }
}

/// A number of bytes in words.
fn count(bytes: usize) -> String {
    if bytes == 1 { "1 byte".to_owned() } else { format!("{bytes} bytes") }
}

/// Collects what is found in some bytes.
struct Pen<'a> {
    part: Part,
    bytes: &'a [u8],
    fields: Vec<Field>,
    problems: Vec<Problem>,
}

impl<'a> Pen<'a> {
    const fn new(part: Part, bytes: &'a [u8]) -> Self {
        Self { part, bytes, fields: Vec::new(), problems: Vec::new() }
    }

    /// Notes bytes from `at` up to `end`; what lies beyond the last byte is left out.
    fn field(
        &mut self,
        at: usize,
        end: usize,
        name: impl Into<String>,
        value: impl Into<String>,
        note: impl Into<String>,
    ) {
        let slice = self.bytes.get(at..end.min(self.bytes.len())).unwrap_or_default();
        self.fields.push(Field {
            part: self.part,
            offset: at,
            len: slice.len(),
            hex: hex::hex_of(slice),
            name: name.into(),
            value: value.into(),
            note: note.into(),
        });
    }

    /// Where the bytes noted last end; not before `start`.
    fn noted_to(&self, start: usize) -> usize {
        self.fields.last().map_or(start, |field| start.max(field.offset + field.len))
    }

    /// Notes something wrong that makes a receiver drop the packet.
    fn dropped(&mut self, at: usize, cause: DropCause, rule: &'static str, what: impl Into<String>) {
        let then = format!("the receiver drops it and counts one more {}", cause.name());
        self.problem(at, Some(cause), rule, what, then);
    }

    fn problem(
        &mut self,
        at: usize,
        cause: Option<DropCause>,
        rule: &'static str,
        what: impl Into<String>,
        then: impl Into<String>,
    ) {
        let drop_cause = cause.map(DropCause::name);
        let (part, what, then) = (self.part, what.into(), then.into());
        self.problems.push(Problem { part, offset: at, drop_cause, what, then, clause: rule });
    }
}

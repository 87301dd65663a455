//! Walks a `postcard` body along its shape and notes each value.
//!
//! - **Invariant:** it finds a body whole exactly where the code that nodes run reads it; the test `both_readers_agree` holds the
//!   two together.

use super::hex::hex_of;
use super::shapes::{COUNTERS, Item, Shape, Unit, Variant, Width};
use super::{Pen, count};
use osap_protocol::DropCause;

/// How a walk ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Shown {
    /// Every byte had its place.
    Whole,
    /// It broke off.
    Wrong {
        /// Where.
        at: usize,
        /// Why.
        what: String,
    },
}

struct Wrong {
    at: usize,
    what: String,
}

/// Notes all values from `start` to the end of the bytes.
pub(super) fn show(pen: &mut Pen<'_>, start: usize, items: &[Item]) -> Shown {
    let mut walker = Walker { pen, at: start, counter: 0 };
    let result = walker.items("", items);
    let (at, end) = (walker.at, pen.bytes.len());
    let result = result.and_then(|()| {
        let what = "bytes are left over behind the last value".to_owned();
        if at < end { Err(Wrong { at, what }) } else { Ok(()) }
    });
    match result {
        Ok(()) => Shown::Whole,
        Err(Wrong { at: wrong, what }) => {
            // the value that went wrong may have been read in part, and was not noted
            let at = pen.noted_to(start);
            if at < end {
                pen.field(at, end, "not read", count(end - at), "");
            }
            Shown::Wrong { at: wrong, what }
        }
    }
}

struct Walker<'p, 'b> {
    pen: &'p mut Pen<'b>,
    at: usize,
    /// Number of the next counter in a page of them.
    counter: usize,
}

impl Walker<'_, '_> {
    fn items(&mut self, prefix: &str, items: &[Item]) -> Result<(), Wrong> {
        items.iter().try_for_each(|item| self.item(prefix, item))
    }

    fn item(&mut self, prefix: &str, item: &Item) -> Result<(), Wrong> {
        let name = if prefix.is_empty() { item.name.to_owned() } else { format!("{prefix} {}", item.name) };
        match item.shape {
            Shape::Choice(variants) => self.choice(&name, variants),
            Shape::Maybe(inner) => self.maybe(&name, inner),
            Shape::Group(inner) => self.items(&name, inner),
            Shape::List(longest, inner) => self.list(&name, longest, inner),
            shape => {
                let start = self.at;
                let (value, note) = self.value(&name, shape)?;
                self.pen.field(start, self.at, name, value, note);
                Ok(())
            }
        }
    }

    /// A value without others in it, and a remark on it.
    fn value(&mut self, name: &str, shape: Shape) -> Result<(String, String), Wrong> {
        let plain = |value: String| (value, String::new());
        Ok(match shape {
            Shape::Byte => plain(self.byte(name)?.to_string()),
            Shape::FirstCounter => {
                let first = self.byte(name)?;
                self.counter = usize::from(first);
                plain(first.to_string())
            }
            Shape::Bool => plain(if self.flag(name)? { "yes" } else { "no" }.to_owned()),
            Shape::Varint(width, unit) => unit.of(i128::from(self.varint(name, width)?)),
            Shape::Zigzag(width, unit) => {
                let doubled = i128::from(self.varint(name, width)?);
                unit.of(if doubled % 2 == 0 { doubled / 2 } else { -(doubled + 1) / 2 })
            }
            Shape::Fixed(width, unit) => unit.of(self.fixed(name, width)?),
            Shape::Text(longest) => plain(self.text(name, longest)?),
            Shape::Digits(count) => plain(hex_of(self.take(name, count)?).replace(' ', "")),
            Shape::Dotted => {
                let parts: Vec<String> = self.take(name, 3)?.iter().map(ToString::to_string).collect();
                plain(parts.join("."))
            }
            Shape::Cause => {
                let (at, number) = (self.at, self.varint(name, Width::U32)?);
                let cause = usize::try_from(number).ok().and_then(DropCause::from_index);
                let cause = cause.ok_or_else(|| Wrong { at, what: format!("{name}: there is no cause {number}") })?;
                (cause.name().to_owned(), cause.meaning().to_owned())
            }
            // these have others in them and are walked by `item`
            Shape::Choice(_) | Shape::Maybe(_) | Shape::Group(_) | Shape::List(..) => plain(String::new()),
        })
    }

    fn choice(&mut self, name: &str, variants: &[Variant]) -> Result<(), Wrong> {
        let at = self.at;
        let number = self.varint(name, Width::U32)?;
        let chosen = usize::try_from(number).ok().and_then(|number| variants.get(number));
        let (value, inner) =
            chosen.ok_or_else(|| Wrong { at, what: format!("{name}: there is no variant {number}") })?;
        self.pen.field(at, self.at, name, *value, "");
        self.items(name, inner)
    }

    fn maybe(&mut self, name: &str, inner: &[Item]) -> Result<(), Wrong> {
        let at = self.at;
        let there = self.flag(name)?;
        self.pen.field(at, self.at, name, if there { "present" } else { "none" }, "");
        if there { self.items(name, inner) } else { Ok(()) }
    }

    fn list(&mut self, name: &str, longest: usize, inner: &[Item]) -> Result<(), Wrong> {
        let start = self.at;
        let count = self.varint(name, Width::U64)?;
        let count = usize::try_from(count).ok().filter(|count| *count <= longest);
        let count = count.ok_or_else(|| Wrong { at: start, what: format!("{name}: at most {longest} fit") })?;
        self.pen.field(start, self.at, name, count.to_string(), "");
        for n in 0..count {
            let name = match DropCause::from_index(self.counter + n) {
                Some(cause) if name == COUNTERS => cause.name().to_owned(),
                _ => format!("{name} {n}"),
            };
            self.items(&name, inner)?;
        }
        Ok(())
    }

    fn take(&mut self, name: &str, count: usize) -> Result<&[u8], Wrong> {
        let start = self.at;
        let end = start.checked_add(count).filter(|end| *end <= self.pen.bytes.len());
        let end = end.ok_or_else(|| Wrong { at: start, what: format!("{name}: the bytes end too early") })?;
        self.at = end;
        Ok(&self.pen.bytes[start..end])
    }

    fn byte(&mut self, name: &str) -> Result<u8, Wrong> {
        self.take(name, 1).map(|byte| byte[0])
    }

    fn flag(&mut self, name: &str) -> Result<bool, Wrong> {
        let at = self.at;
        match self.byte(name)? {
            0 => Ok(false),
            1 => Ok(true),
            other => Err(Wrong { at, what: format!("{name}: 0 or 1 belongs here, not {other}") }),
        }
    }

    /// Seven bits a byte, low ones first, the top bit where more follow; no more bits than `width` has.
    fn varint(&mut self, name: &str, width: Width) -> Result<u64, Wrong> {
        let at = self.at;
        let mut value = 0u128;
        for place in 0..width.bits().div_ceil(7) {
            let byte = self.byte(name)?;
            value |= u128::from(byte & 0x7f) << (7 * place);
            if byte & 0x80 == 0 {
                let fits = u64::try_from(value).ok().filter(|_| value >> width.bits() == 0);
                return fits.ok_or_else(|| Wrong { at, what: format!("{name}: more than {} bits", width.bits()) });
            }
        }
        Err(Wrong { at, what: format!("{name}: more than {} bits", width.bits()) })
    }

    fn fixed(&mut self, name: &str, width: Width) -> Result<i128, Wrong> {
        let bytes = self.take(name, width.bits() / 8)?;
        let raw = bytes.iter().rev().fold(0i128, |value, byte| value << 8 | i128::from(*byte));
        let half = 1i128 << (width.bits() - 1);
        let is_signed = matches!(width, Width::I32 | Width::I64);
        Ok(if is_signed && raw >= half { raw - 2 * half } else { raw })
    }

    fn text(&mut self, name: &str, longest: usize) -> Result<String, Wrong> {
        let at = self.at;
        let count = self.varint(name, Width::U64)?;
        let bytes = self.take(name, usize::try_from(count).unwrap_or(usize::MAX))?;
        if bytes.len() > longest {
            return Err(Wrong { at, what: format!("{name}: {count} bytes, at most {longest} fit") });
        }
        // names come from devices: nothing in them may move a terminal's cursor
        let text = std::str::from_utf8(bytes).map(|text| format!("\"{}\"", text.escape_debug()));
        text.map_err(|_| Wrong { at, what: format!("{name}: not UTF-8") })
    }
}

impl Unit {
    /// A value with its unit, and what it comes to in µs.
    fn of(self, value: i128) -> (String, String) {
        match self {
            Self::None => (value.to_string(), String::new()),
            Self::Named(name) => (format!("{value} {name}"), String::new()),
            Self::Steps => {
                let (sign, size) = (if value < 0 { "-" } else { "" }, value.unsigned_abs());
                let thousandths = (size % 256 * 1000 + 128) / 256;
                let us = size / 256 + thousandths / 1000;
                (format!("{value} steps"), format!("{sign}{us}.{:03} µs", thousandths % 1000))
            }
        }
    }
}

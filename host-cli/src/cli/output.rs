//! Where a command writes: data to one sink, talk to the other, as text or as JSON.
//!
//! - **Invariants:** data never goes to the talk's sink, nor talk to the data's. With `--json` each line of data is one whole
//!   document that names its schema and version. Commands write colour freely; the sinks of `main` take it out where it has no place.

use super::error::CliError;
use anstyle::{AnsiColor, Style};
use serde::Serialize;
use std::fmt::Display;
use std::io::Write;

/// What the eye shall find first: names of devices, heads of columns.
pub const STRONG: Style = Style::new().bold();
/// What may be overlooked.
pub const FAINT: Style = Style::new().dimmed();
/// What is as it should be.
pub const GOOD: Style = AnsiColor::Green.on_default();
/// What is not.
pub const BAD: Style = AnsiColor::Red.on_default();
/// The word "error".
pub const ERROR: Style = AnsiColor::Red.on_default().bold();
/// Words that lead to a next step.
pub const HINT: Style = AnsiColor::Cyan.on_default();

/// The sinks of one run and the form of its data.
pub struct Output<'a> {
    out: &'a mut dyn Write,
    talk: &'a mut dyn Write,
    json: bool,
    progress: bool,
}

/// A document's frame: its schema before its own fields.
#[derive(Serialize)]
struct Document<'a, T: Serialize> {
    schema: String,
    #[serde(flatten)]
    body: &'a T,
}

impl<'a> Output<'a> {
    /// Writes data to `out` and talk to `talk`; `progress` says that `talk` is a terminal that somebody looks at.
    pub fn new(out: &'a mut dyn Write, talk: &'a mut dyn Write, json: bool, progress: bool) -> Self {
        Self { out, talk, json, progress }
    }

    /// Whether data shall be JSON.
    #[must_use]
    pub const fn json(&self) -> bool {
        self.json
    }

    /// Whether bars may be drawn.
    #[must_use]
    pub const fn progress(&self) -> bool {
        self.progress
    }

    /// The sink for data, for what writes itself.
    pub fn data(&mut self) -> &mut dyn Write {
        self.out
    }

    /// A line of data.
    ///
    /// # Errors
    /// Where the sink fails.
    pub fn line(&mut self, text: impl Display) -> Result<(), CliError> {
        Ok(writeln!(self.out, "{text}")?)
    }

    /// Data of several lines, each of which ends itself.
    ///
    /// # Errors
    /// Where the sink fails.
    pub fn text(&mut self, text: impl Display) -> Result<(), CliError> {
        Ok(write!(self.out, "{text}")?)
    }

    /// One document, `{"schema":"osap.<name>/1",…}`, on a line of its own. It is flushed: who follows a stream sees it at once.
    ///
    /// # Errors
    /// Where the sink fails.
    pub fn document(&mut self, name: &str, body: &impl Serialize) -> Result<(), CliError> {
        let document = Document { schema: format!("osap.{name}/1"), body };
        serde_json::to_writer(&mut *self.out, &document).map_err(std::io::Error::from)?;
        writeln!(self.out)?;
        Ok(self.out.flush()?)
    }

    /// Makes what was written visible now.
    ///
    /// # Errors
    /// Where the sink fails.
    pub fn flush(&mut self) -> Result<(), CliError> {
        Ok(self.out.flush()?)
    }

    /// A line of talk, after the data that was written before it. That nobody can read it is no reason to fail.
    pub fn say(&mut self, text: impl Display) {
        // Where the data has no reader any more, the next line of data says so.
        let _ = self.out.flush();
        let _ = writeln!(self.talk, "{text}");
    }

    /// Tells of a failure: as text, or as a document where documents are wanted.
    pub fn fail(&mut self, error: &CliError) {
        let Some(document) = error.document() else { return };
        match serde_json::to_string(&document) {
            Ok(document) if self.json => self.say(document),
            _ => self.say(error),
        }
    }
}

/// A number with its noun: `1 link`, `2 links`.
#[must_use]
pub fn count(number: usize, one: &str, many: &str) -> String {
    format!("{number} {}", if number == 1 { one } else { many })
}

/// `text` with everything that could move a terminal's cursor or colour made visible: names come from devices.
#[must_use]
pub fn printable(text: &str) -> String {
    text.chars().fold(String::with_capacity(text.len()), |mut safe, c| {
        if c.is_control() || is_unseen(c) {
            safe.extend(c.escape_default());
        } else {
            safe.push(c);
        }
        safe
    })
}

/// Whether a character has no picture of its own but changes what others look like, or the order they stand in (Unicode's format
/// characters and its separators of lines and paragraphs).
#[must_use]
pub const fn is_unseen(c: char) -> bool {
    matches!(
        c,
        '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}'
            | '\u{feff}' | '\u{fff9}'..='\u{fffb}' | '\u{e0000}'..='\u{e007f}'
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn documents_name_their_schema_first_and_talk_stays_apart() {
        let (mut out, mut talk) = (Vec::new(), Vec::new());
        let mut output = Output::new(&mut out, &mut talk, true, false);
        output.document("ping", &serde_json::json!({ "sent": 3 })).unwrap();
        output.say("three sent");
        assert_eq!(String::from_utf8(out).unwrap(), "{\"schema\":\"osap.ping/1\",\"sent\":3}\n");
        assert_eq!(talk, b"three sent\n");
    }

    #[test]
    fn a_devices_name_cannot_move_the_cursor() {
        assert_eq!(printable("bed \u{1b}[2J\nZ ü"), "bed \\u{1b}[2J\\nZ ü");
        assert_eq!(printable("\u{202e}rotoM\u{200b}"), "\\u{202e}rotoM\\u{200b}");
    }
}

//! Why a device started anew: a panic or fault, written where it outlives a reset, read after it.
//!
//! - **Walk:** panic or fault handler → [`Report`] → words in memory that start-up leaves alone → reset → [`Report::decode`] → debug
//!   events, for `osap debug`.
//! - **Invariants:** words that no report was written to, or that power-on left at random, are not taken for one: a mark and a CRC-32
//!   guard them. A report is read once.
//! - **Context:** handlers, with everything else stopped; then start-up. **Clause:** `[DSC-06]` for the events.
//!
//! ```
//! use firmware_app::report::{Report, REPORT_WORDS};
//!
//! let mut words = [0; REPORT_WORDS];
//! Report::fault(0x1000_0200, 0x1000_0341, 0, 5_000_000).encode(&mut words);
//! let report = Report::decode(&mut words).unwrap();
//! assert_eq!(report.lines().next().unwrap(), "after 5 s: fault at 0x10000200, called f");
//! assert!(Report::decode(&mut words).is_none()); // once
//! ```

use core::fmt::{self, Write};
use core::panic::PanicInfo;
use osap_protocol::discovery::{TEXT_BYTES_MAX, Text};
use osap_protocol::framing::Check;

/// Bytes of text a report has.
const TEXT_BYTES: usize = 120;
/// Words of memory a report takes: a mark, the length of its text, the text, a check.
pub const REPORT_WORDS: usize = 3 + TEXT_BYTES / 4;
/// Says that a report stands here; any rare word will do.
const MARK: u32 = 0x0511_5afe;

/// In one line of a debug event.
const WATCHDOG_TEXT: &str = "reset by watchdog: routing stood still";
const _: () = assert!(WATCHDOG_TEXT.len() <= TEXT_BYTES_MAX);

/// What happened before a reset, as text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Report {
    text: heapless::String<TEXT_BYTES>,
}

impl Report {
    /// A panic, `up_us` after start-up.
    #[must_use]
    pub fn panic(info: &PanicInfo<'_>, up_us: u64) -> Self {
        let (file, line) = info.location().map_or(("?", 0), |at| (at.file(), at.line()));
        // of a long path the end tells more
        let name = file.rsplit('/').next().unwrap_or(file);
        Self::written(up_us, format_args!("panic at {name}:{line}: {}", info.message()))
    }

    /// A fault of the processor at `pc`, called from `lr`, with the fault status register where the processor has one.
    #[must_use]
    pub fn fault(pc: u32, lr: u32, status: u32, up_us: u64) -> Self {
        Self::written(up_us, format_args!("fault at {pc:#010x}, called from {lr:#010x}, status {status:#010x}"))
    }

    /// The watchdog ran out.
    #[must_use]
    pub fn watchdog() -> Self {
        let mut text = heapless::String::new();
        let _fits = text.push_str(WATCHDOG_TEXT);
        Self { text }
    }

    fn written(up_us: u64, what: fmt::Arguments<'_>) -> Self {
        let mut text = Cut(heapless::String::new());
        // writing to what cuts never fails
        let _never = write!(text, "after {} s: {what}", up_us / 1_000_000);
        Self { text: text.0 }
    }

    /// Its text in lines of a debug event's length.
    pub fn lines(&self) -> impl Iterator<Item = Text> + '_ {
        let mut rest = self.text.as_str();
        core::iter::from_fn(move || {
            if rest.is_empty() {
                return None;
            }
            let end = (0..=rest.len().min(TEXT_BYTES_MAX)).rev().find(|end| rest.is_char_boundary(*end))?;
            let (line, after) = rest.split_at(end);
            rest = after;
            Text::try_from(line).ok()
        })
    }

    /// Writes it to `words`.
    pub fn encode(&self, words: &mut [u32; REPORT_WORDS]) {
        words.fill(0);
        words[0] = MARK;
        words[1] = u32::try_from(self.text.len()).unwrap_or(0);
        for (word, bytes) in words[2..].iter_mut().zip(self.text.as_bytes().chunks(4)) {
            let mut four = [0; 4];
            four[..bytes.len()].copy_from_slice(bytes);
            *word = u32::from_le_bytes(four);
        }
        words[REPORT_WORDS - 1] = check(words);
    }

    /// Reads the report that `words` hold, if they do, and clears them.
    pub fn decode(words: &mut [u32; REPORT_WORDS]) -> Option<Self> {
        let is_one = words[0] == MARK && words[REPORT_WORDS - 1] == check(words);
        let found = *words;
        words[0] = 0;
        let len = usize::try_from(found[1]).ok().filter(|len| is_one && *len <= TEXT_BYTES)?;
        let mut bytes = [0; TEXT_BYTES];
        for (four, word) in bytes.chunks_exact_mut(4).zip(&found[2..]) {
            four.copy_from_slice(&word.to_le_bytes());
        }
        let text = core::str::from_utf8(&bytes[..len]).ok()?;
        Some(Self { text: heapless::String::try_from(text).ok()? })
    }
}

/// The check of all words but the last.
fn check(words: &[u32; REPORT_WORDS]) -> u32 {
    let mut bytes = [0; (REPORT_WORDS - 1) * 4];
    for (four, word) in bytes.chunks_exact_mut(4).zip(words) {
        four.copy_from_slice(&word.to_le_bytes());
    }
    Check::Crc32.of(&bytes)
}

/// Text that is cut at its end instead of failing.
struct Cut(heapless::String<TEXT_BYTES>);

impl Write for Cut {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for character in text.chars() {
            if self.0.push(character).is_err() {
                break;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_power_on_leaves_is_no_report() {
        let mut words = [0xdead_beef; REPORT_WORDS];
        assert_eq!(Report::decode(&mut words), None);
        Report::watchdog().encode(&mut words);
        words[5] ^= 1;
        assert_eq!(Report::decode(&mut words), None, "a flipped bit");
        Report::watchdog().encode(&mut words);
        words[1] = 4000;
        words[REPORT_WORDS - 1] = check(&words);
        assert_eq!(Report::decode(&mut words), None, "a length that cannot be");
    }

    #[test]
    fn a_long_text_is_cut_and_its_lines_give_it_back() {
        let long = Report::written(1, format_args!("{:é>200}", ""));
        assert_eq!(long.text.len(), TEXT_BYTES - 1, "13 letters and 53 of two bytes");
        let mut words = [0; REPORT_WORDS];
        long.encode(&mut words);
        let back = Report::decode(&mut words).unwrap();
        let mut joined = heapless::String::<TEXT_BYTES>::new();
        for line in back.lines() {
            joined.push_str(&line).unwrap();
        }
        assert_eq!(joined, long.text);
    }
}

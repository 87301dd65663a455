//! `osap decode`: explains a packet or frame that somebody has as digits, byte by byte. Needs no device.
//!
//! - **Walk:** digits from the command line or standard input → [`crate::explain`] → a table, or JSON.
//! - **Invariant:** that something is wrong with the bytes is an [`Outcome`], not an error: they were explained.

use crate::explain::{HexError, Options, explain, parse_hex, render};
use clap::{Args, ValueEnum};
use osap_protocol::framing::Check;
use std::io::{self, Read as _, Write};
use thiserror::Error;

/// Longest text read from standard input.
const TEXT_BYTES_MAX: u64 = 16 << 20;

/// Explains a packet or frame byte by byte
#[derive(Clone, Debug, Args)]
#[command(after_help = "Examples:\n  osap decode 05 e8 03 40 00 41 c0 18 01 00 2a\n  \
                        osap decode --as frame --check crc32 - < captured.txt")]
pub struct DecodeArgs {
    /// Bytes as hexadecimal digits, also with 0x, commas or colons; `-` reads them from standard input
    #[arg(required = true, value_name = "HEX")]
    hex: Vec<String>,
    /// What the bytes are; `auto` tells which it took them for, and why
    #[arg(long = "as", value_name = "WHAT", default_value = "auto")]
    form: Form,
    /// Check of a frame [default with `--as frame`: crc16]
    #[arg(long)]
    check: Option<CheckArg>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Form {
    /// A frame of a byte stream, with its stuffing
    Frame,
    /// A packet without framing, such as a datagram
    Packet,
    /// Whichever it looks like
    Auto,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum CheckArg {
    /// None, as over USB and TCP
    None,
    /// CRC-16/IBM-3740
    Crc16,
    /// CRC-32/ISO-HDLC
    Crc32,
}

impl CheckArg {
    const fn check(self) -> Check {
        match self {
            Self::None => Check::None,
            Self::Crc16 => Check::Crc16,
            Self::Crc32 => Check::Crc32,
        }
    }
}

/// How the bytes were found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Nothing is wrong with them.
    Clean,
    /// The output says what is.
    Faulty,
}

/// Why nothing was explained.
#[derive(Debug, Error)]
pub enum DecodeError {
    /// The text is no bytes.
    #[error(transparent)]
    Hex(#[from] HexError),
    /// A check was named for something that has none.
    #[error("a packet has no check: leave out --check, or say --as frame")]
    CheckOfPacket,
    /// Nothing between the blanks.
    #[error("no bytes given")]
    Empty,
    /// More than anybody can have meant.
    #[error("more than {} MiB of text; a packet or frame is far shorter, so give one at a time", TEXT_BYTES_MAX >> 20)]
    TooMuch,
    /// Standard input failed.
    #[error("cannot read standard input: {0}")]
    Input(io::Error),
    /// The output failed.
    #[error("cannot write the output: {0}")]
    Output(io::Error),
}

/// Explains the bytes of `args` on `out`: a table, or with `json` one line of `osap.decode/1`.
///
/// # Errors
/// [`DecodeError`]; bytes with something wrong are no error.
pub fn run(args: &DecodeArgs, json: bool, out: &mut (impl Write + ?Sized)) -> Result<Outcome, DecodeError> {
    let options = options(args)?;
    let bytes = parse_hex(&text(args)?)?;
    if bytes.is_empty() {
        return Err(DecodeError::Empty);
    }
    let explanation = explain(&bytes, options);
    let written = if json {
        serde_json::to_writer(&mut *out, &explanation).map_err(io::Error::from).and_then(|()| writeln!(out))
    } else {
        out.write_all(render(&explanation).as_bytes())
    };
    written.map_err(DecodeError::Output)?;
    Ok(if explanation.problems.is_empty() { Outcome::Clean } else { Outcome::Faulty })
}

/// A check can only be a frame's, so to name one is to say that the bytes are a frame.
fn options(args: &DecodeArgs) -> Result<Options, DecodeError> {
    match (args.form, args.check) {
        (Form::Packet, Some(_)) => Err(DecodeError::CheckOfPacket),
        (Form::Packet, None) => Ok(Options::Packet),
        (Form::Auto, None) => Ok(Options::Auto),
        (Form::Auto | Form::Frame, Some(check)) => Ok(Options::Frame(check.check())),
        (Form::Frame, None) => Ok(Options::Frame(Check::Crc16)),
    }
}

fn text(args: &DecodeArgs) -> Result<String, DecodeError> {
    if args.hex != ["-"] {
        return Ok(args.hex.join(" "));
    }
    read(io::stdin())
}

/// All of `input`, unless it goes on and on.
fn read(input: impl io::Read) -> Result<String, DecodeError> {
    let mut text = Vec::new();
    input.take(TEXT_BYTES_MAX + 1).read_to_end(&mut text).map_err(DecodeError::Input)?;
    if text.len() as u64 > TEXT_BYTES_MAX {
        return Err(DecodeError::TooMuch);
    }
    String::from_utf8(text).map_err(|error| DecodeError::Input(io::Error::new(io::ErrorKind::InvalidData, error)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: DecodeArgs,
    }

    fn decoded(words: &str, json: bool) -> (Result<Outcome, DecodeError>, String) {
        let line = Line::try_parse_from(std::iter::once("decode").chain(words.split(' '))).unwrap();
        let mut out = Vec::new();
        let outcome = run(&line.args, json, &mut out);
        (outcome, String::from_utf8(out).unwrap())
    }

    #[test]
    fn a_good_packet_is_clean_and_a_bad_one_is_faulty() {
        let (outcome, text) = decoded("05e8034000 41 c0,18,01 00 0x2a", false);
        assert_eq!(outcome.unwrap(), Outcome::Clean);
        assert!(text.ends_with("\na whole packet: 0 steps taken, 1 step to come, for port 3 → port 1\n"), "{text}");
        let (outcome, text) = decoded("04 e8 03 40 00 41", false);
        assert_eq!(outcome.unwrap(), Outcome::Faulty);
        assert!(text.contains("\ndropped, pointer-outside: "), "{text}");
    }

    #[test]
    fn json_is_one_line_that_names_its_schema() {
        let (outcome, text) = decoded("--as packet 05 e8 03 40 00 41", true);
        assert_eq!(outcome.unwrap(), Outcome::Faulty);
        assert!(
            text.starts_with("{\"schema\":\"osap.decode/1\",") && text.ends_with("}\n") && text.lines().count() == 1,
            "{text}"
        );
    }

    /// The check of 2a is 64d8.
    #[test]
    fn a_check_makes_it_a_frame() {
        for words in
            ["--check crc16 04 2a d8 64 00", "--as frame 04 2a d8 64 00", "--as frame --check crc16 04 2a d8 64 00"]
        {
            let (_, text) = decoded(words, false);
            assert!(
                text.starts_with("asked for as a frame with CRC-16\n") && text.contains("0x64d8  right"),
                "{words}: {text}"
            );
        }
        let (outcome, _) = decoded("--as packet --check crc16 04", false);
        assert!(matches!(outcome, Err(DecodeError::CheckOfPacket)));
    }

    #[test]
    fn nothing_is_no_packet_and_no_end_is_too_much() {
        assert!(matches!(decoded(",", false), (Err(DecodeError::Empty), text) if text.is_empty()));
        assert!(matches!(read(io::repeat(b'0')), Err(DecodeError::TooMuch)));
        assert_eq!(read(&b"05 e8"[..]).unwrap(), "05 e8");
    }

    #[test]
    fn what_is_no_byte_is_named_with_its_place() {
        let (outcome, text) = decoded("05 e8 0g", false);
        assert_eq!(
            outcome.unwrap_err().to_string(),
            "`g` at offset 7 is no hexadecimal digit; bytes are pairs of 0-9 and a-f"
        );
        assert_eq!(text, "");
    }
}

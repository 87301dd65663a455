//! Bytes as people write them.

use std::fmt::Write as _;
use thiserror::Error;

/// Why a text is not bytes. Offsets count bytes of the text, from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum HexError {
    /// A character that has no place between hexadecimal digits.
    #[error("`{}` at offset {offset} is no hexadecimal digit; bytes are pairs of 0-9 and a-f", found.escape_debug())]
    Character {
        /// Where it stands.
        offset: usize,
        /// What stands there.
        found: char,
    },
    /// A group of digits that does not come out even.
    #[error(
        "the group of {digits} digits at offset {offset}, from `{found}` on, is no whole number of bytes; write 05 for 5"
    )]
    Odd {
        /// Where the group begins.
        offset: usize,
        /// Its first character.
        found: char,
        /// How many digits it has.
        digits: usize,
    },
}

/// Reads bytes out of text: pairs of hexadecimal digits, together or parted by white space, commas and colons, each group with or
/// without `0x`.
///
/// # Errors
/// [`HexError`] with the offset and the character.
///
/// ```
/// use osap::explain::{HexError, parse_hex};
/// assert_eq!(parse_hex("05e8 03, 0x40:00\n"), Ok(vec![5, 0xe8, 3, 0x40, 0]));
/// assert_eq!(parse_hex("05 g8"), Err(HexError::Character { offset: 3, found: 'g' }));
/// ```
pub fn parse_hex(text: &str) -> Result<Vec<u8>, HexError> {
    let mut bytes = Vec::with_capacity(text.len() / 2);
    let is_between = |c: char| c.is_whitespace() || c == ',' || c == ':';
    for group in text.split(is_between).filter(|group| !group.is_empty()) {
        let start = group.as_ptr().addr() - text.as_ptr().addr();
        let digits = group.strip_prefix("0x").or_else(|| group.strip_prefix("0X")).unwrap_or(group);
        let offset = start + group.len() - digits.len();
        let mut values = Vec::with_capacity(digits.len());
        for (at, found) in digits.char_indices() {
            let value = found.to_digit(16).and_then(|value| u8::try_from(value).ok());
            values.push(value.ok_or(HexError::Character { offset: offset + at, found })?);
        }
        let (pairs, rest) = values.as_chunks::<2>();
        if !rest.is_empty() || pairs.is_empty() {
            let found = group.chars().next().unwrap_or_default();
            return Err(HexError::Odd { offset: start, found, digits: values.len() });
        }
        bytes.extend(pairs.iter().map(|[high, low]| high << 4 | low));
    }
    Ok(bytes)
}

/// Two digits a byte, parted by spaces.
pub(super) fn hex_of(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(bytes.len() * 3);
    for (n, byte) in bytes.iter().enumerate() {
        let gap = if n == 0 { "" } else { " " };
        // Writing to a string cannot fail.
        let _ = write!(text, "{gap}{byte:02x}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn every_way_to_part_bytes_is_read() {
        for text in [
            "05e803",
            "05 e8 03",
            "05,E8,03",
            "05:e8:03",
            "0x05, 0xE8, 0x03",
            "0x05e803",
            "\t05\r\ne803\n",
            "0X05 e803,",
        ] {
            assert_eq!(parse_hex(text), Ok(vec![5, 0xe8, 3]), "{text:?}");
        }
        assert_eq!(parse_hex(" ,:\n"), Ok(vec![]));
    }

    #[test]
    fn an_error_tells_where_it_is() {
        assert_eq!(parse_hex("05 e8 zz"), Err(HexError::Character { offset: 6, found: 'z' }));
        assert_eq!(parse_hex("05 µ8"), Err(HexError::Character { offset: 3, found: 'µ' }));
        assert_eq!(parse_hex("0x05 0xg8"), Err(HexError::Character { offset: 7, found: 'g' }));
        assert_eq!(parse_hex("05 e80"), Err(HexError::Odd { offset: 3, found: 'e', digits: 3 }));
        assert_eq!(parse_hex("05 0x"), Err(HexError::Odd { offset: 3, found: '0', digits: 0 }));
        let text = parse_hex("05\u{1b}").unwrap_err().to_string();
        assert!(text.starts_with("`\\u{1b}` at offset 2 is no hexadecimal digit"), "{text}");
    }

    proptest! {
        #[test]
        fn written_bytes_read_back(bytes in proptest::collection::vec(any::<u8>(), 0..40)) {
            prop_assert_eq!(parse_hex(&hex_of(&bytes)), Ok(bytes));
        }

        #[test]
        fn no_text_panics(text in ".{0,40}") {
            if let Err(HexError::Character { offset, found } | HexError::Odd { offset, found, .. }) = parse_hex(&text) {
                prop_assert!(text[offset..].starts_with(found));
            }
        }
    }
}

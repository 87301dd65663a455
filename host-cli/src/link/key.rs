//! The pre-shared key of links beyond loopback, and the file it is kept in.
//!
//! - **Walk:** `--key FILE` → [`Key::load`] → [`LinkOptions`](super::LinkOptions) → `secure`'s handshake.
//! - **Invariant:** a key is never shown: not by `Debug`, not in an error.
//! - **Clause:** `[LNK-05]`.

use rand::TryRng;
use rand::rngs::SysRng;
use std::fmt;
use std::fs::OpenOptions;
use std::io::{self, Read, Write};
use std::path::Path;

/// Longest key file that is read: 64 digits, and room for line ends.
const FILE_BYTES_MAX: u64 = 256;

/// 32 secret bytes that both ends of a link know.
#[derive(Clone, PartialEq, Eq)]
pub struct Key([u8; Key::LEN]);

/// A key from a file.
#[derive(Debug)]
pub struct LoadedKey {
    /// The key.
    pub key: Key,
    /// What should be done about the file, though it could be read.
    pub warning: Option<String>,
}

/// Why there is no key.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// The file cannot be read or written.
    #[error("key file {path}: {source}")]
    File {
        /// Which.
        path: String,
        /// The system's answer.
        source: io::Error,
    },
    /// The text is no key.
    #[error("a key is {} hexadecimal digits, this has {found} characters or one that is no digit", 2 * Key::LEN)]
    Digits {
        /// Characters without the blanks around them.
        found: usize,
    },
    /// The system gave no random numbers.
    #[error("the system gives no random numbers: {reason}")]
    Random {
        /// The system's answer.
        reason: String,
    },
}

impl Key {
    /// Bytes of a key.
    pub const LEN: usize = 32;

    /// The key of these bytes.
    #[must_use]
    pub const fn from_bytes(bytes: [u8; Self::LEN]) -> Self {
        Self(bytes)
    }

    /// A new one from the system's random numbers.
    ///
    /// # Errors
    /// [`KeyError::Random`].
    pub fn generate() -> Result<Self, KeyError> {
        let mut bytes = [0; Self::LEN];
        SysRng.try_fill_bytes(&mut bytes).map_err(|error| KeyError::Random { reason: error.to_string() })?;
        Ok(Self(bytes))
    }

    /// Reads 64 hexadecimal digits, with blanks and line ends around them.
    ///
    /// # Errors
    /// [`KeyError::Digits`].
    pub fn from_hex(text: &str) -> Result<Self, KeyError> {
        let digits = text.trim();
        let wrong = KeyError::Digits { found: digits.chars().count() };
        let values: Option<Vec<u8>> =
            digits.chars().map(|digit| digit.to_digit(16).and_then(|value| u8::try_from(value).ok())).collect();
        let Some(values) = values.filter(|values| values.len() == 2 * Self::LEN) else { return Err(wrong) };
        let mut bytes = [0; Self::LEN];
        for (byte, pair) in bytes.iter_mut().zip(values.chunks_exact(2)) {
            *byte = pair.iter().fold(0, |byte, digit| byte << 4 | digit);
        }
        Ok(Self(bytes))
    }

    /// Reads a key file.
    ///
    /// # Errors
    /// [`KeyError::File`] and [`KeyError::Digits`].
    pub fn load(path: &Path) -> Result<LoadedKey, KeyError> {
        let failed = |source| KeyError::File { path: path.display().to_string(), source };
        let file = std::fs::File::open(path).map_err(failed)?;
        let warning = file.metadata().ok().and_then(|metadata| readable_by_others(path, &metadata));
        let mut text = String::new();
        file.take(FILE_BYTES_MAX).read_to_string(&mut text).map_err(failed)?;
        Ok(LoadedKey { key: Self::from_hex(&text)?, warning })
    }

    /// Writes the key to a new file that only its owner can read.
    ///
    /// # Errors
    /// [`KeyError::File`], also where the file exists: a key that is in use is not overwritten.
    pub fn save_new(&self, path: &Path) -> Result<(), KeyError> {
        let mut options = OpenOptions::new();
        options.write(true).create_new(true);
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
        let text: String = self.0.iter().map(|byte| format!("{byte:02x}")).chain(["\n".to_owned()]).collect();
        options
            .open(path)
            .and_then(|mut file| file.write_all(text.as_bytes()))
            .map_err(|source| KeyError::File { path: path.display().to_string(), source })
    }

    /// For the handshake.
    pub(super) const fn bytes(&self) -> &[u8; Self::LEN] {
        &self.0
    }
}

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Key(…)")
    }
}

#[cfg(unix)]
fn readable_by_others(path: &Path, metadata: &std::fs::Metadata) -> Option<String> {
    use std::os::unix::fs::PermissionsExt;
    let shared = metadata.permissions().mode() & 0o077 != 0;
    shared.then(|| format!("key file {0} is open to other users: `chmod 600 {0}`", path.display()))
}

#[cfg(not(unix))]
fn readable_by_others(_path: &Path, _metadata: &std::fs::Metadata) -> Option<String> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hexadecimal_digits_are_a_key_and_nothing_else_is() {
        let text = format!(" 0aF1{}\n", "00".repeat(30));
        let key = Key::from_hex(&text).unwrap();
        assert_eq!(key.bytes()[..3], [0x0a, 0xf1, 0]);
        for wrong in ["", "0a", &text.replace("F1", "G1"), &text.replace("F1", "€"), &format!("{text}00")] {
            assert!(Key::from_hex(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_key_is_not_shown() {
        assert_eq!(format!("{:?}", Key::from_bytes([7; Key::LEN])), "Key(…)");
    }

    #[test]
    fn two_new_keys_differ() {
        assert_ne!(Key::generate().unwrap(), Key::generate().unwrap());
    }

    #[cfg(unix)]
    #[test]
    fn a_file_gives_the_key_back_and_a_shared_one_warns() {
        use std::os::unix::fs::PermissionsExt;
        let path = std::env::temp_dir().join(format!("osap-key-{}", std::process::id()));
        let key = Key::generate().unwrap();
        key.save_new(&path).unwrap();
        let private = Key::load(&path).unwrap();
        assert_eq!((private.key, private.warning), (key.clone(), None));
        assert!(key.save_new(&path).is_err(), "overwrote a key");
        std::fs::set_permissions(&path, PermissionsExt::from_mode(0o644)).unwrap();
        let warning = Key::load(&path).unwrap().warning.unwrap();
        std::fs::remove_file(&path).unwrap();
        assert!(warning.contains("chmod 600"), "{warning}");
    }
}

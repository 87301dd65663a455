//! A value that holds from its start until the next one: levels, and events as short levels.
//!
//! - **Walk:** a level track's queue → *this module* → a pin, a set point or a node of [`logic`](crate::logic).
//! - **Invariants:** of two that follow each other the later one starts strictly later.
//! - **Context:** any.

use crate::time::{NetTime, Span};
use core::fmt;

/// A value from `start` on. What it counts in is its track's.
///
/// ```
/// use fixed_math::level::Level;
/// use fixed_math::time::{NetTime, Span};
///
/// // a strobe of 20 µs
/// let [on, off] = Level::event(NetTime::from_us(100), Span::from_us(20), 1, 0).unwrap();
/// assert_eq!(Level::read(&[on, off], NetTime::from_us(99)), None);
/// assert_eq!(Level::read(&[on, off], NetTime::from_us(100)), Some(1));
/// assert_eq!(Level::read(&[on, off], NetTime::from_us(120)), Some(0));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Level {
    /// First instant of the value.
    pub start: NetTime,
    /// The value.
    pub value: i32,
}

/// Why a level was refused. Nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LevelError {
    /// It starts no later than the one before it. Send levels in the order of their starts.
    NotLater {
        /// Its start.
        start: NetTime,
        /// The start of the one before it.
        previous: NetTime,
    },
    /// An event without length, or one that ends past the last instant there is. Give it a width.
    NoWidth {
        /// Its start.
        start: NetTime,
        /// Its width.
        width: Span,
    },
}

impl fmt::Display for LevelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotLater { start, previous } => {
                write!(
                    f,
                    "a level from {} us, but the last one is from {} us: send levels in the order of their starts",
                    start.as_us(),
                    previous.as_us()
                )
            }
            Self::NoWidth { start, width } => {
                write!(
                    f,
                    "an event at {} us of {} steps of 1/256 us has no end: give it a width and an end before time does",
                    start.as_us(),
                    width.steps()
                )
            }
        }
    }
}

impl core::error::Error for LevelError {}

impl Level {
    /// Whether the value has begun at `at`.
    #[must_use]
    #[inline]
    pub fn has_begun(&self, at: NetTime) -> bool {
        self.start <= at
    }

    /// Whether this one may come after `previous`.
    ///
    /// # Errors
    ///
    /// [`LevelError::NotLater`] where it starts at the same time or before.
    pub fn check_after(&self, previous: &Self) -> Result<(), LevelError> {
        if self.start > previous.start {
            Ok(())
        } else {
            Err(LevelError::NotLater { start: self.start, previous: previous.start })
        }
    }

    /// An event: `value` for `width`, then `rest`.
    ///
    /// # Errors
    ///
    /// [`LevelError::NoWidth`].
    pub fn event(start: NetTime, width: Span, value: i32, rest: i32) -> Result<[Self; 2], LevelError> {
        let end = start + width;
        if end <= start || end.since(start) != width {
            return Err(LevelError::NoWidth { start, width });
        }
        Ok([Self { start, value }, Self { start: end, value: rest }])
    }

    /// The value at `at` of `levels`, oldest first; `None` before the first of them.
    #[must_use]
    pub fn read(levels: &[Self], at: NetTime) -> Option<i32> {
        levels.iter().rev().find(|level| level.has_begun(at)).map(|level| level.value)
    }
}

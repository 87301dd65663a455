//! One counter per cause of drop.
//!
//! - **Walk:** wherever it ends early. **Invariant:** a counter stops at its largest value, it never starts again.
//! - **Clause:** `[NOD-09]`.

use osap_protocol::DropCause;
use osap_protocol::discovery::{COUNTERS_A_PAGE, CounterPage};

/// How often each [`DropCause`] happened since boot.
#[derive(Clone, Debug)]
pub struct Counters([u32; DropCause::COUNT]);

impl Counters {
    /// All zero.
    #[must_use]
    pub const fn new() -> Self {
        Self([0; DropCause::COUNT])
    }

    /// One more.
    pub const fn add(&mut self, cause: DropCause) {
        let counter = &mut self.0[cause.index()];
        *counter = counter.saturating_add(1);
    }

    /// How often `cause` happened.
    #[must_use]
    pub const fn of(&self, cause: DropCause) -> u32 {
        self.0[cause.index()]
    }

    /// All drops, whatever the cause.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.0.iter().map(|n| u64::from(*n)).sum()
    }

    /// The page that begins at `first`, `[DSC-06]`; empty past the end.
    #[must_use]
    pub fn page(&self, first: u8) -> CounterPage {
        let rest = self.0.get(usize::from(first)..).unwrap_or_default();
        #[expect(clippy::cast_possible_truncation, reason = "there are some thirty causes")]
        CounterPage {
            first,
            total: DropCause::COUNT as u8,
            values: rest.iter().copied().take(COUNTERS_A_PAGE).collect(),
        }
    }
}

impl Default for Counters {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `[DSC-06]`: pages cover all counters once.
    #[test]
    fn pages_cover_every_counter() {
        let mut counters = Counters::new();
        for cause in DropCause::ALL {
            for _ in 0..=cause.index() {
                counters.add(*cause);
            }
        }
        let mut next = 0u8;
        let mut seen = 0;
        while usize::from(next) < DropCause::COUNT {
            let page = counters.page(next);
            for value in &page.values {
                seen += 1;
                assert_eq!(*value, seen);
            }
            next += u8::try_from(page.values.len()).unwrap();
        }
        assert_eq!(usize::try_from(seen).unwrap(), DropCause::COUNT);
        assert!(counters.page(next).values.is_empty());
    }

    #[test]
    fn counters_stop_at_their_largest_value() {
        let mut counters = Counters([u32::MAX; DropCause::COUNT]);
        counters.add(DropCause::Expired);
        assert_eq!(counters.of(DropCause::Expired), u32::MAX);
    }
}

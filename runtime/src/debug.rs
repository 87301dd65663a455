//! The last things that happened in a node, for whoever asks.
//!
//! - **Walk:** every stage may write here; query 7 reads.
//! - **Invariants:** fixed length; the oldest makes way. Each event has a number, so that a reader sees what it missed.
//! - **Context:** the node's; O(1), one comparison where the verbosity leaves the event out.
//! - **Clauses:** `[NOD-09]` drops as events, `[DSC-06]` pages.

use fixed_math::time::LocalTicks;
use osap_protocol::discovery::{ClockMark, DebugEvent, DebugPage, Event, Verbosity};

/// Events kept.
pub const DEBUG_EVENTS: usize = 16;

/// A ring of debug events.
#[derive(Debug)]
pub struct DebugRing {
    events: heapless::HistoryBuf<DebugEvent, DEBUG_EVENTS>,
    /// Number of the next event.
    end: u32,
    verbosity: Verbosity,
}

impl DebugRing {
    /// Empty; drops and events are written down.
    #[must_use]
    pub const fn new() -> Self {
        Self { events: heapless::HistoryBuf::new(), end: 0, verbosity: Verbosity::Events }
    }

    /// What is written down.
    #[must_use]
    pub const fn verbosity(&self) -> Verbosity {
        self.verbosity
    }

    /// Sets what is written down from now on.
    pub const fn set_verbosity(&mut self, verbosity: Verbosity) {
        self.verbosity = verbosity;
    }

    /// Writes `event` down where `level` is within the verbosity.
    #[inline]
    pub fn record(&mut self, level: Verbosity, at: LocalTicks, event: impl FnOnce() -> Event) {
        // in line, as most of what could be written down is left out
        if level <= self.verbosity {
            self.write(at, event());
        }
    }

    #[cold]
    fn write(&mut self, at: LocalTicks, event: Event) {
        self.events.write(DebugEvent { at_us: at.as_us(), event });
        self.end = self.end.wrapping_add(1);
    }

    /// Number of the next event.
    #[must_use]
    pub const fn end(&self) -> u32 {
        self.end
    }

    /// Events from number `cursor` on, or from the oldest kept where that is gone or yet to come; `clock` makes system time of their stamps.
    #[must_use]
    pub fn page(&self, cursor: u32, clock: Option<ClockMark>) -> DebugPage {
        let kept = u32::try_from(self.events.len()).unwrap_or(u32::MAX);
        let behind = self.end.wrapping_sub(cursor).min(kept);
        let first = self.end.wrapping_sub(behind);
        let skip = usize::try_from(kept - behind).unwrap_or(usize::MAX);
        let mut events = heapless::Vec::new();
        for event in self.events.oldest_ordered().skip(skip) {
            if events.push(event.clone()).is_err() {
                break;
            }
        }
        let count = u32::try_from(events.len()).unwrap_or(0);
        DebugPage { first, next: first.wrapping_add(count), end: self.end, verbosity: self.verbosity, clock, events }
    }
}

impl Default for DebugRing {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osap_protocol::discovery::EVENTS_A_PAGE;

    fn opened(gateway: u8) -> Event {
        Event::Gateway { gateway, open: true }
    }

    /// `[DSC-06]`: reading from cursor to cursor gives every event kept, once, in order, and shows what was lost.
    #[test]
    fn pages_follow_on() {
        let mut ring = DebugRing::new();
        for n in 0..20 {
            ring.record(Verbosity::Events, LocalTicks::from_us(u64::from(n)), || opened(n));
        }
        let mut cursor = 0;
        let mut expected = 4; // sixteen of twenty are kept
        while cursor != ring.end() {
            let page = ring.page(cursor, None);
            assert_eq!(page.first, u32::from(expected));
            for event in &page.events {
                assert_eq!(event.event, opened(expected));
                expected += 1;
            }
            cursor = page.next;
        }
        assert_eq!(expected, 20);
        assert!(ring.page(20, None).events.is_empty());
        assert_eq!(ring.page(5, None).events.len(), EVENTS_A_PAGE);
    }

    #[test]
    fn verbosity_leaves_out_what_is_above_it() {
        let mut ring = DebugRing::new();
        ring.set_verbosity(Verbosity::Drops);
        ring.record(Verbosity::Events, LocalTicks::ZERO, || opened(1));
        assert_eq!(ring.end(), 0);
        ring.record(Verbosity::Drops, LocalTicks::ZERO, || opened(1));
        assert_eq!(ring.end(), 1);
    }
}

//! When to stop by oneself: no fresh points, or a clock that cannot be relied on.
//!
//! - **Walk:** [`Feeder::offer`](crate::feeder::Feeder::offer) says that a point is fresh → [`Watchdog::feed`]; once a run of the task
//!   [`Watchdog::is_expired`] and [`ClockGuard::check`] → [`MotionClock::stop`](crate::clock::MotionClock::stop).
//! - **Invariants:** nothing feeds a watchdog but a point with a time ahead of all before it: a sender that repeats itself, or a network that
//!   repeats for it, does not keep an axis alive.
//! - **Context:** the task `serve`.

use fixed_math::time::{NetTime, Span};

/// Expires when no fresh point came for so long. It watches from the first point on, until it is put to rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Watchdog {
    patience: Span,
    /// The latest time of a point.
    newest: NetTime,
    /// System time at which it came.
    fed: Option<NetTime>,
    expiries: u32,
}

impl Watchdog {
    /// One that waits for `patience`.
    #[must_use]
    pub const fn new(patience: Span) -> Self {
        Self { patience, newest: NetTime::ZERO, fed: None, expiries: 0 }
    }

    /// A point for track time `point` was accepted at system time `now`. True where it is ahead of all before it, and feeds.
    pub fn feed(&mut self, point: NetTime, now: NetTime) -> bool {
        let is_fresh = point > self.newest;
        if is_fresh {
            self.newest = point;
            self.fed = Some(now);
        }
        is_fresh
    }

    /// Whether it expired by `now`. It says so once, and watches again from the next fresh point on.
    pub fn is_expired(&mut self, now: NetTime) -> bool {
        let is_expired = self.fed.is_some_and(|fed| now.since(fed) > self.patience);
        if is_expired {
            self.fed = None;
            self.expiries = self.expiries.saturating_add(1);
        }
        is_expired
    }

    /// When it will have expired, if nothing comes before.
    #[must_use]
    pub fn expires(&self) -> Option<NetTime> {
        self.fed.map(|fed| fed + self.patience)
    }

    /// The track came to its end: it watches again from the next fresh point on.
    pub fn rest(&mut self) {
        self.fed = None;
    }

    /// How often it expired.
    #[must_use]
    pub const fn expiries(&self) -> u32 {
        self.expiries
    }
}

/// What a node knows of its system time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockHealth {
    /// Programs may rely on it.
    pub is_settled: bool,
    /// It comes from a root that can still be heard, or the node is the root.
    pub is_linked: bool,
    /// Its greatest possible error; `None` where there is none.
    pub bound: Option<Span>,
}

/// Why a clock cannot be relied on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockFault {
    /// It is not settled.
    Unsettled,
    /// It has no bound.
    Unbounded,
    /// Its bound is too wide.
    Bound {
        /// The bound.
        bound: Span,
        /// The most that it may be.
        most: Span,
    },
    /// Its root was not heard for too long.
    Unlinked {
        /// Since when, system time.
        since: NetTime,
        /// How long it may be.
        patience: Span,
    },
}

/// Watches over a node's clock while an axis moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockGuard {
    bound_max: Span,
    patience: Span,
    unlinked_since: Option<NetTime>,
}

impl ClockGuard {
    /// One that lets a clock be `bound_max` off at the most, and without its root for `patience`.
    #[must_use]
    pub const fn new(bound_max: Span, patience: Span) -> Self {
        Self { bound_max, patience, unlinked_since: None }
    }

    /// Looks at the clock at system time `now`.
    ///
    /// # Errors
    /// The first reason not to rely on it.
    pub fn check(&mut self, health: &ClockHealth, now: NetTime) -> Result<(), ClockFault> {
        let since = match (health.is_linked, self.unlinked_since) {
            (true, _) => None,
            (false, since) => Some(since.unwrap_or(now)),
        };
        self.unlinked_since = since;
        if !health.is_settled {
            return Err(ClockFault::Unsettled);
        }
        let bound = health.bound.ok_or(ClockFault::Unbounded)?;
        if bound > self.bound_max {
            return Err(ClockFault::Bound { bound, most: self.bound_max });
        }
        match since.filter(|since| now.since(*since) > self.patience) {
            Some(since) => Err(ClockFault::Unlinked { since, patience: self.patience }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn us(us: u64) -> NetTime {
        NetTime::from_us(us)
    }

    #[test]
    fn only_points_ahead_of_all_before_feed() {
        let mut dog = Watchdog::new(Span::from_us(100));
        assert!(!dog.is_expired(us(1_000_000)), "nothing to watch yet");
        assert!(dog.feed(us(5_000), us(0)));
        for now in 1..=100 {
            assert!(!dog.feed(us(5_000), us(now)) && !dog.feed(us(4_000), us(now)), "repeated and old");
            assert!(!dog.is_expired(us(now)));
        }
        assert_eq!(dog.expires(), Some(us(100)));
        assert!(dog.is_expired(us(101)));
        assert!(!dog.is_expired(us(102)), "told once");
        assert!(!dog.feed(us(5_000), us(103)) && dog.expires().is_none(), "an old point does not wake it");
        assert!(dog.feed(us(5_001), us(104)));
        assert!(dog.is_expired(us(205)));
        assert_eq!(dog.expiries(), 2);
    }

    #[test]
    fn a_clock_is_relied_on_while_it_is_settled_bounded_and_linked() {
        let mut guard = ClockGuard::new(Span::from_us(10), Span::from_us(1_000));
        let good = ClockHealth { is_settled: true, is_linked: true, bound: Some(Span::from_us(10)) };
        assert_eq!(guard.check(&good, us(0)), Ok(()));
        let wide = ClockHealth { bound: Some(Span::from_us(11)), ..good };
        let error = ClockFault::Bound { bound: Span::from_us(11), most: Span::from_us(10) };
        assert_eq!(guard.check(&wide, us(1)), Err(error));
        assert_eq!(guard.check(&ClockHealth { bound: None, ..good }, us(1)), Err(ClockFault::Unbounded));
        assert_eq!(guard.check(&ClockHealth { is_settled: false, ..good }, us(1)), Err(ClockFault::Unsettled));
        let alone = ClockHealth { is_linked: false, ..good };
        assert_eq!(guard.check(&alone, us(100)), Ok(()));
        assert_eq!(guard.check(&alone, us(1_100)), Ok(()));
        let patience = Span::from_us(1_000);
        assert_eq!(guard.check(&alone, us(1_101)), Err(ClockFault::Unlinked { since: us(100), patience }));
        assert_eq!(guard.check(&good, us(1_102)), Ok(()), "heard again");
        assert_eq!(guard.check(&alone, us(1_103)), Ok(()), "and lost anew");
    }
}

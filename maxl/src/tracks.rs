//! Ramps and levels, queued ahead of their time.
//!
//! - **Walk:** a message → [`RampFeeder::offer`] or [`LevelFeeder::offer`] in the task `serve`: late, full, gap or non-monotonic, refused with
//!   operands → a ring → [`RampPlayer::value`] or [`LevelPlayer::value`] once a beat.
//! - **Invariants:** segments follow each other; the newest one that has begun holds until the next begins. Before the first there is no
//!   value. A track starts anew by [`RampFeeder::restart`].
//! - **Context:** one context for each half; taking a segment out costs a division by the ring's length, as `heapless` has it, once a
//!   segment and not once a beat.

use fixed_math::level::Level;
use fixed_math::ramp::{Ramp, RampError, RampSegment};
use fixed_math::time::{NetTime, Span};
use heapless::spsc::{Consumer, Producer, Queue};

/// Most segments that one beat goes over.
pub const SEGMENTS_A_BEAT_MAX: u32 = 4;

/// Why a segment was not taken. Nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrackRefusal {
    /// It begins before now.
    Late {
        /// When it begins.
        start: NetTime,
        /// Track time now.
        now: NetTime,
    },
    /// There is no room for it yet.
    Full {
        /// Segments that wait.
        waiting: usize,
        /// Room.
        room: usize,
    },
    /// It begins too long after the end of the one before: something is missing between them.
    Gap {
        /// Time between.
        gap: Span,
        /// The most that may be.
        most: Span,
    },
    /// It begins before the one before it is over, or at the same time.
    NonMonotonic {
        /// When it begins.
        start: NetTime,
        /// Where the one before ends; for a level, where it begins.
        newest: NetTime,
    },
    /// The ramp is none.
    Ramp(RampError),
}

/// What happened to segments since start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TrackCounters {
    /// Taken.
    pub accepted: u32,
    /// [`TrackRefusal::Late`].
    pub late: u32,
    /// [`TrackRefusal::Full`].
    pub full: u32,
    /// [`TrackRefusal::Gap`].
    pub gap: u32,
    /// [`TrackRefusal::NonMonotonic`].
    pub non_monotonic: u32,
    /// [`TrackRefusal::Ramp`].
    pub ramp: u32,
}

impl TrackCounters {
    fn count(&mut self, refusal: Option<&TrackRefusal>) {
        let counter = match refusal {
            None => &mut self.accepted,
            Some(TrackRefusal::Late { .. }) => &mut self.late,
            Some(TrackRefusal::Full { .. }) => &mut self.full,
            Some(TrackRefusal::Gap { .. }) => &mut self.gap,
            Some(TrackRefusal::NonMonotonic { .. }) => &mut self.non_monotonic,
            Some(TrackRefusal::Ramp(_)) => &mut self.ramp,
        };
        *counter = counter.saturating_add(1);
    }
}

/// A queue's rules, the same for ramps and levels.
struct Feeder<'a, S> {
    ring: Producer<'a, S>,
    gap_max: Span,
    counters: TrackCounters,
}

impl<S: Copy> Feeder<'_, S> {
    /// Takes `segment`, which begins at `start`; `over` is where the one before ends.
    fn put(&mut self, segment: S, start: NetTime, over: Option<NetTime>, now: NetTime) -> Result<(), TrackRefusal> {
        if start <= now {
            return Err(TrackRefusal::Late { start, now });
        }
        let gap = over.map_or(Span::ZERO, |over| start.since(over));
        if gap > self.gap_max {
            return Err(TrackRefusal::Gap { gap, most: self.gap_max });
        }
        let (waiting, room) = (self.ring.len(), self.ring.capacity());
        self.ring.enqueue(segment).map_err(|_| TrackRefusal::Full { waiting, room })
    }
}

/// The reader's half: the segment that holds, and those to come.
struct Player<'a, S> {
    ring: Consumer<'a, S>,
    current: Option<S>,
}

impl<S: Copy> Player<'_, S> {
    fn at(&mut self, at: NetTime, start: impl Fn(&S) -> NetTime) -> Option<S> {
        for _ in 0..SEGMENTS_A_BEAT_MAX {
            if self.ring.peek().is_none_or(|next| start(next) > at) {
                break;
            }
            self.current = self.ring.dequeue();
        }
        self.current
    }
}

/// Room for `N` − 1 ramps.
#[derive(Debug)]
pub struct RampTrack<const N: usize>(Queue<RampSegment, N>);

impl<const N: usize> RampTrack<N> {
    /// An empty one.
    #[must_use]
    pub const fn new() -> Self {
        Self(Queue::new())
    }

    /// The task's half and the reader's. A ramp that begins more than `gap_max` after the end of the one before is refused;
    /// [`Span::MAX`] for no such rule.
    pub fn split(&mut self, gap_max: Span) -> (RampFeeder<'_>, RampPlayer<'_>) {
        let (ring, out) = self.0.split();
        let feeder = RampFeeder { feeder: Feeder { ring, gap_max, counters: TrackCounters::default() }, newest: None };
        (feeder, RampPlayer(Player { ring: out, current: None }))
    }
}

impl<const N: usize> Default for RampTrack<N> {
    fn default() -> Self {
        Self::new()
    }
}

/// The task's half of a track of ramps.
pub struct RampFeeder<'a> {
    feeder: Feeder<'a, RampSegment>,
    newest: Option<RampSegment>,
}

impl RampFeeder<'_> {
    /// Takes a ramp; what it leaves out comes from the one before. `now` is track time.
    ///
    /// # Errors
    /// [`TrackRefusal`], counted.
    pub fn offer(&mut self, ramp: &Ramp, now: NetTime) -> Result<(), TrackRefusal> {
        let taken = self.take(ramp, now);
        self.feeder.counters.count(taken.as_ref().err());
        taken
    }

    /// The next ramp follows none: it has to come with its start and start value, and no gap is too long.
    pub fn restart(&mut self) {
        self.newest = None;
    }

    /// What happened since start.
    #[must_use]
    pub const fn counters(&self) -> &TrackCounters {
        &self.feeder.counters
    }

    fn take(&mut self, ramp: &Ramp, now: NetTime) -> Result<(), TrackRefusal> {
        let segment = RampSegment::following(self.newest.as_ref(), ramp).map_err(|error| match error {
            RampError::StartBeforePreviousEnd { start, previous_end } => {
                TrackRefusal::NonMonotonic { start, newest: previous_end }
            }
            error => TrackRefusal::Ramp(error),
        })?;
        let over = self.newest.map(|newest| newest.end());
        self.feeder.put(segment, segment.start(), over, now)?;
        self.newest = Some(segment);
        Ok(())
    }
}

/// The reader's half of a track of ramps.
pub struct RampPlayer<'a>(Player<'a, RampSegment>);

impl RampPlayer<'_> {
    /// The value at `at`; `None` before the first ramp.
    pub fn value(&mut self, at: NetTime) -> Option<i32> {
        self.0.at(at, RampSegment::start).map(|ramp| ramp.value(at))
    }
}

/// Room for `N` − 1 levels.
#[derive(Debug)]
pub struct LevelTrack<const N: usize>(Queue<Level, N>);

impl<const N: usize> LevelTrack<N> {
    /// An empty one.
    #[must_use]
    pub const fn new() -> Self {
        Self(Queue::new())
    }

    /// The task's half and the reader's. A level that begins more than `gap_max` after the one before is refused; [`Span::MAX`] for no such
    /// rule.
    pub fn split(&mut self, gap_max: Span) -> (LevelFeeder<'_>, LevelPlayer<'_>) {
        let (ring, out) = self.0.split();
        let feeder = LevelFeeder { feeder: Feeder { ring, gap_max, counters: TrackCounters::default() }, newest: None };
        (feeder, LevelPlayer(Player { ring: out, current: None }))
    }
}

impl<const N: usize> Default for LevelTrack<N> {
    fn default() -> Self {
        Self::new()
    }
}

/// The task's half of a track of levels.
pub struct LevelFeeder<'a> {
    feeder: Feeder<'a, Level>,
    newest: Option<Level>,
}

impl LevelFeeder<'_> {
    /// Takes a level; `now` is track time.
    ///
    /// # Errors
    /// [`TrackRefusal`], counted.
    pub fn offer(&mut self, level: Level, now: NetTime) -> Result<(), TrackRefusal> {
        let taken = self.take(level, now);
        self.feeder.counters.count(taken.as_ref().err());
        taken
    }

    /// The next level follows none: no gap is too long.
    pub fn restart(&mut self) {
        self.newest = None;
    }

    /// What happened since start.
    #[must_use]
    pub const fn counters(&self) -> &TrackCounters {
        &self.feeder.counters
    }

    fn take(&mut self, level: Level, now: NetTime) -> Result<(), TrackRefusal> {
        let over = self.newest.map(|newest| newest.start);
        if let Some(newest) = over
            && level.start <= newest
        {
            return Err(TrackRefusal::NonMonotonic { start: level.start, newest });
        }
        self.feeder.put(level, level.start, over, now)?;
        self.newest = Some(level);
        Ok(())
    }
}

/// The reader's half of a track of levels.
pub struct LevelPlayer<'a>(Player<'a, Level>);

impl LevelPlayer<'_> {
    /// The value at `at`; `None` before the first level.
    pub fn value(&mut self, at: NetTime) -> Option<i32> {
        self.0.at(at, |level| level.start).map(|level| level.value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn us(us: u64) -> NetTime {
        NetTime::from_us(us)
    }

    fn level(start: u64, value: i32) -> Level {
        Level { start: us(start), value }
    }

    #[test]
    fn levels_hold_until_the_next_and_are_refused_with_operands() {
        let mut track = LevelTrack::<4>::new();
        let (mut feeder, mut player) = track.split(Span::from_us(1_000));
        assert_eq!(player.value(us(0)), None);
        assert_eq!(feeder.offer(level(100, 1), us(100)), Err(TrackRefusal::Late { start: us(100), now: us(100) }));
        assert_eq!(feeder.offer(level(100, 1), us(99)), Ok(()));
        assert_eq!(
            feeder.offer(level(100, 2), us(99)),
            Err(TrackRefusal::NonMonotonic { start: us(100), newest: us(100) })
        );
        let gap = TrackRefusal::Gap { gap: Span::from_us(1_001), most: Span::from_us(1_000) };
        assert_eq!(feeder.offer(level(1_101, 2), us(99)), Err(gap));
        assert_eq!(feeder.offer(level(1_100, 2), us(99)), Ok(()));
        assert_eq!(feeder.offer(level(1_200, 3), us(99)), Ok(()));
        assert_eq!(feeder.offer(level(1_300, 4), us(99)), Err(TrackRefusal::Full { waiting: 3, room: 3 }));
        let read: Vec<_> = [99, 100, 1_099, 1_100, 1_199, 1_200, 9_999].map(|at| player.value(us(at))).to_vec();
        assert_eq!(read, [None, Some(1), Some(1), Some(2), Some(2), Some(3), Some(3)]);
        let counters = TrackCounters { accepted: 3, late: 1, full: 1, gap: 1, non_monotonic: 1, ramp: 0 };
        assert_eq!(feeder.counters(), &counters);
        feeder.restart();
        assert_eq!(feeder.offer(level(9_000, 5), us(1_200)), Ok(()));
    }

    /// The reader follows over several segments, and a time that goes back holds the segment's start.
    #[test]
    fn ramps_follow_each_other() {
        let mut track = RampTrack::<8>::new();
        let (mut feeder, mut player) = track.split(Span::from_us(50));
        let first = Ramp { start: Some(us(100)), end: us(200), start_value: Some(0), end_value: 100 };
        assert_eq!(
            feeder.offer(&Ramp { start: None, ..first }, us(0)),
            Err(TrackRefusal::Ramp(RampError::NoStart { end: us(200) }))
        );
        assert_eq!(feeder.offer(&first, us(0)), Ok(()));
        let down = Ramp { start: None, end: us(300), start_value: None, end_value: -100 };
        assert_eq!(feeder.offer(&down, us(0)), Ok(()));
        assert_eq!(feeder.offer(&first, us(0)), Err(TrackRefusal::NonMonotonic { start: us(100), newest: us(300) }));
        let far = Ramp { start: Some(us(351)), end: us(400), start_value: None, end_value: 0 };
        assert_eq!(
            feeder.offer(&far, us(0)),
            Err(TrackRefusal::Gap { gap: Span::from_us(51), most: Span::from_us(50) })
        );
        assert_eq!(feeder.offer(&Ramp { start: Some(us(350)), ..far }, us(0)), Ok(()));
        let read: Vec<_> = [50, 100, 150, 200, 250, 325, 375, 500].map(|at| player.value(us(at))).to_vec();
        assert_eq!(read, [None, Some(0), Some(50), Some(100), Some(0), Some(-100), Some(-50), Some(0)]);
        assert_eq!(player.value(us(0)), Some(-100), "back in time: the start of what holds");
    }
}

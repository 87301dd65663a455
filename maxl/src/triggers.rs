//! When to read a sensor, and where the readings go: at an interval, on an edge of a signal, while a signal is in a window.
//!
//! - **Walk:** once a beat [`Trigger::is_due`] with the beat's time and its signal's value → the board reads → [`ReadingsIn::push`] → a task
//!   takes them out and sends them.
//! - **Invariants:** a reading carries the synchronised time at which it was made. A full ring keeps what it has; what found no room
//!   is counted. Intervals stay in phase with system time, whatever a beat missed.
//! - **Context:** triggers and [`ReadingsIn`] in the highest-priority task, [`ReadingsOut`] in a task.

use core::sync::atomic::{AtomicU32, Ordering};
use fixed_math::time::{NetTime, Span};
use heapless::spsc::{Consumer, Producer, Queue};

/// Most intervals that one beat makes up for without a reading.
pub const CATCH_UP_MAX: u32 = 8;

/// What a sensor said.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reading {
    /// System time.
    pub time: NetTime,
    /// Which sensor.
    pub channel: u8,
    /// What it said.
    pub value: i32,
}

/// Which way a signal goes through its threshold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edge {
    /// From below the threshold to it or above.
    Rising,
    /// From the threshold or above to below.
    Falling,
    /// Both.
    Either,
}

/// When to read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum When {
    Interval,
    Edge { threshold: i32, edge: Edge, was_above: Option<bool> },
    Window { low: i32, high: i32 },
}

/// When to read one sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trigger {
    when: When,
    /// The next instant of the interval.
    next: NetTime,
    period: Span,
    missed: u32,
}

impl Trigger {
    /// At `first` and every `period` from then on. `None` where the period is none.
    #[must_use]
    pub fn interval(first: NetTime, period: Span) -> Option<Self> {
        (period > Span::ZERO).then_some(Self { when: When::Interval, next: first, period, missed: 0 })
    }

    /// When a signal goes through `threshold`. Its first value is no edge.
    #[must_use]
    pub const fn edge(threshold: i32, edge: Edge) -> Self {
        let when = When::Edge { threshold, edge, was_above: None };
        Self { when, next: NetTime::ZERO, period: Span::ZERO, missed: 0 }
    }

    /// At `first` and every `period` from then on, where a signal is from `low` to `high`, both included. `None` where the period is none or
    /// the window is empty.
    #[must_use]
    pub fn window(low: i32, high: i32, first: NetTime, period: Span) -> Option<Self> {
        let when = When::Window { low, high };
        (period > Span::ZERO && low <= high).then_some(Self { when, next: first, period, missed: 0 })
    }

    /// Whether to read at `at`, where the signal is `signal`. To be asked once a beat.
    pub fn is_due(&mut self, at: NetTime, signal: i32) -> bool {
        match &mut self.when {
            When::Edge { threshold, edge, was_above } => {
                let is_above = signal >= *threshold;
                let was_above = was_above.replace(is_above).unwrap_or(is_above);
                match edge {
                    Edge::Rising => is_above && !was_above,
                    Edge::Falling => was_above && !is_above,
                    Edge::Either => is_above != was_above,
                }
            }
            When::Interval => self.has_come(at),
            When::Window { low, high } => {
                let is_inside = (*low..=*high).contains(&signal);
                self.has_come(at) && is_inside
            }
        }
    }

    /// Instants of the interval for which there was no beat.
    #[must_use]
    pub const fn missed(&self) -> u32 {
        self.missed
    }

    fn has_come(&mut self, at: NetTime) -> bool {
        if self.next > at {
            return false;
        }
        self.next = self.next + self.period;
        for _ in 0..CATCH_UP_MAX {
            if self.next > at {
                break;
            }
            self.next = self.next + self.period;
            self.missed = self.missed.saturating_add(1);
        }
        true
    }
}

/// Room for `N` − 1 readings.
#[derive(Debug)]
pub struct ReadingRing<const N: usize> {
    readings: Queue<Reading, N>,
    /// Written by the interrupt alone.
    overflows: AtomicU32,
}

impl<const N: usize> ReadingRing<N> {
    /// An empty one.
    #[must_use]
    pub const fn new() -> Self {
        Self { readings: Queue::new(), overflows: AtomicU32::new(0) }
    }

    /// The interrupt's half and the task's half.
    pub fn split(&mut self) -> (ReadingsIn<'_>, ReadingsOut<'_>) {
        let (readings_in, readings_out) = self.readings.split();
        let overflows = &self.overflows;
        (ReadingsIn { readings: readings_in, overflows }, ReadingsOut { readings: readings_out, overflows })
    }
}

impl<const N: usize> Default for ReadingRing<N> {
    fn default() -> Self {
        Self::new()
    }
}

/// The interrupt's half.
pub struct ReadingsIn<'a> {
    readings: Producer<'a, Reading>,
    overflows: &'a AtomicU32,
}

impl ReadingsIn<'_> {
    /// Keeps a reading. False where there is no room, which is counted.
    pub fn push(&mut self, reading: Reading) -> bool {
        let is_kept = self.readings.enqueue(reading).is_ok();
        if !is_kept {
            // one writer: a load and a store are an increment
            let overflows = self.overflows.load(Ordering::Relaxed);
            self.overflows.store(overflows.saturating_add(1), Ordering::Relaxed);
        }
        is_kept
    }
}

/// The task's half.
pub struct ReadingsOut<'a> {
    readings: Consumer<'a, Reading>,
    overflows: &'a AtomicU32,
}

impl ReadingsOut<'_> {
    /// The oldest reading.
    pub fn take(&mut self) -> Option<Reading> {
        self.readings.dequeue()
    }

    /// Readings that wait.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.readings.len()
    }

    /// Readings that found no room.
    #[must_use]
    pub fn overflows(&self) -> u32 {
        self.overflows.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn us(us: u64) -> NetTime {
        NetTime::from_us(us)
    }

    /// Beats of 64 µs: the first at or after each multiple of 100 µs, and no phase is lost where beats are.
    #[test]
    fn an_interval_stays_in_phase() {
        let mut trigger = Trigger::interval(us(100), Span::from_us(100)).unwrap();
        let due: Vec<u64> = (0..10).map(|beat| beat * 64).filter(|at| trigger.is_due(us(*at), 0)).collect();
        assert_eq!(due, [128, 256, 320, 448, 512]);
        // 576 to 960 were beats that never came: 600 is due late, 700, 800 and 900 are missed
        assert!(trigger.is_due(us(960), 0));
        assert_eq!(trigger.missed(), 3);
        assert!(!trigger.is_due(us(999), 0) && trigger.is_due(us(1_000), 0));
        assert!(Trigger::interval(us(0), Span::ZERO).is_none());
    }

    #[test]
    fn edges_are_told_once_and_a_first_value_is_none() {
        let signal = [5, 4, 5, 6, 5, 4, 4, 5];
        let count = |edge| {
            let mut trigger = Trigger::edge(5, edge);
            (0..)
                .zip(signal)
                .filter(|(at, value)| trigger.is_due(us(*at), *value))
                .map(|(at, _)| at)
                .collect::<Vec<u64>>()
        };
        assert_eq!(count(Edge::Rising), [2, 7]);
        assert_eq!(count(Edge::Falling), [1, 5]);
        assert_eq!(count(Edge::Either), [1, 2, 5, 7]);
    }

    #[test]
    fn a_window_reads_inside_both_bounds_and_stays_in_phase() {
        let mut trigger = Trigger::window(-2, 2, us(0), Span::from_us(2)).unwrap();
        let signal = [-3, -2, -2, 0, 2, 0, 3, 0, 1];
        let due: Vec<u64> =
            (0..).zip(signal).filter(|(at, value)| trigger.is_due(us(*at), *value)).map(|(at, _)| at).collect();
        assert_eq!(due, [2, 4, 8]);
        assert!(Trigger::window(1, 0, us(0), Span::from_us(1)).is_none());
    }

    #[test]
    fn what_finds_no_room_is_counted() {
        let mut ring = ReadingRing::<4>::new();
        let (mut interrupt, mut task) = ring.split();
        let reading = |value| Reading { time: us(1), channel: 0, value };
        let kept: Vec<bool> = (0..5).map(|value| interrupt.push(reading(value))).collect();
        assert_eq!(kept, [true, true, true, false, false]);
        assert_eq!((task.waiting(), task.overflows()), (3, 2));
        assert_eq!(task.take(), Some(reading(0)), "the oldest stay");
        assert!(interrupt.push(reading(9)));
    }
}

//! Stamps of frames: what a node's interrupts make of the instants at which first bytes come and go.
//!
//! - **Walk:** first byte on the wire → *this delay* → the counter is read → the stamp. Of a frame that leaves: see [`Departure`].
//! - **Invariants:** a stamp is never before what it stamps on arrival, and never after the hand-over. Each node draws from a stream of its
//!   own, so that one node's delays do not change another's.
//! - **Context:** the thread that steps the world. **Clauses:** `[FRM-07]`, `[TIM-03]`, `[TIM-04]`.

use crate::time::{Clock, TrueTime};
use fixed_math::time::{LocalTicks, Span};
use rand::RngExt;
use rand_pcg::Pcg64;

/// On which side of a departure its delay lies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Departure {
    /// The counter is read, then the first byte is held up: the stamp is early. So it is where the timer is read right before the
    /// write that sends the byte.
    #[default]
    StampedBefore,
    /// The first byte leaves, then the counter is read: the stamp is late. So it is where an interrupt tells of the departure. No bound
    /// that is built on "not before its stamp" holds then.
    StampedAfter,
}

/// How well a node stamps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StampModel {
    /// Which part of its stamps is delayed, 0 to 1.
    pub delayed_part: f64,
    /// Mean of those delays, which are distributed exponentially.
    pub delay_mean: Span,
    /// On which side of a departure the delay lies.
    pub departure: Departure,
}

impl StampModel {
    /// No stamp is delayed.
    pub const EXACT: Self = Self { delayed_part: 0.0, delay_mean: Span::ZERO, departure: Departure::StampedBefore };
}

/// A node's stamps, and what else differs from one time to the next in it.
pub(super) struct Stamps {
    model: StampModel,
    /// Most that a job takes longer.
    pub(super) job_spread: Span,
    rng: Pcg64,
}

impl Stamps {
    pub(super) fn new(model: StampModel, seed: u64, node: u32) -> Self {
        // a stream of the generator, which the world's own draws never use
        Self {
            model,
            job_spread: Span::ZERO,
            rng: Pcg64::new(u128::from(seed) ^ STATE, u128::from(node) << 1 | STREAM),
        }
    }

    /// What the next job takes longer; nothing is drawn where none does.
    pub(super) fn job(&mut self) -> Span {
        if self.job_spread == Span::ZERO {
            return Span::ZERO;
        }
        Span::from_steps(self.rng.random_range(0..=self.job_spread.steps()))
    }

    /// What the next stamp is late by, at most `limit`. Nothing is drawn where no stamp is delayed.
    pub(super) fn delay(&mut self, limit: Span) -> Span {
        let StampModel { delayed_part, delay_mean, .. } = self.model;
        if delayed_part <= 0.0 || delay_mean == Span::ZERO || self.rng.random_range(0.0..1.0) >= delayed_part {
            return Span::ZERO;
        }
        let rest: f64 = 1.0 - self.rng.random_range(0.0..1.0);
        #[expect(clippy::cast_precision_loss, clippy::cast_sign_loss, reason = "a mean of far less than 2^53 steps")]
        #[expect(clippy::cast_possible_truncation, reason = "at most 37 times the mean: `rest` is at least 2^−53")]
        let steps = (-rest.ln() * delay_mean.steps() as f64) as u64;
        Span::from_steps(steps).min(limit)
    }

    /// The stamp of a frame whose first byte came at `started` and which is handed over at `now`.
    pub(super) fn arrival(&mut self, clock: &Clock, started: TrueTime, now: TrueTime) -> LocalTicks {
        let delay = self.delay(now.since(started));
        clock.local(started + delay)
    }

    /// The stamp of a frame of `takes` wire time that may leave at `now`, and by how much later it leaves.
    pub(super) fn departure(&mut self, clock: &Clock, now: TrueTime, takes: Span) -> (LocalTicks, Span) {
        let delay = self.delay(takes);
        match self.model.departure {
            Departure::StampedBefore => (clock.local(now), delay),
            Departure::StampedAfter => (clock.local(now + delay), Span::ZERO),
        }
    }
}

/// Tell the stamps' generators from all others that are seeded with the same number.
const STATE: u128 = 0x5354_414d_5053 << 64;
const STREAM: u128 = 0x5354_414d_5053 << 80;

#[cfg(test)]
mod tests {
    use super::*;

    /// Of 100,000 stamps 30 % are late by 8 µs in the mean; four standard deviations are 580 of the count (√(n·p·(1−p)) = 145) and
    /// 0.19 µs of the mean (8 µs/√30,000 = 0.046 µs).
    #[test]
    fn delays_have_their_part_and_their_mean() {
        let model = StampModel { delayed_part: 0.3, delay_mean: Span::from_us(8), ..StampModel::EXACT };
        let mut stamps = Stamps::new(model, 1, 0);
        let delays: Vec<u64> =
            (0..100_000).map(|_| stamps.delay(Span::MAX).steps()).filter(|steps| *steps > 0).collect();
        assert!(delays.len().abs_diff(30_000) < 580, "{}", delays.len());
        let mean = delays.iter().sum::<u64>() / delays.len() as u64;
        assert!(mean.abs_diff(8 << 8) < 48, "{mean} steps");
        let mut other = Stamps::new(model, 1, 1);
        assert!((0..20).map(|_| other.delay(Span::MAX)).ne((0..20).map(|_| stamps.delay(Span::MAX))));
    }

    /// A stamp is in the frame, or with the routing task, before the next thing happens to the frame.
    #[test]
    fn no_delay_is_beyond_its_limit() {
        let model = StampModel { delayed_part: 1.0, delay_mean: Span::from_us(80), ..StampModel::EXACT };
        let mut stamps = Stamps::new(model, 1, 0);
        let clock = Clock::new(crate::time::ClockModel::PERFECT, TrueTime::ZERO);
        let (started, now) = (TrueTime::from_us(100), TrueTime::from_us(150));
        let seen: Vec<u64> = (0..1_000).map(|_| stamps.arrival(&clock, started, now).as_us()).collect();
        assert_eq!((seen.iter().min(), seen.iter().max()), (Some(&100), Some(&150)));
    }
}

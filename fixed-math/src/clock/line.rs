//! System time as a line over a counter, and how far off it may be.
//!
//! - **Walk:** a neighbour's [`PeerEstimate`] comes in a reply → [`LinkClock::compose`](super::LinkClock::compose) makes it an
//!   [`Estimate`] over one's own counter → [`Estimate::mean`] of equals → a [`Servo`](super::Servo) or what is told to those below.
//! - **Invariants:** a line rises: its rate is at least −½. A bound is rounded up, and never shrinks by time alone.
//! - **Context:** any; a line is one 32 × 32-bit product to read up to 16 s after its beginning, one or two else, and a few to read backwards.

use super::wide::hypotenuse;
use crate::time::{LocalTicks, NetTime, PeerTicks, Rate, Span};

/// System time against one's own counter: `system` when the counter reads `at`, and `rate` faster than the counter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TimeLine {
    /// The counter's reading.
    pub at: LocalTicks,
    /// System time then.
    pub system: NetTime,
    /// How much faster system time runs than the counter.
    pub rate: Rate,
}

impl TimeLine {
    /// System time when the counter reads `local`, rounded down to a step; before and after `at` alike. Saturates.
    #[must_use]
    pub const fn system_at(&self, local: LocalTicks) -> NetTime {
        self.read(local)
    }

    /// [`TimeLine::system_at`], in line.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "for the map's reading in an interrupt")]
    pub(super) const fn read(&self, local: LocalTicks) -> NetTime {
        let (now, then) = (local.steps(), self.at.steps());
        let since = now.wrapping_sub(then);
        if now < then || since >> 32 != 0 {
            return self.system_at_any(local);
        }
        // up to 16 s after `at`, which is nearly always: what is left of the carries and ends of the other
        #[expect(clippy::cast_possible_truncation, reason = "below 2^32")]
        let gained = self.rate.over_short(since as u32);
        // a rate is above −1
        NetTime::from_steps(self.system.steps().saturating_add((since.cast_signed() + gained).cast_unsigned()))
    }

    /// [`TimeLine::system_at`] of any reading.
    #[cold]
    #[inline(never)]
    const fn system_at_any(&self, local: LocalTicks) -> NetTime {
        self.system.shifted(forwards(self.rate, local.steps_after(self.at)))
    }

    /// The reading at which `system_at` comes to `system`, to a step.
    #[must_use]
    pub const fn local_at(&self, system: NetTime) -> LocalTicks {
        self.at.shifted(backwards(self.rate, system.steps_after(self.system)))
    }
}

/// What a reply tells of the sender's own line and of its trust in it. All of it holds when the *sender's* counter reads `at`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PeerEstimate {
    /// The sender's counter.
    pub at: PeerTicks,
    /// System time then, as the sender believes.
    pub system: NetTime,
    /// How much faster system time runs than the sender's counter.
    pub rate: Rate,
    /// One sigma of `system`.
    pub error: Span,
    /// How far `system` is from the root's time at most.
    pub bound: Span,
    /// How fast `bound` grows from `at`, for each unit of time.
    pub drift: Rate,
}

/// A line over one's own counter with its error; `error` and `bound` hold at `line.at`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Estimate {
    /// System time against the counter.
    pub line: TimeLine,
    /// One sigma.
    pub error: Span,
    /// At most this far from the root's time.
    pub bound: Span,
    /// How fast `bound` grows from `line.at`, before it as after it.
    pub drift: Rate,
}

impl Estimate {
    /// The bound when the counter reads `local`: it grows by `drift` with the distance from `line.at`, either way.
    #[must_use]
    pub const fn bound_at(&self, local: LocalTicks) -> Span {
        let away = distance(local.steps_after(self.line.at));
        Span::from_steps(self.bound.steps().saturating_add(grown(self.drift, away)))
    }

    /// The mean of several estimates of the same time, as a line through `at`. `None` of none.
    ///
    /// Its error is that of the mean of independent ones. Its bound is the mean of the bounds: no mean is farther from the truth than
    /// its parts are on average.
    #[must_use]
    pub fn mean(of: impl Iterator<Item = Self>, at: LocalTicks) -> Option<Self> {
        let mut of = of;
        let first = of.next()?;
        let base = first.line.system_at(at);
        let (mut count, mut ahead, mut rates, mut drifts) =
            (1i64, 0i64, i64::from(first.line.rate.bits()), i64::from(first.drift.bits()));
        let (mut error, mut bounds) = (first.error.steps(), first.bound_at(at).steps());
        for each in of {
            count += 1;
            ahead = ahead.saturating_add(each.line.system_at(at).steps_after(base));
            rates += i64::from(each.line.rate.bits());
            drifts += i64::from(each.drift.bits());
            error = hypotenuse(error, each.error.steps());
            bounds = bounds.saturating_add(each.bound_at(at).steps());
        }
        // there is one nearly always, and a Cortex-M0+ divides 64 bits in 700 cycles even by that
        let share = |total: i64| if count == 1 { total } else { total.div_euclid(count) };
        let share_up = |total: u64| if count == 1 { total } else { total.div_ceil(count.cast_unsigned()) };
        Some(Self {
            line: TimeLine { at, system: base.shifted(share(ahead)), rate: Rate::saturated(share(rates)) },
            error: Span::from_steps(share_up(error)),
            // a step for each rounding: of the lines and of the mean
            bound: Span::from_steps(share_up(bounds).saturating_add(2)),
            drift: Rate::saturated(share(drifts) + 1),
        })
    }
}

/// `steps` of a counter in those of a time that is `rate` faster.
pub(super) const fn forwards(rate: Rate, steps: i64) -> i64 {
    steps.saturating_add(rate.over(steps))
}

/// The inverse of [`forwards`], to a step: `x = steps − rate · x`, again until it stands still. A rate of parts in a million takes three
/// products, one of a hundredth six.
pub(super) const fn backwards(rate: Rate, steps: i64) -> i64 {
    let mut found = steps;
    let mut rounds = 0;
    while rounds < 64 {
        let next = steps.saturating_sub(rate.over(found));
        if next == found {
            break;
        }
        found = next;
        rounds += 1;
    }
    found
}

/// `|steps|`.
pub(super) const fn distance(steps: i64) -> i64 {
    steps.saturating_abs()
}

/// What a bound gains over `away` steps, rounded up; a negative drift, which a peer may send, gains nothing.
pub(super) const fn grown(drift: Rate, away: i64) -> u64 {
    if drift.bits() <= 0 || away == 0 {
        0
    } else if away >> 32 == 0 {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "of 32 bits")]
        let short = away as u32;
        (drift.over_short(short) + 1).cast_unsigned()
    } else {
        drift.over(away).saturating_add(1).cast_unsigned()
    }
}

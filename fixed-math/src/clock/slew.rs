//! What a node's programs take for system time: continuous and rising, while the target behind it may jump.
//!
//! - **Walk:** a [`Servo`](super::Servo) gives a target line → [`SlewedMap::slew_to`] → every reader asks [`SlewedMap::system_at`].
//! - **Invariants:** only [`SlewedMap::step_to`] steps. Otherwise the map never runs backwards, is where it was when a new target comes,
//!   and lies on the target from the meeting on. Where the two pieces meet, rounding may make it wait or skip three steps (12 ns).
//! - **Context:** reading is one 32 × 32-bit product and a few comparisons, 95 to 110 cycles on a Cortex-M0+, for interrupts too: up to 16 s
//!   after a line's beginning, and twice that beyond. A new target is a reciprocal or two, 820 cycles; one that is a second away, or is to
//!   be met in more than four, four 64-bit divisions, 2,800.

use super::line::{TimeLine, distance};
use super::wide::Reciprocal;
use crate::time::{LocalTicks, NetTime, Rate, Span};
use crate::widening::product;

/// Fastest slew there is, a quarter: a map slewed against a line of the slowest rate still rises.
const LIMIT_MAX: Rate = Rate::from_bits(1 << 30);

/// A line that is followed, and another that leads to it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SlewedMap {
    /// What is followed from `meeting` on.
    target: TimeLine,
    /// What holds before.
    lead: TimeLine,
    /// Where the second takes over from the first.
    meeting: LocalTicks,
    /// The target's time there: the lead's end.
    met: NetTime,
}

impl SlewedMap {
    /// A map that is on `line` already.
    #[must_use]
    pub const fn new(line: TimeLine) -> Self {
        Self { target: line, lead: line, meeting: LocalTicks::ZERO, met: NetTime::ZERO }
    }

    /// Is on `target` at once: a step, for a map that nothing follows yet.
    pub fn step_to(&mut self, target: TimeLine) {
        *self = Self::new(target);
    }

    /// From `now` on runs faster or slower than the target by at most `limit`, so as to meet it after `horizon` if the limit allows, and
    /// follows it exactly from then on. Continuous at `now` to the step, and monotone. Before `now` it is the same slewed line,
    /// continued backwards.
    ///
    /// `limit` is 2^−32 at least and a quarter at most; what is outside is taken as the nearest.
    pub fn slew_to(&mut self, target: TimeLine, now: LocalTicks, horizon: Span, limit: Rate) {
        let from = self.system_at(now);
        let behind = target.system_at(now).steps_after(from);
        let away = distance(behind).cast_unsigned();
        if away == 0 {
            // still by way of a lead, so that no rounding of the two lines shows
            *self =
                Self { target, lead: TimeLine { at: now, system: from, rate: target.rate }, meeting: now, met: from };
            return;
        }
        let limit = limit.bits().clamp(1, LIMIT_MAX.bits()).cast_unsigned();
        let (slew, needed) = slew_of(away, horizon.steps().max(1), limit);
        let meeting = now + Span::from_steps(needed);
        let slew = i64::from(slew);
        let rate = Rate::saturated(i64::from(target.rate.bits()) + if behind > 0 { slew } else { -slew });
        let lead = TimeLine { at: now, system: from, rate };
        *self = Self { target, lead, meeting, met: target.system_at(meeting) };
    }

    /// System time when the counter reads `local`.
    #[must_use]
    pub fn system_at(&self, local: LocalTicks) -> NetTime {
        let is_met = local >= self.meeting;
        let line = if is_met { &self.target } else { &self.lead };
        let system = line.read(local);
        // the last steps of a lead may be past the target by rounding, and time never runs backwards
        if is_met || system < self.met { system } else { self.met }
    }

    /// When the counter will read, or has read, `system`; to a step.
    #[must_use]
    pub fn local_at(&self, system: NetTime) -> LocalTicks {
        if system >= self.met {
            self.target.local_at(system).max(self.meeting)
        } else {
            self.lead.local_at(system).min(self.meeting)
        }
    }

    /// Target minus map when the counter reads `local`: what is left to slew, in steps.
    #[must_use]
    pub fn behind_steps(&self, local: LocalTicks) -> i64 {
        self.target.system_at(local).steps_after(self.system_at(local))
    }

    /// How much faster than the counter the map runs when that reads `local`.
    #[must_use]
    pub fn rate_at(&self, local: LocalTicks) -> Rate {
        if local >= self.meeting { self.target.rate } else { self.lead.rate }
    }

    /// What is followed.
    #[must_use]
    pub const fn target(&self) -> TimeLine {
        self.target
    }
}

/// How fast `away` steps are taken off, 2^−32, and in how many steps: in `horizon`, or at `limit` where that takes longer.
///
/// The distance shrinks by the slew a step, and is none at the end, or past none: by less than a step where both are short. Then the
/// slew is up to three above the least that would do, which makes 3/4 of a step in 2^30; or the time is up to three steps long, which is
/// 3/4 of a step at the fastest.
fn slew_of(away: u64, horizon: u64, limit: u32) -> (u32, u64) {
    if away >> 28 == 0
        && let Ok(horizon) = u32::try_from(horizon)
        && horizon >> 30 == 0
    {
        let away = away.cast_signed();
        if away.cast_unsigned() <= product(limit, horizon) >> 32 {
            // 2^30 at most, of which a quotient's error is less than one, and another for rounding
            let slew = Reciprocal::of(horizon.into()).times(away, 32) + 2;
            return (u32::try_from(slew).unwrap_or(limit).min(limit), horizon.into());
        }
        let (over, slew) = (Reciprocal::of(limit.into()), i64::from(limit));
        let near = over.times(away, 32);
        // up to 2^60, and so once more with what is left
        let rest = (away << 32).wrapping_sub(near.wrapping_mul(slew));
        return (limit, (near + over.times(rest, 0) + 2).cast_unsigned());
    }
    let slew = u32::try_from(quotient_q32(away, horizon)).unwrap_or(limit).min(limit);
    (slew, quotient_q32(away, slew.into()))
}

/// `(numerator · 2^32) / denominator`, rounded up, saturating: two divisions of 64 bits. Of zero as of one.
#[cold]
const fn quotient_q32(numerator: u64, denominator: u64) -> u64 {
    let denominator = if denominator == 0 { 1 } else { denominator };
    let (whole, rest) = (numerator / denominator, numerator % denominator);
    if whole >= 1 << 31 {
        return u64::MAX;
    }
    // a denominator over 32 bits loses its lowest, and the rest is below it
    let excess = 32u32.saturating_sub(rest.leading_zeros());
    let fraction = (rest << (32 - excess)).div_ceil(if denominator >> excess == 0 { 1 } else { denominator >> excess });
    (whole << 32).saturating_add(fraction)
}

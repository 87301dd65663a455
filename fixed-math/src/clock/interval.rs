//! What the peer's counter certainly reads: two inequalities an exchange, and what time does to them.
//!
//! Let f(L) be the peer's counter at the moment when one's own reads L; it rises. A counter's reading is rounded down by less than a
//! tick, and an arrival is seen at once or later, so an arrival stamp s says that the counter was *below* s + tick when the byte
//! arrived. A departure stamp is read before the byte leaves, or at most `late` after it, so it says that the counter was *at or above*
//! s − late when the byte left. Between departure and arrival lie at least `there` on the way there and `back` on the way back, both
//! counted by whichever of the two counters is slower. Then
//!
//! ```text
//! peer at the request's arrival  < t2 + tick           own at its departure >= t1 - late   =>   f(t1 - late) < t2 + tick - there
//! peer at the reply's departure >= t3 - late           own at its arrival    < t4 + tick   =>   f(t4 + tick) > t3 - late + back
//! ```
//!
//! Whatever delays a frame, an arrival stamp or the byte after its stamp only widens the two. What breaks them is a departure stamp
//! taken later than `late` after the byte left: no arithmetic finds that out, as t1 and t4 late by the same look like a shorter way
//! back and forth. That is why a transmitter reads its counter *before* the byte, with interrupts masked or not.
//!
//! Both are carried to one instant between t1 and t4 by the estimated rate, whose uncertainty widens them, and so from exchange to
//! exchange; all that are known are intersected. Their difference is the round trip less what is certain of it: where that is negative
//! the four stamps contradict the wire.
//!
//! The rate's uncertainty is no sigma either. Two such intervals T apart hold the mean rate between them to the sum of their widths
//! over T; a rate that changes by c a second at most is within c·T/2 of that mean at the later end. Before there are two, the rate is
//! within six sigmas of what the oscillators promise. The earlier of the two is an anchor between half of √(2w/c) and that old, w being
//! the present width, which is where w/T and c·T/2 are equal and their sum is least.
//!
//! - **Walk:** [`LinkClock::observe`](super::LinkClock::observe) and [`LinkClock::bound_at`](super::LinkClock::bound_at).
//! - **Invariants:** every rounding widens. What is certain rests on three promises and on nothing measured: the departure stamps', the
//!   oscillators' range, and `c`.
//! - **Context:** once an exchange: two products longer than 64 bits, and one reciprocal.

use super::wide::{Reciprocal, scale};
use crate::time::{LocalTicks, PeerTicks, Rate};
use crate::widening::product;

/// Between what the truth lies, relative to some reference.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Interval {
    pub(super) lowest: i64,
    pub(super) highest: i64,
}

impl Interval {
    /// All there is. Nothing else is over 2^47, so that no sum of a few is longer than 63 bits.
    const ALL: Self = Self { lowest: -1 << 62, highest: 1 << 62 };

    /// As far to either side.
    const fn around(reach: i64) -> Self {
        Self { lowest: -reach, highest: reach }
    }

    /// The same, wider by `by` to either side, relative to a reference `moved` later.
    pub(super) const fn widened(self, by: i64, moved: i64) -> Self {
        Self { lowest: self.lowest - moved - by, highest: self.highest - moved + by }
    }

    /// What both allow, or `None` where they contradict each other.
    fn and(self, other: Self) -> Option<Self> {
        let both = Self { lowest: self.lowest.max(other.lowest), highest: self.highest.min(other.highest) };
        (both.lowest <= both.highest).then_some(both)
    }

    /// From end to end; what is over 2^30 steps, 4 s, counts as that.
    fn width(self) -> u32 {
        narrow((self.highest - self.lowest).clamp(0, 1 << 30))
    }

    /// The nearest there is to `value`.
    fn nearest(self, value: i64) -> i64 {
        value.max(self.lowest).min(self.highest)
    }

    /// How far `value` is from the truth at most.
    const fn reach(self, value: i64) -> i64 {
        let (below, above) = (value.saturating_sub(self.lowest), self.highest.saturating_sub(value));
        let farther = if below > above { below } else { above };
        if farther < 0 { 0 } else { farther }
    }
}

/// What was certain at an exchange.
#[derive(Clone, Copy, Debug)]
struct Anchor {
    at: LocalTicks,
    peer: PeerTicks,
    offset: Interval,
}

/// Where the peer's counter and its rate certainly are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Certain {
    /// Relative to `reference.peer`, at `reference.at`.
    reference: Anchor,
    /// In 2^−40.
    rate: Interval,
    /// What the rate is within before anything was measured, 2^−40, either way.
    range: i64,
    /// What the rate gains at most in 2^28 steps (1.05 s), 2^−32.
    ramp: u32,
    /// The farthest of `rate` from the estimate.
    drift: Rate,
    /// What it gains in [`LIFE`].
    in_life: Rate,
    older: Anchor,
    newer: Anchor,
}

impl Certain {
    /// Of a link whose rate is within `range`, and gains `ramp` a second at most.
    pub(super) const fn new(range: Rate, ramp: Rate) -> Self {
        let none = Anchor { at: LocalTicks::ZERO, peer: PeerTicks::ZERO, offset: Interval::ALL };
        let widest = (range.bits() as i64) << 8;
        // 2^20 over 10^6
        let ramp = narrow((ramp.bits().unsigned_abs() as i64 * 1_049 / 1_000) + 1);
        let new = Self {
            reference: none,
            rate: Interval::around(widest),
            range: widest,
            ramp,
            drift: range,
            in_life: Rate::ZERO,
            older: none,
            newer: none,
        };
        Self { in_life: new.ramped(LIFE), ..new }
    }

    /// How far the estimated rate is from the true one at most, at the last exchange.
    pub(super) const fn drift(&self) -> Rate {
        self.drift
    }

    /// What the rate gains at most in `steps`, which are not negative.
    pub(super) const fn ramped(&self, steps: i64) -> Rate {
        let gained = if steps >> 32 == 0 {
            // 36 bits
            (product(self.ramp, narrow(steps)) >> 28).cast_signed()
        } else {
            scale(steps, self.ramp, 28)
        };
        if gained < i32::MAX as i64 {
            Rate::from_bits(narrow(gained).cast_signed() + 1)
        } else {
            Rate::from_bits(i32::MAX)
        }
    }

    /// The same in what an estimate lives on without news.
    pub(super) const fn ramped_in_life(&self) -> Rate {
        self.in_life
    }

    /// How far the estimate, which is the reference, is from the truth at most, `steps` before or after it.
    pub(super) const fn reach(&self, steps: i64) -> u64 {
        self.reference.offset.reach(0).saturating_add(self.widening(steps, self.ramped(steps))).cast_unsigned()
    }

    /// What the interval gains in `steps`, which are not negative: the rate's uncertainty, and half of what that gains meanwhile.
    const fn widening(&self, steps: i64, ramped: Rate) -> i64 {
        if steps >> 32 == 0 {
            // 32 bits each
            let steps = narrow(steps);
            return self.drift.over_short(steps) + (ramped.over_short(steps) >> 1) + 3;
        }
        self.drift.over(steps).saturating_add(ramped.over(steps) >> 1).saturating_add(3)
    }

    /// Begins with one exchange: the estimate is `peer` at `at`. Returns how far it has to move to be inside.
    pub(super) fn start(&mut self, at: LocalTicks, peer: PeerTicks, said: Interval) -> i64 {
        self.reference = Anchor { at, peer, offset: said };
        self.rate = Interval::around(self.range);
        self.enclose()
    }

    /// Whether an exchange `steps` later that says `said`, relative to the prediction, agrees with what was certain; the intersection.
    /// `ramped` is what [`Certain::ramped`] says of `steps`.
    pub(super) fn later(&self, steps: i64, ramped: Rate, said: Interval) -> Option<Interval> {
        self.reference.offset.widened(self.widening(steps, ramped), 0).and(said)
    }

    /// Moves the reference to an exchange `steps` later, where the estimate is `peer` and the truth within `offset` of that. Returns how
    /// far the estimate has to move to be inside, or `None` where the rates contradict each other.
    pub(super) fn advance(&mut self, steps: i64, ramped: Rate, peer: PeerTicks, offset: Interval) -> Option<i64> {
        let at = self.reference.at.shifted(steps);
        self.reference = Anchor { at, peer, offset };
        let since = self.reference.at.steps_after(self.older.at);
        let slope = self.slope(since)?.widened(i64::from(self.ramped(since).bits()) << 7, 0);
        self.rate =
            self.rate.widened(i64::from(ramped.bits()) << 8, 0).and(slope)?.and(Interval::around(self.range))?;
        self.choose_anchors();
        let out = offset.nearest(0);
        self.reference.peer = peer.shifted(out);
        self.reference.offset = offset.widened(0, out);
        Some(out)
    }

    /// Keeps the anchors that say most of the rate: the older gives way when the newer is half of the best age, or when its slope is
    /// already the narrower; the newer gives way to one of half its width.
    fn choose_anchors(&mut self) {
        let now = self.reference;
        let width = now.offset.width();
        let (age, since) = (now.at.steps_after(self.newer.at), now.at.steps_after(self.older.at));
        // by which of two times, so that nothing is divided; ages are cut at 2^40 steps (72 min), so that no product is over 2^59
        let long = |age: i64| narrow(age.clamp(0, 1 << 40) >> 12);
        let older_slope = product(self.older.offset.width() + width, long(age));
        let newer_slope = product(self.newer.offset.width() + width, long(since));
        // c·T²/2 > w/4
        if self.ramped(age).over(age) > i64::from(width >> 1) || newer_slope < older_slope {
            (self.older, self.newer) = (self.newer, now);
        } else if width < self.newer.offset.width() >> 1 {
            self.newer = now;
        }
    }

    /// The nearest to `skew` that the rate can be, both in 2^−40; from there its uncertainty counts.
    pub(super) fn rate_near(&mut self, skew: i64) -> i64 {
        let nearest = self.rate.nearest(skew);
        // rounded to 2^−32 when it is used
        self.drift = Rate::saturated((self.rate.reach(nearest) >> 8) + 2);
        nearest
    }

    /// Between what the mean rate since the older anchor lies, `since` steps ago, 2^−40.
    fn slope(&self, since: i64) -> Option<Interval> {
        if since <= 0 {
            return Some(Interval::ALL);
        }
        let (now, then) = (self.reference, self.older);
        let rise = now.peer.steps_after(then.peer).saturating_sub(since).clamp(-MOST, MOST);
        let lowest = rise + now.offset.lowest - then.offset.highest;
        let highest = rise + now.offset.highest - then.offset.lowest;
        let over = Reciprocal::of(since);
        // over a few steps that is anything; no rate is over 2^40
        let rate = |steps: i64| over.times(steps << 16, 24).clamp(-1 << 46, 1 << 46);
        // a quotient is a part in 2^30 and a unit off at most
        let (lowest, highest) = (rate(lowest), rate(highest));
        let between =
            Interval { lowest: lowest - (lowest.abs() >> 30) - 2, highest: highest + (highest.abs() >> 30) + 2 };
        (lowest <= highest).then_some(between)
    }

    /// Moves the reference into the interval, and makes it the only anchor.
    fn enclose(&mut self) -> i64 {
        let Anchor { at, peer, offset } = self.reference;
        let out = offset.nearest(0);
        self.reference = Anchor { at, peer: peer.shifted(out), offset: offset.widened(0, out) };
        (self.older, self.newer) = (self.reference, self.reference);
        out
    }
}

/// What is known to be of 32 bits.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "cut before")]
const fn narrow(value: i64) -> u32 {
    value as u32
}

/// What an estimate lives on without news, 2.5 s: its drift counts for what the rate may gain in that time, and so covers what the
/// square of the time adds in twice as long.
const LIFE: i64 = 640_000_000;

/// Steps that still fit when they are taken as µs in Q24; what is farther counts as that.
const MOST: i64 = 1 << 46;

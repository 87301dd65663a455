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
//! - **Walk:** [`LinkClock::observe`](super::LinkClock::observe) and [`LinkClock::bound_at`](super::LinkClock::bound_at).
//! - **Invariants:** every rounding widens.
//! - **Context:** any.

/// Between what steps the truth lies, relative to some reference.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Interval {
    pub(super) lowest: i64,
    pub(super) highest: i64,
}

impl Interval {
    /// The same, wider by `by` to either side, relative to a reference `moved` steps later.
    pub(super) const fn widened(self, by: i64, moved: i64) -> Self {
        Self {
            lowest: self.lowest.saturating_sub(moved).saturating_sub(by),
            highest: self.highest.saturating_sub(moved).saturating_add(by),
        }
    }

    /// What both allow, or `None` where they contradict each other.
    pub(super) fn and(self, other: Self) -> Option<Self> {
        let both = Self { lowest: self.lowest.max(other.lowest), highest: self.highest.min(other.highest) };
        (both.lowest <= both.highest).then_some(both)
    }

    /// How far the reference is from the truth at most.
    pub(super) const fn reach(self) -> u64 {
        let (below, above) = (self.lowest.saturating_neg(), self.highest);
        let farther = if below > above { below } else { above };
        if farther < 0 { 0 } else { farther.cast_unsigned() }
    }
}

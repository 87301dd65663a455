//! How sure the estimator of a link is of its two numbers, and how much it makes of a measurement: a Kalman filter's arithmetic.
//!
//! - **Walk:** [`LinkClock::observe`](super::LinkClock::observe) → [`Covariance::after`] (what time does to it) → [`Covariance::gains`] →
//!   [`Covariance::measured`].
//! - **Invariants:** both states are microseconds, since the skew is taken as what it adds to the offset in a unit of 2^16 µs (65.5 ms);
//!   so all three entries are µs² in Q36, 15 (µm)² fine. A span in steps of 2^−8 µs is that many units in Q24, and every product by time
//!   is one shift by 24. The diagonal is at least [`OFFSET_FLOOR`] and [`SKEW_FLOOR`] and at most [`CAP`].
//! - **Context:** once an exchange: twelve products longer than 64 bits, most of which have factors of 32 bits once the link has settled,
//!   and one reciprocal.

use super::wide::{Reciprocal, mul_shift, scale, scale_or_more};
use crate::widening::product;

/// Largest entry of the diagonal, 2^25 µs² (5.8 ms, one sigma): two of them still add up in 63 bits.
pub(super) const CAP: i64 = 1 << 61;
/// Largest growth of the offset's variance between two measurements, 2^20 µs² (1 ms, one sigma): with more, what was known of the offset
/// says nothing, and the two make a slope.
const GROWTH_MAX: i64 = 1 << 56;
/// Smallest variance of the offset, (1/256 µs)²: the step of what is published.
const OFFSET_FLOOR: i64 = 1 << 20;
/// Smallest variance of the skew, (0.93 ppb)²: below it rounding of the products above takes over.
const SKEW_FLOOR: i64 = 1 << 8;
/// Fraction bits of the skew's gain, which is up to 2^18, and down to 2^−13. The offset's is below one, and 2^−13 at least.
const GAIN_FRACTION: u32 = 40;
/// Fraction bits of a span of time in units of 2^16 µs when it is given in steps.
const TIME_FRACTION: u32 = 24;

/// Two thirds in 2^−16.
const TWO_THIRDS_Q16: u32 = 43_691;

/// Of offset and skew; µs² in Q36.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Covariance {
    pub(super) offset: i64,
    pub(super) both: i64,
    pub(super) skew: i64,
}

/// What part of a surprise goes to the offset, in 2^−32, and to the skew, in 2^−40.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gains {
    offset: u32,
    skew: i64,
}

impl Gains {
    /// What is added to offset and skew for `surprise`, all in the same unit.
    pub(super) const fn of(self, surprise: i64) -> (i64, i64) {
        (scale(surprise, self.offset, 32), scale_or_more(surprise, self.skew, GAIN_FRACTION))
    }
}

impl Covariance {
    /// Two numbers that know nothing of each other.
    pub(super) const fn apart(offset: i64, skew: i64) -> Self {
        Self { offset: within(offset, OFFSET_FLOOR), both: 0, skew: within(skew, SKEW_FLOOR) }
    }

    /// `steps` later, which are not negative, the skew having walked by `agility` (µs² in Q36 a unit of time): Q = A·[[T³/3, T²/2], [T²/2, T]].
    /// `None` past [`GROWTH_MAX`]. Five products.
    pub(super) const fn after(self, steps: i64, agility: i64) -> Option<Self> {
        let Some(Grown { offset, both, once }) = self.grown(steps, agility) else { return None };
        let both = self.both.saturating_add(both);
        let skew = self.skew.saturating_add(once);
        if skew > CAP {
            return None;
        }
        Some(Self { offset, both, skew: within(skew, SKEW_FLOOR) })
    }

    /// The offset's variance then.
    pub(super) const fn offset_after(self, steps: i64, agility: i64) -> Option<i64> {
        match self.grown(steps, agility) {
            Some(grown) => Some(grown.offset),
            None => None,
        }
    }

    /// What the offset's variance becomes, and what is added to the other two.
    const fn grown(self, steps: i64, agility: i64) -> Option<Grown> {
        let Walk { once, twice, thrice } = Walk::of(steps, agility);
        let turned = in_time(self.skew, steps);
        let inner = self.both.saturating_add(self.both).saturating_add(turned).saturating_add(thrice);
        let growth = in_time(inner, steps);
        let offset = self.offset.saturating_add(growth);
        if growth > GROWTH_MAX || offset > CAP {
            return None;
        }
        Some(Grown { offset: within(offset, OFFSET_FLOOR), both: turned.saturating_add(twice), once })
    }

    /// The gains for a measurement of the offset with variance `noise`. Two products and the division.
    pub(super) const fn gains(self, noise: i64) -> Gains {
        let over_sum = Reciprocal::of(self.offset + noise);
        let offset = over_sum.times(self.offset, 32);
        Gains {
            // below one, but perhaps for rounding
            offset: if let Some(offset) = narrow(offset) { offset } else { u32::MAX },
            skew: over_sum.times(self.both, GAIN_FRACTION),
        }
    }

    /// After that measurement. Three products, in the form whose diagonal cannot become negative but by rounding.
    pub(super) const fn measured(self, noise: i64, gains: Gains) -> Self {
        let skew = self.skew.saturating_sub(scale_or_more(self.both, gains.skew, GAIN_FRACTION));
        Self {
            offset: within(scale(noise, gains.offset, 32), OFFSET_FLOOR),
            both: scale_or_more(noise, gains.skew, GAIN_FRACTION),
            skew: within(skew, SKEW_FLOOR),
        }
    }

    /// What is added to the skew where the offset is known to be `surprise` off, from elsewhere. Two products and a division.
    pub(super) const fn skew_for(self, surprise: i64) -> i64 {
        let gain = Reciprocal::of(self.offset).times(self.both, GAIN_FRACTION);
        mul_shift(surprise, gain, GAIN_FRACTION)
    }

    /// After two measurements so far apart that the skew between them is their slope: what [`Covariance::after`] and
    /// [`Covariance::measured`] tend to where the skew was not known. Both noises and the walk are those of the skew at the later end.
    pub(super) const fn of_slope(first: i64, second: i64, over_steps: Reciprocal, steps: i64, agility: i64) -> Self {
        let both = over_steps.times(second, TIME_FRACTION);
        let slope = over_steps.times(first.saturating_add(second), TIME_FRACTION);
        let skew = over_steps.times(slope, TIME_FRACTION);
        let walked = mul_shift(agility, steps, TIME_FRACTION) / 3;
        Self { offset: within(second, OFFSET_FLOOR), both, skew: within(skew.saturating_add(walked), SKEW_FLOOR) }
    }
}

/// See [`Covariance::grown`].
struct Grown {
    offset: i64,
    both: i64,
    once: i64,
}

/// What a walk of the skew adds: A·T to its own variance, A·T²/2 to what it shares with the offset, and A·T²/3, of which T times is the
/// offset's.
struct Walk {
    once: i64,
    twice: i64,
    thrice: i64,
}

impl Walk {
    /// In `steps` with `agility`; three products.
    const fn of(steps: i64, agility: i64) -> Self {
        if let (Some(short), Some(agility)) = (narrow(steps), narrow(agility))
            && let Some(once) = narrow((product(agility, short) >> TIME_FRACTION).cast_signed())
            && let Some(twice) = narrow((product(once, short) >> (TIME_FRACTION + 1)).cast_signed())
        {
            // 32 bits each, as nearly always
            let thrice = (product(twice, TWO_THIRDS_Q16) >> 16).cast_signed();
            return Self { once: once as i64, twice: twice as i64, thrice };
        }
        let once = scale_or_more(agility, steps, TIME_FRACTION);
        let twice = scale_or_more(once, steps, TIME_FRACTION + 1);
        Self { once, twice, thrice: scale(twice, TWO_THIRDS_Q16, 16) }
    }
}

/// `value` times `steps` in units of time, rounded down, saturating.
const fn in_time(value: i64, steps: i64) -> i64 {
    if let (Some(short), Some(steps)) = (narrow(value), narrow(steps)) {
        return (product(short, steps) >> TIME_FRACTION).cast_signed();
    }
    scale_or_more(value, steps, TIME_FRACTION)
}

/// Where it is of 32 bits.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "of 32 bits")]
const fn narrow(value: i64) -> Option<u32> {
    if value >> 32 == 0 { Some(value as u32) } else { None }
}

/// Between `floor` and [`CAP`].
const fn within(value: i64, floor: i64) -> i64 {
    if value < floor {
        floor
    } else if value > CAP {
        CAP
    } else {
        value
    }
}

#[cfg(test)]
#[expect(clippy::cast_precision_loss, reason = "the reference is in floating point")]
mod tests {
    use super::*;
    extern crate std;
    use proptest::prelude::*;
    use std::vec::Vec;

    /// µs² of an entry.
    fn value(entry: i64) -> f64 {
        entry as f64 / f64::from(1u32 << 18).powi(2)
    }

    /// The same filter, of a textbook, in floating point; µs and units of 2^16 µs.
    struct Reference {
        p: [[f64; 2]; 2],
    }

    impl Reference {
        fn after(&mut self, time: f64, a: f64) {
            let [[p00, p01], [_, p11]] = self.p;
            let both = p01 + time * p11 + a * time * time / 2.0;
            self.p[0][0] = p00 + 2.0 * time * p01 + time * time * p11 + a * time.powi(3) / 3.0;
            self.p[0][1] = both;
            self.p[1] = [both, p11 + a * time];
        }

        fn measured(&mut self, r: f64) -> [f64; 2] {
            let [[p00, p01], [_, p11]] = self.p;
            let gains = [p00 / (p00 + r), p01 / (p00 + r)];
            self.p = [[gains[0] * r, gains[1] * r], [gains[1] * r, p11 - gains[1] * p01]];
            gains
        }
    }

    /// A crystal's or an RC oscillator's start, and exchanges 1 ms to 10 s apart with any excess.
    fn exchanges() -> impl Strategy<Value = (i64, Vec<(i64, i64)>)> {
        let time = prop_oneof![256_000i64..2_560_000, 1_280_000i64..12_800_000, 12_800_000i64..2_560_000_000];
        let noise = prop_oneof![4 => Just(5_726_623_061i64), 1 => 1i64 << 32..1 << 46];
        ((1i64 << 38..1 << 44), prop::collection::vec((time, noise), 1..400))
    }

    proptest! {
        /// Gains and variances are those of the reference. A measurement brings the skew's variance down to a part in 2^23 at most
        /// ([`GROWTH_MAX`] over the least noise), by a difference whose larger side is a part in 2^30 off: 2^−7 of what is left, which the
        /// next one no longer sees. Other roundings are a unit each, of entries above 2^12.
        #[test]
        fn gains_are_those_of_the_reference((skew, exchanges) in exchanges()) {
            let agility = 17_400;
            let mut found = Covariance::apart(1 << 33, skew);
            let mut reference = Reference { p: [[value(1 << 33), 0.0], [0.0, value(skew)]] };
            for (steps, noise) in exchanges {
                let Some(later) = found.after(steps, agility) else { break };
                reference.after(steps as f64 / f64::from(1 << 24), value(agility));
                let gains = later.gains(noise);
                found = later.measured(noise, gains);
                let exact = reference.measured(value(noise));
                let gain = |gain: i64| gain as f64 / f64::from(1u32 << 20).powi(2);
                let offset_gain = gain(i64::from(gains.offset) << 8);
                prop_assert!((offset_gain - exact[0]).abs() <= exact[0] / 128.0 + 1e-9, "{gains:?} {exact:?}");
                prop_assert!((gain(gains.skew) - exact[1]).abs() <= exact[1].abs() / 128.0 + 1e-9, "{gains:?} {exact:?}");
                let [[p00, _], [_, p11]] = reference.p;
                prop_assert!((value(found.offset) - p00).abs() <= p00 / 128.0, "{found:?} {p00}");
                prop_assert!((value(found.skew) - p11).abs() <= p11 / 128.0, "{found:?} {p11}");
            }
        }

        /// What a slope is worth: two measurements of which the first was preceded by nothing.
        #[test]
        fn a_slope_is_the_filter_that_knew_nothing(steps in 256_000_000i64..1 << 38, noise in 1i64 << 32..1 << 40) {
            let time = steps as f64 / f64::from(1 << 24);
            let found = Covariance::of_slope(noise, noise, Reciprocal::of(steps), steps, 17_400);
            // a skew of which nothing is known: hundreds of ppm squared, and no more, as the reference subtracts too
            let mut reference = Reference { p: [[value(noise), 0.0], [0.0, 1e4]] };
            reference.after(time, value(17_400));
            reference.measured(value(noise));
            let [[p00, p01], [_, p11]] = reference.p;
            let near = |found: i64, exact: f64| (value(found) - exact).abs() <= 1e-3 * exact + value(1 << 9);
            prop_assert!(near(found.offset, p00) && near(found.both, p01) && near(found.skew, p11), "{found:?} {p00} {p01} {p11}");
        }

        /// No times, noises or walks overflow or leave the caps.
        #[test]
        fn nothing_leaves_the_caps(start in 0i64..=CAP, steps in 0i64..1 << 38, agility in 0i64..1 << 30, noise in 1i64..=CAP, surprise in any::<i64>()) {
            let mut found = Covariance::apart(start, start);
            while let Some(later) = found.after(steps, agility) {
                let gains = later.gains(noise);
                let _ = gains.of(surprise);
                let measured = later.measured(noise, gains);
                prop_assert!((OFFSET_FLOOR..=CAP).contains(&measured.offset) && (SKEW_FLOOR..=CAP).contains(&measured.skew));
                if measured == found || measured.offset >= found.offset {
                    break;
                }
                found = measured;
            }
        }
    }
}

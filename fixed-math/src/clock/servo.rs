//! What steers a node's map: the estimator, or one of two servos of others, chosen at run time.
//!
//! - **Walk:** the clock service gathers a [`Neighbour`] for each link → [`Servo::steer`] → the [`SlewedMap`].
//! - **Invariants:** none but [`Oldest`] ever steps a map, and that only forwards, to a clock that is substantially older.
//! - **Context:** once an interval; one 64-bit division, or for the estimator what a new target of its map takes.

use super::line::{Estimate, TimeLine};
use super::slew::SlewedMap;
use crate::time::{LocalTicks, Rate, Span};

/// A neighbour's time as a servo sees it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Neighbour {
    /// Links between it and the root.
    pub tier: u8,
    /// Its system time minus mine, as measured in the last exchange.
    pub offset_steps: i64,
    /// The same, filtered by [`ewma`].
    pub filtered_steps: i64,
    /// What the estimator makes of it.
    pub estimate: Estimate,
}

/// What can be tuned, over the network and at run time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gains {
    /// Time between two calls of [`Servo::steer`].
    pub interval: Span,
    /// Weight of what is new in a filter, 2^−16; 65,536 and more: no filter.
    pub filter_q16: i32,
    /// Part of an offset that is taken off in an interval, 2^−16.
    pub proportional_q16: i32,
    /// Part of an offset that is added to the rate for good, 2^−16 an interval.
    pub integral_q16: i32,
    /// Most that a map's rate differs from its target's, or for the servos of others from the counter's.
    pub limit: Rate,
    /// How far ahead another clock is "substantially older", steps.
    pub adopt_steps: i64,
}

/// Steers a map towards neighbours' times.
pub trait Servo {
    /// Once an interval. No neighbours: nothing changes.
    fn steer(&mut self, now: LocalTicks, neighbours: &[Neighbour], gains: &Gains, map: &mut SlewedMap);

    /// Forgets what it learnt.
    fn restart(&mut self);
}

/// The estimator: the target is the mean of the estimates of the lowest tier, and the map is slewed to it within four intervals if the
/// limit allows.
#[derive(Clone, Copy, Debug, Default)]
pub struct Follow;

impl Servo for Follow {
    fn steer(&mut self, now: LocalTicks, neighbours: &[Neighbour], gains: &Gains, map: &mut SlewedMap) {
        let best = of_lowest_tier(neighbours).map(|neighbour| neighbour.estimate);
        if let Some(mean) = Estimate::mean(best, now) {
            map.slew_to(mean.line, now, gains.interval.saturating_mul(4), gains.limit);
        }
    }

    fn restart(&mut self) {}
}

/// The thesis's servo (2.3.2.2): the filtered offsets to the neighbours of the best tier, averaged, through a PI controller that sets the
/// rate.
#[derive(Clone, Copy, Debug, Default)]
pub struct Diffusion {
    /// In 2^−32.
    integral: i64,
}

impl Servo for Diffusion {
    fn steer(&mut self, now: LocalTicks, neighbours: &[Neighbour], gains: &Gains, map: &mut SlewedMap) {
        let best = of_lowest_tier(neighbours).map(|neighbour| neighbour.filtered_steps);
        let Some(error) = mean_steps(best) else { return };
        let limit = i64::from(gains.limit.bits().max(0));
        // held at the limit, so that it does not wind up
        self.integral = (self.integral + shim(error, gains.integral_q16, gains.interval)).clamp(-limit, limit);
        run_at(self.integral + shim(error, gains.proportional_q16, gains.interval), gains, now, map);
    }

    fn restart(&mut self) {
        self.integral = 0;
    }
}

/// The disclosure's rule: a clock that is substantially older is adopted; otherwise the average of the neighbours' offsets shims the rate,
/// through a filter.
#[derive(Clone, Copy, Debug, Default)]
pub struct Oldest {
    /// In 2^−32.
    filtered: i64,
}

impl Servo for Oldest {
    fn steer(&mut self, now: LocalTicks, neighbours: &[Neighbour], gains: &Gains, map: &mut SlewedMap) {
        let offsets = || neighbours.iter().map(|neighbour| neighbour.offset_steps);
        let (Some(oldest), Some(mean)) = (offsets().max(), mean_steps(offsets())) else { return };
        if oldest > gains.adopt_steps {
            let line = TimeLine { at: now, system: map.system_at(now).shifted(oldest), rate: map.rate_at(now) };
            map.step_to(line);
            return;
        }
        self.filtered = ewma(self.filtered, shim(mean, gains.proportional_q16, gains.interval), gains.filter_q16);
        run_at(self.filtered, gains, now, map);
    }

    fn restart(&mut self) {
        self.filtered = 0;
    }
}

/// An exponentially weighted mean: `filtered` moved towards `new` by `weight_q16` 2^−16 of the distance, which is taken as 0 to 1.
///
/// Rounded away from `filtered`, so that it arrives; what is longer than 2^46 is moved by whole units of the weight only.
#[must_use]
pub fn ewma(filtered: i64, new: i64, weight_q16: i32) -> i64 {
    let weight = i64::from(weight_q16.clamp(0, 1 << 16));
    if weight == 1 << 16 {
        return new;
    }
    let distance = new.saturating_sub(filtered);
    let part = match distance.checked_mul(weight) {
        Some(product) if product < 0 => product.div_euclid(1 << 16),
        Some(product) => product.saturating_add((1 << 16) - 1) >> 16,
        None => (distance >> 16) * weight,
    };
    filtered.saturating_add(part)
}

/// Those as near to the root as any.
fn of_lowest_tier(neighbours: &[Neighbour]) -> impl Iterator<Item = &Neighbour> {
    let lowest = neighbours.iter().map(|neighbour| neighbour.tier).min();
    neighbours.iter().filter(move |neighbour| Some(neighbour.tier) == lowest)
}

/// The mean, rounded down; of none, none.
fn mean_steps(offsets: impl Iterator<Item = i64>) -> Option<i64> {
    let (sum, count) = offsets.fold((0i64, 0i64), |(sum, count), offset| (sum.saturating_add(offset), count + 1));
    (count > 0).then(|| sum.div_euclid(count))
}

/// The rate, in 2^−32, that takes `gain_q16` 2^−16 of `error` off in an interval. Errors are cut at 2^20 µs, and so fit.
fn shim(error: i64, gain_q16: i32, interval: Span) -> i64 {
    const MOST: i64 = 1 << 28;
    let interval = i64::try_from(interval.steps()).unwrap_or(i64::MAX).max(1);
    let gain = i64::from(gain_q16.clamp(-(1 << 17), 1 << 17));
    (error.clamp(-MOST, MOST) * gain).saturating_mul(1 << 16) / interval
}

/// Runs on from where the map is, at `rate` 2^−32 within the limit.
fn run_at(rate: i64, gains: &Gains, now: LocalTicks, map: &mut SlewedMap) {
    let limit = Rate::from_bits(gains.limit.bits().max(0));
    map.step_to(TimeLine { at: now, system: map.system_at(now), rate: Rate::saturated(rate).within(limit) });
}

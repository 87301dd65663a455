//! Counters of nodes: a rate that is off, that ramps with temperature, wanders and steps, read with a timer's resolution.
//!
//! - **Walk:** [`ClockModel`] says what a counter is like → [`Clock`] reads it, and tells when it will read something.
//! - **Invariants:** a clock never runs backwards; [`Clock::truth`] is the first instant at which [`Clock::local`] reads at least that much.
//!   Both are exact in integers, at any instant, without any state: the rate is a sum of triangles of true time, whose integral is known.
//! - **Context:** the thread that steps the world. **Clause:** `[NOD-12]`.
//!
//! The rate is constant within each tenth of a second of true time. A ramp of 0.01 ppm a second so becomes steps of 10⁻⁹, which make
//! 0.1 ns of each: nothing beside a step of 1/256 µs.

use super::TrueTime;
use fixed_math::time::{LocalTicks, Span};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// What a node's counter is like.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ClockModel {
    /// How much faster than true time it runs, parts per million; within ±500,000.
    pub rate_ppm: f64,
    /// What it reads when its node is added, µs. After a reset it begins at zero.
    pub offset_us: u64,
    /// What its timer counts in: readings are rounded down to whole ones. Zero: 1/256 µs, the step of all times.
    pub tick: Span,
    /// Goes evenly up and down, as with temperature; on top of `rate_ppm`.
    pub ramp: Ramp,
    /// Goes up and down at random, as an RC oscillator does; on top of that.
    pub wander: Wander,
    /// Changes once, as in a draught; on top of that.
    pub step: RateStep,
}

impl ClockModel {
    /// Runs with true time, and is read exactly.
    pub const PERFECT: Self = Self::off_by(0.0);

    /// Runs `rate_ppm` faster than true time, evenly, and is read exactly.
    #[must_use]
    pub const fn off_by(rate_ppm: f64) -> Self {
        Self { rate_ppm, offset_us: 0, tick: Span::ZERO, ramp: Ramp::NONE, wander: Wander::NONE, step: RateStep::NONE }
    }

    /// An RC oscillator: off by `rate_ppm`, a thousand ppm of wander with a slowest period of 20 s, a timer of 1 µs.
    #[must_use]
    pub const fn rc(rate_ppm: f64, seed: u64) -> Self {
        let wander = Wander { ppm_max: 1_000.0, period_s: 20.0, seed };
        Self { tick: Span::from_us(1), wander, ..Self::off_by(rate_ppm) }
    }
}

/// A rate that goes evenly between two bounds and turns round there. It is nought at the world's beginning; a reset of the node does not
/// change what its crystal does.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ramp {
    /// How fast it changes, ppm a second; negative: downwards first.
    pub ppm_per_s: f64,
    /// Where it turns, ppm above and below nought; at most 50,000.
    pub ppm_max: f64,
}

impl Ramp {
    /// A rate that stays.
    pub const NONE: Self = Self { ppm_per_s: 0.0, ppm_max: 0.0 };
}

/// A rate that goes up and down without a period: three ramps whose periods have the golden section between them, at phases drawn from
/// the seed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wander {
    /// What it never exceeds, ppm; at most 50,000.
    pub ppm_max: f64,
    /// Period of the slowest ramp, s, which has half of `ppm_max`; the others have a third and a sixth.
    pub period_s: f64,
    /// Of the phases.
    pub seed: u64,
}

impl Wander {
    /// A rate that stays.
    pub const NONE: Self = Self { ppm_max: 0.0, period_s: 0.0, seed: 0 };
}

/// A change of rate that stays.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RateStep {
    /// When; the rate changes at the next whole tenth of a second.
    pub at: TrueTime,
    /// By how much, ppm; at most 50,000 either way.
    pub ppm: f64,
}

impl RateStep {
    /// A rate that stays.
    pub const NONE: Self = Self { at: TrueTime::ZERO, ppm: 0.0 };
}

/// Fractional bits of a clock's rate: one part in 2^48 is 0.3 µs in a year.
const RATE_BITS: u32 = 48;
/// The rate is constant for so long: a tenth of a second, steps.
const SEGMENT: i128 = 100_000 << fixed_math::time::FRACTION_BITS;
const SEGMENTS_A_SECOND: f64 = 10.0;
/// What a ramp, a wander and a step may each come to. With a rate of at least ½, all together keep it above 0.35, and within a factor of
/// two of itself, so that the search of [`Clock::truth`] closes in.
const DEVIATION_PPM_MAX: f64 = 50_000.0;
/// Longest half period of a ramp, segments: three million years.
const HALF_MAX: f64 = 1e15;

/// `ppm` as a rate.
fn rate_of(ppm: f64) -> i64 {
    #[expect(clippy::cast_possible_truncation, reason = "at most half of 2^48")]
    let rate = (ppm * 1e-6 * 2f64.powi(48)).round() as i64;
    rate
}

/// A deviation that goes between −`slope · half / 2` and as much above, in whole segments.
#[derive(Clone, Copy, Debug, Default)]
struct Triangle {
    /// What each segment adds while it rises; 2^−48.
    slope: i64,
    /// Segments from one turn to the next; even.
    half: i64,
    /// Segments since the last turn upwards, at the world's beginning.
    phase: i64,
}

impl Triangle {
    /// `share` says where in its period it begins: 0 at the lower turn, ¼ at nought and rising.
    fn new(ppm_max: f64, half_s: f64, share: f64) -> Self {
        let peak = rate_of(if ppm_max.is_finite() { ppm_max.clamp(0.0, DEVIATION_PPM_MAX) } else { DEVIATION_PPM_MAX });
        let pairs = (half_s * SEGMENTS_A_SECOND / 2.0).round();
        // what is not a number is no longer than a pair either
        #[expect(clippy::cast_possible_truncation, reason = "at most 10^15")]
        let half = if pairs > 1.0 { pairs.min(HALF_MAX / 2.0) as i64 * 2 } else { 2 };
        #[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "below 2 · 10^15")]
        let phase = ((share * 2.0 * half as f64) as i64).rem_euclid(2 * half);
        Self { slope: 2 * peak / half, half, phase }
    }

    fn peak(self) -> i128 {
        i128::from(self.slope) * i128::from(self.half / 2)
    }

    /// Its value in the segment `at` segments after a turn upwards, at most a period.
    fn value(self, at: i64) -> i128 {
        let up = at.min(self.half) - (at - self.half).max(0);
        i128::from(self.slope) * i128::from(up) - self.peak()
    }

    /// The sum of its values in the first `at` segments after a turn upwards, at most a period. A whole period sums up to nothing.
    fn sum(self, at: i64) -> i128 {
        let ramp = |count: i64| i128::from(self.slope) * (i128::from(count) * i128::from(count - 1) / 2);
        let (up, down) = (at.min(self.half), (at - self.half).max(0));
        self.peak() * i128::from(down - up) + ramp(up) - ramp(down)
    }

    /// In segment `n` of the world: its value, and the sum of all values before.
    fn at(self, n: i64) -> (i128, i128) {
        if self.slope == 0 {
            return (0, 0);
        }
        let at = (self.phase + n) % (2 * self.half);
        (self.value(at), self.sum(at) - self.sum(self.phase))
    }
}

/// A node's counter.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    origin: TrueTime,
    /// What it reads at its origin, steps.
    offset: u64,
    /// Steps that its timer counts in.
    tick: u64,
    /// Its steps for each step of true time, in units of 2^−48, before deviations.
    rate: i64,
    ramps: [Triangle; 4],
    /// From this segment on the rate is another.
    step_from: i64,
    step: i64,
    /// It has deviations at all.
    varies: bool,
    /// Counted since the world's beginning at its origin, 2^−48 steps.
    before: i128,
}

/// What a clock does in a segment.
struct Segment {
    starts: i128,
    /// Counted since the world's beginning, 2^−48 steps.
    counted: i128,
    rate: i128,
}

impl Clock {
    /// A counter that begins at `origin`. A rate outside ±500,000 ppm is cut, as is a deviation outside ±50,000 ppm.
    #[must_use]
    pub fn new(model: ClockModel, origin: TrueTime) -> Self {
        let ClockModel { rate_ppm, offset_us, tick, ramp, wander, step } = model;
        let ramp_half_s = 2.0 * ramp.ppm_max / ramp.ppm_per_s.abs();
        let ramp = if ramp.ppm_per_s == 0.0 || ramp.ppm_max == 0.0 {
            Triangle::default()
        } else {
            Triangle::new(ramp.ppm_max, ramp_half_s, if ramp.ppm_per_s < 0.0 { 0.75 } else { 0.25 })
        };
        let mut rng = Pcg64::seed_from_u64(wander.seed);
        let mut wandering = |part: f64, period: f64| {
            Triangle::new(wander.ppm_max * part, wander.period_s * period / 2.0, rng.random_range(0.0..1.0))
        };
        // powers of the golden section: no two of them have a common multiple
        let [slow, middle, quick] =
            [wandering(1.0 / 2.0, 1.0), wandering(1.0 / 3.0, 0.381_966), wandering(1.0 / 6.0, 0.145_898)];
        let ramps = [ramp, slow, middle, quick];
        let step_rate = rate_of(step.ppm.clamp(-DEVIATION_PPM_MAX, DEVIATION_PPM_MAX));
        let mut clock = Self {
            origin,
            offset: TrueTime::from_us(offset_us).steps(),
            tick: tick.steps().max(1),
            rate: (1 << RATE_BITS) + rate_of(rate_ppm.clamp(-5e5, 5e5)),
            ramps,
            step_from: segment_of(i128::from(step.at.steps()) + SEGMENT - 1),
            step: step_rate,
            varies: step_rate != 0 || ramps.iter().any(|ramp| ramp.slope != 0),
            before: 0,
        };
        clock.before = clock.counted(origin);
        clock
    }

    /// The same counter after a reset at `origin`: it begins at zero again. Its crystal goes on as before.
    #[must_use]
    pub fn restarted(self, origin: TrueTime) -> Self {
        Self { origin, offset: 0, before: self.counted(origin), ..self }
    }

    /// What it reads at `at`, in whole ticks; before its origin, what it reads there.
    #[must_use]
    pub fn local(&self, at: TrueTime) -> LocalTicks {
        let exact = self.exact(at).steps();
        LocalTicks::from_steps(exact - exact % self.tick)
    }

    /// What it would read at `at` if its timer counted in steps: for measuring, since no node can know it.
    #[must_use]
    pub fn exact(&self, at: TrueTime) -> LocalTicks {
        let passed = (self.counted(at.max(self.origin)) - self.before) >> RATE_BITS;
        LocalTicks::from_steps(saturate(i128::from(self.offset) + passed))
    }

    /// The first instant at which it reads `local` or more.
    #[must_use]
    pub fn truth(&self, local: LocalTicks) -> TrueTime {
        // it reads `local` from the first whole tick at or above on
        let wanted = u128::from(local.steps()).next_multiple_of(u128::from(self.tick));
        let passed = i128::try_from(wanted).unwrap_or(i128::MAX) - i128::from(self.offset);
        if passed <= 0 {
            return self.origin;
        }
        let wanted = self.before + (passed << RATE_BITS);
        TrueTime::from_steps(saturate(self.first_with(wanted))).max(self.origin)
    }

    /// Steps of 2^−48 counted from the world's beginning to `at`, whether or not the node was there.
    fn counted(&self, at: TrueTime) -> i128 {
        let at = i128::from(at.steps());
        if !self.varies {
            return at * i128::from(self.rate);
        }
        let segment = self.segment(segment_of(at));
        segment.counted + (at - segment.starts) * segment.rate
    }

    /// The first step of true time, without an end, at which `wanted` is counted; `wanted` is above nought.
    fn first_with(&self, wanted: i128) -> i128 {
        let mut n = if self.varies { segment_of(wanted / i128::from(self.rate)) } else { 0 };
        loop {
            let Segment { starts, counted, rate } = self.segment(n);
            let missing = wanted - counted;
            if self.varies && missing <= 0 {
                n = segment_of(starts - 1 + missing / rate).max(0);
            } else if self.varies && missing > SEGMENT * rate {
                n = segment_of(starts + missing / rate);
            } else {
                return starts + missing / rate + i128::from(missing % rate != 0);
            }
        }
    }

    fn segment(&self, n: i64) -> Segment {
        let starts = i128::from(n) * SEGMENT;
        if !self.varies {
            return Segment { starts, counted: starts * i128::from(self.rate), rate: i128::from(self.rate) };
        }
        let (mut rate, mut extra) = (i128::from(self.rate), 0);
        for ramp in self.ramps {
            let (value, sum) = ramp.at(n);
            rate += value;
            extra += sum;
        }
        if n >= self.step_from {
            rate += i128::from(self.step);
            extra += i128::from(self.step) * i128::from(n - self.step_from);
        }
        Segment { starts, counted: starts * i128::from(self.rate) + extra * SEGMENT, rate }
    }
}

/// The segment in which a step of true time lies.
fn segment_of(at: i128) -> i64 {
    // true time has 2^64 steps, a search may look as far as twice that: 2^41 segments
    i64::try_from(at / SEGMENT).unwrap_or(i64::MAX)
}

fn saturate(steps: i128) -> u64 {
    u64::try_from(steps).unwrap_or(if steps < 0 { 0 } else { u64::MAX })
}

#[cfg(test)]
mod tests;

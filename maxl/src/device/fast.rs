//! Stepping at eight times the rate of the beat: 125 kHz where that is 15.625 kHz.
//!
//! - **Walk:** every eighth of a beat, a *slice* → [`FastInterpolator::slice`] → the levels for the next slice. In slice 0 the times are found, in slices
//!   1 to 4 an axis each is played and its edges of the next beat are found, in 5 and 6 signals and triggers, so that no slice has more than
//!   an eighth of a beat's work. What is left for every slice is to take its edges from the beat's.
//! - **Invariants:** an axis is exact at beats, by the same evaluator. Within a beat a position is the line between two: exact in eighths of a
//!   LSB, and off the spline by at most A/(8·n²) LSB, with A the greatest second difference and n beats in an interval: 4 LSB at intervals
//!   of 4.096 ms and A = 2^17. What is put out was calculated a beat before, so tracks are played two beats ahead of the calculation.
//! - **Context:** the highest-priority task; a step costs additions and comparisons alone. **Clause:** `[MOT-02]`.

use super::interpolator::{BeatOutput, Interpolator, Times};
use super::{AXES, INPUTS};
use crate::player::{Output, PlayerState};
use fixed_math::steps::{Direction, StepBits};
use fixed_math::time::{LocalTicks, Span};

/// Slices of a beat, base-two logarithm.
const SLICES_LOG2: u32 = 3;
/// Slices of a beat.
pub const SLICES: u32 = 1 << SLICES_LOG2;
/// The last of them.
const LAST: usize = SLICES as usize - 1;
const _: () = assert!(SLICES as usize > AXES + 3 && INPUTS > 0, "a slice for each part of a beat");

/// What all axes put out in each slice of a beat: bit n is axis n.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Edges {
    steps: [u8; SLICES as usize],
    directions: [u8; SLICES as usize],
}

impl Edges {
    /// Adds those of axis `index`, which goes from `from` to `to` in a line. Its first position is an eighth of the way on, its last `to`.
    fn add(&mut self, index: usize, steps: &mut StepBits, from: i32, to: i32) {
        // limits keep a beat's way far below this; were it not so, the steps would come late and be told
        let slope = to.saturating_sub(from).clamp(-(1 << 27), 1 << 27);
        let bit = 1 << index;
        let (first, last) = (from.wrapping_add(slope >> SLICES_LOG2), from.wrapping_add(slope));
        if steps.holds(first) && steps.holds(last) {
            // what lies between two that are held is held
            if steps.update(last).direction == Direction::Up {
                self.directions.iter_mut().for_each(|levels| *levels |= bit);
            }
            return;
        }
        let mut gone = 0;
        for (step_levels, direction_levels) in self.steps.iter_mut().zip(&mut self.directions) {
            gone += slope;
            let step = steps.update(from.wrapping_add(gone >> SLICES_LOG2));
            *step_levels |= if step.is_step { bit } else { 0 };
            *direction_levels |= if step.direction == Direction::Up { bit } else { 0 };
        }
    }
}

/// An interpolator that is called in slices.
pub struct FastInterpolator<'a> {
    inner: Interpolator<'a>,
    slice: usize,
    times: Option<Times>,
    /// Where each axis is at the end of its last line.
    ends: [i32; AXES],
    /// What is calculated for the next beat.
    coming: BeatOutput,
    coming_edges: Edges,
    /// What holds for this one.
    held: BeatOutput,
    edges: Edges,
}

impl<'a> FastInterpolator<'a> {
    /// Over an interpolator whose beat is eight slices long.
    #[must_use]
    pub fn new(inner: Interpolator<'a>) -> Self {
        let held = BeatOutput { period_cycles: inner.nominal_cycles, ..BeatOutput::default() };
        let edges = Edges::default();
        Self { inner, slice: 0, times: None, ends: [0; AXES], coming: held, coming_edges: edges, held, edges }
    }

    /// One slice. `wrap` is asked for when the first slice of a beat began; `sense` reads a channel. Of what comes back, steps and directions are for
    /// the next slice, and the period is that of one slice.
    pub fn slice(&mut self, wrap: impl FnOnce() -> LocalTicks, mut sense: impl FnMut(u8) -> i32) -> BeatOutput {
        match self.slice {
            0 => {
                let lead = Span::from_steps(2 * self.inner.period.steps());
                (self.coming, self.times) = self.inner.begin(wrap(), lead);
                self.coming_edges = Edges::default();
            }
            5 => {
                if let Some(times) = self.times {
                    self.inner.signals(times.track, &mut self.coming);
                }
            }
            6 => {
                if let Some(times) = self.times {
                    self.inner.trigger(times.system, &mut sense);
                }
            }
            7 => (self.held, self.edges) = (self.coming, self.coming_edges),
            axis => {
                if let Some(times) = self.times {
                    let played = self.inner.play(axis - 1, times.track, &mut self.coming);
                    self.follow(axis - 1, &played);
                }
            }
        }
        let mut out = self.held;
        // what the beat's length leaves over an eighth goes to its first slices
        let (each, rest) = (out.period_cycles >> SLICES_LOG2, out.period_cycles as usize & LAST);
        out.period_cycles = each + u32::from(self.slice < rest);
        self.slice = (self.slice + 1) & LAST;
        (out.steps, out.directions) = (self.edges.steps[self.slice], self.edges.directions[self.slice]);
        out
    }

    /// Edges of axis `index` on its way to where it is played next.
    fn follow(&mut self, index: usize, played: &Output) {
        let (Some(axis), Some(end)) = (self.inner.axes.get_mut(index), self.ends.get_mut(index)) else { return };
        if played.state == PlayerState::Idle {
            return;
        }
        let from = if axis.begins(played) { played.position } else { *end };
        axis.rebase(played);
        *end = played.position;
        if let Some(steps) = axis.steps() {
            self.coming_edges.add(index, steps, from, played.position);
        }
    }

    /// As [`Interpolator::node`].
    #[must_use]
    pub fn node(&self, index: usize) -> Option<i32> {
        self.inner.node(index)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Edges found at once are those of one position after the other, and leave the same behind, over ways of all lengths, rests among them.
    #[test]
    fn a_beats_edges_are_those_of_its_slices() {
        let mut seed = 7_u32;
        let mut random = || {
            seed ^= seed << 13;
            seed ^= seed >> 17;
            seed ^= seed << 5;
            seed
        };
        let mut steps = StepBits::new(6, 16, 0).unwrap();
        let mut reference = steps;
        let (mut from, mut stepped) = (0_i32, 0);
        for _ in 0..100_000 {
            let way = (random() >> (16 + random() % 16)).cast_signed();
            let to = from.wrapping_add(if random() % 2 == 0 { way } else { -way });
            let mut edges = Edges::default();
            edges.add(2, &mut steps, from, to);
            let mut expected = Edges::default();
            for slice in 0..8 {
                let at = from + (((to - from) * (slice + 1)) >> 3);
                let step = reference.update(at);
                let place = usize::try_from(slice).unwrap();
                expected.steps[place] = u8::from(step.is_step) << 2;
                expected.directions[place] = u8::from(step.direction == Direction::Up) << 2;
                stepped += u32::from(step.is_step);
            }
            assert_eq!((edges, steps), (expected, reference), "from {from} to {to}");
            from = if to.abs() > 1 << 20 { 0 } else { to };
            if from == 0 {
                (steps, reference) = (StepBits::new(6, 16, 0).unwrap(), StepBits::new(6, 16, 0).unwrap());
            }
        }
        assert!(stepped > 10_000, "{stepped}");
    }
}

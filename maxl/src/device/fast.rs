//! Stepping at eight times the rate of the beat: 125 kHz where that is 15.625 kHz.
//!
//! - **Walk:** every eighth of a beat, a *slice* → [`FastInterpolator::slice`] → the levels for the next slice. In slice 0 the times are found, in slices
//!   1 to 4 an axis each is played, in 5 and 6 signals and triggers, so that no slice has more than an eighth of a beat's work and its own.
//! - **Invariants:** an axis is exact at beats, by the same evaluator. Within a beat a position is the line between two: exact in eighths of a
//!   LSB, and off the spline by at most A/(8·n²) LSB, with A the greatest second difference and n beats in an interval: 4 LSB at intervals
//!   of 4.096 ms and A = 2^17. What is put out was calculated a beat before, so tracks are played two beats ahead of the calculation.
//! - **Context:** the highest-priority task; a step costs additions and comparisons alone. **Clause:** `[MOT-02]`.

use super::interpolator::{BeatOutput, Interpolator, Times, put_step};
use super::{AXES, INPUTS};
use crate::player::{Output, PlayerState};
use fixed_math::time::{LocalTicks, Span};

/// Slices of a beat, base-two logarithm.
const SLICES_LOG2: u32 = 3;
/// Slices of a beat.
pub const SLICES: u32 = 1 << SLICES_LOG2;
const _: () = assert!(SLICES as usize > AXES + 3 && INPUTS > 0, "a slice for each part of a beat");

/// One axis between two beats.
#[derive(Clone, Copy, Debug, Default)]
struct Line {
    /// Where it was at the beat before.
    from: i32,
    /// Where it is going to be at the next.
    to: i32,
    /// Times 2^[`SLICES_LOG2`], what it has gone since.
    gone: i32,
    /// What it goes in a slice, likewise: all of the way to the next beat.
    slope: i32,
    /// It has a motor, and its position a meaning.
    is_live: bool,
    /// Of the beat that is being calculated.
    next: Output,
}

/// An interpolator that is called in slices.
pub struct FastInterpolator<'a> {
    inner: Interpolator<'a>,
    slice: u32,
    times: Option<Times>,
    lines: [Line; AXES],
    /// What is calculated for the next beat.
    coming: BeatOutput,
    /// What holds for this one.
    held: BeatOutput,
}

impl<'a> FastInterpolator<'a> {
    /// Over an interpolator whose beat is eight slices long.
    #[must_use]
    pub fn new(inner: Interpolator<'a>) -> Self {
        let held = BeatOutput { period_cycles: inner.nominal_cycles, ..BeatOutput::default() };
        Self { inner, slice: 0, times: None, lines: [Line::default(); AXES], coming: held, held }
    }

    /// One slice. `wrap` is asked for when the first slice of a beat began; `sense` reads a channel. Of what comes back, steps and directions are for
    /// the next slice, and the period is that of one slice.
    pub fn slice(&mut self, wrap: impl FnOnce() -> LocalTicks, mut sense: impl FnMut(u8) -> i32) -> BeatOutput {
        match self.slice {
            0 => {
                let lead = Span::from_steps(2 * self.inner.period.steps());
                (self.coming, self.times) = self.inner.begin(wrap(), lead);
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
            7 => self.turn(),
            axis => {
                let index = axis as usize - 1;
                if let (Some(times), Some(line)) = (self.times, self.lines.get_mut(index)) {
                    line.next = self.inner.play(index, times.track, &mut self.coming);
                }
            }
        }
        let mut out = self.held;
        // what the beat's length leaves over an eighth goes to its first slices
        let (each, rest) = (out.period_cycles >> SLICES_LOG2, out.period_cycles & (SLICES - 1));
        out.period_cycles = each + u32::from(self.slice < rest);
        self.slice = (self.slice + 1) & (SLICES - 1);
        for (index, (line, axis)) in self.lines.iter_mut().zip(&mut self.inner.axes).enumerate() {
            if !line.is_live {
                continue;
            }
            line.gone += line.slope;
            if let Some(steps) = axis.steps() {
                put_step(steps.update(line.from + (line.gone >> SLICES_LOG2)), index, &mut out);
            }
        }
        out
    }

    /// The beat is over: what was calculated becomes what is gone to.
    fn turn(&mut self) {
        self.held = self.coming;
        for (line, axis) in self.lines.iter_mut().zip(&mut self.inner.axes) {
            let next = line.next;
            line.is_live = next.state != PlayerState::Idle && self.times.is_some();
            if !line.is_live {
                continue;
            }
            let is_new = axis.begins(&next);
            axis.rebase(&next);
            line.from = if is_new { next.position } else { line.to };
            line.to = next.position;
            // limits keep a beat's way far below this; were it not so, the steps would come late and be told
            line.slope = line.to.saturating_sub(line.from).clamp(-(1 << 27), 1 << 27);
            line.gone = 0;
        }
    }

    /// As [`Interpolator::node`].
    #[must_use]
    pub fn node(&self, index: usize) -> Option<i32> {
        self.inner.node(index)
    }
}

//! Three ways from a path to control points.
//!
//! - **Walk:** [`Path`](super::path::Path), sampled at the points' times → [`Fit::points`] → rounded to LSB → [`Curve`](super::curve::Curve).
//! - **Invariants:** a straight line comes out as itself, whichever way; so does what stands still.
//!
//! | fit | points | the spline |
//! |---|---|---|
//! | sample | P = p | stays in the hull of the path's samples, never accelerates more than the path; cuts bends |
//! | quasi | P = (−p₋ + 8p − p₊)/6 | keeps cubics; overshoots acceleration by up to 1.09 on a step of acceleration |
//! | prefilter | Unser: poles √3−2, both ways | goes through the samples; overshoots by up to 1.18 |
//!
//! ```
//! use osap::motion::fit::Fit;
//! let parabola: Vec<f64> = (0..5).map(|t| f64::from(t * t)).collect();
//! // the spline of samples lies h²·a/6 inside of it, a third here; these points take that back
//! assert!((Fit::Quasi.points(&parabola)[2] - (4.0 - 1.0 / 3.0)).abs() < 1e-15);
//! ```

use serde::Serialize;

/// Where control points are put for samples of a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Fit {
    /// On the path.
    Sample,
    /// Beside it, by what a parabola would be cut.
    Quasi,
    /// Where the spline goes through the samples.
    Prefilter,
}

/// The pole of the cubic spline's inverse filter, √3 − 2.
const POLE: f64 = -0.267_949_192_431_122_7;

/// Samples at either end that a caller adds to those that matter: what is beyond them weighs less than the pole^32 = 5e-19.
pub const MARGIN: usize = 32;

impl Fit {
    /// All, the simplest first.
    pub const ALL: [Self; 3] = [Self::Sample, Self::Quasi, Self::Prefilter];

    /// Its word on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Sample => "sample",
            Self::Quasi => "quasi",
            Self::Prefilter => "prefilter",
        }
    }

    /// A control point for each of `samples`, taken at equal times. Beyond both ends the path is taken to stand still; see [`MARGIN`].
    #[must_use]
    pub fn points(self, samples: &[f64]) -> Vec<f64> {
        match self {
            Self::Sample => samples.to_vec(),
            Self::Quasi => quasi(samples),
            Self::Prefilter => prefilter(samples),
        }
    }
}

fn quasi(samples: &[f64]) -> Vec<f64> {
    let at = |index: usize| samples[index.min(samples.len() - 1)];
    let point = |index: usize| {
        let (before, here, after) = (at(index.saturating_sub(1)), at(index), at(index + 1));
        // about the sample itself, so that a large position costs no digits
        here - ((after - here) - (here - before)) / 6.0
    };
    (0..samples.len()).map(point).collect()
}

/// The inverse of (1, 4, 1)/6 as two first-order filters, one each way in time.
fn prefilter(samples: &[f64]) -> Vec<f64> {
    // What has stood still for ever is s/(1−z) after the first filter, and −z/(1−z) of that after the second.
    let mut state = samples.first().map_or(0.0, |first| first / (1.0 - POLE));
    let mut points: Vec<f64> = samples
        .iter()
        .map(|sample| {
            state = sample + POLE * state;
            state
        })
        .collect();
    let mut state = points.last().map_or(0.0, |last| -POLE / (1.0 - POLE) * last);
    for point in points.iter_mut().rev() {
        state = POLE * (state - *point);
        *point = 6.0 * state;
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_margins(path: impl Fn(f64) -> f64) -> Vec<f64> {
        let count = i32::try_from(2 * MARGIN + 20).unwrap();
        (0..count).map(|index| path(f64::from(index))).collect()
    }

    /// 1e-9 of a unit: what 84 sums and products of numbers below 2^9 lose is some 1e-12.
    const ROUNDING: f64 = 1e-9;

    #[test]
    fn lines_come_out_as_themselves() {
        for fit in Fit::ALL {
            let line = with_margins(|t| 3.0 * t - 100.0);
            for (point, sample) in fit.points(&line).iter().zip(&line).skip(MARGIN).take(20) {
                assert!((point - sample).abs() < ROUNDING, "{fit:?}: {point} for {sample}");
            }
            let still = [7.25; 9];
            for point in fit.points(&still) {
                assert!((point - 7.25).abs() < ROUNDING, "{fit:?}");
            }
        }
    }

    /// By definition: (P₋ + 4P + P₊)/6 is the sample.
    #[test]
    fn a_prefiltered_spline_goes_through_its_samples() {
        let samples = with_margins(|t| if t < 40.0 { 0.0 } else { (t - 40.0).powi(2) });
        let points = Fit::Prefilter.points(&samples);
        for at in MARGIN..MARGIN + 20 {
            let spline = (points[at - 1] + 4.0 * points[at] + points[at + 1]) / 6.0;
            assert!((spline - samples[at]).abs() < ROUNDING, "{at}");
        }
    }

    /// FIGURES: on a step of acceleration 1.09 and 1.18 times. Of points exactly on the step, second differences of the samples are
    /// 0, ½, 1; what the filters make of them is at most 13/12 and 1 + (2−√3)·… as found here by the filters' own step response.
    #[test]
    fn overshoot_of_a_step_of_acceleration() {
        let largest = |fit: Fit| {
            let phases = (0..64).map(|phase| f64::from(phase) / 64.0);
            let of_phase = phases.map(|phase| {
                let samples = with_margins(|t| (t - 40.0 - phase).max(0.0).powi(2) / 2.0);
                let points = fit.points(&samples);
                let bends = points.windows(3).skip(MARGIN - 10).take(30).map(|it| it[2] - 2.0 * it[1] + it[0]);
                bends.fold(0.0, f64::max)
            });
            of_phase.fold(0.0, f64::max)
        };
        assert!((largest(Fit::Sample) - 1.0).abs() < ROUNDING);
        assert!((largest(Fit::Quasi) - 1.09).abs() < 0.01, "{}", largest(Fit::Quasi));
        assert!((largest(Fit::Prefilter) - 1.18).abs() < 0.01, "{}", largest(Fit::Prefilter));
    }
}

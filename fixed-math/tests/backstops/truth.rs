//! What limits mean, in wide integers and by the spline itself.

use fixed_math::limits::{Curve, Limits};

/// A curve as it is meant: a straight line between two corners, not rounded.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Line {
    pub(crate) at_rest: i32,
    pub(crate) at_full: i32,
    pub(crate) knee: i32,
    pub(crate) full: i32,
}

impl Line {
    pub(crate) fn curve(&self) -> Curve {
        if self.at_rest == self.at_full {
            return Curve::flat(self.at_rest);
        }
        Curve::falling(self.at_rest, self.at_full, self.knee, self.full).expect("corners in order")
    }

    /// Whether |value|/of is at most what is allowed at |speed|/of; `of` is positive.
    pub(crate) fn allows(&self, value: i128, speed: i128, of: i128) -> bool {
        let (value, speed) = (value.abs(), speed.abs());
        let [at_rest, at_full, knee, full] = [self.at_rest, self.at_full, self.knee, self.full].map(i128::from);
        if at_rest == at_full || speed <= knee * of {
            return value <= at_rest * of;
        }
        if speed >= full * of {
            return value <= at_full * of;
        }
        // value/of ≤ at_rest − (at_rest − at_full)·(speed/of − knee)/(full − knee)
        value * (full - knee) <= at_rest * of * (full - knee) - (at_rest - at_full) * (speed - knee * of)
    }
}

/// Limits of an axis as they are meant.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Truth {
    pub(crate) min: i32,
    pub(crate) max: i32,
    pub(crate) velocity: i32,
    pub(crate) acceleration: Line,
    pub(crate) jerk: Line,
}

/// Samples of a segment, so that velocity's extremum is never far from one.
const SAMPLES: i128 = 16;

impl Truth {
    pub(crate) fn limits(&self) -> Result<Limits, fixed_math::limits::LimitsError> {
        let (acceleration, jerk) = (self.acceleration.curve(), self.jerk.curve());
        Limits::new((self.min, self.max), self.velocity, acceleration, jerk)
    }

    /// The segment of four points, at its knots and between.
    pub(crate) fn keeps(&self, points: [i32; 4]) -> Result<(), String> {
        let [p0, p1, p2, p3] = points.map(i128::from);
        let range = i128::from(self.min)..=i128::from(self.max);
        if ![p0, p1, p2, p3].iter().all(|point| range.contains(point)) {
            return Err(format!("{points:?} leaves {range:?}"));
        }
        let jerk = p3 - 3 * p2 + 3 * p1 - p0;
        for sample in 0..=SAMPLES {
            // over 2N²: velocity; over N: acceleration
            let (n, t) = (SAMPLES, sample);
            let acceleration = (p0 - 2 * p1 + p2) * n + jerk * t;
            let velocity = (p2 - p0) * n * n + 2 * (p0 - 2 * p1 + p2) * n * t + jerk * t * t;
            let of = 2 * n * n;
            let position = (p0 + 4 * p1 + p2) * n.pow(3)
                + 3 * (p2 - p0) * n * n * t
                + 3 * (p0 - 2 * p1 + p2) * n * t * t
                + jerk * t.pow(3);
            let scale = 6 * n.pow(3);
            if position < scale * range.start() || position > scale * range.end() {
                return Err(format!("{points:?} at {t}/{n}: position {position}/{scale}"));
            }
            if velocity.abs() > i128::from(self.velocity) * of {
                return Err(format!("{points:?} at {t}/{n}: velocity {velocity}/{of}"));
            }
            if !self.acceleration.allows(acceleration * 2 * n, velocity, of) {
                return Err(format!(
                    "{points:?} at {t}/{n}: acceleration {acceleration}/{n} at velocity {velocity}/{of}"
                ));
            }
            if !self.jerk.allows(jerk * of, velocity, of) {
                return Err(format!("{points:?} at {t}/{n}: jerk {jerk} at velocity {velocity}/{of}"));
            }
        }
        Ok(())
    }

    /// A whole series.
    pub(crate) fn keeps_all(&self, points: &[i32]) -> Result<(), String> {
        points.windows(4).try_for_each(|four| self.keeps([four[0], four[1], four[2], four[3]]))
    }
}

/// The three points that a knot stands for, oldest first.
pub(crate) fn points_of(knot: fixed_math::limits::Knot) -> [i32; 3] {
    let before = knot.position - knot.velocity;
    [before - (knot.velocity - knot.acceleration), before, knot.position]
}

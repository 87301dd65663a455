//! Paths as machines run them, made from a seed: what `osap maxl error` is shown and tested on.
//!
//! - **Walk:** [`Shape::rows`] → a file of time series, by the example `paths`.
//! - **Invariants:** the same shape, seed and period give the same file on every machine, to the nm. The square
//!   begins and ends at the speed it takes corners at, and [`Shape::Corner`] at full speed: no machine could run that, it is the one
//!   that the thesis begins with. All others begin and end at rest.
//!
//! Millimetres and seconds. The seed turns a path and shifts it; its speeds and accelerations stay.

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use std::f64::consts::TAU;
use std::fmt::Write as _;

/// Along straight lines and arcs, mm/s².
const ACCELERATION: f64 = 5_000.0;

/// A path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// Once around, radius 20 mm at up to 300 mm/s: 4.5 m/s² towards the centre, 3 m/s² along it at both ends.
    Circle,
    /// 40 mm along each side at up to 200 mm/s and 5 m/s², the corners at 5 mm/s without a stop.
    Square,
    /// One axis to and fro from 2 to 40 Hz within 2 s, at 5 m/s².
    Chirp,
    /// Three turns of 10 mm radius, 2 mm up for each, jerk-limited at both ends.
    Helix,
    /// 90 degrees at 100 mm/s, without slowing down.
    Corner,
}

impl Shape {
    /// All.
    pub const ALL: [Self; 5] = [Self::Circle, Self::Square, Self::Chirp, Self::Helix, Self::Corner];

    /// Its word.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Circle => "circle",
            Self::Square => "square",
            Self::Chirp => "chirp",
            Self::Helix => "helix",
            Self::Corner => "corner",
        }
    }

    /// The file: a head, then a row every `every_us`, positions in mm with nine digits behind the point.
    #[must_use]
    pub fn rows(self, seed: u64, every_us: u32) -> String {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let (turn, shift) = (random.random_range(0.0..TAU), [(); 2].map(|()| random.random_range(50.0..150.0)));
        let (head, duration_s) = self.head_and_duration();
        let place = |at_s: f64| {
            let mut axes = self.at(at_s.min(duration_s));
            if axes.len() > 1 {
                let (x, y) = (axes[0], axes[1]);
                axes[0] = x * turn.cos() - y * turn.sin() + shift[0];
                axes[1] = x * turn.sin() + y * turn.cos() + shift[1];
            }
            axes
        };
        let mut text = format!("{head}\n");
        let every_us = every_us.max(1);
        for row in 0.. {
            let since_us = u64::from(every_us) * row;
            #[expect(clippy::cast_precision_loss, reason = "some seconds of µs")]
            let at_s = since_us as f64 / 1e6;
            // writing to a string cannot fail
            let _ = write!(text, "{since_us}");
            for position in place(at_s) {
                let _ = write!(text, ",{position:.9}");
            }
            text.push('\n');
            if at_s >= duration_s {
                return text;
            }
        }
        text
    }

    fn head_and_duration(self) -> (&'static str, f64) {
        match self {
            Self::Circle => ("time_us,x,y", circle().duration_s()),
            Self::Square => ("time_us,x,y", 4.0 * side().duration_s()),
            Self::Chirp => ("time_us,x", CHIRP_S),
            Self::Helix => ("time_us,x,y,z", HELIX_S),
            Self::Corner => ("time_us,x,y", 0.2),
        }
    }

    /// Not yet turned.
    fn at(self, at_s: f64) -> Vec<f64> {
        match self {
            Self::Circle => {
                let angle = circle().at(at_s) / CIRCLE_MM;
                vec![CIRCLE_MM * angle.cos(), CIRCLE_MM * angle.sin()]
            }
            Self::Square => square(at_s),
            Self::Chirp => vec![chirp(at_s)],
            Self::Helix => {
                let turns = HELIX_TURNS * smooth(at_s / HELIX_S);
                let angle = TAU * turns;
                vec![HELIX_MM * angle.cos(), HELIX_MM * angle.sin(), 2.0 * turns]
            }
            Self::Corner => vec![100.0 * at_s.min(0.1), 100.0 * (at_s - 0.1).max(0.0)],
        }
    }
}

/// Radius, mm.
const CIRCLE_MM: f64 = 20.0;
/// Radius, mm.
const HELIX_MM: f64 = 10.0;
/// Turns.
const HELIX_TURNS: f64 = 3.0;
/// Duration, s.
const HELIX_S: f64 = 1.5;
/// Duration, s.
const CHIRP_S: f64 = 2.0;
/// First and last frequency, Hz.
const CHIRP_HZ: (f64, f64) = (2.0, 40.0);
/// Time to begin and to end in, s.
const CHIRP_EDGE_S: f64 = 0.25;

/// A trapezoid of speed over a length, from and to the same speed.
struct Trapezoid {
    length: f64,
    ends_per_s: f64,
    top_per_s: f64,
    acceleration_per_s2: f64,
}

const fn circle() -> Trapezoid {
    Trapezoid { length: TAU * CIRCLE_MM, ends_per_s: 0.0, top_per_s: 300.0, acceleration_per_s2: 3_000.0 }
}

const fn side() -> Trapezoid {
    Trapezoid { length: 40.0, ends_per_s: 5.0, top_per_s: 200.0, acceleration_per_s2: ACCELERATION }
}

impl Trapezoid {
    /// Time and length of one ramp; all lengths here leave room for two.
    fn ramp(&self) -> (f64, f64) {
        let ramp_s = (self.top_per_s - self.ends_per_s) / self.acceleration_per_s2;
        (ramp_s, f64::midpoint(self.top_per_s, self.ends_per_s) * ramp_s)
    }

    fn duration_s(&self) -> f64 {
        let (ramp_s, ramp) = self.ramp();
        2.0 * ramp_s + (self.length - 2.0 * ramp) / self.top_per_s
    }

    /// Length run at a time.
    fn at(&self, at_s: f64) -> f64 {
        let (ramp_s, ramp) = self.ramp();
        let since_begin = |t: f64| self.ends_per_s * t + self.acceleration_per_s2 * t * t / 2.0;
        let left_s = self.duration_s() - at_s;
        match () {
            () if at_s <= ramp_s => since_begin(at_s.max(0.0)),
            () if left_s <= ramp_s => self.length - since_begin(left_s.max(0.0)),
            () => ramp + self.top_per_s * (at_s - ramp_s),
        }
    }
}

/// Four sides, one after the other. The first begins, and the last ends, with the speed of a corner.
fn square(at_s: f64) -> Vec<f64> {
    let side = side();
    let sides = at_s / side.duration_s();
    let run = |number: f64| side.at(at_s - number * side.duration_s());
    match sides {
        _ if sides < 1.0 => vec![run(0.0), 0.0],
        _ if sides < 2.0 => vec![side.length, run(1.0)],
        _ if sides < 3.0 => vec![side.length - run(2.0), side.length],
        _ => vec![0.0, side.length - run(3.0)],
    }
}

/// A sine whose frequency grows and whose size shrinks with its square, so that the acceleration stays.
fn chirp(at_s: f64) -> f64 {
    let (first, last) = CHIRP_HZ;
    let rate = (last - first) / CHIRP_S;
    let omega = TAU * (first + rate * at_s);
    let phase = TAU * (first * at_s + rate * at_s * at_s / 2.0);
    let edge = smooth(at_s / CHIRP_EDGE_S) * smooth((CHIRP_S - at_s) / CHIRP_EDGE_S);
    edge * ACCELERATION / (omega * omega) * phase.sin()
}

/// 0 to 1 with no velocity and no acceleration at either end.
fn smooth(part: f64) -> f64 {
    let u = part.clamp(0.0, 1.0);
    u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::path::Path;
    use crate::motion::table::Table;

    fn path(shape: Shape, seed: u64) -> Path {
        Path::from_table(&Table::read(shape.rows(seed, 100).as_bytes()).unwrap()).unwrap()
    }

    /// The largest acceleration between rows, away from `corners`, mm/s².
    fn acceleration(path: &Path, corner_per_s: f64) -> f64 {
        let bends = path.bends(false).into_iter().map(|bend| {
            let change = bend.velocity_change_per_s.iter().map(|it| it * it).sum::<f64>().sqrt();
            if change > corner_per_s { 0.0 } else { change / 100e-6 }
        });
        bends.fold(0.0, f64::max)
    }

    /// 0.4 mm/s² is what rounding to a nm (1e-9 mm, 4 halves) makes within 100 µs: 2e-9 / 1e-8.
    #[test]
    fn they_accelerate_as_they_say() {
        let circle = acceleration(&path(Shape::Circle, 1), f64::INFINITY);
        // at most both at once, √(4.5² + 3²) m/s²; a chord over 100 µs takes a little off
        assert!((4_500.0..=5_409.0).contains(&circle), "{circle}");
        // the corners are √2·5 mm/s, all else 5 m/s²: half a mm/s a row
        let square = acceleration(&path(Shape::Square, 1), 2.0);
        assert!((square - 5_000.0).abs() < 1.0, "{square}");
        let chirp = acceleration(&path(Shape::Chirp, 1), f64::INFINITY);
        assert!((4_800.0..5_600.0).contains(&chirp), "{chirp}");
    }

    #[test]
    fn a_seed_turns_and_shifts_and_repeats() {
        for shape in Shape::ALL {
            assert_eq!(shape.rows(3, 1_000), shape.rows(3, 1_000));
            let [first, second] = [path(shape, 1), path(shape, 2)];
            assert!((first.duration_us() - second.duration_us()).abs() < 1e-9);
            assert_eq!(first == second, shape == Shape::Chirp, "{shape:?}");
        }
    }
}

//! The evaluators of splines side by side: errors against the exact value and against double precision, and time a call on this machine.
//!
//! Errors are of two paths. *Full travel* swings over all of 32 bits with random points on it: gain, rounding and range all show. *Near rest*
//! swings slowly within a thousand units of zero, where no gain shows, so that its mean is the bias. Both are compared with the sum of basis functions
//! in 128-bit integers, at random parts of the interval, or at each sample where an evaluator has samples. A knot's jump is the end of one
//! interval against the start of the next.

use super::baseline;
use fixed_math::spline::differences::Differences;
use fixed_math::spline::horner::{Cubic, GUARD_BITS};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use serde_json::{Value, json};
use std::hint::black_box;
use std::time::Instant;

/// Intervals of a path.
const INTERVALS: u32 = 8_192;
/// Instants in an interval, and samples of the differences: 64 µs at 4.096 ms.
const SAMPLES_LOG2: u32 = 6;
const PARTS: i128 = 1 << 16;
const SEED: u64 = 5;
/// One metre in 2^-16 mm.
const METRE: i32 = 1_000 << 16;
/// Segments that a timed loop goes over: they stay in the first-level cache.
const SEGMENTS: u32 = 256;
/// Loops that are timed; told is the median.
const LOOPS: usize = 401;

type Points = [i32; 4];

/// What gives a position at a part, 0 to 65,536, the last being the interval's end.
type Position = fn(Points, u32) -> i32;

/// The evaluators that take any instant.
const EVALUATORS: [(&str, Position); 4] = [
    (BASELINE, baseline::position),
    ("f32 Horner", |points, part| round(f64::from(single(points).position(portion_single(part))))),
    ("f64 Horner", |points, part| round(double(points).position(portion(part)))),
    (HORNER, |points, part| {
        let cubic = cubic(points);
        u16::try_from(part).map_or_else(|_| cubic.end(), |part| cubic.position(part))
    }),
];
const BASELINE: &str = "Q16.16 cut off (baseline)";
const HORNER: &str = "Horner, 32 bits (ours)";
const DIFFERENCES: &str = "forward differences (ours)";

/// Prints the tables, or all of it as JSON.
pub(crate) fn run(is_json: bool) {
    let (accuracy, velocity, speed) = (accuracy(), velocity(), speed());
    if is_json {
        let document = json!({
            "version": 1,
            "report": "motion-error",
            "seed": SEED,
            "accuracy": accuracy.iter().map(Accuracy::json).collect::<Vec<_>>(),
            "velocity_error_lsb_per_interval": { "least": velocity.0, "most": velocity.1 },
            "speed": speed.iter().map(Speed::json).collect::<Vec<_>>(),
        });
        println!("{document:#}");
        return;
    }
    println!(
        "Splines: errors in LSB (2^-16 mm: 15 nm) against the exact value, {INTERVALS} intervals, 2^{SAMPLES_LOG2} instants each, seed {SEED}"
    );
    println!(
        "{:<28}{:>14}{:>16}{:>16}{:>14}{:>14}{:>12}",
        "evaluator", "gain at 1 m", "full travel max", "against f64", "at rest max", "at rest mean", "knot jump"
    );
    accuracy.iter().for_each(Accuracy::print);
    let (least, most) = velocity;
    println!("velocity of Horner (ours): off by {least:.3} to {most:.3} LSB an interval; bound -0.375 to 0.0625");
    println!();
    println!(
        "Time a call on this machine, one thread, median of {LOOPS} loops over {SEGMENTS} segments, coefficients made beforehand but for the baseline"
    );
    println!("{:<40}{:>10}{:>22}", "evaluator", "ns", "against f64 Horner");
    speed.iter().for_each(Speed::print);
}

/// What is found of one evaluator.
struct Accuracy {
    name: &'static str,
    gain_ppm: f64,
    full_travel_max_lsb: f64,
    /// As the row before, against double precision instead of the exact value.
    against_double_max_lsb: f64,
    near_rest_max_lsb: f64,
    near_rest_mean_lsb: f64,
    knot_jump_max_lsb: u32,
}

impl Accuracy {
    fn print(&self) {
        let Self { name, gain_ppm, full_travel_max_lsb: full, against_double_max_lsb: double, .. } = self;
        println!(
            "{name:<28}{:>14}{full:>16.3}{double:>16.3}{:>14.3}{:>14.3}{:>12}",
            format!("{gain_ppm:.1} ppm"),
            self.near_rest_max_lsb,
            self.near_rest_mean_lsb,
            self.knot_jump_max_lsb,
        );
    }

    fn json(&self) -> Value {
        json!({
            "name": self.name,
            "gain_ppm": self.gain_ppm,
            "full_travel_max_lsb": self.full_travel_max_lsb,
            "against_double_max_lsb": self.against_double_max_lsb,
            "near_rest_max_lsb": self.near_rest_max_lsb,
            "near_rest_mean_lsb": self.near_rest_mean_lsb,
            "knot_jump_max_lsb": self.knot_jump_max_lsb,
        })
    }
}

fn accuracy() -> Vec<Accuracy> {
    let (full, rest) = (full_travel(), near_rest());
    let mut rows: Vec<Accuracy> = (EVALUATORS.iter())
        .map(|&(name, position)| {
            let (far, near) = (Errors::at_any(&full, position), Errors::at_any(&rest, position));
            let at_a_metre = f64::from(position([METRE; 4], 12_345)) - f64::from(METRE);
            row(name, at_a_metre, &far, &near, jump(&full, position).max(jump(&rest, position)))
        })
        .collect();
    let at_a_metre = f64::from(differences([METRE; 4]).position()) - f64::from(METRE);
    rows.push(row(
        DIFFERENCES,
        at_a_metre,
        &Errors::at_samples(&full),
        &Errors::at_samples(&rest),
        jump_of_samples(&rest),
    ));
    rows
}

fn row(name: &'static str, at_a_metre: f64, far: &Errors, near: &Errors, knot_jump_max_lsb: u32) -> Accuracy {
    Accuracy {
        name,
        gain_ppm: at_a_metre / f64::from(METRE) * 1e6,
        full_travel_max_lsb: far.most,
        against_double_max_lsb: far.against_double,
        near_rest_max_lsb: near.most,
        near_rest_mean_lsb: near.sum / near.count,
        knot_jump_max_lsb,
    }
}

/// Errors of one path.
#[derive(Default)]
struct Errors {
    most: f64,
    against_double: f64,
    sum: f64,
    count: f64,
}

impl Errors {
    fn at_any(path: &[i32], position: Position) -> Self {
        let mut errors = Self::default();
        let mut random = Pcg32::seed_from_u64(SEED);
        for points in segments(path) {
            for _ in 0..1 << SAMPLES_LOG2 {
                let part = random.random_range(0..1 << 16);
                errors.add(points, part, position(points, part));
            }
        }
        errors
    }

    fn at_samples(path: &[i32]) -> Self {
        let mut errors = Self::default();
        let mut differences = differences([path[0], path[1], path[2], path[3]]);
        for points in segments(path) {
            if differences.left() == 0 {
                differences.knot(points[3]).expect("the paths keep its bound");
            }
            for sample in 1..=1 << SAMPLES_LOG2 {
                differences.advance().expect("no more samples than there are");
                errors.add(points, sample << (16 - SAMPLES_LOG2), differences.position());
            }
        }
        errors
    }

    fn add(&mut self, points: Points, part: u32, position: i32) {
        let scale = 6 * PARTS.pow(3);
        #[expect(clippy::cast_precision_loss, reason = "an error to 53 bits")]
        let off = (i128::from(position) * scale - exact(points, part)) as f64 / scale as f64;
        self.most = self.most.max(off.abs());
        let double = f64::from(position) - double(points).position(portion(part));
        self.against_double = self.against_double.max(double.abs());
        self.sum += off;
        self.count += 1.0;
    }
}

fn jump(path: &[i32], position: Position) -> u32 {
    let ends = segments(path).map(|points| position(points, 1 << 16));
    let starts = segments(path).skip(1).map(|points| position(points, 0));
    ends.zip(starts).map(|(end, start)| end.abs_diff(start)).max().unwrap_or(0)
}

fn jump_of_samples(path: &[i32]) -> u32 {
    let mut played = differences([path[0], path[1], path[2], path[3]]);
    let jumps = segments(path).skip(1).map(|points| {
        played.block::<{ 1 << SAMPLES_LOG2 }>(|_| ()).expect("a whole interval");
        let end = played.position();
        played.knot(points[3]).expect("the paths keep its bound");
        played.position().abs_diff(end)
    });
    jumps.max().unwrap_or(0)
}

/// Least and most that Horner's velocity is off by, in LSB an interval, on the full travel.
fn velocity() -> (f64, f64) {
    let mut random = Pcg32::seed_from_u64(SEED);
    let path = full_travel();
    segments(&path).fold((f64::MAX, f64::MIN), |(least, most), points| {
        let part: u16 = random.random();
        let (_, velocity) = cubic(points).position_velocity(part);
        let off = f64::from(velocity) / f64::from(1 << GUARD_BITS) - double(points).velocity(portion(part.into()));
        (least.min(off), most.max(off))
    })
}

/// 6·2^48 times the position: the sum of the four basis functions.
fn exact(points: Points, part: u32) -> i128 {
    let [p0, p1, p2, p3] = points.map(i128::from);
    let (n, t) = (PARTS, i128::from(part));
    let s = n - t;
    let near = |a: i128| n * n * n + 3 * n * n * a + 3 * n * a * a - 3 * a * a * a;
    p0 * s * s * s + p1 * near(s) + p2 * near(t) + p3 * t * t * t
}

/// Swings over all of 32 bits, with random points on it: neighbours less than 2^25 apart.
fn full_travel() -> Vec<i32> {
    let mut random = Pcg32::seed_from_u64(SEED);
    let noise = 1 << 20;
    let amplitude = f64::from(i32::MAX - noise);
    let swing = (0..INTERVALS).map(|i| round((f64::from(i) / 128.0).sin() * amplitude));
    swing.map(|point| point + random.random_range(-noise..=noise)).collect()
}

/// A slow swing about zero, so few units from it that a gain error does not show.
fn near_rest() -> Vec<i32> {
    (0..INTERVALS).map(|i| round((f64::from(i) / 128.0).sin() * 1_000.0)).collect()
}

fn segments(path: &[i32]) -> impl Iterator<Item = Points> {
    path.windows(4).map(|window| [window[0], window[1], window[2], window[3]])
}

fn cubic(points: Points) -> Cubic {
    Cubic::new(points).expect("the paths keep its bound")
}

fn differences(points: Points) -> Differences {
    Differences::new(points, SAMPLES_LOG2).expect("the paths keep its bound")
}

fn portion(part: u32) -> f64 {
    f64::from(part) / 65_536.0
}

#[expect(clippy::cast_possible_truncation, reason = "17 bits into 24: exact")]
fn portion_single(part: u32) -> f32 {
    portion(part) as f32
}

#[expect(clippy::cast_possible_truncation, reason = "a cast saturates, and positions are in their points' hull")]
fn round(position: f64) -> i32 {
    position.round() as i32
}

/// Coefficients of a cubic in floating point, constant first.
#[derive(Clone, Copy)]
struct Power<F>([F; 4]);

macro_rules! power {
    ($float:ty) => {
        impl Power<$float> {
            fn new([p0, p1, p2, p3]: [$float; 4]) -> Self {
                let sixth = 1.0 / 6.0;
                Self([
                    (p0 + 4.0 * p1 + p2) * sixth,
                    (p2 - p0) * 0.5,
                    (p0 - 2.0 * p1 + p2) * 0.5,
                    (p3 - p0 + 3.0 * (p1 - p2)) * sixth,
                ])
            }

            fn position(&self, u: $float) -> $float {
                let [c0, c1, c2, c3] = self.0;
                ((c3 * u + c2) * u + c1) * u + c0
            }
        }
    };
}

power!(f64);
power!(f32);

impl Power<f64> {
    fn velocity(&self, u: f64) -> f64 {
        let [_, c1, c2, c3] = self.0;
        (3.0 * c3 * u + 2.0 * c2) * u + c1
    }
}

fn double(points: Points) -> Power<f64> {
    Power::<f64>::new(points.map(f64::from))
}

#[expect(clippy::cast_precision_loss, reason = "it is what single precision does")]
fn single(points: Points) -> Power<f32> {
    Power::<f32>::new(points.map(|point| point as f32))
}

/// What one call takes.
struct Speed {
    name: &'static str,
    ns: f64,
    /// ns against those of the row of f64 that does the same.
    ratio: f64,
}

impl Speed {
    fn print(&self) {
        println!("{:<40}{:>10.2}{:>22.2}", self.name, self.ns, self.ratio);
    }

    fn json(&self) -> Value {
        json!({ "name": self.name, "ns": self.ns, "ratio_to_f64_horner": self.ratio })
    }
}

fn speed() -> Vec<Speed> {
    let path = full_travel();
    let points: Vec<Points> = segments(&path).take(SEGMENTS as usize).collect();
    let cubics: Vec<Cubic> = points.iter().map(|&points| cubic(points)).collect();
    let doubles: Vec<Power<f64>> = points.iter().map(|&points| double(points)).collect();
    let singles: Vec<Power<f32>> = points.iter().map(|&points| single(points)).collect();
    let mut played: Vec<Differences> = points.iter().map(|&points| differences(points)).collect();
    let (part, u) = (black_box(0x4321_u16), black_box(portion(0x4321)));
    let p = median(&doubles, |cubic| _ = black_box(cubic.position(u)));
    let pv = median(&doubles, |cubic| _ = black_box((cubic.position(u), cubic.velocity(u))));
    let row = |name, ns: f64, against: f64| Speed { name, ns, ratio: ns / against };
    let u_single = portion_single(part.into());
    vec![
        row("f64 Horner, position", p, p),
        row("f64 Horner, position and velocity", pv, pv),
        row("f32 Horner, position", median(&singles, |cubic| _ = black_box(cubic.position(u_single))), p),
        row(
            "Q16.16 cut off, position",
            median(&points, |&points| _ = black_box(baseline::position(points, part.into()))),
            p,
        ),
        row("Horner (ours), position", median(&cubics, |cubic| _ = black_box(cubic.position(part))), p),
        row(
            "Horner (ours), position and velocity",
            median(&cubics, |cubic| _ = black_box(cubic.position_velocity(part))),
            pv,
        ),
        row("Horner (ours), coefficients", median(&points, |&points| _ = black_box(Cubic::new(points))), p),
        row("differences (ours), a sample of 16", in_blocks(&mut played), p),
    ]
}

/// Median ns of `call`, each taken over all of `items`; `call` keeps its result from being left out.
fn median<T>(items: &[T], mut call: impl FnMut(&T)) -> f64 {
    let mut loops: Vec<f64> = (0..LOOPS)
        .map(|_| {
            let started = Instant::now();
            black_box(items).iter().for_each(&mut call);
            started.elapsed().as_secs_f64() * 1e9 / f64::from(SEGMENTS)
        })
        .collect();
    loops.sort_by(f64::total_cmp);
    loops[LOOPS / 2]
}

/// Median ns of a sample, 16 at a time, always from the interval's start.
fn in_blocks(played: &mut [Differences]) -> f64 {
    let starts = played.to_vec();
    let mut loops: Vec<f64> = (0..LOOPS)
        .map(|_| {
            played.copy_from_slice(&starts);
            let started = Instant::now();
            for differences in black_box(&mut *played) {
                differences.block::<16>(|scaled| _ = black_box(scaled)).expect("at the interval's start");
            }
            started.elapsed().as_secs_f64() * 1e9 / f64::from(16 * SEGMENTS)
        })
        .collect();
    loops.sort_by(f64::total_cmp);
    loops[LOOPS / 2]
}

//! The functions of a beat, each for one axis after the other: what is measured where cycles are told.
//!
//! - **Walk:** an image → [`run`] with its own way to mark → an edge before and behind each of [`BLOCKS`] → cycles. For processors that
//!   nothing here emulates to the cycle these functions' machine code is put through a model of them.
//! - **Invariants:** all is in memory, as between beats: states, inputs and results are loaded and stored for each axis, and where an axis is
//!   comes from memory too. A function that does only that, of the same input and result, is a block too, and is taken off.
//! - **Context:** start-up of an image that was built for this, with the feature `kernels`; no image has it otherwise.

#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "inputs are made of small numbers, and results are not of interest"
)]

use crate::limits::{Curve, Knot, Limits};
use crate::phase::{Coils, Phase};
use crate::servo::{Gain, Gains, Scales, Servo, ServoTraits, SetPoint};
use crate::spline::differences::Differences;
use crate::spline::horner::Cubic;
use crate::steps::{Direction, Step, StepBits, StepThresholds};
use crate::time::Span;
use crate::warp::Warp;
use core::hint::black_box;

/// Evaluations of each function, one after the other: of as many axes.
pub const AXES: usize = 8;
/// Samples of a block of forward differences.
const SAMPLES: usize = 16;
/// Samples an interval of theirs, base-two logarithm.
const SAMPLES_LOG2: u32 = 5;
/// A step, LSB, base-two logarithm.
const STEP_LOG2: u32 = 6;

/// A function that is marked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block {
    /// Its function's name.
    pub name: &'static str,
    /// Evaluations between its two marks.
    pub evaluations: u32,
    /// The block that is taken off: it loads and stores the same. `None` where it is such a block itself.
    pub empty: Option<&'static str>,
}

/// All of one axis, as a device keeps it. In this order, so that a processor whose loads reach 124 bytes reaches all results.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Axis<State, Input, Out> {
    /// What came of it.
    pub result: Out,
    /// What it is given.
    pub input: Input,
    /// What it remembers.
    pub state: State,
}

macro_rules! kernels {
    ($($(#[$doc:meta])* $name:ident($axis:ident: $Axis:ty) { $($body:tt)* })*) => {$(
        $(#[$doc])*
        #[inline(never)]
        pub fn $name([a, b, c, d, e, f, g, h]: &mut [$Axis; AXES]) {
            #[inline(always)]
            fn one($axis: &mut $Axis) {
                let $axis = black_box($axis);
                $($body)*
            }
            one(a);
            one(b);
            one(c);
            one(d);
            one(e);
            one(f);
            one(g);
            one(h);
        }
    )*};
}

kernels! {
    /// A part to a word.
    empty_part(axis: Axis<(), u16, i32>) { axis.result = i32::from(axis.input); }
    /// A part to two words.
    empty_part_pair(axis: Axis<(), u16, [i32; 2]>) { axis.result = [i32::from(axis.input); 2]; }
    /// A word to a word.
    empty_word(axis: Axis<(), i32, i32>) { axis.result = axis.input; }
    /// Two words to a word.
    empty_long(axis: Axis<(), i64, i32>) { axis.result = (axis.input >> 32) as i32 ^ axis.input as i32; }
    /// Nothing to nothing.
    empty(_axis: Axis<(), (), ()>) { }
    /// Position by Horner's rule.
    horner_position(axis: Axis<Cubic, u16, i32>) { axis.result = axis.state.position(axis.input); }
    /// Position and velocity by Horner's rule.
    horner_position_velocity(axis: Axis<Cubic, u16, [i32; 2]>) {
        let (position, velocity) = axis.state.position_velocity(axis.input);
        axis.result = [position, velocity];
    }
    /// Sixteen samples by forward differences, each stored in two words.
    differences_block(axis: Axis<Differences, (), [i64; SAMPLES]>) {
        let mut at = 0;
        let _enough_left = axis.state.block::<{ SAMPLES as u32 }>(|sample| {
            axis.result[at % SAMPLES] = sample;
            at += 1;
        });
    }
    /// One sample by forward differences, stored in two words.
    differences_advance(axis: Axis<Differences, (), i64>) {
        let _enough_left = axis.state.advance();
        axis.result = axis.state.scaled();
    }
    /// Steps from bits.
    step_bits(axis: Axis<StepBits, i32, i32>) { axis.result = levels(axis.state.update(axis.input)); }
    /// Steps by thresholds.
    step_thresholds(axis: Axis<StepThresholds, i64, i32>) { axis.result = levels(axis.state.update(axis.input)); }
    /// Currents of two coils.
    coils(axis: Axis<u16, u16, Coils>) { axis.result = Coils::at(Phase::new(u32::from(axis.input)), axis.state); }
    /// A servo's torque.
    servo(axis: Axis<(Servo, Gains, SetPoint), i32, i32>) {
        let (servo, gains, set) = &mut axis.state;
        axis.result = servo.update(set, axis.input, gains, 0).torque;
    }
    /// Time while a stop is under way.
    warp_stopped(axis: Axis<Warp, i64, i32>) {
        axis.result = axis.state.stopped(Span::from_steps(axis.input.cast_unsigned())).steps() as i32;
    }
    /// An interval's polynomial from four points.
    cubic_new(axis: Axis<[i32; 4], (), Option<Cubic>>) { axis.result = Cubic::new(axis.state).ok(); }
    /// A point against its limits.
    limits_check(axis: Axis<(Limits, Knot), i32, i32>) {
        let (limits, last) = &axis.state;
        axis.result = i32::from(limits.check(*last, axis.input).is_ok());
    }
}

/// Both pins in a word, as a board's table takes it.
fn levels(step: Step) -> i32 {
    i32::from(step.is_step) | i32::from(step.direction == Direction::Up) << 1
}

/// `AXES` evaluations of `name` less `empty`.
const fn block(name: &'static str, empty: &'static str) -> Block {
    Block { name, evaluations: AXES as u32, empty: Some(empty) }
}

/// One that is taken off.
const fn nothing(name: &'static str) -> Block {
    Block { name, evaluations: AXES as u32, empty: None }
}

/// What [`run`] marks, in its order.
pub const BLOCKS: [Block; 19] = [
    nothing("empty_part"),
    nothing("empty_part_pair"),
    nothing("empty_word"),
    nothing("empty_long"),
    nothing("empty"),
    block("horner_position", "empty_part"),
    block("horner_position_velocity", "empty_part_pair"),
    Block { evaluations: (AXES * SAMPLES) as u32, ..block("differences_block", "empty") },
    block("differences_advance", "empty"),
    block("step_bits", "empty_word"),
    block("step_bits due", "empty_word"),
    block("step_thresholds", "empty_long"),
    block("step_thresholds due", "empty_long"),
    block("coils", "empty_part"),
    block("servo", "empty_word"),
    block("warp_stopped", "empty_long"),
    block("cubic_new", "empty"),
    block("limits_check", "empty_word"),
    block("limits_check, simulated stop", "empty_word"),
];

/// Runs all blocks. `mark` is called with `true` before each and with `false` behind it.
pub fn run(mark: &mut impl FnMut(bool)) {
    empties(mark);
    splines(mark);
    steps(mark);
    outputs(mark);
    points(mark);
}

/// So many axes; `each` says of an axis what it remembers and what it is given, which is in range.
fn axes<State, Input, Out: Default>(each: impl Fn(i32) -> Option<(State, Input)>) -> [Axis<State, Input, Out>; AXES] {
    core::array::from_fn(|axis| match each(axis as i32) {
        Some((state, input)) => Axis { state, input, result: Out::default() },
        None => unreachable!("figures in this file are in range"),
    })
}

/// Marks a function of such axes.
#[inline(never)]
fn measure<State, Input, Out: Default>(
    mark: &mut impl FnMut(bool),
    kernel: fn(&mut [Axis<State, Input, Out>; AXES]),
    each: impl Fn(i32) -> Option<(State, Input)>,
) {
    let mut axes = axes(each);
    mark(true);
    kernel(black_box(&mut axes));
    mark(false);
    black_box(&axes);
}

/// Part of an interval.
fn part(axis: i32) -> u16 {
    (axis * 7_919 + 401) as u16
}

/// Control points of an axis that turns round in between.
fn control_points(axis: i32) -> [i32; 4] {
    let bend = 3_001 * (axis + 1);
    [-70_000 - axis, -20_000 * axis, 60_011 - bend, 90_000 - 3 * bend]
}

fn empties(mark: &mut impl FnMut(bool)) {
    measure(mark, empty_part, |axis| Some(((), part(axis))));
    measure(mark, empty_part_pair, |axis| Some(((), part(axis))));
    measure(mark, empty_word, |axis| Some(((), axis)));
    measure(mark, empty_long, |axis| Some(((), i64::from(axis))));
    measure(mark, empty, |_| Some(((), ())));
}

fn splines(mark: &mut impl FnMut(bool)) {
    let cubic = |axis| Some((Cubic::new(control_points(axis)).ok()?, part(axis)));
    measure(mark, horner_position, cubic);
    measure(mark, horner_position_velocity, cubic);
    let differences = |axis| Differences::new(control_points(axis), SAMPLES_LOG2).ok();
    measure(mark, differences_block, |axis| Some((differences(axis)?, ())));
    measure(mark, differences_advance, |axis| Some((differences(axis)?, ())));
}

fn steps(mark: &mut impl FnMut(bool)) {
    let step = 1 << STEP_LOG2;
    let bits = |axis| StepBits::new(STEP_LOG2, StepBits::quarter(STEP_LOG2), axis * 1_000).ok();
    measure(mark, step_bits, |axis| Some((bits(axis)?, axis * 1_000)));
    measure(mark, step_bits, |axis| Some((bits(axis)?, axis * 1_000 + step)));
    let scale = crate::spline::differences::scale(SAMPLES_LOG2);
    let thresholds = |axis| StepThresholds::new(STEP_LOG2, 0, axis, 0, scale).ok();
    measure(mark, step_thresholds, |axis| Some((thresholds(axis)?, i64::from(axis * step + 3) * scale)));
    measure(mark, step_thresholds, |axis| Some((thresholds(axis)?, i64::from((axis + 1) * step + 3) * scale)));
}

fn outputs(mark: &mut impl FnMut(bool)) {
    measure(mark, coils, |axis| Some((45_875 - axis as u16, part(axis))));
    measure(mark, servo, |axis| {
        let scales = Scales::default();
        let traits = ServoTraits { scales, filter_log2: 2, torque_limit: 32_000, integral_limit: 8_000 };
        let gain = |more| Gain::saturated((3 << 16) + axis * more);
        let gains = Gains {
            proportional: gain(1),
            integral: gain(-1),
            derivative: gain(7),
            velocity: gain(2),
            acceleration: gain(3),
        };
        let set = SetPoint { position: 1_000 * axis, velocity: 300 + axis, acceleration: 40 - axis };
        Some(((Servo::new(traits, 1_000 * axis).ok()?, gains, set), 1_000 * axis - 37))
    });
    measure(mark, warp_stopped, |axis| Some((Warp::new(16)?, i64::from(axis + 1) * 5_000_000)));
}

fn points(mark: &mut impl FnMut(bool)) {
    measure(mark, cubic_new, |axis| Some((control_points(axis), ())));
    // in the middle of its way, and so near its end that the stop that would follow is simulated
    for max in [1 << 30, 1_900_000] {
        measure(mark, limits_check, |axis| {
            let limits = Limits::new((-1 << 30, max), 200_000, Curve::flat(20_000), Curve::flat(2_000)).ok()?;
            let knot = Knot { position: 5_000 * axis, velocity: 60_000, acceleration: 1_000 };
            Some(((limits, knot), 5_000 * axis + 60_000 + 1_000 + 500))
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every block is marked once, and a block that is taken off is there before it is needed.
    #[test]
    fn blocks_are_marked_in_their_order() {
        let (mut began, mut ended) = (0, 0);
        run(&mut |is_begun| {
            assert_eq!(is_begun, began == ended);
            if is_begun { began += 1 } else { ended += 1 }
        });
        assert_eq!((began, ended), (BLOCKS.len(), BLOCKS.len()));
        for (index, block) in BLOCKS.iter().enumerate() {
            let is_empty = |other: &Block| Some(other.name) == block.empty && other.empty.is_none();
            assert!(block.empty.is_none() || BLOCKS[..index].iter().any(is_empty), "{}", block.name);
        }
    }

    /// Loops do what their names say: those of steps give steps where they are due and none elsewhere, no check of a point fails.
    #[test]
    fn loops_measure_what_they_say() {
        let steps = StepBits::new(STEP_LOG2, 16, 0).unwrap();
        let mut stepped = [0, 63, 64, 65, -16, -17, 127, 128].map(|input| Axis { state: steps, input, result: 0 });
        step_bits(&mut stepped);
        assert_eq!(stepped.map(|axis| axis.result), [2, 2, 3, 3, 2, 0, 3, 3]);
        let mut made =
            [0, 1, 2, 3, 4, 5, 6, 7].map(|axis| Axis { state: control_points(axis), input: (), result: None });
        cubic_new(&mut made);
        assert_eq!(made[3].result, Cubic::new(control_points(3)).ok());
        let begun = |axis| Differences::new(control_points(axis), SAMPLES_LOG2).unwrap();
        let mut blocks =
            [0, 1, 2, 3, 4, 5, 6, 7].map(|axis| Axis { state: begun(axis), input: (), result: [0; SAMPLES] });
        differences_block(&mut blocks);
        let mut reference = begun(3);
        for sample in blocks[3].result {
            reference.advance().unwrap();
            assert_eq!(sample, reference.scaled());
        }
        let limits = Limits::new((-1 << 30, 1_900_000), 200_000, Curve::flat(20_000), Curve::flat(2_000)).unwrap();
        let knot = Knot { position: 0, velocity: 60_000, acceleration: 1_000 };
        let mut checked = [61_500, 64_500, 63_000, 0, 61_000, 62_000, 59_000, 1].map(|input| Axis {
            state: (limits, knot),
            input,
            result: -1,
        });
        limits_check(&mut checked);
        assert_eq!(checked.map(|axis| axis.result), [1, 0, 1, 0, 1, 1, 1, 0]);
    }
}

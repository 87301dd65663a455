//! A load of interpolation's kind and size, in its place until there is motion: [`AXES`] cubic B-splines evaluated at every beat.
//!
//! What is real of it: the rate, the priority, the arithmetic (32-bit coefficients, products of 64 bits, one division by six as a product)
//! and the reading of the time at its beginning. What is not: the control points, which are a triangle that each axis makes for itself, and
//! the outputs, which go to memory where nobody reads them. It moves nothing.
//!
//! - **Walk:** `PWM_IRQ_WRAP` → [`Interpolation::beat`] → [`POSITIONS`].
//! - **Invariants:** no lock and nothing shared by one; what others may see is atomic. Every beat does the same work but the one in
//!   [`BEATS_A_SEGMENT`] that begins a segment, which makes coefficients too.
//! - **Context:** the interrupt `PWM_IRQ_WRAP`, at the highest priority.

#![expect(clippy::cast_possible_truncation, reason = "of points within the range all sums fit")]

use board_rp2040_pico::clock::{self, Stamp};
use board_rp2040_pico::pace::Pace;
use core::sync::atomic::{AtomicI32, AtomicU32, Ordering};

/// From one beat to the next, µs.
const PERIOD_US: u32 = 64;
/// As many as make a beat of 600 to 1,000 cycles: an evaluation has four products of 64 bits, of some 80 cycles each on a Cortex-M0+.
const AXES: usize = 2;
/// Control points are 2^12 µs apart.
const INTERVAL_LOG2: u32 = 12;
const BEATS_A_SEGMENT: u32 = (1 << INTERVAL_LOG2) / PERIOD_US;
/// Where the triangle turns.
const RANGE: i32 = 1 << 20;
/// 2^32 / 6, rounded up: what a division by six is multiplied by.
const SIXTH: i64 = (1_i64 << 32) / 6 + 1;

/// Positions of all axes at the last beat. Nobody in the image reads these three: what a debugger sees of the beat.
#[used]
static POSITIONS: [AtomicI32; AXES] = [const { AtomicI32::new(0) }; AXES];
/// The low word of the timer at the last beat's beginning, µs.
#[used]
static LATCHED_US: AtomicU32 = AtomicU32::new(0);
/// Beats since start-up.
#[used]
static BEATS: AtomicU32 = AtomicU32::new(0);

/// One axis: its control points and the polynomial between the middle ones.
#[derive(Clone, Copy)]
struct Axis {
    points: [i32; 4],
    /// Of 6·P in powers of the part of the interval that has passed.
    coefficients: [i32; 4],
    step: i32,
}

impl Axis {
    const fn new(step: i32) -> Self {
        Self { points: [0; 4], coefficients: [0; 4], step }
    }

    /// Takes the next control point, and the coefficients of the segment that it ends.
    fn advance(&mut self) {
        let [_, p0, p1, p2] = self.points;
        if p2.abs() >= RANGE && (p2 > 0) == (self.step > 0) {
            self.step = -self.step;
        }
        let p3 = p2 + self.step;
        self.points = [p0, p1, p2, p3];
        self.coefficients = [p0 + 4 * p1 + p2, 3 * (p2 - p0), 3 * (p0 - 2 * p1 + p2), p3 - p0 + 3 * (p1 - p2)];
    }

    /// The position at `t_us` after the segment's beginning.
    fn position(&self, t_us: u32) -> i32 {
        let [c0, c1, c2, c3] = self.coefficients;
        let t = i64::from(t_us);
        let horner = |sum: i32, coefficient: i32| ((i64::from(sum) * t) >> INTERVAL_LOG2) as i32 + coefficient;
        let sixfold = horner(horner(horner(c3, c2), c1), c0);
        ((i64::from(sixfold) * SIXTH) >> 32) as i32
    }
}

/// What the task has to itself.
pub struct Interpolation {
    pace: Pace,
    axes: [Axis; AXES],
    beat: u32,
}

impl Interpolation {
    /// All axes at rest at zero, the beat running.
    pub fn start(mut pace: Pace) -> Self {
        pace.start(PERIOD_US);
        Self { pace, axes: [Axis::new(500), Axis::new(-1_700)], beat: 0 }
    }

    /// One beat.
    pub fn beat(&mut self) {
        let Stamp { us, .. } = clock::stamp();
        self.pace.clear();
        LATCHED_US.store(us, Ordering::Relaxed);
        let begins = self.beat == 0;
        let t_us = self.beat * PERIOD_US;
        for (axis, position) in self.axes.iter_mut().zip(&POSITIONS) {
            if begins {
                axis.advance();
            }
            position.store(axis.position(t_us), Ordering::Relaxed);
        }
        self.beat = if self.beat + 1 == BEATS_A_SEGMENT { 0 } else { self.beat + 1 };
        BEATS.store(BEATS.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
    }
}

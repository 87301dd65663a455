//! Phase stepping: a position's bits are an electrical angle, and a sine table makes two coil currents of it.
//!
//! - **Walk:** a position at a beat → [`PhaseWindow::phase`] → [`Coils::at`] → two pairs of PWM levels.
//! - **Invariants:** the angle follows from the position by two shifts, so nothing accumulates and positions that wrap do no harm. Sines
//!   are within 1.01 of 32767 times the exact ones.
//! - **Context:** a beat; in line about 8 cycles of a Cortex-M0+ for the angle and 75 for both currents.
//!
//! **The table** holds a quarter of a wave: 1025 values of 16 bits and a spare one for the 4096 phases of a quarter, with a straight line over each four.
//! A chord of a 4096th of a turn leaves the sine by `(2π/4096)²/8`, 0.0097 of 32767, far less than the rounding of the table, so a table of
//! all 4097 phases would gain half of one in 32767 for 6 kB more. It should lie in RAM, as what runs in a beat does on an RP2040, and
//! 2052 bytes are 0.8 % of what that has.

use core::fmt;

/// Base-two logarithm of the phases of an electrical turn.
pub const PHASE_LOG2: u32 = 14;
/// Phases of an electrical turn: four full steps of a two-phase motor.
pub const PHASES: u32 = 1 << PHASE_LOG2;
/// The sine of a quarter turn.
pub const SINE_ONE: i32 = 32_767;

/// Phases between two values of the table.
const STRIDE_LOG2: u32 = 2;
/// Phases of a quarter of a turn.
const QUARTER_TURN: u32 = PHASES / 4;
/// Lines of the table.
const LINES: usize = (QUARTER_TURN >> STRIDE_LOG2) as usize;
/// Its values: a quarter, its end, and one that is read and taken no part of there.
const TABLE_LEN: usize = LINES + 2;

static QUARTER: [i16; TABLE_LEN] = quarter();

/// π/2 in 2^−60.
const HALF_PI_Q60: i128 = 1_811_004_864_519_280_711;

/// sin of `index` in [`LINES`] parts of a quarter, of 32767, to the nearest.
const fn sine_of(index: usize) -> i16 {
    let x = HALF_PI_Q60 * index as i128 / LINES as i128;
    let x2 = (x * x) >> 60;
    // x − x³/3! + x⁵/5! …: the 25th power over 25! is below 2^−60 where x ≤ π/2
    let (mut term, mut sum, mut power) = (x, x, 1);
    while power < 25 {
        term = -((term * x2) >> 60) / ((power + 1) * (power + 2));
        sum += term;
        power += 2;
    }
    #[expect(clippy::cast_possible_truncation, reason = "at most 32767, as the first test shows")]
    let rounded = ((sum * SINE_ONE as i128 + (1 << 59)) >> 60) as i16;
    rounded
}

const fn quarter() -> [i16; TABLE_LEN] {
    let mut table = [0; TABLE_LEN];
    let mut index = 0;
    while index < TABLE_LEN {
        table[index] = sine_of(index);
        index += 1;
    }
    table
}

/// An electrical angle in 2^−14 turns; always below [`PHASES`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Phase(u16);

impl Phase {
    /// `phase` less whole turns.
    #[must_use]
    pub const fn new(phase: u32) -> Self {
        Self((phase & (PHASES - 1)) as u16)
    }

    /// In 2^−14 turns.
    #[must_use]
    #[inline]
    pub const fn get(self) -> u32 {
        self.0 as u32
    }

    /// The angle `by` further on.
    #[must_use]
    #[inline]
    pub const fn plus(self, by: Self) -> Self {
        Self::new(self.get() + by.get())
    }

    /// A quarter of a turn on: where a current pulls hardest at a rotor that stands here.
    #[must_use]
    #[inline]
    pub const fn quarter_ahead(self) -> Self {
        self.plus(Self::new(QUARTER_TURN))
    }

    /// Cosine and sine, −32767 to 32767.
    #[must_use]
    #[inline]
    pub fn cosine_sine(self) -> (i32, i32) {
        let phase = self.get();
        let within = phase & (QUARTER_TURN - 1);
        let (rising, falling) = (first_quarter(within), first_quarter(QUARTER_TURN - within));
        // a quarter further the sine is what the cosine was, and the cosine the sine's negative
        let (cosine, sine) = if phase & QUARTER_TURN == 0 { (falling, rising) } else { (-rising, falling) };
        if phase & (2 * QUARTER_TURN) == 0 { (cosine, sine) } else { (-cosine, -sine) }
    }
}

/// The sine of up to a quarter of a turn, `within` ≤ 4096.
#[inline]
fn first_quarter(within: u32) -> i32 {
    let (index, part) = ((within >> STRIDE_LOG2) as usize, within & ((1 << STRIDE_LOG2) - 1));
    let (low, high) = (i32::from(QUARTER[index]), i32::from(QUARTER[index + 1]));
    low + (((high - low) * part.cast_signed() + (1 << (STRIDE_LOG2 - 1))) >> STRIDE_LOG2)
}

/// Why a window was not set up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PhaseError {
    /// An electrical turn has 2^2 to 2^32 LSB.
    TurnLog2 {
        /// What was asked for.
        turn_log2: u32,
    },
}

impl fmt::Display for PhaseError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TurnLog2 { turn_log2 } => {
                write!(f, "an electrical turn of 2^{turn_log2} LSB: use 2^2 to 2^32")
            }
        }
    }
}

impl core::error::Error for PhaseError {}

/// Which bits of a position are the electrical angle.
///
/// ```
/// use fixed_math::phase::{Coils, PhaseWindow};
///
/// // 1/256 microstep of 256 a full step: four full steps a turn are 2^18 LSB
/// let window = PhaseWindow::new(18, 0).unwrap();
/// assert_eq!(window.phase(1 << 16).get(), 4096); // a full step is a quarter turn
/// assert_eq!(window.phase(-1).get(), 16_383);
/// assert_eq!(Coils::at(window.phase(0), 65_535), Coils { a: 32_767, b: 0 });
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PhaseWindow {
    /// bits above the turn
    left: u32,
    /// added to the angle, in 2^−32 turns
    offset: u32,
}

impl PhaseWindow {
    /// An electrical turn of `2^turn_log2` LSB; at position 0 the angle is `offset` in 2^−32 turns, to align a rotor.
    ///
    /// # Errors
    ///
    /// [`PhaseError::TurnLog2`].
    pub const fn new(turn_log2: u32, offset: u32) -> Result<Self, PhaseError> {
        if turn_log2 < 2 || turn_log2 > 32 {
            return Err(PhaseError::TurnLog2 { turn_log2 });
        }
        Ok(Self { left: 32 - turn_log2, offset })
    }

    /// The offset that makes the angle at `position` be `phase`: alignment to a rotor that was pulled there.
    #[must_use]
    pub const fn aligned(self, position: i32, phase: Phase) -> Self {
        let offset = (phase.get() << (32 - PHASE_LOG2)).wrapping_sub(position.cast_unsigned() << self.left);
        Self { left: self.left, offset }
    }

    /// The angle at `position`.
    #[must_use]
    #[inline]
    pub const fn phase(&self, position: i32) -> Phase {
        Phase::new((position.cast_unsigned() << self.left).wrapping_add(self.offset) >> (32 - PHASE_LOG2))
    }
}

/// The currents of a two-phase motor, in 2^−15 of full scale.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Coils {
    /// Cosine of the angle, times the amplitude.
    pub a: i16,
    /// Sine, likewise.
    pub b: i16,
}

impl Coils {
    /// Currents that turn the field to `phase`, with `amplitude` in 2^−16 of full scale. Any amplitude fits.
    #[must_use]
    #[inline]
    pub fn at(phase: Phase, amplitude: u16) -> Self {
        let (cosine, sine) = phase.cosine_sine();
        Self { a: scaled(cosine, amplitude), b: scaled(sine, amplitude) }
    }

    /// Currents that turn a rotor that stands at `phase` with `torque`, −32768 to 32767 in 2^−15 of full scale, beyond that cut.
    #[must_use]
    #[inline]
    pub fn for_torque(phase: Phase, torque: i32) -> Self {
        let torque = torque.clamp(-SINE_ONE, SINE_ONE);
        #[expect(clippy::cast_possible_truncation, reason = "twice 15 bits")]
        let amplitude = (torque.unsigned_abs() << 1) as u16;
        let ahead = phase.quarter_ahead();
        Self::at(if torque < 0 { ahead.plus(Phase::new(PHASES / 2)) } else { ahead }, amplitude)
    }
}

/// To the nearest; 15 bits by 16, so it fits.
#[inline]
fn scaled(sine: i32, amplitude: u16) -> i16 {
    ((sine * i32::from(amplitude) + (1 << 15)) >> 16) as i16
}

//! Step and direction from a position: from its bits, or by thresholds on one that forward differences made.
//!
//! - **Walk:** a position at a beat → [`StepBits::update`] or [`StepThresholds::update`] → a [`Step`] → two pins.
//! - **Invariants:** no step is lost: what one beat cannot put out is put out by those after it, one each, and told. A position that
//!   rests at an edge does not chatter. The direction is set a whole beat before the first step that goes that way.
//! - **Context:** a beat; compares, shifts and sums. In line on a Cortex-M0+ about 20 cycles where no step is due and 60 where one is, by
//!   thresholds 25 and 80.
//!
//! **Where the steps are:** step k lies at `k · 2^s` LSB. Going up it is put out at `position ≥ k·2^s`; going down it is taken back at
//! `position < k·2^s − hysteresis`, where the hysteresis is less than a step. So between a step and its reversal lies a travel of
//! more than the hysteresis, and where the motor stands depends on the position by no more than that.
//!
//! Positions are counted on a circle of 2^32 LSB: one that wraps steps on, and a motor that is half of that behind goes the shorter way.
//!
//! **Direction set-up:** a beat in which the first step of the other direction is due changes the direction alone. The step is then
//! still due in the next beat and put out there, so the set-up time is one period of the beat.

use core::fmt;

/// Fewest bits of a step.
pub const STEP_LOG2_MIN: u32 = 1;
/// Most bits of a step.
pub const STEP_LOG2_MAX: u32 = 30;

/// Farthest threshold from the base of a scaled position; the position itself is no farther.
const REACH: u64 = 1 << 62;

/// Which way a motor goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Direction {
    /// Towards larger positions.
    #[default]
    Up,
    /// Towards smaller ones.
    Down,
}

/// What to put out in a beat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// Whether a step pulse is given.
    pub is_step: bool,
    /// Level of the direction line, from this beat on.
    pub direction: Direction,
    /// More was due than the one step of a beat: the motor is behind its track. Steps follow one a beat.
    pub is_behind: bool,
}

/// Why steps were not set up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepsError {
    /// A step has 2^1 to 2^30 LSB.
    StepLog2 {
        /// What was asked for.
        step_log2: u32,
    },
    /// The hysteresis is not below a step.
    Hysteresis {
        /// What was asked for, LSB.
        hysteresis: u32,
        /// A step, LSB.
        step: u32,
    },
    /// A scale below 1, or one by which a step leaves 61 bits.
    Scale {
        /// What was asked for: units of a scaled position an LSB.
        scale: i64,
        /// A step, LSB.
        step: u32,
    },
    /// A motor farther from the base than 2^62 units of the scale.
    TooFar {
        /// Where it stands, steps.
        at: i32,
        /// The base, LSB.
        base: i32,
    },
}

impl fmt::Display for StepsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::StepLog2 { step_log2 } => {
                write!(f, "a step of 2^{step_log2} LSB: use 2^{STEP_LOG2_MIN} to 2^{STEP_LOG2_MAX}")
            }
            Self::Hysteresis { hysteresis, step } => {
                write!(f, "a hysteresis of {hysteresis} LSB is no less than a step of {step}: use less")
            }
            Self::TooFar { at, base } => {
                write!(
                    f,
                    "a motor at step {at} is out of reach of a track at {base} LSB: stop it and begin where it stands"
                )
            }
            Self::Scale { scale, step } => {
                write!(
                    f,
                    "a step of {step} LSB at {scale} units an LSB: use a scale of 1 or more at which a step has 61 bits"
                )
            }
        }
    }
}

impl core::error::Error for StepsError {}

/// Checks both and gives the step in LSB.
fn check(step_log2: u32, hysteresis: u32) -> Result<u32, StepsError> {
    if !(STEP_LOG2_MIN..=STEP_LOG2_MAX).contains(&step_log2) {
        return Err(StepsError::StepLog2 { step_log2 });
    }
    let step = 1 << step_log2;
    if hysteresis < step { Ok(step) } else { Err(StepsError::Hysteresis { hysteresis, step }) }
}

/// Steps from the upper bits of a position.
///
/// ```
/// use fixed_math::steps::{Direction, StepBits};
///
/// // a step of 256 LSB, a quarter of it as hysteresis, the motor where the position is
/// let mut steps = StepBits::new(8, 64, 0).unwrap();
/// assert!(!steps.update(255).is_step);
/// assert!(steps.update(256).is_step);
/// assert!(!steps.update(192).is_step); // 256 − 64 is still held
/// let turn = steps.update(191); // one below: the direction first,
/// assert_eq!((turn.is_step, turn.direction), (false, Direction::Down));
/// assert!(steps.update(191).is_step); // the step a beat later
/// assert_eq!(steps.at(), 0);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepBits {
    /// the lowest position that holds the motor where it stands
    low: i32,
    /// positions from there on that do: a step and the hysteresis
    width: u32,
    step_log2: u32,
    direction: Direction,
    /// steps put out so far, counted like the position
    at: i32,
    /// steps due that no beat had room for yet
    backlog: u32,
    missed: u32,
}

impl StepBits {
    /// Steps of `2^step_log2` LSB with `hysteresis` LSB, of a motor that stands where `position` is.
    ///
    /// # Errors
    ///
    /// [`StepsError::StepLog2`], [`StepsError::Hysteresis`].
    pub fn new(step_log2: u32, hysteresis: u32, position: i32) -> Result<Self, StepsError> {
        let step = check(step_log2, hysteresis)?;
        let at = position >> step_log2;
        let low = (at << step_log2).wrapping_sub_unsigned(hysteresis);
        let width = step + hysteresis;
        Ok(Self { low, width, step_log2, direction: Direction::Up, at, backlog: 0, missed: 0 })
    }

    /// A quarter of a step, LSB, or none where a step has no quarters: a hysteresis for most motors.
    #[must_use]
    pub const fn quarter(step_log2: u32) -> u32 {
        if step_log2 >= 2 && step_log2 <= STEP_LOG2_MAX { 1 << (step_log2 - 2) } else { 0 }
    }

    /// Whether no step is due at `position`.
    #[must_use]
    #[inline]
    pub const fn holds(&self, position: i32) -> bool {
        position.wrapping_sub(self.low).cast_unsigned() < self.width
    }

    /// What to put out for `position`.
    #[inline]
    pub fn update(&mut self, position: i32) -> Step {
        let offset = position.wrapping_sub(self.low);
        // one comparison for both sides: below is above, without a sign
        if offset.cast_unsigned() < self.width {
            self.backlog = 0;
            return Step { is_step: false, direction: self.direction, is_behind: false };
        }
        self.go(offset)
    }

    /// A step is due one way or the other.
    #[inline]
    fn go(&mut self, offset: i32) -> Step {
        let is_up = offset >= 0;
        // steps due besides the first
        let backlog =
            if is_up { offset.cast_unsigned() - self.width } else { !offset.cast_unsigned() } >> self.step_log2;
        self.missed = self.missed.saturating_add(backlog.saturating_sub(self.backlog));
        self.backlog = backlog;
        let direction = if is_up { Direction::Up } else { Direction::Down };
        let is_step = self.direction == direction;
        self.direction = direction;
        if is_step {
            let one = if is_up { 1 } else { -1 };
            self.at = self.at.wrapping_add(one);
            self.low = self.low.wrapping_add(one << self.step_log2);
        }
        Step { is_step, direction, is_behind: backlog > 0 }
    }

    /// Where the motor stands, steps.
    #[must_use]
    pub const fn at(&self) -> i32 {
        self.at
    }

    /// Steps that were due at the last beat besides the one that a beat puts out.
    #[must_use]
    pub const fn backlog(&self) -> u32 {
        self.backlog
    }

    /// Steps by which the motor fell behind, summed over every time that it did; saturates.
    #[must_use]
    pub const fn missed(&self) -> u32 {
        self.missed
    }

    /// The two lines of a quadrature output where the motor stands.
    #[must_use]
    #[inline]
    pub const fn quadrature(&self) -> Quadrature {
        Quadrature::of(self.at)
    }
}

/// Steps by thresholds on a position that forward differences made: compares and additions alone, exact at every sample.
///
/// The position is `(P − base) · scale`, as [`Differences::scaled`](crate::spline::differences::Differences::scaled) has it.
///
/// ```
/// use fixed_math::spline::differences::Differences;
/// use fixed_math::steps::StepThresholds;
///
/// // 16 samples an interval, a line that rises by 8 LSB an interval, steps of 4 LSB
/// let mut spline = Differences::new([-8, 0, 8, 16], 4).unwrap();
/// let mut steps = StepThresholds::new(2, 0, 0, spline.base(), spline.scale()).unwrap();
/// let mut stepped_at = [false; 17];
/// for at in 1..=16 {
///     spline.advance().unwrap();
///     stepped_at[at] = steps.update(spline.scaled()).is_step;
/// }
/// assert!((0..=16).all(|at| stepped_at[at] == (at == 8 || at == 16)));
/// spline.knot(24).unwrap();
/// steps.rebase(spline.base()).unwrap();
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepThresholds {
    /// the lowest position that holds the motor where it stands
    low: i64,
    /// positions from there on that do: a step and the hysteresis
    width: u64,
    /// a step
    step: i64,
    direction: Direction,
    at: i32,
    step_log2: u32,
    hysteresis: u32,
    scale: i64,
}

impl StepThresholds {
    /// Steps of `2^step_log2` LSB with `hysteresis` LSB, of a motor that stands at step `at`, over positions of `scale` units an LSB
    /// counted from `base` LSB.
    ///
    /// # Errors
    ///
    /// Any [`StepsError`].
    pub fn new(step_log2: u32, hysteresis: u32, at: i32, base: i32, scale: i64) -> Result<Self, StepsError> {
        let step = check(step_log2, hysteresis)?;
        let scaled = i64::from(step).checked_mul(scale).filter(|scaled| (1..=i64::MAX / 4).contains(scaled));
        let scaled = scaled.ok_or(StepsError::Scale { scale, step })?;
        let width = (scaled + i64::from(hysteresis) * scale).cast_unsigned();
        let mut made = Self { low: 0, width, step: scaled, direction: Direction::Up, at, step_log2, hysteresis, scale };
        made.rebase(base)?;
        Ok(made)
    }

    /// Counts positions from `base` LSB from now on: at a knot, where the base changes. Once an interval: it multiplies 64 bits.
    ///
    /// # Errors
    ///
    /// [`StepsError::TooFar`] where the motor stands farther from the base than positions can be told apart; nothing has changed. It is
    /// so far behind its track that it should stop.
    pub fn rebase(&mut self, base: i32) -> Result<(), StepsError> {
        let distance = (i64::from(self.at) << self.step_log2) - i64::from(self.hysteresis) - i64::from(base);
        match distance.checked_mul(self.scale) {
            // with positions of 62 bits, their distance has 63
            Some(low) if low.unsigned_abs() <= REACH => {
                self.low = low;
                Ok(())
            }
            _ => Err(StepsError::TooFar { at: self.at, base }),
        }
    }

    /// What to put out for `position`, which lies within ±2^62. After `is_behind`, beats with the same position catch up.
    #[inline]
    pub fn update(&mut self, position: i64) -> Step {
        let offset = position.wrapping_sub(self.low);
        // one comparison for both sides: below is above, without a sign
        if offset.cast_unsigned() < self.width {
            return Step { is_step: false, direction: self.direction, is_behind: false };
        }
        self.go(offset)
    }

    /// A step is due one way or the other.
    #[inline]
    fn go(&mut self, offset: i64) -> Step {
        let is_up = offset >= 0;
        let (direction, one, step) =
            if is_up { (Direction::Up, 1, self.step) } else { (Direction::Down, -1, -self.step) };
        let is_step = self.direction == direction;
        self.direction = direction;
        if is_step {
            self.at = self.at.wrapping_add(one);
            self.low = self.low.wrapping_add(step);
        }
        // what would be left after one step
        let left = offset.wrapping_sub(step);
        let is_behind = if is_up { left >= self.width.cast_signed() } else { left < 0 };
        Step { is_step, direction, is_behind }
    }

    /// Where the motor stands, steps.
    #[must_use]
    pub const fn at(&self) -> i32 {
        self.at
    }

    /// The two lines of a quadrature output where the motor stands.
    #[must_use]
    #[inline]
    pub const fn quadrature(&self) -> Quadrature {
        Quadrature::of(self.at)
    }
}

/// Two lines a quarter of a period apart: four steps a period, one line changes at each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quadrature {
    /// Leads where steps go up.
    pub a: bool,
    /// Follows.
    pub b: bool,
}

impl Quadrature {
    /// The lines at step `at`: from its two lowest bits, 00, 10, 11, 01.
    #[must_use]
    #[inline]
    pub const fn of(at: i32) -> Self {
        let (low, high) = (at & 1 != 0, at & 2 != 0);
        Self { a: low != high, b: high }
    }
}

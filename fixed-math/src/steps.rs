//! Step and direction from a position: from its bits, or by thresholds on one that forward differences made.
//!
//! - **Walk:** a position at a beat → [`StepBits::update`] or [`StepThresholds::update`] → a [`Step`] → two pins.
//! - **Invariants:** no step is lost: what one beat cannot put out is put out by those after it, one each, and told. A position that
//!   rests at an edge does not chatter. The direction is set a whole beat before the first step that goes that way.
//! - **Context:** a beat; compares, shifts and adds of about 20 cycles of a Cortex-M0+ from bits, 15 by thresholds where no step is due.
//!
//! **Where the steps are:** step k lies at `k · 2^s` LSB. Going up it is put out at `position ≥ k·2^s`; going down it is taken back at
//! `position < k·2^s − hysteresis`, where the hysteresis is less than a step. So between a step and its reversal lies a travel of
//! more than the hysteresis, and where the motor stands depends on the position by no more than that.
//!
//! **Direction set-up:** a beat in which the first step of the other direction is due changes the direction alone. The step is then
//! still due in the next beat and put out there, so the set-up time is one period of the beat.

/// Fewest bits of a step.
pub const STEP_LOG2_MIN: u32 = 1;
/// Most bits of a step.
pub const STEP_LOG2_MAX: u32 = 30;

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
    /// Neither a scale below 1 nor one by which a step leaves 62 bits can be compared.
    Scale {
        /// What was asked for: units of a scaled position an LSB.
        scale: i64,
        /// LSB from the base to the farthest threshold.
        distance: i64,
    },
}

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
    /// steps put out so far, counted like the position
    at: i32,
    hysteresis: i32,
    step_log2: u32,
    direction: Direction,
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
        check(step_log2, hysteresis)?;
        Ok(Self {
            at: position >> step_log2,
            hysteresis: hysteresis.cast_signed(),
            step_log2,
            direction: Direction::Up,
            backlog: 0,
            missed: 0,
        })
    }

    /// The hysteresis that leaves a quarter of a step between a step and its reversal, LSB.
    #[must_use]
    pub const fn quarter(step_log2: u32) -> u32 {
        if step_log2 > 2 && step_log2 <= STEP_LOG2_MAX { 1 << (step_log2 - 2) } else { 0 }
    }

    /// What to put out for `position`.
    #[inline]
    pub fn update(&mut self, position: i32) -> Step {
        // a step has two LSB at least, so step counts have 31 bits and their differences fit
        let up = (position >> self.step_log2) - self.at;
        if up > 0 {
            return self.go(Direction::Up, up.unsigned_abs());
        }
        // past the top it stays at the top, which is no lower than any step
        let down = self.at - (position.saturating_add(self.hysteresis) >> self.step_log2);
        if down > 0 {
            return self.go(Direction::Down, down.unsigned_abs());
        }
        self.backlog = 0;
        Step { is_step: false, direction: self.direction, is_behind: false }
    }

    /// `due` steps of one direction, of which a beat puts out one.
    fn go(&mut self, direction: Direction, due: u32) -> Step {
        let backlog = due - 1;
        self.missed = self.missed.saturating_add(backlog.saturating_sub(self.backlog));
        self.backlog = backlog;
        let is_step = self.direction == direction;
        if is_step {
            self.at += if direction == Direction::Up { 1 } else { -1 };
        }
        self.direction = direction;
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

    /// Steps that came late so far, each counted once; saturates.
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
/// The position is `(P − base) · scale`, with `scale` = 6N³ for N samples an interval.
///
/// ```
/// use fixed_math::steps::StepThresholds;
///
/// // 16 samples an interval, steps of 4 LSB, no hysteresis, from 0 on
/// let scale = 6 * 16 * 16 * 16;
/// let mut steps = StepThresholds::new(2, 0, 0, 0, scale).unwrap();
/// assert!(!steps.update(4 * scale - 1).is_step);
/// assert!(steps.update(4 * scale).is_step);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepThresholds {
    /// from here on a step up is due
    up: i64,
    /// below this a step down is due
    down: i64,
    /// a step
    step: i64,
    direction: Direction,
}

impl StepThresholds {
    /// Steps of `2^step_log2` LSB with `hysteresis` LSB, of a motor that stands at step `at`, over positions of `scale` units an LSB
    /// counted from `base` LSB.
    ///
    /// # Errors
    ///
    /// Any [`StepsError`].
    pub fn new(step_log2: u32, hysteresis: u32, at: i32, base: i32, scale: i64) -> Result<Self, StepsError> {
        let step = i64::from(check(step_log2, hysteresis)?);
        let from_base = i64::from(at) * step - i64::from(base);
        let distance = from_base.abs() + step;
        let refused = StepsError::Scale { scale, distance };
        if scale < 1 || distance.checked_mul(scale).is_none_or(|farthest| farthest > i64::MAX / 2) {
            return Err(refused);
        }
        Ok(Self {
            up: (from_base + step) * scale,
            down: (from_base - i64::from(hysteresis)) * scale,
            step: step * scale,
            direction: Direction::Up,
        })
    }

    /// What to put out for `position`. After `is_behind`, beats with the same position catch up.
    #[inline]
    pub fn update(&mut self, position: i64) -> Step {
        if position >= self.up {
            return self.go(Direction::Up, position);
        }
        if position < self.down {
            return self.go(Direction::Down, position);
        }
        Step { is_step: false, direction: self.direction, is_behind: false }
    }

    fn go(&mut self, direction: Direction, position: i64) -> Step {
        let is_step = self.direction == direction;
        self.direction = direction;
        let is_up = direction == Direction::Up;
        if is_step {
            self.shift(if is_up { self.step } else { -self.step });
            Step { is_step, direction, is_behind: if is_up { position >= self.up } else { position < self.down } }
        } else {
            let is_behind = if is_up {
                position >= self.up.saturating_add(self.step)
            } else {
                position < self.down.saturating_sub(self.step)
            };
            Step { is_step, direction, is_behind }
        }
    }

    /// Counts from another base: `units` more are then in every position, in units of the scale.
    #[inline]
    pub fn shift(&mut self, units: i64) {
        self.up = self.up.saturating_add(units);
        self.down = self.down.saturating_add(units);
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

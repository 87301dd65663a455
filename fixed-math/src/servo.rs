//! A servo's control law: PID with feed-forward of velocity, acceleration and torque, in 32-bit products.
//!
//! - **Walk:** a set point of the spline and a measured position at a beat → [`Servo::update`] → a torque → coil currents.
//! - **Invariants:** no input overflows anything: errors and rates are cut to 16 bits, gains to [`GAIN_MAX`], and both are told. The
//!   integral is exact until it is read, stays within its limit, and stops where it would push an output on that is cut already.
//! - **Context:** a beat of up to 15.625 kHz; about 270 cycles of a Cortex-M0+, no division, no 64-bit product. Gains and the torque
//!   feed-forward may be other tracks' values of the same beat.
//!
//! With e the position's error, v̂ the measured velocity through a filter, all in the units of [`Scales`]:
//!
//! `torque = kp·e + ki·Σe − kd·v̂ + kv·v + ka·a + feed-forward`, cut to ± the limit.
//!
//! The derivative acts on the measurement, so a jump of the set point does not kick; a `kv` of as much as `kd` (in the same units) takes
//! its drag off at speed, and what is more than that meets friction.

mod plant;

pub use plant::{Plant, PlantError, PlantTraits};

use core::fmt;

/// Largest magnitude of a gain's bits: 2^28. A product of it then has 27 bits, and four of them do not overflow.
pub const GAIN_MAX: i32 = 1 << 28;
/// Largest torque limit, output units: 2^22.
pub const TORQUE_MAX: i32 = 1 << 22;
/// Largest of an error, a rate or a feed-forward input after its shift; the least is one less than its negative.
pub const INPUT_MAX: i32 = 32_767;
/// Largest shift of a scale.
pub const SHIFT_MAX: u8 = 16;
/// Longest filter: a 2^−6 share of what is new each beat.
pub const FILTER_LOG2_MAX: u8 = 6;

/// Fractional bits of the filtered velocity.
const RATE_FRACTION_BITS: u32 = 12;
/// Largest measured velocity before the filter, LSB a beat; the least is one less than its negative.
const RATE_MAX: i32 = (1 << 18) - 1;
/// Fractional bits of the integral, in output units.
const INTEGRAL_FRACTION_BITS: u32 = 8;

/// A factor; its bits are cut to ± [`GAIN_MAX`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Gain(i32);

impl Gain {
    /// None at all.
    pub const ZERO: Self = Self(0);

    /// What `bits` say, in the fraction that its use states, cut to ± [`GAIN_MAX`]: a track's value of this beat.
    #[must_use]
    #[inline]
    pub fn saturated(bits: i32) -> Self {
        Self(bits.clamp(-GAIN_MAX, GAIN_MAX))
    }

    /// The same, or `None` where it had to be cut.
    #[must_use]
    pub const fn new(bits: i32) -> Option<Self> {
        if bits >= -GAIN_MAX && bits <= GAIN_MAX { Some(Self(bits)) } else { None }
    }

    /// Its bits.
    #[must_use]
    pub const fn bits(self) -> i32 {
        self.0
    }

    /// Times `x` of no more than 16 bits and its sign, in 2^−16, to the nearest, halves up.
    #[inline]
    const fn times(self, x: i32) -> i32 {
        // ±65535 · 32768 + 2^15 is within ±2^31
        (self.0 >> 16) * x + (((self.0 & 0xffff) * x + (1 << 15)) >> 16)
    }
}

/// Gains of a beat.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Gains {
    /// Output units per unit of error, 2^−16.
    pub proportional: Gain,
    /// Output units per unit of error and beat, 2^−24.
    pub integral: Gain,
    /// Output units per unit of measured velocity, 2^−16.
    pub derivative: Gain,
    /// Output units per unit of the set point's velocity, 2^−16.
    pub velocity: Gain,
    /// Output units per unit of the set point's acceleration, 2^−16.
    pub acceleration: Gain,
}

/// By how many bits each input is shifted down before it is cut to 16 bits: the coarser, the wider its range. 0 to 16.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Scales {
    /// Error: its unit is 2^error LSB.
    pub error: u8,
    /// Measured velocity: its unit is 2^(rate − 12) LSB a beat.
    pub rate: u8,
    /// Set point's velocity: its unit is 2^velocity of what it is given in.
    pub velocity: u8,
    /// Set point's acceleration: its unit is 2^acceleration of what it is given in.
    pub acceleration: u8,
}

/// What does not change from beat to beat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ServoTraits {
    /// Units of the inputs.
    pub scales: Scales,
    /// The measured velocity takes a 2^−filter share of what is new each beat: 0 is no filter, 6 the longest.
    pub filter_log2: u8,
    /// Largest torque either way, output units, 1 to [`TORQUE_MAX`].
    pub torque_limit: i32,
    /// Largest share of it that the integral may hold, output units, 0 to the torque limit.
    pub integral_limit: i32,
}

/// Why a servo was not set up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServoError {
    /// A shift above [`SHIFT_MAX`].
    Shift {
        /// Largest of the four.
        shift: u8,
    },
    /// A filter above [`FILTER_LOG2_MAX`].
    Filter {
        /// What was asked for.
        filter_log2: u8,
    },
    /// A torque limit outside 1 to [`TORQUE_MAX`].
    TorqueLimit {
        /// What was asked for.
        torque_limit: i32,
    },
    /// An integral limit outside 0 to the torque limit.
    IntegralLimit {
        /// What was asked for.
        integral_limit: i32,
        /// The torque limit.
        torque_limit: i32,
    },
}

impl fmt::Display for ServoError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Shift { shift } => {
                write!(f, "a scale of 2^{shift}: use 2^{SHIFT_MAX} or less")
            }
            Self::Filter { filter_log2 } => {
                write!(f, "a filter of 2^-{filter_log2}: use 2^-{FILTER_LOG2_MAX} or more")
            }
            Self::TorqueLimit { torque_limit } => {
                write!(f, "a torque limit of {torque_limit}: use 1 to {TORQUE_MAX}")
            }
            Self::IntegralLimit { integral_limit, torque_limit } => {
                write!(f, "an integral limit of {integral_limit}: use 0 to the torque limit, {torque_limit}")
            }
        }
    }
}

impl core::error::Error for ServoError {}

/// Where a motor should be, as its track's spline has it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SetPoint {
    /// LSB.
    pub position: i32,
    /// Any unit, such as the spline's 2^−4 LSB an interval; the scale and the gain are matched to it.
    pub velocity: i32,
    /// Any unit, likewise.
    pub acceleration: i32,
}

/// What a beat comes to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Drive {
    /// Output units, within ± the torque limit.
    pub torque: i32,
    /// The torque was cut to its limit.
    pub is_saturated: bool,
    /// The error, the measured velocity or an input of the feed-forward was cut to its 16 bits.
    pub is_input_cut: bool,
}

/// The law and what it remembers.
///
/// ```
/// use fixed_math::servo::{Gain, Gains, Scales, Servo, ServoTraits, SetPoint};
///
/// let traits = ServoTraits { scales: Scales::default(), filter_log2: 2, torque_limit: 1_000, integral_limit: 200 };
/// let mut servo = Servo::new(traits, 0).unwrap();
/// let gains = Gains { proportional: Gain::saturated(3 << 16), ..Gains::default() };
/// let at = SetPoint { position: 50, ..SetPoint::default() };
/// let drive = servo.update(&at, 10, &gains, 5);
/// assert_eq!((drive.torque, drive.is_saturated), (3 * 40 + 5, false));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Servo {
    traits: ServoTraits,
    /// in 2^−8 output units
    integral: i32,
    /// and 2^−24 of them
    integral_fraction: i32,
    measured: i32,
    /// LSB a beat, 2^−12
    rate: i32,
}

impl Servo {
    /// A servo at rest at `measured` LSB.
    ///
    /// # Errors
    ///
    /// Any [`ServoError`].
    pub fn new(traits: ServoTraits, measured: i32) -> Result<Self, ServoError> {
        let ServoTraits { scales, filter_log2, torque_limit, integral_limit } = traits;
        let shift = scales.error.max(scales.rate).max(scales.velocity).max(scales.acceleration);
        if shift > SHIFT_MAX {
            return Err(ServoError::Shift { shift });
        }
        if filter_log2 > FILTER_LOG2_MAX {
            return Err(ServoError::Filter { filter_log2 });
        }
        if !(1..=TORQUE_MAX).contains(&torque_limit) {
            return Err(ServoError::TorqueLimit { torque_limit });
        }
        if !(0..=torque_limit).contains(&integral_limit) {
            return Err(ServoError::IntegralLimit { integral_limit, torque_limit });
        }
        Ok(Self { traits, integral: 0, integral_fraction: 0, measured, rate: 0 })
    }

    /// Forgets the integral and the velocity: after the motor was released, at `measured` LSB.
    pub fn restart(&mut self, measured: i32) {
        *self = Self { traits: self.traits, integral: 0, integral_fraction: 0, measured, rate: 0 };
    }

    /// The integral's share of the torque, output units.
    #[must_use]
    pub const fn integral(&self) -> i32 {
        self.integral >> INTEGRAL_FRACTION_BITS
    }

    /// The torque for this beat. `measured` is in LSB; positions are on a circle of 2^32 LSB, so it may wrap where the set point does.
    /// `feed_forward` is in output units.
    #[inline]
    pub fn update(&mut self, set: &SetPoint, measured: i32, gains: &Gains, feed_forward: i32) -> Drive {
        let scales = self.traits.scales;
        let (rate, is_fast) = self.filtered(measured);
        let mut rate = rate >> scales.rate;
        let mut error = set.position.wrapping_sub(measured) >> scales.error;
        let mut velocity = set.velocity >> scales.velocity;
        let mut acceleration = set.acceleration >> scales.acceleration;
        // one test for all four, which nearly always pass it
        let is_wide = (magnitude(error) | magnitude(velocity) | magnitude(acceleration) | magnitude(rate)) > INPUT_MAX;
        if is_wide {
            (error, rate) = (cut_input(error), cut_input(rate));
            (velocity, acceleration) = (cut_input(velocity), cut_input(acceleration));
        }
        // four of 27 bits, one of 22
        let sum = gains.proportional.times(error) - gains.derivative.times(rate)
            + gains.velocity.times(velocity)
            + gains.acceleration.times(acceleration)
            + self.integral();
        let (torque, is_saturated) = cut(sum.saturating_add(feed_forward), self.traits.torque_limit);
        // an output that is cut already is not pushed on
        if !is_saturated || (error ^ torque) < 0 {
            self.integrate(gains.integral, error);
        }
        Drive { torque, is_saturated, is_input_cut: is_wide | is_fast }
    }

    /// The measured velocity, LSB a beat in 2^−12, and whether it was cut before the filter.
    #[inline]
    fn filtered(&mut self, measured: i32) -> (i32, bool) {
        let mut moved = measured.wrapping_sub(self.measured);
        self.measured = measured;
        let is_fast = magnitude(moved) > RATE_MAX;
        if is_fast {
            moved = RATE_MAX ^ (moved >> 31);
        }
        // 30 bits and a sign less as many
        self.rate += ((moved << RATE_FRACTION_BITS) - self.rate) >> self.traits.filter_log2;
        (self.rate, is_fast)
    }

    /// Adds `gain · error` with all of its bits.
    #[inline]
    fn integrate(&mut self, gain: Gain, error: i32) {
        // in 2^−24 output units, within ±65535 · 32768; the sum of the fractions needs one bit more than 16
        let low = (gain.0 & 0xffff) * error;
        let fraction = self.integral_fraction + (low & 0xffff);
        self.integral_fraction = fraction & 0xffff;
        let sum = self.integral + (gain.0 >> 16) * error + (low >> 16) + (fraction >> 16);
        let (integral, is_cut) = cut(sum, self.traits.integral_limit << INTEGRAL_FRACTION_BITS);
        self.integral = integral;
        if is_cut {
            self.integral_fraction = 0;
        }
    }
}

/// That of `value`, less one where it is negative: what its bits are compared by.
#[inline]
const fn magnitude(value: i32) -> i32 {
    value ^ (value >> 31)
}

/// `value` in 16 bits, its sign among them.
#[cold]
const fn cut_input(value: i32) -> i32 {
    // the limit, or its complement
    if magnitude(value) > INPUT_MAX { INPUT_MAX ^ (value >> 31) } else { value }
}

/// `value` within ± `limit`, and whether it had to be cut.
#[inline]
const fn cut(value: i32, limit: i32) -> (i32, bool) {
    if value > limit {
        (limit, true)
    } else if value < -limit {
        (-limit, true)
    } else {
        (value, false)
    }
}

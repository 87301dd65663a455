//! A motor that is not there: inertia, viscous friction and an encoder in fixed point, to close a loop with in an image or a test.
//!
//! - **Walk:** a torque at a beat → [`Plant::update`] → counts of an encoder, as a timer in encoder mode would have them.
//! - **Invariants:** deterministic, the same on every machine to the bit; what division would leave is carried, so friction has no dead
//!   zone and torque is lost nowhere. A speed that does not fit is cut and told.
//! - **Context:** any; about 110 cycles of a Cortex-M0+ in line. A simulation: it shows a loop's function, not what a motor does.
//!
//! Each beat: `v += torque·gain − v·friction`, then `x += v`.

use crate::steps::Quadrature;
use crate::widening::product_signed;
use core::fmt;

/// Fractional bits of position and velocity.
const FRACTION_BITS: u32 = 16;

/// What a simulated motor is like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlantTraits {
    /// What an output unit of torque adds to the velocity in a beat, 2^−32 LSB a beat: the inverse of inertia, ≥ 0.
    pub gain: i32,
    /// What share of the velocity a beat takes, 2^−16: viscous friction over inertia.
    pub friction: u16,
    /// LSB a count of the encoder is worth, as a base-two logarithm, 0 to 16.
    pub count_log2: u8,
}

/// Why a plant was not set up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlantError {
    /// A negative inertia.
    Gain {
        /// What was asked for.
        gain: i32,
    },
    /// Counts of more than 2^16 LSB.
    CountLog2 {
        /// What was asked for.
        count_log2: u8,
    },
}

impl fmt::Display for PlantError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Gain { gain } => {
                write!(f, "a motor that a torque drives backwards by {gain}: use 0 or more")
            }
            Self::CountLog2 { count_log2 } => {
                write!(f, "counts of 2^{count_log2} LSB: use 2^16 or less")
            }
        }
    }
}

impl core::error::Error for PlantError {}

/// A simulated motor with its encoder.
///
/// ```
/// use fixed_math::servo::{Plant, PlantTraits};
///
/// // no friction; one unit of torque adds one LSB a beat to the velocity in each beat
/// let mut plant = Plant::new(PlantTraits { gain: i32::MAX, friction: 0, count_log2: 0 }).unwrap();
/// for _ in 0..4 {
///     plant.update(2);
/// }
/// // (2^31 − 1) / 2^32 is a hair below a half: v = 1, 2, 3, 4 less a hair, x = 10 less a hair
/// assert_eq!(plant.counts(), 9);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plant {
    traits: PlantTraits,
    /// LSB, 2^−16
    position: i64,
    /// LSB a beat, 2^−16
    velocity: i32,
    /// what is left of the velocity, 2^−32
    rest: i64,
}

impl Plant {
    /// A motor at rest at 0.
    ///
    /// # Errors
    ///
    /// Any [`PlantError`].
    pub const fn new(traits: PlantTraits) -> Result<Self, PlantError> {
        if traits.gain < 0 {
            return Err(PlantError::Gain { gain: traits.gain });
        }
        if traits.count_log2 > 16 {
            return Err(PlantError::CountLog2 { count_log2: traits.count_log2 });
        }
        Ok(Self { traits, position: 0, velocity: 0, rest: 0 })
    }

    /// One beat with `torque`, output units. Whether the velocity fitted; where it did not it is cut to ±2^15 LSB a beat.
    pub const fn update(&mut self, torque: i32) -> bool {
        // 2^62 and 2^47 and less: no overflow
        let change = product_signed(torque, self.traits.gain)
            - product_signed(self.velocity, self.traits.friction as i32)
            + self.rest;
        self.rest = change & ((1 << FRACTION_BITS) - 1);
        let wanted = self.velocity as i64 + (change >> FRACTION_BITS);
        #[expect(clippy::cast_possible_truncation, reason = "compared right below")]
        let velocity = wanted as i32;
        let fits = velocity as i64 == wanted;
        self.velocity = if fits {
            velocity
        } else if wanted > 0 {
            i32::MAX
        } else {
            i32::MIN
        };
        self.position = self.position.wrapping_add(self.velocity as i64);
        fits
    }

    /// What a counter of the encoder's edges reads; it wraps.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "counters wrap")]
    pub const fn counts(&self) -> i32 {
        (self.position >> FRACTION_BITS >> self.traits.count_log2) as i32
    }

    /// The counts in LSB of the track, what a servo takes as measured; it wraps.
    #[must_use]
    pub const fn measured(&self) -> i32 {
        self.counts() << self.traits.count_log2
    }

    /// The two lines of the encoder.
    #[must_use]
    pub const fn encoder(&self) -> Quadrature {
        Quadrature::of(self.counts())
    }

    /// Velocity, LSB a beat in 2^−16.
    #[must_use]
    pub const fn velocity(&self) -> i32 {
        self.velocity
    }

    /// Position, LSB in 2^−16.
    #[must_use]
    pub const fn position(&self) -> i64 {
        self.position
    }
}

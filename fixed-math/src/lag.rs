//! The known delay of an actuator, taken off by looking that far ahead.
//!
//! - **Walk:** the time of a beat → *this module* → the time at which a track is evaluated for an output that lags.
//! - **Invariants:** none but that time saturates at its end.
//! - **Context:** any; one 64-bit addition.

use crate::time::{NetTime, Span};

/// How long after its command an output happens: a solenoid's rise of current, a valve, a laser's supply.
///
/// ```
/// use fixed_math::lag::Lag;
/// use fixed_math::ramp::RampSegment;
/// use fixed_math::time::{NetTime, Span};
///
/// let ramp = RampSegment::new(NetTime::from_us(0), NetTime::from_us(1_000), 0, 100).unwrap();
/// let solenoid = Lag(Span::from_us(250));
/// // what is put out at 500 µs is seen at 750 µs
/// assert_eq!(ramp.value(solenoid.ahead(NetTime::from_us(500))), 75);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Lag(pub Span);

impl Lag {
    /// An output that follows at once.
    pub const NONE: Self = Self(Span::ZERO);

    /// The time to evaluate at for an output that is put out at `at`. A track has to hold points that much further ahead.
    #[must_use]
    #[inline]
    pub fn ahead(self, at: NetTime) -> NetTime {
        at + self.0
    }
}

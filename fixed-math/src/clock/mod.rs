//! The arithmetic of clock synchronisation: what four stamps say of two counters, and a time made of that which never steps.
//!
//! - **Walk:** [`Exchange`] → [`LinkClock::observe`] (one for each link: offset and skew of the neighbour's counter against one's own, with
//!   an error and a guaranteed bound) → [`LinkClock::compose`] with what the neighbour tells of system time → [`Estimate`] →
//!   a [`Servo`] → [`SlewedMap`], which all else reads.
//! - **Invariants:** integers only, no panic for any stamps, no allocation. Counters are never set: all is relative to them.
//! - **Context:** the clock service, 20 to 200 times a second for each link; only [`SlewedMap::system_at`] is for interrupts.
//!
//! ```
//! use fixed_math::clock::{Exchange, LinkClock, LinkTraits};
//! use fixed_math::time::{LocalTicks, PeerTicks, Rate, Span};
//!
//! let mut link = LinkClock::new(LinkTraits { tick: Span::from_us(1), ..LinkTraits::CRYSTAL });
//! // a request of 20 µs there, answered after 60, 20 µs back; the peer's counter is 1000 µs ahead
//! let exchange = Exchange {
//!     sent: LocalTicks::from_us(500),
//!     heard: PeerTicks::from_us(1520),
//!     answered: PeerTicks::from_us(1580),
//!     received: LocalTicks::from_us(600),
//! };
//! link.observe(&exchange).unwrap();
//! assert_eq!(link.peer_at(LocalTicks::from_us(550)), PeerTicks::from_us(1550));
//! // nothing says how the 40 µs are shared between the two ways, or what the ticks cut off
//! assert_eq!(link.bound_at(LocalTicks::from_us(550)).as_us_floor(), 21);
//! ```

mod covariance;
mod interval;
mod line;
mod link;
mod roundtrip;
mod servo;
mod slew;
mod wide;

pub use line::{Estimate, PeerEstimate, TimeLine};
pub use link::{LinkClock, RUN};
pub use servo::{Diffusion, Follow, Gains, Neighbour, Oldest, Servo, ewma};
pub use slew::SlewedMap;

use crate::time::{LocalTicks, PeerTicks, Rate, Span};

/// The four stamps of one exchange, each at its frame's first byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Exchange {
    /// The request's departure.
    pub sent: LocalTicks,
    /// The request's arrival.
    pub heard: PeerTicks,
    /// The reply's departure.
    pub answered: PeerTicks,
    /// The reply's arrival.
    pub received: LocalTicks,
}

/// What is known of a link beforehand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LinkTraits {
    /// Known time from the departure stamp to the arrival stamp of a frame, the mean of both ways: a byte's time on a UART, since stamps
    /// are taken when the first byte has come. Zero where unknown. Never more than it takes.
    pub wire: Span,
    /// How far a stamp may be below its counter's true reading: the tick of the coarser of the two counters.
    pub tick: Span,
    /// How late a departure stamp may be read after the byte left; zero where the counter is read first. Arrival stamps may be as late as
    /// they like. See the derivation in `interval.rs`.
    pub late: Span,
    /// Calibrated asymmetry: how much longer the way there takes than the way back, steps, signed.
    pub asymmetry_steps: i32,
    /// One sigma of the relative rate before anything was measured: 40 ppm for crystals, 10⁻² for an RC oscillator. Three in a hundred
    /// at most. Six of them are the most that is ever believed.
    pub rate_sigma: Rate,
    /// What the relative rate gains at most in a second, either way: 0.02 ppm for two crystals in a room, 20 ppm for an RC
    /// oscillator.
    pub ramp: Rate,
}

impl LinkTraits {
    /// Two crystals, counters of a microsecond, and nothing known of the wire.
    pub const CRYSTAL: Self = Self {
        wire: Span::ZERO,
        tick: Span::from_us(1),
        late: Span::ZERO,
        asymmetry_steps: 0,
        rate_sigma: Rate::from_ppb(40_000),
        ramp: Rate::from_ppb(20),
    };
    /// As [`LinkTraits::CRYSTAL`], one of the two clocked by an RC oscillator.
    pub const RC: Self = Self { rate_sigma: Rate::from_ppb(10_000_000), ramp: Rate::from_ppb(20_000), ..Self::CRYSTAL };
    /// As [`LinkTraits::RC`], both clocked by one.
    pub const RC_BOTH: Self = Self { ramp: Rate::from_ppb(40_000), ..Self::RC };
}

/// Why an exchange was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Fault {
    /// Answered before it was heard, or received before it was sent.
    Order,
    /// Not after the exchange before it.
    Past,
    /// Shorter on the way than the wire allows.
    RoundTrip,
    /// Beyond what offset and rate can be, or over a minute long.
    Absurd,
}

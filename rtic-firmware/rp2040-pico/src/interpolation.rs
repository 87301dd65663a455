//! What this image's interrupt plays, and by what.
//!
//! - **Walk:** `PWM_IRQ_WRAP` → [`PicoBeats`], which `init` makes by [`beats`]. **Context:** the highest priority.
//! - **Variants:** as it is, four axes by step and direction at 15.625 kHz; with the feature `fast` they step at 125 kHz; with `servo` the first axis
//!   is a motor with two coils that closes its loop at every beat, by a simulated encoder.

#![expect(unreachable_pub, reason = "RTIC has its resources be public types")]

use board_rp2040_pico::motors::Motors;
use board_rp2040_pico::outputs::{Enable, Phases, StepPins};
use board_rp2040_pico::pace::Pace;
use board_rp2040_pico::signals::SignalPins;
#[cfg(not(feature = "fast"))]
use firmware_app::beats::Beats;
#[cfg(feature = "fast")]
use firmware_app::beats::FastBeats;
use firmware_app::motion::MotionTraits;
#[cfg(feature = "fast")]
use osap_maxl::device::FastInterpolator;
use osap_maxl::device::{BeatTraits, Interpolator};

/// From one beat to the next, µs: 2^[`PERIOD_LOG2`].
const PERIOD_US: u32 = 1 << PERIOD_LOG2;
const PERIOD_LOG2: u32 = 6;
/// From one interrupt to the next, µs.
const INTERRUPT_US: u32 = if cfg!(feature = "fast") { PERIOD_US / osap_maxl::device::SLICES } else { PERIOD_US };

/// What the motion port says of this board: its channels are the encoder's, where there is one, and the inputs' levels.
pub const MOTION: MotionTraits =
    MotionTraits { beat_us: 1 << PERIOD_LOG2, channels: 2, has_phases: cfg!(feature = "servo") };
/// The beat.
pub const BEAT: BeatTraits =
    BeatTraits { period_log2: PERIOD_LOG2, nominal_cycles: PERIOD_US * board_rp2040_pico::pace::CYCLES_A_US };

/// What follows the first axis.
#[cfg(all(feature = "servo", not(feature = "fast")))]
pub type PicoFollower = firmware_app::servo::SimulatedMotor;
/// Nothing does.
#[cfg(not(any(feature = "servo", feature = "fast")))]
pub type PicoFollower = firmware_app::beats::NoServo;

/// All that the interrupt has.
#[cfg(not(feature = "fast"))]
pub type PicoBeats = Beats<Pace, Motors, PicoFollower>;
/// All that the interrupt has.
#[cfg(feature = "fast")]
pub type PicoBeats = FastBeats<Pace, Motors>;

/// The board's parts for it.
pub struct Parts {
    /// Stands still.
    pub pace: Pace,
    /// Low.
    pub steps: StepPins,
    /// Without current.
    pub phases: Phases,
    /// Off.
    pub enable: Enable,
    /// Low.
    pub signals: SignalPins,
}

/// Starts the beat.
pub fn beats(parts: Parts, interpolator: Interpolator<'static>) -> PicoBeats {
    let Parts { mut pace, steps, phases, enable, signals } = parts;
    pace.start(INTERRUPT_US);
    let phases = cfg!(feature = "servo").then(|| phases.start());
    let motors = Motors { steps, enable, phases, signals };
    #[cfg(feature = "fast")]
    let beats = FastBeats::new(FastInterpolator::new(interpolator), pace, motors);
    #[cfg(not(feature = "fast"))]
    let beats = Beats::new(interpolator, pace, motors, PicoFollower::default());
    beats
}

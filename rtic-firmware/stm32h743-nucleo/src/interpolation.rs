//! What this image's highest task plays, and by what.
//!
//! - **Walk:** interrupt `TIM3` → [`Beats`], which `init` makes by [`start`]: four axes by step and direction at 15.625 kHz.
//! - **Context:** [`start`] at start-up, the rest at the highest priority. **Clauses:** `[MOT-01]`, `[MOT-13]`, `[MOT-14]`.

use crate::device::NucleoServices;
use board_stm32h743_nucleo::motors::Motors;
use board_stm32h743_nucleo::outputs::{Enable, StepPins};
use board_stm32h743_nucleo::pace::{CYCLES_A_US, Pace};
use board_stm32h743_nucleo::signals::SignalPins;
use firmware_app::beats::NoServo;
use firmware_app::motion::{MotionService, MotionTraits};
use osap_maxl::device::{BeatTraits, DeviceRings};

/// Base-two logarithm of the time from one beat to the next, µs.
const PERIOD_LOG2: u32 = 6;
/// From one beat to the next, µs.
const PERIOD_US: u8 = 1 << PERIOD_LOG2;

/// What the motion port says of this board: its channels are the encoder's, of which there is none, and the inputs' levels.
const MOTION: MotionTraits = MotionTraits { beat_us: PERIOD_US, channels: 2, has_phases: false };
/// The beat.
const BEAT: BeatTraits = BeatTraits { period_log2: PERIOD_LOG2, nominal_cycles: PERIOD_US as u32 * CYCLES_A_US };

/// What both halves of motion share.
pub(crate) type Rings = DeviceRings;
/// All that the highest task has.
pub(crate) type Beats = firmware_app::beats::Beats<Pace, Motors, NoServo>;

/// The board's parts for it.
pub(crate) struct Parts {
    /// Stands still.
    pub(crate) pace: Pace,
    /// Low.
    pub(crate) steps: StepPins,
    /// Off.
    pub(crate) enable: Enable,
    /// Low.
    pub(crate) signals: SignalPins,
}

/// Gives `services` what answers at a motion port, where the kind has one, and starts the beat.
pub(crate) fn start(rings: &'static mut Rings, services: &mut NucleoServices, parts: Parts) -> Beats {
    let Parts { mut pace, steps, enable, signals } = parts;
    let (motion, interpolator) = rings.split(BEAT);
    services.set_motion(MotionService::new(motion, MOTION));
    pace.start(PERIOD_US.into());
    Beats::new(interpolator, pace, Motors { steps, enable, signals }, NoServo)
}

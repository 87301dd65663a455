//! What a track's errors are on the wire.
//!
//! - **Walk:** an error of `osap_maxl` → *here* → a refusal with its operands. **Invariant:** no operand is lost that the wire has a field for.
//! - **Clauses:** `[MOT-04]`, `[MOT-06]`, `[MOT-09]`.

use fixed_math::limits::{LimitKind as Limited, LimitsError};
use fixed_math::ramp::RampError;
use fixed_math::spline::IntervalLog2;
use fixed_math::time::NetTime;
use osap_maxl::axis::{ArmError, ConfigError, Fault as Broken};
use osap_maxl::device::{OfferError, SettingError};
use osap_maxl::feeder::Refusal;
use osap_maxl::player::PlayerState;
use osap_maxl::tracks::TrackRefusal;
use osap_protocol::motion::{AxisState, Fault, LimitKind, MotionRefusal};

const fn kind_of(limit: Limited) -> LimitKind {
    match limit {
        Limited::PositionMin | Limited::PositionMax => LimitKind::Position,
        Limited::Velocity => LimitKind::Velocity,
        Limited::Acceleration => LimitKind::Acceleration,
        Limited::Jerk => LimitKind::Jerk,
    }
}

/// A fault as it is told.
pub(super) const fn fault_of(fault: &Broken) -> Fault {
    let Broken { point_time, limit, value, bound, .. } = *fault;
    Fault { point_steps: point_time.steps(), limit: kind_of(limit), value, bound }
}

/// What the interrupt says that an axis does.
pub(super) const fn state_of(played: u32) -> AxisState {
    const FOLLOWING: u32 = PlayerState::Following as u32;
    const STOPPING: u32 = PlayerState::Stopping as u32;
    const RESTING: u32 = PlayerState::Resting as u32;
    const HOLDING: u32 = PlayerState::Holding as u32;
    const RELEASED: u32 = PlayerState::Released as u32;
    match played {
        FOLLOWING => AxisState::Playing,
        STOPPING => AxisState::Stopping,
        RESTING | HOLDING => AxisState::Starved,
        RELEASED => AxisState::Released,
        _ => AxisState::Idle,
    }
}

pub(super) fn of_limits(error: LimitsError) -> MotionRefusal {
    match error {
        LimitsError::PositionsCrossed { min, max } => MotionRefusal::Setting { field: 5, value: min, bound: max },
        LimitsError::OutOfRange { limit, value, least, most } => {
            let field = match limit {
                Limited::PositionMin => 5,
                Limited::PositionMax => 6,
                Limited::Velocity => 7,
                Limited::Acceleration => 8,
                Limited::Jerk => 9,
            };
            MotionRefusal::Setting { field, value, bound: value.clamp(least, most) }
        }
        LimitsError::StopTooLong { intervals, most } => {
            MotionRefusal::StopTooLong { intervals, most: u16::try_from(most).unwrap_or(u16::MAX) }
        }
    }
}

fn of_config(error: &ConfigError) -> MotionRefusal {
    match error {
        ConfigError::Warp(short) => match short.least_log2 {
            Some(least) => {
                let least = u8::try_from(least).unwrap_or(u8::MAX);
                MotionRefusal::HaltTooShort { stop_log2: least.saturating_sub(1), least }
            }
            None => of_limits(short.error),
        },
        ConfigError::MissingMax { value, most } => {
            MotionRefusal::Setting { field: 3, value: (*value).into(), bound: (*most).into() }
        }
        // the lead is this service's own
        ConfigError::Lead { .. } => MotionRefusal::Malformed,
    }
}

pub(super) fn of_setting(error: &SettingError) -> MotionRefusal {
    match error {
        SettingError::NoSuch { index, count } => {
            MotionRefusal::NoSuch { index: *index, count: u8::try_from(*count).unwrap_or(u8::MAX) }
        }
        SettingError::Moving => MotionRefusal::Moving,
        SettingError::Config(config) => of_config(config),
        SettingError::Node(_) => MotionRefusal::Malformed,
        SettingError::Busy => MotionRefusal::Busy,
    }
}

pub(super) fn of_node(error: &SettingError, operation: u8, operand: u8) -> MotionRefusal {
    match error {
        SettingError::Node(_) => MotionRefusal::Node { operation, operand },
        other => of_setting(other),
    }
}

pub(super) fn of_arm(error: Option<&ArmError>) -> MotionRefusal {
    match error {
        None => MotionRefusal::NotArmed,
        Some(ArmError::Moving) => MotionRefusal::Moving,
        Some(ArmError::Latched(fault)) => MotionRefusal::Latched(fault_of(fault)),
        Some(ArmError::Config(config)) => of_config(config),
        Some(ArmError::Limit(fault)) => MotionRefusal::Limit(fault_of(fault)),
        Some(ArmError::OffGrid { start, interval }) => MotionRefusal::OffGrid {
            point_steps: start.steps(),
            interval_log2: u8::try_from(interval.as_us_floor().ilog2()).unwrap_or(0),
        },
        Some(ArmError::Late { needed_by, now }) => {
            MotionRefusal::Late { point_steps: needed_by.steps(), earliest_steps: now.steps() }
        }
        Some(ArmError::Elsewhere { position, rests_at }) => {
            MotionRefusal::Setting { field: 0, value: *position, bound: *rests_at }
        }
    }
}

/// Of the point at `time`, the one after `taken` of its message.
pub(super) fn of_offer(error: &OfferError, time: NetTime, taken: u8, interval: IntervalLog2) -> MotionRefusal {
    let refusal = match error {
        OfferError::Setting(error) => return of_setting(error),
        OfferError::Arm(ArmError::OffGrid { .. }) => {
            let interval_log2 = log2_of(interval);
            return MotionRefusal::OffGrid { point_steps: time.steps(), interval_log2 };
        }
        OfferError::Arm(ArmError::Late { needed_by, now }) => return late(time, *needed_by, *now),
        OfferError::Arm(error) => return of_arm(Some(error)),
        OfferError::Refused(refusal) => refusal,
    };
    match *refusal {
        Refusal::NotArmed | Refusal::Starved { .. } => MotionRefusal::NotArmed,
        Refusal::OffGrid { time, .. } => {
            MotionRefusal::OffGrid { point_steps: time.steps(), interval_log2: log2_of(interval) }
        }
        Refusal::Late { needed_by, now } => late(time, needed_by, now),
        Refusal::NonMonotonic { time, newest } => {
            MotionRefusal::NonMonotonic { point_steps: time.steps(), last_steps: newest.steps() }
        }
        Refusal::Gap { missing, most } => MotionRefusal::Gap {
            missing: u32::try_from(missing).unwrap_or(u32::MAX),
            missing_max: u8::try_from(most).unwrap_or(u8::MAX),
        },
        Refusal::Full { .. } => MotionRefusal::Full { taken, capacity: super::CAPACITY },
        Refusal::Latched(fault) => MotionRefusal::Latched(fault_of(&fault)),
        Refusal::Limit(fault) => MotionRefusal::Limit(fault_of(&fault)),
    }
}

/// 8 to 14.
fn log2_of(interval: IntervalLog2) -> u8 {
    u8::try_from(interval.log2()).unwrap_or(u8::MAX)
}

/// The point's time, and that of the earliest that would not be late.
fn late(time: NetTime, needed_by: NetTime, now: NetTime) -> MotionRefusal {
    let earliest = time + now.since(needed_by);
    MotionRefusal::Late { point_steps: time.steps(), earliest_steps: earliest.steps() }
}

pub(super) fn of_track(error: Option<&TrackRefusal>, track: u8, count: usize) -> MotionRefusal {
    let order =
        |start: NetTime, end: NetTime| MotionRefusal::Order { start_steps: start.steps(), end_steps: end.steps() };
    match error {
        None => MotionRefusal::NoSuch { index: track, count: u8::try_from(count).unwrap_or(u8::MAX) },
        Some(TrackRefusal::Late { start, now }) => {
            MotionRefusal::Late { point_steps: start.steps(), earliest_steps: now.steps() }
        }
        Some(TrackRefusal::Full { room, .. }) => {
            MotionRefusal::Full { taken: 0, capacity: u16::try_from(*room).unwrap_or(u16::MAX) }
        }
        Some(TrackRefusal::Gap { gap, .. }) => {
            MotionRefusal::Gap { missing: u32::try_from(gap.as_us_floor()).unwrap_or(u32::MAX), missing_max: 0 }
        }
        Some(TrackRefusal::NonMonotonic { start, newest }) => {
            MotionRefusal::NonMonotonic { point_steps: start.steps(), last_steps: newest.steps() }
        }
        Some(TrackRefusal::Ramp(RampError::EndNotAfterStart { start, end } | RampError::TooLong { start, end })) => {
            order(*start, *end)
        }
        Some(TrackRefusal::Ramp(RampError::StartBeforePreviousEnd { start, previous_end })) => {
            order(*start, *previous_end)
        }
        Some(TrackRefusal::Ramp(RampError::NoStart { end } | RampError::NoStartValue { end, .. })) => {
            order(NetTime::ZERO, *end)
        }
    }
}

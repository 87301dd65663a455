//! Queries about a node's clock: what it follows, how well, and what may be tuned.
//!
//! - **Walk:** netresponder's queries 9, 10, 12, 13 and 14. **Invariant:** [`TimeControl`] has fixed width.
//! - **Context:** any. **Clauses:** `[DSC-07]`, `[TIM-10]` to `[TIM-13]`.

use super::{Name, Query, Refusal, UniqueId, encode};
use postcard::fixint;
use serde::{Deserialize, Serialize};

/// A node that is not synchronised to any other.
pub const TIER_FREE_RUNNING: u8 = u8::MAX;

/// Answer to [`Query::TimeControl`]: 61 bytes whatever the values, `[DSC-07]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TimeControl {
    /// System time as this node has it, 1/256 µs.
    #[serde(with = "fixint::le")]
    pub system_time_steps: u64,
    /// The node's own counter at the same instant, 1/256 µs.
    #[serde(with = "fixint::le")]
    pub local_ticks_steps: u64,
    /// Time between exchanges with a neighbour, µs.
    #[serde(with = "fixint::le")]
    pub interval_us: u32,
    /// Offset to the best neighbour, 1/256 µs.
    #[serde(with = "fixint::le")]
    pub offset_steps: i32,
    /// Rate against the root, parts per 10⁹.
    #[serde(with = "fixint::le")]
    pub skew_ppb: i32,
    /// Largest possible error of the system time, 1/256 µs; negative where none can be given.
    #[serde(with = "fixint::le")]
    pub bound_steps: i32,
    /// Last round trip to the best neighbour, 1/256 µs.
    #[serde(with = "fixint::le")]
    pub round_trip_steps: i32,
    /// Least round trip seen, 1/256 µs.
    #[serde(with = "fixint::le")]
    pub round_trip_min_steps: i32,
    /// See [`TimeSettings`].
    #[serde(with = "fixint::le")]
    pub filter_q16: i32,
    /// See [`TimeSettings`].
    #[serde(with = "fixint::le")]
    pub proportional_q16: i32,
    /// See [`TimeSettings`].
    #[serde(with = "fixint::le")]
    pub integral_q16: i32,
    /// See [`TimeSettings`].
    #[serde(with = "fixint::le")]
    pub skew_limit_ppb: i32,
    /// See [`TimeSettings`].
    #[serde(with = "fixint::le")]
    pub gate_steps: i32,
    /// Steps from the root; [`TIER_FREE_RUNNING`] without one.
    pub tier: u8,
}

impl TimeControl {
    /// As [`encode`], which is generic and so compiled where it is used: clocks are compared by this answer, and it is to be made at the
    /// speed that this crate is compiled for.
    ///
    /// # Errors
    /// [`Refusal::TooLong`] where it does not fit.
    #[inline(never)]
    pub fn encode(&self, out: &mut [u8]) -> Result<usize, Refusal> {
        encode(Query::TimeControl.key(), self, out)
    }
}

/// What steers a node's clock, `[TIM-11]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ServoKind {
    /// Follows the root's time as estimated over the links.
    #[default]
    Estimator,
    /// Diffusion: averaged offsets to the best neighbours, a PI controller on the rate.
    Diffusion,
    /// An older clock is adopted; else the mean of all offsets shims the rate.
    Oldest,
}

impl ServoKind {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Estimator, Self::Diffusion, Self::Oldest];

    /// Its name, for people.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Estimator => "estimator",
            Self::Diffusion => "diffusion",
            Self::Oldest => "oldest",
        }
    }
}

/// Body of [`Query::SetTimeControl`]: the parameters that may be tuned.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TimeSettings {
    /// Time between exchanges with a neighbour, µs: 1,000 to 10,000,000.
    pub interval_us: u32,
    /// Weight of a new offset in the average, 1/65,536: 1 to 65,536.
    pub filter_q16: i32,
    /// Proportional gain, 1/65,536: 0 to 2^24.
    pub proportional_q16: i32,
    /// Integral gain, 1/65,536: 0 to 2^24.
    pub integral_q16: i32,
    /// Most the rate may be shimmed, parts per 10⁹: 0 to 20,000,000.
    pub skew_limit_ppb: i32,
    /// Offsets further off than this are not believed once the clock is settled, 1/256 µs: at least 0.
    pub gate_steps: i32,
    /// What steers the clock.
    pub servo: ServoKind,
    /// Whose time is the system's: the lowest; 255 never becomes root, `[TIM-07]`.
    pub priority: u8,
}

impl TimeSettings {
    /// Whether every value is in its range.
    #[must_use]
    pub fn in_range(&self) -> bool {
        const GAIN_MAX: i32 = 1 << 24;
        (1_000..=10_000_000).contains(&self.interval_us)
            && (1..=65_536).contains(&self.filter_q16)
            && (0..=GAIN_MAX).contains(&self.proportional_q16)
            && (0..=GAIN_MAX).contains(&self.integral_q16)
            && (0..=20_000_000).contains(&self.skew_limit_ppb)
            && self.gate_steps >= 0
    }
}

/// Answer to [`Query::TimeStatus`]: what a node's clock follows, `[TIM-12]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TimeStatus {
    /// Its settings.
    pub settings: TimeSettings,
    /// Steps to the root, 0 for the root itself; 255 without one.
    pub tier: u8,
    /// The root's priority.
    pub root_priority: u8,
    /// The root.
    pub root: UniqueId,
    /// Programs may rely on its time.
    pub is_settled: bool,
    /// Something runs by its time now, so that it is slewed and never stepped, `[TIM-10]`.
    pub is_live: bool,
    /// Gateways it has its time from, one bit each.
    pub sources: u64,
    /// One standard deviation of its system time, 1/256 µs.
    pub error_steps: u32,
    /// How fast its bound grows, parts per 10⁹.
    pub drift_ppb: u32,
    /// What is still to be slewed, 1/256 µs.
    pub behind_steps: i64,
    /// Time since the root itself was heard, µs.
    pub age_us: u32,
    /// UNIX time less system time, µs, where a host offered it.
    pub unix_offset_us: Option<i64>,
    /// How often its time was set anew, at the first time included.
    pub steps: u16,
    /// How often its root changed.
    pub root_changes: u16,
}

/// Answer to [`Query::TimeLink`]: what is known of the clock at a gateway's other end, `[TIM-12]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TimeLink {
    /// Steps from the neighbour to its root; 255 without one, or where nothing was heard.
    pub tier: u8,
    /// Its root.
    pub root: UniqueId,
    /// Exchanges since the estimate began.
    pub exchanges: u32,
    /// Requests without an answer.
    pub unanswered: u32,
    /// Replies that were refused.
    pub refused: u32,
    /// Its system time less ours at the last exchange, 1/256 µs.
    pub offset_steps: i64,
    /// Its counter's rate against ours, parts per 10⁹.
    pub rate_ppb: i32,
    /// Last round trip, 1/256 µs.
    pub round_trip_steps: u32,
    /// Least round trip of late, 1/256 µs.
    pub round_trip_min_steps: u32,
    /// One standard deviation of the estimate, 1/256 µs.
    pub error_steps: u32,
    /// Greatest possible error of the estimate, 1/256 µs.
    pub bound_steps: u32,
    /// By how much the way there is longer than the way back, as set, 1/256 µs.
    pub asymmetry_steps: i32,
}

/// Body of [`Query::SetTimeAsymmetry`]: a calibration of all links of one type, `[TIM-13]`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TimeAsymmetry {
    /// Which type, such as `usb-cdc`.
    pub type_name: Name,
    /// By how much the way there is longer than the way back, 1/256 µs.
    pub asymmetry_steps: i32,
}

/// Links of which a device keeps what it knows.
pub const KEPT_LINKS_MAX: usize = 4;

/// What a clock keeps over a reset, `[TIM-17]`: no message, but as durable as one.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeptTime {
    /// Its settings.
    pub settings: TimeSettings,
    /// Its first links.
    pub links: heapless::Vec<KeptLink, KEPT_LINKS_MAX>,
}

/// What is kept of one link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeptLink {
    /// Which device was at its other end, and its counter's rate against ours, parts per 10⁹.
    pub peer: Option<(UniqueId, i32)>,
    /// As [`TimeAsymmetry::asymmetry_steps`].
    pub asymmetry_steps: i32,
}

impl KeptTime {
    /// Most bytes it takes: settings of 32, a length, and links of 1 + 12 + 5 + 5.
    pub const LEN_MAX: usize = 32 + 1 + KEPT_LINKS_MAX * 23;

    /// Writes it into `out`; its length, or `None` where it does not fit.
    pub fn encode(&self, out: &mut [u8]) -> Option<usize> {
        postcard::to_slice(self, out).ok().map(|bytes| bytes.len())
    }

    /// Reads one; `None` where it is none, or its settings are out of range.
    #[must_use]
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        match postcard::take_from_bytes::<Self>(bytes) {
            Ok((it, [])) if it.settings.in_range() => Some(it),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `[TIM-17]`: the stated length is the most there is; what was cut or is out of range is nothing.
    #[test]
    fn what_is_kept_comes_back() {
        let settings = TimeSettings {
            interval_us: 10_000_000,
            filter_q16: 65_536,
            proportional_q16: 1 << 24,
            integral_q16: 1 << 24,
            skew_limit_ppb: 20_000_000,
            gate_steps: i32::MAX,
            servo: ServoKind::Oldest,
            priority: 255,
        };
        let link = KeptLink { peer: Some((UniqueId([255; 12]), i32::MIN)), asymmetry_steps: i32::MIN };
        let kept = KeptTime { settings, links: core::iter::repeat_n(link, KEPT_LINKS_MAX).collect() };
        let mut out = [0; KeptTime::LEN_MAX];
        let len = kept.encode(&mut out).unwrap();
        assert_eq!(KeptTime::decode(&out[..len]), Some(kept.clone()));
        assert_eq!(KeptTime::decode(&out[..len - 1]), None);
        let bad = KeptTime { settings: TimeSettings { interval_us: 1, ..settings }, ..kept };
        let len = bad.encode(&mut out).unwrap();
        assert_eq!(KeptTime::decode(&out[..len]), None);
    }
}

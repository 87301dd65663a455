//! What a clock tells: its neighbours, whoever asks, and the settings' store.
//!
//! - **Walk:** the egress's replies; queries 9 and 12; debug pages; idle's keeper. **Invariant:** what is told is as of the instant given.
//! - **Context:** the node's. **Clauses:** `[TIM-02]`, `[TIM-12]`, `[TIM-15]`, `[TIM-17]`, `[DSC-07]`.

use super::{Clock, cut};
use crate::gateway::Gateway;
use crate::peer::Owed;
use fixed_math::time::{LocalTicks, PeerTicks, Rate, Span};
use osap_protocol::GatewayIndex;
use osap_protocol::discovery::{
    ClockMark, KEPT_LINKS_MAX, KeptLink, KeptTime, ServoKind, TimeControl, TimeSettings, TimeStatus,
};
use osap_protocol::time::{NO_BOUND, TimeReply};

/// How long a node is settled before its rates are kept for the first time, µs, and from then on from one time to the next.
const KEEP_FIRST_US: u64 = 10_000_000;
const KEEP_NEXT_US: u64 = 600_000_000;
/// A rate that has moved by less since it was kept is as good as kept, ppb.
const KEEP_MIN_PPB: u32 = 1_000;

impl Clock {
    /// The answer to a request, as of its arrival, `[TIM-02]`; `by_partner`: it is of whom this node asks there.
    pub(crate) fn reply(&self, owed: Owed, index: GatewayIndex, by_partner: bool, tick: Span) -> TimeReply {
        let Owed { sequence, asked_slot, heard, .. } = owed;
        let follows = self.settings.servo == ServoKind::Estimator;
        let (system, rate) = if follows {
            (self.estimate.line.system_at(heard), self.estimate.line.rate)
        } else {
            (self.map.system_at(heard), self.map.rate_at(heard))
        };
        let bound = if follows { self.estimate_bound_at(heard) } else { self.bound_at(heard) };
        // whoever goes on at the rate told goes away from the root by as much as that is off; a root that shims its own rate may turn round
        let strays = match self.settings.servo {
            ServoKind::Oldest if self.tier == 0 => {
                2 * Rate::from_ppb(self.settings.skew_limit_ppb).bits().unsigned_abs()
            }
            _ => rate.bits().abs_diff(self.estimate.line.rate.bits()),
        };
        let (age_us, news_at) = self.news;
        let age_us = if self.tier == 0 { 0 } else { u64::from(age_us) + heard.since(news_at).as_us_ceil() };
        TimeReply {
            sequence,
            asked_slot,
            heard: PeerTicks::from_steps(heard.steps()),
            system,
            rate,
            error_steps: cut(self.estimate.error.steps()),
            bound_steps: bound.map_or(NO_BOUND, |bound| cut(bound.steps())),
            drift_bits: self.estimate.drift.bits().unsigned_abs().saturating_add(strays),
            age_us: cut(age_us),
            tick_steps: u16::try_from(tick.steps()).unwrap_or(u16::MAX),
            tier: self.tier,
            root: self.root,
            is_yours: by_partner && self.sources & 1 << index.get() != 0,
            is_settled: self.is_settled,
            is_rc: self.is_rc(),
            unix: self.unix.filter(|_| self.unix_from != Some(index)),
            answered_slot: 0,
        }
    }

    /// All that query 9 tells, at `now`.
    #[must_use]
    pub(crate) fn control(&self, gateways: &[Gateway], now: LocalTicks) -> TimeControl {
        let TimeSettings {
            interval_us, filter_q16, proportional_q16, integral_q16, skew_limit_ppb, gate_steps, ..
        } = self.settings;
        let source = gateways.get(self.sources.trailing_zeros() as usize).map(|gateway| &gateway.peer);
        let system = self.map.system_at(now);
        TimeControl {
            system_time_steps: system.steps(),
            local_ticks_steps: now.steps(),
            interval_us,
            offset_steps: source.map_or(0, |peer| clamp(peer.offset_steps)),
            skew_ppb: self.map.rate_at(now).ppb(),
            bound_steps: self.bound_of(system, now).map_or(-1, |bound| clamp(bound.steps().cast_signed())),
            round_trip_steps: source.map_or(0, |peer| clamp(peer.link.round_trip().steps().cast_signed())),
            round_trip_min_steps: source.map_or(0, |peer| clamp(peer.link.round_trip_min().steps().cast_signed())),
            filter_q16,
            proportional_q16,
            integral_q16,
            skew_limit_ppb,
            gate_steps,
            tier: self.tier,
        }
    }

    /// All that query 12 tells, at `now`, `[TIM-12]`.
    #[must_use]
    pub(crate) fn status(&self, now: LocalTicks) -> TimeStatus {
        let (age_us, at) = self.news;
        TimeStatus {
            settings: self.settings,
            tier: self.tier,
            root_priority: self.root.priority,
            root: self.root.unique_id,
            is_settled: self.is_settled,
            is_live: self.is_live,
            sources: self.sources,
            error_steps: cut(self.estimate.error.steps()),
            drift_ppb: self.estimate.drift.ppb().unsigned_abs(),
            behind_steps: self.estimate.line.system_at(now).steps_after(self.map.system_at(now)),
            age_us: if self.tier == 0 { 0 } else { cut(u64::from(age_us) + now.since(at).as_us_ceil()) },
            unix_offset_us: self.unix_offset_us(),
            steps: self.steps,
            root_changes: self.root_changes,
        }
    }

    /// What is to outlast a reset, where it has changed since it was last taken, `[TIM-17]`: seldom, as flash wears.
    pub(crate) fn take_to_keep(&mut self, gateways: &mut [Gateway], now: LocalTicks) -> Option<KeptTime> {
        let due_us = if self.kept_at.is_some() { KEEP_NEXT_US } else { KEEP_FIRST_US };
        let last = self.kept_at.unwrap_or(self.since);
        let may_rates = self.is_settled && now.since(last) >= Span::from_us(due_us);
        let moved = |gateway: &Gateway| gateway.peer.rate_moved(KEEP_MIN_PPB);
        let has_rates = may_rates && gateways.iter().any(moved);
        if !self.is_changed && !has_rates {
            return None;
        }
        self.is_changed = false;
        if may_rates {
            self.kept_at = Some(now);
            for gateway in &mut *gateways {
                gateway.peer.keep_rate();
            }
        }
        let links = gateways.iter().take(KEPT_LINKS_MAX).map(|gateway| KeptLink {
            peer: gateway.peer.kept.map(|(of, rate)| (of, rate.ppb())),
            asymmetry_steps: gateway.peer.asymmetry_steps,
        });
        Some(KeptTime { settings: self.settings, links: links.collect() })
    }

    /// Both clocks at `now`, where time is settled, `[TIM-15]`.
    #[must_use]
    pub(crate) fn mark(&self, now: LocalTicks) -> Option<ClockMark> {
        let system = self.map.system_at(now);
        let bound = self.bound_of(system, now)?;
        Some(ClockMark {
            local_steps: now.steps(),
            system_steps: system.steps(),
            rate_ppb: self.map.rate_at(now).ppb(),
            bound_steps: cut(bound.steps()),
        })
    }
}

fn clamp(value: i64) -> i32 {
    i32::try_from(value).unwrap_or(if value < 0 { i32::MIN } else { i32::MAX })
}

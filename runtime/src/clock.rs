//! The node's time controller: its settings, and what it can say of system time.
//!
//! - **Walk:** queries 9 and 10. **Invariant:** settings are within their ranges, whatever is asked.
//! - **Clauses:** `[DSC-02]`, `[DSC-07]`.
//!
//! Until clocks are disciplined a node says so: its tier is [`TIER_FREE_RUNNING`] and it gives no bound.

use fixed_math::time::LocalTicks;
use osap_protocol::discovery::{Refusal, TIER_FREE_RUNNING, TimeControl, TimeSettings};

/// Settings of a new node: the thesis's 50 ms between exchanges, a quarter of each new offset into the average.
pub const DEFAULT_SETTINGS: TimeSettings = TimeSettings {
    interval_us: 50_000,
    filter_q16: 16_384,
    proportional_q16: 6_554,
    integral_q16: 655,
    skew_limit_ppb: 500_000,
    gate_steps: 256 * 10_000,
};

/// A node's time controller.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    settings: TimeSettings,
}

impl Clock {
    /// Free running, with [`DEFAULT_SETTINGS`].
    #[must_use]
    pub const fn new() -> Self {
        Self { settings: DEFAULT_SETTINGS }
    }

    /// Takes new settings.
    ///
    /// # Errors
    /// [`Refusal::Range`] where one is outside its range; nothing is changed then.
    pub fn set(&mut self, settings: TimeSettings) -> Result<(), Refusal> {
        if settings.in_range() {
            self.settings = settings;
            Ok(())
        } else {
            Err(Refusal::Range)
        }
    }

    /// All that is known at `now`.
    #[must_use]
    pub fn control(&self, now: LocalTicks) -> TimeControl {
        let TimeSettings { interval_us, filter_q16, proportional_q16, integral_q16, skew_limit_ppb, gate_steps } =
            self.settings;
        TimeControl {
            system_time_steps: now.steps(),
            local_ticks_steps: now.steps(),
            interval_us,
            offset_steps: 0,
            skew_ppb: 0,
            bound_steps: -1,
            round_trip_steps: 0,
            round_trip_min_steps: 0,
            filter_q16,
            proportional_q16,
            integral_q16,
            skew_limit_ppb,
            gate_steps,
            tier: TIER_FREE_RUNNING,
        }
    }
}

impl Default for Clock {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `[DSC-02]`: out of range is refused and changes nothing.
    #[test]
    fn settings_out_of_range_change_nothing() {
        let mut clock = Clock::new();
        for bad in [
            TimeSettings { interval_us: 999, ..DEFAULT_SETTINGS },
            TimeSettings { filter_q16: 0, ..DEFAULT_SETTINGS },
            TimeSettings { skew_limit_ppb: -1, ..DEFAULT_SETTINGS },
            TimeSettings { gate_steps: -1, ..DEFAULT_SETTINGS },
        ] {
            assert_eq!(clock.set(bad), Err(Refusal::Range));
            assert_eq!(clock.control(LocalTicks::ZERO).interval_us, DEFAULT_SETTINGS.interval_us);
        }
        clock.set(TimeSettings { interval_us: 10_000, ..DEFAULT_SETTINGS }).unwrap();
        assert_eq!(clock.control(LocalTicks::ZERO).interval_us, 10_000);
    }
}

//! Beats that fall on multiples of their period in system time, on every device.
//!
//! - **Walk:** a timer wraps → its interrupt → [`BeatLock::wrapped`] with the system time of the wrap → the period to set, and the grid time
//!   for which this beat's output was meant.
//! - **Invariants:** the period stays within one part in [`TRIM_PART`] of the nominal one, whatever the times say. The grid time never
//!   goes back.
//! - **Context:** the highest-priority task; one 32-bit product, no division.
//!
//! A period that is set at one wrap runs from the next one on, so the loop has one beat of delay. It is proportional by 1/8 and integral by
//! 1/256 a beat, which is close to critical damping; a cycle's fraction is carried over to the next beat, so that the mean period is as
//! exact as the integral.

use fixed_math::time::NetTime;

/// The period is trimmed by at most one part in so many.
pub const TRIM_PART: u32 = 16;
/// A beat is off by less, steps of 1/256 µs: one microsecond.
pub const LOCK_STEPS: u32 = 256;
/// Beats in a row that have to be, for the lock to be told.
pub const LOCK_BEATS: u8 = 16;

/// What to do at a beat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Beat {
    /// The multiple of the period next to the wrap: what this beat stands for.
    pub grid: NetTime,
    /// The period that begins with the next wrap, cycles of the counter.
    pub period_cycles: u32,
    /// How late the wrap was, steps of 1/256 µs; negative if early.
    pub late_steps: i32,
    /// The last [`LOCK_BEATS`] were within [`LOCK_STEPS`].
    pub is_locked: bool,
}

/// Locks the wraps of a counter to system time.
#[derive(Clone, Copy, Debug)]
pub struct BeatLock {
    /// A period is 2 to this, µs.
    period_log2: u32,
    nominal_cycles: u32,
    /// Sum of what is late, 2^−16 cycles.
    integral: i32,
    /// What was left of the last trim, 2^−16 cycles.
    rest: i32,
    within: u8,
    grid: NetTime,
}

impl BeatLock {
    /// Beats of 2^`period_log2` µs, 3 to 6, that take `nominal_cycles`, at most 2^15, of the counter. `None` where one is out of range.
    #[must_use]
    pub const fn new(period_log2: u32, nominal_cycles: u32) -> Option<Self> {
        if period_log2 < 3 || period_log2 > 6 || nominal_cycles < TRIM_PART || nominal_cycles > 1 << 15 {
            return None;
        }
        Some(Self { period_log2, nominal_cycles, integral: 0, rest: 0, within: 0, grid: NetTime::ZERO })
    }

    /// The counter wrapped at `system`.
    pub fn wrapped(&mut self, system: NetTime) -> Beat {
        let period = 1 << (self.period_log2 + fixed_math::time::FRACTION_BITS);
        let nearest = (system.steps().saturating_add(period / 2)) & !(period - 1);
        // at most half a period: 2^13 steps
        #[expect(clippy::cast_possible_truncation, reason = "as said above")]
        let late_steps = system.steps_after(NetTime::from_steps(nearest)) as i32;
        self.within = if late_steps.unsigned_abs() < LOCK_STEPS { (self.within + 1).min(LOCK_BEATS) } else { 0 };
        self.grid = self.grid.max(NetTime::from_steps(nearest));
        let trim = self.trim(late_steps);
        Beat {
            grid: self.grid,
            period_cycles: self.nominal_cycles.saturating_add_signed(trim),
            late_steps,
            is_locked: self.within >= LOCK_BEATS,
        }
    }

    /// Cycles that the next period is longer.
    fn trim(&mut self, late_steps: i32) -> i32 {
        let nominal = self.nominal_cycles.cast_signed();
        // 2^13 · 2^15 over 2^n: late by so many cycles, 2^−8
        let late = (late_steps * nominal) >> self.period_log2;
        let integral = self.integral - late;
        // of 1/8 a 2^−8 makes 2^−16 by 2^5
        let wanted = integral.saturating_sub(late.saturating_mul(1 << 5)).saturating_add(self.rest);
        let most = nominal / TRIM_PART.cast_signed();
        let trim = wanted >> 16;
        if trim.abs() > most {
            // far off: neither the integral nor what is left means anything
            self.rest = 0;
            return trim.clamp(-most, most);
        }
        self.integral = integral;
        self.rest = wanted & 0xffff;
        trim
    }
}

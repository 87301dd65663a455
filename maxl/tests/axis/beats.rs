//! Beats against a counter that is off, stamps that are rounded, and a system time that is slewed.
#![expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the truth is kept in floating point")]

use fixed_math::time::NetTime;
use osap_maxl::beat::{BeatLock, LOCK_STEPS, TRIM_PART};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Steps of 1/256 µs that a stamp is rounded down to.
const STAMP_STEPS: f64 = 16.0;

struct Course {
    /// Beats until the lock was told.
    locked_after: usize,
    /// Greatest distance of a true wrap from the grid after 200 more beats, steps.
    worst_steps: f64,
    is_locked_at_the_end: bool,
}

/// Runs 20,000 beats; `slew` is how much faster system time runs than true time from the middle on.
fn run(period_log2: u32, cycles_a_us: u32, counter_ppm: f64, phase: f64, slew: f64, seed: u64) -> Course {
    let nominal = cycles_a_us << period_log2;
    let mut lock = BeatLock::new(period_log2, nominal).unwrap();
    let mut rng = Pcg64::seed_from_u64(seed);
    let period_steps = f64::from(256u32 << period_log2);
    // steps of true time in a cycle
    let cycle = 256.0 / f64::from(cycles_a_us) / (1.0 + counter_ppm * 1e-6);
    let mut system = 1e9 * period_steps + phase * period_steps;
    let mut running = nominal;
    let (mut locked_after, mut worst, mut grid, mut is_locked) = (usize::MAX, 0.0_f64, NetTime::ZERO, false);
    for at in 0..20_000 {
        // read a moment after the wrap, rounded down, as a board does
        let stamp = (system / STAMP_STEPS).floor() * STAMP_STEPS + rng.random_range(0.0..STAMP_STEPS);
        let beat = lock.wrapped(NetTime::from_steps(stamp as u64));
        assert!(beat.grid >= grid, "the grid went back");
        assert_eq!(beat.grid.steps() % (256 << period_log2), 0);
        assert!(beat.period_cycles.abs_diff(nominal) <= nominal / TRIM_PART);
        (grid, is_locked) = (beat.grid, beat.is_locked);
        if beat.is_locked {
            locked_after = locked_after.min(at);
        }
        let off = system - (system / period_steps).round() * period_steps;
        if at > locked_after.saturating_add(200) {
            worst = worst.max(off.abs());
            assert_eq!(beat.grid.steps(), (system / period_steps).round() as u64 * (256 << period_log2), "beat {at}");
        }
        let rate = if at > 10_000 { 1.0 + slew } else { 1.0 };
        system += f64::from(running) * cycle * rate;
        running = beat.period_cycles;
    }
    Course { locked_after, worst_steps: worst, is_locked_at_the_end: is_locked }
}

/// All periods, counters of ±100 ppm, any phase: locked within 400 beats, and then within a quarter of a microsecond.
#[test]
fn beats_lock_to_system_time() {
    let (mut slowest, mut worst) = (0, 0.0_f64);
    for period_log2 in 3..=6 {
        for cycles_a_us in [25, 48, 125, 480] {
            for (seed, ppm) in [(1, -100.0), (2, 0.0), (3, 100.0)] {
                for phase in [0.0, 0.25, 0.499, 0.75] {
                    let course = run(period_log2, cycles_a_us, ppm, phase, 0.0, seed);
                    assert!(course.is_locked_at_the_end);
                    slowest = slowest.max(course.locked_after);
                    worst = worst.max(course.worst_steps);
                }
            }
        }
    }
    println!("locked within {slowest} beats, then within {:.3} us", worst / 256.0);
    assert!(slowest <= 400, "{slowest} beats");
    assert!(worst <= 64.0, "{worst} steps");
}

/// System time that begins to be slewed by 500 ppm: 32 ns a beat of 64 µs, which the integral takes up; it stays locked.
#[test]
fn beats_follow_a_slew() {
    for slew in [-500e-6, 500e-6] {
        let course = run(6, 125, 40.0, 0.1, slew, 4);
        println!("slewed by {slew}: within {:.3} us", course.worst_steps / 256.0);
        assert!(course.is_locked_at_the_end && course.worst_steps < f64::from(LOCK_STEPS), "{}", course.worst_steps);
    }
}

/// A system time that jumps: the lock is lost and found again, and the grid does not go back.
#[test]
fn a_jump_unlocks() {
    let mut lock = BeatLock::new(6, 8_000).unwrap();
    let period = 64 * 256;
    assert!((0..20).map(|at| lock.wrapped(NetTime::from_steps(at * period))).last().unwrap().is_locked);
    let off = lock.wrapped(NetTime::from_steps(20 * period + period / 3));
    assert!(!off.is_locked && off.late_steps == i32::try_from(period / 3).unwrap());
    // late by 2666.5 cycles: an eighth and a 256th of them are 343.7
    assert_eq!(off.period_cycles, 8_000 - 344);
    let back = lock.wrapped(NetTime::from_steps(3 * period));
    assert_eq!(back.grid, NetTime::from_steps(20 * period), "it waits for time to come back");
    assert!(BeatLock::new(2, 8_000).is_none() && BeatLock::new(7, 8_000).is_none());
    assert!(BeatLock::new(6, 1 << 16).is_none() && BeatLock::new(6, 1).is_none());
}

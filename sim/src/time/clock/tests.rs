//! Readings worked out by hand, and properties against the definitions.

use super::*;
use proptest::prelude::*;

const SECOND: u64 = 1_000_000;

/// `[NOD-12]`: 50 ppm is 50 µs a second, to the step.
#[test]
fn fifty_ppm_are_fifty_microseconds_a_second() {
    for (rate_ppm, expected_us) in [(50.0, 1_000_050), (-50.0, 999_950), (0.0, 1_000_000)] {
        let clock = Clock::new(ClockModel::off_by(rate_ppm), TrueTime::ZERO);
        let off = clock.local(TrueTime::from_us(SECOND)).steps().abs_diff(expected_us << 8);
        assert!(off <= 1, "{rate_ppm} ppm: {off} steps off");
    }
}

/// ½ · 2 ppm/s · (2 s)² is 4 µs; then the ramp turns at 4 ppm, takes 2 s back to nought, and its half below eats up what was won. Steps of
/// a tenth of a second lose ½ · 0.2 ppm · 0.1 s each: 0.2 µs of the first 4.
#[test]
fn a_ramp_is_a_parabola_and_turns_round() {
    let model = ClockModel { ramp: Ramp { ppm_per_s: 2.0, ppm_max: 4.0 }, ..ClockModel::PERFECT };
    let up = Clock::new(model, TrueTime::ZERO);
    let down = Clock::new(ClockModel { ramp: Ramp { ppm_per_s: -2.0, ..model.ramp }, ..model }, TrueTime::ZERO);
    for (after_s, gained_steps) in [(0, 0i64), (2, 1024), (4, 2048), (6, 1024), (8, 0), (10, 1024)] {
        let at = TrueTime::from_us(after_s * SECOND);
        for (clock, gained_steps) in [(up, gained_steps), (down, -gained_steps)] {
            let gained = clock.local(at).steps().cast_signed() - at.steps().cast_signed();
            assert!((gained - gained_steps).abs() <= 52, "{gained} steps after {after_s} s, not {gained_steps}");
        }
    }
}

#[test]
fn a_step_of_rate_begins_at_its_time_and_stays() {
    let step = RateStep { at: TrueTime::from_us(2 * SECOND - 1), ppm: -30.0 };
    let clock = Clock::new(ClockModel { step, ..ClockModel::PERFECT }, TrueTime::ZERO);
    for (after_s, lost_us) in [(1, 0), (2, 0), (3, 30), (12, 300)] {
        let at = TrueTime::from_us(after_s * SECOND);
        assert_eq!(clock.local(at).steps().div_ceil(256), at.as_us() - lost_us);
    }
}

/// A timer of 1 µs counts whole ones, from whatever it began at.
#[test]
fn readings_are_whole_ticks() {
    let clock = Clock::new(ClockModel { tick: Span::from_us(1), offset_us: 5, ..ClockModel::PERFECT }, TrueTime::ZERO);
    for (steps, reads_us) in [(0, 5), (255, 5), (256, 6), (511, 6), (25_600, 105)] {
        assert_eq!(clock.local(TrueTime::from_steps(steps)), LocalTicks::from_us(reads_us));
        assert_eq!(clock.exact(TrueTime::from_steps(steps)).steps(), steps + (5 << 8));
    }
    assert_eq!(clock.truth(LocalTicks::from_steps((6 << 8) + 1)), TrueTime::from_us(2));
}

/// A reset begins the count at zero and leaves the crystal alone: what the clock counts from then on is what it would have counted.
#[test]
fn a_reset_does_not_change_the_crystal() {
    let ramp = Ramp { ppm_per_s: 5.0, ppm_max: 20.0 };
    let model = ClockModel {
        rate_ppm: 30.0,
        ramp,
        wander: Wander { ppm_max: 9.0, period_s: 3.0, seed: 4 },
        ..ClockModel::PERFECT
    };
    let clock = Clock::new(model, TrueTime::ZERO);
    let reset = TrueTime::from_us(3_333_333);
    let after = clock.restarted(reset);
    assert_eq!(after.local(reset), LocalTicks::ZERO);
    let later = TrueTime::from_us(9_876_543);
    let passed = clock.local(later).since(clock.local(reset)).steps();
    assert!(after.local(later).steps().abs_diff(passed) <= 1);
}

/// A wander stays within its bound, gets at least half way there, and is another with another seed.
#[test]
fn a_wander_is_bounded_seeded_and_not_nothing() {
    let rates = |seed| {
        let wander = Wander { ppm_max: 1_000.0, period_s: 20.0, seed };
        let clock = Clock::new(ClockModel { wander, ..ClockModel::PERFECT }, TrueTime::ZERO);
        let reading = |n: u64| clock.local(TrueTime::from_us(n * 100_000)).steps();
        (0..1_000).map(|n| reading(n + 1) - reading(n)).collect::<Vec<u64>>()
    };
    let first = rates(1);
    // 100 ms are 25.6 million steps, 1,000 ppm of them 25,600; a reading's rounding is one more
    let off = first.iter().map(|steps| steps.abs_diff(25_600_000)).max().unwrap();
    assert!((12_800..=25_601).contains(&off), "{off}");
    assert_ne!(first, rates(2));
    let sum: u64 = first.iter().sum();
    // five slow periods cancel; a part of a ramp wins at most peak · period / 4: 333 ppm · 7.64 s / 4 and 167 ppm · 2.92 s / 4, 758 µs
    assert!(sum.abs_diff(25_600_000_000) < 758 << 8, "{sum}");
}

fn any_model() -> impl Strategy<Value = ClockModel> {
    let ramp = (-2e3..2e3, 0.0..6e4).prop_map(|(ppm_per_s, ppm_max)| Ramp { ppm_per_s, ppm_max });
    let wander =
        (0.0..6e4, 0.1..1e3, any::<u64>()).prop_map(|(ppm_max, period_s, seed)| Wander { ppm_max, period_s, seed });
    let step = (0u64..1 << 50, -6e4..6e4).prop_map(|(at, ppm)| RateStep { at: TrueTime::from_steps(at), ppm });
    let maybe = (prop::option::of(ramp), prop::option::of(wander), prop::option::of(step));
    (-5e5..5e5, 0u64..1 << 54, prop_oneof![Just(0), 1u64..2_000], maybe).prop_map(
        |(rate_ppm, offset_us, tick, (ramp, wander, step))| ClockModel {
            rate_ppm,
            offset_us,
            tick: Span::from_steps(tick),
            ramp: ramp.unwrap_or_default(),
            wander: wander.unwrap_or_default(),
            step: step.unwrap_or_default(),
        },
    )
}

proptest! {
    /// A wake at `truth(local)` finds its time come, and one step earlier it would not have.
    #[test]
    fn truth_is_the_first_instant(model in any_model(), origin in 0u64..1 << 50, after in prop_oneof![1u64..1 << 30, 1u64..1 << 55]) {
        let clock = Clock::new(model, TrueTime::from_steps(origin));
        let first = clock.local(TrueTime::from_steps(origin)).steps();
        let local = LocalTicks::from_steps(first + model.tick.steps() + after);
        let at = clock.truth(local);
        prop_assert!(clock.local(at) >= local);
        prop_assert!(clock.local(at.before(Span::from_steps(1))) < local);
    }

    #[test]
    fn clocks_never_run_backwards(model in any_model(), at in 0u64..1 << 60, step in 0u64..1 << 34) {
        let clock = Clock::new(model, TrueTime::ZERO);
        let [before, after] = [at, at + step].map(|at| clock.exact(TrueTime::from_steps(at)).steps());
        prop_assert!(before <= after);
        // nor faster or slower than the bounds of all its deviations together, but for rounding
        let slowest = u128::from(step) * 35 / 100;
        let fastest = u128::from(step) * 165 / 100 + 1;
        prop_assert!((slowest..=fastest).contains(&u128::from(after - before)));
    }

    /// The sums in closed form are the sums.
    #[test]
    fn a_triangles_sum_is_the_sum_of_its_values(ppm_max in 1.0..5e4, half_s in 0.1..30.0, share in 0.0..1.0, n in 0i64..900) {
        let it = Triangle::new(ppm_max, half_s, share);
        let added: i128 = (0..n).map(|n| it.at(n).0).sum();
        prop_assert_eq!(it.at(n).1, added);
    }

    /// Clocks that begin shortly before the end of all times stand still there.
    #[test]
    fn no_reading_is_beyond_the_last(offset_us in (1u64 << 56) - 1_000..1 << 56, at in any::<u64>(), local in any::<u64>()) {
        let clock = Clock::new(ClockModel { offset_us, ..ClockModel::off_by(1e5) }, TrueTime::ZERO);
        prop_assert!(clock.local(TrueTime::from_steps(at)).steps() >= offset_us << 8);
        let _any = clock.truth(LocalTicks::from_steps(local));
    }
}

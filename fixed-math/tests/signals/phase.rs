//! Phases and currents against double precision, all of them.

use core::f64::consts::{FRAC_PI_2, TAU};
use fixed_math::phase::{Coils, PHASES, Phase, PhaseError, PhaseWindow, SINE_ONE};
use proptest::prelude::*;

fn angle(phase: u32) -> f64 {
    f64::from(phase) / f64::from(PHASES) * TAU
}

/// Half of one from the table's rounding, half from the line's, and the chord's 32767·(2π/4096)²/8 = 0.0097.
const SINE_BOUND: f64 = 1.01;

#[test]
fn every_sine_and_cosine_is_within_its_bound() {
    let mut worst: f64 = 0.0;
    for phase in 0..PHASES {
        let (cosine, sine) = Phase::new(phase).cosine_sine();
        let off_sine = f64::from(sine) - f64::from(SINE_ONE) * angle(phase).sin();
        let off_cosine = f64::from(cosine) - f64::from(SINE_ONE) * angle(phase).cos();
        worst = worst.max(off_sine.abs()).max(off_cosine.abs());
        assert!(off_sine.abs() <= SINE_BOUND && off_cosine.abs() <= SINE_BOUND, "{phase}: {sine}, {cosine}");
    }
    println!("worst error of a sine: {worst:.3} of 32767");
}

/// The table's own values, each fourth phase, are the nearest there are.
#[test]
fn the_tables_values_are_the_nearest() {
    for phase in (0..PHASES).step_by(4) {
        let exact = f64::from(SINE_ONE) * angle(phase).sin();
        assert!((f64::from(Phase::new(phase).cosine_sine().1) - exact).abs() <= 0.5 + 1e-9, "{phase}");
    }
}

/// Opposite phases are opposite to the bit, so a motor has no bias; and a quarter ahead, the sine is the cosine.
#[test]
fn quarters_are_alike_to_the_bit() {
    for phase in 0..PHASES {
        let (cosine, sine) = Phase::new(phase).cosine_sine();
        let opposite = Phase::new(phase + PHASES / 2).cosine_sine();
        assert_eq!(opposite, (-cosine, -sine), "{phase}");
        assert_eq!(Phase::new(phase).quarter_ahead().cosine_sine(), (-sine, cosine), "{phase}");
        assert_eq!(Phase::new(PHASES - phase).cosine_sine(), (cosine, -sine), "{phase}");
    }
}

/// The sine rises in the first and last quarter and falls between.
#[test]
fn the_sine_is_monotone_in_its_quarters() {
    let sine = |phase: u32| Phase::new(phase).cosine_sine().1;
    let quarter = PHASES / 4;
    assert!((0..quarter).all(|phase| sine(phase) <= sine(phase + 1)));
    assert!((quarter..3 * quarter).all(|phase| sine(phase) >= sine(phase + 1)));
    assert_eq!([0, quarter, 2 * quarter, 3 * quarter].map(sine), [0, SINE_ONE, 0, -SINE_ONE]);
}

#[test]
fn turns_that_no_position_has_are_refused() {
    for turn_log2 in [0, 1, 33, u32::MAX] {
        assert_eq!(PhaseWindow::new(turn_log2, 0), Err(PhaseError::TurnLog2 { turn_log2 }));
    }
    assert!(PhaseWindow::new(2, 0).is_ok() && PhaseWindow::new(32, 0).is_ok());
}

/// Turns shorter than 16,384 LSB skip phases, longer ones hold each for some.
#[test]
fn hand_worked_windows() {
    let short = PhaseWindow::new(2, 0).unwrap();
    assert_eq!([0, 1, 2, 3, 4, -1].map(|at| short.phase(at).get()), [0, 4096, 8192, 12_288, 0, 12_288]);
    let long = PhaseWindow::new(16, 0).unwrap();
    assert_eq!([3, 4, 65_535, 65_536].map(|at| long.phase(at).get()), [0, 1, 16_383, 0]);
    let aligned = long.aligned(1_000, Phase::new(5_000));
    assert_eq!(aligned.phase(1_000).get(), 5_000);
    assert_eq!(aligned.phase(1_004).get(), 5_001);
}

/// Torque one way pulls a quarter ahead, the other way a quarter behind, and none not at all.
#[test]
fn torque_pulls_to_its_side() {
    for phase in (0..PHASES).step_by(37).map(Phase::new) {
        let (ahead, behind) = (Coils::for_torque(phase, 20_000), Coils::for_torque(phase, -20_000));
        assert_eq!(ahead, Coils::at(phase.quarter_ahead(), 40_000));
        // halves are rounded up on both sides, so opposite to one
        assert!((ahead.a + behind.a).abs() <= 1 && (ahead.b + behind.b).abs() <= 1);
        assert_eq!(Coils::for_torque(phase, 0), Coils { a: 0, b: 0 });
        assert_eq!(Coils::for_torque(phase, i32::MIN), Coils::for_torque(phase, -SINE_ONE));
        assert_eq!(Coils::for_torque(phase, i32::MAX), Coils::for_torque(phase, SINE_ONE));
    }
}

proptest! {
    /// The angle is the position's remainder in the turn, rounded down to a phase; wrapping does no harm.
    #[test]
    fn a_phase_is_the_positions_remainder(position in any::<i32>(), turn_log2 in 2u32..=32, offset in any::<u32>()) {
        let phase = PhaseWindow::new(turn_log2, offset).unwrap().phase(position);
        let turns_q32 = ((i128::from(position) << 32) >> turn_log2) + i128::from(offset);
        let expected = (turns_q32.rem_euclid(1 << 32) * i128::from(PHASES)) >> 32;
        prop_assert_eq!(i128::from(phase.get()), expected);
    }

    /// A current is off by its share of the sine's bound and half of one for its own rounding.
    #[test]
    fn currents_are_within_their_bound(phase in 0..PHASES, amplitude in any::<u16>()) {
        let coils = Coils::at(Phase::new(phase), amplitude);
        let scale = f64::from(amplitude) / 65_536.0;
        let bound = SINE_BOUND * scale + 0.5;
        let exact_a = f64::from(SINE_ONE) * scale * (angle(phase) + FRAC_PI_2).sin();
        let exact_b = f64::from(SINE_ONE) * scale * angle(phase).sin();
        prop_assert!((f64::from(coils.a) - exact_a).abs() <= bound, "{coils:?} for {exact_a}");
        prop_assert!((f64::from(coils.b) - exact_b).abs() <= bound, "{coils:?} for {exact_b}");
    }
}

//! Steps against a model in long integers that knows nothing of bits, wraps or unsigned comparisons.

use fixed_math::spline::differences::Differences;
use fixed_math::steps::{Direction, Quadrature, Step, StepBits, StepThresholds, StepsError};
use proptest::prelude::*;

/// The rule as it is written: up at k·step, down at k·step − hysteresis, one a beat, the direction a beat before.
struct Model {
    at: i128,
    step: i128,
    hysteresis: i128,
    is_up: bool,
    backlog: i128,
    missed: i128,
}

impl Model {
    fn new(at: i128, step: i128, hysteresis: i128) -> Self {
        Self { at, step, hysteresis, is_up: true, backlog: 0, missed: 0 }
    }

    /// Steps due: above nought up, below nought down.
    fn due(&self, position: i128) -> i128 {
        let mut due = 0;
        while position >= (self.at + due + 1) * self.step {
            due += 1;
        }
        while position < (self.at + due) * self.step - self.hysteresis {
            due -= 1;
        }
        due
    }

    fn update(&mut self, position: i128) -> Step {
        let due = self.due(position);
        let backlog = (due.abs() - 1).max(0);
        self.missed += (backlog - self.backlog).max(0);
        self.backlog = backlog;
        let mut is_step = false;
        if due != 0 {
            is_step = self.is_up == (due > 0);
            self.is_up = due > 0;
            if is_step {
                self.at += due.signum();
            }
        }
        let direction = if self.is_up { Direction::Up } else { Direction::Down };
        Step { is_step, direction, is_behind: due.abs() > 1 }
    }
}

/// A step's bits, its hysteresis, a start, and movements of up to some steps a beat.
fn walk() -> impl Strategy<Value = (u32, u32, i32, Vec<i32>)> {
    (1u32..=16).prop_flat_map(|log2| {
        let far = 3 << log2;
        let near = (1i32 << log2) / 3 + 1;
        let movement = prop_oneof![-near..=near, -2..=2, -far..=far];
        let movements = proptest::collection::vec(movement, 1..200);
        (Just(log2), 0..1u32 << log2, -1_000_000_000..1_000_000_000, movements)
    })
}

/// Step 4, hysteresis 1, by hand: up at 4, 8, …; 4 is left below 3.
#[test]
fn hand_worked_steps() {
    let mut steps = StepBits::new(2, 1, 0).unwrap();
    let step = |is_step, direction, is_behind| Step { is_step, direction, is_behind };
    let (up, down) = (Direction::Up, Direction::Down);
    let positions = [3, 4, 3, 2, 2, 2, 7, 7, 7, 20, 20, 20, 20, 20];
    let seen = positions.map(|position| steps.update(position));
    let expected = [
        step(false, up, false),
        step(true, up, false),
        step(false, up, false),   // 3 ≥ 4 − 1
        step(false, down, false), // due, and the direction first
        step(true, down, false),
        step(false, down, false),
        step(false, up, false), // 4 is due again
        step(true, up, false),
        step(false, up, false),
        step(true, up, true), // 8, 12, 16 and 20 are due at once
        step(true, up, true),
        step(true, up, true),
        step(true, up, false),
        step(false, up, false),
    ];
    assert_eq!(seen, expected);
    assert_eq!((steps.at(), steps.backlog(), steps.missed()), (5, 0, 3));
    // the same by thresholds, from a base of 5 LSB in 96ths
    let mut steps = StepThresholds::new(2, 1, 0, 5, 96).unwrap();
    assert_eq!(positions.map(|position| steps.update((i64::from(position) - 5) * 96)), expected);
    assert_eq!(steps.at(), 5);
}

#[test]
fn what_makes_no_steps_is_refused_with_its_operands() {
    for step_log2 in [0, 31, u32::MAX] {
        assert_eq!(StepBits::new(step_log2, 0, 0), Err(StepsError::StepLog2 { step_log2 }));
        assert_eq!(StepThresholds::new(step_log2, 0, 0, 0, 6), Err(StepsError::StepLog2 { step_log2 }));
    }
    assert_eq!(StepBits::new(3, 8, 0), Err(StepsError::Hysteresis { hysteresis: 8, step: 8 }));
    assert!(StepBits::new(3, 7, 0).is_ok() && StepBits::new(30, 0, i32::MIN).is_ok());
    for scale in [0, -1, i64::MAX, i64::MAX / 16] {
        assert_eq!(StepThresholds::new(3, 0, 0, 0, scale), Err(StepsError::Scale { scale, step: 8 }));
    }
    // 2^62 units away is within reach, and more is not
    let scale = 6 << 33;
    let reach = (1i64 << 62) / scale / 8;
    let at = i32::try_from(reach).unwrap();
    assert!(StepThresholds::new(3, 0, at, 0, scale).is_ok());
    let mut steps = StepThresholds::new(3, 0, at, 8, scale).unwrap();
    let before = steps;
    assert_eq!(steps.rebase(-9), Err(StepsError::TooFar { at, base: -9 }));
    assert_eq!(steps, before);
    assert_eq!(StepThresholds::new(3, 0, i32::MAX, 0, scale), Err(StepsError::TooFar { at: i32::MAX, base: 0 }));
}

#[test]
fn a_quarter_of_a_step_is_a_hysteresis() {
    assert_eq!([0, 1, 2, 8, 30, 31].map(StepBits::quarter), [0, 0, 1, 64, 1 << 28, 0]);
}

/// Positions that wrap step on: four steps up over the seam and back.
#[test]
fn positions_that_wrap_step_on() {
    let start = i32::MAX - 7;
    let mut steps = StepBits::new(2, 1, start).unwrap();
    let first = steps.at();
    let up = (1..=16).filter(|by| steps.update(start.wrapping_add(*by)).is_step).count();
    assert_eq!((up, steps.at()), (4, first.wrapping_add(4)));
    let down = (0..=16).rev().filter(|by| steps.update(start.wrapping_add(*by)).is_step).count();
    assert_eq!((down, steps.at()), (4, first));
}

/// Of the two lines one changes at each step, and a comes first upwards.
#[test]
fn quadrature_changes_one_line_a_step() {
    let lines = [(false, false), (true, false), (true, true), (false, true)].map(|(a, b)| Quadrature { a, b });
    for at in -9..9 {
        assert_eq!(Quadrature::of(at), lines[at.rem_euclid(4) as usize]);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1_000))]

    /// Beat by beat the same as the model, at any size of step and movement.
    #[test]
    fn bits_step_as_the_model((log2, hysteresis, start, movements) in walk()) {
        let mut steps = StepBits::new(log2, hysteresis, start).unwrap();
        let step = 1i128 << log2;
        let mut model = Model::new(i128::from(start).div_euclid(step), step, i128::from(hysteresis));
        let mut position = start;
        for movement in movements {
            position += movement;
            prop_assert_eq!(steps.update(position), model.update(i128::from(position)));
            prop_assert_eq!((i128::from(steps.at()), i128::from(steps.backlog())), (model.at, model.backlog));
        }
        prop_assert_eq!(i128::from(steps.missed()), model.missed);
    }

    /// A step goes the way that the direction line said a beat before.
    #[test]
    fn the_direction_is_set_a_beat_before((log2, hysteresis, start, movements) in walk()) {
        let mut steps = StepBits::new(log2, hysteresis, start).unwrap();
        let mut position = start;
        let (mut line, mut counted) = (Direction::Up, steps.at());
        for movement in movements {
            position += movement;
            let step = steps.update(position);
            if step.is_step {
                prop_assert_eq!(step.direction, line);
                counted += if line == Direction::Up { 1 } else { -1 };
            }
            line = step.direction;
        }
        prop_assert_eq!(counted, steps.at());
        // what was late comes: at rest the motor is where the position is, less the hysteresis
        for _ in 0..=steps.backlog() + 2 {
            steps.update(position);
        }
        prop_assert!(steps.at() >= position >> log2);
        prop_assert!(steps.at() <= (position + hysteresis.cast_signed()) >> log2);
        prop_assert_eq!(steps.update(position).is_step, false);
    }

    /// A position that rests on an edge and shakes by no more than the hysteresis steps once at most.
    #[test]
    fn an_edge_does_not_chatter(log2 in 2u32..=16, edge in -1_000..1_000, shakes in proptest::collection::vec(any::<u32>(), 1..100)) {
        let hysteresis = StepBits::quarter(log2);
        let edge = edge << log2;
        let mut steps = StepBits::new(log2, hysteresis, edge - 1).unwrap();
        let mut taken = 0;
        for shake in shakes {
            // from the hysteresis below the edge to the end of its step
            let position = edge - hysteresis.cast_signed() + (shake % (2 * hysteresis)).cast_signed();
            taken += u32::from(steps.update(position).is_step);
        }
        prop_assert!(taken <= 1);
    }

    /// By thresholds on forward differences: at every sample the same as the model on exact fractions, knots included.
    #[test]
    fn thresholds_step_as_the_model(
        m in 0u32..=7,
        log2 in 1u32..=12,
        hysteresis_part in 0u32..256,
        start in -1_000_000i32..1_000_000,
        deltas in proptest::collection::vec(-20_000i32..20_000, 4..12),
    ) {
        let hysteresis = (hysteresis_part << log2) >> 8;
        let points: Vec<i32> = deltas.iter().scan(start, |at, by| { *at += by; Some(*at) }).collect();
        let mut spline = Differences::new([points[0], points[1], points[2], points[3]], m).unwrap();
        let scale = spline.scale();
        let at = spline.position() >> log2;
        let mut steps = StepThresholds::new(log2, hysteresis, at, spline.base(), scale).unwrap();
        let mut model = Model::new(i128::from(at), i128::from(scale) << log2, i128::from(scale) * i128::from(hysteresis));
        for next in &points[4..] {
            while spline.left() > 0 {
                spline.advance().unwrap();
                let exact = i128::from(spline.scaled()) + i128::from(spline.base()) * i128::from(scale);
                prop_assert_eq!(steps.update(spline.scaled()), model.update(exact));
                prop_assert_eq!(i128::from(steps.at()), model.at);
            }
            spline.knot(*next).unwrap();
            steps.rebase(spline.base()).unwrap();
        }
        // the two ways of stepping agree where the motor comes to rest
        let resting = spline.position();
        let mut bits = StepBits::new(log2, hysteresis, resting).unwrap();
        bits.update(resting);
        prop_assert!(model.due(i128::from(resting) * i128::from(scale)) + model.at - i128::from(bits.at()) <= 1);
    }
}

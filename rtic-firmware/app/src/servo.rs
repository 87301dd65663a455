//! A motor that closes its loop: the servo of the first axis, with a simulated motor and encoder where a board has none.
//!
//! - **Walk:** the first axis' position, velocity and acceleration at a beat → [`SimulatedMotor::follow`] → torque → the currents of two coils,
//!   a quarter turn ahead of the rotor; and the simulated motor takes the torque.
//! - **Invariants:** node 0 of the signals, where one is set, is added to the torque; node 1, where it is not 0, is the proportional gain. So tracks can
//!   feed both. A motor that is let go of has no torque.
//! - **What is real:** the loop, its arithmetic, its rate and the currents at the pins. **What is not:** the motor. It is
//!   `fixed_math::servo::Plant`: inertia, friction and an encoder of 2^[`COUNT_LOG2`] LSB a count.
//! - **Context:** the highest-priority task.

use crate::beats::Follower;
use fixed_math::phase::{Coils, PhaseWindow};
use fixed_math::servo::{Gain, Gains, Plant, PlantTraits, Scales, Servo, ServoTraits, SetPoint};
use osap_maxl::device::{BeatOutput, Interpolator};
use osap_maxl::player::PlayerState;

/// LSB a count of the encoder, base-two logarithm.
pub const COUNT_LOG2: u8 = 4;
/// LSB an electrical turn, base-two logarithm.
pub const TURN_LOG2: u32 = 18;

/// The simulated motor: a torque of 16,384 accelerates it by 2 LSB a beat², friction takes it to a stop within some 60 ms.
const PLANT: PlantTraits = PlantTraits { gain: 524_288, friction: 66, count_log2: COUNT_LOG2 };
/// Of its servo.
const TRAITS: ServoTraits = ServoTraits {
    scales: Scales { error: 0, rate: 6, velocity: 4, acceleration: 3 },
    filter_log2: 2,
    torque_limit: 32_000,
    integral_limit: 8_000,
};
/// Proportional, integral and derivative gain, and those of the set point's velocity and acceleration, as [`Gains`] has them.
///
/// A unit of torque is g = 2^−13 LSB a beat². At 16 units a LSB the loop's own frequency is √(16·g) = 1/22.6 a beat, 110 Hz at 15.625 kHz; damping of 0.8 wants
/// 2·0.8/22.6/g = 580 units for a LSB a beat, of which a unit of the measured velocity is 2^−6. The set point's velocity has the same unit at intervals
/// of 2^12 µs, 64 beats, and takes the derivative's drag off, and friction's 66/2^16/g = 8.3 units. Its acceleration has 2^−13 LSB a
/// beat² a unit: as much as a unit of torque makes.
const GAINS: [i32; 5] = [16 << 16, 1 << 21, 593_920, 602_368, 1 << 16];

/// Node that is added to the torque.
const NODE_TORQUE: usize = 0;
/// Node that is the proportional gain, where it is not 0.
const NODE_GAIN: usize = 1;

/// The servo and its motor.
#[derive(Debug)]
pub struct SimulatedMotor {
    servo: Servo,
    plant: Plant,
    gains: Gains,
    window: PhaseWindow,
    /// What the motor's position is counted from, so that it is where its axis is armed.
    origin: i32,
    was: PlayerState,
    /// Where it should be now: what is followed is for the next beat.
    due: i32,
    /// Greatest error since the axis was armed, LSB.
    error_max: u32,
}

impl SimulatedMotor {
    /// At rest.
    ///
    /// # Panics
    /// Never: what it is made of is in range.
    #[must_use]
    pub fn new() -> Self {
        let [proportional, integral, derivative, velocity, acceleration] = GAINS.map(Gain::saturated);
        Self {
            servo: Servo::new(TRAITS, 0).expect("in range"),
            plant: Plant::new(PLANT).expect("in range"),
            gains: Gains { proportional, integral, derivative, velocity, acceleration },
            window: PhaseWindow::new(TURN_LOG2, 0).expect("in range"),
            origin: 0,
            was: PlayerState::Idle,
            due: 0,
            error_max: 0,
        }
    }

    /// Greatest distance between where the motor was and where it should have been, since it was armed, LSB.
    #[must_use]
    pub const fn error_max(&self) -> u32 {
        self.error_max
    }

    /// One beat towards `set`, with a torque and a proportional gain from elsewhere; the currents.
    pub fn step(&mut self, set: &SetPoint, torque: i32, gain: Option<i32>) -> Coils {
        let mut gains = self.gains;
        if let Some(bits) = gain.filter(|bits| *bits != 0) {
            gains.proportional = Gain::saturated(bits);
        }
        let measured = self.measured();
        let due = core::mem::replace(&mut self.due, set.position);
        self.error_max = self.error_max.max(due.abs_diff(measured));
        let drive = self.servo.update(&SetPoint { position: due, ..*set }, measured, &gains, torque);
        self.plant.update(drive.torque);
        Coils::for_torque(self.window.phase(measured), drive.torque)
    }
}

impl Default for SimulatedMotor {
    fn default() -> Self {
        Self::new()
    }
}

impl Follower for SimulatedMotor {
    fn follow(&mut self, out: &BeatOutput, interpolator: &Interpolator<'_>) -> [i16; 2] {
        let first = out.first;
        let is_on = !matches!(first.state, PlayerState::Idle | PlayerState::Released);
        if !is_on {
            self.plant.update(0);
            self.was = first.state;
            return [0; 2];
        }
        if self.was == PlayerState::Idle {
            // the axis says where the motor is
            self.origin = first.position.wrapping_sub(self.plant.measured());
            self.servo.restart(first.position);
            self.due = first.position;
            self.error_max = 0;
        }
        self.was = first.state;
        let set = SetPoint { position: first.position, velocity: first.velocity, acceleration: first.acceleration };
        let torque = interpolator.node(NODE_TORQUE).unwrap_or(0);
        let Coils { a, b } = self.step(&set, torque, interpolator.node(NODE_GAIN));
        [a, b]
    }

    fn measured(&self) -> i32 {
        self.plant.measured().wrapping_add(self.origin)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use fixed_math::spline::IntervalLog2;
    use fixed_math::spline::horner::Cubic;
    use std::vec::Vec;

    /// A sine of `amplitude` LSB and `turns` a second as a spline of 4.096 ms, followed for `beats`; greatest error behind the first tenth of them.
    fn follow(motor: &mut SimulatedMotor, amplitude: f64, turns: f64, beats: usize, torque: i32) -> u32 {
        let interval = IntervalLog2::new(12).unwrap();
        #[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "small numbers")]
        let point = |index: usize| {
            let angle = index as f64 * 4.096e-3 * turns * core::f64::consts::TAU;
            (amplitude * (1.0 - angle.cos())).round() as i32
        };
        let points: Vec<i32> = (0..beats / 64 + 4).map(point).collect();
        motor.error_max = 0;
        for beat in 0..beats {
            let knot = beat / 64;
            let cubic = Cubic::new([points[knot], points[knot + 1], points[knot + 2], points[knot + 3]]).unwrap();
            let part = interval.part(u32::try_from(beat % 64 * 64 * 256).unwrap());
            let (position, velocity) = cubic.position_velocity(part);
            let set = SetPoint { position, velocity, acceleration: cubic.acceleration(part) };
            if beat == 0 {
                motor.due = position;
                motor.servo.restart(position);
            }
            motor.step(&set, torque, None);
            if beat == beats / 10 {
                motor.error_max = 0;
            }
        }
        motor.error_max()
    }

    /// A sine of 3 turns a second over ±20,000 LSB, 24 LSB a beat at its fastest: with its feed-forward the loop errs by what an encoder of 16 LSB does
    /// not see, a count, and by as much again for the rate that is filtered out of it. Without feed-forward of velocity and acceleration it lags.
    #[test]
    fn a_track_is_followed_to_two_counts() {
        let error = follow(&mut SimulatedMotor::new(), 20_000.0, 3.0, 30_000, 0);
        assert!(error <= 2 << COUNT_LOG2, "{error} LSB");
        let mut without = SimulatedMotor::new();
        without.gains.velocity = Gain::ZERO;
        without.gains.acceleration = Gain::ZERO;
        let lag = follow(&mut without, 20_000.0, 3.0, 30_000, 0);
        assert!(lag > 20 * error.max(1), "{lag} LSB");
    }

    /// A torque from elsewhere is as good as one of the loop's own: what is told is not seen, what is not told is found by the integral.
    #[test]
    fn a_load_is_taken_by_the_integral_or_told() {
        let mut motor = SimulatedMotor::new();
        let set = SetPoint::default();
        for _ in 0..15_625 {
            motor.step(&set, -2_000, None);
        }
        assert!((1_900..=2_100).contains(&motor.servo.integral()), "{}", motor.servo.integral());
        assert!(motor.measured().unsigned_abs() <= 1 << COUNT_LOG2, "{}", motor.measured());
    }
}

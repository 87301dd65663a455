//! The servo against the same law in double precision, the plant against the same in 128 bits, and both in a loop.

use core::f64::consts::TAU;
use fixed_math::servo::{
    Drive, FILTER_LOG2_MAX, GAIN_MAX, Gain, Gains, Plant, PlantError, PlantTraits, Scales, Servo, ServoError,
    ServoTraits, SetPoint, TORQUE_MAX,
};
use proptest::prelude::*;

/// The law without any rounding but that of its inputs' shifts, which are part of it.
struct Model {
    traits: ServoTraits,
    integral: f64,
    rate: f64,
    measured: i32,
}

/// What the law comes to before it is cut, and how far off the servo may be from it.
struct Wanted {
    torque: f64,
    slack: f64,
    is_input_cut: bool,
    /// the rate is so near its limit that either may be told
    may_be_cut: bool,
}

fn bits(gain: Gain, log2: i32) -> f64 {
    f64::from(gain.bits()) / 2f64.powi(log2)
}

impl Model {
    fn update(&mut self, set: &SetPoint, measured: i32, gains: &Gains, feed_forward: i32) -> (Wanted, f64) {
        let Scales { error, rate, velocity, acceleration } = self.traits.scales;
        let mut is_input_cut = false;
        let mut cut = |value: f64, low: f64, high: f64| {
            is_input_cut |= value < low || value > high;
            value.clamp(low, high)
        };
        let mut input = |value: i32, shift: u8| cut(f64::from(value >> shift), -32_768.0, 32_767.0);
        let error = input(set.position.wrapping_sub(measured), error);
        let (velocity, acceleration) = (input(set.velocity, velocity), input(set.acceleration, acceleration));
        let moved = cut(f64::from(measured.wrapping_sub(self.measured)), -262_144.0, 262_143.0);
        self.measured = measured;
        let filter = 2f64.powi(self.traits.filter_log2.into());
        self.rate += (moved * 4_096.0 - self.rate) / filter;
        // the filter rounds down by less than one each beat, of which a share 1/filter decays: less than filter in all
        let unit = 2f64.powi(rate.into());
        let rate_slack = 1.0 + filter / unit;
        let wide = self.rate / unit;
        let may_be_cut = wide.abs() <= 32_768.0 + rate_slack && wide.abs() >= 32_767.0 - rate_slack;
        let rate = cut(wide, -32_768.0, 32_767.0);
        let torque = bits(gains.proportional, 16) * error - bits(gains.derivative, 16) * rate
            + bits(gains.velocity, 16) * velocity
            + bits(gains.acceleration, 16) * acceleration
            + self.integral
            + f64::from(feed_forward);
        // four halves of a rounding, the integral rounded down, its limit passed by 2^−8; the sum of 32 bits is exact in a double
        let slack = 3.0 + 1.0 / 256.0 + bits(gains.derivative, 16).abs() * rate_slack + 1e-3;
        (Wanted { torque, slack, is_input_cut, may_be_cut }, error)
    }

    fn integrate(&mut self, gain: Gain, error: f64) {
        let limit = f64::from(self.traits.integral_limit);
        self.integral = (self.integral + bits(gain, 24) * error).clamp(-limit, limit);
    }
}

/// Compares a beat; where the torque is so near its limit that either may be right, the servo's word is taken on whether it is cut.
fn agree(model: &mut Model, servo: &mut Servo, beat: &Beat) -> Result<(), TestCaseError> {
    let Beat { set, measured, gains, feed_forward } = beat;
    let drive = servo.update(set, *measured, gains, *feed_forward);
    let (wanted, error) = model.update(set, *measured, gains, *feed_forward);
    let limit = f64::from(model.traits.torque_limit);
    let off = f64::from(drive.torque) - wanted.torque.clamp(-limit, limit);
    prop_assert!(off.abs() <= wanted.slack, "{drive:?} for {}: off by {off} of {}", wanted.torque, wanted.slack);
    if (wanted.torque.abs() - limit).abs() > wanted.slack {
        prop_assert_eq!(drive.is_saturated, wanted.torque.abs() > limit);
    }
    if !wanted.may_be_cut {
        prop_assert_eq!(drive.is_input_cut, wanted.is_input_cut);
    }
    if !drive.is_saturated || (error < 0.0) != (drive.torque < 0) {
        model.integrate(gains.integral, error);
    }
    prop_assert!(servo.integral().abs() <= model.traits.integral_limit);
    prop_assert!((f64::from(servo.integral()) - model.integral).abs() <= 1.0 + 1.0 / 256.0);
    Ok(())
}

#[derive(Clone, Debug)]
struct Beat {
    set: SetPoint,
    measured: i32,
    gains: Gains,
    feed_forward: i32,
}

/// Small ones and large ones alike.
fn wide(bits: u32) -> impl Strategy<Value = i32> {
    (0..=bits, any::<i32>()).prop_map(|(bits, value)| if bits == 0 { 0 } else { value >> (32 - bits) })
}

fn gain() -> impl Strategy<Value = Gain> {
    wide(30).prop_map(Gain::saturated)
}

fn beat() -> impl Strategy<Value = Beat> {
    let gains = (gain(), gain(), gain(), gain(), gain()).prop_map(
        |(proportional, integral, derivative, velocity, acceleration)| Gains {
            proportional,
            integral,
            derivative,
            velocity,
            acceleration,
        },
    );
    (any::<i32>(), wide(28), wide(32), wide(32), gains, wide(32)).prop_map(
        |(position, behind, velocity, acceleration, gains, feed_forward)| Beat {
            set: SetPoint { position, velocity, acceleration },
            measured: position.wrapping_sub(behind),
            gains,
            feed_forward,
        },
    )
}

/// A trajectory: steady gains, a set point that moves on, a measurement that follows with noise.
fn trajectory() -> impl Strategy<Value = Vec<Beat>> {
    (beat(), proptest::collection::vec((wide(18), wide(14), wide(20)), 1..200)).prop_map(|(first, moves)| {
        let mut position = first.set.position;
        let each = |(by, noise, acceleration): (i32, i32, i32)| {
            position = position.wrapping_add(by);
            let set = SetPoint { position, velocity: by << 8, acceleration };
            Beat { set, measured: position.wrapping_add(noise), ..first.clone() }
        };
        moves.into_iter().map(each).collect()
    })
}

fn traits() -> impl Strategy<Value = ServoTraits> {
    (proptest::array::uniform4(0u8..=16), 0..=FILTER_LOG2_MAX, 0u32..22, any::<u32>()).prop_map(
        |(scales, filter_log2, bits, part)| {
            let torque_limit = ((1 << bits) | (part & ((1 << bits) - 1))).cast_signed();
            let [error, rate, velocity, acceleration] = scales;
            let integral_limit = (part >> 8).cast_signed() % (torque_limit + 1);
            ServoTraits {
                scales: Scales { error, rate, velocity, acceleration },
                filter_log2,
                torque_limit,
                integral_limit,
            }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1_000))]

    /// Beats that have nothing to do with each other, each with gains of its own: what tracks may feed.
    #[test]
    fn it_is_the_law_for_any_inputs(traits in traits(), beats in proptest::collection::vec(beat(), 1..40)) {
        let mut servo = Servo::new(traits, 0).unwrap();
        let mut model = Model { traits, integral: 0.0, rate: 0.0, measured: 0 };
        for beat in &beats {
            agree(&mut model, &mut servo, beat)?;
        }
    }

    /// Trajectories, over which the integral and the filter build up.
    #[test]
    fn it_is_the_law_along_trajectories(traits in traits(), beats in trajectory()) {
        let start = beats[0].measured;
        let mut servo = Servo::new(traits, start).unwrap();
        let mut model = Model { traits, integral: 0.0, rate: 0.0, measured: start };
        for beat in &beats {
            agree(&mut model, &mut servo, beat)?;
        }
    }

    /// The plant's recursion in 128 bits, to the bit, at any torque; and its speed is cut where it has to be.
    #[test]
    fn a_plant_is_its_recursion(
        gain in 0..=i32::MAX, friction in any::<u16>(), count_log2 in 0u8..=16, torques in proptest::collection::vec(wide(32), 1..200),
    ) {
        let mut plant = Plant::new(PlantTraits { gain, friction, count_log2 }).unwrap();
        // 2^−32 LSB a beat, and 2^−16 LSB
        let (mut speed, mut position) = (0i128, 0i128);
        for torque in torques {
            let floor = speed >> 16;
            speed += i128::from(torque) * i128::from(gain) - floor * i128::from(friction);
            let rest = speed & 0xffff;
            let wanted = speed >> 16;
            let cut = wanted.clamp(i32::MIN.into(), i32::MAX.into());
            speed = (cut << 16) + rest;
            position += cut;
            prop_assert_eq!(plant.update(torque), cut == wanted);
            prop_assert_eq!((i128::from(plant.velocity()), i128::from(plant.position())), (cut, position));
            prop_assert_eq!(plant.counts(), (position >> 16 >> count_log2) as i32);
            prop_assert_eq!(plant.measured(), (position >> 16 >> count_log2 << count_log2) as i32);
        }
    }
}

#[test]
fn what_is_no_servo_is_refused_with_its_operands() {
    let good = ServoTraits { scales: Scales::default(), filter_log2: 0, torque_limit: 100, integral_limit: 100 };
    assert!(Servo::new(good, 0).is_ok());
    for scales in [
        Scales { error: 17, ..Scales::default() },
        Scales { rate: 17, ..Scales::default() },
        Scales { velocity: 17, ..Scales::default() },
        Scales { acceleration: 17, ..Scales::default() },
    ] {
        assert_eq!(Servo::new(ServoTraits { scales, ..good }, 0), Err(ServoError::Shift { shift: 17 }));
    }
    assert_eq!(Servo::new(ServoTraits { filter_log2: 7, ..good }, 0), Err(ServoError::Filter { filter_log2: 7 }));
    for torque_limit in [0, -1, TORQUE_MAX + 1] {
        assert_eq!(Servo::new(ServoTraits { torque_limit, ..good }, 0), Err(ServoError::TorqueLimit { torque_limit }));
    }
    for integral_limit in [-1, 101] {
        let refused = ServoError::IntegralLimit { integral_limit, torque_limit: 100 };
        assert_eq!(Servo::new(ServoTraits { integral_limit, ..good }, 0), Err(refused));
    }
    assert_eq!(Plant::new(PlantTraits { gain: -1, friction: 0, count_log2: 0 }), Err(PlantError::Gain { gain: -1 }));
    let refused = PlantError::CountLog2 { count_log2: 17 };
    assert_eq!(Plant::new(PlantTraits { gain: 1, friction: 0, count_log2: 17 }), Err(refused));
    assert_eq!((Gain::new(GAIN_MAX + 1), Gain::saturated(i32::MIN).bits()), (None, -GAIN_MAX));
}

/// Each term by hand: gains of 2, 3, 4, 5 and 6 for one beat.
#[test]
fn a_hand_worked_beat() {
    let traits = ServoTraits {
        scales: Scales { rate: 12, ..Scales::default() },
        filter_log2: 0,
        torque_limit: 10_000,
        integral_limit: 10_000,
    };
    let mut servo = Servo::new(traits, 100).unwrap();
    let gains = Gains {
        proportional: Gain::saturated(2 << 16),
        integral: Gain::saturated(3 << 24),
        derivative: Gain::saturated(4 << 16),
        velocity: Gain::saturated(5 << 16),
        acceleration: Gain::saturated(6 << 16),
    };
    let set = SetPoint { position: 150, velocity: 20, acceleration: -7 };
    // e = 40, moved 10: 80 − 40 + 100 − 42 + 9; the integral comes a beat later: 3·40
    assert_eq!(servo.update(&set, 110, &gains, 9), Drive { torque: 107, is_saturated: false, is_input_cut: false });
    assert_eq!(servo.integral(), 120);
    // e = 40 again, at rest
    assert_eq!(servo.update(&set, 110, &gains, 9).torque, 80 + 120 + 100 - 42 + 9);
    servo.restart(110);
    assert_eq!((servo.integral(), servo.update(&set, 110, &gains, 9).torque), (0, 80 + 100 - 42 + 9));
}

/// An integral of 2^−24 a beat is not lost: 2^16 beats of an error of 256 make one, either way.
#[test]
fn small_errors_add_up() {
    let traits = ServoTraits { scales: Scales::default(), filter_log2: 0, torque_limit: 100, integral_limit: 100 };
    for sign in [1, -1] {
        let mut servo = Servo::new(traits, 0).unwrap();
        let gains = Gains { integral: Gain::saturated(1), ..Gains::default() };
        let set = SetPoint { position: 256 * sign, ..SetPoint::default() };
        for _ in 0..1 << 16 {
            servo.update(&set, 0, &gains, 0);
        }
        assert_eq!(servo.integral(), sign);
    }
}

/// A cut torque stops the integral that pushes it on, and lets the one through that brings it back.
#[test]
fn the_integral_does_not_wind_up() {
    let traits = ServoTraits { scales: Scales::default(), filter_log2: 0, torque_limit: 1_000, integral_limit: 500 };
    let mut servo = Servo::new(traits, 0).unwrap();
    let gains =
        Gains { proportional: Gain::saturated(1 << 16), integral: Gain::saturated(1 << 24), ..Gains::default() };
    let far = SetPoint { position: 5_000, ..SetPoint::default() };
    for _ in 0..100 {
        let drive = servo.update(&far, 0, &gains, 0);
        assert_eq!((drive.torque, drive.is_saturated, servo.integral()), (1_000, true, 0));
    }
    let near = SetPoint { position: 300, ..SetPoint::default() };
    let integrals = [0; 3].map(|_| {
        servo.update(&near, 0, &gains, 0);
        servo.integral()
    });
    assert_eq!(integrals, [300, 500, 500]);
    // cut upwards by the feed-forward while the error says down: it comes back
    let below = SetPoint { position: -100, ..SetPoint::default() };
    let drive = servo.update(&below, 0, &gains, 5_000);
    assert_eq!((drive.torque, drive.is_saturated, servo.integral()), (1_000, true, 400));
}

/// A jump of the set point moves the proportional term alone.
#[test]
fn a_jump_does_not_kick_the_derivative() {
    let traits = ServoTraits { scales: Scales::default(), filter_log2: 2, torque_limit: TORQUE_MAX, integral_limit: 0 };
    let mut servo = Servo::new(traits, 0).unwrap();
    let gains =
        Gains { proportional: Gain::saturated(1 << 16), derivative: Gain::saturated(9 << 16), ..Gains::default() };
    let jump = SetPoint { position: 1_000, ..SetPoint::default() };
    assert_eq!(servo.update(&SetPoint::default(), 0, &gains, 0).torque, 0);
    assert_eq!(servo.update(&jump, 0, &gains, 0).torque, 1_000);
}

/// The velocity that a torque comes to is torque·gain/friction, by the exponential of first order: each beat's floor of the velocity
/// is off by less than one in 2^−16, of which the friction takes its share back, so less than one in all.
#[test]
fn a_plant_follows_its_exponential() {
    let (gain, friction, torque) = (70_000_000, 655, 1_234);
    let mut plant = Plant::new(PlantTraits { gain, friction, count_log2: 0 }).unwrap();
    let share = f64::from(friction) / 65_536.0;
    let last = f64::from(torque) * f64::from(gain) / f64::from(friction);
    for beat in 1..=2_000 {
        assert!(plant.update(torque));
        let exact = last * (1.0 - (1.0 - share).powi(beat));
        // one for the friction's floor, one for that of what is read
        assert!((f64::from(plant.velocity()) - exact).abs() <= 2.0, "beat {beat}: {} for {exact}", plant.velocity());
    }
    // and let go it comes to rest, from either side
    for _ in 0..4_000 {
        plant.update(0);
    }
    assert!(plant.velocity().abs() <= 1, "{}", plant.velocity());
}

/// The two lines tell all of the counts while there is less than one a beat.
#[test]
fn an_encoders_lines_count() {
    let mut plant = Plant::new(PlantTraits { gain: 2_000_000, friction: 300, count_log2: 4 }).unwrap();
    let place = |plant: &Plant| match (plant.encoder().a, plant.encoder().b) {
        (false, false) => 0i32,
        (true, false) => 1,
        (true, true) => 2,
        (false, true) => 3,
    };
    let (mut before, mut counted) = (place(&plant), 0);
    for beat in 0..20_000 {
        plant.update(if (beat / 3_000) % 2 == 0 { 60 } else { -75 });
        let now = place(&plant);
        let by = (now - before).rem_euclid(4);
        assert_ne!(by, 2, "beat {beat}: two counts in one");
        counted += if by == 3 { -1 } else { by };
        before = now;
        assert_eq!(counted, plant.counts());
    }
}

/// What a closed loop comes to.
struct Run {
    rms_error: f64,
    saturated: u32,
    last_error: i32,
}

const PLANT: PlantTraits = PlantTraits { gain: 4_000_000, friction: 200, count_log2: 2 };
/// What `PLANT` needs: per LSB a beat of velocity, and per LSB a beat² of acceleration, output units.
const FRICTION_TORQUE: f64 = 200.0 * 65_536.0 / 4_000_000.0;
const INERTIA_TORQUE: f64 = 4_294_967_296.0 / 4_000_000.0;

const LOOP: ServoTraits = ServoTraits {
    scales: Scales { error: 0, rate: 7, velocity: 0, acceleration: 0 },
    filter_log2: 2,
    torque_limit: 30_000,
    integral_limit: 15_000,
};

/// Kp = 6, Ki = 0.02, Kd = 144 a LSB a beat: √(6/1074) = 0.075 of a radian a beat, 190 Hz, damped by 0.9. The rate's unit is 2^−5.
fn feedback() -> Gains {
    Gains {
        proportional: Gain::saturated(6 << 16),
        integral: Gain::saturated((0.02 * 2f64.powi(24)) as i32),
        derivative: Gain::saturated((144.0 / 32.0 * 65_536.0) as i32),
        ..Gains::default()
    }
}

/// `feedback` with the feed-forward that `PLANT` needs, for velocities in 2^−8 LSB a beat and accelerations in 2^−16 a beat².
fn feed_forward() -> Gains {
    Gains {
        velocity: Gain::saturated(((144.0 + FRICTION_TORQUE) / 256.0 * 65_536.0) as i32),
        acceleration: Gain::saturated(INERTIA_TORQUE as i32),
        ..feedback()
    }
}

/// 4 s of a sine of 20,000 LSB and 2 Hz at 15,625 beats a second, against a `load` of which `compensated` is fed forward.
fn follow(gains: &Gains, load: i32, compensated: bool) -> Run {
    let (mut plant, mut servo) = (Plant::new(PLANT).unwrap(), Servo::new(LOOP, 0).unwrap());
    let omega = TAU * 2.0 / 15_625.0;
    let (beats, mut squares, mut saturated, mut last_error) = (62_500, 0.0, 0, 0);
    for beat in 0..beats {
        let angle = omega * f64::from(beat);
        let (p, v) = (20_000.0 * (1.0 - angle.cos()), 20_000.0 * omega * angle.sin());
        let a = 20_000.0 * omega * omega * angle.cos();
        let set =
            SetPoint { position: p.round() as i32, velocity: (v * 256.0) as i32, acceleration: (a * 65_536.0) as i32 };
        // the load turns with the arm
        let load = (f64::from(load) * (angle / 3.0).cos()) as i32;
        last_error = set.position - plant.measured();
        squares += f64::from(last_error).powi(2);
        let drive = servo.update(&set, plant.measured(), gains, if compensated { load } else { 0 });
        saturated += u32::from(drive.is_saturated);
        plant.update(drive.torque - load);
    }
    Run { rms_error: (squares / f64::from(beats)).sqrt(), saturated, last_error }
}

#[test]
fn a_loop_follows_and_feed_forward_takes_its_lag() {
    let (plain, ahead) = (follow(&feedback(), 0, false), follow(&feed_forward(), 0, false));
    println!(
        "rms error of a sine of 20000 LSB: {:.1} LSB by feedback, {:.1} with feed-forward",
        plain.rms_error, ahead.rms_error
    );
    assert_eq!((plain.saturated, ahead.saturated), (0, 0));
    // a count is 4 LSB: nothing finer is seen of the error
    assert!(ahead.rms_error <= 4.0, "{}", ahead.rms_error);
    assert!(plain.rms_error > 5.0 * ahead.rms_error);
    // and at the end no more than a count and the next
    assert!(ahead.last_error.abs() <= 8);
}

/// A load that changes with where the machine is: what another track feeds forward does not have to be found by the integral.
#[test]
fn a_torque_track_takes_a_loads_error() {
    let (found, told) = (follow(&feed_forward(), 4_000, false), follow(&feed_forward(), 4_000, true));
    println!(
        "rms error under load: {:.1} LSB found by the loop, {:.1} told by a track",
        found.rms_error, told.rms_error
    );
    assert!(told.rms_error <= 4.0 && found.rms_error > 2.0 * told.rms_error);
}

/// A jump far past what the torque can do at once: cut, told, and then settled within counts without end of swinging.
#[test]
fn a_loop_settles_after_a_jump() {
    let (mut plant, mut servo) = (Plant::new(PLANT).unwrap(), Servo::new(LOOP, 0).unwrap());
    let set = SetPoint { position: 25_000, ..SetPoint::default() };
    let (mut saturated, mut highest) = (0, 0);
    for _ in 0..30_000 {
        let drive = servo.update(&set, plant.measured(), &feedback(), 0);
        saturated += u32::from(drive.is_saturated);
        highest = highest.max(plant.measured());
        plant.update(drive.torque);
    }
    println!("a jump of 25000 LSB: {saturated} beats cut, highest at {highest}, at last {}", plant.measured());
    assert!(saturated > 0);
    // damped by 0.9 it goes 0.2 % past, and what the integral gathers on the way adds some; a tenth says that the cut did not make it swing
    assert!(highest < 25_000 + 25_000 / 10);
    // within two counts, which the integral swings over
    assert!((plant.measured() - 25_000).abs() <= 8);
}

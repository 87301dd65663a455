//! A control point's walk on simulated devices: from the workstation's session over the network to a track, and what comes back when something
//! is wrong with it. `[MOT-01]` to `[MOT-11]`, `[MOT-20]` to `[MOT-24]`.

use fixed_math::spline::{IntervalLog2, Segment};
use fixed_math::time::{NetTime, Span};
use osap::error::AskError;
use osap::map::Device;
use osap::scan::ScanOptions;
use osap::session::{OpenOptions, Session};
use osap_protocol::PortIndex;
use osap_protocol::motion::{
    AxisSettings, AxisState, AxisStatus, CurveSettings, HaltReason, LimitKind, MotionRefusal, MotionReply,
    MotionRequest, PORT_TYPE, Points, StarvedPolicy,
};
use osap_runtime::sequenced::Destination;

/// Control points are 4.096 ms apart.
const INTERVAL_LOG2: u8 = 12;
const INTERVAL_US: u64 = 1 << INTERVAL_LOG2;
/// The motion port of a motor.
const PORT: u16 = 4;

const fn flat(value: i32) -> CurveSettings {
    CurveSettings { at_rest: value, at_full: value, knee: 0 }
}

/// Stops take 3·2^15 µs = 98 ms = 24 intervals, and use up 12 of them.
const SETTINGS: AxisSettings = AxisSettings {
    interval_log2: INTERVAL_LOG2,
    step_log2: 8,
    policy: StarvedPolicy::Stop,
    missing_max: 2,
    stop_log2: 15,
    position_min: -2_000_000,
    position_max: 2_000_000,
    velocity: 20_000,
    acceleration: flat(4_000),
    jerk: flat(1_000),
};

/// The printer, scanned and with one time, and the ways to the motion ports of its motors.
fn machine() -> (Session, Vec<Destination>) {
    let mut session =
        Session::open(&["sim:printer".parse().expect("a machine")], &OpenOptions::default()).expect("open");
    let map = session.scan(&ScanOptions::default(), &mut |_| {}).expect("scanned").map;
    session.learn(&map);
    session.network().pause(Span::from_us(3_000_000)).expect("runs");
    let is_motor = |device: &&Device| device.type_name == "motor";
    let motors: Vec<Destination> = map
        .devices
        .iter()
        .filter(is_motor)
        .map(|device| Destination { port: PortIndex::new(PORT).expect("below 2048"), ..session.destination_of(device) })
        .collect();
    assert!(motors.len() >= 2, "a printer has motors");
    (session, motors)
}

fn now(session: &mut Session) -> NetTime {
    let at = session.network().now();
    session.network().system_time(at).expect("runs").at
}

/// The next multiple of the interval that lies `ahead_us` from now.
fn start(session: &mut Session, ahead_us: u64) -> NetTime {
    NetTime::from_us((now(session).as_us() + ahead_us).next_multiple_of(INTERVAL_US))
}

fn status(session: &mut Session, motor: &Destination) -> AxisStatus {
    match session.motion(motor, &MotionRequest::Status { axis: 0 }) {
        Ok(MotionReply::Status(status)) => status,
        other => panic!("{other:?}"),
    }
}

fn refused(answer: Result<MotionReply, AskError>) -> MotionRefusal {
    match answer {
        Err(AskError::MotionRefused { refusal, .. }) => refusal,
        other => panic!("not refused: {other:?}"),
    }
}

fn arm(session: &mut Session, motor: &Destination, position: i32) {
    let configure = MotionRequest::Configure { axis: 0, settings: SETTINGS };
    assert_eq!(session.motion(motor, &configure).expect("configured"), MotionReply::Done);
    let arm = MotionRequest::Arm { axis: 0, position };
    assert_eq!(session.motion(motor, &arm).expect("armed"), MotionReply::Done);
}

/// There and back again: a raised cosine within the limits less the stop's reserve, `count` points with four at its end that are at rest.
fn path(count: usize, height: f64) -> Vec<i32> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "small numbers")]
    let point = |index: usize| {
        let part = ((index + 1) as f64 / (count - 4) as f64).min(1.0);
        (height / 2.0 * (1.0 - (part * std::f64::consts::TAU).cos())).round() as i32
    };
    (0..count).map(point).collect()
}

fn send(session: &mut Session, motor: &Destination, from: NetTime, positions: &[i32]) {
    for (index, positions) in (0..).zip(positions.chunks(16)) {
        let time = from + Span::from_us(index * 16 * INTERVAL_US);
        let answer = session.motion_points(motor, &Points { axis: 0, time, positions }).expect("taken");
        assert!(
            matches!(answer, MotionReply::Accepted { taken, .. } if usize::from(taken) == positions.len()),
            "{answer:?}"
        );
    }
}

fn pause_until(session: &mut Session, at: NetTime) {
    let left = at.since(now(session));
    session.network().pause(left).expect("runs");
}

/// The position on the path's spline at `since` from its first point's time, exactly; before it all points are at 0.
fn exact(positions: &[i32], since_us: i64) -> i32 {
    let interval = i64::try_from(INTERVAL_US).expect("small");
    let point = |index: i64| {
        usize::try_from(index)
            .map_or(0, |index| positions.get(index).copied().unwrap_or(*positions.last().expect("some")))
    };
    let knot = since_us.div_euclid(interval);
    let points = [-1, 0, 1, 2].map(|offset| point(knot + offset));
    let segment = Segment::new(points, IntervalLog2::new(INTERVAL_LOG2.into()).expect("an interval"));
    segment.sample(u32::try_from(since_us.rem_euclid(interval)).expect("small")).position
}

/// `[MOT-02]`, `[MOT-03]`, `[MOT-10]`: two motors behind different hubs play what they were sent, and say afterwards where they were at any instant, to the last
/// place; then they have come to rest for want of points, which is no fault.
#[test]
fn points_are_played_and_the_past_can_be_asked_for() {
    let (mut session, motors) = machine();
    let path = path(96, 100_000.0);
    let from = start(&mut session, 100_000);
    for motor in &motors[..2] {
        assert_eq!(
            refused(session.motion(motor, &MotionRequest::Arm { axis: 0, position: 0 })),
            MotionRefusal::NotArmed
        );
        arm(&mut session, motor, 0);
        assert_eq!(status(&mut session, motor).state, AxisState::Armed);
        send(&mut session, motor, from, &path);
    }
    pause_until(&mut session, from + Span::from_us(50 * INTERVAL_US));
    for motor in &motors[..2] {
        assert_eq!(status(&mut session, motor).state, AxisState::Playing);
        for back_us in [1_000, 7_777, 50_001, 120_000] {
            let at = now(&mut session).as_us() - back_us;
            let asked = MotionRequest::MotionAt { axis: 0, time_steps: NetTime::from_us(at).steps() };
            let Ok(MotionReply::Motion { position, .. }) = session.motion(motor, &asked) else { panic!("no answer") };
            let expected = exact(&path, at.cast_signed() - from.as_us().cast_signed());
            assert!(position.abs_diff(expected) <= 1, "{position} where the spline is {expected}, {back_us} µs ago");
        }
    }
    pause_until(&mut session, from + Span::from_us(120 * INTERVAL_US));
    for motor in &motors[..2] {
        let it = status(&mut session, motor);
        assert_eq!((it.state, it.position, it.fault), (AxisState::Starved, 0, None));
        assert_eq!((it.accepted, it.refused, it.rebuilt, it.starved, it.steps_late), (96, 0, 0, 1, 0));
    }
}

/// `[MOT-04]`, `[MOT-05]`: each refusal with its operands; what is missing is rebuilt; nothing that was refused has changed anything.
#[test]
fn points_are_refused_with_their_operands() {
    let (mut session, motors) = machine();
    let motor = &motors[0];
    let path = path(96, 100_000.0);
    let from = start(&mut session, 100_000);
    let at = |index: u64| from + Span::from_us(index * INTERVAL_US);
    let one = |time, position: &'static i32| Points { axis: 0, time, positions: std::slice::from_ref(position) };
    assert_eq!(refused(session.motion_points(motor, &one(from, &0))), MotionRefusal::NotArmed);
    arm(&mut session, motor, 0);
    send(&mut session, motor, from, &path[..20]);
    let grid = refused(session.motion_points(motor, &one(at(20) + Span::from_us(1), &0)));
    assert_eq!(grid, MotionRefusal::OffGrid { point_steps: at(20).steps() + 256, interval_log2: 12 });
    let again = refused(session.motion_points(motor, &one(at(3), &0)));
    assert_eq!(again, MotionRefusal::NonMonotonic { point_steps: at(3).steps(), last_steps: at(19).steps() });
    let gap = refused(session.motion_points(motor, &one(at(25), &0)));
    assert_eq!(gap, MotionRefusal::Gap { missing: 5, missing_max: 2 });
    // one is missing, and is never sent; until it is needed 15 points are kept behind it
    send(&mut session, motor, at(21), &path[21..36]);
    let full = refused(session.motion_points(motor, &one(at(36), &0)));
    assert_eq!(full, MotionRefusal::Full { taken: 0, capacity: 128 });
    pause_until(&mut session, at(19));
    send(&mut session, motor, at(36), &path[36..]);
    let reconfigured = session.motion(motor, &MotionRequest::Configure { axis: 0, settings: SETTINGS });
    assert_eq!(refused(reconfigured), MotionRefusal::Moving);
    pause_until(&mut session, at(60));
    let late = refused(session.motion_points(motor, &one(at(20), &0)));
    assert!(
        matches!(late, MotionRefusal::Late { point_steps, earliest_steps }
        if point_steps == at(20).steps() && earliest_steps > at(60).steps()),
        "{late:?}"
    );
    pause_until(&mut session, at(120));
    let it = status(&mut session, motor);
    assert_eq!((it.state, it.position, it.fault, it.rebuilt), (AxisState::Starved, 0, None, 1));
    // the first of all was offered to an axis that was no axis yet, which is no point of its own
    assert_eq!((it.accepted, it.refused), (95, 5));
    let nowhere = refused(session.motion(motor, &MotionRequest::Status { axis: 9 }));
    assert_eq!(nowhere, MotionRefusal::NoSuch { index: 9, count: 4 });
    let bad = AxisSettings { velocity: 0, ..SETTINGS };
    let bad = refused(session.motion(motor, &MotionRequest::Configure { axis: 0, settings: bad }));
    assert!(matches!(bad, MotionRefusal::Setting { field: 7, value: 0, bound: 1 }), "{bad:?}");
    let short = AxisSettings { stop_log2: 8, ..SETTINGS };
    let short = refused(session.motion(motor, &MotionRequest::Configure { axis: 0, settings: short }));
    assert!(matches!(short, MotionRefusal::HaltTooShort { least, .. } if least > 8), "{short:?}");
}

/// `[MOT-20]` to `[MOT-24]`: one device is asked to halt; all stand on their paths at the same track time, go on together, and end where they should.
#[test]
fn a_halt_stops_all_on_their_paths_and_a_resume_goes_on() {
    let (mut session, motors) = machine();
    let path = path(96, 100_000.0);
    let from = start(&mut session, 100_000);
    for motor in &motors[..2] {
        arm(&mut session, motor, 0);
        send(&mut session, motor, from, &path);
    }
    pause_until(&mut session, from + Span::from_us(30 * INTERVAL_US));
    let halt = session.motion(&motors[1], &MotionRequest::Halt { resume: false, lead_us: 20_000 });
    let Ok(MotionReply::Halted { epoch_steps, .. }) = halt else { panic!("{halt:?}") };
    session.network().pause(Span::from_us(400_000)).expect("runs");
    // T/2 behind the epoch, which is on the grid of 64 µs
    let epoch_us = (epoch_steps >> 8).next_multiple_of(64);
    let stood_us = epoch_us + 3 * (1 << 15) / 2;
    let expected = exact(&path, stood_us.cast_signed() - from.as_us().cast_signed());
    let mut delays = Vec::new();
    for motor in &motors[..2] {
        let it = status(&mut session, motor);
        assert_eq!(it.state, AxisState::Playing, "it stands on its path and has points");
        assert!(it.position.abs_diff(expected) <= 1, "{} where the path is {expected}", it.position);
        session.network().pause(Span::from_us(10_000)).expect("runs");
        assert_eq!(status(&mut session, motor).position, it.position, "it stands");
    }
    let resume = session.motion(&motors[0], &MotionRequest::Halt { resume: true, lead_us: 20_000 });
    assert!(matches!(resume, Ok(MotionReply::Halted { .. })), "{resume:?}");
    session.network().pause(Span::from_us(1_000_000)).expect("runs");
    for motor in &motors[..2] {
        let it = status(&mut session, motor);
        assert_eq!((it.state, it.position, it.halted), (AxisState::Starved, 0, None));
        delays.push(it.delay_steps);
    }
    assert_eq!(delays[0], delays[1], "the same delay");
    assert!(delays[0] >> 8 > 400_000);
}

/// `[MOT-06]`: a point that breaks a limit latches with what it was, and halts the other motor too, which has done nothing wrong.
#[test]
fn a_fault_latches_and_halts_the_machine() {
    let (mut session, motors) = machine();
    let path = path(96, 100_000.0);
    let from = start(&mut session, 100_000);
    for motor in &motors[..2] {
        arm(&mut session, motor, 0);
        send(&mut session, motor, from, &path[..60]);
    }
    let wild = [path[59] + 30_000];
    let time = from + Span::from_us(60 * INTERVAL_US);
    let fault = refused(session.motion_points(&motors[0], &Points { axis: 0, time, positions: &wild }));
    let MotionRefusal::Limit(fault) = fault else { panic!("{fault:?}") };
    assert_eq!(
        (fault.point_steps, fault.limit, fault.value, fault.bound),
        (time.steps(), LimitKind::Velocity, 30_000, 20_000)
    );
    let after = refused(session.motion_points(&motors[0], &Points { axis: 0, time, positions: &[path[60]] }));
    assert_eq!(after, MotionRefusal::Latched(fault));
    session.network().pause(Span::from_us(300_000)).expect("runs");
    let [faulty, other] = [0, 1].map(|motor| status(&mut session, &motors[motor]));
    assert_eq!((faulty.fault, faulty.halted), (Some(fault), Some(HaltReason::Fault { axis: 0 })));
    assert_eq!((other.fault, other.halted), (None, None), "it is told to halt, and has no reason of its own");
    assert_eq!(faulty.position, other.position, "both stand at the same place of the same path");
    assert!(faulty.delay_steps > 0 && other.delay_steps > 0);
}

/// `[MOT-11]`: who sends no fresh point while there is still something to play is taken for lost.
#[test]
fn silence_halts() {
    let (mut session, motors) = machine();
    let motor = &motors[0];
    arm(&mut session, motor, 0);
    let path = path(128, 100_000.0);
    // half a second of points, and another half second before they begin
    let from = start(&mut session, 400_000);
    send(&mut session, motor, from, &path[..100]);
    session.network().pause(Span::from_us(700_000)).expect("runs");
    let it = status(&mut session, motor);
    assert_eq!(it.halted, Some(HaltReason::Silence { axis: 0 }));
    assert!(it.delay_steps > 0);
}

/// The port is what its description says.
#[test]
fn a_motor_has_a_port_for_motion() {
    let (mut session, motors) = machine();
    let reply = session.motion(&motors[0], &MotionRequest::Describe).expect("described");
    let MotionReply::Described { axes, beat_us, queue, history, .. } = reply else { panic!("{reply:?}") };
    assert_eq!((axes, beat_us, queue, history), (4, 64, 128, 256));
    let port = session.port_info(&Destination { port: PortIndex::NETRESPONDER, ..motors[0].clone() }, PORT);
    assert_eq!(port.expect("told").value.type_name.as_str(), PORT_TYPE);
}

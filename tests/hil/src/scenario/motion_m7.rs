//! An emulated Cortex-M7 plays tracks that come over the network: where it says that its axes were, and the steps that it put out.
//!
//! - **Walk:** [`Motor`] → settings, a signal → points of four axes, [`LEAD`] ahead of their time → rest → positions out of its history
//!   against the exact spline, and the record of its pins against the tracks.
//! - **Invariants:** what is expected is made of the tracks alone, by arithmetic of 128 bits and by counting, without the device's code. Every
//!   way from one rest to the next goes in one direction, between middles of steps: its steps are as many whenever the beats come.
//! - **Context:** real time: QEMU's beats are as late as the computer makes them, so that no time is judged. A computer that is too busy to
//!   send points in time has shown nothing, and that is said. **Clauses:** `[MOT-03]`, `[MOT-07]`, `[MOT-10]`, `[MOT-13]`.

use super::Context;
use super::preemption_m7::{RETRY, TRIES, await_answer};
use crate::bridge::{Bridge, End};
use crate::images::Image;
use crate::pico::{MOTOR, route};
use crate::qemu::{Identity, Qemu};
use crate::report::{Failure, Report, real, table};
use fixed_math::logic::{Node, Source};
use fixed_math::spline::{IntervalLog2, Segment};
use fixed_math::time::{LocalTicks, NetTime, Span};
use osap::error::AskError;
use osap::session::{OpenOptions, Session};
use osap_protocol::PortIndex;
use osap_protocol::discovery::TimeSettings;
use osap_protocol::motion::{
    AxisSettings, AxisState, AxisStatus, CurveSettings, MotionRefusal, MotionReply, MotionRequest, Points,
    StarvedPolicy,
};
use osap_runtime::sequenced::Destination;
use serde_json::json;
use std::net::{SocketAddr, TcpListener};
use tempfile::TempDir;

/// The motion port of a motor, `[APP-01]`.
const MOTION: PortIndex = PortIndex::from_low_bits(4);
/// Steps up from rest, then down, by axis.
const WAYS: [(u16, u16); AXES] = [(600, 900), (1, 2), (255, 257), (333, 77)];
const AXES: usize = 4;
/// Points on the way up, at rest there, on the way down, and at rest at the end.
const UP: u16 = 40;
const REST: u16 = 10;
const DOWN: u16 = 60;
const END: u16 = 4;
/// Between points, 2^n µs: the longest there is, which leaves most time for whatever holds a computer up.
const INTERVAL_LOG2: u8 = 14;
/// A step is 2^n LSB; tracks rest in the middle of one.
const STEP_LOG2: u8 = 8;
const MIDDLE: i32 = 1 << (STEP_LOG2 - 1);
/// Points are sent so long before their time. The device halts where none comes for 500 ms, and the last ones are played that much later.
const LEAD: Span = Span::from_us(400_000);
/// Points of a message: one that every link carries.
const CHUNK: usize = 8;
/// Between two looks at what is to be sent, or at what the device does.
const PAUSE: Span = Span::from_us(20_000);
/// A computer that lets so much time pass between two looks cannot be relied on to be in time: a quarter of [`LEAD`].
const BUSY: Span = Span::from_us(100_000);
/// Looks until all axes must rest, and until the clock must be settled: 20 s and more.
const LOOKS_MAX: usize = 1_000;
/// Runs that are tried where the computer was busy.
const ATTEMPTS_MAX: u32 = 3;
/// From one position asked for to the next, µs: an odd number, for all parts of an interval.
const ASKED_US: usize = 37_123;
/// A device's position is less than one LSB from the exact one, which is rounded by half of one: one of integers.
const POSITION_OFF_MAX: i32 = 1;
/// Velocity is off by -6 to 1 of 2^-4 LSB an interval, as `fixed_math::spline::horner` proves; the reference, which is rounded to a LSB a
/// second, by half of 16 · 2^14 / 10^6 more.
const VELOCITY_OFF: core::ops::Range<f64> = -6.14..1.14;
/// Signal 0 is true while axis 0 is past this.
const THRESHOLD: i32 = 400 << STEP_LOG2;

/// Where the record of the steps stands in the device's memory, as `boards/mps2-an500/src/kept.rs` says, and that of the signals.
const STEPS_OFFSET: u64 = 0x7000;
const SIGNALS_OFFSET: u64 = 0x7800;
/// They begin with these, as `outputs.rs` and `signals.rs` there say.
const STEPS_MARK: u32 = 0x0511_0a75;
const SIGNALS_MARK: u32 = 0x0511_51c5;

/// One device at the host's link.
struct Motor {
    qemu: Qemu,
    _bridge: Bridge,
    address: SocketAddr,
    /// Last, so that the files outlive the process.
    _folder: TempDir,
}

/// What the device counted at its pins; the tables in `outputs.rs` and `signals.rs` of its board.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Pins {
    beats: u32,
    is_enabled: bool,
    steps: [u32; AXES],
    positions: [i32; AXES],
    late_directions: u32,
    outputs: u32,
    edges: [u32; AXES],
}

/// One axis' points, one interval apart; before them it rests in the middle of step 0.
struct Track(Vec<i32>);

/// Came to its end, or did not for want of time.
enum Ended {
    Played(Box<Report>),
    Busy(String),
}

/// Goes on as the device's does for as long as a run takes, to far below an interval.
struct SystemClock {
    system: NetTime,
    host: LocalTicks,
}

impl Motor {
    fn start(context: &Context) -> Result<Self, Failure> {
        let elf = context.places.image(Image::Mps2An500)?;
        crate::qemu::version()?;
        let folder = tempfile::tempdir()?;
        let identity = Identity { name: "motor".to_owned(), unique_id: *b"mps2mot\0\0\0\0\x02", kind: MOTOR };
        let mut qemu = Qemu::new(identity, &elf, folder.path(), false)?;
        let listener = TcpListener::bind(("127.0.0.1", 0))?;
        let address = listener.local_addr()?;
        let bridge = Bridge::start(vec![[End::Listener(listener), End::Socket(qemu.serial(0))]], None)?;
        qemu.start()?;
        Ok(Self { qemu, _bridge: bridge, address, _folder: folder })
    }

    fn session(&self) -> Result<Session, Failure> {
        let spec = format!("tcp:{},check=crc16", self.address);
        let spec = spec.parse().map_err(|error| Failure::Failed(format!("{spec}: {error}")))?;
        Session::open(&[spec], &OpenOptions::default()).map_err(|error| Failure::Failed(error.to_string()))
    }

    fn pins(&self) -> Result<Pins, Failure> {
        let steps = words::<13>(&self.qemu.read_memory(STEPS_OFFSET, 13 * 4)?);
        let signals = words::<6>(&self.qemu.read_memory(SIGNALS_OFFSET, 6 * 4)?);
        Pins::decode(&steps, &signals).ok_or_else(|| {
            Failure::Failed(
                "the image keeps no record of its pins: it is an old one, or does not start its board".into(),
            )
        })
    }
}

fn words<const N: usize>(bytes: &[u8]) -> [u32; N] {
    let mut words = [0; N];
    for (word, four) in words.iter_mut().zip(bytes.as_chunks().0) {
        *word = u32::from_le_bytes(*four);
    }
    words
}

impl Pins {
    fn decode(steps: &[u32; 13], signals: &[u32; 6]) -> Option<Self> {
        let [STEPS_MARK, beats, _, enabled, s0, s1, s2, s3, p0, p1, p2, p3, late_directions] = *steps else {
            return None;
        };
        let [SIGNALS_MARK, outputs, edges @ ..] = *signals else { return None };
        Some(Self {
            beats,
            is_enabled: enabled != 0,
            steps: [s0, s1, s2, s3],
            positions: [p0, p1, p2, p3].map(u32::cast_signed),
            late_directions,
            outputs,
            edges,
        })
    }
}

impl Track {
    /// Up and down by so many steps, with no jump in acceleration.
    fn new((up, down): (u16, u16)) -> Self {
        let top = i32::from(up) << STEP_LOG2;
        let ends = [MIDDLE, MIDDLE + top, MIDDLE + top - (i32::from(down) << STEP_LOG2)];
        let way = |from: i32, to: i32, points: u16| {
            (1..=points).map(move |point| {
                let s = f64::from(point) / f64::from(points);
                #[expect(clippy::cast_possible_truncation, reason = "a part of the way")]
                let gone = (f64::from(to - from) * s * s * s * (10.0 + s * (6.0 * s - 15.0))).round() as i32;
                from + gone
            })
        };
        let rest = |at: i32, points: u16| (0..points).map(move |_| at);
        let up = way(ends[0], ends[1], UP).chain(rest(ends[1], REST));
        Self(up.chain(way(ends[1], ends[2], DOWN)).chain(rest(ends[2], END)).collect())
    }

    /// Point `index`, of which 0 is the first.
    fn point(&self, index: i64) -> i32 {
        let last = self.0.last().copied().unwrap_or(MIDDLE);
        usize::try_from(index).map_or(MIDDLE, |index| self.0.get(index).copied().unwrap_or(last))
    }

    /// Where it is `us` after the first point: position, velocity in LSB a second, and jerk in LSB an interval³.
    fn at(&self, us: i64) -> (i32, i64, i32) {
        let interval = interval();
        let index = us.div_euclid(interval.us().into());
        let points = [-1, 0, 1, 2].map(|offset| self.point(index + offset));
        let since = u32::try_from(us.rem_euclid(interval.us().into())).unwrap_or_default();
        let sample = Segment::new(points, interval).sample(since);
        let [p0, p1, p2, p3] = points;
        (sample.position, sample.velocity_per_s, p3 - p0 + 3 * (p1 - p2))
    }
}

impl SystemClock {
    fn now(&self, session: &mut Session) -> NetTime {
        self.system + session.network().now().since(self.host)
    }
}

fn interval() -> IntervalLog2 {
    IntervalLog2::new(INTERVAL_LOG2.into()).expect("one of those there are")
}

/// What all axes may do: several times what the longest way takes, whose peaks are 1.9·V/40, 5.8·V/40² and 60·V/40³ for V of 600 steps.
fn settings() -> AxisSettings {
    let flat = |value| CurveSettings { at_rest: value, at_full: value, knee: 0 };
    AxisSettings {
        interval_log2: INTERVAL_LOG2,
        step_log2: STEP_LOG2,
        policy: StarvedPolicy::Stop,
        missing_max: 0,
        stop_log2: 16,
        position_min: -(1 << 20),
        position_max: 1 << 20,
        velocity: 10_000,
        acceleration: flat(5_000),
        jerk: flat(2_000),
    }
}

pub(super) fn run(context: &Context) -> Result<Report, Failure> {
    let mut busy = String::new();
    for _ in 0..ATTEMPTS_MAX {
        match play(context)? {
            Ended::Played(report) => return Ok(*report),
            Ended::Busy(why) => busy = why,
        }
    }
    Err(Failure::NotRun(format!("in {ATTEMPTS_MAX} runs the computer was too busy to send points in time: {busy}")))
}

fn play(context: &Context) -> Result<Ended, Failure> {
    let motor = Motor::start(context)?;
    let mut session = motor.session()?;
    let device = session.destination(&route("/0"));
    let clock = settled_clock(&mut session, &device)?;
    let to = Destination { port: MOTION, ttl_us: u16::MAX, ..device };
    let before = motor.pins()?;
    let described = session.motion(&to, &MotionRequest::Describe)?;
    set_up(&mut session, &to)?;
    let tracks = WAYS.map(Track::new);
    let first = clock.now(&mut session) + LEAD;
    let first = NetTime::from_steps(first.steps().next_multiple_of(interval().steps().into()));
    let (slowest, late) = send(&mut session, &to, &tracks, &clock, first)?;
    let busy = |what: String| format!("{what}; {} ms passed between two looks", slowest.as_us_ceil() / 1_000);
    if let Some(late) = late {
        let why = busy(late);
        return if slowest > BUSY { Ok(Ended::Busy(why)) } else { Err(Failure::Failed(why)) };
    }
    let statuses = at_rest(&mut session, &to)?;
    if let Some(halted) = statuses.iter().find_map(|status| status.halted)
        && slowest > BUSY
    {
        return Ok(Ended::Busy(busy(format!("the device halted: {halted:?}"))));
    }
    let mut report = Report::new();
    let is_described =
        matches!(described, MotionReply::Described { axes: 4, beat_us: 64, channels: 2, outputs: 4, .. });
    report.check(is_described, format!("Cortex-M7: it says {described:?}"));
    judge_ends(&mut report, &tracks, &statuses);
    judge_history(&mut report, &mut session, &to, &tracks, first)?;
    let (again, began) = (motor.pins()?, session.network().now());
    session.network().pause(LEAD)?;
    let (pins, ended) = (motor.pins()?, session.network().now());
    judge_pins(&mut report, &before, &pins);
    let rate =
        real(u64::from(pins.beats.wrapping_sub(again.beats))) / real(ended.since(began).as_us_ceil().max(1)) * 1e3;
    report.line(format!(
        "Beats of the emulated Cortex-M7 by this computer's clock: {rate:.2} kHz, of 15.625 on hardware."
    ));
    report.datum("beats_khz", json!(rate));
    Ok(Ended::Played(Box::new(report)))
}

/// Waits for an answer and a settled clock, has the device ask for the time seldom, and reads its clock.
fn settled_clock(session: &mut Session, device: &Destination) -> Result<SystemClock, Failure> {
    await_answer(session, device)?;
    let status = session.time_status(device)?.value;
    session.set_time_control(device, &TimeSettings { interval_us: 10_000_000, ..status.settings })?;
    let mut is_settled = status.is_settled;
    for _ in 0..LOOKS_MAX {
        if is_settled {
            break;
        }
        session.network().pause(PAUSE)?;
        is_settled = session.time_status(device)?.value.is_settled;
    }
    if !is_settled {
        return Err(Failure::Failed(format!("the device's clock was not settled after {LOOKS_MAX} looks at it")));
    }
    let answer = session.time_control(device)?;
    Ok(SystemClock { system: NetTime::from_steps(answer.value.system_time_steps), host: answer.arrived })
}

/// Arms all axes at rest, and has output 0 be high while axis 0 is far up.
fn set_up(session: &mut Session, to: &Destination) -> Result<(), Failure> {
    let mut requests = Vec::new();
    for axis in (0..).take(AXES) {
        requests.push(MotionRequest::Configure { axis, settings: settings() });
        requests.push(MotionRequest::Arm { axis, position: MIDDLE });
    }
    let a = Source::input(0).expect("the position of axis 0");
    let above = Node::Above { a, threshold: THRESHOLD, hysteresis: 1 << STEP_LOG2 };
    requests.push(MotionRequest::SetNode { node: 0, bytes: above.encode() });
    requests.push(MotionRequest::SetOutput { output: 0, node: Some(0) });
    for request in &requests {
        let mut answer = session.motion(to, request);
        for _ in 0..TRIES {
            // its highest task takes one order a beat
            if !matches!(answer, Err(AskError::MotionRefused { refusal: MotionRefusal::Busy, .. })) {
                break;
            }
            session.network().pause(RETRY)?;
            answer = session.motion(to, request);
        }
        answer?;
    }
    Ok(())
}

/// Sends all points in time. The longest time between two looks, and what was late.
fn send(
    session: &mut Session,
    to: &Destination,
    tracks: &[Track; AXES],
    clock: &SystemClock,
    first: NetTime,
) -> Result<(Span, Option<String>), Failure> {
    let (mut sent, mut slowest, mut looked) = ([0; AXES], Span::ZERO, clock.now(session));
    while sent.iter().zip(tracks).any(|(sent, track)| *sent < track.0.len()) {
        let now = clock.now(session);
        slowest = slowest.max(now.since(looked));
        looked = now;
        for ((axis, track), sent) in (0..).zip(tracks).zip(&mut sent) {
            let due = (now + LEAD).since(first).steps() / u64::from(interval().steps()) + 1;
            let due = track.0.len().min(usize::try_from(due).unwrap_or(usize::MAX));
            while *sent < due {
                let positions = &track.0[*sent..due.min(*sent + CHUNK)];
                let time = first + Span::from_steps(*sent as u64 * u64::from(interval().steps()));
                match session.motion_points(to, &Points { axis, time, positions }) {
                    Ok(_) => *sent += positions.len(),
                    Err(AskError::MotionRefused { refusal: refusal @ MotionRefusal::Late { .. }, .. }) => {
                        slowest = slowest.max(clock.now(session).since(looked));
                        return Ok((slowest, Some(format!("axis {axis}: {refusal:?}"))));
                    }
                    Err(error) => return Err(error.into()),
                }
            }
        }
        session.network().pause(PAUSE)?;
    }
    Ok((slowest, None))
}

/// Waits until nothing moves any more.
fn at_rest(session: &mut Session, to: &Destination) -> Result<[AxisStatus; AXES], Failure> {
    let mut statuses = [AxisStatus::default(); AXES];
    for _ in 0..LOOKS_MAX {
        for (axis, status) in (0..).zip(&mut statuses) {
            let reply = session.motion(to, &MotionRequest::Status { axis })?;
            let MotionReply::Status(told) = reply else { return Err(odd(&reply)) };
            *status = told;
        }
        if statuses.iter().all(|status| status.state == AxisState::Starved) {
            return Ok(statuses);
        }
        session.network().pause(PAUSE)?;
    }
    Err(Failure::Failed(format!("not all axes came to rest within {LOOKS_MAX} looks: {statuses:?}")))
}

fn odd(reply: &MotionReply) -> Failure {
    Failure::Failed(format!("the motion port answered something else: {reply:?}"))
}

/// Each axis took all points, ended where its track does, and nothing went wrong.
fn judge_ends(report: &mut Report, tracks: &[Track; AXES], statuses: &[AxisStatus; AXES]) {
    for (axis, (track, status)) in tracks.iter().zip(statuses).enumerate() {
        let AxisStatus { position, accepted, refused, rebuilt, starved, fault, halted, .. } = *status;
        let counts = [accepted as usize, refused as usize, rebuilt as usize, starved as usize];
        let is_whole = counts == [track.0.len(), 0, 0, 1] && fault.is_none() && halted.is_none();
        report.check(
            is_whole && position == track.point(i64::MAX),
            format!(
                "Cortex-M7: axis {axis} took {accepted} of {} points and rests at {position}; refused {refused}, rebuilt {rebuilt}, \
                 fault {fault:?}, halt {halted:?}",
                track.0.len()
            ),
        );
    }
}

/// Where axes were, by the device's history, against the exact spline.
fn judge_history(
    report: &mut Report,
    session: &mut Session,
    to: &Destination,
    tracks: &[Track; AXES],
    first: NetTime,
) -> Result<(), Failure> {
    let interval_us = i64::from(interval().us());
    let (mut rows, mut asked) = (Vec::new(), 0);
    for (axis, track) in (0..).zip(tracks) {
        let (mut off_max, mut velocity_off, mut are_jerks_exact) = (0, [0.0f64; 2], true);
        let end_us = interval_us * i64::try_from(track.0.len()).unwrap_or(i64::MAX);
        for us in (-2 * interval_us..end_us).step_by(ASKED_US) {
            let time_steps = first.shifted(us * 256).steps();
            let reply = session.motion(to, &MotionRequest::MotionAt { axis, time_steps })?;
            let MotionReply::Motion { position, velocity, jerk, .. } = reply else { return Err(odd(&reply)) };
            let (exact, velocity_per_s, exact_jerk) = track.at(us);
            off_max = off_max.max((position - exact).abs());
            #[expect(clippy::cast_precision_loss, reason = "far below 2^53")]
            let exact_velocity = velocity_per_s as f64 * 16.0 * f64::from(interval().us()) / 1e6;
            let off = f64::from(velocity) - exact_velocity;
            velocity_off = [velocity_off[0].min(off), velocity_off[1].max(off)];
            are_jerks_exact &= jerk == exact_jerk;
            asked += 1;
        }
        let is_near = VELOCITY_OFF.start < velocity_off[0] && velocity_off[1] < VELOCITY_OFF.end;
        rows.push(vec![
            axis.to_string(),
            off_max.to_string(),
            format!("{:.2} to {:.2}", velocity_off[0], velocity_off[1]),
            are_jerks_exact.to_string(),
        ]);
        report.check(
            off_max <= POSITION_OFF_MAX && is_near && are_jerks_exact,
            format!("Cortex-M7: axis {axis} was where its spline is, to {off_max} LSB"),
        );
    }
    report.line(format!("{asked} questions where axes were, to an emulated Cortex-M7, against the exact splines"));
    report.line(table(&["axis", "off by LSB", "velocity off by LSB/16 an interval", "jerk exact"], &rows));
    Ok(())
}

/// What went out at the pins.
fn judge_pins(report: &mut Report, before: &Pins, after: &Pins) {
    report.check(
        !before.is_enabled && after.is_enabled && before.steps == [0; AXES],
        "Cortex-M7: drivers are off before and on after the first track",
    );
    for (axis, (up, down)) in WAYS.into_iter().enumerate() {
        let (steps, position) = (after.steps[axis], after.positions[axis]);
        report.check(
            steps == u32::from(up) + u32::from(down) && position == i32::from(up) - i32::from(down),
            format!("Cortex-M7: axis {axis} made {steps} steps, {up} up and {down} down, and stands at {position}"),
        );
    }
    report.check(
        after.late_directions == 0,
        format!("Cortex-M7: {} steps came with a change of their direction", after.late_directions),
    );
    report.check(
        after.edges == [1, 0, 0, 0] && after.outputs == 0,
        format!("Cortex-M7: output 0 was high once, while axis 0 was past its threshold: edges {:?}", after.edges),
    );
    report.datum("m7_motion", json!({ "steps": after.steps, "positions": after.positions, "beats": after.beats }));
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The tables in `boards/mps2-an500/src/outputs.rs` and `signals.rs`.
    #[test]
    fn records_are_read_as_the_board_writes_them_and_nothing_else_for_them() {
        let (steps, signals) =
            ([STEPS_MARK, 1, 2, 1, 4, 5, 6, 7, u32::MAX, 9, 10, 11, 12], [SIGNALS_MARK, 3, 1, 0, 0, 2]);
        let bytes = steps.map(u32::to_le_bytes).concat();
        let pins = Pins::decode(&words(&bytes), &signals).unwrap();
        assert_eq!((pins.beats, pins.is_enabled, pins.steps, pins.positions), (1, true, [4, 5, 6, 7], [-1, 9, 10, 11]));
        assert_eq!((pins.late_directions, pins.outputs, pins.edges), (12, 3, [1, 0, 0, 2]));
        assert_eq!(Pins::decode(&[0; 13], &signals), None);
        assert_eq!(Pins::decode(&steps, &[0; 6]), None);
    }

    /// Each way goes in one direction and keeps what [`settings`] allow, less what a halt may add; it rests in the middle of a step.
    #[test]
    fn tracks_go_up_and_down_once_within_the_limits() {
        let AxisSettings { velocity, acceleration, jerk, .. } = settings();
        for way in WAYS {
            let track = Track::new(way);
            let all: Vec<i32> =
                (-3..i64::try_from(track.0.len()).unwrap() + 3).map(|index| track.point(index)).collect();
            let differences = |of: &[i32]| of.windows(2).map(|pair| pair[1] - pair[0]).collect::<Vec<_>>();
            let first = differences(&all);
            let (second, most) = (differences(&first), |of: &[i32]| of.iter().map(|it| it.abs()).max().unwrap());
            // a halt of 3·2^16 µs is 12 intervals: 2V/12 of acceleration, 3.27·A/12 + 4V/12² of jerk are kept for it
            let (v, a) = (f64::from(velocity), f64::from(acceleration.at_rest));
            assert!(most(&first) < velocity && f64::from(most(&second)) < a - v / 6.0);
            assert!(
                f64::from(most(&differences(&second))) < f64::from(jerk.at_rest) - 3.27 * a / 12.0 - 4.0 * v / 144.0
            );
            // differences: two before the first point, then one a point
            let turn = usize::from(2 + UP + REST);
            assert!(first[..turn].iter().all(|it| *it >= 0) && first[turn..].iter().all(|it| *it <= 0));
            assert_eq!(track.point(i64::MAX).rem_euclid(1 << STEP_LOG2), MIDDLE);
        }
    }
}

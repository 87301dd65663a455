//! A workstation, a hub and two motors in a row, with the truth about their time.
//!
//! - **Walk:** power-on → [`Stage::start`] waits until the motors' clocks are settled → requests, [`Feed`] of points → [`Stage::edges`].
//! - **Invariants:** the hub is started first and is the root: system time is its counter and a constant, which it tells, and the co-simulation
//!   knows what its counter reads at any instant. Crystals keep their rates here. Virtual time.

use super::super::Context;
use super::judge::Pins;
use super::track::Series;
use crate::cosim::{ClockAt, NS_PER_MS, Ns, Profile};
use crate::network::{BAUD, HostPort};
use crate::pico::{Bench, HUB, MOTOR, pico, route};
use crate::pins::{PICO_AXES, PICO_ENABLE, PICO_OUTPUTS};
use crate::report::Failure;
use fixed_math::time::{NetTime, Span};
use osap::core::{Completion, HostCore, Outcome};
use osap::error::AskError;
use osap_protocol::PortIndex;
use osap_protocol::discovery::{Query, TIER_FREE_RUNNING, TimeControl, VERSION, decode};
use osap_protocol::motion::{
    AxisStatus, MotionRefusal, MotionReply, MotionRequest, POINTS_MAX, Points, REPLY_BYTES_MAX, ReadingMessage,
    refusal, reply,
};
use osap_runtime::sequenced::{Destination, Expect, Ticket};
use std::collections::HashMap;

/// Motion port of a motor, `[APP-01]`.
const MOTION: PortIndex = PortIndex::from_low_bits(4);
/// The motors.
pub(super) const MOTORS: usize = 2;
/// The chips: name, start, crystal; each is wired to the one before it.
const CHIPS: [(&str, Ns, f64); MOTORS + 1] =
    [("hub", 0, -35.0), ("one", 37 * NS_PER_MS, 50.0), ("two", 81 * NS_PER_MS, -50.0)];
const ROUTES: [&str; MOTORS + 1] = ["/0", "/0/1", "/0/1/1"];
/// A clock that may be off by less, 1/256 µs, is settled enough to compare edges by it.
const BOUND_STEPS_MAX: i32 = 3 * 256;
/// The clocks get so long for it.
const SETTLE_NS: Ns = 4_000 * NS_PER_MS;
/// Most messages that are under way together.
const OPEN_MAX: usize = 6;
/// A message's time to live.
const TTL_US: u16 = 30_000;

/// System time by the co-simulation's own clock: a line.
#[derive(Clone, Copy, Debug)]
pub(super) struct Truth {
    global_ns: f64,
    system_ns: f64,
    rate: f64,
}

impl Truth {
    /// System time, ns.
    pub(super) fn system_ns(&self, global_ns: f64) -> f64 {
        self.system_ns + (global_ns - self.global_ns) * self.rate
    }

    /// The global instant of a system time.
    pub(super) fn global_ns(&self, system: NetTime) -> f64 {
        (ns(system.steps()) - self.system_ns) / self.rate + self.global_ns
    }
}

/// Steps of 1/256 µs in nanoseconds.
#[expect(clippy::cast_precision_loss, reason = "exact below 2^53 steps, a year")]
pub(super) fn ns(steps: u64) -> f64 {
    steps as f64 * 1_000.0 / 256.0
}

/// Nanoseconds as a time, rounded down.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a time after the origin")]
pub(super) fn net_time(ns: f64) -> NetTime {
    NetTime::from_steps((ns * 256.0 / 1_000.0) as u64)
}

/// The stage.
pub(super) struct Stage {
    pub(super) bench: Bench,
    pub(super) truth: Truth,
    /// Names of the chips that move.
    pub(super) names: Vec<&'static str>,
    /// Their motion ports.
    pub(super) ports: Vec<Destination>,
    /// What their pins did.
    pub(super) pins: Vec<Pins>,
    /// Largest errors that the motors' clocks may have, as they say, 1/256 µs.
    pub(super) bounds_steps: Vec<i32>,
    /// Messages that were not answered yet: points, motor and axis of each.
    open: HashMap<Ticket, (u8, usize, u8)>,
    /// Refusals of messages that were not waited for.
    pub(super) refused: Vec<MotionRefusal>,
    /// Points taken of such messages, and sent in datagrams.
    pub(super) taken: u32,
    pub(super) readings: Vec<ReadingMessage>,
    /// What was answered and was none of ours.
    pub(super) strangers: Vec<Ticket>,
}

impl Stage {
    /// All three, settled.
    pub(super) fn start(context: &Context) -> Result<Self, Failure> {
        let mut bench = Bench::build(&context.places, context.seed, &[HostPort::uart("host")], false, |cosim, elf| {
            for (number, (name, start_ns, ppm)) in (0u64..).zip(CHIPS) {
                let kind = if number == 0 { HUB } else { MOTOR };
                cosim.chip(&crate::cosim::Chip { ppm, start_ns, ..pico(name, elf, 0xc0 + number, kind) })?;
            }
            cosim.port("host", (CHIPS[0].0, 0), BAUD, None)?;
            for pair in CHIPS.windows(2) {
                cosim.wire(pair[1].0, (pair[0].0, 1), (pair[1].0, 0), None)?;
            }
            Ok(())
        })?;
        let hosts = ROUTES.map(|text| bench.session.destination(&route(text)));
        let (truth, bounds_steps) = settle(&mut bench, &hosts)?;
        let names = CHIPS[1..].iter().map(|(name, ..)| *name).collect();
        Self::over(bench, truth, names, &hosts[1..], bounds_steps)
    }

    /// One motor alone, which is its own root.
    pub(super) fn alone(context: &Context, elf: &std::path::Path) -> Result<Self, Failure> {
        let mut bench = Bench::build(&context.places, context.seed, &[HostPort::uart("host")], false, |cosim, _| {
            cosim.chip(&pico("motor", elf, 0xd1, MOTOR))?;
            Ok(cosim.port("host", ("motor", 0), BAUD, None)?)
        })?;
        let motor = bench.session.destination(&route("/0"));
        let control = time_of(&mut bench, &motor)?;
        let truth = truth_of(&bench, "motor", &control)?;
        Self::over(bench, truth, vec!["motor"], &[motor], vec![0])
    }

    fn over(
        bench: Bench,
        truth: Truth,
        names: Vec<&'static str>,
        chips: &[Destination],
        bounds_steps: Vec<i32>,
    ) -> Result<Self, Failure> {
        let mask = PICO_AXES.iter().fold(1 << PICO_ENABLE, |mask, (step, direction)| mask | 1 << step | 1 << direction);
        let mask = PICO_OUTPUTS.iter().fold(mask, |mask, pin| mask | 1 << pin);
        for name in &names {
            bench.cosim.borrow_mut().pins(name, mask)?;
        }
        let ports =
            chips.iter().map(|chip| Destination { port: MOTION, ttl_us: TTL_US, ..chip.clone() }).collect::<Vec<_>>();
        let pins = names.iter().map(|_| Pins::new()).collect();
        let (open, refused, taken, readings, strangers) = (HashMap::new(), Vec::new(), 0, Vec::new(), Vec::new());
        Ok(Self { bench, truth, names, ports, pins, bounds_steps, open, refused, taken, readings, strangers })
    }

    /// System time now.
    pub(super) fn now(&self) -> NetTime {
        net_time(self.truth.system_ns(real_ns(self.bench.now_ns())))
    }

    /// Lets time pass up to a system time, and takes what is answered.
    pub(super) fn run_until(&mut self, system: NetTime) -> Result<(), Failure> {
        let until = crate::network::ticks(whole_ns(self.truth.global_ns(system)));
        loop {
            let (found, result) = std::sync::mpsc::sync_channel::<Completion>(1);
            let (read, readings) = std::sync::mpsc::channel::<Vec<u8>>();
            let task = move |core: &mut HostCore, _| {
                while let Some(datagram) = core.take_datagram() {
                    // the other end lives as long as this task
                    let _sent = read.send(datagram.payload);
                }
                core.take_completion().is_some_and(|completion| found.try_send(completion).is_ok())
            };
            self.bench.session.network().drive(until, Box::new(task))?;
            for payload in readings.try_iter() {
                self.came(&payload);
            }
            let Ok(completion) = result.try_recv() else { return Ok(()) };
            self.completed(&completion)?;
        }
    }

    fn came(&mut self, payload: &[u8]) {
        if let Some(readings) = ReadingMessage::decode_all(payload) {
            self.readings.extend(readings);
        } else if let [_, osap_protocol::motion::REFUSAL_OPERATION, body @ ..] = payload {
            self.refused.extend(refusal(body));
        }
    }

    fn completed(&mut self, completion: &Completion) -> Result<(), Failure> {
        let Some((points, ..)) = self.open.remove(&completion.ticket) else {
            self.strangers.push(completion.ticket);
            return Ok(());
        };
        match &completion.outcome {
            Outcome::Reply(answer) => match reply(&answer.payload) {
                Some(MotionReply::Accepted { taken, .. }) if taken == points => self.taken += u32::from(taken),
                other => return Err(Failure::Failed(format!("{points} points were answered by {other:?}"))),
            },
            Outcome::Refusal(answer) => self.refused.extend(refusal(&answer.payload)),
            other => return Err(Failure::Failed(format!("points were not answered: {other:?}"))),
        }
        Ok(())
    }

    /// Asks and waits.
    pub(super) fn ask(&mut self, motor: usize, request: &MotionRequest) -> Result<MotionReply, AskError> {
        let to = self.ports[motor].clone();
        self.bench.session.motion(&to, request)
    }

    /// Asks, waits, and has a refusal back as such.
    pub(super) fn refusal(&mut self, motor: usize, request: &MotionRequest) -> Result<MotionRefusal, Failure> {
        match self.ask(motor, request) {
            Err(AskError::MotionRefused { refusal, .. }) => Ok(refusal),
            other => Err(Failure::Failed(format!("{request:?} was to be refused: {other:?}"))),
        }
    }

    /// Points that are to be refused.
    pub(super) fn refused_points(&mut self, motor: usize, points: &Points<'_>) -> Result<MotionRefusal, Failure> {
        let to = self.ports[motor].clone();
        match self.bench.session.motion_points(&to, points) {
            Err(AskError::MotionRefused { refusal, .. }) => Ok(refusal),
            other => Err(Failure::Failed(format!("points of axis {} were to be refused: {other:?}", points.axis))),
        }
    }

    /// How an axis does.
    pub(super) fn status(&mut self, motor: usize, axis: u8) -> Result<AxisStatus, Failure> {
        match self.ask(motor, &MotionRequest::Status { axis })? {
            MotionReply::Status(status) => Ok(status),
            other => Err(Failure::Failed(format!("a status was answered by {other:?}"))),
        }
    }

    /// Sends points without waiting for what comes of it.
    pub(super) fn post(&mut self, motor: usize, points: &Points<'_>, is_datagram: bool) -> Result<(), Failure> {
        let mut bytes = [0; Points::HEAD_BYTES + 4 * POINTS_MAX];
        let len = points.encode(&mut bytes).ok_or_else(|| Failure::Failed("too many points".to_owned()))?;
        let count = u8::try_from(points.positions.len()).unwrap_or(u8::MAX);
        if is_datagram {
            self.taken += u32::from(count);
            return self.datagram_to(motor, &bytes[..len]);
        }
        let to = self.ports[motor].clone();
        let sent = self.bench.session.network().submit(to, Expect::One, &bytes[..len]);
        let ticket = sent.map_err(|error| Failure::Failed(format!("points were not sent: {error:?}")))?;
        self.open.insert(ticket, (count, motor, points.axis));
        Ok(())
    }

    /// Asks by a datagram, so that readings come where datagrams do. A refusal is found among [`Stage::refused`].
    pub(super) fn tell(&mut self, motor: usize, request: &MotionRequest) -> Result<(), Failure> {
        let mut bytes = [0; REPLY_BYTES_MAX];
        let len = request.encode(&mut bytes).ok_or_else(|| Failure::Failed("too long a request".to_owned()))?;
        self.datagram_to(motor, &bytes[..len])
    }

    fn datagram_to(&mut self, motor: usize, payload: &[u8]) -> Result<(), Failure> {
        let now = self.bench.session.network().now();
        let (sent, result) = std::sync::mpsc::sync_channel(1);
        let (to, payload) = (self.ports[motor].clone(), payload.to_vec());
        let mut open = Some(sent);
        let task = move |core: &mut HostCore, now| {
            if let Some(sent) = open.take() {
                let _told = sent.try_send(core.send_datagram(&to, &payload, now));
            }
            true
        };
        self.bench.session.network().drive(now + Span::from_us(1), Box::new(task))?;
        match result.try_recv() {
            Ok(Ok(())) => Ok(()),
            other => Err(Failure::Failed(format!("a datagram was not sent: {other:?}"))),
        }
    }

    /// What the pins did since the last call, to each motor's [`Pins`].
    pub(super) fn edges(&mut self) -> Result<(), Failure> {
        for (name, pins) in self.names.iter().zip(&mut self.pins) {
            let edges = self.bench.cosim.borrow_mut().edges(name)?;
            if edges.lost > 0 {
                return Err(Failure::Failed(format!("{} edges of {name} were not kept", edges.lost)));
            }
            pins.take(&edges.edges, &self.truth);
        }
        Ok(())
    }

    /// Where a motor's time went since the last call.
    pub(super) fn profile(&self, motor: usize) -> Result<Profile, Failure> {
        Ok(self.bench.cosim.borrow_mut().profile(self.names[motor], true)?)
    }
}

/// Points that are sent ahead of time.
pub(super) struct Feed {
    /// When, to which motor, which axis, points from index to index, and whether as a datagram.
    items: Vec<(NetTime, usize, u8, std::ops::Range<usize>, bool)>,
}

impl Feed {
    /// Series of axes of motors, `chunk` points a message, each `ahead` of the time of its first point; every third message is a datagram
    /// where `mixed`. `delay` is that of the motors' stops.
    pub(super) fn new(series: &[(usize, u8, &Series)], chunk: usize, ahead: Span, mixed: bool, delay: Span) -> Self {
        let mut items = Vec::new();
        for (motor, axis, series) in series {
            let step = u64::from(series.interval.steps());
            for (number, from) in (0..series.points.len()).step_by(chunk).enumerate() {
                let first = series.start + Span::from_steps((from as u64 + 1) * step) + delay;
                let at = first.shifted(-ahead.steps().cast_signed());
                let to = (from + chunk).min(series.points.len());
                // the first message of a series has to be the first to come
                items.push((at, *motor, *axis, from..to, mixed && number % 3 == 2));
            }
        }
        items.sort_by_key(|(at, motor, axis, range, _)| (*at, range.start, *motor, *axis));
        Self { items }
    }

    /// Sends all, each at its time, and runs up to `until`.
    pub(super) fn play(
        self,
        stage: &mut Stage,
        series: &[(usize, u8, &Series)],
        until: NetTime,
    ) -> Result<(), Failure> {
        for (at, motor, axis, range, is_datagram) in self.items {
            if at > until {
                break;
            }
            stage.run_until(at.max(stage.now()))?;
            // messages under way together come in any order, and points of an axis may not
            while stage.open.len() >= OPEN_MAX || stage.open.values().any(|(_, to, of)| (*to, *of) == (motor, axis)) {
                stage.run_until(stage.now() + Span::from_us(100))?;
            }
            let Some((.., series)) = series.iter().find(|(to, of, _)| (*to, *of) == (motor, axis)) else { continue };
            let time = series.start + Span::from_steps((range.start as u64 + 1) * u64::from(series.interval.steps()));
            stage.post(motor, &Points { axis, time, positions: &series.points[range] }, is_datagram)?;
        }
        stage.run_until(until)
    }
}

/// A time in whole nanoseconds.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a time after the origin")]
fn whole_ns(ns: f64) -> Ns {
    ns.ceil() as Ns
}

fn real_ns(ns: Ns) -> f64 {
    crate::report::real(ns)
}

fn time_of(bench: &mut Bench, chip: &Destination) -> Result<TimeControl, Failure> {
    let reply = bench.session.request(chip, "time", &[Query::TimeControl.key(), VERSION])?;
    let read = decode(&reply.payload).and_then(|message| message.body.read());
    read.map_err(|error| Failure::Failed(format!("the answer about time cannot be read: {error:?}")))
}

/// System time by what the root says of its counter.
fn truth_of(bench: &Bench, root: &str, control: &TimeControl) -> Result<Truth, Failure> {
    let read = bench.cosim.borrow_mut().time(root, ClockAt::LocalNs(ns(control.local_ticks_steps)))?;
    Ok(Truth { global_ns: read.global_ns, system_ns: ns(control.system_time_steps), rate: 1.0 + read.ppm * 1e-6 })
}

/// Waits until both motors follow the hub, and are sure to a few microseconds.
fn settle(bench: &mut Bench, chips: &[Destination; MOTORS + 1]) -> Result<(Truth, Vec<i32>), Failure> {
    while bench.now_ns() < SETTLE_NS {
        bench.run_for(50 * NS_PER_MS)?;
        let mut bounds = Vec::new();
        for chip in &chips[1..] {
            let control = time_of(bench, chip)?;
            let is_settled = control.tier != 0 && control.tier != TIER_FREE_RUNNING && control.bound_steps >= 0;
            bounds.extend(is_settled.then_some(control.bound_steps));
        }
        if bounds.len() == MOTORS && bounds.iter().all(|bound| *bound <= BOUND_STEPS_MAX) {
            let control = time_of(bench, &chips[0])?;
            if control.tier != 0 {
                return Err(Failure::Failed("the hub, started first, is not the root".to_owned()));
            }
            return Ok((truth_of(bench, CHIPS[0].0, &control)?, bounds));
        }
    }
    Err(Failure::Failed(format!("clocks were not settled {} ms after power-on", SETTLE_NS / NS_PER_MS)))
}

//! System time on real Pico images, against the truth: a root, a device one step from it and one two steps from it.
//!
//! - **Walk:** power-on, one after the other → bursts of time requests → query 9 at each chip, again and again: one instant by the chip's
//!   counter and by its system time → the co-simulation says when that was, and what the root's counter read then.
//! - **Invariants:** a sample's truth is exact: a chip names the tick of its timer that it read, and the co-simulation knows when the timer
//!   ticked, to far below a nanosecond. Virtual time. The root's time is its counter and a constant, which its own answers tell.
//! - **Clauses:** `[TIM-03]`, `[TIM-04]`, `[TIM-05]`, `[TIM-09]`.

use super::Context;
use crate::cosim::{ClockAt, Cosim, NS_PER_MS, Ns};
use crate::images::Image;
use crate::network::{BAUD, HostPort};
use crate::pico::{Bench, HUB, MOTOR, pico, route};
use crate::report::{Failure, Report, table};
use firmware_app::stream::StreamRequest;
use fixed_math::time::{LocalTicks, Span};
use osap::core::{Completion, HostCore, Outcome};
use osap::network::Network;
use osap_protocol::PortIndex;
use osap_protocol::discovery::{Query, TIER_FREE_RUNNING, TimeControl, VERSION, decode};
use osap_protocol::time::{TimeReply, TimeRequest};
use osap_runtime::sequenced::{Destination, Expect, Ticket};
use serde_json::json;
use std::path::Path;

/// Ports of every device, `[APP-01]`.
const STREAM: PortIndex = PortIndex::from_low_bits(2);
const SPIN: PortIndex = PortIndex::from_low_bits(3);
/// The chips: name, start, crystal and its ramp; each is wired to the one before it.
const CHIPS: [(&str, Ns, f64, f64); 3] =
    [("root", 0, -35.0, 0.01), ("one", 37 * NS_PER_MS, 50.0, -0.01), ("two", 81 * NS_PER_MS, -50.0, 0.01)];
/// Their routes.
const ROUTES: [&str; 3] = ["/0", "/0/1", "/0/1/1"];
/// From one question to the next: a different chip each time.
const QUESTION_NS: Ns = 1_700_000;
/// A packet of load each way in every such time is four fifths of what a wire of 3 Mbaud carries: 240 bytes of ten bits are 800 µs.
const LOAD_NS: Ns = NS_PER_MS;
const LOAD_BYTES: u16 = 222;
/// Turns of the first spin, whose time tells what a turn takes.
const TRIAL_TURNS: u32 = 20_000;
/// What a spin shall take.
const SPIN_NS: Ns = 20 * NS_PER_MS;
/// Samples after this time since a chip's start count as settled.
const SETTLED_NS: Ns = 1_000 * NS_PER_MS;
/// Goals: root mean square, 99.9th percentile, and times since the start to stay within 10 µs and 1 µs.
const GOAL_RMS_US: f64 = 0.5;
const GOAL_P999_US: f64 = 1.5;
const GOAL_TEN_MS: f64 = 500.0;
const GOAL_ONE_MS: f64 = 1_000.0;
/// A reply is 65 bytes longer than a request: stamps at the ends of frames would put half that time between the two clocks, µs.
#[expect(clippy::cast_precision_loss, reason = "two small numbers")]
const END_BIAS_US: f64 = (TimeReply::LEN - TimeRequest::LEN) as f64 * 10.0 / (2.0 * 3.0);
/// What is left of it may be two ticks of a stamp, 1/16 µs each, a step.
const BIAS_US_MAX: f64 = 2.0 * 2.0 / 16.0;

/// One answer of a chip, and the truth about it.
#[derive(Clone, Copy, Debug)]
struct Sample {
    since_start_ns: f64,
    error_us: f64,
    bound_us: Option<f64>,
    is_following: bool,
}

/// What the chips have to do beside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Load {
    /// Nothing but questions.
    Idle,
    /// The beat at 15.6 kHz, both links at 80 % both ways, and a user function that takes 20 ms, again and again.
    Full,
}

pub(super) fn run(context: &Context, ms: u64) -> Result<Report, Failure> {
    let mut report = Report::new();
    report.line(format!(
        "System time of real RP2040 images, co-simulated over {ms} virtual ms, against the truth; µs, times in ms since power-on of the chip. \
         Stamps of 1/16 µs; crystals of -35, +50 and -50 ppm with ramps of 0.01 ppm/s; seed {}",
        context.seed
    ));
    let mut rows = Vec::new();
    for (name, load) in [("idle", Load::Idle), ("loaded", Load::Full)] {
        let samples = measure(context, load, ms)?;
        for (steps, samples) in samples.iter().enumerate().skip(1) {
            let figures = Figures::of(samples).ok_or_else(|| {
                Failure::Failed(format!("{name}: too few answers of the chip {steps} steps from the root"))
            })?;
            rows.push(figures.row(name, steps, samples.len()));
            figures.judge(&mut report, name, steps);
            report.datum(&format!("{name}-{steps}"), figures.json(samples));
        }
    }
    let head =
        ["load", "steps", "samples", "bias", "rms", "p99.9", "max", "<10 after", "<1 after", "bound", "error/bound"];
    report.line(table(&head, &rows));
    report.line("Loaded: the 15.6 kHz interrupt with no axis armed, 80 % of both wires both ways, and a user function of 20 ms at a time, on all chips.");
    Ok(report)
}

fn start(context: &Context) -> Result<Bench, Failure> {
    let image = Image::Rp2040Pico;
    let elf = context.places.image(image)?;
    Bench::build(&context.places, context.seed, &[HostPort::uart("host")], false, |cosim, _| wire_up(cosim, &elf))
}

fn wire_up(cosim: &mut Cosim, elf: &Path) -> Result<(), Failure> {
    for (number, (name, start_ns, ppm, _)) in (0u64..).zip(CHIPS) {
        let kind = if number == 0 { HUB } else { MOTOR };
        cosim.chip(&crate::cosim::Chip { ppm, start_ns, ..pico(name, elf, 0xb0 + number, kind) })?;
    }
    cosim.port("host", (CHIPS[0].0, 0), BAUD, None)?;
    for pair in CHIPS.windows(2) {
        cosim.wire(pair[1].0, (pair[0].0, 1), (pair[1].0, 0), None)?;
    }
    Ok(())
}

/// Asks all chips in turn for `ms` after the last was started.
fn measure(context: &Context, load: Load, ms: u64) -> Result<[Vec<Sample>; 3], Failure> {
    let mut bench = start(context)?;
    for (name, _, ppm, ramp) in CHIPS {
        bench.cosim.borrow_mut().crystal(name, ppm, ramp)?;
    }
    let mut run = Run { raw: Default::default(), open: Vec::new(), spins: [None; 2], spin_turns: [TRIAL_TURNS; 2] };
    let to = ROUTES.map(|text| bench.session.destination(&route(text)));
    let end_ns = CHIPS[2].1 + ms * NS_PER_MS;
    let (mut question_ns, mut load_ns, mut next) = (bench.now_ns(), bench.now_ns(), 0);
    if load == Load::Full {
        let count = u32::try_from(ms).unwrap_or(u32::MAX);
        let interval_us = u32::try_from(LOAD_NS / 1_000).unwrap_or(u32::MAX);
        let request = StreamRequest { interval_us, payload_bytes: LOAD_BYTES, count, ttl_us: 30_000 };
        let stream = Destination { port: STREAM, ..to[2].clone() };
        bench.session.request(&stream, "a stream", &request.encode())?;
    }
    while bench.now_ns() < end_ns {
        let now_ns = bench.now_ns();
        if now_ns >= question_ns && run.open.len() < 8 {
            let question = [Query::TimeControl.key(), VERSION];
            let at = Destination { port: PortIndex::NETRESPONDER, ttl_us: 30_000, ..to[next].clone() };
            run.open.push((submit(&mut bench, at, &question)?, next));
            question_ns = now_ns + QUESTION_NS;
            next = (next + 1) % 3;
        }
        if load == Load::Full {
            run.spin(&mut bench, &to)?;
            if now_ns >= load_ns {
                feed(&mut bench, &to[2])?;
                load_ns += LOAD_NS;
            }
        }
        let until_ns = question_ns.min(if load == Load::Full { load_ns } else { Ns::MAX }).max(now_ns + 10_000);
        run.wait(&mut bench, until_ns)?;
    }
    run.judged(&mut bench)
}

/// What is asked and was answered.
struct Run {
    /// The answers of each chip.
    raw: [Vec<TimeControl>; 3],
    open: Vec<(Ticket, usize)>,
    /// Spins under way at the two devices, and when they were asked for.
    spins: [Option<(Ticket, Ns)>; 2],
    spin_turns: [u32; 2],
}

impl Run {
    /// Has each device spin again as soon as it is done.
    fn spin(&mut self, bench: &mut Bench, to: &[Destination; 3]) -> Result<(), Failure> {
        for (device, spin) in self.spins.iter_mut().enumerate().filter(|(_, spin)| spin.is_none()) {
            let at = Destination { port: SPIN, ttl_us: u16::MAX, ..to[device + 1].clone() };
            *spin = Some((submit(bench, at, &self.spin_turns[device].to_le_bytes())?, bench.now_ns()));
        }
        Ok(())
    }

    /// Takes what is answered until `until_ns`.
    fn wait(&mut self, bench: &mut Bench, until_ns: Ns) -> Result<(), Failure> {
        let until = crate::network::ticks(until_ns);
        while let Some(Completion { ticket, outcome, .. }) = next(bench.session.network(), until)? {
            let now_ns = bench.now_ns();
            for (spin, turns) in self.spins.iter_mut().zip(&mut self.spin_turns) {
                if let Some((_, since)) = spin.take_if(|(open, _)| *open == ticket) {
                    let took_ns = (now_ns - since).max(1);
                    let scaled = u64::from(*turns) * SPIN_NS / took_ns;
                    *turns = u32::try_from(scaled).unwrap_or(u32::MAX).max(1);
                }
            }
            let Some(at) = self.open.iter().position(|(open, _)| *open == ticket) else { continue };
            let (_, chip) = self.open.swap_remove(at);
            if let Outcome::Reply(reply) = outcome
                && let Ok(control) = decode(&reply.payload).and_then(|message| message.body.read())
            {
                self.raw[chip].push(control);
            }
        }
        Ok(())
    }

    /// The truth about each answer.
    fn judged(self, bench: &mut Bench) -> Result<[Vec<Sample>; 3], Failure> {
        let root = self.raw[0].iter().filter(|control| control.tier == 0);
        let mut constants: Vec<i64> =
            root.map(|it| it.system_time_steps.wrapping_sub(it.local_ticks_steps).cast_signed()).collect();
        constants.dedup();
        let [constant] = constants[..] else {
            return Err(Failure::Failed(format!(
                "the chip started first is not the one root: its constants are {constants:?}"
            )));
        };
        let mut all: [Vec<Sample>; 3] = Default::default();
        for ((samples, raw), (name, start_ns, _, _)) in all.iter_mut().zip(&self.raw).zip(CHIPS) {
            for control in raw {
                let mut cosim = bench.cosim.borrow_mut();
                let read = cosim.time(name, ClockAt::LocalNs(ns(control.local_ticks_steps)))?;
                let truth = cosim.time(CHIPS[0].0, ClockAt::GlobalNs(read.global_ns))?;
                let system_ns = ns(control.system_time_steps.wrapping_sub(constant.cast_unsigned()));
                #[expect(clippy::cast_precision_loss, reason = "exact below 2^53 ns")]
                let since_start_ns = read.global_ns - start_ns as f64;
                samples.push(Sample {
                    since_start_ns,
                    error_us: (system_ns - truth.local_ns) / 1_000.0,
                    bound_us: (control.bound_steps >= 0).then(|| f64::from(control.bound_steps) / 256.0),
                    is_following: control.tier != 0 && control.tier != TIER_FREE_RUNNING,
                });
            }
        }
        Ok(all)
    }
}

/// Steps of 1/256 µs in nanoseconds.
#[expect(clippy::cast_precision_loss, reason = "exact below 2^53 steps, a year")]
fn ns(steps: u64) -> f64 {
    steps as f64 * 1_000.0 / 256.0
}

fn submit(bench: &mut Bench, to: Destination, payload: &[u8]) -> Result<Ticket, Failure> {
    let sent = bench.session.network().submit(to, Expect::One, payload);
    sent.map_err(|error| Failure::Failed(format!("not sent: {error:?}")))
}

/// Sends one datagram of load towards the last chip, which drops it, and empties what its stream brought.
fn feed(bench: &mut Bench, last: &Destination) -> Result<(), Failure> {
    let to = Destination { port: STREAM, ttl_us: 30_000, ..last.clone() };
    let now = bench.session.network().now();
    let task = move |core: &mut HostCore, now: LocalTicks| {
        while core.take_datagram().is_some() {}
        // a link that is full for the moment is what the load is for
        let _shed = core.send_datagram(&to, &[0x55; LOAD_BYTES as usize], now);
        true
    };
    Ok(bench.session.network().drive(now + Span::from_us(1), Box::new(task))?)
}

/// The next answer, if it comes before `until`.
fn next(network: &mut dyn Network, until: LocalTicks) -> Result<Option<Completion>, Failure> {
    let (found, result) = std::sync::mpsc::sync_channel(1);
    // one message: the task is called no more after it said so
    let task = move |core: &mut HostCore, _| {
        core.take_completion().is_some_and(|completion| found.try_send(completion).is_ok())
    };
    network.drive(until, Box::new(task))?;
    Ok(result.try_recv().ok())
}

/// One row of the table.
struct Figures {
    /// The mean error, with its sign.
    bias_us: f64,
    rms_us: f64,
    p999_us: f64,
    max_us: f64,
    within_ten_ms: f64,
    within_one_ms: f64,
    bound_median_us: f64,
    /// The largest share of its bound that an error took, over all samples with a bound.
    of_bound: f64,
}

impl Figures {
    fn of(samples: &[Sample]) -> Option<Self> {
        let settled = samples.iter().filter(|sample| sample.since_start_ns >= SETTLED_NS_F64);
        let mut errors: Vec<f64> = settled.map(|sample| sample.error_us).collect();
        #[expect(clippy::cast_precision_loss, reason = "a few thousand samples")]
        let count = errors.len() as f64;
        let bias_us = errors.iter().sum::<f64>() / count;
        for error in &mut errors {
            *error = error.abs();
        }
        errors.sort_by(f64::total_cmp);
        let bounded = samples.iter().filter_map(|sample| Some((sample.error_us.abs(), sample.bound_us?)));
        let mut bounds: Vec<f64> = bounded.clone().map(|(_, bound)| bound).collect();
        bounds.sort_by(f64::total_cmp);
        let mean_square = errors.iter().map(|error| error * error).sum::<f64>() / count;
        Some(Self {
            bias_us,
            rms_us: mean_square.sqrt(),
            p999_us: *errors.get((errors.len() * 999).div_ceil(1_000).checked_sub(1)?)?,
            max_us: *errors.last()?,
            within_ten_ms: stays_within(samples, 10.0),
            within_one_ms: stays_within(samples, 1.0),
            bound_median_us: *bounds.get(bounds.len() / 2)?,
            of_bound: bounded.map(|(error, bound)| error / bound).fold(0.0, f64::max),
        })
    }

    fn row(&self, load: &str, steps: usize, samples: usize) -> Vec<String> {
        let figures = [self.bias_us, self.rms_us, self.p999_us, self.max_us];
        let times = [self.within_ten_ms, self.within_one_ms];
        [load.to_owned(), steps.to_string(), samples.to_string()]
            .into_iter()
            .chain(figures.map(|figure| format!("{figure:.3}")))
            .chain(times.map(|time| format!("{time:.0}")))
            .chain([format!("{:.2}", self.bound_median_us), format!("{:.2}", self.of_bound)])
            .collect()
    }

    fn judge(&self, report: &mut Report, load: &str, steps: usize) {
        let place = format!("{load}, {steps} from the root");
        report.check(
            self.bias_us.abs() <= BIAS_US_MAX,
            format!("{place}: bias {:.3} µs, at most {BIAS_US_MAX}; stamps at the ends of frames would make it {END_BIAS_US:.0}", self.bias_us),
        );
        report.check(self.rms_us <= GOAL_RMS_US, format!("{place}: rms {:.3} µs of {GOAL_RMS_US}", self.rms_us));
        report.check(self.p999_us <= GOAL_P999_US, format!("{place}: p99.9 {:.3} µs of {GOAL_P999_US}", self.p999_us));
        let times = [(10, self.within_ten_ms, GOAL_TEN_MS), (1, self.within_one_ms, GOAL_ONE_MS)];
        for (us, ms, goal) in times {
            report.check(ms <= goal, format!("{place}: within {us} µs for good {ms:.0} ms after power-on, of {goal}"));
        }
        report.check(
            self.of_bound <= 1.0,
            format!("{place}: no error above its bound, at most {:.2} of it", self.of_bound),
        );
    }

    fn json(&self, samples: &[Sample]) -> serde_json::Value {
        let series: Vec<_> = samples
            .iter()
            .filter(|sample| sample.is_following)
            .map(|sample| json!([sample.since_start_ns / 1e6, sample.error_us, sample.bound_us]))
            .collect();
        json!({
            "bias_us": self.bias_us, "rms_us": self.rms_us, "p999_us": self.p999_us, "max_us": self.max_us,
            "within_10_us_ms": self.within_ten_ms, "within_1_us_ms": self.within_one_ms,
            "bound_median_us": self.bound_median_us, "error_of_bound_max": self.of_bound,
            "series_ms_error_us_bound_us": series,
        })
    }
}

#[expect(clippy::cast_precision_loss, reason = "a power of ten")]
const SETTLED_NS_F64: f64 = SETTLED_NS as f64;

/// Since when, in ms after the start, a chip follows a root with no error above `limit_us`.
fn stays_within(samples: &[Sample], limit_us: f64) -> f64 {
    let bad = samples.iter().rposition(|sample| !sample.is_following || sample.error_us.abs() >= limit_us);
    // the first sample after the last bad one
    let good = bad.map_or(0, |bad| bad + 1);
    samples.get(good).map_or(f64::INFINITY, |sample| sample.since_start_ns / 1e6)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Times are those of the first sample after the last bad one; figures leave out what came before the settling.
    #[test]
    fn figures_are_of_what_they_say() {
        let sample = |ms: u32, error_us, bound_us, is_following| Sample {
            since_start_ns: f64::from(ms) * 1e6,
            error_us,
            bound_us,
            is_following,
        };
        let mut samples = vec![
            sample(10, 0.0, None, false),
            sample(20, -12.0, None, true),
            sample(30, 2.0, Some(4.0), true),
            sample(40, 0.5, Some(2.0), true),
        ];
        assert!(stays_within(&samples, 10.0) - 30.0 < 1e-9 && stays_within(&samples, 1.0) - 40.0 < 1e-9);
        samples.extend((0..1_000).map(|n| sample(1_000 + n, if n % 2 == 0 { 0.3 } else { -0.4 }, Some(1.0), true)));
        let figures = Figures::of(&samples).unwrap();
        assert!((figures.rms_us - 0.125f64.sqrt()).abs() < 1e-9, "{}", figures.rms_us);
        assert!((figures.bias_us + 0.05).abs() < 1e-9, "{}", figures.bias_us);
        assert!((figures.max_us - 0.4).abs() < 1e-9 && (figures.of_bound - 0.5).abs() < 1e-9);
        samples.push(sample(3_000, 1.5, Some(1.0), true));
        assert!(stays_within(&samples, 1.0).is_infinite());
        assert!(Figures::of(&samples).unwrap().of_bound > 1.0);
        assert!(Figures::of(&[]).is_none());
    }
}

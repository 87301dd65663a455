//! Two counters and a wire between them, in floating point: the truth that the estimator is compared with.
//!
//! True time is in µs from the start. Stamps are rounded down to a microsecond, and the origins are whole microseconds, so that rounding
//! falls where it would in a device.

use fixed_math::clock::{Exchange, Fault, LinkClock};
use fixed_math::time::{LocalTicks, PeerTicks, Span};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

/// A free-running counter.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Counter {
    /// Against true time.
    pub(crate) rate: f64,
    /// What the rate gains a second.
    pub(crate) ramp_per_s: f64,
    /// What it reads at the start.
    pub(crate) origin_us: u64,
}

impl Counter {
    /// Within 50 ppm, and any origin.
    pub(crate) fn crystal(random: &mut Pcg32) -> Self {
        Self { rate: random.random_range(-50e-6..50e-6), ramp_per_s: 0.0, origin_us: random.random_range(0..1 << 40) }
    }

    /// The reading at true time `at_us`, less the origin.
    pub(crate) fn since_origin(&self, at_us: f64) -> f64 {
        at_us * (1.0 + self.rate + 0.5e-6 * self.ramp_per_s * at_us)
    }

    /// When it reads `steps` after the origin.
    pub(crate) fn time_of(&self, steps: u64) -> f64 {
        let reading = steps as f64 / 256.0;
        // the ramp's part is below 10⁻² of the whole, so that five rounds leave nothing
        (0..5).fold(reading, |at, _| reading / (1.0 + self.rate + 0.5e-6 * self.ramp_per_s * at))
    }

    /// The stamp, in whole microseconds.
    fn stamp(&self, at_us: f64) -> u64 {
        self.origin_us + floor(self.since_origin(at_us))
    }

    /// The reading in steps of 1/256 µs, after the origin.
    pub(crate) fn steps(&self, at_us: f64) -> u64 {
        floor(self.since_origin(at_us) * 256.0)
    }
}

/// What a run is made of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Conditions {
    pub(crate) own: Counter,
    pub(crate) peer: Counter,
    /// Part of all stamps that are delayed, and by how much on average (exponentially).
    pub(crate) delayed: f64,
    pub(crate) delay_us: f64,
    /// Most that a departure is stamped too late; nothing where departures are stamped first and leave later.
    pub(crate) late_us: f64,
    /// Time on the way, each way.
    pub(crate) there_us: f64,
    pub(crate) back_us: f64,
    /// Whether requests leave whenever the own counter turns over, and are answered after the same time: nothing dithers then.
    pub(crate) in_step: bool,
}

impl Conditions {
    /// Those of the issue: 50 ppm apart at most, a ramp, a UART of 3 Mbaud, 30 % of stamps delayed by 8 µs.
    pub(crate) fn issue(seed: u64) -> Self {
        let mut random = Pcg32::seed_from_u64(seed ^ 0x5eed);
        Self {
            own: Counter::crystal(&mut random),
            peer: Counter { ramp_per_s: 0.01e-6, ..Counter::crystal(&mut random) },
            delayed: 0.3,
            delay_us: 8.0,
            late_us: 0.0,
            there_us: 10.0 / 3.0,
            back_us: 10.0 / 3.0,
            in_step: false,
        }
    }
}

/// Two counters at some true time.
pub(crate) struct World {
    pub(crate) conditions: Conditions,
    pub(crate) now_us: f64,
    random: Pcg32,
}

impl World {
    pub(crate) fn new(conditions: Conditions, seed: u64) -> Self {
        Self { conditions, now_us: 0.0, random: Pcg32::seed_from_u64(seed) }
    }

    /// Zero for most stamps.
    fn delay(&mut self) -> f64 {
        let (delayed, mean) = (self.conditions.delayed, self.conditions.delay_us);
        if self.random.random_bool(delayed) { -mean * (1.0 - self.random.random::<f64>()).ln() } else { 0.0 }
    }

    /// A departure at `at_us` and its arrival: (what the stamp of the departure saw, when it arrived, what that stamp saw).
    fn frame(&mut self, at_us: f64, wire_us: f64) -> (f64, f64, f64) {
        let delay = self.delay();
        // with interrupts open the byte leaves after the stamp; a stamp from a transmit interrupt comes after the byte
        let late = self.conditions.late_us;
        let (stamp, departure) = if late > 0.0 { (at_us + delay.min(late), at_us) } else { (at_us, at_us + delay) };
        let arrival = departure + wire_us;
        (stamp, arrival, arrival + self.delay())
    }

    /// One exchange from now on; time has passed afterwards.
    pub(crate) fn exchange(&mut self) -> Exchange {
        let Conditions { own, peer, there_us, back_us, in_step, .. } = self.conditions;
        let from = if in_step { own.time_of(floor(own.since_origin(self.now_us)) * 256) } else { self.now_us };
        let (sent, _, heard) = self.frame(from, there_us);
        let turn = if in_step { 64.0 } else { self.random.random_range(30.0..120.0) };
        let (answered, _, received) = self.frame(heard + turn, back_us);
        self.now_us = received;
        Exchange {
            sent: LocalTicks::from_us(own.stamp(sent)),
            heard: PeerTicks::from_us(peer.stamp(heard)),
            answered: PeerTicks::from_us(peer.stamp(answered)),
            received: LocalTicks::from_us(own.stamp(received)),
        }
    }

    /// (error of `peer_at`, its bound, its sigma), µs, at the own reading that is nearest to true time `at_us`.
    pub(crate) fn error_us(&self, link: &LinkClock, at_us: f64) -> (f64, f64, f64) {
        let Conditions { own, peer, .. } = self.conditions;
        let reading = own.steps(at_us);
        let local = LocalTicks::from_us(own.origin_us) + Span::from_steps(reading);
        let truth = peer.since_origin(own.time_of(reading));
        let found = link.peer_at(local).steps_after(PeerTicks::from_us(peer.origin_us));
        (found as f64 / 256.0 - truth, us(link.bound_at(local)), us(link.error_at(local)))
    }
}

/// Rounded down to a whole number that is not negative.
fn floor(value: f64) -> u64 {
    value.floor() as u64
}

pub(crate) fn us(span: Span) -> f64 {
    span.steps() as f64 / 256.0
}

/// What became of a run.
#[derive(Debug, Default)]
pub(crate) struct Outcome {
    /// Errors from `settled_us` on, µs, without sign.
    pub(crate) settled: Vec<f64>,
    /// Mean of squares of error over sigma.
    pub(crate) sigmas: f64,
    /// Last true time at which the error was 1 µs and more, 10 µs and more; within the first 10 s.
    pub(crate) below_1us_at_us: f64,
    pub(crate) below_10us_at_us: f64,
    /// Largest error over bound, which is never above 1.
    pub(crate) worst_of_bound: f64,
    /// Bounds from `settled_us` on, their mean, µs.
    pub(crate) bound_us: f64,
    pub(crate) refused: u32,
    pub(crate) contradictions: u32,
}

impl Outcome {
    pub(crate) fn rms_us(&self) -> f64 {
        (self.settled.iter().map(|error| error * error).sum::<f64>() / self.settled.len() as f64).sqrt()
    }
}

/// From the beginning of an exchange to that of the next: 5 ms for the `burst` at join, then 50 ms.
pub(crate) fn pace_us(index: u32, burst: u32) -> f64 {
    if index < burst { 5_000.0 } else { 50_000.0 }
}

/// Exchanges for `seconds`, looked at eight times between any two; what is in `Outcome::settled` is from `settled_s` on.
pub(crate) fn run(world: &mut World, link: &mut LinkClock, seconds: f64, settled_s: f64) -> Outcome {
    let mut outcome = Outcome::default();
    let (begin, mut next, mut looks) = (world.now_us, world.now_us, 0.0);
    for index in 0.. {
        world.now_us = next;
        let exchange = world.exchange();
        match link.observe(&exchange) {
            Ok(()) => {}
            Err(Fault::Absurd | Fault::RoundTrip) => outcome.refused += 1,
            Err(other) => panic!("{other:?} for {exchange:?}"),
        }
        let from = world.now_us;
        // not in step with the exchanges, as a sender's own timers would be
        next += pace_us(index, 64) + world.random.random_range(0.0..7.0);
        for part in 0..8 {
            let at = from + (next - from) * f64::from(part) / 8.0;
            let (error, bound, sigma) = world.error_us(link, at);
            outcome.worst_of_bound = outcome.worst_of_bound.max(error.abs() / bound);
            let since = at - begin;
            if since < 10e6 && error.abs() >= 1.0 {
                outcome.below_1us_at_us = since;
            }
            if since < 10e6 && error.abs() >= 10.0 {
                outcome.below_10us_at_us = since;
            }
            if since >= settled_s * 1e6 {
                outcome.settled.push(error.abs());
                outcome.sigmas += (error / sigma).powi(2);
                outcome.bound_us += bound;
                looks += 1.0;
            }
        }
        if next - begin > seconds * 1e6 {
            break;
        }
    }
    outcome.contradictions = link.contradictions();
    outcome.sigmas = (outcome.sigmas / looks).sqrt();
    outcome.bound_us /= looks;
    outcome
}

//! One axis in virtual time: a sender of points good and bad, a network that loses and repeats them, halts, stalls, and a judge.

use super::judge::Judge;
use super::sender::Sender;
use super::truth::{Line, Truth};
use fixed_math::spline::IntervalLog2;
use fixed_math::time::{NetTime, Span};
use fixed_math::warp::Warp;
use osap_maxl::axis::AxisConfig;
use osap_maxl::{
    AxisRings, BeatClock, ClockRings, Feeder, FeederCounters, FeederState, MotionClock, MotionState, Player, Refusal,
    StarvedPolicy,
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const QUEUE: usize = 32;
const HISTORY: usize = 64;

/// What a scene came to.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tally {
    pub(super) offered: u64,
    pub(super) beats: u64,
    pub(super) knots: u64,
    pub(super) counters: FeederCounters,
    pub(super) series: u64,
    pub(super) stops: u64,
    pub(super) leaps: u64,
    pub(super) rebuilt_played: u64,
    pub(super) halts: u64,
}

/// How bad it is.
#[derive(Clone, Copy, Debug)]
struct Weather {
    stall: f64,
    leap: f64,
    back: f64,
    halt: f64,
    task: f64,
    abandon: f64,
}

/// One case of the injection.
struct Scene<'a> {
    rng: Pcg64,
    feeder: Feeder<'a, QUEUE, HISTORY>,
    player: Player<'a, QUEUE>,
    motion: MotionClock<'a>,
    clock: BeatClock<'a>,
    judge: Judge,
    sender: Sender,
    weather: Weather,
    config: Option<(Truth, AxisConfig)>,
    system: NetTime,
    beat: Span,
    /// Of the last halt that was sent, and of the last that was followed.
    sequence: u32,
    followed: Option<u32>,
    tally: Tally,
}

/// Plays a case until it has offered about `points`.
pub(super) fn play(seed: u64, case: u64, points: u64) -> Result<Tally, String> {
    let mut rng = Pcg64::new(u128::from(seed) << 64 | u128::from(case), 0x5851_f42d);
    let (mut axis, mut clocks) = (AxisRings::<QUEUE>::new(), ClockRings::new());
    let (feeder, player) = axis.split::<HISTORY>();
    let warp = Warp::new(rng.random_range(10..=18)).ok_or("a warp in range")?;
    let (motion, clock) = clocks.split(warp);
    let mut rare = |most: f64| if rng.random_bool(0.5) { 0.0 } else { rng.random_range(0.0..most) };
    let (stall, leap, back, halt, abandon) = (rare(0.01), rare(0.0005), rare(0.0005), rare(0.02), rare(0.001));
    let weather = Weather { stall, leap, back, halt, task: rng.random_range(0.1..=1.0), abandon };
    let sender = Sender::new(Pcg64::from_rng(&mut rng));
    let system = NetTime::from_us(rng.random_range(1 << 20..1 << 40));
    let (judge, tally) = (Judge::new(), Tally::default());
    let mut scene = Scene {
        rng,
        feeder,
        player,
        motion,
        clock,
        judge,
        sender,
        weather,
        config: None,
        system,
        beat: Span::from_us(64),
        sequence: 0,
        followed: None,
        tally,
    };
    let mut idle = 0;
    while scene.tally.offered < points && idle < 20_000 {
        let before = scene.tally.offered;
        let now = scene.system;
        scene.beat().map_err(|what| format!("{what}, at {} us of system time, {:?}", now.as_us(), scene.weather))?;
        idle = if scene.tally.offered > before { 0 } else { idle + 1 };
    }
    let Judge { knots, rebuilt, stops, leaps, .. } = scene.judge;
    let counters = *scene.feeder.counters();
    Ok(Tally { knots, rebuilt_played: rebuilt, stops, leaps, counters, ..scene.tally })
}

impl Scene<'_> {
    /// Time passes by a beat; the player plays, and sometimes the task comes to run.
    fn beat(&mut self) -> Result<(), String> {
        let mut step = self.beat.steps();
        if self.rng.random_bool(self.weather.stall) {
            step += self.rng.random_range(0..=6 * self.interval());
        }
        if self.rng.random_bool(self.weather.leap) {
            step += self.rng.random_range(0..=40 * self.interval());
        }
        self.system = self.system + Span::from_steps(step);
        if self.rng.random_bool(self.weather.back) {
            let back = self.rng.random_range(0..=30 * self.interval());
            self.system = self.system.shifted(-back.cast_signed());
        }
        let track = self.clock.advance(self.system);
        let output = self.player.beat(track.time);
        self.tally.beats += 1;
        self.judge.see(self.system, track, output, self.player.points())?;
        if self.rng.random_bool(self.weather.task) { self.task() } else { Ok(()) }
    }

    fn interval(&self) -> u64 {
        self.config.map_or(1 << 16, |(_, config)| config.interval.steps().into())
    }

    fn task(&mut self) -> Result<(), String> {
        // what the task takes for now may be some beats old: it was interrupted by them
        let old = if self.rng.random_bool(0.3) { self.rng.random_range(0..=3 * self.beat.steps()) } else { 0 };
        let system = self.system.shifted(-old.cast_signed());
        self.motion.run();
        self.halt(system);
        let now = self.motion.track_time(system).time;
        match self.feeder.state() {
            FeederState::Unarmed | FeederState::Resting { .. } => self.arm(now),
            FeederState::Following => self.send(now)?,
            FeederState::Stopping { .. } => {}
        }
        self.feeder.run(now);
        self.ask_past(now)
    }

    /// Points go to the feeder, and what is accepted to the judge.
    fn send(&mut self, now: NetTime) -> Result<(), String> {
        if self.rng.random_bool(self.weather.abandon) {
            self.feeder.abandon();
        }
        for _ in 0..4 {
            let Some(point) = self.sender.next(now) else { break };
            self.tally.offered += 1;
            match self.feeder.offer(point, now) {
                Ok(accepted) => {
                    if usize::try_from(accepted.free).is_ok_and(|free| free > QUEUE) {
                        return Err(format!("room for {} of {QUEUE}", accepted.free));
                    }
                    self.judge.accept(point.time, point.position);
                }
                Err(refusal) => self.check_refusal(refusal)?,
            }
        }
        Ok(())
    }

    fn check_refusal(&mut self, refusal: Refusal) -> Result<(), String> {
        match refusal {
            Refusal::Limit(fault) if self.feeder.fault() != Some(fault) => Err(format!("{fault:?} was not latched")),
            Refusal::Limit(_) | Refusal::Latched(_) => {
                self.sender.give_up();
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn arm(&mut self, now: NetTime) {
        if !self.rng.random_bool(0.2) {
            return;
        }
        self.feeder.clear_fault();
        if self.rng.random_bool(0.2) {
            self.feeder.disarm();
        }
        if self.config.is_none() || self.rng.random_bool(0.3) {
            let warp = *self.motion.warp();
            self.config = (0..50).find_map(|_| random_config(&mut self.rng, warp));
        }
        let Some((truth, config)) = self.config else { return };
        let rests_at = self.player.points().0[3];
        let position = if self.feeder.state() == FeederState::Unarmed {
            self.rng.random_range(truth.min..=truth.max)
        } else {
            rests_at
        };
        let step = u64::from(config.interval.steps());
        let start = (now.steps() + self.rng.random_range(2..8) * step + config.lead.steps()).div_ceil(step) * step;
        let start = NetTime::from_steps(start);
        if self.feeder.arm(&config, position, start, now).is_err() {
            // it rests outside of new limits, or it is late: another time, elsewhere
            self.feeder.disarm();
            return;
        }
        self.tally.series += 1;
        self.judge.arm(truth, config.interval, position, start);
        if let Ok(within) = config.check() {
            self.sender.begin(within, position, start, config.interval);
        }
        let quarter = (step / 4).max(64 * 256);
        self.beat = Span::from_steps(if self.rng.random_bool(0.5) {
            quarter
        } else {
            self.rng.random_range(64 * 256..=quarter)
        });
    }

    /// Stops and resumes, in order and not, early, late and repeated.
    fn halt(&mut self, now: NetTime) {
        let stands = self.motion.state(self.system) == MotionState::Stopped;
        if !self.rng.random_bool(if stands { 0.3 } else { self.weather.halt }) {
            return;
        }
        let ahead = self.rng.random_range(-20_000_i64..60_000) * 256;
        let epoch = now.shifted(ahead);
        let is_repeated = self.rng.random_bool(0.2);
        self.sequence += u32::from(!is_repeated);
        let is_stop = self.rng.random_bool(if stands { 0.1 } else { 0.8 });
        let asked = if is_stop {
            self.motion.stop(self.sequence, epoch, now)
        } else {
            self.motion.resume(self.sequence, epoch, now)
        };
        // a stop that changes nothing changes nothing for the judge either
        if asked.is_ok() && (is_stop || self.followed != Some(self.sequence)) {
            self.followed = Some(self.sequence);
            self.tally.halts += 1;
            let duration = super::truth::real(self.motion.warp().duration().steps());
            self.judge.clock.ask(is_stop, epoch.max(now).steps(), duration);
        }
    }

    /// Where the axis was a moment ago.
    fn ask_past(&mut self, now: NetTime) -> Result<(), String> {
        let back = self.rng.random_range(0..=2 * self.interval());
        let at = now.shifted(-back.cast_signed());
        match self.feeder.position_at(at) {
            Some(motion) => self.judge.check_past(at, motion),
            None => Ok(()),
        }
    }
}

/// Limits of all sizes, in differences of any interval, that leave something of themselves beside the stop.
fn random_config(rng: &mut Pcg64, warp: Warp) -> Option<(Truth, AxisConfig)> {
    // a stop of about two to a thousand intervals
    let interval = IntervalLog2::new(rng.random_range(8..=warp.log2().min(14)))?;
    let steps_max = (1 << (warp.log2() - interval.log2())).min(150);
    let velocity: i32 = 1 << rng.random_range(6..=25);
    let velocity = rng.random_range(velocity / 2..=velocity);
    let at_full = (velocity / rng.random_range(1..=steps_max)).max(1);
    let at_rest =
        if rng.random_bool(0.5) { at_full } else { at_full.saturating_add(rng.random_range(0..=2 * at_full)) };
    let jerk = (at_full / rng.random_range(1..=30)).max(1);
    let jerk_at_rest = if rng.random_bool(0.5) { jerk } else { jerk + rng.random_range(0..=2 * jerk) };
    let travel = i64::from(velocity) * rng.random_range(1..=3_000);
    let max = i32::try_from(travel.min(i64::from(i32::MAX))).ok()?;
    let min = if rng.random_bool(0.5) { -max } else { 0 };
    let line = |rng: &mut Pcg64, at_rest, at_full| Line {
        at_rest,
        at_full,
        knee: rng.random_range(0..velocity),
        full: velocity,
    };
    let (acceleration, jerk) = (line(rng, at_rest, at_full), line(rng, jerk_at_rest, jerk));
    let truth = Truth { min, max, velocity, acceleration, jerk };
    let reserve = warp.reserve(interval, velocity, at_rest);
    if reserve.acceleration >= at_full || reserve.jerk >= jerk.at_full {
        return None;
    }
    let config = AxisConfig {
        interval,
        limits: truth.limits()?,
        warp,
        policy: [StarvedPolicy::Stop, StarvedPolicy::Hold, StarvedPolicy::Relax][rng.random_range(0..3)],
        missing_max: rng.random_range(0..=8),
        rebuilt_max: rng.random_range(0..=u16::MAX),
        lead: Span::from_steps(rng.random_range(0..=4) * u64::from(interval.steps()) / 2),
    };
    config.check().is_ok().then_some((truth, config))
}

//! Points as they might arrive: along the limits, beside them, and anything that bytes can be read as.

use fixed_math::limits::{Knot, Limits};
use fixed_math::spline::IntervalLog2;
use fixed_math::time::NetTime;
use osap_maxl::Point;
use rand::RngExt;
use rand_pcg::Pcg64;
use std::collections::VecDeque;

/// How often what happens, of one.
#[derive(Clone, Copy, Debug)]
struct Habits {
    /// Goes beyond a limit.
    bad: f64,
    /// Leaves the path for anywhere.
    jump: f64,
    /// Is any bytes.
    noise: f64,
    lost: f64,
    repeated: f64,
    swapped: f64,
    /// Says nothing for a while.
    silent: f64,
    /// Intervals ahead of now.
    ahead: u64,
}

/// Sends points for one series after another.
pub(super) struct Sender {
    rng: Pcg64,
    habits: Habits,
    plan: Option<Plan>,
    /// On their way.
    sent: VecDeque<Point>,
    last: Option<Point>,
}

#[derive(Clone, Copy)]
struct Plan {
    limits: Limits,
    knot: Knot,
    time: NetTime,
    interval: IntervalLog2,
    push: i32,
    silent: u32,
}

impl Sender {
    pub(super) fn new(mut rng: Pcg64) -> Self {
        let habits = Self::habits(&mut rng);
        Self { rng, habits, plan: None, sent: VecDeque::new(), last: None }
    }

    fn habits(rng: &mut Pcg64) -> Habits {
        let mut rare = |most: f64| if rng.random_bool(0.5) { 0.0 } else { rng.random_range(0.0..most) };
        let (bad, jump, noise) = (rare(0.02), rare(0.005), rare(0.05));
        let (lost, repeated, swapped, silent) = (rare(0.2), rare(0.1), rare(0.1), rare(0.01));
        Habits { bad, jump, noise, lost, repeated, swapped, silent, ahead: rng.random_range(3..40) }
    }

    /// A series was armed.
    pub(super) fn begin(&mut self, limits: Limits, position: i32, start: NetTime, interval: IntervalLog2) {
        self.habits = Self::habits(&mut self.rng);
        self.sent.clear();
        let knot = Knot::resting(position);
        self.plan = Some(Plan { limits, knot, time: start, interval, push: 1, silent: 0 });
    }

    /// Nothing is taken any more.
    pub(super) fn give_up(&mut self) {
        if self.rng.random_bool(0.9) {
            self.plan = None;
        }
    }

    /// The next point to arrive at `now`.
    pub(super) fn next(&mut self, now: NetTime) -> Option<Point> {
        if self.rng.random_bool(self.habits.noise) {
            return Some(self.noise(now));
        }
        if self.sent.is_empty() {
            let point = self.planned(now)?;
            self.dispatch(point);
        }
        self.sent.pop_front()
    }

    /// Loses, repeats and swaps.
    fn dispatch(&mut self, point: Point) {
        let last = self.last.replace(point);
        if self.rng.random_bool(self.habits.lost) {
            return;
        }
        self.sent.push_back(point);
        if self.rng.random_bool(self.habits.repeated) {
            self.sent.push_back(last.unwrap_or(point));
        }
        if self.rng.random_bool(self.habits.swapped) {
            self.sent.rotate_left(1);
        }
    }

    /// The next point of the path, while it is not too far ahead.
    fn planned(&mut self, now: NetTime) -> Option<Point> {
        let habits = self.habits;
        let plan = self.plan.as_mut()?;
        let step = u64::from(plan.interval.steps());
        if plan.time.since(now).steps() > habits.ahead * step {
            return None;
        }
        if plan.silent > 0 {
            plan.silent -= 1;
            return None;
        }
        if self.rng.random_bool(habits.silent) {
            plan.silent = self.rng.random_range(1..60);
        }
        let rng = &mut self.rng;
        if rng.random_bool(0.03) {
            plan.push = rng.random_range(-1..=1);
        }
        let wanted = wanted(rng, plan);
        plan.knot = match plan.limits.check(plan.knot, wanted) {
            Ok(knot) => knot,
            Err(_) if rng.random_bool(habits.bad) => following(plan.knot, wanted),
            Err(_) => {
                plan.push = rng.random_range(-1..=1);
                plan.limits.brake().next(plan.knot)
            }
        };
        if rng.random_bool(habits.jump) {
            let far = rng.random_range(0..31);
            plan.knot = following(plan.knot, plan.knot.position.wrapping_add(rng.random_range(-1..=1) << far));
        }
        plan.time = plan.time.shifted(step.cast_signed());
        Some(Point { time: plan.time, position: plan.knot.position })
    }

    /// Twelve bytes: now and then near what is expected, now and then anything.
    fn noise(&mut self, now: NetTime) -> Point {
        let mut bytes = [0; 12];
        self.rng.fill(&mut bytes);
        let (low, high) = bytes.split_at(8);
        let time = u64::from_le_bytes(low.try_into().unwrap_or_default());
        let position = i32::from_le_bytes(high.try_into().unwrap_or_default());
        let Some(plan) = self.plan else { return Point { time: NetTime::from_steps(time), position } };
        let step = u64::from(plan.interval.steps());
        let on_grid = now.steps() / step * step;
        let time = match self.rng.random_range(0..4) {
            0 => NetTime::from_steps(time),
            1 => NetTime::from_steps(on_grid.wrapping_add((time % 64).wrapping_sub(16).wrapping_mul(step))),
            2 => plan.time.shifted((time % 4).cast_signed() * step.cast_signed()),
            _ => now.shifted((time % (64 * step)).cast_signed()),
        };
        let position = match self.rng.random_range(0..3) {
            0 => position,
            1 => plan.knot.position.wrapping_add(position % 1_024),
            _ => plan.knot.position.wrapping_add(position.wrapping_rem(plan.limits.velocity())),
        };
        Point { time, position }
    }
}

/// Full jerk most of the time, one LSB beside it often.
fn wanted(rng: &mut Pcg64, plan: &Plan) -> i32 {
    let Plan { limits, knot, push, .. } = plan;
    let speed = knot.velocity.unsigned_abs();
    let (jerk, bend) = (limits.jerk().at(speed), limits.acceleration().at(speed));
    let change = match rng.random_range(0..8) {
        0 => rng.random_range(-jerk..=jerk),
        1 => 0,
        2 => push * (jerk - 1),
        3 => push * (jerk + 1),
        _ => push * jerk,
    };
    let acceleration = knot.acceleration.saturating_add(change).clamp(-bend, bend);
    let velocity = knot.velocity.saturating_add(acceleration);
    let most = limits.velocity();
    let velocity = if rng.random_bool(0.5) { velocity.clamp(-most, most) } else { velocity };
    knot.position.saturating_add(velocity)
}

fn following(knot: Knot, position: i32) -> Knot {
    let velocity = position.wrapping_sub(knot.position);
    Knot { position, velocity, acceleration: velocity.wrapping_sub(knot.velocity) }
}

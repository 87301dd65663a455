//! The interrupt's half of an axis: the spline at a track time, and points of its own where there are none.
//!
//! - **Walk:** [`BeatClock::advance`](crate::clock::BeatClock::advance) → [`Player::beat`] → an output. At a knot the next point comes
//!   from the ring, or from the brake.
//! - **Invariants:** every point is either the feeder's, in order, or the brake's after the last of them; once the brake has
//!   begun, the series is over. At most [`LEAP_INTERVALS_MAX`] knots a beat; a time that leaps further, or back, is not followed: the axis
//!   brakes from where it is. Nothing panics.
//! - **Context:** the highest-priority task; no lock, no division but where an order or an event is passed. **Clauses:** `[MOT-02]`, `[MOT-07]`.

use crate::axis::{Event, Order, Start, StarvedCause, StarvedPolicy};
use crate::ring::PointsOut;
use fixed_math::brake::Brake;
use fixed_math::limits::Knot;
use fixed_math::spline::IntervalLog2;
use fixed_math::spline::horner::Cubic;
use fixed_math::time::NetTime;
use heapless::spsc::{Consumer, Producer};

/// Most intervals that track time may go on by from one beat to the next, or back.
pub const LEAP_INTERVALS_MAX: u32 = 8;

/// What an axis does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PlayerState {
    /// Was never armed, or was disarmed: its position means nothing.
    #[default]
    Idle,
    /// Plays the feeder's points.
    Following,
    /// Brakes, on points of its own.
    Stopping,
    /// Has come to rest without points and stays there.
    Resting,
    /// As resting; its output may lower its currents.
    Holding,
    /// As resting; its output is to let go.
    Released,
}

/// What an output is to do at a beat.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Output {
    /// LSB.
    pub position: i32,
    /// Along the track, 2^−4 LSB an interval; times the clock's rate it is that of system time.
    pub velocity: i32,
    /// Along the track, 2^−4 LSB an interval².
    pub acceleration: i32,
    /// What the axis does.
    pub state: PlayerState,
    /// Counts the times that the axis was armed out of [`PlayerState::Idle`]: position has a new meaning.
    pub origin: u8,
}

/// The interrupt's half of an axis.
pub struct Player<'a, const QUEUE: usize> {
    points_in: PointsOut<'a, QUEUE>,
    orders: Consumer<'a, Order>,
    events: Producer<'a, Event>,
    segment: Segment,
    brake: Brake,
    policy: StarvedPolicy,
    state: PlayerState,
    origin: u8,
    /// Time leapt in this series.
    has_leapt: bool,
}

/// Where a player is: four points, and when the second of them is.
#[derive(Clone, Copy, Debug)]
struct Segment {
    points: [i32; 4],
    /// The last of them.
    newest: Knot,
    cubic: Cubic,
    knot: NetTime,
    interval: IntervalLog2,
    /// The last that was played; the origin where none was, so that a leap over the series' start is one.
    at: NetTime,
}

impl Segment {
    /// Rests at `position`; its first knot is one interval before `start`.
    fn resting(position: i32, start: NetTime, interval: IntervalLog2) -> Self {
        let knot = start.shifted(-2 * i64::from(interval.steps()));
        let newest = Knot::resting(position);
        Self { points: [position; 4], newest, cubic: constant(position), knot, interval, at: NetTime::ZERO }
    }

    /// Goes on to the next knot, with `next` as the newest point.
    fn advance(&mut self, next: Knot) {
        let [_, p1, p2, p3] = self.points;
        self.points = [p1, p2, p3, next.position];
        self.newest = next;
        // points that were checked are never too far apart; if they were, it would stay where it is
        self.cubic = Cubic::new(self.points).unwrap_or(constant(p2));
        self.knot = self.knot.shifted(i64::from(self.interval.steps()));
    }

    /// The knot that `position` makes as the newest point.
    const fn following(&self, position: i32) -> Knot {
        let velocity = position.wrapping_sub(self.newest.position);
        let acceleration = velocity.wrapping_sub(self.newest.velocity);
        Knot { position, velocity, acceleration }
    }

    fn is_at_rest(&self) -> bool {
        let [first, ..] = self.points;
        self.points.iter().all(|point| *point == first)
    }

    /// Steps since the knot; may be past the interval's end.
    fn elapsed(&self) -> u64 {
        self.at.since(self.knot).steps()
    }
}

/// A cubic that is `position` everywhere.
fn constant(position: i32) -> Cubic {
    match Cubic::new([position; 4]) {
        Ok(cubic) => cubic,
        Err(_) => unreachable!("points that are equal are not apart"),
    }
}

impl<'a, const QUEUE: usize> Player<'a, QUEUE> {
    pub(crate) fn new(
        points_in: PointsOut<'a, QUEUE>,
        orders: Consumer<'a, Order>,
        events: Producer<'a, Event>,
    ) -> Self {
        let Some(interval) = IntervalLog2::new(fixed_math::spline::INTERVAL_LOG2_MIN) else {
            unreachable!("the shortest interval is one")
        };
        Self {
            points_in,
            orders,
            events,
            segment: Segment::resting(0, NetTime::ZERO, interval),
            brake: Brake::new(1, 1),
            policy: StarvedPolicy::Stop,
            state: PlayerState::Idle,
            origin: 0,
            has_leapt: false,
        }
    }

    /// What the axis does.
    #[must_use]
    pub const fn state(&self) -> PlayerState {
        self.state
    }

    /// The four points of the present segment, oldest first, and the track time of the second. Between the second and the third the axis is.
    #[must_use]
    pub const fn points(&self) -> ([i32; 4], NetTime) {
        (self.segment.points, self.segment.knot)
    }

    /// The output at track time `at`, which is that of the beat.
    pub fn beat(&mut self, at: NetTime) -> Output {
        self.take_orders();
        match self.state {
            PlayerState::Following | PlayerState::Stopping => self.go_on(at),
            _ => {}
        }
        self.output()
    }

    /// Follows points no longer, if it did: it brakes from the next knot on.
    pub fn abandon(&mut self) {
        if self.state == PlayerState::Following {
            self.starve(StarvedCause::Abandoned);
        }
    }

    fn take_orders(&mut self) {
        let Some(order) = self.orders.peek().copied() else { return };
        match (order, self.state) {
            (Order::Start(_) | Order::Disarm, PlayerState::Stopping | PlayerState::Following) => return,
            (Order::Start(start), _) => self.start(start),
            (Order::Disarm, _) => self.state = PlayerState::Idle,
            (Order::Abandon, _) => self.abandon(),
        }
        let _taken = self.orders.dequeue();
    }

    fn start(&mut self, start: Start) {
        let Start { first, position, time, interval, brake, policy } = start;
        self.points_in.skip_to(first);
        self.segment = Segment::resting(position, time, interval);
        (self.brake, self.policy) = (brake, policy);
        if self.state == PlayerState::Idle {
            self.origin = self.origin.wrapping_add(1);
        }
        self.state = PlayerState::Following;
        self.has_leapt = false;
    }

    /// Goes on to `at`, over as many knots as there are between.
    fn go_on(&mut self, at: NetTime) {
        let interval = u64::from(self.segment.interval.steps());
        // most beats are on in the interval of the one before
        if at >= self.segment.at && at.steps().wrapping_sub(self.segment.knot.steps()) < interval {
            self.segment.at = at;
            return;
        }
        let most = interval * u64::from(LEAP_INTERVALS_MAX);
        let back = self.segment.at.since(at).steps();
        if back > most || at.since(self.segment.at.max(self.segment.knot)).steps() > most {
            self.leap(at);
        } else {
            self.segment.at = self.segment.at.max(at);
        }
        for _ in 0..=LEAP_INTERVALS_MAX {
            if self.segment.elapsed() < interval {
                break;
            }
            self.pass_knot();
        }
    }

    /// Time is elsewhere: what was played last is played now, and the brake takes over.
    fn leap(&mut self, at: NetTime) {
        let part = self.segment.elapsed();
        self.segment.at = at;
        self.segment.knot = NetTime::from_steps(at.steps().saturating_sub(part));
        if self.state == PlayerState::Following {
            self.starve(StarvedCause::Leapt);
        }
        if !core::mem::replace(&mut self.has_leapt, true) {
            let _room = self.events.enqueue(Event::Leapt);
        }
    }

    fn pass_knot(&mut self) {
        let point = if self.state == PlayerState::Following { self.points_in.pop() } else { None };
        let next = if let Some(position) = point {
            self.segment.following(position)
        } else {
            if self.state == PlayerState::Following {
                self.starve(StarvedCause::NoPoint);
            }
            self.brake.next(self.segment.newest)
        };
        self.segment.advance(next);
        if self.state == PlayerState::Stopping && self.segment.is_at_rest() {
            self.state = match self.policy {
                StarvedPolicy::Stop => PlayerState::Resting,
                StarvedPolicy::Hold => PlayerState::Holding,
                StarvedPolicy::Relax => PlayerState::Released,
            };
            let _room = self.events.enqueue(Event::Rested);
        }
    }

    fn starve(&mut self, cause: StarvedCause) {
        self.state = PlayerState::Stopping;
        let _room = self.events.enqueue(Event::Starved { number: self.points_in.next(), cause });
    }

    fn output(&self) -> Output {
        let segment = &self.segment;
        let (state, origin) = (self.state, self.origin);
        // past the interval's end it is the last part before it
        let elapsed = u32::try_from(segment.elapsed()).unwrap_or(u32::MAX);
        let part = segment.interval.part(elapsed);
        let (position, velocity) = segment.cubic.position_velocity(part);
        Output { position, velocity, acceleration: segment.cubic.acceleration(part), state, origin }
    }
}

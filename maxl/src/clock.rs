//! Track time of all axes of a node: system time less what stops have used up.
//!
//! - **Walk:** a halt message → [`MotionClock::stop`] or [`MotionClock::resume`] in a task → a ring → [`BeatClock::advance`] once a beat →
//!   the track time at which every axis is evaluated.
//! - **Invariants:** track time never runs backwards, never faster than system time, and changes its rate only as a [`Warp`] does, whatever
//!   arrives when: a stop that comes late begins at once, one that comes during a resume begins at its end. A past system time
//!   maps to the track time that was played.
//! - **Context:** [`MotionClock`] in the task `serve`, [`BeatClock`] in the highest-priority task. **Clauses:** `[MOT-21]`, `[MOT-24]`.

use fixed_math::time::{NetTime, Span};
use fixed_math::warp::Warp;
use heapless::Deque;
use heapless::spsc::{Consumer, Producer, Queue};

/// Epochs are multiples of this, so that resumed tracks meet beats where they did before.
pub const EPOCH_GRID: Span = Span::from_us(64);
/// Stops and resumes that are remembered.
pub const WARPS_KEPT: usize = 8;

/// Track time and how fast it runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TrackTime {
    /// Track time.
    pub time: NetTime,
    /// Of it to system time, 2^−16: 65,536 unless a stop or a resume is under way.
    pub rate: u32,
}

/// What track time does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MotionState {
    /// Runs with system time.
    Running,
    /// A stop is under way.
    Stopping,
    /// Stands.
    Stopped,
    /// A resume is under way.
    Resuming,
}

/// Why a halt was not followed. Nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HaltError {
    /// A later one was followed before.
    Stale {
        /// Its number.
        sequence: u32,
        /// The number of the last that was followed.
        last: u32,
    },
    /// A resume before the stop is through: send it again from then on.
    StillStopping {
        /// When track time will stand.
        until: NetTime,
    },
    /// A resume of what runs.
    NotStopped,
    /// What was asked before waits for the next beat: send it again.
    Busy,
}

/// A stop or a resume from its epoch on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Turn {
    warp: Warp,
    is_stop: bool,
    /// System time.
    epoch: NetTime,
    /// Track time then.
    track: NetTime,
    /// How much of it had passed at the epoch already: none, unless system time stepped since.
    passed: Span,
}

impl Turn {
    /// Track time of a clock that has always run.
    const NONE: Self = Self {
        warp: Warp::SHORTEST,
        is_stop: false,
        epoch: NetTime::ZERO,
        track: NetTime::ZERO,
        passed: Warp::SHORTEST.duration(),
    };

    fn at(&self, system: NetTime) -> TrackTime {
        let since = self.passed + system.since(self.epoch);
        let track = |since| if self.is_stop { self.warp.stopped(since) } else { self.warp.resumed(since) };
        let rate = if self.is_stop { self.warp.stop_rate(since) } else { self.warp.resume_rate(since) };
        TrackTime { time: self.track + track(since).saturating_sub(track(self.passed)), rate }
    }

    /// When it is through.
    fn end(&self) -> NetTime {
        self.epoch + self.warp.duration().saturating_sub(self.passed)
    }

    fn state(&self, system: NetTime) -> MotionState {
        let is_over = system >= self.end();
        match (self.is_stop, is_over) {
            (true, false) => MotionState::Stopping,
            (true, true) => MotionState::Stopped,
            (false, false) => MotionState::Resuming,
            (false, true) => MotionState::Running,
        }
    }
}

/// From the task: a stop or a resume.
#[derive(Clone, Copy, Debug)]
struct Request {
    warp: Warp,
    is_stop: bool,
    epoch: NetTime,
}

/// From the interrupt, one to each request: what became of it. And where system time stepped back.
#[derive(Clone, Copy, Debug)]
enum Told {
    /// It will be turned.
    Turn(Turn),
    /// The last turn, which has not begun, is this one instead.
    Instead(Turn),
    /// The last turn, which has not begun, is none.
    Cancelled,
    /// There was nothing to do.
    Nothing,
    /// System time stepped back: all turns before are as if they had never been; with the one to come.
    Stepped(Turn, Option<Turn>),
}

/// What the two halves of a node's motion clock share.
#[derive(Debug)]
pub struct ClockRings {
    requests: Queue<Request, 4>,
    told: Queue<Told, 8>,
}

impl ClockRings {
    /// Empty ones.
    #[must_use]
    pub const fn new() -> Self {
        Self { requests: Queue::new(), told: Queue::new() }
    }

    /// The half of the task and the half of the interrupt; stops take as long as `warp` says, until [`MotionClock::set_warp`].
    pub fn split(&mut self, warp: Warp) -> (MotionClock<'_>, BeatClock<'_>) {
        let (requests_in, requests_out) = self.requests.split();
        let (told_in, told_out) = self.told.split();
        let clock = MotionClock {
            warp,
            requests: requests_in,
            told: told_out,
            kept: Deque::new(),
            oldest: Turn::NONE,
            asked: None,
            outstanding: 0,
            followed: None,
            steps_back: 0,
        };
        let (turn, next, last) = (Turn::NONE, None, NetTime::ZERO);
        (clock, BeatClock { requests: requests_out, told: told_in, turn, next, last })
    }
}

impl Default for ClockRings {
    fn default() -> Self {
        Self::new()
    }
}

/// The task's half.
pub struct MotionClock<'a> {
    /// Of stops to come; a resume is as its stop was.
    warp: Warp,
    requests: Producer<'a, Request>,
    told: Consumer<'a, Told>,
    /// Turns that were played, the newest last.
    kept: Deque<Turn, WARPS_KEPT>,
    /// The one before the oldest that is kept.
    oldest: Turn,
    /// What the last request is expected to become, until it is told.
    asked: Option<Turn>,
    /// Requests that were not told of yet.
    outstanding: u8,
    /// Sequence of the last halt that was followed, and whether it was a stop.
    followed: Option<(u32, bool)>,
    steps_back: u32,
}

impl MotionClock<'_> {
    /// Track time stops from `epoch` on, or from `now` on where that is later, or at the end of a resume that is under way. A resume that has not
    /// begun is cancelled, and a stop that was to begin later begins now. One that is repeated does nothing; of two halts of one `sequence`
    /// the stop goes before, `[MOT-21]`.
    ///
    /// # Errors
    /// [`HaltError::Stale`]; [`HaltError::Busy`] where three requests wait for the next beat.
    pub fn stop(&mut self, sequence: u32, epoch: NetTime, now: NetTime) -> Result<(), HaltError> {
        self.run();
        self.refuse_stale(sequence)?;
        let epoch = epoch.max(now);
        let newest = self.newest();
        if newest.is_stop && newest.epoch <= on_grid(epoch) {
            self.followed = Some((sequence, true));
            return Ok(());
        }
        let expected = if newest.is_stop { epoch } else { epoch.max(newest.end()) };
        self.ask(sequence, Request { warp: self.warp, is_stop: true, epoch }, expected)
    }

    /// Track time goes on from `epoch` on, or from `now` on where that is later.
    ///
    /// # Errors
    /// [`HaltError::NotStopped`], [`HaltError::StillStopping`], [`HaltError::Stale`], [`HaltError::Busy`].
    pub fn resume(&mut self, sequence: u32, epoch: NetTime, now: NetTime) -> Result<(), HaltError> {
        self.run();
        self.refuse_stale(sequence)?;
        match self.followed {
            // of two halts of one sequence the stop goes before
            Some((last, true)) if last == sequence => return Err(HaltError::Stale { sequence, last }),
            Some((last, false)) if last == sequence => return Ok(()),
            _ => {}
        }
        if self.outstanding > 0 {
            return Err(HaltError::Busy);
        }
        let newest = self.newest();
        if !newest.is_stop {
            return Err(HaltError::NotStopped);
        }
        let (epoch, until) = (epoch.max(now), newest.end());
        if epoch < until {
            return Err(HaltError::StillStopping { until });
        }
        self.ask(sequence, Request { warp: newest.warp, is_stop: false, epoch }, epoch)
    }

    /// Hears what the interrupt's half did.
    pub fn run(&mut self) {
        while let Some(told) = self.told.dequeue() {
            if !matches!(told, Told::Stepped(..)) {
                self.outstanding = self.outstanding.saturating_sub(1);
            }
            if self.outstanding == 0 {
                self.asked = None;
            }
            match told {
                Told::Turn(turn) => self.keep(turn),
                Told::Instead(turn) => {
                    let _cancelled = self.kept.pop_back();
                    self.keep(turn);
                }
                Told::Cancelled => {
                    let _cancelled = self.kept.pop_back();
                }
                Told::Nothing => {}
                Told::Stepped(turn, next) => {
                    self.kept.clear();
                    self.oldest = turn;
                    if let Some(next) = next {
                        self.keep(next);
                    }
                    self.steps_back = self.steps_back.saturating_add(1);
                }
            }
        }
    }

    /// Track time at `system`, past or not. Before the oldest turn that is remembered it is what it was behind the one before.
    #[must_use]
    pub fn track_time(&self, system: NetTime) -> TrackTime {
        self.turn_at(system).at(system)
    }

    /// What track time does at `system`.
    #[must_use]
    pub fn state(&self, system: NetTime) -> MotionState {
        self.turn_at(system).state(system)
    }

    /// From now on stops take as long as `warp` says. For the task to decide when: axes that are armed have the reserve of the former.
    pub const fn set_warp(&mut self, warp: Warp) {
        self.warp = warp;
    }

    /// How stops to come take their time.
    #[must_use]
    pub const fn warp(&self) -> &Warp {
        &self.warp
    }

    /// How often system time stepped back; track time did not, and is off the network's since.
    #[must_use]
    pub const fn steps_back(&self) -> u32 {
        self.steps_back
    }

    /// The turn of the last stop, or of the last resume, that is to come or was.
    fn newest(&self) -> Turn {
        self.asked.or(self.kept.back().copied()).unwrap_or(self.oldest)
    }

    fn turn_at(&self, system: NetTime) -> &Turn {
        let mut newest_first = self.asked.iter().chain(self.kept.iter().rev());
        newest_first.find(|turn| turn.epoch <= system).unwrap_or(&self.oldest)
    }

    fn keep(&mut self, turn: Turn) {
        if self.kept.is_full()
            && let Some(oldest) = self.kept.pop_front()
        {
            self.oldest = oldest;
        }
        let _room = self.kept.push_back(turn);
    }

    fn refuse_stale(&self, sequence: u32) -> Result<(), HaltError> {
        match self.followed {
            Some((last, _)) if sequence.wrapping_sub(last).cast_signed() < 0 => {
                Err(HaltError::Stale { sequence, last })
            }
            _ => Ok(()),
        }
    }

    /// Hands a request over; it is expected to turn track time at `expected`.
    fn ask(&mut self, sequence: u32, request: Request, expected: NetTime) -> Result<(), HaltError> {
        self.requests.enqueue(request).map_err(|_| HaltError::Busy)?;
        self.outstanding += 1;
        self.followed = Some((sequence, request.is_stop));
        let epoch = on_grid(expected);
        let track = self.newest().at(epoch).time;
        let Request { warp, is_stop, .. } = request;
        self.asked = Some(Turn { warp, is_stop, epoch, track, passed: Span::ZERO });
        Ok(())
    }
}

/// The interrupt's half.
pub struct BeatClock<'a> {
    requests: Consumer<'a, Request>,
    told: Producer<'a, Told>,
    turn: Turn,
    /// What begins at its epoch.
    next: Option<Turn>,
    /// System time of the last beat.
    last: NetTime,
}

impl BeatClock<'_> {
    /// Track time of the beat at `system`. A system time that is back by up to [`EPOCH_GRID`] is taken as that of the last beat; where it is back by
    /// more, track time goes on from where it is, off the network's.
    pub fn advance(&mut self, system: NetTime) -> TrackTime {
        if self.last.since(system) > EPOCH_GRID {
            self.step_back(system);
        }
        if self.told.ready()
            && let Some(request) = self.requests.dequeue()
        {
            let told = self.turned(request);
            let _room = self.told.enqueue(told);
        }
        self.last = self.last.max(system);
        if let Some(next) = self.next.take_if(|next| next.epoch <= self.last) {
            self.turn = next;
        }
        self.turn.at(self.last)
    }

    /// What track time did at the last beat.
    #[must_use]
    pub fn state(&self) -> MotionState {
        self.turn.state(self.last)
    }

    /// What becomes of a request. What has been played cannot be turned any more, so nothing begins before the last beat.
    fn turned(&mut self, request: Request) -> Told {
        let Request { warp, is_stop, epoch } = request;
        let epoch = on_grid(epoch.max(self.last));
        match (is_stop, self.next) {
            (true, Some(next)) if !next.is_stop => {
                self.next = None;
                Told::Cancelled
            }
            (true, Some(next)) => {
                let epoch = epoch.max(on_grid(self.turn.end()));
                if epoch >= next.epoch {
                    return Told::Nothing;
                }
                Told::Instead(self.turn_next(warp, is_stop, epoch))
            }
            (true, None) if !self.turn.is_stop => {
                // a resume goes to its end before
                let epoch = epoch.max(on_grid(self.turn.end()));
                Told::Turn(self.turn_next(warp, is_stop, epoch))
            }
            (false, None) if self.turn.is_stop && epoch >= self.turn.end() => {
                Told::Turn(self.turn_next(warp, is_stop, epoch))
            }
            _ => Told::Nothing,
        }
    }

    fn turn_next(&mut self, warp: Warp, is_stop: bool, epoch: NetTime) -> Turn {
        let turn = Turn { warp, is_stop, epoch, track: self.turn.at(epoch).time, passed: Span::ZERO };
        self.next = Some(turn);
        turn
    }

    /// System time is `system` now and was later before: what is under way goes on from there, and what is to come keeps its distance.
    fn step_back(&mut self, system: NetTime) {
        let back = system.steps_after(self.last);
        let passed = self.turn.passed + self.last.since(self.turn.epoch);
        let passed = passed.min(self.turn.warp.duration());
        self.turn = Turn { epoch: system, track: self.turn.at(self.last).time, passed, ..self.turn };
        self.next = self.next.map(|next| Turn { epoch: next.epoch.shifted(back), ..next });
        self.last = system;
        if self.told.ready() {
            let _room = self.told.enqueue(Told::Stepped(self.turn, self.next));
        }
    }
}

/// The next multiple of [`EPOCH_GRID`].
fn on_grid(epoch: NetTime) -> NetTime {
    let mask = EPOCH_GRID.steps() - 1;
    NetTime::from_steps(epoch.steps().saturating_add(mask) & !mask)
}

//! Track time of all axes of a node: system time less what stops have used up.
//!
//! - **Walk:** a halt message → [`MotionClock::stop`] or [`MotionClock::resume`] in a task → a ring → [`BeatClock::advance`] once a beat →
//!   the track time at which every axis is evaluated.
//! - **Invariants:** track time never runs backwards, never faster than system time, and changes its rate only as a [`Warp`] does, whatever
//!   arrives when: a stop that comes late begins at once, one that comes during a resume begins at its end. A past system time
//!   maps to the track time that was played.
//! - **Context:** [`MotionClock`] in the task `serve`, [`BeatClock`] in the highest-priority task.

use fixed_math::time::{NetTime, Span};
use fixed_math::warp::{RATE_ONE, Warp};
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
    /// The task below has not taken the last one yet; send it again.
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
}

impl Turn {
    /// Track time of a clock that has always run.
    const NONE: Self = Self { warp: Warp::SHORTEST, is_stop: false, epoch: NetTime::ZERO, track: NetTime::ZERO };

    fn at(&self, system: NetTime) -> TrackTime {
        let since = system.since(self.epoch);
        if *self == Self::NONE {
            return TrackTime { time: system, rate: RATE_ONE };
        }
        let (passed, rate) = if self.is_stop {
            (self.warp.stopped(since), self.warp.stop_rate(since))
        } else {
            (self.warp.resumed(since), self.warp.resume_rate(since))
        };
        TrackTime { time: self.track + passed, rate }
    }

    /// When it is through.
    fn end(&self) -> NetTime {
        if *self == Self::NONE { NetTime::ZERO } else { self.epoch + self.warp.duration() }
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

/// What the two halves of a node's motion clock share.
#[derive(Debug)]
pub struct ClockRings {
    requests: Queue<Request, 4>,
    turns: Queue<Turn, 4>,
}

impl ClockRings {
    /// Empty ones.
    #[must_use]
    pub const fn new() -> Self {
        Self { requests: Queue::new(), turns: Queue::new() }
    }

    /// The half of the task and the half of the interrupt; stops take as long as `warp` says, until [`MotionClock::set_warp`].
    pub fn split(&mut self, warp: Warp) -> (MotionClock<'_>, BeatClock<'_>) {
        let (requests_in, requests_out) = self.requests.split();
        let (turns_in, turns_out) = self.turns.split();
        let clock = MotionClock {
            warp,
            requests: requests_in,
            turns: turns_out,
            kept: Deque::new(),
            oldest: Turn::NONE,
            asked: None,
            sequence: None,
        };
        let beat = BeatClock {
            requests: requests_out,
            turns: turns_in,
            turn: Turn::NONE,
            next: None,
            last: NetTime::ZERO,
        };
        (clock, beat)
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
    turns: Consumer<'a, Turn>,
    /// Turns that were played, the newest last.
    kept: Deque<Turn, WARPS_KEPT>,
    /// The one before the oldest that is kept.
    oldest: Turn,
    /// The request that was not confirmed yet.
    asked: Option<Turn>,
    sequence: Option<u32>,
}

impl MotionClock<'_> {
    /// Track time stops from `epoch` on, or from `now` on where that is later. A repeated `sequence` is no error and does nothing.
    ///
    /// # Errors
    /// [`HaltError::Stale`], [`HaltError::Busy`].
    pub fn stop(&mut self, sequence: u32, epoch: NetTime, now: NetTime) -> Result<(), HaltError> {
        self.run();
        if !self.is_new(sequence)? {
            return Ok(());
        }
        if self.newest().is_stop {
            self.sequence = Some(sequence);
            return Ok(());
        }
        // a resume goes to its end before
        let over = self.newest().end();
        self.ask(sequence, true, epoch.max(now).max(over))
    }

    /// Track time goes on from `epoch` on, or from `now` on where that is later.
    ///
    /// # Errors
    /// [`HaltError::NotStopped`], [`HaltError::StillStopping`], [`HaltError::Stale`], [`HaltError::Busy`].
    pub fn resume(&mut self, sequence: u32, epoch: NetTime, now: NetTime) -> Result<(), HaltError> {
        self.run();
        if !self.is_new(sequence)? {
            return Ok(());
        }
        let newest = self.newest();
        if !newest.is_stop {
            return Err(HaltError::NotStopped);
        }
        let epoch = epoch.max(now);
        let until = newest.end();
        if epoch < until {
            return Err(HaltError::StillStopping { until });
        }
        self.ask(sequence, false, epoch)
    }

    /// Hears what the interrupt's half did.
    pub fn run(&mut self) {
        while let Some(turn) = self.turns.dequeue() {
            self.asked = None;
            if self.kept.is_full()
                && let Some(oldest) = self.kept.pop_front()
            {
                self.oldest = oldest;
            }
            let _room = self.kept.push_back(turn);
        }
    }

    /// Track time at `system`, past or not. Before the oldest turn that is remembered it is what it was behind that one.
    #[must_use]
    pub fn track_time(&self, system: NetTime) -> TrackTime {
        let played = self.asked.iter().chain(self.kept.iter().rev());
        let turn = played.into_iter().find(|turn| turn.epoch <= system);
        turn.unwrap_or(&self.oldest).at(system)
    }

    /// What track time does at `system`.
    #[must_use]
    pub fn state(&self, system: NetTime) -> MotionState {
        let played = self.asked.iter().chain(self.kept.iter().rev());
        let turn = played.into_iter().find(|turn| turn.epoch <= system);
        turn.unwrap_or(&self.oldest).state(system)
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

    fn newest(&self) -> Turn {
        self.asked.or(self.kept.back().copied()).unwrap_or(self.oldest)
    }

    fn is_new(&self, sequence: u32) -> Result<bool, HaltError> {
        match self.sequence {
            Some(last) if last == sequence => Ok(false),
            Some(last) if sequence.wrapping_sub(last).cast_signed() < 0 => Err(HaltError::Stale { sequence, last }),
            _ => Ok(true),
        }
    }

    fn ask(&mut self, sequence: u32, is_stop: bool, epoch: NetTime) -> Result<(), HaltError> {
        if self.asked.is_some() {
            return Err(HaltError::Busy);
        }
        let epoch = on_grid(epoch);
        let newest = self.newest();
        let warp = if is_stop { self.warp } else { newest.warp };
        let track = newest.at(epoch).time;
        self.requests.enqueue(Request { warp, is_stop, epoch }).map_err(|_| HaltError::Busy)?;
        self.asked = Some(Turn { warp, is_stop, epoch, track });
        self.sequence = Some(sequence);
        Ok(())
    }
}

/// The interrupt's half.
pub struct BeatClock<'a> {
    requests: Consumer<'a, Request>,
    turns: Producer<'a, Turn>,
    turn: Turn,
    /// What begins at its epoch.
    next: Option<Turn>,
    /// System time of the last beat.
    last: NetTime,
}

impl BeatClock<'_> {
    /// Track time of the beat at `system`. A system time before that of the last beat is taken as that one.
    pub fn advance(&mut self, system: NetTime) -> TrackTime {
        let system = system.max(self.last);
        if self.next.is_none()
            && let Some(request) = self.requests.dequeue()
        {
            // what has been played cannot be warped any more
            let epoch = on_grid(request.epoch.max(self.last));
            let track = self.turn.at(epoch).time;
            let turn = Turn { warp: request.warp, is_stop: request.is_stop, epoch, track };
            self.next = Some(turn);
            let _room = self.turns.enqueue(turn);
        }
        self.last = system;
        if let Some(next) = self.next.take_if(|next| next.epoch <= system) {
            self.turn = next;
        }
        self.turn.at(system)
    }

    /// What track time did at the last beat.
    #[must_use]
    pub fn state(&self) -> MotionState {
        self.turn.state(self.last)
    }
}

/// The next multiple of [`EPOCH_GRID`].
fn on_grid(epoch: NetTime) -> NetTime {
    let mask = EPOCH_GRID.steps() - 1;
    NetTime::from_steps(epoch.steps().saturating_add(mask) & !mask)
}

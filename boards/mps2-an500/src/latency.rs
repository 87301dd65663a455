//! How long an interrupt at the links' priority waits, counted by the interrupt itself; for who measures.
//!
//! - **Walk:** the dual timer comes to 0 and begins anew → its interrupt, at the links' priority → [`Latency::on_interrupt`] reads how far
//!   it has counted since → the record, which the host reads at its place in the [`Region`].
//! - **Invariants:** the period is a prime number of ticks and none of the program's, so that it falls on every phase of what else goes
//!   on. What waits longest in the record is what a byte would have waited for that came then.
//! - **Context:** the links' priority, O(1); [`Turns::count`] in the serving task. Clause: `[NOD-08]`.
//!
//! QEMU's wires take no time: the bytes of a frame come on end, each as soon as the one before was taken, and leave likewise. So the longest
//! wait is that behind all interrupts of some frames, where at a real bit rate it would be that behind one byte of each UART. It is an upper
//! bound, in instruction time with `-icount shift=2`, 4 ns an instruction, about the pace of a Cortex-M7 at 250 MHz; without that option it
//! is the host's doing. What is waited while nothing is served has the emulator's own waking-up in it: judge by the turn of serving.
//!
//! The record, words in little-endian:
//!
//! | word | what |
//! |---|---|
//! | 0 | [`RECORD_MARK`] |
//! | 1 | interrupts of the timer counted |
//! | 2 | the longest wait of all, ticks of 40 ns |
//! | 3 | the longest turn of serving, ticks |
//! | 4 | in that turn: the longest wait, ticks |
//! | 5 | in that turn: bytes received |
//! | 6 | in that turn: bytes sent |
//! | 7 | in that turn: frames sent |

use crate::clock::now;
use crate::kept::{PROBE, Region};
use crate::pac::{DualTimerRegisters, Registers};
use core::sync::atomic::{AtomicU32, Ordering};

/// Begins a record.
pub const RECORD_MARK: u32 = 0x0511_1a7e;

/// Ticks of the period: a prime, 0.4 ms.
const PERIOD_TICKS: u32 = 10_007;
/// Counts, begins anew, interrupts, 32 bits wide.
const ON: u32 = 0b1110_0010;

/// What happened in the turn of serving under way.
static TURN: [AtomicU32; TURN_WORDS] = [const { AtomicU32::new(0) }; TURN_WORDS];
/// Words of it.
const TURN_WORDS: usize = 4;

/// Which word of a turn.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(not(feature = "probe"), expect(dead_code, reason = "UARTs count with the feature `probe` alone"))]
pub(crate) enum Count {
    /// The longest wait, ticks.
    Wait,
    /// Bytes received.
    BytesIn,
    /// Bytes sent.
    BytesOut,
    /// Frames sent.
    FramesOut,
}

/// Counts one.
#[cfg(feature = "probe")]
pub(crate) fn count(what: Count) {
    TURN[what as usize].fetch_add(1, Ordering::Relaxed);
}

/// The record in memory.
#[repr(C)]
struct Record {
    mark: AtomicU32,
    samples: AtomicU32,
    wait_max: AtomicU32,
    turn_ticks_max: AtomicU32,
    turn: [AtomicU32; TURN_WORDS],
}

/// The timer whose interrupt counts.
pub struct Latency {
    timer: Registers<DualTimerRegisters>,
    record: &'static Record,
}

impl Latency {
    pub(crate) fn new(timer: Registers<DualTimerRegisters>, region: Region) -> Self {
        // SAFETY: an aligned place in RAM that is reached through atomics alone.
        Self { timer, record: unsafe { &*region.place(PROBE) } }
    }

    /// Begins a new record.
    #[must_use]
    pub fn start(self) -> Self {
        let Record { mark, samples, wait_max, turn_ticks_max, turn } = self.record;
        for word in [samples, wait_max, turn_ticks_max].into_iter().chain(turn) {
            word.store(0, Ordering::Relaxed);
        }
        mark.store(RECORD_MARK, Ordering::Relaxed);
        self.timer.load.set(PERIOD_TICKS - 1);
        self.timer.control.set(ON);
        self
    }

    /// The body of the timer's interrupt.
    pub fn on_interrupt(&mut self) {
        let wait = (PERIOD_TICKS - 1).wrapping_sub(self.timer.value.get());
        self.timer.interrupt_clear.set(1);
        self.record.samples.fetch_add(1, Ordering::Relaxed);
        self.record.wait_max.fetch_max(wait, Ordering::Relaxed);
        TURN[Count::Wait as usize].fetch_max(wait, Ordering::Relaxed);
    }

    /// What serving needs of it.
    #[must_use]
    pub const fn turns(&self) -> Turns {
        Turns(self.record)
    }
}

/// Counts turns of serving.
pub struct Turns(&'static Record);

impl Turns {
    /// Runs one turn, and keeps what happened in it where it is the longest so far.
    pub fn count<R>(&mut self, turn: impl FnOnce() -> R) -> R {
        for word in &TURN {
            word.store(0, Ordering::Relaxed);
        }
        let began = now();
        let result = turn();
        let ticks = u32::try_from(now().since(began).steps() * 25 / 256).unwrap_or(u32::MAX);
        if ticks > self.0.turn_ticks_max.load(Ordering::Relaxed) {
            self.0.turn_ticks_max.store(ticks, Ordering::Relaxed);
            for (from, to) in TURN.iter().zip(&self.0.turn) {
                to.store(from.load(Ordering::Relaxed), Ordering::Relaxed);
            }
        }
        result
    }
}

//! Faults on a link, `[LNK-07]`: loss, duplication, reordering, delay, bit errors and bandwidth, all drawn from one seed.
//!
//! - **Walk:** a frame's bytes → [`FaultLayer::offer`] → … → [`FaultLayer::poll`] → the link, or the node behind it. The simulator
//!   calls it in virtual time, the workstation's links in real time; time is an argument here.
//! - **Invariants:** the same configuration, calls and times give the same bytes. `offered + duplicated = lost + overflowed +
//!   delivered + inside`. No configuration, however absurd, panics.
//! - **Context:** any thread; an offer costs O(log n) for `n` frames inside and O(bits flipped).
//! - **Clause:** `[LNK-07]`.
//!
//! A frame meets them in this order, as on a wire:
//!
//! 1. *Queue.* Where `FRAMES_MAX` frames are inside, it is dropped: `overflowed`.
//! 2. *Bandwidth.* One frame after the other, `bytes × 8 / bandwidth` each; it is out when its last bit is. A frame that is lost
//!    further on took its time too.
//! 3. *Loss.*
//! 4. *Duplication.* A copy follows it at once, without taking bandwidth. What comes below is drawn for each of the two.
//! 5. *Bit errors.* Each bit flips by itself; the distance to the next flip is drawn, so that rare flips cost nothing.
//! 6. *Delay and jitter.* `delay` plus a uniform share of `jitter`, but never before the frame in front: jitter alone does not
//!    change the order.
//! 7. *Reordering.* A frame so drawn is held until the next 1 to `OVERTAKEN_MAX` frames (uniform) have gone past, and comes
//!    right behind the last of them; or until `HOLD` has passed, so that a frame nobody follows is not held for ever.
//!
//! ```
//! use fixed_math::time::{LocalTicks, Span};
//! use osap_sim::faults::{FaultConfig, FaultLayer};
//!
//! let config: FaultConfig = "delay=200us,bandwidth=1M,seed=7".parse()?;
//! let mut layer = FaultLayer::new(config);
//! layer.offer(LocalTicks::ZERO, &[0x55; 10]); // 80 bits at 1 Mbit/s: 80 µs
//! assert_eq!(layer.next_at(), Some(LocalTicks::from_us(280)));
//! assert_eq!(layer.poll(LocalTicks::from_us(279)), None);
//! assert_eq!(layer.poll(LocalTicks::from_us(280)), Some(vec![0x55; 10]));
//! # Ok::<(), osap_sim::faults::FaultConfigError>(())
//! ```

mod config;

pub use config::{FaultConfig, FaultConfigError};

use fixed_math::time::{LocalTicks, Span};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use std::collections::BTreeMap;

/// Frames inside at most; more are dropped and counted as `overflowed`.
pub const FRAMES_MAX: usize = 1024;
/// Frames that may go past one that is held back.
pub const OVERTAKEN_MAX: u32 = 3;
/// How long a frame is held back at most, where too few follow it: well below the longest time to live, 65.5 ms.
pub const HOLD: Span = Span::from_us(10_000);

/// What became of the frames so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FaultCounts {
    /// Given to [`FaultLayer::offer`].
    pub offered: u64,
    /// Lost.
    pub lost: u64,
    /// Copies made.
    pub duplicated: u64,
    /// Held back to be overtaken.
    pub reordered: u64,
    /// Frames with at least one flipped bit.
    pub corrupted: u64,
    /// Bits flipped in all of them.
    pub bits_flipped: u64,
    /// Dropped since `FRAMES_MAX` frames were inside.
    pub overflowed: u64,
    /// Given out by [`FaultLayer::poll`].
    pub delivered: u64,
}

/// When a frame is due, and its number, which decides between equals.
type Place = (LocalTicks, u64);

/// A frame that waits to be overtaken.
#[derive(Debug)]
struct Held {
    place: Place,
    remaining: u32,
}

/// One direction of a faulty link.
#[derive(Debug)]
pub struct FaultLayer {
    config: FaultConfig,
    rng: Pcg64,
    counts: FaultCounts,
    frames: BTreeMap<Place, Vec<u8>>,
    held: Vec<Held>,
    next_number: u64,
    /// When the last bit of what was offered is out.
    free_at: LocalTicks,
    /// When the last frame that keeps the order is due.
    last_due: LocalTicks,
    /// Bits to pass before the next that flips.
    bits_to_flip: u64,
}

impl FaultLayer {
    /// An empty layer.
    #[must_use]
    pub fn new(config: FaultConfig) -> Self {
        let mut rng = Pcg64::seed_from_u64(config.seed);
        let bits_to_flip = draw_gap(&mut rng, config.bit_error_rate);
        Self {
            config,
            rng,
            counts: FaultCounts::default(),
            frames: BTreeMap::new(),
            held: Vec::new(),
            next_number: 0,
            free_at: LocalTicks::ZERO,
            last_due: LocalTicks::ZERO,
            bits_to_flip,
        }
    }

    /// Takes a frame that is handed to the link at `now`.
    pub fn offer(&mut self, now: LocalTicks, bytes: &[u8]) {
        self.counts.offered += 1;
        if self.frames.len() >= FRAMES_MAX {
            self.counts.overflowed += 1;
            return;
        }
        self.free_at = self.free_at.max(now) + self.wire_time(bytes.len());
        if self.happens(self.config.loss) {
            self.counts.lost += 1;
            return;
        }
        let twice = self.happens(self.config.duplication);
        self.insert(bytes);
        if twice {
            self.counts.duplicated += 1;
            if self.frames.len() >= FRAMES_MAX {
                self.counts.overflowed += 1;
            } else {
                self.insert(bytes);
            }
        }
    }

    /// When there is something for [`FaultLayer::poll`]; `None` while the layer is empty.
    #[must_use]
    pub fn next_at(&self) -> Option<LocalTicks> {
        self.frames.first_key_value().map(|((due, _), _)| *due)
    }

    /// The next frame that is due at `now`: by time, equal ones in order of insertion.
    pub fn poll(&mut self, now: LocalTicks) -> Option<Vec<u8>> {
        let first = self.frames.first_entry().filter(|entry| entry.key().0 <= now)?;
        self.counts.delivered += 1;
        let (place, bytes) = first.remove_entry();
        self.held.retain(|held| held.place != place);
        Some(bytes)
    }

    /// When the wire is free for a next frame: the last bit of all that was offered is out.
    #[must_use]
    pub fn free_at(&self) -> LocalTicks {
        self.free_at
    }

    /// Frames inside.
    #[must_use]
    pub fn inside(&self) -> usize {
        self.frames.len()
    }

    /// What became of the frames so far.
    #[must_use]
    pub fn counts(&self) -> FaultCounts {
        self.counts
    }

    /// Steps 5 to 7 for one copy.
    fn insert(&mut self, bytes: &[u8]) {
        let mut bytes = bytes.to_vec();
        self.flip_bits(&mut bytes);
        let jitter = Span::from_steps(self.draw_up_to(self.config.jitter.steps()));
        let due = (self.free_at + self.config.delay + jitter).max(self.last_due);
        if self.happens(self.config.reorder) {
            self.counts.reordered += 1;
            let remaining = self.rng.random_range(1..=OVERTAKEN_MAX);
            let place = self.place(due + HOLD);
            self.frames.insert(place, bytes);
            self.held.push(Held { place, remaining });
            return;
        }
        self.last_due = due;
        let place = self.place(due);
        self.frames.insert(place, bytes);
        self.overtake(due);
    }

    /// A frame due at `due` went past all that are held: who has seen enough of them comes right behind it.
    fn overtake(&mut self, due: LocalTicks) {
        for mut held in std::mem::take(&mut self.held) {
            held.remaining -= 1;
            if held.remaining > 0 {
                self.held.push(held);
            } else if held.place.0 > due
                && let Some(bytes) = self.frames.remove(&held.place)
            {
                let place = self.place(due);
                self.frames.insert(place, bytes);
            }
        }
    }

    fn place(&mut self, due: LocalTicks) -> Place {
        self.next_number += 1;
        (due, self.next_number)
    }

    fn flip_bits(&mut self, bytes: &mut [u8]) {
        if self.config.bit_error_rate <= 0.0 {
            return;
        }
        let bits = bytes.len() as u64 * 8;
        let mut at = self.bits_to_flip;
        let flipped_before = self.counts.bits_flipped;
        while at < bits {
            if let Some(byte) = usize::try_from(at / 8).ok().and_then(|index| bytes.get_mut(index)) {
                *byte ^= 1 << (at % 8);
            }
            self.counts.bits_flipped += 1;
            at = at.saturating_add(1).saturating_add(draw_gap(&mut self.rng, self.config.bit_error_rate));
        }
        self.bits_to_flip = at - bits;
        self.counts.corrupted += u64::from(self.counts.bits_flipped > flipped_before);
    }

    fn wire_time(&self, len: usize) -> Span {
        let Some(bandwidth_bits_s) = self.config.bandwidth_bits_s else { return Span::ZERO };
        let bits_in_steps = (len as u128 * 8 * 1_000_000) << fixed_math::time::FRACTION_BITS;
        // No bandwidth at all: never out, rather than a division by zero.
        if bandwidth_bits_s == 0 {
            return Span::MAX;
        }
        Span::from_steps(u64::try_from(bits_in_steps.div_ceil(u128::from(bandwidth_bits_s))).unwrap_or(u64::MAX))
    }

    /// Draws only where there is something to decide, so that one fault switched off does not shift the draws of the others.
    fn happens(&mut self, probability: f64) -> bool {
        probability > 0.0 && self.rng.random::<f64>() < probability
    }

    fn draw_up_to(&mut self, last: u64) -> u64 {
        if last == 0 { 0 } else { self.rng.random_range(0..=last) }
    }
}

/// Bits that pass unharmed before one flips, each with probability `rate`: a geometric variable, by inversion.
fn draw_gap(rng: &mut Pcg64, rate: f64) -> u64 {
    if rate <= 0.0 || rate.is_nan() {
        return u64::MAX;
    }
    // 1 − [0, 1) is (0, 1]: its logarithm is finite. A rate of one or more gives −∞ or NaN below, and thus a gap of zero.
    let uniform: f64 = 1.0 - rng.random::<f64>();
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "never negative; saturates; NaN gives 0"
    )]
    let gap = (uniform.ln() / (-rate).ln_1p()) as u64;
    gap
}

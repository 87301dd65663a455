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

/// One direction of a faulty link, or a bus.
#[derive(Debug)]
pub struct FaultLayer {
    config: FaultConfig,
    rng: Pcg64,
    counts: FaultCounts,
    frames: BTreeMap<Place, (u32, Vec<u8>)>,
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
        self.offer_tagged(now, 0, bytes);
    }

    /// As [`FaultLayer::offer`], with a number that comes out beside the frame and its copies, out of reach of the bit errors: on a
    /// shared medium, who spoke.
    pub fn offer_tagged(&mut self, now: LocalTicks, tag: u32, bytes: &[u8]) {
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
        self.insert(tag, bytes);
        if twice {
            self.counts.duplicated += 1;
            if self.frames.len() >= FRAMES_MAX {
                self.counts.overflowed += 1;
            } else {
                self.insert(tag, bytes);
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
        self.poll_tagged(now).map(|(_, bytes)| bytes)
    }

    /// As [`FaultLayer::poll`], with what came in beside the frame.
    pub fn poll_tagged(&mut self, now: LocalTicks) -> Option<(u32, Vec<u8>)> {
        let first = self.frames.first_entry().filter(|entry| entry.key().0 <= now)?;
        self.counts.delivered += 1;
        let (place, frame) = first.remove_entry();
        self.held.retain(|held| held.place != place);
        Some(frame)
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
    fn insert(&mut self, tag: u32, bytes: &[u8]) {
        let mut bytes = bytes.to_vec();
        self.flip_bits(&mut bytes);
        let jitter = Span::from_steps(self.draw_up_to(self.config.jitter.steps()));
        let due = (self.free_at + self.config.delay + jitter).max(self.last_due);
        if self.happens(self.config.reorder) {
            self.counts.reordered += 1;
            let remaining = self.rng.random_range(1..=OVERTAKEN_MAX);
            let place = self.place(due + HOLD);
            self.frames.insert(place, (tag, bytes));
            self.held.push(Held { place, remaining });
            return;
        }
        self.last_due = due;
        let place = self.place(due);
        self.frames.insert(place, (tag, bytes));
        self.overtake(due);
    }

    /// A frame due at `due` went past all that are held: who has seen enough of them comes right behind it.
    fn overtake(&mut self, due: LocalTicks) {
        for mut held in std::mem::take(&mut self.held) {
            held.remaining -= 1;
            if held.remaining > 0 {
                self.held.push(held);
            } else if held.place.0 > due
                && let Some(frame) = self.frames.remove(&held.place)
            {
                let place = self.place(due);
                self.frames.insert(place, frame);
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Everything that is inside, in the order in which it comes out.
    fn drain(layer: &mut FaultLayer) -> Vec<Vec<u8>> {
        std::iter::from_fn(|| layer.poll(LocalTicks::MAX)).collect()
    }

    /// Offers `count` numbered frames of four bytes, 1 µs apart.
    fn offer_numbered(layer: &mut FaultLayer, count: u32) {
        for n in 0..count {
            layer.offer(LocalTicks::from_us(u64::from(n)), &n.to_le_bytes());
        }
    }

    fn numbers(frames: &[Vec<u8>]) -> Vec<u32> {
        frames.iter().map(|frame| u32::from_le_bytes(frame[..].try_into().unwrap())).collect()
    }

    fn layer(text: &str) -> FaultLayer {
        FaultLayer::new(text.parse().unwrap())
    }

    /// Whether `count` is within five standard deviations of what `trials` with probability `p` give: σ² = n p (1 − p).
    /// Beyond that lies less than one seed in a million.
    fn plausible(count: u64, trials: f64, p: f64) -> bool {
        #[expect(clippy::cast_precision_loss, reason = "far below 2^53")]
        let off = (count as f64 - trials * p).abs();
        off <= 5.0 * (trials * p * (1.0 - p)).sqrt()
    }

    #[test]
    fn the_loss_rate_is_the_one_asked_for() {
        let mut layer = layer("loss=0.01,seed=1");
        for _ in 0..100_000 {
            layer.offer(LocalTicks::ZERO, &[1]);
            layer.poll(LocalTicks::ZERO);
        }
        let lost = layer.counts().lost;
        assert!(plausible(lost, 1e5, 0.01), "{lost} of 100000 lost");
    }

    #[test]
    fn bits_flip_at_the_rate_asked_for_and_are_all_counted() {
        let mut layer = layer("ber=0.001,seed=2");
        let mut flipped = 0;
        for _ in 0..1_000 {
            layer.offer(LocalTicks::ZERO, &[0; 1_000]);
            let frame = layer.poll(LocalTicks::ZERO).unwrap();
            flipped += frame.iter().map(|byte| u64::from(byte.count_ones())).sum::<u64>();
        }
        assert_eq!(flipped, layer.counts().bits_flipped);
        assert!(plausible(flipped, 8e6, 1e-3), "{flipped} of 8 million bits");
        // A frame of 8000 bits stays whole with probability 0.999^8000 = 0.000334.
        assert!(layer.counts().corrupted > 980, "{:?}", layer.counts());
    }

    /// The gap to the next flip is carried from frame to frame: one draw for some 10⁹ bits, not one a bit or a frame.
    #[test]
    fn rare_flips_cost_no_draws() {
        let mut layer = layer("ber=1e-9,seed=3");
        let gap = layer.bits_to_flip;
        assert!(gap > 8_000_000, "this seed's first gap is {gap}");
        let before = layer.rng.clone();
        for _ in 0..1_000 {
            layer.offer(LocalTicks::ZERO, &[0; 1_000]);
            layer.poll(LocalTicks::ZERO);
        }
        assert_eq!(layer.rng, before);
        assert_eq!(layer.bits_to_flip, gap - 8_000_000);
    }

    #[test]
    fn at_a_rate_of_one_every_bit_flips() {
        let mut layer = layer("ber=1");
        layer.offer(LocalTicks::ZERO, &[0x0f, 0xaa]);
        assert_eq!(drain(&mut layer), [[0xf0, 0x55]]);
    }

    /// Two frames at once: the second waits for the first. A lost one takes its time too.
    #[test]
    fn bandwidth_serves_one_frame_after_the_other() {
        let mut layer = layer("bandwidth=8k");
        layer.offer(LocalTicks::ZERO, &[1]); // 8 bits at 8 kbit/s: 1 ms
        layer.offer(LocalTicks::ZERO, &[2, 2]);
        assert_eq!(layer.free_at(), LocalTicks::from_us(3_000));
        assert_eq!(layer.poll(LocalTicks::from_us(999)), None);
        assert_eq!(layer.poll(LocalTicks::from_us(1_000)), Some(vec![1]));
        assert_eq!(layer.next_at(), Some(LocalTicks::from_us(3_000)));

        let mut lossy = self::layer("bandwidth=8k,loss=1");
        lossy.offer(LocalTicks::ZERO, &[1]);
        assert_eq!((lossy.free_at(), lossy.inside()), (LocalTicks::from_us(1_000), 0));
    }

    #[test]
    fn a_copy_follows_its_original() {
        let mut layer = layer("dup=1");
        offer_numbered(&mut layer, 3);
        assert_eq!(numbers(&drain(&mut layer)), [0, 0, 1, 1, 2, 2]);
    }

    #[test]
    fn jitter_alone_keeps_the_order() {
        let mut layer = layer("delay=5us,jitter=1ms,seed=4");
        offer_numbered(&mut layer, 500);
        assert_eq!(numbers(&drain(&mut layer)), (0..500).collect::<Vec<_>>());
    }

    /// One that is held back comes right behind the last frame it waited for, which is one of the next three.
    #[test]
    fn a_frame_held_back_is_overtaken_by_the_next_few() {
        let mut layer = layer("reorder=0.05,seed=5");
        offer_numbered(&mut layer, 1_000);
        let order = numbers(&drain(&mut layer));
        let late: Vec<usize> = (1..order.len()).filter(|at| order[*at] < order[at - 1]).collect();
        // Neighbours that are both held can come out behind the same frame in their order: then one step back is seen for two.
        let reordered = usize::try_from(layer.counts().reordered).unwrap();
        assert!(plausible(layer.counts().reordered, 1e3, 0.05), "{reordered}");
        assert!(late.len() > reordered * 3 / 4 && late.len() <= reordered, "{} of {reordered}", late.len());
        for at in late {
            let jump = order[at - 1] - order[at];
            // Up to three that keep the order, and what was held back among them.
            assert!((1..=2 * OVERTAKEN_MAX).contains(&jump), "{:?}", &order[at - 1..=at]);
        }
    }

    #[test]
    fn a_held_frame_that_nobody_follows_comes_after_the_hold() {
        let mut layer = layer("reorder=1");
        layer.offer(LocalTicks::from_us(1), &[1]);
        assert_eq!(layer.next_at(), Some(LocalTicks::from_us(1) + HOLD));
        assert_eq!(drain(&mut layer), [[1]]);
        assert_eq!(layer.next_at(), None);
    }

    #[test]
    fn a_full_layer_drops_and_counts() {
        let mut layer = layer("dup=1");
        offer_numbered(&mut layer, 600);
        let counts = layer.counts();
        assert_eq!((layer.inside(), counts.offered, counts.duplicated, counts.overflowed), (FRAMES_MAX, 600, 512, 88));
    }

    #[test]
    fn another_seed_gives_other_faults() {
        let run = |text: &str| {
            let mut layer = layer(text);
            offer_numbered(&mut layer, 100);
            drain(&mut layer)
        };
        assert_ne!(run("loss=0.5,seed=1"), run("loss=0.5,seed=2"));
    }

    /// The fields are open to anybody: none may make it panic.
    #[test]
    fn absurd_numbers_do_not_panic() {
        for p in [f64::NAN, f64::INFINITY, -1.0, 7.0] {
            for bandwidth_bits_s in [None, Some(0), Some(u64::MAX)] {
                let mut layer = FaultLayer::new(FaultConfig {
                    loss: p / 10.0,
                    duplication: p,
                    reorder: p,
                    delay: Span::MAX,
                    jitter: Span::MAX,
                    bit_error_rate: p,
                    bandwidth_bits_s,
                    seed: 0,
                });
                offer_numbered(&mut layer, 10);
                drain(&mut layer);
            }
        }
    }

    fn any_config() -> impl Strategy<Value = FaultConfig> {
        let p = || prop_oneof![Just(0.0), 0.0..0.3];
        (p(), p(), p(), 0u64..50_000, 0u64..50_000, p(), proptest::option::of(1_000u64..10_000_000), any::<u64>())
            .prop_map(|(loss, duplication, reorder, delay, jitter, bit_error_rate, bandwidth_bits_s, seed)| {
                FaultConfig {
                    loss,
                    duplication,
                    reorder,
                    delay: Span::from_steps(delay),
                    jitter: Span::from_steps(jitter),
                    bit_error_rate: bit_error_rate / 10.0,
                    bandwidth_bits_s,
                    seed,
                }
            })
    }

    /// Gaps between offers, µs, and the frames.
    fn any_traffic() -> impl Strategy<Value = Vec<(u64, Vec<u8>)>> {
        proptest::collection::vec((0u64..300, proptest::collection::vec(any::<u8>(), 0..40)), 0..120)
    }

    /// Offers all of it, polling as its time comes; then what is left.
    fn run(
        layer: &mut FaultLayer,
        traffic: &[(u64, Vec<u8>)],
        mut each: impl FnMut(&FaultLayer),
    ) -> Vec<(LocalTicks, Vec<u8>)> {
        let mut now = LocalTicks::ZERO;
        let mut out = Vec::new();
        for (gap_us, bytes) in traffic {
            now = now + Span::from_us(*gap_us);
            out.extend(std::iter::from_fn(|| layer.poll(now)).map(|frame| (now, frame)));
            layer.offer(now, bytes);
            each(layer);
        }
        while let Some(at) = layer.next_at() {
            out.extend(layer.poll(at).map(|frame| (at, frame)));
            each(layer);
        }
        out
    }

    proptest! {
        /// `[LNK-07]`: no frame appears or vanishes without being counted.
        #[test]
        fn frames_are_conserved(config in any_config(), traffic in any_traffic()) {
            let mut broken = None;
            run(&mut FaultLayer::new(config), &traffic, |layer| {
                let c = layer.counts();
                if c.offered + c.duplicated != c.lost + c.overflowed + c.delivered + layer.inside() as u64 {
                    broken = Some((c, layer.inside()));
                }
            });
            prop_assert_eq!(broken, None);
        }

        /// Without faults every frame comes out at once, as it was.
        #[test]
        fn no_faults_is_identity(traffic in any_traffic(), seed: u64) {
            let mut layer = FaultLayer::new(FaultConfig { seed, ..FaultConfig::default() });
            let mut now = LocalTicks::ZERO;
            for (gap_us, bytes) in traffic {
                now = now + Span::from_us(gap_us);
                layer.offer(now, &bytes);
                prop_assert_eq!(layer.poll(now), Some(bytes));
                prop_assert_eq!(layer.poll(now), None);
            }
        }

        /// `[LNK-07]`: all is drawn from the seed.
        #[test]
        fn one_seed_gives_one_output(config in any_config(), traffic in any_traffic()) {
            let once = run(&mut FaultLayer::new(config), &traffic, |_| {});
            let again = run(&mut FaultLayer::new(config), &traffic, |_| {});
            prop_assert_eq!(once, again);
        }

        /// Nothing comes before it has crossed the wire and waited its delay, and nothing later than every wait together.
        #[test]
        fn a_frame_comes_neither_early_nor_late(config in any_config(), bytes in proptest::collection::vec(any::<u8>(), 0..40)) {
            let mut layer = FaultLayer::new(FaultConfig { loss: 0.0, ..config });
            layer.offer(LocalTicks::from_us(9), &bytes);
            let earliest = layer.free_at() + config.delay;
            while let Some(at) = layer.next_at() {
                prop_assert!(at >= earliest && at <= earliest + config.jitter + HOLD);
                prop_assert!(layer.poll(at).is_some());
            }
        }
    }
}

//! The last points of a series by their index, so that a past position can be asked for.
//!
//! - **Walk:** every point that goes to the player, and every one that the player is known to have made → *here* → a sensor's time.
//! - **Invariants:** indices before the series are its rest position; what was overwritten is `None`, never another point.
//! - **Context:** the task `serve`.

/// The last `N` points; `N` is a power of two.
#[derive(Clone, Copy, Debug)]
pub(crate) struct History<const N: usize> {
    points: [i32; N],
    /// Where the series began, for all indices up to 0.
    origin: i32,
    /// The newest index.
    newest: u64,
    /// The oldest index that is still there.
    oldest: u64,
}

impl<const N: usize> History<N> {
    pub(crate) const fn new() -> Self {
        const { assert!(N.is_power_of_two() && N >= 8, "a power of two of at least 8") };
        Self { points: [0; N], origin: 0, newest: 0, oldest: 0 }
    }

    /// A series at rest at `position`, at index 0.
    pub(crate) fn restart(&mut self, position: i32) {
        *self = Self { origin: position, ..Self::new() };
        self.put(0, position);
    }

    /// The point after the newest.
    pub(crate) fn push(&mut self, position: i32) {
        self.newest += 1;
        self.put(self.newest, position);
        let kept = N as u64 - 1;
        self.oldest = self.oldest.max(self.newest.saturating_sub(kept));
    }

    /// Forgets what comes after `index`.
    pub(crate) fn cut(&mut self, index: u64) {
        self.newest = self.newest.min(index);
    }

    pub(crate) const fn newest(&self) -> u64 {
        self.newest
    }

    pub(crate) const fn oldest(&self) -> u64 {
        self.oldest
    }

    pub(crate) fn get(&self, index: i64) -> Option<i32> {
        match u64::try_from(index) {
            Err(_) | Ok(0) if self.oldest == 0 => Some(self.origin),
            Ok(index) if (self.oldest..=self.newest).contains(&index) => self.slot(index).copied(),
            _ => None,
        }
    }

    fn put(&mut self, index: u64, position: i32) {
        if let Some(slot) = self.points.get_mut(Self::at(index)) {
            *slot = position;
        }
    }

    fn slot(&self, index: u64) -> Option<&i32> {
        self.points.get(Self::at(index))
    }

    #[expect(clippy::cast_possible_truncation, reason = "the low bits are what is wanted")]
    const fn at(index: u64) -> usize {
        index as usize & (N - 1)
    }
}

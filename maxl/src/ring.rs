//! Control points from a task to the interrupt above it.
//!
//! - **Walk:** [`PointsIn::push`] in `serve` → *this ring* → [`PointsOut::pop`] once an interval in the highest-priority task.
//! - **Invariants:** a point's number is the count of those pushed before it, so a series that begins anew drops what is left of the
//!   one before by its number alone. Single producer, single consumer, no lock, no division: the length is a power of two that the
//!   compiler knows, which `heapless` has its halves learn as they run.
//! - **Context:** either half in one context each.

use core::sync::atomic::{AtomicI32, AtomicU32, Ordering};

/// Room for `N` points; `N` is a power of two.
#[derive(Debug)]
pub(crate) struct PointRing<const N: usize> {
    points: [AtomicI32; N],
    pushed: AtomicU32,
    popped: AtomicU32,
}

impl<const N: usize> PointRing<N> {
    pub(crate) const fn new() -> Self {
        const { assert!(N.is_power_of_two() && N >= 4 && N <= 1 << 16, "a power of two from 4 to 65,536") };
        Self { points: [const { AtomicI32::new(0) }; N], pushed: AtomicU32::new(0), popped: AtomicU32::new(0) }
    }

    /// `&mut`, so that there is one of each half.
    pub(crate) const fn split(&mut self) -> (PointsIn<'_, N>, PointsOut<'_, N>) {
        (PointsIn(self), PointsOut(self))
    }

    fn slot(&self, number: u32) -> Option<&AtomicI32> {
        self.points.get(number as usize & (N - 1))
    }
}

/// The task's half.
pub(crate) struct PointsIn<'a, const N: usize>(&'a PointRing<N>);

impl<const N: usize> PointsIn<'_, N> {
    /// The number that the next point will have.
    pub(crate) fn next(&self) -> u32 {
        self.0.pushed.load(Ordering::Relaxed)
    }

    /// Points that are waiting.
    #[expect(clippy::cast_possible_truncation, reason = "N is at most 2^16")]
    pub(crate) fn waiting(&self) -> u32 {
        self.next().wrapping_sub(self.0.popped.load(Ordering::Acquire)).min(N as u32)
    }

    /// False where there is no room.
    pub(crate) fn push(&mut self, point: i32) -> bool {
        let number = self.next();
        if self.waiting() as usize >= N {
            return false;
        }
        let Some(slot) = self.0.slot(number) else { return false };
        slot.store(point, Ordering::Relaxed);
        self.0.pushed.store(number.wrapping_add(1), Ordering::Release);
        true
    }
}

/// The interrupt's half.
pub(crate) struct PointsOut<'a, const N: usize>(&'a PointRing<N>);

impl<const N: usize> PointsOut<'_, N> {
    /// The oldest point, if there is one.
    pub(crate) fn pop(&mut self) -> Option<i32> {
        let number = self.next();
        if number == self.0.pushed.load(Ordering::Acquire) {
            return None;
        }
        let point = self.0.slot(number)?.load(Ordering::Relaxed);
        self.0.popped.store(number.wrapping_add(1), Ordering::Release);
        Some(point)
    }

    /// The number of the next point.
    pub(crate) fn next(&self) -> u32 {
        self.0.popped.load(Ordering::Relaxed)
    }

    /// Drops what comes before `number`, which was [`PointsIn::next`] of a series to come.
    pub(crate) fn skip_to(&mut self, number: u32) {
        self.0.popped.store(number, Ordering::Release);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_come_out_in_order_and_no_more_go_in_than_there_is_room() {
        let mut ring = PointRing::<4>::new();
        let (mut task, mut interrupt) = ring.split();
        for round in 0..100 {
            assert!((0..4).all(|point| task.push(round * 4 + point)));
            assert!(!task.push(-1), "full");
            assert_eq!(task.waiting(), 4);
            assert!((0..4).all(|point| interrupt.pop() == Some(round * 4 + point)));
            assert_eq!(interrupt.pop(), None);
        }
    }

    #[test]
    fn a_new_series_drops_the_rest_of_the_one_before() {
        let mut ring = PointRing::<8>::new();
        let (mut task, mut interrupt) = ring.split();
        assert!(task.push(1) && task.push(2));
        let first = task.next();
        assert!(task.push(3));
        interrupt.skip_to(first);
        assert_eq!((interrupt.pop(), interrupt.pop(), task.waiting()), (Some(3), None, 0));
    }
}

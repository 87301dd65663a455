//! What a test may know and no node can: readings of counters at true instants, and when nodes booted.
//!
//! - **Walk:** none: nothing here changes the world.
//! - **Context:** between steps of the world. **Clause:** `[NOD-12]`.

use super::{NodeId, World};
use crate::time::TrueTime;
use fixed_math::time::LocalTicks;

impl World {
    /// What a node's counter reads now, in whole ticks of its timer.
    #[must_use]
    pub fn local_now(&self, node: NodeId) -> LocalTicks {
        self.local(node, self.now)
    }

    /// What a node's counter reads at `at`, in whole ticks of its timer; its readings before its last boot are that boot's.
    #[must_use]
    pub fn local(&self, node: NodeId, at: TrueTime) -> LocalTicks {
        self.stations[node.at()].clock.local(at)
    }

    /// What a node's counter would read at `at` if its timer had no coarser tick than 1/256 µs. Two nodes' system times of these
    /// readings, at one instant, differ by the error of their clocks and nothing else.
    #[must_use]
    pub fn exact(&self, node: NodeId, at: TrueTime) -> LocalTicks {
        self.stations[node.at()].clock.exact(at)
    }

    /// When a node's counter reads `local`.
    #[must_use]
    pub fn truth(&self, node: NodeId, local: LocalTicks) -> TrueTime {
        self.stations[node.at()].clock.truth(local)
    }

    /// When a node booted last, or will boot.
    #[must_use]
    pub fn booted(&self, node: NodeId) -> TrueTime {
        self.stations[node.at()].booted
    }
}

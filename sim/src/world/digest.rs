//! One number for all that happened: two runs that share it were the same.
//!
//! - **Walk:** every event and every frame passes here once. **Invariant:** the number depends on their order.
//! - **Context:** the thread that steps the world.

use super::World;
use super::queue::What;
use crate::time::TrueTime;

impl World {
    /// A number that two runs share if, and but for chance only if, all their events and frames were the same.
    #[must_use]
    pub const fn digest(&self) -> u64 {
        self.digest
    }

    pub(super) fn digest_event(&mut self, at: TrueTime, what: What) {
        let (kind, detail) = match what {
            What::Arrive { flight } => (1, u64::from(flight)),
            What::Sent { node, gateway, .. } => (2, u64::from(node.0) << 8 | u64::from(gateway.get())),
            What::Job { node, .. } => (3, u64::from(node.0)),
            What::Wake { node } => (4, u64::from(node.0)),
            What::Faults { link, way } => (5, u64::from(link) << 8 | u64::from(way)),
            What::BusFree { bus } => (6, u64::from(bus)),
            What::BusFaults { bus } => (7, u64::from(bus)),
            What::Hear { bus } => (0, u64::from(bus)),
        };
        self.mix(at.steps());
        self.mix(detail << 3 | kind);
    }

    pub(super) fn digest_bytes(&mut self, bytes: &[u8]) {
        let (words, rest) = bytes.as_chunks::<8>();
        for word in words {
            self.mix(u64::from_le_bytes(*word));
        }
        let mut last = [0; 8];
        last[..rest.len()].copy_from_slice(rest);
        self.mix(u64::from_le_bytes(last));
    }

    /// One round of a multiply-and-rotate hash: quick, and good enough to tell two runs apart.
    const fn mix(&mut self, word: u64) {
        self.digest = (self.digest.rotate_left(23) ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }
}

//! The true time of whoever a node names as its root, also after that one has become unreachable or follows another.
//!
//! A root's time is a line over its counter, which goes on when the root itself has long taken another time: those who have not heard of it
//! yet follow the line that they were told of, and their bounds are about that.

use fixed_math::clock::TimeLine;
use fixed_math::time::NetTime;
use osap_protocol::discovery::UniqueId;
use osap_sim::device::SimDevice;
use osap_sim::machines::clocks::ClockTree;
use osap_sim::machines::unique_id;
use osap_sim::world::World;

/// What each node's time was when it was last a root.
pub(super) struct Reference {
    ids: Vec<UniqueId>,
    lines: Vec<Option<TimeLine>>,
}

impl Reference {
    /// Of a network in which nobody has been a root yet.
    pub(super) fn new(tree: &ClockTree) -> Self {
        let ids = tree.nodes.iter().map(|node| unique_id(node.at())).collect();
        Self { ids, lines: vec![None; tree.nodes.len()] }
    }

    /// Looks who is a root now.
    pub(super) fn note(&mut self, world: &World, tree: &ClockTree) {
        for (line, node) in self.lines.iter_mut().zip(&tree.nodes) {
            let Some(device) = world.endpoint::<SimDevice>(*node) else { continue };
            let clock = device.node().clock();
            if clock.tier() == 0 {
                *line = Some(clock.map().target());
            }
        }
    }

    /// The place of a node's root, and that one's time now.
    pub(super) fn of(&self, world: &World, tree: &ClockTree, place: usize) -> Option<(usize, NetTime)> {
        let root = world.endpoint::<SimDevice>(tree.nodes[place])?.node().clock().root().unique_id;
        let at = self.ids.iter().position(|id| *id == root)?;
        let local = world.exact(tree.nodes[at], world.now());
        self.lines[at].map(|line| (at, line.system_at(local)))
    }
}

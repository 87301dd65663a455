//! The stages that packets pass, in order: the walk that a reader of the code can follow by file name.
//!
//! - **Walk:** all of it. **Invariant:** stages inside a node come from the node's own debug ring, the others from the world; what is a
//!   link's own, announcements and time, is left out.
//! - **Context:** recorded where [`World::record_walk`](crate::world::World::record_walk) asks for it; nothing is kept otherwise.

use crate::time::TrueTime;
use crate::world::NodeId;
use osap_protocol::discovery::Stage;

/// A stage of a packet's walk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum WalkStage {
    /// An interrupt has the frame's last byte.
    Captured,
    /// The routing task takes the frame up.
    HandedOver,
    /// Unstuffed, check found right.
    Deframed,
    /// A stage inside the node.
    Node(Stage),
    /// The last byte has left.
    Sent,
}

impl WalkStage {
    /// Its name in texts.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Captured => "captured",
            Self::HandedOver => "handed-over",
            Self::Deframed => "deframed",
            Self::Node(Stage::Ingress) => "ingress",
            Self::Node(Stage::Route) => "route",
            Self::Node(Stage::Stack) => "stack",
            Self::Node(Stage::Egress) => "egress",
            Self::Node(Stage::Deliver) => "deliver",
            Self::Node(Stage::Reply) => "reply",
            Self::Sent => "sent",
        }
    }
}

/// One stage passed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct WalkEvent {
    /// When.
    pub at: TrueTime,
    /// Where.
    pub node: NodeId,
    /// Which stage.
    pub stage: WalkStage,
    /// The gateway or port concerned.
    pub index: u16,
}

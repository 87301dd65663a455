//! Kinds of device: what each calls itself and which services its ports lead to.
//!
//! - **Walk:** an image or a simulated machine names a kind; [`Device::new`](crate::Device::new) makes its ports.
//! - **Invariants:** a kind has at least a port for each entry, in their order, after the netresponder; each service stands once.
//! - **Clause:** `[APP-01]`.

use osap_protocol::PortIndex;
use osap_runtime::PortConfig;

/// What a port leads to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Service {
    /// Sends back what comes, `[APP-02]` to `[APP-04]`.
    Echo,
    /// Sends datagrams at an interval, `[APP-05]` to `[APP-09]`.
    Stream,
    /// Keeps the serving task busy, `[APP-10]`.
    Spin,
    /// Plays tracks, `[MOT-01]`.
    Motion,
}

impl Service {
    /// The name its port gives as type.
    #[must_use]
    pub const fn type_name(self) -> &'static str {
        match self {
            Self::Echo => "echo",
            Self::Stream => "stream",
            Self::Spin => "spin",
            Self::Motion => osap_protocol::motion::PORT_TYPE,
        }
    }
}

/// One port of a kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PortEntry {
    /// What it leads to.
    pub service: Service,
    /// Packets of its own that it may hold at once.
    pub packet_hold_max: u8,
}

impl PortEntry {
    /// As the runtime wants it.
    #[must_use]
    pub const fn config(self) -> PortConfig {
        PortConfig { type_name: self.service.type_name(), name: "", packet_hold_max: self.packet_hold_max }
    }
}

/// A kind of device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kind {
    /// What it calls itself.
    pub type_name: &'static str,
    /// Version of its application: major, minor, patch.
    pub version: [u8; 3],
    /// Its ports from port 1 on.
    pub ports: &'static [PortEntry],
}

impl Kind {
    /// The port that leads to `service`.
    #[must_use]
    pub fn port_of(&self, service: Service) -> Option<PortIndex> {
        let at = self.ports.iter().position(|port| port.service == service)?;
        PortIndex::new(u16::try_from(at + 1).ok()?)
    }
}

/// A whole window of segments, and a reply beside it.
const ECHO: PortEntry = PortEntry { service: Service::Echo, packet_hold_max: 5 };
/// As long as a stream's packets cannot leave, four wait; then new ones are shed.
const STREAM: PortEntry = PortEntry { service: Service::Stream, packet_hold_max: 4 };
/// One at a time is enough to keep a task busy.
const SPIN: PortEntry = PortEntry { service: Service::Spin, packet_hold_max: 1 };
/// A hub's slots are for the packets of others.
const STREAM_OF_HUB: PortEntry = PortEntry { packet_hold_max: 2, ..STREAM };

/// A message of points for each axis may wait, and questions beside them.
const MOTION: PortEntry = PortEntry { service: Service::Motion, packet_hold_max: 6 };

/// Forwards between many links.
pub const HUB: Kind = Kind { type_name: "hub", version: [0, 1, 0], ports: &[ECHO, STREAM_OF_HUB, SPIN] };
/// Drives a motor.
pub const MOTOR: Kind = Kind { type_name: "motor", version: [0, 2, 0], ports: &[ECHO, STREAM, SPIN, MOTION] };
/// Measures a force.
pub const LOAD_CELL: Kind = Kind { type_name: "loadcell", version: [0, 1, 0], ports: &[ECHO, STREAM, SPIN] };
/// Heats and measures a temperature.
pub const HEATER: Kind = Kind { type_name: "heater", version: [0, 1, 0], ports: &[ECHO, STREAM, SPIN] };
/// Takes pictures.
pub const CAMERA: Kind = Kind { type_name: "camera", version: [0, 1, 0], ports: &[ECHO, STREAM, SPIN] };
/// All of them.
pub const KINDS: [Kind; 5] = [HUB, MOTOR, LOAD_CELL, HEATER, CAMERA];

/// Most ports that one of them has, the netresponder's included.
pub const PORTS_MAX: usize = 5;

/// The same without their ports, for an image that is a node and nothing else.
pub const WITHOUT_PORTS: [Kind; KINDS.len()] = {
    let mut kinds = KINDS;
    let mut at = 0;
    while at < kinds.len() {
        kinds[at].ports = &[];
        at += 1;
    }
    kinds
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_ports_are_stated() {
        assert_eq!(KINDS.map(|kind| kind.ports.len() + 1).into_iter().max(), Some(PORTS_MAX));
    }

    /// `[APP-01]`: the ports stand where the specification says, and no service stands twice.
    #[test]
    fn every_kind_has_echo_stream_and_spin_on_ports_1_to_3_and_motors_motion_on_4() {
        assert_eq!(MOTOR.port_of(Service::Motion), PortIndex::new(4));
        for kind in KINDS {
            assert_eq!(kind.port_of(Service::Echo), PortIndex::new(1), "{}", kind.type_name);
            assert_eq!(kind.port_of(Service::Stream), PortIndex::new(2), "{}", kind.type_name);
            assert_eq!(kind.port_of(Service::Spin), PortIndex::new(3), "{}", kind.type_name);
            assert_eq!(kind.ports.len(), if kind.port_of(Service::Motion).is_some() { 4 } else { 3 });
        }
    }
}

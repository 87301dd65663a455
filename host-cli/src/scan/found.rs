//! What a scan knows while it runs.
//!
//! - **Walk:** a [`Candidate`] that answers becomes a [`Found`] and an [`Edge`]; one that does not, a [`Silence`].

use crate::core::PACKET_BYTES_MAX;
use crate::map::{Gateway, Port};
use crate::session::RouteBudget;
use osap_protocol::discovery::{LinkInfo, PortInfo, RuntimeInfo, UniqueId};
use osap_protocol::{PortIndex, RouteBuf, Step};
use osap_runtime::sequenced::Destination;

/// A way that may lead to a node.
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    /// From which device by which step; none for the host itself.
    pub(super) from: Option<(usize, Step)>,
    pub(super) route: RouteBuf,
    pub(super) mtu_bytes: u16,
    pub(super) budget: RouteBudget,
    pub(super) ttl_us: u16,
    /// Who is expected there.
    pub(super) neighbour: Option<UniqueId>,
    /// Whether somebody announced himself there, or answered a broadcast. Else one try must do.
    pub(super) is_certain: bool,
}

impl Candidate {
    pub(super) fn host() -> Self {
        Self {
            from: None,
            route: RouteBuf::new(),
            mtu_bytes: u16::try_from(PACKET_BYTES_MAX).unwrap_or(u16::MAX),
            budget: RouteBudget::default(),
            ttl_us: crate::session::TTL_DEFAULT_US,
            neighbour: None,
            is_certain: true,
        }
    }

    pub(super) fn destination(&self) -> Destination {
        let Self { route, mtu_bytes, ttl_us, .. } = self;
        Destination { route: route.clone(), mtu_bytes: *mtu_bytes, ttl_us: *ttl_us, port: PortIndex::NETRESPONDER }
    }
}

/// A node that answered.
#[derive(Clone, Debug)]
pub(super) struct Found {
    pub(super) info: RuntimeInfo,
    pub(super) name: Option<String>,
    pub(super) type_name: Option<String>,
    /// By index; `None` where there was no answer.
    pub(super) links: Vec<Option<LinkInfo>>,
    pub(super) ports: Vec<Option<PortInfo>>,
    /// The first way that was found, with all that was known of it.
    pub(super) way: Candidate,
    pub(super) restarts: u32,
    /// Restarted, as another way to it showed: to be read again.
    pub(super) is_stale: bool,
    /// Its neighbours changed: to be told.
    pub(super) has_changed: bool,
    pub(super) fell_silent: bool,
}

impl Found {
    pub(super) fn new(info: RuntimeInfo, way: Candidate) -> Self {
        Self {
            info,
            name: None,
            type_name: None,
            links: Vec::new(),
            ports: Vec::new(),
            // whoever answered once is worth all tries from then on
            way: Candidate { is_certain: true, ..way },
            restarts: 0,
            is_stale: false,
            has_changed: false,
            fell_silent: false,
        }
    }

    /// Takes what a device says now that restarted or has other neighbours, `[DSC-09]`. What it said before stays until it is read
    /// anew: over a link with losses, old words are better than none.
    pub(super) fn renew(&mut self, info: RuntimeInfo) {
        self.info = info;
        self.is_stale = false;
    }

    /// Forgets what was said there: another device stands in its place.
    pub(super) fn forget(&mut self, info: RuntimeInfo) {
        *self = Self { restarts: self.restarts, has_changed: self.has_changed, ..Self::new(info, self.way.clone()) };
    }

    pub(super) fn depth(&self) -> usize {
        self.way.route.as_route().steps().count()
    }

    /// What it did not tell.
    pub(super) fn missing(&self, with_ports: bool) -> Vec<String> {
        let mut missing = Vec::new();
        missing.extend(self.type_name.is_none().then(|| "type name".to_owned()));
        missing.extend(self.name.is_none().then(|| "name".to_owned()));
        let gaps = |list: Vec<bool>, what: &str| -> Vec<String> {
            list.iter().enumerate().filter(|(_, gap)| **gap).map(|(index, _)| format!("{what} {index}")).collect()
        };
        missing.extend(gaps(self.links.iter().map(Option::is_none).collect(), "link"));
        if with_ports {
            missing.extend(gaps(self.ports.iter().map(Option::is_none).collect(), "port"));
        }
        missing
    }
}

/// A step that was taken from one device to another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Edge {
    pub(super) from: usize,
    pub(super) step: Step,
    pub(super) to: usize,
}

/// A way that gave no answer.
#[derive(Clone, Debug)]
pub(super) struct Silence {
    pub(super) device: usize,
    pub(super) gateway: u8,
    pub(super) neighbour: Option<UniqueId>,
    pub(super) tries: u8,
}

/// A link's answer as the map has it.
pub(super) fn gateway(index: usize, info: &LinkInfo) -> Gateway {
    Gateway {
        index: u8::try_from(index).unwrap_or(u8::MAX),
        type_name: info.type_name.as_str().to_owned(),
        kind: info.kind,
        open: info.open,
        mtu_bytes: info.mtu_bytes,
        bit_rate: info.bit_rate,
        bits_a_byte: info.bits_a_byte,
        check: info.check,
        packet_hold_max: info.packet_hold_max,
        received: info.received,
        sent: info.sent,
        dropped: info.dropped,
        neighbour: info.neighbour.map(|neighbour| neighbour.unique_id),
        leads_to: None,
    }
}

/// A port's answer as the map has it.
pub(super) fn port(index: usize, info: &PortInfo) -> Port {
    Port {
        index: u16::try_from(index).unwrap_or(u16::MAX),
        type_name: info.type_name.as_str().to_owned(),
        name: info.name.as_str().to_owned(),
        packet_hold_max: info.packet_hold_max,
        received: info.received,
        sent: info.sent,
    }
}

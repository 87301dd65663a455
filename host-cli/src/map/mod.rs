//! The map of a network: devices, links between them, ways to reach them, and what was odd.
//!
//! - **Walk:** `scan` makes a map → JSON, a tree or DOT for people; names and routes for everything that asks devices.
//! - **Invariants:** `devices[0]` is the host. Devices stand in order of their first route, so the same network gives the same map
//!   however the answers came in. Every index in a map is of that map.
//! - **Context:** plain data. The JSON form is versioned: [`SCHEMA`].
//! - **Clauses:** `[DSC-04]` several paths and doubled ids, `[DSC-08]` first path, `[DSC-09]` restarts.

mod diff;
mod dot;
mod finding;
mod resolve;
mod route_text;
mod tree;

pub use diff::{Change, diff};
pub use finding::Finding;
pub use resolve::{Candidate, ResolveError};
pub(crate) use route_text::step_text;
pub use route_text::{RouteText, RouteTextError};

use osap_protocol::discovery::{BuildKind, GatewayKind, UniqueId};
use osap_protocol::framing::Check;
use serde::{Deserialize, Serialize};

/// Name and version of the JSON form.
pub const SCHEMA: &str = "osap.map/1";
/// Routes kept for one device; a well-connected network has more than anybody wants to read.
pub const ROUTES_MAX: usize = 8;

/// A network as one host saw it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NetworkMap {
    /// [`SCHEMA`].
    pub schema: String,
    /// The host, then all that answered, by first route.
    pub devices: Vec<Device>,
    /// Point-to-point links between them.
    pub links: Vec<LinkEdge>,
    /// Buses and who is on them.
    pub buses: Vec<Bus>,
    /// Open gateways behind which somebody is, or may be, who did not answer.
    pub silent: Vec<SilentPlace>,
    /// What was odd.
    pub findings: Vec<Finding>,
}

/// A device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Device {
    /// Which one, from its silicon.
    #[serde(with = "hex_id")]
    pub unique_id: UniqueId,
    /// What it is called; empty where it did not say.
    pub name: String,
    /// What kind it is.
    pub type_name: String,
    /// Another number after each boot.
    pub boot_epoch: u32,
    /// Version of its runtime: major, minor, patch.
    pub version: [u8; 3],
    /// What it was built for.
    pub build: BuildKind,
    /// Time since its boot, µs.
    pub uptime_us: u64,
    /// Largest packet it holds, bytes.
    pub packet_bytes_max: u16,
    /// Packets it holds at once.
    pub slots: u16,
    /// Goes up with every neighbour that comes or goes.
    pub topology_generation: u32,
    /// Its links and buses, by index.
    pub gateways: Vec<Gateway>,
    /// Its ports, by index.
    pub ports: Vec<Port>,
    /// Ways to it, shortest first; at most [`ROUTES_MAX`].
    pub routes: Vec<MapRoute>,
}

/// A way to a device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MapRoute {
    /// The steps.
    pub route: RouteText,
    /// Smallest packet size of the links on it, bytes.
    pub mtu_bytes: u16,
}

/// A device's end of a link or bus.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Gateway {
    /// Its index in the device.
    pub index: u8,
    /// Kind of hardware, such as `uart`.
    pub type_name: String,
    /// Link or bus.
    pub kind: GatewayKind,
    /// Whether it can carry packets.
    pub open: bool,
    /// Largest packet, bytes.
    pub mtu_bytes: u16,
    /// Bits a second; 0 where unknown.
    pub bit_rate: u32,
    /// Bits each byte takes.
    pub bits_a_byte: u8,
    /// Guard of its frames.
    pub check: Check,
    /// Packets it may hold at once.
    pub packet_hold_max: u8,
    /// Packets received.
    pub received: u32,
    /// Packets sent.
    pub sent: u32,
    /// Packets and frames dropped that came in here.
    pub dropped: u32,
    /// Who announced itself here last.
    #[serde(with = "hex_id::option")]
    pub neighbour: Option<UniqueId>,
    /// What the scan found behind it.
    pub leads_to: Option<LeadsTo>,
}

/// What is behind a gateway.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum LeadsTo {
    /// A device.
    Device {
        /// Which.
        device: usize,
        /// By which of its gateways, where that is known.
        gateway: Option<u8>,
    },
    /// A bus.
    Bus {
        /// Which.
        bus: usize,
    },
    /// Somebody who did not answer.
    Silent {
        /// Which silent place.
        silent: usize,
    },
}

/// A port of a device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Port {
    /// Its index in the device.
    pub index: u16,
    /// What software it leads to.
    pub type_name: String,
    /// What it is called; often empty.
    pub name: String,
    /// Packets it may hold at once.
    pub packet_hold_max: u8,
    /// Packets delivered to it.
    pub received: u32,
    /// Packets it sent.
    pub sent: u32,
}

/// One end of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct LinkEnd {
    /// The device.
    pub device: usize,
    /// Its gateway, where that is known.
    pub gateway: Option<u8>,
}

/// A point-to-point link between two devices.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct LinkEdge {
    /// The end nearer to the host.
    pub near: LinkEnd,
    /// The other end.
    pub far: LinkEnd,
    /// Whether the first route to `far` uses it; else it closes a loop.
    pub in_tree: bool,
}

/// A bus.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bus {
    /// Who is on it, by drop.
    pub members: Vec<BusMember>,
}

/// A device on a bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct BusMember {
    /// Its address there.
    pub drop: u8,
    /// The device.
    pub device: usize,
    /// Its gateway, where that is known.
    pub gateway: Option<u8>,
}

/// A gateway behind which somebody is, or may be, who did not answer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SilentPlace {
    /// The device this side of it.
    pub device: usize,
    /// Its gateway.
    pub gateway: u8,
    /// Who announced itself there; unknown on a bus.
    #[serde(with = "hex_id::option")]
    pub neighbour: Option<UniqueId>,
    /// The way that gave no answer.
    pub route: RouteText,
    /// How often it was asked.
    pub tries: u8,
}

impl NetworkMap {
    /// The host.
    ///
    /// # Panics
    /// Where a map was read from elsewhere and has no devices; [`NetworkMap::from_json`] refuses such.
    #[must_use]
    pub fn root(&self) -> &Device {
        &self.devices[0]
    }

    /// Reads the JSON form.
    ///
    /// # Errors
    /// [`MapError`] where it is no map of this version, or one whose indices lead out of it.
    pub fn from_json(text: &str) -> Result<Self, MapError> {
        let map: Self = serde_json::from_str(text).map_err(|error| MapError::Json(error.to_string()))?;
        if map.schema != SCHEMA {
            return Err(MapError::Schema { found: map.schema });
        }
        if map.is_closed() { Ok(map) } else { Err(MapError::Index) }
    }

    /// The JSON form.
    #[must_use]
    pub fn to_json(&self) -> String {
        // strings, numbers and lists only: there is nothing that could fail
        serde_json::to_string_pretty(self).unwrap_or_default()
    }

    /// Who is at the end of a route: the device and the gateways used on the way, by following `leads_to`.
    #[must_use]
    pub fn follow(&self, route: &RouteText) -> Option<(usize, Vec<&Gateway>)> {
        let (mut at, mut used) = (0, Vec::new());
        for step in route.as_route().steps() {
            let index = step.gateway().get();
            let gateway = self.devices.get(at)?.gateways.iter().find(|gateway| gateway.index == index)?;
            used.push(gateway);
            at = match (gateway.leads_to?, step) {
                (LeadsTo::Device { device, .. }, osap_protocol::Step::Link(_)) => device,
                (LeadsTo::Bus { bus }, osap_protocol::Step::Bus { drop, .. }) => {
                    self.buses.get(bus)?.members.iter().find(|member| member.drop == drop.0)?.device
                }
                _ => return None,
            };
        }
        Some((at, used))
    }

    /// Whether there is a host and every index is of something there is.
    fn is_closed(&self) -> bool {
        let has = |device: usize| device < self.devices.len();
        let leads = |gateway: &Gateway| match gateway.leads_to {
            Some(LeadsTo::Device { device, .. }) => has(device),
            Some(LeadsTo::Bus { bus }) => bus < self.buses.len(),
            Some(LeadsTo::Silent { silent }) => silent < self.silent.len(),
            None => true,
        };
        has(0)
            && self.devices.iter().all(|device| !device.routes.is_empty() && device.gateways.iter().all(leads))
            && self.links.iter().all(|link| has(link.near.device) && has(link.far.device))
            && self.buses.iter().flat_map(|bus| &bus.members).all(|member| has(member.device))
            && self.silent.iter().all(|place| has(place.device))
            && self.findings.iter().flat_map(Finding::devices).all(has)
    }
}

impl Device {
    /// The first and shortest way to it.
    ///
    /// # Panics
    /// Where a device was made by hand without any.
    #[must_use]
    pub fn route(&self) -> &RouteText {
        &self.routes[0].route
    }

    /// Its name, or its type and the tail of its id where it has none.
    #[must_use]
    pub fn label(&self) -> String {
        if self.name.is_empty() {
            let kind = if self.type_name.is_empty() { "device" } else { &self.type_name };
            format!("{kind}-{}", &self.unique_id.to_string()[16..])
        } else {
            self.name.clone()
        }
    }
}

/// Head and tail of an id, since makers count in either: enough to tell devices apart by eye.
pub(crate) fn short_id(id: UniqueId) -> String {
    let digits = id.to_string();
    format!("{}…{}", &digits[..4], &digits[20..])
}

/// Why a text is no map.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MapError {
    /// It is not JSON of the right shape.
    #[error("this is no map: {0}. Make one with `osap map --save FILE`")]
    Json(String),
    /// Another version.
    #[error("the map is of schema {found}, this program reads {SCHEMA}: scan again")]
    Schema {
        /// As found.
        found: String,
    },
    /// An index out of range.
    #[error("the map names devices that are not in it: it was edited or cut; scan again")]
    Index,
}

/// Unique ids as 24 hexadecimal digits.
mod hex_id {
    use osap_protocol::discovery::UniqueId;
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    pub(super) fn serialize<S: Serializer>(id: &UniqueId, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(id)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<UniqueId, D::Error> {
        let text = String::deserialize(deserializer)?;
        parse(&text).ok_or_else(|| D::Error::custom(format!("{text} is not 24 hexadecimal digits")))
    }

    fn parse(text: &str) -> Option<UniqueId> {
        let mut id = [0; 12];
        if text.len() != 2 * id.len() || !text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return None;
        }
        for (byte, digits) in id.iter_mut().zip(text.as_bytes().chunks(2)) {
            *byte = u8::from_str_radix(std::str::from_utf8(digits).ok()?, 16).ok()?;
        }
        Some(UniqueId(id))
    }

    /// As above, where there may be none.
    pub(super) mod option {
        use super::{Deserialize, Deserializer, Error, Serializer, UniqueId, parse};

        #[expect(clippy::ref_option, reason = "the shape that serde calls")]
        pub(in super::super) fn serialize<S: Serializer>(
            id: &Option<UniqueId>,
            serializer: S,
        ) -> Result<S::Ok, S::Error> {
            match id {
                Some(id) => serializer.collect_str(id),
                None => serializer.serialize_none(),
            }
        }

        pub(in super::super) fn deserialize<'de, D: Deserializer<'de>>(
            deserializer: D,
        ) -> Result<Option<UniqueId>, D::Error> {
            let wrong = |text: &str| D::Error::custom(format!("{text} is not 24 hexadecimal digits"));
            let text = Option::<String>::deserialize(deserializer)?;
            text.map(|text| parse(&text).ok_or_else(|| wrong(&text))).transpose()
        }
    }
}

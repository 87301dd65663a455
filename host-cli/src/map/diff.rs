//! What became different between two maps of one machine.
//!
//! - **Walk:** a map kept from before and one of now → [`diff`] → people.
//! - **Invariants:** equal maps have no differences; the order is that of the devices concerned. The host is the same place in
//!   both whatever its id, since that differs from run to run.
//! - **Context:** plain data, O(n log n).
//!
//! A device is known by its unique id. Where it is plugged in is known by its neighbour's id and gateway: a whole branch that moves is
//! one move, that of the device it hangs on.

use super::{Device, LeadsTo, NetworkMap, RouteText, short_id};
use osap_protocol::Step;
use osap_protocol::discovery::UniqueId;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::{self, Display, Formatter};

/// One difference.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Change {
    /// A device that was not there.
    Appeared {
        /// Its name.
        device: String,
        /// The way to it.
        route: RouteText,
    },
    /// A device that is not there any more.
    Lost {
        /// Its name.
        device: String,
        /// The way there was.
        route: RouteText,
    },
    /// Another device stands where one was.
    Swapped {
        /// The place.
        route: RouteText,
        /// Who was there.
        before: String,
        /// Who is there.
        after: String,
    },
    /// A device was plugged in elsewhere.
    Moved {
        /// Its name.
        device: String,
        /// The way there was.
        before: RouteText,
        /// The way there is.
        after: RouteText,
    },
    /// A device has booted since.
    Rebooted {
        /// Its name.
        device: String,
        /// The way to it.
        route: RouteText,
    },
    /// A device has another name.
    Renamed {
        /// The way to it.
        route: RouteText,
        /// What it was called.
        before: String,
        /// What it is called.
        after: String,
    },
    /// A link between two devices that both were there.
    LinkAdded {
        /// Its ends, as `name:gateway`.
        ends: [String; 2],
    },
    /// A link is gone between two devices that both are there.
    LinkRemoved {
        /// Its ends, as `name:gateway`.
        ends: [String; 2],
    },
}

impl Display for Change {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Appeared { device, route } => write!(f, "appeared: {device} at {route}"),
            Self::Lost { device, route } => write!(f, "lost: {device}, which was at {route}"),
            Self::Swapped { route, before, after } => {
                write!(f, "swapped: {after} stands at {route}, where {before} was")
            }
            Self::Moved { device, before, after } => write!(f, "moved: {device} from {before} to {after}"),
            Self::Rebooted { device, route } => write!(f, "rebooted: {device} at {route}"),
            Self::Renamed { route, before, after } => write!(f, "renamed: {before} is {after} now, at {route}"),
            Self::LinkAdded { ends: [one, other] } => write!(f, "link added: {one} to {other}"),
            Self::LinkRemoved { ends: [one, other] } => write!(f, "link removed: {one} to {other}"),
        }
    }
}

/// What is different in `new`.
#[must_use]
pub fn diff(old: &NetworkMap, new: &NetworkMap) -> Vec<Change> {
    let (old, new) = (Keyed::new(old), Keyed::new(new));
    let mut changes = Vec::new();
    let mut swapped_in = BTreeSet::new();
    for (key, before) in old.others() {
        if let Some(after) = new.devices.get(key) {
            compare(&old, &new, key, (before, after), &mut changes);
            continue;
        }
        let places = old.places_of(key);
        let successor = new.others().find(|(other, _)| {
            !old.devices.contains_key(*other)
                && !swapped_in.contains(*other)
                && !new.places_of(other).is_disjoint(&places)
        });
        changes.push(match successor {
            Some((other, after)) => {
                swapped_in.insert(*other);
                let (before, after_id) = (told(before), told(after));
                Change::Swapped { route: after.route().clone(), before, after: after_id }
            }
            None => Change::Lost { device: before.label(), route: before.route().clone() },
        });
    }
    for (key, after) in new.others() {
        if !old.devices.contains_key(key) && !swapped_in.contains(key) {
            changes.push(Change::Appeared { device: after.label(), route: after.route().clone() });
        }
    }
    compare_links(&old, &new, &mut changes);
    changes
}

/// Name and head of the id, for two that may have one name.
fn told(device: &Device) -> String {
    format!("{} ({})", device.label(), short_id(device.unique_id))
}

fn compare(old: &Keyed, new: &Keyed, key: &Key, (before, after): (&Device, &Device), changes: &mut Vec<Change>) {
    let (was, is) = (old.places_of(key), new.places_of(key));
    // by the same way it is reached past somebody who was swapped, but stands where it stood
    if !was.is_empty() && was.is_disjoint(&is) && before.route() != after.route() {
        let (before, to) = (before.route().clone(), after.route().clone());
        changes.push(Change::Moved { device: after.label(), before, after: to });
    }
    if before.boot_epoch != after.boot_epoch {
        changes.push(Change::Rebooted { device: after.label(), route: after.route().clone() });
    }
    // whoever did not tell its name has not given it up
    if before.name != after.name && !before.name.is_empty() && !after.name.is_empty() {
        let (route, name) = (after.route().clone(), before.name.clone());
        changes.push(Change::Renamed { route, before: name, after: after.name.clone() });
    }
}

fn compare_links(old: &Keyed, new: &Keyed, changes: &mut Vec<Change>) {
    let both =
        |link: &LinkKey| link.iter().all(|(key, _)| old.devices.contains_key(key) && new.devices.contains_key(key));
    let ends = |map: &Keyed, link: &LinkKey| {
        link.map(|(key, gateway)| {
            let label = map.devices.get(&key).map_or_else(String::new, |device| device.label());
            gateway.map_or_else(|| label.clone(), |gateway| format!("{label}:{gateway}"))
        })
    };
    for link in old.links.difference(&new.links).filter(|link| both(link)) {
        changes.push(Change::LinkRemoved { ends: ends(old, link) });
    }
    for link in new.links.difference(&old.links).filter(|link| both(link)) {
        changes.push(Change::LinkAdded { ends: ends(new, link) });
    }
}

/// A device in both maps: its unique id, and which of several that carry it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Key {
    Host,
    Device(UniqueId, usize),
}

/// Two ends, the smaller first.
type LinkKey = [(Key, Option<u8>); 2];

/// Where a device is plugged in: by whom, and at which step from there.
type Place = (Key, Step);

/// A map by what stays the same from scan to scan.
struct Keyed<'a> {
    devices: BTreeMap<Key, &'a Device>,
    order: Vec<Key>,
    places: BTreeMap<Key, BTreeSet<Place>>,
    links: BTreeSet<LinkKey>,
}

impl<'a> Keyed<'a> {
    fn new(map: &'a NetworkMap) -> Self {
        let mut seen: BTreeMap<UniqueId, usize> = BTreeMap::new();
        let mut order = Vec::new();
        for (index, device) in map.devices.iter().enumerate() {
            let count = seen.entry(device.unique_id).or_default();
            order.push(if index == 0 { Key::Host } else { Key::Device(device.unique_id, *count) });
            *count += usize::from(index > 0);
        }
        let devices = order.iter().copied().zip(&map.devices).collect();
        let link = |link: &super::LinkEdge| {
            let mut ends = [link.near, link.far].map(|end| (order[end.device], end.gateway));
            ends.sort_unstable();
            ends
        };
        let links = map.links.iter().map(link).collect();
        let places = places(map, &order);
        Self { devices, order, places, links }
    }

    fn others(&self) -> impl Iterator<Item = (&Key, &'a Device)> {
        self.order.iter().filter(|key| **key != Key::Host).filter_map(|key| Some((key, *self.devices.get(key)?)))
    }

    fn places_of(&self, key: &Key) -> BTreeSet<Place> {
        self.places.get(key).cloned().unwrap_or_default()
    }
}

/// Every gateway that leads to a device, by the device.
fn places(map: &NetworkMap, order: &[Key]) -> BTreeMap<Key, BTreeSet<Place>> {
    let mut places: BTreeMap<Key, BTreeSet<Place>> = BTreeMap::new();
    for (key, device) in order.iter().zip(&map.devices) {
        for gateway in &device.gateways {
            let Some(index) = osap_protocol::GatewayIndex::new(gateway.index) else { continue };
            match gateway.leads_to {
                Some(LeadsTo::Device { device, .. }) => {
                    places.entry(order[device]).or_default().insert((*key, Step::Link(index)));
                }
                Some(LeadsTo::Bus { bus }) => {
                    for member in map.buses.get(bus).iter().flat_map(|bus| &bus.members) {
                        let drop = osap_protocol::BusDrop(member.drop);
                        places
                            .entry(order[member.device])
                            .or_default()
                            .insert((*key, Step::Bus { gateway: index, drop }));
                    }
                }
                Some(LeadsTo::Silent { .. }) | None => {}
            }
        }
    }
    places
}

//! Makes the map of what a scan found.
//!
//! - **Walk:** devices in order of their first routes → links and buses between them → further routes → packet sizes → findings.
//! - **Invariant:** the same answers give the same map, in whatever order they came. **Clauses:** `[DSC-04]`, `[PKT-12]`.

use super::Scanner;
use super::found::{Edge, Found, Silence, gateway, port};
use crate::map::{
    Bus, BusMember, Device, Finding, LeadsTo, LinkEdge, LinkEnd, MapRoute, NetworkMap, ROUTES_MAX, RouteText, SCHEMA,
    SilentPlace,
};
use osap_protocol::discovery::{GatewayKind, UniqueId};
use osap_protocol::{GatewayIndex, RouteBuf, Step};
use std::collections::{BTreeMap, BTreeSet};

impl Scanner<'_> {
    /// The map; the scan is over.
    pub(super) fn assemble(mut self) -> NetworkMap {
        let mut findings = std::mem::take(&mut self.findings);
        findings.extend(self.device_findings());
        let mut map = loop {
            let new = self.renumber();
            findings = findings.into_iter().map(|finding| finding.renumbered(&new)).collect();
            let mut map = NetworkMap {
                schema: SCHEMA.to_owned(),
                devices: self.found.iter().map(device).collect(),
                links: self.link_edges(),
                buses: self.bus_members(),
                silent: self.silent_places(),
                findings: Vec::new(),
            };
            lead(&mut map, &self.buses.iter().map(|bus| (bus.device, bus.gateway.get())).collect::<Vec<_>>());
            self.add_routes(&mut map);
            if !self.shorten_ways(&map) {
                break map;
            }
        };
        map.findings.extend(findings);
        size_routes(&mut map);
        map.findings.extend(packet_sizes(&map));
        map.findings.extend(doubles(&map));
        map.findings.sort();
        map.findings.dedup();
        map
    }

    fn device_findings(&self) -> Vec<Finding> {
        let mut findings = Vec::new();
        for (device, found) in self.found.iter().enumerate() {
            if found.restarts > 0 {
                findings.push(Finding::Restarted { device, times: found.restarts });
            }
            if found.has_changed {
                findings.push(Finding::Changed { device });
            }
            if found.fell_silent {
                findings.push(Finding::FellSilent { device });
            }
            let missing = found.missing(self.options.ports);
            if !missing.is_empty() {
                findings.push(Finding::Incomplete { device, missing });
            }
        }
        findings
    }

    /// Where answers were lost a device may have been found by a longer way than there is: its first way becomes the least of its routes. Whether
    /// any did. Ways get less each time, so that this comes to an end.
    fn shorten_ways(&mut self, map: &NetworkMap) -> bool {
        let mut has_changed = false;
        for (found, device) in self.found.iter_mut().zip(&map.devices) {
            let least = device.route().to_buf();
            has_changed |= found.way.route != least;
            found.way.route = least;
        }
        has_changed
    }

    /// Puts devices in order of their first routes; returns the new number of each old one.
    fn renumber(&mut self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.found.len()).collect();
        order.sort_by_key(|device| RouteText::from(self.found[*device].way.route.clone()));
        let mut new = vec![0; order.len()];
        for (place, device) in order.iter().enumerate() {
            new[*device] = place;
        }
        self.found = order.iter().map(|device| self.found[*device].clone()).collect();
        for edge in &mut self.edges {
            *edge = Edge { from: new[edge.from], to: new[edge.to], ..*edge };
        }
        self.edges.sort_unstable();
        for bus in &mut self.buses {
            bus.device = new[bus.device];
        }
        self.buses.sort_by_key(|bus| (bus.device, bus.gateway));
        for silence in self.silent.values_mut() {
            silence.device = new[silence.device];
        }
        new
    }

    fn silent_places(&self) -> Vec<SilentPlace> {
        let mut places: Vec<SilentPlace> = self
            .silent
            .iter()
            .map(|(route, Silence { device, gateway, neighbour, tries })| SilentPlace {
                device: *device,
                gateway: *gateway,
                neighbour: *neighbour,
                route: RouteText::from(route.clone()),
                tries: *tries,
            })
            .collect();
        places.sort_by(|a, b| a.route.cmp(&b.route));
        places
    }

    /// Links that were followed, each once, with the gateway at the far end where it is known.
    fn link_edges(&self) -> Vec<LinkEdge> {
        let mut links = BTreeMap::new();
        for edge in &self.edges {
            let Step::Link(gateway) = edge.step else { continue };
            let near = LinkEnd { device: edge.from, gateway: Some(gateway.get()) };
            let far = LinkEnd { device: edge.to, gateway: self.far_gateway(edge, gateway) };
            let in_tree = self.is_first_way(edge);
            // followed from both ends, it is one link: known from the end nearer to the host
            let both = (near.min(far), near.max(far));
            let known = links.entry(both).or_insert(LinkEdge { near, far, in_tree });
            if in_tree || (!known.in_tree && near < known.near) {
                *known = LinkEdge { near, far, in_tree };
            }
        }
        let mut links: Vec<LinkEdge> = links.into_values().collect();
        links.sort();
        links
    }

    /// The far end's own index for a link: as it announced itself, else as it knows its neighbour.
    fn far_gateway(&self, edge: &Edge, near: GatewayIndex) -> Option<u8> {
        let (from, to) = (&self.found[edge.from], &self.found[edge.to]);
        let announced = from.links.get(near.at()).and_then(Option::as_ref).and_then(|info| info.neighbour);
        if let Some(neighbour) = announced.filter(|neighbour| neighbour.unique_id == to.info.unique_id) {
            return Some(neighbour.gateway);
        }
        let is_back = |neighbour: &osap_protocol::discovery::Neighbour| {
            neighbour.unique_id == from.info.unique_id && neighbour.gateway == near.get()
        };
        let back = to
            .links
            .iter()
            .position(|info| info.as_ref().and_then(|info| info.neighbour).is_some_and(|it| is_back(&it)));
        back.and_then(|index| u8::try_from(index).ok())
    }

    fn is_first_way(&self, edge: &Edge) -> bool {
        let way = self.found[edge.from].way.route.with(edge.step);
        way.is_ok_and(|route| route == self.found[edge.to].way.route)
    }

    fn bus_members(&self) -> Vec<Bus> {
        let on_bus = |bus: &super::buses::FoundBus| {
            let own = BusMember { drop: bus.own_drop, device: bus.device, gateway: Some(bus.gateway.get()) };
            let others = self.edges.iter().filter_map(|edge| match edge.step {
                Step::Bus { gateway, drop } if (edge.from, gateway) == (bus.device, bus.gateway) => {
                    let gateway = self.bus_gateway(edge.to, drop.0);
                    Some(BusMember { drop: drop.0, device: edge.to, gateway })
                }
                _ => None,
            });
            let members: BTreeSet<BusMember> = std::iter::once(own).chain(others).collect();
            Bus { members: members.into_iter().collect() }
        };
        self.buses.iter().map(on_bus).collect()
    }

    /// The only gateway by which a device has this address.
    fn bus_gateway(&self, device: usize, drop: u8) -> Option<u8> {
        let links = self.links_of(device);
        let mut same = links.iter().filter(|(_, info)| info.kind == GatewayKind::Bus { drop });
        match (same.next(), same.next()) {
            (Some((index, _)), None) => Some(index.get()),
            _ => None,
        }
    }

    /// First routes, and one more for each end of each link that is in none of them; steps over buses likewise.
    fn add_routes(&self, map: &mut NetworkMap) {
        let first: Vec<RouteBuf> = self.found.iter().map(|found| found.way.route.clone()).collect();
        let mut routes: Vec<BTreeSet<RouteText>> =
            first.iter().map(|route| BTreeSet::from([RouteText::from(route.clone())])).collect();
        let mut add = |from: usize, step: Step, to: usize| {
            // not through the device itself
            let passes = !first[to].as_route().bytes().is_empty() && starts_with(&first[from], &first[to]);
            if to != 0
                && !passes
                && let Ok(route) = first[from].with(step)
            {
                routes[to].insert(route.into());
            }
        };
        for edge in &self.edges {
            add(edge.from, edge.step, edge.to);
        }
        for link in map.links.iter().filter(|link| !link.in_tree) {
            if let Some(gateway) = link.far.gateway.and_then(GatewayIndex::new) {
                add(link.far.device, Step::Link(gateway), link.near.device);
            }
        }
        for (device, routes) in map.devices.iter_mut().zip(routes) {
            let way = |route| MapRoute { route, mtu_bytes: 0 };
            device.routes = routes.into_iter().take(ROUTES_MAX).map(way).collect();
        }
    }
}

/// Whether `route` begins with all steps of `head`.
fn starts_with(route: &RouteBuf, head: &RouteBuf) -> bool {
    let mut steps = route.as_route().steps();
    head.as_route().steps().all(|step| steps.next() == Some(step))
}

fn device(found: &Found) -> Device {
    let info = &found.info;
    let links = found.links.iter().enumerate();
    let ports = found.ports.iter().enumerate();
    Device {
        unique_id: info.unique_id,
        name: found.name.clone().unwrap_or_default(),
        type_name: found.type_name.clone().unwrap_or_default(),
        boot_epoch: info.boot_epoch,
        version: info.version,
        build: info.build,
        uptime_us: info.uptime_us,
        packet_bytes_max: info.packet_bytes_max,
        slots: info.slots,
        topology_generation: info.topology_generation,
        gateways: links.filter_map(|(index, info)| Some(gateway(index, info.as_ref()?))).collect(),
        ports: ports.filter_map(|(index, info)| Some(port(index, info.as_ref()?))).collect(),
        routes: Vec::new(),
    }
}

/// Writes into each gateway what is behind it.
fn lead(map: &mut NetworkMap, asked: &[(usize, u8)]) {
    let mut leads: BTreeMap<(usize, u8), LeadsTo> = BTreeMap::new();
    for (silent, place) in map.silent.iter().enumerate() {
        leads.insert((place.device, place.gateway), LeadsTo::Silent { silent });
    }
    for link in &map.links {
        for (here, there) in [(link.near, link.far), (link.far, link.near)] {
            if let Some(gateway) = here.gateway {
                leads.insert((here.device, gateway), LeadsTo::Device { device: there.device, gateway: there.gateway });
            }
        }
    }
    for (bus, (it, asked)) in map.buses.iter().zip(asked).enumerate() {
        leads.insert(*asked, LeadsTo::Bus { bus });
        for member in &it.members {
            if let Some(gateway) = member.gateway {
                leads.insert((member.device, gateway), LeadsTo::Bus { bus });
            }
        }
    }
    for (index, device) in map.devices.iter_mut().enumerate() {
        for gateway in &mut device.gateways {
            gateway.leads_to = leads.get(&(index, gateway.index)).copied();
        }
    }
}

/// Gives each route the smallest packet size of its links, at both of their ends, `[PKT-12]`.
fn size_routes(map: &mut NetworkMap) {
    let sizes: Vec<Vec<u16>> = map
        .devices
        .iter()
        .map(|device| device.routes.iter().map(|way| size(map, device, &way.route)).collect())
        .collect();
    for (device, sizes) in map.devices.iter_mut().zip(sizes) {
        for (way, size) in device.routes.iter_mut().zip(sizes) {
            way.mtu_bytes = size;
        }
    }
}

fn size(map: &NetworkMap, device: &Device, route: &RouteText) -> u16 {
    let ends = map.follow(route).map(|(_, used)| used).unwrap_or_default();
    let far = |leads: &Option<LeadsTo>| match leads {
        Some(LeadsTo::Device { device, gateway: Some(gateway) }) => {
            map.devices[*device].gateways.iter().find(|it| it.index == *gateway).map(|it| it.mtu_bytes)
        }
        _ => None,
    };
    let sizes = ends.iter().flat_map(|gateway| [Some(gateway.mtu_bytes), far(&gateway.leads_to)]).flatten();
    sizes.min().unwrap_or(u16::MAX).min(map.root().packet_bytes_max).min(device.packet_bytes_max)
}

/// Links whose ends take packets of different sizes.
fn packet_sizes(map: &NetworkMap) -> Vec<Finding> {
    let size = |end: LinkEnd| {
        let gateways = &map.devices[end.device].gateways;
        gateways.iter().find(|gateway| Some(gateway.index) == end.gateway).map(|gateway| gateway.mtu_bytes)
    };
    // the host takes more than any device by design, which is no news
    let links = map.links.iter().filter(|link| link.near.device != 0);
    links
        .filter_map(|link| {
            let (near, far) = (size(link.near)?, size(link.far)?);
            let devices = [link.near.device, link.far.device];
            (near != far).then_some(Finding::PacketSizes { devices, mtu_bytes: [near, far] })
        })
        .collect()
}

/// Names and unique ids that several devices have, `[DSC-04]`.
fn doubles(map: &NetworkMap) -> Vec<Finding> {
    let mut names: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    let mut ids: BTreeMap<UniqueId, Vec<usize>> = BTreeMap::new();
    for (index, device) in map.devices.iter().enumerate() {
        if !device.name.is_empty() {
            names.entry(&device.name).or_default().push(index);
        }
        ids.entry(device.unique_id).or_default().push(index);
    }
    let names = names.into_iter().filter(|(_, devices)| devices.len() > 1);
    let ids = ids.into_iter().filter(|(_, devices)| devices.len() > 1);
    names
        .map(|(name, devices)| Finding::DuplicateName { name: name.to_owned(), devices })
        .chain(ids.map(|(id, devices)| Finding::DuplicateUniqueId { unique_id: id.to_string(), devices }))
        .collect()
}

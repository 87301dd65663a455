//! What the scan's tests share: scans, and a simulated network's own truth.

use osap::map::{Finding, NetworkMap};
use osap::network::SimNetwork;
use osap::scan::{ScanOptions, ScanReport};
use osap::session::Session;
use osap_protocol::discovery::UniqueId;
use osap_sim::machines::unique_id;
use std::collections::BTreeSet;

/// Scans once, with everything as it is by default.
pub(crate) fn scan(network: SimNetwork) -> ScanReport {
    scan_again(&mut Session::over(network))
}

pub(crate) fn scan_again(session: &mut Session) -> ScanReport {
    let report = session.scan(&ScanOptions::default(), &mut |_| {}).expect("the host answers itself");
    check(&report.map);
    report
}

/// What holds of every map.
pub(crate) fn check(map: &NetworkMap) {
    let json = map.to_json();
    assert_eq!(NetworkMap::from_json(&json).as_ref(), Ok(map));
    for (index, device) in map.devices.iter().enumerate() {
        for way in &device.routes {
            let end = map.follow(&way.route).map(|(end, _)| end);
            assert_eq!(end, Some(index), "the route {} of {}", way.route, device.label());
        }
        assert!(device.routes.is_sorted_by_key(|way| way.route.clone()));
    }
    assert!(map.devices.is_sorted_by_key(|device| device.route().clone()));
    assert!(!map.tree().is_empty() && map.dot().ends_with("}\n"));
}

/// The ids of the devices a world was built with: nodes `1..=count`, since the host was made first.
pub(crate) fn ids(count: usize) -> BTreeSet<UniqueId> {
    (1..=count).map(unique_id).collect()
}

/// The ids in a map, without the host's; each once.
pub(crate) fn found_ids(map: &NetworkMap) -> BTreeSet<UniqueId> {
    let ids: Vec<UniqueId> = map.devices[1..].iter().map(|device| device.unique_id).collect();
    let set: BTreeSet<UniqueId> = ids.iter().copied().collect();
    assert_eq!(set.len(), ids.len(), "a device stands in the map twice");
    set
}

/// A link by its ends' ids and gateways, the smaller first.
pub(crate) type Link = [(UniqueId, u8); 2];

/// The links that the simulator made, without those at the host.
pub(crate) fn true_links(network: &mut SimNetwork) -> BTreeSet<Link> {
    let links = network.links().to_vec();
    let world = network.world();
    let host = world.nodes().next().unwrap();
    links
        .into_iter()
        .map(|link| world.ends(link))
        .filter(|ends| ends.iter().all(|(node, _)| *node != host))
        .map(|ends| sorted(ends.map(|(node, gateway)| (unique_id(node.at()), gateway.get()))))
        .collect()
}

/// The links in a map, without those at the host.
pub(crate) fn found_links(map: &NetworkMap) -> BTreeSet<Link> {
    let others = map.links.iter().filter(|link| link.near.device != 0 && link.far.device != 0);
    let links: Vec<Link> = others
        .map(|link| {
            let end = |end: osap::map::LinkEnd| {
                (map.devices[end.device].unique_id, end.gateway.expect("both ends were read"))
            };
            sorted([end(link.near), end(link.far)])
        })
        .collect();
    let set: BTreeSet<Link> = links.iter().copied().collect();
    assert_eq!(set.len(), links.len(), "a link stands in the map twice");
    set
}

fn sorted(mut link: Link) -> Link {
    link.sort_unstable();
    link
}

/// The findings, as text with the devices' names.
pub(crate) fn findings(map: &NetworkMap) -> Vec<String> {
    let label = |device: usize| map.devices[device].label();
    map.findings.iter().map(|finding: &Finding| finding.text(label).to_string()).collect()
}

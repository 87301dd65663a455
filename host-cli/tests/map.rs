//! Maps read from elsewhere: what a map says it says again, and no map, however odd, breaks what shows it.

use osap::map::{
    Bus, BusMember, Device, Finding, Gateway, LeadsTo, LinkEdge, LinkEnd, MapError, MapRoute, NetworkMap, Port, SCHEMA,
    SilentPlace, diff,
};
use osap_protocol::discovery::{BuildKind, GatewayKind, UniqueId};
use osap_protocol::framing::Check;
use proptest::collection::vec;
use proptest::option;
use proptest::prelude::*;

/// Up to this many devices; indices are drawn from one more, so that some lead out of the map.
const DEVICES: usize = 5;

fn route() -> impl Strategy<Value = osap::map::RouteText> {
    "(/([0-3]|b[01]:[0-9])){0,3}".prop_map(|text| if text.is_empty() { "/" } else { &text }.parse().unwrap())
}

fn id() -> impl Strategy<Value = UniqueId> {
    (0u8..4).prop_map(|byte| UniqueId([byte; 12]))
}

fn leads_to() -> impl Strategy<Value = LeadsTo> {
    prop_oneof![
        6 => (0..DEVICES, option::of(0u8..4)).prop_map(|(device, gateway)| LeadsTo::Device { device, gateway }),
        1 => (0usize..2).prop_map(|bus| LeadsTo::Bus { bus }),
        1 => (0usize..2).prop_map(|silent| LeadsTo::Silent { silent }),
    ]
}

fn gateway() -> impl Strategy<Value = Gateway> {
    let kind = prop_oneof![Just(GatewayKind::Link), (0u8..9).prop_map(|drop| GatewayKind::Bus { drop })];
    (any::<u8>(), kind, any::<bool>(), any::<u32>(), option::of(id()), option::of(leads_to())).prop_map(
        |(index, kind, open, bit_rate, neighbour, leads_to)| Gateway {
            index: index % 66,
            type_name: "uart".to_owned(),
            kind,
            open,
            mtu_bytes: 256,
            bit_rate,
            bits_a_byte: 10,
            check: Check::Crc16,
            packet_hold_max: 4,
            received: 1,
            sent: 2,
            dropped: 3,
            neighbour,
            leads_to,
        },
    )
}

fn device() -> impl Strategy<Value = Device> {
    (id(), "\\PC{0,8}", any::<u32>(), vec(gateway(), 0..4), vec(route(), 0..3)).prop_map(
        |(unique_id, name, boot_epoch, gateways, routes)| Device {
            unique_id,
            type_name: name.chars().rev().collect(),
            name,
            boot_epoch,
            version: [0, 1, 0],
            build: BuildKind::Simulated,
            uptime_us: u64::from(boot_epoch) << 20,
            packet_bytes_max: 256,
            slots: 16,
            topology_generation: 1,
            gateways,
            ports: vec![Port {
                index: 0,
                type_name: "netresponder".to_owned(),
                name: String::new(),
                packet_hold_max: 0,
                received: 0,
                sent: 0,
            }],
            routes: routes.into_iter().map(|route| MapRoute { route, mtu_bytes: 256 }).collect(),
        },
    )
}

fn end() -> impl Strategy<Value = LinkEnd> {
    (0..DEVICES, option::of(0u8..4)).prop_map(|(device, gateway)| LinkEnd { device, gateway })
}

fn map() -> impl Strategy<Value = NetworkMap> {
    let link = (end(), end(), any::<bool>()).prop_map(|(near, far, in_tree)| LinkEdge { near, far, in_tree });
    let member = (0u8..9, end()).prop_map(|(drop, LinkEnd { device, gateway })| BusMember { drop, device, gateway });
    let bus = vec(member, 0..3).prop_map(|members| Bus { members });
    let silent = (0..DEVICES, option::of(id()), route()).prop_map(|(device, neighbour, route)| SilentPlace {
        device,
        gateway: 1,
        neighbour,
        route,
        tries: 4,
    });
    let finding = prop_oneof![
        (0..DEVICES, any::<u32>()).prop_map(|(device, times)| Finding::Restarted { device, times }),
        vec(0..DEVICES, 0..3).prop_map(|devices| Finding::DuplicateName { name: "a \"b\"".to_owned(), devices }),
    ];
    (vec(device(), 0..DEVICES), vec(link, 0..4), vec(bus, 0..3), vec(silent, 0..3), vec(finding, 0..3)).prop_map(
        |(devices, links, buses, silent, findings)| NetworkMap {
            schema: SCHEMA.to_owned(),
            devices,
            links,
            buses,
            silent,
            findings,
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    /// What is read is what was written, or is refused since it leads out of the map; what is read can be shown.
    #[test]
    fn a_map_reads_back_as_it_was_written(map in map()) {
        match NetworkMap::from_json(&map.to_json()) {
            Ok(read) => {
                prop_assert_eq!(&read, &map);
                prop_assert!(read.tree().starts_with(&read.root().label()));
                prop_assert_eq!(read.dot().chars().rev().nth(1), Some('}'));
                prop_assert_eq!(diff(&read, &read), []);
                for device in &read.devices {
                    let _ = read.resolve(&device.name);
                    let found = read.resolve(&device.route().to_string());
                    prop_assert!(found.is_ok_and(|found| found.routes.iter().any(|way| way.route == *device.route())));
                }
            }
            Err(error) => {
                prop_assert_eq!(error, MapError::Index);
                let count = map.devices.len();
                let leads_out = |gateway: &Gateway| match gateway.leads_to {
                    Some(LeadsTo::Device { device, .. }) => device >= count,
                    Some(LeadsTo::Bus { bus }) => bus >= map.buses.len(),
                    Some(LeadsTo::Silent { silent }) => silent >= map.silent.len(),
                    None => false,
                };
                let is_open = count == 0
                    || map.devices.iter().any(|device| device.routes.is_empty() || device.gateways.iter().any(leads_out))
                    || map.links.iter().any(|link| link.near.device.max(link.far.device) >= count)
                    || map.buses.iter().flat_map(|bus| &bus.members).any(|member| member.device >= count)
                    || map.silent.iter().any(|place| place.device >= count)
                    || map.findings.iter().flat_map(Finding::devices).any(|device| device >= count);
                prop_assert!(is_open, "a whole map was refused");
            }
        }
    }

    #[test]
    fn differences_of_any_two_maps_are_told(old in map(), new in map()) {
        if let (Ok(old), Ok(new)) = (NetworkMap::from_json(&old.to_json()), NetworkMap::from_json(&new.to_json())) {
            for change in diff(&old, &new) {
                prop_assert!(!change.to_string().is_empty());
            }
        }
    }
}

#[test]
fn what_is_no_map_is_refused_with_what_to_do() {
    let other = NetworkMap::from_json(
        r#"{"schema":"osap.map/2","devices":[],"links":[],"buses":[],"silent":[],"findings":[]}"#,
    );
    assert_eq!(other, Err(MapError::Schema { found: "osap.map/2".to_owned() }));
    let error = NetworkMap::from_json("{}").unwrap_err().to_string();
    assert!(
        error.starts_with("this is no map: ") && error.ends_with("Make one with `osap map --save FILE`"),
        "{error}"
    );
}

//! Networks by shape: a line, a ring, a bus, and a random network with loops.
//!
//! - **Walk:** a builder returns its nodes in order and its links; tests and scans begin at the first node.
//! - **Invariant:** every network is connected. All devices are RP2040s; all links are 3 Mbaud UARTs.

use super::{CRYSTAL_PPM, RP2040_200_MHZ, UART, add_device, gateway};
use crate::device::SIM_GATEWAYS;
use crate::world::{BusId, BusModel, LinkId, LinkModel, NodeId, World};
use firmware_app::kind::{self, Kind};
use osap_protocol::GatewayIndex;
use osap_protocol::discovery::GatewayKind;
use osap_runtime::GatewayConfig;

/// A network's nodes and links, each in the order in which it was made.
#[derive(Clone, Debug, Default)]
pub struct Shape {
    /// Nodes.
    pub nodes: Vec<NodeId>,
    /// Links.
    pub links: Vec<LinkId>,
}

/// A bus with what hangs on it.
#[derive(Clone, Debug)]
pub struct Cell {
    /// The hub: gateway 0 is free, gateway 1 leads to the bus, where it is drop 0.
    pub hub: NodeId,
    /// The devices: gateway 0 leads to the bus, where they are drops 1, 2, …
    pub devices: Vec<NodeId>,
    /// The bus.
    pub bus: BusId,
}

/// A bus gateway at 1 Mbit/s, with `drop` as its address.
#[must_use]
pub const fn bus_gateway(drop: u8) -> GatewayConfig {
    GatewayConfig { type_name: "bus", kind: GatewayKind::Bus { drop }, bit_rate: 1_000_000, ..UART }
}

/// Adds a device with `gateways` UARTs.
fn add(world: &mut World, kind: &'static Kind, gateways: usize) -> NodeId {
    let name = format!("{}-{}", kind.type_name, world.nodes().count());
    let clock = world.draw_clock(CRYSTAL_PPM);
    add_device(world, kind, &name, vec![UART; gateways], RP2040_200_MHZ, clock)
}

/// `nodes` hubs in a row: gateway 0 leads to the one before, gateway 1 to the one behind. The first one's gateway 0 is free.
pub fn line(world: &mut World, nodes: usize, model: LinkModel) -> Shape {
    let nodes: Vec<NodeId> = (0..nodes).map(|_| add(world, &kind::HUB, 2)).collect();
    let links =
        nodes.windows(2).map(|pair| world.connect((pair[0], gateway(1)), (pair[1], gateway(0)), model)).collect();
    Shape { nodes, links }
}

/// `nodes` hubs in a ring, at least three: gateway 0 leads to the one before, gateway 1 to the one behind, gateway 2 is free.
///
/// # Panics
/// Below three nodes.
pub fn ring(world: &mut World, nodes: usize, model: LinkModel) -> Shape {
    assert!(nodes >= 3, "a ring has at least three nodes");
    let nodes: Vec<NodeId> = (0..nodes).map(|_| add(world, &kind::HUB, 3)).collect();
    let links = (0..nodes.len())
        .map(|at| {
            let behind = nodes[(at + 1) % nodes.len()];
            world.connect((nodes[at], gateway(1)), (behind, gateway(0)), model)
        })
        .collect();
    Shape { nodes, links }
}

/// A hub and `devices` motors on one bus.
///
/// # Panics
/// Above 254 devices: a bus has drops 0 to 254.
pub fn bus_cell(world: &mut World, devices: usize) -> Cell {
    let clock = world.draw_clock(CRYSTAL_PPM);
    let hub = add_device(world, &kind::HUB, "cell hub", vec![UART, bus_gateway(0)], RP2040_200_MHZ, clock);
    let mut members: Vec<(NodeId, GatewayIndex)> = vec![(hub, gateway(1))];
    let devices: Vec<NodeId> = (1..=devices)
        .map(|drop| {
            let drop = u8::try_from(drop).ok().filter(|drop| *drop < 255).expect("drops end at 254");
            let clock = world.draw_clock(CRYSTAL_PPM);
            let name = format!("motor {drop}");
            add_device(world, &kind::MOTOR, &name, vec![bus_gateway(drop)], RP2040_200_MHZ, clock)
        })
        .collect();
    members.extend(devices.iter().map(|device| (*device, gateway(0))));
    let bus = world.bus(&members, BusModel::default());
    Cell { hub, devices, bus }
}

/// `nodes` devices in a random connected network: a spanning tree in which each node hangs on a random earlier one with a gateway
/// left, and up to `extra_links` links between random pairs that still have gateways, which make loops. Gateway 0 of the first
/// node is free. Every third node is a hub, which has all `SIM_GATEWAYS` gateways; other devices have four.
pub fn network(world: &mut World, nodes: usize, extra_links: usize) -> Shape {
    const KINDS: [&Kind; 6] = [&kind::HUB, &kind::MOTOR, &kind::HEATER, &kind::HUB, &kind::LOAD_CELL, &kind::CAMERA];
    let mut shape = Shape::default();
    let mut free: Vec<Free> = Vec::new();
    for at in 0..nodes {
        let kind = KINDS[at % KINDS.len()];
        let gateways = if at % 3 == 0 { SIM_GATEWAYS } else { 4 };
        let node = add(world, kind, gateways);
        shape.nodes.push(node);
        let mut mine = Free { node, next: usize::from(at == 0), gateways };
        if at > 0 {
            let other = world.draw_below(free.len());
            let link = world.connect((free[other].node, free[other].claim()), (node, mine.claim()), LinkModel::WIRE);
            shape.links.push(link);
            free.retain(Free::any);
        }
        free.push(mine);
    }
    for _ in 0..extra_links {
        if free.len() < 2 {
            break;
        }
        let (a, b) = (world.draw_below(free.len()), world.draw_below(free.len() - 1));
        let b = if b >= a { b + 1 } else { b };
        let ends = [a, b].map(|at| (free[at].node, free[at].claim()));
        shape.links.push(world.connect(ends[0], ends[1], LinkModel::WIRE));
        free.retain(Free::any);
    }
    shape
}

/// A node's gateways that nothing is wired to.
struct Free {
    node: NodeId,
    next: usize,
    gateways: usize,
}

impl Free {
    fn any(&self) -> bool {
        self.next < self.gateways
    }

    fn claim(&mut self) -> GatewayIndex {
        self.next += 1;
        gateway(self.next - 1)
    }
}

//! A simulated machine around a bridge, and which of its links lead to the workstation's place.

use super::bridge::Bridge;
use crate::cli::CliError;
use crate::cli::Exit;
use crate::network::SimKind;
use fixed_math::time::LocalTicks;
use osap_protocol::GatewayIndex;
use osap_runtime::GatewayConfig;
use osap_sim::capture::{Capture, CaptureError, Direction, InterfaceId};
use osap_sim::machines::{UART, printer, shapes};
use osap_sim::processor::Processor;
use osap_sim::time::ClockModel;
use osap_sim::world::{LinkId, LinkModel, NodeId, TapEvent, World};
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// A link to the workstation's place; its index is the bridge's gateway.
#[derive(Clone, Debug)]
pub(super) struct MachineLink {
    /// The device at its other end.
    pub(super) leads_to: String,
    /// Which link.
    pub(super) id: LinkId,
}

/// A world with a [`Bridge`] in it.
#[derive(Debug)]
pub(super) struct Machine {
    pub(super) world: World,
    pub(super) bridge: NodeId,
    pub(super) links: Vec<MachineLink>,
    /// Every link of the machine.
    all: Vec<LinkId>,
}

impl Machine {
    /// The machine of `kind`, whose devices boot with `first_epoch`; nobody is at its links yet.
    pub(super) fn build(kind: SimKind, seed: u64, first_epoch: u32) -> Self {
        let mut world = World::new(seed);
        world.set_first_epoch(first_epoch);
        let mut machine = match kind {
            SimKind::Printer => Self::printer(world),
            SimKind::Line { devices } => Self::behind(world, "hub-1", |world| {
                let shape = shapes::line(world, devices, LinkModel::WIRE);
                (shape.nodes.first().map(|node| (*node, 0)), shape.links)
            }),
            SimKind::Ring { devices } => Self::behind(world, "hub-1", |world| {
                let shape = shapes::ring(world, devices, LinkModel::WIRE);
                (shape.nodes.first().map(|node| (*node, 2)), shape.links)
            }),
            SimKind::Bus { devices } => {
                Self::behind(world, "cell hub", |world| (Some((shapes::bus_cell(world, devices).hub, 0)), Vec::new()))
            }
            SimKind::Random { devices, extra_links } => Self::behind(world, "hub-1", |world| {
                let shape = shapes::network(world, devices, extra_links);
                (shape.nodes.first().map(|node| (*node, 0)), shape.links)
            }),
        };
        for link in &machine.links {
            machine.world.unplug(link.id);
        }
        machine
    }

    fn printer(mut world: World) -> Self {
        let bridge = Box::new(Bridge::new(&printer::HOST_GATEWAYS));
        let built = printer::build(&mut world, bridge, Processor::INSTANT);
        let links = built.devices.iter().zip(&built.links).take(printer::HOST_GATEWAYS.len());
        let links = links.map(|((name, _), id)| MachineLink { leads_to: (*name).to_owned(), id: *id }).collect();
        Self { world, bridge: built.host, links, all: built.links }
    }

    /// A machine with one link to the workstation's place, by the gateway that `build` names.
    fn behind(
        mut world: World,
        first: &str,
        build: impl FnOnce(&mut World) -> (Option<(NodeId, u8)>, Vec<LinkId>),
    ) -> Self {
        let gateways: [GatewayConfig; 1] = [UART];
        let bridge = world.add_node(Box::new(Bridge::new(&gateways)), Processor::INSTANT, ClockModel::PERFECT);
        let (way_in, mut all) = build(&mut world);
        let own = GatewayIndex::from_low_bits(0);
        let connect = |(node, index)| {
            let id = world.connect((bridge, own), (node, GatewayIndex::from_low_bits(index)), LinkModel::WIRE);
            MachineLink { leads_to: first.to_owned(), id }
        };
        let links: Vec<MachineLink> = way_in.map(connect).into_iter().collect();
        all.extend(links.iter().map(|link| link.id));
        Self { world, bridge, links, all }
    }

    /// Writes every packet of every link to a file, from now on.
    pub(super) fn capture(&mut self, path: &Path) -> Result<(), CliError> {
        let failed = |error: CaptureError| {
            CliError::new(Exit::Io, error.to_string(), path.display().to_string(), "choose another file for --capture")
        };
        let file = File::create(path).map_err(|error| CliError::file(path, "write the capture", &error))?;
        let mut capture = Capture::new(BufWriter::new(file)).map_err(failed)?;
        let mut interfaces = Vec::new();
        for link in &self.all {
            let ends = self.world.ends(*link).map(|(node, gateway)| format!("{}:{}", node.at(), gateway.get()));
            interfaces.push((*link, capture.add_interface(&ends.join("-"), 0).map_err(failed)?));
        }
        let capture = Arc::new(Mutex::new(capture));
        for (link, interface) in interfaces {
            self.world.tap_link(link, Box::new(tap(Arc::clone(&capture), interface)));
        }
        Ok(())
    }
}

/// Writes what passes over one link. A full disk ends the capture, not the machine.
fn tap(
    capture: Arc<Mutex<Capture<BufWriter<File>>>>,
    interface: InterfaceId,
) -> impl FnMut(&TapEvent<'_>) + Send + 'static {
    let mut is_whole = true;
    move |event| {
        let direction = if event.way == 0 { Direction::Sent } else { Direction::Received };
        let at = LocalTicks::from_steps(event.at.steps());
        let mut capture = capture.lock().unwrap_or_else(PoisonError::into_inner);
        is_whole = is_whole && capture.packet(interface, at, direction, event.packet).is_ok();
    }
}

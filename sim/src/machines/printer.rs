//! The printer of the thesis, Table 2.7: a workstation, two hubs and a camera on USB, nine devices on UARTs behind the hubs.
//!
//! - **Walk:** [`build`] → scan, ping, measure → compare with [`TABLE_2_7`].
//! - **Invariants:** names, links and processors are the table's; what the table does not tell is stated here and nowhere else.
//!
//! Devices on UARTs take the table's "Processing Time Est.", split as in [`Processor::with_total`]. For the hubs and the camera the
//! table's figure contains the Python script; they take the RP2040's 24.2 µs scaled by clock frequency, which flatters slower memory
//! and slights wider cores. Wire times come from the links' rates, USB waits from [`USB_HIGH_SPEED_LINK`] and
//! [`USB_FULL_SPEED_LINK`]. Clocks are off by up to [`CRYSTAL_PPM`], drawn from the world's seed.

use super::{
    CRYSTAL_PPM, RP2040_200_MHZ, UART, USB_FULL_SPEED, USB_FULL_SPEED_LINK, USB_HIGH_SPEED, USB_HIGH_SPEED_LINK,
    add_device, gateway, micros,
};
use crate::endpoint::Endpoint;
use crate::processor::Processor;
use crate::time::ClockModel;
use crate::world::{LinkId, LinkModel, NodeId, World};
use firmware_app::{Kind, kind};
use fixed_math::time::Span;
use osap_runtime::GatewayConfig;

/// What the workstation's node needs: gateways 0 and 1 to the hubs, 2 to the camera.
pub const HOST_GATEWAYS: [GatewayConfig; 3] = [USB_HIGH_SPEED, USB_HIGH_SPEED, USB_FULL_SPEED];

/// A row of the thesis's Table 2.7; times in µs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TableRow {
    /// Device.
    pub device: &'static str,
    /// Devices and links in its route.
    pub route: &'static str,
    /// Closest link wire time.
    pub wire_us: f64,
    /// Mean round trip.
    pub rtt_mean_us: f64,
    /// Standard deviation of the round trip.
    pub rtt_sigma_us: f64,
    /// Longest round trip of 99.99 %.
    pub rtt_max_us: f64,
    /// Processing time; of the first three rows with Python's.
    pub processing_us: f64,
}

const HUB_A: &str = "Hub A + UART";
const HUB_B: &str = "Hub B + UART";
const HIGH_SPEED: &str = "USB 2.0 HS (CDC)";

const fn row(device: &'static str, route: &'static str, times: [f64; 5]) -> TableRow {
    let [wire_us, rtt_mean_us, rtt_sigma_us, rtt_max_us, processing_us] = times;
    TableRow { device, route, wire_us, rtt_mean_us, rtt_sigma_us, rtt_max_us, processing_us }
}

/// The thesis's Table 2.7, to be shown beside ours. Published figures, measured by a Python script on the real printer.
pub const TABLE_2_7: [TableRow; 12] = [
    row("Message Hub A", HIGH_SPEED, [3.2, 350.0, 64.0, 541.9, 346.8]),
    row("Message Hub B", HIGH_SPEED, [3.2, 264.7, 48.4, 580.6, 261.5]),
    row("Microbolometer", "USB 2.0 FS (CDC)", [32.0, 979.3, 185.8, 1843.6, 947.3]),
    row("Bed Heater", HUB_B, [534.0, 822.9, 58.3, 963.3, 24.2]),
    row("Extruder Motor", HUB_A, [534.0, 920.0, 59.1, 1170.6, 36.0]),
    row("B Motor", HUB_A, [534.0, 951.6, 68.1, 1246.5, 67.6]),
    row("A Motor", HUB_A, [534.0, 947.8, 66.0, 1155.7, 63.8]),
    row("Z Motor (Rear)", HUB_B, [534.0, 890.9, 68.2, 1126.5, 92.2]),
    row("Z Motor (Right)", HUB_B, [534.0, 917.9, 71.4, 1166.7, 119.2]),
    row("Z Motor (Left)", HUB_B, [534.0, 920.2, 71.1, 1140.7, 121.5]),
    row("Extruder Heater", HUB_A, [534.0, 1217.3, 68.4, 1567.1, 333.3]),
    row("Load Cell", HUB_A, [534.0, 1358.9, 83.3, 2033.4, 474.9]),
];

const fn samd51(whole: u64, tenths: u64) -> Processor {
    Processor::with_total("SAMD51", 180_000_000, micros(whole, tenths))
}

const fn samd21(whole: u64, tenths: u64) -> Processor {
    Processor::with_total("SAMD21", 48_000_000, micros(whole, tenths))
}

/// The RP2040's time scaled by clock frequency.
const fn scaled(name: &'static str, clock_mhz: u32) -> Processor {
    // 24.2 µs at 200 MHz is 4840 cycles
    let steps = 4840 * 256 / clock_mhz as u64;
    Processor::with_total(name, clock_mhz * 1_000_000, Span::from_steps(steps))
}

/// The hubs' processor.
pub const HUB_PROCESSOR: Processor = scaled("i.MX RT1062", 600);
/// The camera's processor.
pub const CAMERA_PROCESSOR: Processor = scaled("RP2350", 266);

/// Devices on hub A, in order of its gateways from 1 on.
const ON_HUB_A: [(&str, &Kind, Processor); 5] = [
    ("Extruder Motor", &kind::MOTOR, samd51(36, 0)),
    ("A Motor", &kind::MOTOR, samd51(63, 8)),
    ("B Motor", &kind::MOTOR, samd51(67, 6)),
    ("Extruder Heater", &kind::HEATER, samd21(333, 3)),
    ("Load Cell", &kind::LOAD_CELL, samd21(474, 9)),
];

/// Devices on hub B, in order of its gateways from 1 on.
const ON_HUB_B: [(&str, &Kind, Processor); 4] = [
    ("Bed Heater", &kind::HEATER, RP2040_200_MHZ),
    ("Z Motor (Rear)", &kind::MOTOR, samd51(92, 2)),
    ("Z Motor (Right)", &kind::MOTOR, samd51(119, 2)),
    ("Z Motor (Left)", &kind::MOTOR, samd51(121, 5)),
];

/// The printer's nodes and wires.
#[derive(Clone, Debug)]
pub struct Printer {
    /// The workstation.
    pub host: NodeId,
    /// Everything else, by the table's names: hubs, camera, then the devices.
    pub devices: Vec<(&'static str, NodeId)>,
    /// The link that leads to each of `devices` from the node before it.
    pub links: Vec<LinkId>,
}

impl Printer {
    /// The node of a name in the table.
    #[must_use]
    pub fn node(&self, name: &str) -> Option<NodeId> {
        self.devices.iter().find(|(device, _)| *device == name).map(|(_, node)| *node)
    }

    /// The link that leads to the node of a name.
    #[must_use]
    pub fn link(&self, name: &str) -> Option<LinkId> {
        let at = self.devices.iter().position(|(device, _)| *device == name)?;
        self.links.get(at).copied()
    }
}

/// Builds the printer around a workstation with the gateways of [`HOST_GATEWAYS`].
///
/// # Panics
/// Where the workstation lacks one of them.
pub fn build(world: &mut World, host: Box<dyn Endpoint>, host_processor: Processor) -> Printer {
    let host = world.add_node(host, host_processor, ClockModel::PERFECT);
    let mut printer = Printer { host, devices: Vec::new(), links: Vec::new() };
    let hub_a = add_hub(world, &mut printer, "Message Hub A", 0, &ON_HUB_A);
    let hub_b = add_hub(world, &mut printer, "Message Hub B", 1, &ON_HUB_B);

    let clock = world.draw_clock(CRYSTAL_PPM);
    let camera = add_device(world, &kind::CAMERA, "Microbolometer", vec![USB_FULL_SPEED], CAMERA_PROCESSOR, clock);
    let link = world.connect((host, gateway(2)), (camera, gateway(0)), USB_FULL_SPEED_LINK);
    printer.devices.push(("Microbolometer", camera));
    printer.links.push(link);

    add_devices(world, &mut printer, hub_a, &ON_HUB_A);
    add_devices(world, &mut printer, hub_b, &ON_HUB_B);
    printer
}

fn add_hub(
    world: &mut World,
    printer: &mut Printer,
    name: &'static str,
    host_gateway: usize,
    behind: &[(&str, &Kind, Processor)],
) -> NodeId {
    let mut gateways = vec![USB_HIGH_SPEED];
    gateways.extend(behind.iter().map(|_| UART));
    let clock = world.draw_clock(CRYSTAL_PPM);
    let hub = add_device(world, &kind::HUB, name, gateways, HUB_PROCESSOR, clock);
    let link = world.connect((printer.host, gateway(host_gateway)), (hub, gateway(0)), USB_HIGH_SPEED_LINK);
    printer.devices.push((name, hub));
    printer.links.push(link);
    hub
}

fn add_devices(
    world: &mut World,
    printer: &mut Printer,
    hub: NodeId,
    devices: &[(&'static str, &'static Kind, Processor)],
) {
    for (at, (name, kind, processor)) in devices.iter().enumerate() {
        let clock = world.draw_clock(CRYSTAL_PPM);
        let node = add_device(world, kind, name, vec![UART], *processor, clock);
        let link = world.connect((hub, gateway(at + 1)), (node, gateway(0)), LinkModel::WIRE);
        printer.devices.push((name, node));
        printer.links.push(link);
    }
}

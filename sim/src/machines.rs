//! Whole machines and networks, ready to run.
//!
//! - **Walk:** a builder adds nodes and wires to a [`World`] and says which is which.
//! - **Invariants:** what is drawn at random comes from the world's seed. Every device can be reset; its unique id is its place.
//! - **Context:** before or between steps of the world. **Clause:** `[LNK-02]`.

pub mod clocks;
pub mod printer;
pub mod shapes;

use crate::device::sim_device;
use crate::processor::Processor;
use crate::time::ClockModel;
use crate::world::{Factory, LinkModel, NodeId, World};
use firmware_app::Kind;
use fixed_math::time::Span;
use osap_protocol::GatewayIndex;
use osap_protocol::discovery::{GatewayKind, UniqueId};
use osap_protocol::framing::Check;
use osap_runtime::{GatewayConfig, Stamps};

/// A UART of the thesis's machines: 3 Mbaud, ten bits a byte, CRC-16.
pub const UART: GatewayConfig = GatewayConfig {
    type_name: "uart",
    kind: GatewayKind::Link,
    mtu_bytes: 256,
    bit_rate: 3_000_000,
    bits_a_byte: 10,
    check: Check::Crc16,
    packet_hold_max: 4,
    stamps: Stamps::SOFTWARE,
};

/// USB-CDC at high speed: the bulk transfer carries its own check, `[FRM-04]`.
pub const USB_HIGH_SPEED: GatewayConfig = GatewayConfig {
    type_name: "usb-cdc",
    kind: GatewayKind::Link,
    mtu_bytes: 256,
    bit_rate: 480_000_000,
    bits_a_byte: 8,
    check: Check::None,
    packet_hold_max: 8,
    stamps: Stamps::SOFTWARE,
};

/// USB-CDC at full speed.
pub const USB_FULL_SPEED: GatewayConfig = GatewayConfig { bit_rate: 12_000_000, ..USB_HIGH_SPEED };

/// The wait of a bulk transfer for its host controller at high speed: anywhere in a microframe of 125 µs. Two such waits have a
/// standard deviation of 51 µs; the thesis's Table 2.7 shows 48 and 64 µs for a round trip.
pub const USB_HIGH_SPEED_LINK: LinkModel = LinkModel { jitter: Span::from_us(125), ..LinkModel::WIRE };

/// The same at full speed: anywhere in half a frame of 1 ms, since controllers serve a bulk pipe again within a frame. Two such waits
/// have a standard deviation of 204 µs; Table 2.7 shows 186 µs.
pub const USB_FULL_SPEED_LINK: LinkModel = LinkModel { jitter: Span::from_us(500), ..LinkModel::WIRE };

/// How far a device's crystal may be off, ppm.
pub const CRYSTAL_PPM: f64 = 50.0;

/// Time that a Raspberry Pi RP2040 at 200 MHz takes for one packet, received, handled and answered: Table 2.7's bed heater.
pub const RP2040_200_MHZ: Processor = Processor::with_total("RP2040", 200_000_000, micros(24, 2));

/// `whole.tenths` microseconds.
const fn micros(whole: u64, tenths: u64) -> Span {
    Span::from_steps((whole * 10 + tenths) * 256 / 10)
}

/// A gateway's index where the builder knows that it fits.
pub(crate) fn gateway(index: usize) -> GatewayIndex {
    u8::try_from(index).ok().and_then(GatewayIndex::new).expect("below 64")
}

/// The unique id of a world's `at`-th device.
#[must_use]
pub fn unique_id(at: usize) -> UniqueId {
    let mut bytes = *b"sim-........";
    bytes[4..].copy_from_slice(&(at as u64).to_be_bytes());
    UniqueId(bytes)
}

/// Adds a device of `kind` that boots with `name`, or with the name it was given since, and `gateways`.
pub fn add_device(
    world: &mut World,
    kind: &'static Kind,
    name: &str,
    gateways: Vec<GatewayConfig>,
    processor: Processor,
    clock: ClockModel,
) -> NodeId {
    let factory = sim_factory(world, kind, name, gateways);
    world.add_device(factory, processor, clock)
}

/// Boots a device of `kind` as `name`, or under the name it was given since; its unique id is the next node's place.
pub(crate) fn sim_factory(world: &World, kind: &'static Kind, name: &str, gateways: Vec<GatewayConfig>) -> Factory {
    let id = unique_id(world.nodes().count());
    let name = name.to_owned();
    Box::new(move |boot| sim_device(kind, id, boot.epoch, boot.name.unwrap_or(&name), &gateways))
}

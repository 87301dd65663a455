//! Devices as endpoints: the same application that runs in firmware.
//!
//! - **Walk:** the world's calls, one by one, to the device's. **Clause:** `[APP-01]`.

use crate::endpoint::Endpoint;
use firmware_app::kind::{PORTS_MAX, Service};
use firmware_app::motion::{MotionService, MotionTraits};
use firmware_app::{Device, Kind};
use fixed_math::time::LocalTicks;
use osap_maxl::device::{BeatTraits, DeviceRings};
use osap_protocol::discovery::{BuildKind, UniqueId};
use osap_protocol::header::Arrival;
use osap_protocol::{DropCause, GatewayIndex};
use osap_runtime::debug::DebugRing;
use osap_runtime::{GatewayConfig, Outgoing};

/// Packet slots of a simulated device.
pub const SIM_SLOTS: usize = 16;
/// Bytes of each.
pub const SIM_PACKET_BYTES: usize = 256;
/// Gateways it can have.
pub const SIM_GATEWAYS: usize = 16;
/// The longest message that its echo port takes, bytes.
pub const SIM_MESSAGE_BYTES: usize = 4096;

/// Its beat: 64 µs by a counter of 1 MHz.
const BEAT: BeatTraits = BeatTraits { period_log2: 6, nominal_cycles: 64 };
/// What its motion port says.
const MOTION: MotionTraits = MotionTraits { beat_us: 64, channels: 1, has_phases: false };

/// A simulated device.
pub type SimDevice = Device<SIM_SLOTS, SIM_PACKET_BYTES, SIM_GATEWAYS, PORTS_MAX, SIM_MESSAGE_BYTES>;

/// A simulated device of `kind` with `gateways`, in order of their indices.
///
/// # Panics
/// Where there are more than `SIM_GATEWAYS` gateways.
#[must_use]
pub fn sim_device(
    kind: &'static Kind,
    unique_id: UniqueId,
    boot_epoch: u32,
    name: &str,
    gateways: &[GatewayConfig],
) -> Box<SimDevice> {
    let device = SimDevice::new(kind, unique_id, boot_epoch, BuildKind::Simulated, name);
    let mut device = Box::new(device.expect("as many ports as a kind has"));
    if kind.port_of(Service::Motion).is_some() {
        // tracks want memory for as long as there is a device, which in a simulation is as long as the process runs
        let (motion, interpolator) = Box::leak(Box::new(DeviceRings::new())).split(BEAT);
        device.set_motion(MotionService::new(motion, MOTION).played_here(interpolator));
    }
    for gateway in gateways {
        device.node_mut().add_gateway(*gateway).expect("at most SIM_GATEWAYS gateways");
    }
    device
}

impl<const SLOTS: usize, const BYTES: usize, const GATEWAYS: usize, const PORTS: usize, const MESSAGE_BYTES: usize>
    Endpoint for Device<SLOTS, BYTES, GATEWAYS, PORTS, MESSAGE_BYTES>
{
    fn receive(&mut self, arrival: Arrival, packet: &mut [u8], started: LocalTicks, now: LocalTicks) {
        let _counted = Self::receive(self, arrival, packet, started, now);
    }

    fn run(&mut self, now: LocalTicks) {
        Self::run(self, now);
    }

    fn waiting(&self, now: LocalTicks) -> usize {
        self.queries_waiting() + self.services_waiting(now)
    }

    fn transmit(&mut self, gateway: GatewayIndex, now: LocalTicks, out: &mut [u8]) -> Option<Outgoing> {
        Self::transmit(self, gateway, now, out)
    }

    fn has_output(&self, gateway: GatewayIndex, now: LocalTicks) -> bool {
        Self::has_output(self, gateway, now)
    }

    fn next_wake(&self) -> Option<LocalTicks> {
        Self::next_wake(self)
    }

    fn set_open(&mut self, gateway: GatewayIndex, open: bool, now: LocalTicks) {
        self.node_mut().set_open(gateway, open, now);
    }

    fn count(&mut self, cause: DropCause, gateway: Option<GatewayIndex>, now: LocalTicks) {
        self.node_mut().count(cause, gateway, now);
    }

    fn gateway_config(&self, gateway: GatewayIndex) -> Option<GatewayConfig> {
        self.node().gateway(gateway).map(|it| *it.config())
    }

    fn debug(&self) -> &DebugRing {
        self.node().debug()
    }

    fn debug_mut(&mut self) -> &mut DebugRing {
        self.node_mut().debug_mut()
    }

    fn free_slots(&self) -> usize {
        self.node().free_slots()
    }

    fn take_new_name(&mut self) -> Option<&str> {
        Self::take_new_name(self)
    }
}

//! The device of this image: its sizes, its links, and what the tasks of `main.rs` do.
//!
//! - **Context:** [`start`] in `init`; [`Routing`] and [`Links`] in `route`; [`Keeper`] in `idle`.

#![expect(unreachable_pub, reason = "RTIC has its resources be public types")]

use board_rp2040_pico::clock::{self, Alarm};
use board_rp2040_pico::pac::{Interrupt, Peripherals};
use board_rp2040_pico::uart::{self, DmaUart};
use board_rp2040_pico::{Board, UART_BAUD};
use core::sync::atomic::{AtomicBool, Ordering};
use firmware_app::Link;
use firmware_app::kind::{self, Kind};
use firmware_app::routing::{self, Links};
use firmware_app::settings::Changes;
use fixed_math::time::LocalTicks;
use osap_protocol::discovery::{BuildKind, GatewayKind, Name, UniqueId};
use osap_protocol::framing::Check;
use osap_runtime::{GatewayConfig, Identity, Node};

/// Wakes routing.
pub const ROUTE: Interrupt = Interrupt::SW0_IRQ;
/// Wakes serving.
pub const SERVE: Interrupt = Interrupt::SW1_IRQ;

const SLOTS: usize = 16;
const PACKET_BYTES: usize = 256;
const GATEWAYS: usize = 3;
/// The netresponder, and the services of a kind.
const PORTS: usize = if cfg!(feature = "services") { kind::PORTS_MAX } else { 1 };
const MESSAGE_BYTES: usize = 1024;
const FRAME_BYTES: usize = PACKET_BYTES + Check::Crc16.len();

/// Routing has more to do than to take in bytes. Set at the priority of routing and below, so that reading and clearing it there are not
/// come between.
static ROUTE_ALL: AtomicBool = AtomicBool::new(true);

/// Has routing look at everything.
pub fn wake_routing() {
    ROUTE_ALL.store(true, Ordering::Relaxed);
    rtic::pend(ROUTE);
}

/// This image's node.
pub type PicoNode = Node<SLOTS, PACKET_BYTES, GATEWAYS, PORTS>;
/// Its services.
#[cfg(feature = "services")]
pub type PicoServices = firmware_app::Services<PACKET_BYTES, MESSAGE_BYTES>;
/// None of them.
#[cfg(not(feature = "services"))]
pub type PicoServices = ();

/// What the interpolating interrupt has.
#[cfg(feature = "motion")]
pub type PicoBeats = crate::interpolation::PicoBeats;
/// It does not beat.
#[cfg(not(feature = "motion"))]
pub type PicoBeats = ();

/// What both halves of motion share.
#[cfg(feature = "motion")]
pub type MotionRings = osap_maxl::device::DeviceRings;
/// Nothing.
#[cfg(not(feature = "motion"))]
pub struct MotionRings;

#[cfg(not(feature = "motion"))]
impl MotionRings {
    /// None.
    pub const fn new() -> Self {
        Self
    }
}

/// The kinds this image can be: all that there are, or in a node alone these without their services.
static KINDS: [Kind; kind::KINDS.len()] = if cfg!(feature = "services") { kind::KINDS } else { kind::WITHOUT_PORTS };

const UART: GatewayConfig = GatewayConfig {
    type_name: "uart",
    kind: GatewayKind::Link,
    mtu_bytes: 256,
    bit_rate: UART_BAUD,
    bits_a_byte: 10,
    check: Check::Crc16,
    packet_hold_max: 6,
    stamps: uart::STAMPS,
};

/// A UART's link.
type UartLink = Link<DmaUart, PACKET_BYTES, FRAME_BYTES>;

/// All links, in order of their gateways.
pub struct PicoLinks {
    uarts: [UartLink; 2],
    #[cfg(feature = "usb")]
    usb: Link<board_rp2040_pico::usb::UsbWire, PACKET_BYTES, FRAME_BYTES>,
}

impl PicoLinks {
    /// Does what the USB asks for.
    pub fn poll_usb(&mut self) {
        #[cfg(feature = "usb")]
        self.usb.wire().poll();
    }
}

impl Links<SLOTS, PACKET_BYTES, GATEWAYS, PORTS> for PicoLinks {
    fn receive(&mut self, node: &mut PicoNode, now: LocalTicks) -> bool {
        let ended = self.uarts.receive(node, now);
        #[cfg(feature = "usb")]
        let ended = ended | self.usb.receive(node, now);
        ended
    }

    fn transmit(&mut self, node: &mut PicoNode, now: LocalTicks) {
        self.uarts.transmit(node, now);
        #[cfg(feature = "usb")]
        self.usb.transmit(node, now);
    }

    fn next_wake(&self) -> Option<LocalTicks> {
        Links::<SLOTS, PACKET_BYTES, GATEWAYS, PORTS>::next_wake(&self.uarts)
    }
}

/// What the routing task has to itself.
pub struct Routing {
    alarm: Alarm,
    #[cfg(feature = "watchdog")]
    watchdog: board_rp2040_pico::Watchdog,
}

impl Routing {
    /// One turn of routing; says whether a service has something to do. Where no more came than pieces of frames it is a short one.
    pub fn turn(&mut self, node: &mut PicoNode, links: &mut PicoLinks, services_wake: Option<LocalTicks>) -> bool {
        let all = ROUTE_ALL.load(Ordering::Relaxed);
        ROUTE_ALL.store(false, Ordering::Relaxed);
        if !links.receive(node, clock::now()) && !all {
            return false;
        }
        let next = routing::forward(node, links, services_wake, clock::now());
        self.alarm.set(next.wake);
        #[cfg(feature = "watchdog")]
        self.watchdog.feed();
        next.serve
    }
}

/// Keeps what is to outlast power-off.
pub struct Keeper {
    #[cfg(feature = "settings")]
    settings: Option<firmware_app::settings::Settings<board_rp2040_pico::flash::SettingsFlash>>,
}

impl Keeper {
    /// Gives a node's clock what a former run kept of it.
    #[cfg(feature = "settings")]
    fn restore(&self, node: &mut PicoNode) {
        if let Some(time) = self.settings.as_ref().and_then(firmware_app::settings::Settings::time) {
            node.restore_time(time);
        }
    }

    /// Writes what has changed.
    pub fn keep(&mut self, changes: &Changes) {
        #[cfg(feature = "settings")]
        if let Some(settings) = &mut self.settings {
            let _lasts_until_power_off = settings.keep(changes);
        }
        #[cfg(not(feature = "settings"))]
        let _lasts_until_power_off = changes;
    }
}

/// What is to be kept, once; without settings nothing is.
pub fn changes(node: &mut PicoNode) -> Changes {
    if cfg!(feature = "settings") { Changes::take(node, clock::now()) } else { Changes::default() }
}

/// The node behind RTIC's lock.
#[cfg(feature = "services")]
pub struct SharedNode<M>(pub M);

#[cfg(feature = "services")]
impl<M: rtic::Mutex<T = &'static mut PicoNode>> firmware_app::lock::NodeLock for SharedNode<M> {
    type Node = PicoNode;

    fn lock<R>(&mut self, work: impl FnOnce(&mut PicoNode) -> R) -> R {
        self.0.lock(|node| work(node))
    }

    fn wake_routing(&mut self) {
        wake_routing();
    }
}

/// What `init` makes.
pub struct Parts {
    /// Shared by all below interrupts, in its place.
    pub node: &'static mut PicoNode,
    /// Of routing and USB.
    pub links: PicoLinks,
    /// Routing's own.
    pub routing: Routing,
    /// Serving's own, in its place.
    pub services: &'static mut PicoServices,
    /// Idle's own.
    pub keeper: Keeper,
    /// Interpolation's own.
    pub beats: PicoBeats,
}

/// Where what is large is for good: handed from one stack frame to the next, as RTIC does with its resources, it would not fit the stack.
pub struct Places {
    rings: MotionRings,
    node: Option<PicoNode>,
    services: Option<PicoServices>,
}

impl Places {
    /// With nothing in them.
    pub const fn new() -> Self {
        Self { rings: MotionRings::new(), node: None, services: None }
    }
}

/// Starts the board and makes the device.
pub fn start(peripherals: Peripherals, places: &'static mut Places) -> Parts {
    let board = Board::init(peripherals, cfg!(feature = "usb"));
    #[cfg(feature = "evaluate")]
    let board = {
        let mut board = board;
        crate::evaluations::run(&mut board.signals);
        board
    };
    let (keeper, name, boots) = settings();
    let kind = &KINDS[usize::from(board.straps) % KINDS.len()];
    let id = UniqueId(board.unique_id);
    let Places { rings, node, services } = places;
    let node = place_node(node, kind, id, boots, &name);
    #[cfg(feature = "services")]
    let services = services.insert(PicoServices::new(kind));
    #[cfg(not(feature = "services"))]
    let services = services.insert(());
    #[cfg(feature = "motion")]
    let interpolator = set_motion(services, rings);
    #[cfg(not(feature = "motion"))]
    let _nothing_in_it = rings;
    #[cfg(feature = "report")]
    if let Some(report) = &board.report {
        crate::handlers::tell(node, report);
    }
    let uarts = board.uarts.map(|uart| Link::new(uart, UART, node).expect("a place for each UART"));
    #[cfg(feature = "usb")]
    let usb = {
        let (check, stamps) = (Check::None, osap_runtime::Stamps::SOFTWARE);
        let config = GatewayConfig { type_name: "usb-cdc", bit_rate: 0, bits_a_byte: 8, check, stamps, ..UART };
        Link::new(board.usb.expect("asked for"), config, node).expect("a place for USB")
    };
    let links = PicoLinks {
        uarts,
        #[cfg(feature = "usb")]
        usb,
    };
    #[cfg(feature = "settings")]
    keeper.restore(node);
    #[cfg(feature = "motion")]
    let beats = {
        let Board { pace, steps, phases, enable, signals, .. } = board;
        crate::interpolation::beats(crate::interpolation::Parts { pace, steps, phases, enable, signals }, interpolator)
    };
    #[cfg(not(feature = "motion"))]
    let beats = ();
    #[cfg(feature = "watchdog")]
    let watchdog = {
        let mut watchdog = board.watchdog;
        watchdog.start();
        watchdog
    };
    let routing = Routing {
        alarm: board.alarm,
        #[cfg(feature = "watchdog")]
        watchdog,
    };
    Parts { node, links, routing, services, keeper, beats }
}

/// A node of a kind with its ports and no gateways yet, made in a frame that is gone before the others are.
#[inline(never)]
fn place_node<'n>(
    place: &'n mut Option<PicoNode>,
    kind: &'static Kind,
    unique_id: UniqueId,
    boot_epoch: u32,
    name: &Name,
) -> &'n mut PicoNode {
    let (type_name, version, build) = (kind.type_name, kind.version, BuildKind::Firmware);
    let node = place.insert(Node::new(Identity { type_name, unique_id, boot_epoch, version, build }, name));
    for port in kind.ports {
        node.add_port(port.config()).expect("as many ports as the kinds have");
    }
    node
}

/// Gives the services their half of motion; the other half. In a frame of its own too.
#[cfg(feature = "motion")]
#[inline(never)]
fn set_motion(
    services: &mut PicoServices,
    rings: &'static mut MotionRings,
) -> osap_maxl::device::Interpolator<'static> {
    let (motion, interpolator) = rings.split(crate::interpolation::BEAT);
    services.set_motion(firmware_app::motion::MotionService::new(motion, crate::interpolation::MOTION));
    interpolator
}

/// The settings' keeper, the name in them and which start this is.
#[cfg(feature = "settings")]
fn settings() -> (Keeper, Name, u32) {
    use board_rp2040_pico::flash::{SETTINGS_BYTES, SettingsFlash};
    // SAFETY: called once; code, constants and vectors are in RAM, and the DMA reads no flash
    let flash = unsafe { SettingsFlash::new() };
    let settings = firmware_app::settings::Settings::load(flash, 0..SETTINGS_BYTES).ok();
    let name = settings.as_ref().and_then(|settings| Name::try_from(settings.name()).ok()).unwrap_or_default();
    let boots = settings.as_ref().map_or(1, firmware_app::settings::Settings::boots);
    (Keeper { settings }, name, boots)
}

/// Without settings each start looks like the first.
#[cfg(not(feature = "settings"))]
fn settings() -> (Keeper, Name, u32) {
    (Keeper {}, Name::new(), 1)
}

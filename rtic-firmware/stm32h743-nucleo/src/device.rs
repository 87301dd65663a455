//! The device of this image: its sizes, its links, and what the tasks of `main.rs` do.
//!
//! - **Walk:** `init` → [`start`] → what the tasks own.
//! - **Invariants:** links have the gateways of the board's table, in its order; the boot epoch is the number of starts.
//! - **Context:** [`start`] in `init`; [`Routing`] and [`Links`] in `route`; [`Keeper`] in `idle`. **Clauses:** `[LNK-02]`, `[SYS-04]`.

use board_stm32h743_nucleo::Board;
use board_stm32h743_nucleo::clock::{self, Wake, WakeInterrupt};
use board_stm32h743_nucleo::flash::SettingsFlash;
use board_stm32h743_nucleo::pac::{Interrupt, Peripherals};
use board_stm32h743_nucleo::uart::{
    BIT_RATE, BITS_A_BYTE, CHECK, MTU_BYTES, UART_COUNT, Uart, UartBuffers, UartInterrupt,
};
use firmware_app::lock::NodeLock;
use firmware_app::routing::route;
use firmware_app::settings::Changes;
use firmware_app::{Device, Link, Services, kind};
use fixed_math::time::LocalTicks;
use osap_protocol::discovery::{BuildKind, GatewayKind, Name, UniqueId};
use osap_runtime::{GatewayConfig, Node, Stamps};

/// What `route` is bound to: the interrupt of a peripheral whose clock is never turned on.
pub(crate) const ROUTE: Interrupt = Interrupt::LPTIM1;
/// What `serve` is bound to, likewise.
pub(crate) const SERVE: Interrupt = Interrupt::LPTIM2;

/// Slots for packets.
const SLOTS: usize = 32;
/// Bytes of a slot.
const BYTES: usize = MTU_BYTES as usize;
/// The UARTs and USB.
const GATEWAYS: usize = UART_COUNT + 1;
/// The netresponder, echo, stream, spin and motion.
const PORTS: usize = firmware_app::kind::PORTS_MAX;
/// Bytes of the longest message that echo takes.
const MESSAGE_BYTES: usize = 1024;
/// Bytes of the longest packet and its check.
const FRAME_BYTES: usize = BYTES + CHECK.len();

/// This image's node.
pub(crate) type NucleoNode = Node<SLOTS, BYTES, GATEWAYS, PORTS>;
/// Its services.
pub(crate) type NucleoServices = Services<BYTES, MESSAGE_BYTES>;
/// The UARTs, then USB where there is one.
pub(crate) type Links = ([Link<Uart, BYTES, FRAME_BYTES>; UART_COUNT], UsbLink);

/// The link over USB.
#[cfg(feature = "usb")]
pub(crate) type UsbLink = Link<board_stm32h743_nucleo::usb::UsbWire, BYTES, FRAME_BYTES>;
/// No link.
#[cfg(not(feature = "usb"))]
pub(crate) type UsbLink = ();

/// What both halves of motion share.
#[cfg(feature = "motion")]
pub(crate) type Rings = crate::interpolation::Rings;
/// Nothing.
#[cfg(not(feature = "motion"))]
pub(crate) struct Rings;

#[cfg(not(feature = "motion"))]
impl Rings {
    /// None.
    pub(crate) const fn new() -> Self {
        Self
    }
}

/// All that the highest task has.
#[cfg(feature = "motion")]
pub(crate) type Beats = crate::interpolation::Beats;
/// It does not beat.
#[cfg(not(feature = "motion"))]
pub(crate) type Beats = ();

/// A UART as a gateway. Each may hold a quarter of the slots, so that no one link can fill the pool.
const UART: GatewayConfig = GatewayConfig {
    type_name: "uart",
    kind: GatewayKind::Link,
    mtu_bytes: MTU_BYTES,
    bit_rate: BIT_RATE,
    bits_a_byte: BITS_A_BYTE,
    check: CHECK,
    packet_hold_max: 8,
    stamps: Stamps::SOFTWARE,
};

/// Does what the USB asks for.
#[cfg(feature = "usb")]
pub(crate) fn poll_usb(links: &mut Links) {
    links.1.wire().poll();
}

/// What the routing task has to itself.
pub(crate) struct Routing {
    wake: Wake,
    #[cfg(feature = "watchdog")]
    watchdog: board_stm32h743_nucleo::Watchdog,
}

impl Routing {
    /// One turn; says whether a service has something to do.
    pub(crate) fn run(&mut self, node: &mut NucleoNode, links: &mut Links, services_wake: Option<LocalTicks>) -> bool {
        let next = route(node, links, services_wake, clock::now());
        clock::keep();
        self.wake.set(next.wake);
        #[cfg(feature = "watchdog")]
        self.watchdog.feed();
        next.serve
    }
}

/// Keeps what is to outlast power-off.
pub(crate) struct Keeper {
    #[cfg(feature = "settings")]
    settings: Option<firmware_app::settings::Settings<SettingsFlash>>,
}

impl Keeper {
    /// Gives a node's clock what a former run kept of it.
    #[cfg(feature = "settings")]
    fn restore(&self, node: &mut NucleoNode) {
        if let Some(time) = self.settings.as_ref().and_then(firmware_app::settings::Settings::time) {
            node.restore_time(time);
        }
    }

    /// There is nothing to restore.
    #[cfg(not(feature = "settings"))]
    #[expect(clippy::unused_self, reason = "the same name where there are settings")]
    fn restore(&self, _: &mut NucleoNode) {}

    /// Writes what has changed.
    #[cfg(feature = "settings")]
    pub(crate) fn keep(&mut self, changes: &Changes) {
        if let Some(settings) = &mut self.settings {
            let _until_power_off = settings.keep(changes);
        }
    }

    /// Keeps nothing.
    #[cfg(not(feature = "settings"))]
    #[expect(clippy::unused_self, reason = "the same name where there are settings")]
    pub(crate) fn keep(&mut self, _: &Changes) {}
}

/// What is to be kept, once.
pub(crate) fn changes(node: &mut NucleoNode) -> Changes {
    Changes::take(node, clock::now())
}

/// The node behind RTIC's lock.
pub(crate) struct SharedNode<M>(pub(crate) M);

impl<M: rtic::Mutex<T = NucleoNode>> NodeLock for SharedNode<M> {
    type Node = NucleoNode;

    fn lock<R>(&mut self, work: impl FnOnce(&mut NucleoNode) -> R) -> R {
        self.0.lock(work)
    }

    fn wake_routing(&mut self) {
        rtic::pend(ROUTE);
    }
}

/// What `init` makes.
pub(crate) struct Parts {
    /// Shared by all below interrupts.
    pub(crate) node: NucleoNode,
    /// Of routing and USB.
    pub(crate) links: Links,
    /// Routing's own.
    pub(crate) routing: Routing,
    /// Interpolation's own.
    pub(crate) beats: Beats,
    /// Serving's own.
    pub(crate) services: NucleoServices,
    /// Idle's own.
    pub(crate) keeper: Keeper,
    /// The timer's own.
    pub(crate) wake_interrupt: WakeInterrupt,
    /// The UARTs' own.
    pub(crate) uart_interrupts: [UartInterrupt; UART_COUNT],
}

/// Starts the board and makes the device.
pub(crate) fn start(
    core: cortex_m::Peripherals,
    peripherals: Peripherals,
    buffers: &'static mut [UartBuffers; UART_COUNT],
    rings: &'static mut Rings,
) -> Parts {
    let board = Board::init(core, peripherals, buffers, cfg!(feature = "usb"));
    let (keeper, name, boots) = settings(board.settings);
    let kind = kind::KINDS.get(usize::from(board.straps)).unwrap_or(&kind::HUB);
    let device = Device::new(kind, UniqueId(board.unique_id), boots, BuildKind::Firmware, &name);
    let (mut node, services) = device.expect("PORTS are as many as every kind has").into_parts();
    #[cfg(feature = "motion")]
    let (services, beats) = {
        let mut services = services;
        let Board { pace, steps, enable, signals, .. } = board;
        let parts = crate::interpolation::Parts { pace, steps, enable, signals };
        let beats = crate::interpolation::start(rings, &mut services, parts);
        (services, beats)
    };
    #[cfg(not(feature = "motion"))]
    let (Rings, beats) = (rings, ());
    #[cfg(feature = "report")]
    if let Some(report) = &board.report {
        crate::handlers::tell(&mut node, report);
    }
    let uarts = board.uarts.map(|uart| Link::new(uart, UART, &mut node).expect("a gateway for each UART"));
    #[cfg(feature = "usb")]
    let usb = {
        let check = osap_protocol::framing::Check::None;
        let config = GatewayConfig { type_name: "usb-cdc", bit_rate: 0, bits_a_byte: 8, check, ..UART };
        Link::new(board.usb.expect("asked for"), config, &mut node).expect("a gateway for USB")
    };
    #[cfg(not(feature = "usb"))]
    let usb = ();
    keeper.restore(&mut node);
    #[cfg(feature = "watchdog")]
    let watchdog = {
        let mut watchdog = board.watchdog;
        watchdog.start();
        watchdog
    };
    let routing = Routing {
        wake: board.wake,
        #[cfg(feature = "watchdog")]
        watchdog,
    };
    Parts {
        node,
        links: (uarts, usb),
        routing,
        beats,
        services,
        keeper,
        wake_interrupt: board.wake_interrupt,
        uart_interrupts: board.uart_interrupts,
    }
}

/// The settings' keeper, the name in them and which start this is.
#[cfg(feature = "settings")]
fn settings(flash: Option<SettingsFlash>) -> (Keeper, Name, u32) {
    use board_stm32h743_nucleo::flash::SETTINGS_BYTES;
    use firmware_app::settings::Settings;
    let settings = flash.and_then(|flash| Settings::load(flash, 0..SETTINGS_BYTES).ok());
    let name = settings.as_ref().and_then(|settings| Name::try_from(settings.name()).ok()).unwrap_or_default();
    let boots = settings.as_ref().map_or(1, Settings::boots);
    (Keeper { settings }, name, boots)
}

/// Without settings each start looks like the first.
#[cfg(not(feature = "settings"))]
fn settings(_: Option<SettingsFlash>) -> (Keeper, Name, u32) {
    (Keeper {}, Name::new(), 1)
}

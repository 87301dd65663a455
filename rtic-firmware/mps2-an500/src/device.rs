//! The device this image makes: sizes, and what is put together at start-up.
//!
//! - **Walk:** `init` → [`start`] → what the tasks own.
//! - **Invariant:** the kind comes from the settings, else from the factory record; the boot epoch is the number of starts.
//! - **Context:** start-up, before any interrupt. **Clauses:** `[LNK-02]`, `[SYS-04]`.

use crate::features::{
    Beats, KeptSettings, MotionParts, Probe, Rings, RunningWatchdog, Turns, past_reports, start_motion, start_probe,
};
use board_mps2_an500::clock::Wake;
use board_mps2_an500::pac::{Interrupt, Peripherals};
use board_mps2_an500::uart::{BIT_RATE, CHECK, MTU_BYTES, UART_COUNT, Uart, UartBuffers};
use board_mps2_an500::{Board, REGION, UartRx, UartTx};
use firmware_app::kind::KINDS;
use firmware_app::lock::NodeLock;
use firmware_app::settings::Changes;
use firmware_app::{Device, Link};
use osap_protocol::discovery::{BuildKind, GatewayKind};
use osap_runtime::{GatewayConfig, Stamps};

/// What `route` is bound to: a port's interrupt that nothing else uses.
pub(crate) const ROUTE: Interrupt = Interrupt::PORT0;
/// What `serve` is bound to, likewise.
pub(crate) const SERVE: Interrupt = Interrupt::PORT1;

/// Slots for packets.
const SLOTS: usize = 32;
/// Bytes of a slot.
const BYTES: usize = MTU_BYTES as usize;
/// The netresponder, echo, stream, spin and motion.
const PORTS: usize = firmware_app::kind::PORTS_MAX;
/// Bytes of the longest message that echo takes.
const MESSAGE_BYTES: usize = 1024;
/// Bytes of the longest packet and its check.
const FRAME_BYTES: usize = BYTES + CHECK.len();

/// The node.
pub(crate) type Node = osap_runtime::Node<SLOTS, BYTES, UART_COUNT, PORTS>;
/// The services.
pub(crate) type Services = firmware_app::Services<BYTES, MESSAGE_BYTES>;
/// The links.
pub(crate) type Links = [Link<Uart, BYTES, FRAME_BYTES>; UART_COUNT];

/// A UART as a gateway. Each may hold a quarter of the slots, so that no one link can fill the pool.
const GATEWAY: GatewayConfig = GatewayConfig {
    type_name: "uart",
    kind: GatewayKind::Link,
    mtu_bytes: MTU_BYTES,
    bit_rate: BIT_RATE,
    bits_a_byte: 10,
    check: CHECK,
    packet_hold_max: 8,
    stamps: Stamps::SOFTWARE,
};

/// What the tasks own.
pub(crate) struct Started {
    pub(crate) node: Node,
    pub(crate) services: Services,
    pub(crate) beats: Beats,
    pub(crate) links: Links,
    pub(crate) rx: [UartRx; UART_COUNT],
    pub(crate) tx: [UartTx; UART_COUNT],
    pub(crate) wake: Wake,
    pub(crate) watchdog: RunningWatchdog,
    pub(crate) settings: KeptSettings,
    pub(crate) probe: Probe,
    pub(crate) turns: Turns,
}

/// Puts the device together.
pub(crate) fn start(
    peripherals: Peripherals,
    buffers: &'static mut [UartBuffers; UART_COUNT],
    rings: &'static mut Rings,
) -> Started {
    let board = Board::new(peripherals, REGION, buffers);
    let settings = KeptSettings::load(board.kept.settings);
    let kind = settings.kind().and_then(|kind| KINDS.get(usize::from(kind))).unwrap_or(board.factory.kind);
    let device = Device::new(kind, board.factory.unique_id, settings.boots(), BuildKind::Firmware, settings.name());
    let (mut node, mut services) = device.expect("PORTS are as many as every kind has").into_parts();
    past_reports(board.kept.report, &mut node);
    let Board { pace, steps, enable, signals, .. } = board;
    let beats = start_motion(rings, &mut services, MotionParts { pace, steps, enable, signals });
    let links = board.wires.map(|wire| Link::new(wire, GATEWAY, &mut node).expect("a gateway for each UART"));
    settings.restore(&mut node);
    let (probe, turns) = start_probe(board.latency);
    Started {
        node,
        services,
        beats,
        links,
        rx: board.rx,
        tx: board.tx,
        wake: board.wake,
        watchdog: RunningWatchdog::start(board.watchdog),
        settings,
        probe,
        turns,
    }
}

/// What is to be kept, once.
pub(crate) fn changes(node: &mut Node) -> Changes {
    Changes::take(node, board_mps2_an500::now())
}

/// The node as RTIC shares it.
pub(crate) struct Locked<M>(pub(crate) M);

impl<M: rtic::Mutex<T = Node>> NodeLock for Locked<M> {
    type Node = Node;

    fn lock<R>(&mut self, work: impl FnOnce(&mut Node) -> R) -> R {
        self.0.lock(work)
    }

    fn wake_routing(&mut self) {
        rtic::pend(ROUTE);
    }
}

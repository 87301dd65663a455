//! QEMU's `mps2-an500`: a Cortex-M7 with five UARTs. There is such a board, but what this crate was tried on is the emulated one.
//!
//! - **Walk:** [`Board::new`] hands out what an image's tasks own; the interrupt bodies are [`UartRx::on_interrupt`] and
//!   [`UartTx::on_interrupt`]. [`pace`] → interpolation → [`outputs`], [`signals`]; [`motors`] has them as interpolation takes them.
//! - **Invariants:** each part is handed out once. Nothing here knows a node: an image brings the two together.
//! - **Context:** start-up for [`Board::new`]; else as each part says.
//! - **Clauses:** `[NOD-08]` capture, `[DSC-05]` what is kept.
//!
//! Clock: 25 MHz for the processor and all peripherals. QEMU counts time, not cycles: it runs as fast as its host can.
//!
//! The other MPS2 boards with the same peripherals have crates of a few lines over this one: [`kept::Region`] tells them apart.
#![no_std]

pub mod clock;
pub mod kept;
pub mod latency;
pub mod motors;
pub mod outputs;
pub mod pac;
pub mod pace;
pub mod signals;
pub mod uart;
pub mod watchdog;

use kept::{Factory, Kept, Region};
use latency::Latency;
use outputs::{Enable, StepPins};
use pac::Interrupt;
use pace::Pace;
use signals::SignalPins;
use uart::{UART_COUNT, UartBuffers};
use watchdog::Watchdog;

pub use clock::{Wake, now};
pub use uart::{Uart, UartRx, UartTx};

/// Where this board keeps what outlives a reset: its pseudo-static RAM, 16 MiB, which QEMU calls `mps.ram`.
pub const REGION: Region = Region::at(0x6000_0000);

/// All that an image gets of the board.
pub struct Board {
    /// The UARTs, 0 to 4.
    pub wires: [Uart; UART_COUNT],
    /// Their receive interrupts' parts.
    pub rx: [UartRx; UART_COUNT],
    /// Their transmit interrupts' parts.
    pub tx: [UartTx; UART_COUNT],
    /// When routing wakes of itself.
    pub wake: Wake,
    /// Stopped until it is started.
    pub watchdog: Watchdog,
    /// Settings and reports.
    pub kept: Kept,
    /// Who this device is.
    pub factory: Factory,
    /// Stopped until it is started.
    pub latency: Latency,
    /// The beat of interpolation, which stands still until it is started.
    pub pace: Pace,
    /// Steps and directions, all low.
    pub steps: StepPins,
    /// Motor drivers, off.
    pub enable: Enable,
    /// Pins of signals, all low.
    pub signals: SignalPins,
}

impl Board {
    /// Starts the clock and the UARTs. `region` is this board's [`REGION`], `buffers` memory for the UARTs.
    pub fn new(device: pac::Peripherals, region: Region, buffers: &'static mut [UartBuffers; UART_COUNT]) -> Self {
        clock::start(device.timer0);
        let [port0, port1, port2] = device.ports;
        // SAFETY: the one writes LEDs, the other reads buttons
        let buttons = unsafe { device.io.share() };
        let (steps, enable) = outputs::start(port0, port1, device.io, region);
        let signals = signals::start(port2, buttons, region);
        let ([r0, r1, r2, r3, r4], [b0, b1, b2, b3, b4]) = (device.uarts, buffers);
        let [u0, u1, u2, u3, u4] = [
            uart::start(r0, Interrupt::UART0TX, b0),
            uart::start(r1, Interrupt::UART1TX, b1),
            uart::start(r2, Interrupt::UART2TX, b2),
            uart::start(r3, Interrupt::UART3TX, b3),
            uart::start(r4, Interrupt::UART4TX, b4),
        ];
        Self {
            wires: [u0.wire, u1.wire, u2.wire, u3.wire, u4.wire],
            rx: [u0.rx, u1.rx, u2.rx, u3.rx, u4.rx],
            tx: [u0.tx, u1.tx, u2.tx, u3.tx, u4.tx],
            wake: Wake::new(device.timer1),
            watchdog: Watchdog::new(device.watchdog),
            kept: region.take(),
            factory: region.factory(),
            latency: Latency::new(device.dual_timer, region),
            pace: Pace::new(device.systick),
            steps,
            enable,
            signals,
        }
    }
}

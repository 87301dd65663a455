//! Raspberry Pi Pico: RP2040 at 125 MHz, UART0 and UART1 at 3 Mbaud by DMA, USB-CDC, settings in flash, watchdog.
//!
//! - **Walk:** UART → DMA → [`uart`] → the image's routing task → [`uart`] → DMA → UART; the same with [`usb`]. [`pace`] → interpolation →
//!   [`outputs`].
//! - **Invariants:** all code and constants are in RAM, the vector table too, so that writing the flash delays nobody. DMA channels 0 to 7
//!   are the UARTs'; of the PWM, slice 0 is [`pace`]'s, slices 1 and 5 are [`outputs`]' and slice 7 is [`clock`]'s.
//! - **Context:** [`Board::init`] in `init`, the rest where its module says.
//!
//! | pin | is | pin | is |
//! |---|---|---|---|
//! | GPIO0 | UART0 TX | GPIO4 | UART1 TX |
//! | GPIO1 | UART0 RX | GPIO5 | UART1 RX |
//! | GPIO18 | kind, bit 0 | GPIO19, GPIO20 | kind, bits 1 and 2 |
//! | GPIO6 to GPIO13 | steps and directions | GPIO14 | enable of motor drivers |
//! | GPIO2, GPIO3 | coil A | GPIO26, GPIO27 | coil B |
//! | GPIO16, 17, 21, 22 | outputs of signals | GPIO15, GPIO28 | inputs that are read at a beat |
//!
//! The kind's pins are read once at start-up: open is 0, tied to 3.3 V is 1; the number is an index into `firmware_app::kind::KINDS`.
#![no_std]
#![expect(clippy::cast_possible_truncation, reason = "addresses and lengths of a processor of 32 bits are `u32`")]

pub mod clock;
pub mod flash;
pub mod motors;
pub mod outputs;
pub mod pace;
pub mod signals;
pub mod uart;
pub mod usb;

pub use rp2040_hal::pac;

use core::mem::MaybeUninit;
use core::ptr::addr_of_mut;
use embedded_hal::digital::InputPin;
use firmware_app::report::{REPORT_WORDS, Report};
use fugit::{ExtU32, RateExtU32};
use hal::clocks::{Clock, init_clocks_and_plls};
use hal::uart::{DataBits, StopBits, UartConfig, UartPeripheral};
use rp2040_hal as hal;

/// Rate of both UARTs as asked for, bits a second; the divider makes 2,994,012 of it.
pub const UART_BAUD: u32 = 3_000_000;
/// The processor's clock.
pub const CORE_HZ: u32 = 125_000_000;

const CRYSTAL_HZ: u32 = 12_000_000;
/// Without being fed for so long, the watchdog resets.
const WATCHDOG_US: u32 = 1_000_000;
/// Vectors of the processor itself and of its interrupts.
const VECTORS: usize = 16 + 32;

/// Second stage of the boot ROM: sets up the flash of a Pico.
#[unsafe(link_section = ".boot2")]
#[used]
#[unsafe(no_mangle)]
pub static BOOT2_FIRMWARE: [u8; 256] = rp2040_boot2::BOOT_LOADER_W25Q080;

/// The vector table in RAM. Aligned as VTOR demands.
#[repr(align(256))]
struct Vectors([u32; VECTORS]);

static mut VECTOR_TABLE: Vectors = Vectors([0; VECTORS]);

/// What outlives a reset.
#[unsafe(link_section = ".uninit.REPORT")]
static mut REPORT: MaybeUninit<[u32; REPORT_WORDS]> = MaybeUninit::uninit();

/// Runs before start-up has copied anything, so it stands in flash.
#[unsafe(link_section = ".boot_text")]
#[unsafe(no_mangle)]
extern "C" fn __pre_init() {}

/// The board after its start.
pub struct Board {
    /// UART0 and UART1.
    pub uarts: [uart::DmaUart; 2],
    /// The USB port; `None` until [`Board::init`] is asked for it.
    pub usb: Option<usb::UsbWire>,
    /// Fed by routing.
    pub watchdog: Watchdog,
    /// To wake routing.
    pub alarm: clock::Alarm,
    /// The beat of interpolation, which stands still until it is started.
    pub pace: pace::Pace,
    /// Steps and directions, all low.
    pub steps: outputs::StepPins,
    /// Coils, without current until they are started.
    pub phases: outputs::Phases,
    /// Motor drivers, off.
    pub enable: outputs::Enable,
    /// What follows signals, and inputs.
    pub signals: signals::SignalPins,
    /// Silicon's number: the flash chip's 64 bits behind four letters.
    pub unique_id: [u8; 12],
    /// Number set by the kind's pins.
    pub straps: u8,
    /// What happened before this start, if it was not power-on.
    pub report: Option<Report>,
}

/// The watchdog.
pub struct Watchdog(hal::Watchdog);

impl Watchdog {
    /// Starts it: from now on it wants to be fed.
    pub fn start(&mut self) {
        self.0.start(WATCHDOG_US.micros());
    }

    /// Gives it another second.
    pub fn feed(&mut self) {
        self.0.feed();
    }
}

impl Board {
    /// Starts clocks, pins, DMA and timer.
    ///
    /// # Panics
    /// Where the crystal does not start, which no board recovers from.
    #[must_use]
    pub fn init(mut p: pac::Peripherals, with_usb: bool) -> Self {
        // SAFETY: no other core runs and no critical section is open; a spinlock left over from before a reset would lock for good
        unsafe { hal::sio::spinlock_reset() };
        vectors_to_ram();
        let by_watchdog = p.WATCHDOG.reason().read().timer().bit_is_set();
        let mut watchdog = hal::Watchdog::new(p.WATCHDOG);
        let clocks =
            init_clocks_and_plls(CRYSTAL_HZ, p.XOSC, p.CLOCKS, p.PLL_SYS, p.PLL_USB, &mut p.RESETS, &mut watchdog)
                .unwrap_or_else(|_| panic!("the crystal does not start"));
        let timer = clock::start(p.TIMER, &mut p.RESETS, &clocks);
        let unique_id = flash::unique_id();
        let sio = hal::Sio::new(p.SIO);
        let pins = hal::gpio::Pins::new(p.IO_BANK0, p.PADS_BANK0, sio.gpio_bank0, &mut p.RESETS);
        let levels = [
            pins.gpio18.into_pull_down_input().is_high(),
            pins.gpio19.into_pull_down_input().is_high(),
            pins.gpio20.into_pull_down_input().is_high(),
        ];
        let straps = levels.into_iter().rev().fold(0, |number, bit| (number << 1) | u8::from(bit == Ok(true)));
        let (steps, phases, enable) = outputs::start();
        let config = || UartConfig::new(UART_BAUD.Hz(), DataBits::Eight, None, StopBits::One);
        let rate_hz = clocks.peripheral_clock.freq();
        let uart0 =
            UartPeripheral::new(p.UART0, (pins.gpio0.into_function(), pins.gpio1.into_function()), &mut p.RESETS);
        let mut uart0 = uart0.enable(config(), rate_hz).unwrap_or_else(|_| panic!("the rate cannot be divided"));
        uart0.set_fifos(true);
        let uart1 =
            UartPeripheral::new(p.UART1, (pins.gpio4.into_function(), pins.gpio5.into_function()), &mut p.RESETS);
        let mut uart1 = uart1.enable(config(), rate_hz).unwrap_or_else(|_| panic!("the rate cannot be divided"));
        uart1.set_fifos(true);
        let wires = uart::start(&p.DMA, &mut p.RESETS);
        let usb = with_usb
            .then(|| usb::UsbWire::new(p.USBCTRL_REGS, p.USBCTRL_DPRAM, clocks.usb_clock, &mut p.RESETS, &unique_id));
        let report = take_report().or_else(|| by_watchdog.then(Report::watchdog));
        Self {
            uarts: wires,
            usb,
            watchdog: Watchdog(watchdog),
            alarm: timer,
            pace: pace::Pace::new(),
            steps,
            phases,
            enable,
            signals: signals::start(),
            unique_id,
            straps,
            report,
        }
    }
}

/// Copies the vector table to RAM and has the processor use it there.
fn vectors_to_ram() {
    let table = addr_of_mut!(VECTOR_TABLE);
    // SAFETY: called once, before any interrupt is enabled; the table linked at VTOR has `VECTORS` words, and the copy lives for good
    unsafe {
        let scb = &*cortex_m::peripheral::SCB::PTR;
        let linked = scb.vtor.read() as *const [u32; VECTORS];
        (*table).0 = linked.read_volatile();
        scb.vtor.write(table as u32);
    }
}

/// The report left before the last reset, once.
fn take_report() -> Option<Report> {
    let place = addr_of_mut!(REPORT).cast::<[u32; REPORT_WORDS]>();
    // SAFETY: called once at start-up, before handlers could write; any bits are valid words, and volatile access takes them as they are
    unsafe {
        let mut words = place.read_volatile();
        let report = Report::decode(&mut words);
        place.write_volatile(words);
        report
    }
}

/// Leaves a report and starts anew. For handlers of panics and faults.
pub fn reset_with(report: &Report) -> ! {
    let mut words = [0; REPORT_WORDS];
    report.encode(&mut words);
    // SAFETY: interrupts are masked and this never returns, so nobody else touches the words
    unsafe {
        cortex_m::interrupt::disable();
        addr_of_mut!(REPORT).cast::<[u32; REPORT_WORDS]>().write_volatile(words);
    }
    cortex_m::peripheral::SCB::sys_reset()
}

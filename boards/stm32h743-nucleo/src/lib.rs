//! NUCLEO-H743ZI2: STM32H743ZI (revision V) at 384 MHz, three UARTs at 3 Mbaud by interrupt, USB-CDC, settings in flash, watchdog.
//!
//! **Never run on hardware by its authors, and no emulator has this chip.** What it was tried by: the compiler, reading against the
//! reference manual (RM0433 revision 7, whose chapters are named beside the registers used), and tests of its arithmetic on a host. What
//! it does with bytes and packets is `firmware-app`'s, which the emulated boards run.
//!
//! - **Walk:** UART → interrupt → ring → [`uart`] → the image's routing task → [`uart`] → interrupt → UART; the same with [`usb`].
//!   [`pace`] → interpolation → [`outputs`], [`signals`]; [`motors`] has them as interpolation takes them.
//! - **Invariants:** nothing here knows a node. No DMA; all data in DTCM, so that caches need no upkeep: see `memory.rs`.
//! - **Context:** [`Board::init`] in `init`, the rest where its module says.
//!
//! | what | pins | on the board | interrupt |
//! |---|---|---|---|
//! | link 0 | USART3: PD8 TX, PD9 RX | the ST-LINK's virtual COM port | `USART3` |
//! | link 1 | USART2: PD5 TX, PD6 RX | CN9: D53, D52 | `USART2` |
//! | link 2 | UART7: PE8 TX, PE7 RX | CN10: D42, D41 | `UART7` |
//! | link 3 | OTG2, full speed: PA11 D−, PA12 D+ | CN13, "USB USER" | `OTG_FS` |
//! | kind, bits 0, 1, 2 | PE4, PE5, PE6 | CN9: D57, D58, D59 | |
//! | steps, directions, enable | PE9 to PE15, PE0, PE2 | CN10, see [`outputs`] | |
//! | signals | PC8 to PC11, PG2, PG3 | CN8, see [`signals`] | |
//! | beat | | | `TIM3` |
//!
//! The kind's pins are read once at start-up: open is 0, tied to 3.3 V is 1; the number is an index into `firmware_app::kind::KINDS`.
//!
//! Link 0 is one cable's way in: `osap scan --link serial:/dev/ttyACM0@3000000,check=crc16`. ST states rates above 3 Mbaud for the
//! STLINK-V3's port, but no flow control and no figure for what it carries without loss, so a frame lost there is to be expected and is
//! counted; that this rate works at all is not tried either. With a cable to "USB USER", link 3 is the better one.
//!
//! **Clocks.** The ST-LINK gives 8 MHz (HSE, bypassed); without it, as when powered from elsewhere, the board does not start. PLL1: 8 × 96 =
//! 768 MHz; P: / 2 = 384 MHz, core; Q: / 16 = 48 MHz, USB. Buses: AXI and AHB 192 MHz, APB 96 MHz, their timers 192 MHz. 384 and not
//! the 400 or 480 MHz the chip can do, since all that is made of it is then exact: UARTs 96 / 32 = 3 Mbaud, ticks 192 / 3 = 64 MHz = four
//! steps of a time each, USB without an oscillator of its own. It also stays in voltage range VOS1, at any allowed temperature.
#![no_std]

pub mod clock;
pub mod flash;
pub mod kept;
mod memory;
pub mod motors;
pub mod outputs;
pub mod pace;
pub mod signals;
pub mod uart;
pub mod usb;

pub use stm32h7xx_hal::pac;

use firmware_app::report::Report;
use kept::Cause;
use stm32h7xx_hal as hal;

use hal::independent_watchdog::IndependentWatchdog;
use hal::prelude::*;
use hal::rcc::rec::UsbClkSel;
use hal::rcc::{Ccdr, PllConfigStrategy};
use hal::serial::config::{Config, FifoThreshold};
use uart::{BIT_RATE, Registers, UART_COUNT, Uart, UartBuffers, UartInterrupt};

/// The processor's clock.
pub const CORE_HZ: u32 = 384_000_000;
/// What the ST-LINK gives.
const HSE_HZ: u32 = 8_000_000;
const BUS_HZ: u32 = CORE_HZ / 2;
const PERIPHERAL_HZ: u32 = BUS_HZ / 2;
const USB_HZ: u32 = 48_000_000;
/// Without being fed for so long, the watchdog resets. Its clock, the LSI, is exact to some percent.
const WATCHDOG_MS: u32 = 1_000;

/// The board after its start.
pub struct Board {
    /// USART3, USART2 and UART7, for the routing task.
    pub uarts: [Uart; UART_COUNT],
    /// The same, for their interrupts.
    pub uart_interrupts: [UartInterrupt; UART_COUNT],
    /// The USB port; `None` unless [`Board::init`] is asked for it.
    pub usb: Option<usb::UsbWire>,
    /// Fed by routing.
    pub watchdog: Watchdog,
    /// To wake routing.
    pub wake: clock::Wake,
    /// For the interrupt `TIM5`.
    pub wake_interrupt: clock::WakeInterrupt,
    /// The beat of interpolation, which stands still until it is started.
    pub pace: pace::Pace,
    /// Steps and directions, all low.
    pub steps: outputs::StepPins,
    /// Motor drivers, off.
    pub enable: outputs::Enable,
    /// Pins of signals, all low.
    pub signals: signals::SignalPins,
    /// Where settings are kept.
    pub settings: Option<flash::SettingsFlash>,
    /// Silicon's number, 96 bits.
    pub unique_id: [u8; 12],
    /// Number set by the kind's pins.
    pub straps: u8,
    /// What happened before this start, if it was not power-on.
    pub report: Option<Report>,
}

/// The independent watchdog, IWDG1. Once started it runs until the next reset.
pub struct Watchdog(IndependentWatchdog);

impl Watchdog {
    /// Starts it: from now on it wants to be fed.
    pub fn start(&mut self) {
        self.0.start(WATCHDOG_MS.millis());
    }

    /// Gives it another second.
    pub fn feed(&mut self) {
        self.0.feed();
    }
}

impl Board {
    /// Starts caches, clocks, pins and timer. `buffers` is memory for the UARTs.
    ///
    /// # Panics
    /// Where a clock is not what this was written for, which is a mistake here.
    #[must_use]
    pub fn init(
        core: cortex_m::Peripherals,
        p: pac::Peripherals,
        buffers: &'static mut [UartBuffers; UART_COUNT],
        with_usb: bool,
    ) -> Self {
        let cause = Cause::take(&p.RCC);
        let report = kept::take_report(cause);
        memory::set_up(core);
        let Ccdr { clocks, mut peripheral, .. } = clocks(p.PWR, p.RCC, &p.SYSCFG);
        peripheral.kernel_usb_clk_mux(UsbClkSel::Pll1Q);
        let (wake, wake_interrupt) = clock::start(p.TIM5, peripheral.TIM5, &clocks);
        let pace = pace::set_up(p.TIM3, peripheral.TIM3, &clocks);
        let unique_id = *hal::signature::Uid::read();

        let a = p.GPIOA.split(peripheral.GPIOA);
        let d = p.GPIOD.split(peripheral.GPIOD);
        let e = p.GPIOE.split(peripheral.GPIOE);
        outputs::low(e.pe9);
        outputs::low(e.pe10);
        outputs::low(e.pe11);
        outputs::low(e.pe12);
        outputs::low(e.pe13);
        outputs::low(e.pe14);
        outputs::low(e.pe15);
        outputs::low(e.pe0);
        outputs::low(e.pe2);
        let (steps, enable) = outputs::of_low_pins();
        let signals = signals::start(p.GPIOC.split(peripheral.GPIOC), p.GPIOG.split(peripheral.GPIOG));
        let straps = [
            e.pe4.into_pull_down_input().is_high(),
            e.pe5.into_pull_down_input().is_high(),
            e.pe6.into_pull_down_input().is_high(),
        ];
        let straps = straps.into_iter().rev().fold(0, |number, bit| number << 1 | u8::from(bit));

        // receivers are pulled up, so that one with nothing attached is idle; the transmit FIFO's interrupt comes while half of it or more is empty
        let config = Config::new(BIT_RATE.Hz()).txfifothreshold(FifoThreshold::Half);
        let pins = (d.pd8.into_alternate::<7>(), d.pd9.into_alternate::<7>().internal_pull_up(true));
        let _usart3 = p.USART3.serial(pins, config, peripheral.USART3, &clocks).expect("full duplex");
        let pins = (d.pd5.into_alternate::<7>(), d.pd6.into_alternate::<7>().internal_pull_up(true));
        let _usart2 = p.USART2.serial(pins, config, peripheral.USART2, &clocks).expect("full duplex");
        let pins = (e.pe8.into_alternate::<7>(), e.pe7.into_alternate::<7>().internal_pull_up(true));
        let _uart7 = p.UART7.serial(pins, config, peripheral.UART7, &clocks).expect("full duplex");
        let (uarts, uart_interrupts) = uart_parts(buffers);

        let usb = with_usb.then(|| {
            let (minus, plus) = (a.pa11.into_alternate::<10>(), a.pa12.into_alternate::<10>());
            let (global, device, power) = (p.OTG2_HS_GLOBAL, p.OTG2_HS_DEVICE, p.OTG2_HS_PWRCLK);
            let usb = hal::usb_hs::USB2::new(global, device, power, minus, plus, peripheral.USB2OTG, &clocks);
            usb::UsbWire::new(usb, &unique_id)
        });
        Self {
            uarts,
            uart_interrupts,
            usb,
            watchdog: Watchdog(IndependentWatchdog::new(p.IWDG)),
            wake,
            wake_interrupt,
            pace,
            steps,
            enable,
            signals,
            settings: flash::SettingsFlash::new(p.FLASH),
            unique_id,
            straps,
            report,
        }
    }
}

/// Sets the clocks as the module's head says.
fn clocks(pwr: pac::PWR, rcc: pac::RCC, syscfg: &pac::SYSCFG) -> Ccdr {
    let power = pwr.constrain().vos1().freeze();
    let ccdr = rcc
        .constrain()
        .use_hse(HSE_HZ.Hz())
        .bypass_hse()
        .pll1_strategy(PllConfigStrategy::Iterative)
        .sys_ck(CORE_HZ.Hz())
        .pll1_q_ck(USB_HZ.Hz())
        .hclk(BUS_HZ.Hz())
        .pclk1(PERIPHERAL_HZ.Hz())
        .pclk2(PERIPHERAL_HZ.Hz())
        .pclk3(PERIPHERAL_HZ.Hz())
        .pclk4(PERIPHERAL_HZ.Hz())
        .freeze(power, syscfg);
    let is_exact = |given: hal::time::Hertz, wanted: u32| given.raw() == wanted;
    assert!(
        is_exact(ccdr.clocks.sys_ck(), CORE_HZ) && is_exact(ccdr.clocks.pclk1(), PERIPHERAL_HZ),
        "clocks are exact"
    );
    ccdr
}

/// The UARTs' halves, in order of their links.
fn uart_parts(buffers: &'static mut [UartBuffers; UART_COUNT]) -> ([Uart; UART_COUNT], [UartInterrupt; UART_COUNT]) {
    let [b0, b1, b2] = buffers;
    let [i0, i1, i2] = uart::INTERRUPTS;
    // SAFETY: these three are set up, and their drivers of the HAL are not used after that
    let [r0, r1, r2] =
        unsafe { [pac::USART3::ptr(), pac::USART2::ptr(), pac::UART7::ptr()].map(|block| Registers::new(block)) };
    let (u0, x0) = uart::start(r0, i0, b0);
    let (u1, x1) = uart::start(r1, i1, b1);
    let (u2, x2) = uart::start(r2, i2, b2);
    ([u0, u1, u2], [x0, x1, x2])
}

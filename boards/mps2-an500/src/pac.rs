//! Registers and interrupts that the MPS2 boards AN385, AN386 and AN500 share: RTIC's `device`.
//!
//! - **Invariants:** addresses, offsets and interrupt numbers are those of Arm's application notes 385, 386 and 500 and of the CMSDK's
//!   manual (DDI 0479), as far as QEMU models them.
//! - **Context:** any; each access is one load or store.

use core::ops::Deref;
use vcell::VolatileCell;

/// Bits of an interrupt's priority that are used: eight levels.
pub const NVIC_PRIO_BITS: u8 = 3;

/// Registers that stand at a fixed address.
pub struct Registers<T: 'static>(&'static T);

impl<T> Registers<T> {
    /// The registers at `address`.
    ///
    /// # Safety
    /// `T` is what stands there, and whoever else has it writes no register that this one's holder writes.
    const unsafe fn at(address: usize) -> Self {
        // SAFETY: registers are always there, and `VolatileCell` is what they may be shared as; the caller vouches for the rest.
        Self(unsafe { &*core::ptr::with_exposed_provenance(address) })
    }

    /// Registers in memory, for tests.
    #[cfg(test)]
    pub(crate) const fn of(registers: &'static T) -> Self {
        Self(registers)
    }

    /// The same once more, for a second task.
    ///
    /// # Safety
    /// The two holders write no register of which both writes matter.
    pub(crate) const unsafe fn share(&self) -> Self {
        Self(self.0)
    }
}

impl<T> Deref for Registers<T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.0
    }
}

// SAFETY: an access is one load or store, whole in whichever task it is made.
unsafe impl<T> Send for Registers<T> {}

/// A UART: one byte of buffer each way.
#[repr(C)]
pub struct UartRegisters {
    /// The byte that came; writing sends one.
    pub data: VolatileCell<u32>,
    /// Bit 0: the transmit buffer is full; bit 1: the receive buffer is.
    pub state: VolatileCell<u32>,
    /// Bit 0: transmit, 1: receive, 2: transmit interrupt, 3: receive interrupt.
    pub control: VolatileCell<u32>,
    /// Bit 0: transmit, 1: receive; writing a 1 clears it.
    pub interrupts: VolatileCell<u32>,
    /// Clock over bit rate, 16 at least.
    pub divider: VolatileCell<u32>,
}

/// A timer that counts down.
#[repr(C)]
pub struct TimerRegisters {
    /// Bit 0: counts; bit 3: interrupts.
    pub control: VolatileCell<u32>,
    /// Its count.
    pub value: VolatileCell<u32>,
    /// What it begins at again after 0; with 0 it stops there.
    pub reload: VolatileCell<u32>,
    /// Bit 0: it has reached 0; writing a 1 clears it.
    pub interrupts: VolatileCell<u32>,
}

/// The first half of the dual timer.
#[repr(C)]
pub struct DualTimerRegisters {
    /// What it begins at, now and after each 0.
    pub load: VolatileCell<u32>,
    /// Its count.
    pub value: VolatileCell<u32>,
    /// Bit 1: 32 bits wide; bit 5: interrupts; bit 6: begins anew at `load`; bit 7: counts.
    pub control: VolatileCell<u32>,
    /// Writing anything clears the interrupt.
    pub interrupt_clear: VolatileCell<u32>,
}

/// The processor's own timer, which counts down.
#[repr(C)]
pub struct SystickRegisters {
    /// Bit 0: counts; bit 1: makes the exception; bit 2: by the processor's clock.
    pub control: VolatileCell<u32>,
    /// What it begins at again after 0.
    pub reload: VolatileCell<u32>,
    /// Its count; writing anything makes it 0.
    pub value: VolatileCell<u32>,
}

/// A block of sixteen pins.
#[repr(C)]
pub struct GpioRegisters {
    /// Levels of the pins.
    pub data: VolatileCell<u32>,
    /// Levels that are put out.
    pub output: VolatileCell<u32>,
    reserved: [u32; 2],
    /// Writing a 1 makes its pin an output.
    pub output_enable: VolatileCell<u32>,
    /// Writing a 1 makes its pin an input.
    pub output_disable: VolatileCell<u32>,
    /// Writing a 1 gives its pin to another function.
    pub alternate_set: VolatileCell<u32>,
    /// Writing a 1 takes its pin back.
    pub alternate_clear: VolatileCell<u32>,
}

const _: () = assert!(core::mem::offset_of!(GpioRegisters, alternate_clear) == 0x1c);

/// The first of the board's own registers.
#[repr(C)]
pub struct IoRegisters {
    /// Bits 0 and 1: the LEDs of the user.
    pub led: VolatileCell<u32>,
    reserved: u32,
    /// Bits 0 and 1: the buttons of the user, 1 where pressed. QEMU has none: they read 0.
    pub button: VolatileCell<u32>,
}

const _: () = assert!(core::mem::offset_of!(IoRegisters, button) == 8);

/// The watchdog.
#[repr(C)]
pub struct WatchdogRegisters {
    /// What it begins at.
    pub load: VolatileCell<u32>,
    /// Its count.
    pub value: VolatileCell<u32>,
    /// Bit 0: counts and interrupts; bit 1: resets where it reaches 0 with the interrupt still there.
    pub control: VolatileCell<u32>,
    /// Writing anything clears the interrupt and begins at `load` again.
    pub interrupt_clear: VolatileCell<u32>,
    reserved: [u32; 0x2fc],
    /// Writing [`WATCHDOG_UNLOCK`] opens the registers, anything else closes them.
    pub lock: VolatileCell<u32>,
}

const _: () = assert!(core::mem::offset_of!(WatchdogRegisters, lock) == 0xc00);

/// Opens the watchdog's registers.
pub const WATCHDOG_UNLOCK: u32 = 0x1acc_e551;

/// Where the timer stands that the clock reads, from any task.
const CLOCK_TIMER: usize = 0x4000_0000;

/// The peripherals this crate uses.
pub struct Peripherals {
    /// Timer 0.
    pub timer0: Registers<TimerRegisters>,
    /// Timer 1.
    pub timer1: Registers<TimerRegisters>,
    /// The dual timer's first half.
    pub dual_timer: Registers<DualTimerRegisters>,
    /// UARTs 0 to 4.
    pub uarts: [Registers<UartRegisters>; 5],
    /// The watchdog.
    pub watchdog: Registers<WatchdogRegisters>,
    /// The processor's own timer.
    pub systick: Registers<SystickRegisters>,
    /// Blocks 0 to 2 of pins.
    pub ports: [Registers<GpioRegisters>; 3],
    /// LEDs and buttons.
    pub io: Registers<IoRegisters>,
}

impl Peripherals {
    /// All of them: RTIC calls this, once.
    ///
    /// # Safety
    /// Whoever else has them leaves them alone from now on.
    #[must_use]
    pub const unsafe fn steal() -> Self {
        // SAFETY: addresses are the boards'; the caller vouches for there being no other holder.
        unsafe {
            Self {
                timer0: Registers::at(CLOCK_TIMER),
                timer1: Registers::at(0x4000_1000),
                dual_timer: Registers::at(0x4000_2000),
                uarts: [
                    Registers::at(0x4000_4000),
                    Registers::at(0x4000_5000),
                    Registers::at(0x4000_6000),
                    Registers::at(0x4000_7000),
                    Registers::at(0x4000_9000),
                ],
                watchdog: Registers::at(0x4000_8000),
                systick: Registers::at(0xe000_e010),
                ports: [Registers::at(0x4001_0000), Registers::at(0x4001_1000), Registers::at(0x4001_2000)],
                io: Registers::at(0x4002_8000),
            }
        }
    }
}

/// The count of timer 0, which [`crate::clock`] runs, from any task.
#[must_use]
pub(crate) fn clock_value() -> u32 {
    // SAFETY: reading this register changes nothing.
    unsafe { Registers::<TimerRegisters>::at(CLOCK_TIMER) }.value.get()
}

pub use Interrupt as interrupt;

/// An entry of the vector table.
#[repr(transparent)]
pub struct Vector(pub unsafe extern "C" fn());

/// Numbers the interrupts from 0 on and lays out their vectors; `device.x` gives those that no task binds a handler.
macro_rules! interrupts {
    ($($name:ident),+ $(,)?) => {
        /// The interrupts, by their lines.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u16)]
        pub enum Interrupt {
            $(#[doc = stringify!($name)] $name),+
        }

        #[cfg(target_os = "none")]
        mod vectors {
            use super::{Interrupt, Vector};

            unsafe extern "C" {
                $(fn $name();)+
            }

            /// Behind the processor's own vectors, where cortex-m-rt puts this section.
            #[unsafe(link_section = ".vector_table.interrupts")]
            #[unsafe(no_mangle)]
            static __INTERRUPTS: [Vector; [$(Interrupt::$name),+].len()] = [$(Vector($name)),+];
        }
    };
}

interrupts!(
    UART0RX, UART0TX, UART1RX, UART1TX, UART2RX, UART2TX, PORT0, PORT1, TIMER0, TIMER1, DUALTIMER, SPI, UARTOVF,
    ETHERNET, I2S, TOUCH, PORT2, PORT3, UART3RX, UART3TX, UART4RX, UART4TX,
);

// SAFETY: the numbers are those of the boards' interrupt controller, and each is another one.
unsafe impl cortex_m::interrupt::InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        self as u16
    }
}

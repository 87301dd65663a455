//! What moves motors: steps and directions of four axes at pins, the currents of one motor's two coils by PWM, and the drivers' enable.
//!
//! - **Walk:** interpolation → [`StepPins::write`], [`PhasePins::write`] → pins. A backstop → [`Enable::set`].
//! - **Invariants:** from the board's start on every pin here is driven: steps and directions low, both coils without current, drivers off.
//!   Before that, in a reset, the pads pull down. What [`StepPins::write`] changes changes with one store, all axes at the same cycle.
//! - **Context:** interpolation; each part has one owner. [`Enable`] may be another task's.
//!
//! | pin | on the Pico | is | pin | on the Pico | is |
//! |---|---|---|---|---|---|
//! | GPIO6 | 9 | step, axis 0 | GPIO7 | 10 | direction, axis 0 |
//! | GPIO8 | 11 | step, axis 1 | GPIO9 | 12 | direction, axis 1 |
//! | GPIO10 | 14 | step, axis 2 | GPIO11 | 15 | direction, axis 2 |
//! | GPIO12 | 16 | step, axis 3 | GPIO13 | 17 | direction, axis 3 |
//! | GPIO2 | 4 | coil A, forward | GPIO3 | 5 | coil A, backward |
//! | GPIO26 | 31 | coil B, forward | GPIO27 | 32 | coil B, backward |
//! | GPIO14 | 19 | enable, high is on | | | |
//!
//! The enable belongs at an input that keeps a driver off while it is low or open, as `nSLEEP` of an A4988, DRV8825 or DRV8833 does; one that
//! is on while low (`nENABLE`) needs an inverter. A coil is an H bridge with an input for each direction, such as a DRV8833's: the share of the
//! period that the one is high is the current's size, and which of the two it is its sign; with both low the bridge lets go.

use rp2040_hal::pac;

/// Axes with a step and a direction.
pub const AXES: usize = 4;
/// Coils of the motor that is driven by phases.
pub const COILS: usize = 2;
/// Current of [`PhasePins::write`] at which a bridge is always on: full scale is 1 in Q15.
pub const CURRENT_FULL: i32 = 1 << 15;

/// The first of the pins of [`StepPins`]: step and direction of each axis in turn.
const FIRST_PIN: usize = 6;
/// The pin of [`Enable`].
const ENABLE_PIN: u32 = 14;
/// Slices of the PWM at the coils' pins: channel A forward, channel B backward.
const COIL_SLICES: [usize; COILS] = [1, 5];
/// The pins that these slices are led to.
const COIL_PINS: [[usize; 2]; COILS] = [[2, 3], [26, 27]];
/// Cycles of a period of the coils' PWM: 31.25 kHz, half a beat of 64 µs, above what can be heard.
const PHASE_CYCLES: u32 = 4_000;
/// The atomic-set alias of a peripheral's registers.
const SET_ALIAS: usize = 0x2000;

/// What leads SIO and the PWM to a pin: function numbers of `IO_BANK0`.
const FUNCTION_SIO: u8 = 5;
const FUNCTION_PWM: u8 = 4;

/// Drives all pins of this module: low, off, without current. Behind the reset of SIO's pins, the pads and the PWM.
pub(crate) fn start() -> (StepPins, Phases, Enable) {
    const OUTPUTS: u32 = StepPins::ALL | 1 << ENABLE_PIN;
    // SAFETY: called once, by `Board::init`, which owns SIO, IO_BANK0 and the pads and gives these pins to nobody else; the set and clear
    // registers leave the other pins, and every function number is one that the pin has
    unsafe {
        let (sio, io) = (&*pac::SIO::ptr(), &*pac::IO_BANK0::ptr());
        sio.gpio_out_clr().write(|w| w.bits(OUTPUTS));
        sio.gpio_oe_set().write(|w| w.bits(OUTPUTS));
        let connect = |pin: usize, function| io.gpio(pin).gpio_ctrl().write(|w| w.funcsel().bits(function));
        (0..32).filter(|pin| OUTPUTS >> pin & 1 == 1).for_each(|pin| connect(pin, FUNCTION_SIO));
        COIL_PINS.into_iter().flatten().for_each(|pin| connect(pin, FUNCTION_PWM));
    }
    (StepPins(()), Phases(()), Enable(()))
}

/// Steps and directions.
pub struct StepPins(());

impl StepPins {
    /// All pins of this.
    pub const ALL: u32 = ((1 << (2 * AXES)) - 1) << FIRST_PIN;

    /// The step pin of an axis, as a bit of [`StepPins::write`].
    ///
    /// # Panics
    /// Where there is no such axis, which is a mistake of the image.
    #[must_use]
    pub const fn step(axis: usize) -> u32 {
        assert!(axis < AXES, "no such axis");
        1 << (FIRST_PIN + 2 * axis)
    }

    /// The direction pin of an axis.
    ///
    /// # Panics
    /// As [`StepPins::step`].
    #[must_use]
    pub const fn direction(axis: usize) -> u32 {
        Self::step(axis) << 1
    }

    /// Makes the pins in `clear` low and those in `set` high, which wins; leaves the others. One store changes all; six cycles with it.
    #[inline]
    pub fn write(&mut self, set: u32, clear: u32) {
        let toggled = set ^ (outputs() & (set | clear));
        // SAFETY: of SIO's outputs these pins are the one `StepPins`'s, and no others are turned over
        unsafe { (*pac::SIO::ptr()).gpio_out_xor().write(|w| w.bits(toggled & Self::ALL)) };
    }

    /// The pins that are high.
    #[must_use]
    pub fn levels(&self) -> u32 {
        outputs() & Self::ALL
    }
}

/// What SIO drives.
fn outputs() -> u32 {
    // SAFETY: the block is there for good, and reading its outputs changes nothing
    unsafe { (*pac::SIO::ptr()).gpio_out().read().bits() }
}

/// The drivers' enable, for all axes and coils.
pub struct Enable(());

impl Enable {
    /// Switches the drivers on or off.
    #[inline]
    pub fn set(&mut self, on: bool) {
        // SAFETY: of SIO's outputs this pin is the one `Enable`'s, and setting and clearing leave the others
        unsafe {
            let sio = &*pac::SIO::ptr();
            if on {
                sio.gpio_out_set().write(|w| w.bits(1 << ENABLE_PIN));
            } else {
                sio.gpio_out_clr().write(|w| w.bits(1 << ENABLE_PIN));
            }
        }
    }
}

/// The two coils before their first current: both bridges let go. Where no motor is driven by phases they stay so, and the PWM costs nothing.
pub struct Phases(());

impl Phases {
    /// Starts both slices, without current.
    #[must_use]
    pub fn start(self) -> PhasePins {
        for slice in COIL_SLICES {
            let slice = registers().ch(slice);
            // SAFETY: TOP takes 16 bits, CC two of them
            unsafe {
                slice.top().write(|w| w.bits(PHASE_CYCLES - 1));
                slice.cc().write(|w| w.bits(0));
            }
        }
        let enable = (registers().en().as_ptr() as usize | SET_ALIAS) as *mut u32;
        // SAFETY: the alias sets bits and leaves the other slices'; one store starts both coils' slices at the same cycle
        unsafe { enable.write_volatile(COIL_SLICES.iter().fold(0, |bits, slice| bits | 1 << slice)) };
        PhasePins(())
    }
}

/// Currents of the two coils.
pub struct PhasePins(());

impl PhasePins {
    /// Gives each coil a current, in Q15 of [`CURRENT_FULL`]. Size and sign of one coil change together with the next wrap, within 32 µs; both
    /// coils with the same wrap, unless one falls between the two stores.
    #[inline]
    pub fn write(&mut self, currents: [i16; COILS]) {
        let [a, b] = currents;
        // SAFETY: CC takes any word
        unsafe {
            registers().ch(COIL_SLICES[0]).cc().write(|w| w.bits(compare(a)));
            registers().ch(COIL_SLICES[1]).cc().write(|w| w.bits(compare(b)));
        }
    }
}

/// The compare word of a coil's slice: how many cycles of a period the forward pin is high in its low half, the backward pin in its high half.
const fn compare(current: i16) -> u32 {
    let cycles = (current.unsigned_abs() as u32 * PHASE_CYCLES + CURRENT_FULL.cast_unsigned() / 2) >> 15;
    if current < 0 { cycles << 16 } else { cycles }
}

fn registers() -> &'static pac::pwm::RegisterBlock {
    // SAFETY: the block is there for good; the coils' slices belong to the one `PhasePins`
    unsafe { &*pac::PWM::ptr() }
}

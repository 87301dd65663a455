//! Why the device was reset: what the chip tells, and a report that outlives the reset.
//!
//! - **Walk:** a handler → [`reset_with`] → reset → start-up → `take_report`.
//! - **Invariants:** the report lies in DTCM, which a reset leaves as it was and start-up does not touch, at the same place in every image.
//!   Each of its words is written whole: this memory has a check for each 32-bit word, and a part of a word would wait in the memory's
//!   own buffer, where a reset loses it (RM0433, 2.4; AN5342). After power-on it is written before it is read, since the check of what
//!   was never written may fail. No cache lies in between.
//! - **Context:** start-up; handlers, with everything else stopped.

use core::mem::MaybeUninit;
use core::ptr::addr_of_mut;
use firmware_app::report::{REPORT_WORDS, Report};
use stm32h7xx_hal::pac;

#[unsafe(link_section = ".kept")]
static mut REPORT: MaybeUninit<[u32; REPORT_WORDS]> = MaybeUninit::uninit();

/// What the last reset came from, as far as it matters here.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Cause {
    /// Memory holds nothing: power came, or it had fallen too low.
    Power,
    /// The independent watchdog.
    Watchdog,
    /// The pin, or software.
    Other,
}

impl Cause {
    /// Reads `RCC_RSR` and clears it for the next time (RM0433, 8.4.4, reset source identification).
    pub(crate) fn take(rcc: &pac::RCC) -> Self {
        let flags = rcc.rsr.read();
        rcc.rsr.modify(|_, w| w.rmvf().set_bit());
        if flags.porrstf().bit_is_set() || flags.borrstf().bit_is_set() {
            Self::Power
        } else if flags.iwdg1rstf().bit_is_set() {
            Self::Watchdog
        } else {
            Self::Other
        }
    }
}

/// The report left before the last reset, once. Called once, at start-up.
pub(crate) fn take_report(cause: Cause) -> Option<Report> {
    let mut words = [0; REPORT_WORDS];
    if cause != Cause::Power {
        for (at, word) in words.iter_mut().enumerate() {
            // SAFETY: within the report; any bits are a word, and handlers that write it do not return
            *word = unsafe { place().add(at).read_volatile() };
        }
    }
    let report = Report::decode(&mut words);
    write(&words);
    report.or_else(|| (cause == Cause::Watchdog).then(Report::watchdog))
}

/// Leaves a report and starts anew. For handlers of panics and faults.
pub fn reset_with(report: &Report) -> ! {
    cortex_m::interrupt::disable();
    let mut words = [0; REPORT_WORDS];
    report.encode(&mut words);
    write(&words);
    // with its barriers, before which the words are in memory
    cortex_m::peripheral::SCB::sys_reset()
}

/// Writes the report, word by word.
fn write(words: &[u32; REPORT_WORDS]) {
    for (at, word) in words.iter().enumerate() {
        // SAFETY: within the report; called at start-up or with interrupts masked, so that nobody else touches it
        unsafe { place().add(at).write_volatile(*word) };
    }
}

fn place() -> *mut u32 {
    addr_of_mut!(REPORT).cast()
}

//! What ends a run: panic, fault, watchdog. Each writes down why and resets the device.
//!
//! - **Walk:** handler → [`Region::report`](board_mps2_an386::kept::Region::report) → reset → `past_reports` → `osap debug`.
//! - **Invariant:** nothing of the program runs on after any of these.
//! - **Context:** handlers, above every task. **Clause:** `[DSC-06]`.

use board_mps2_an386::{REGION, now};
use core::panic::PanicInfo;
use cortex_m_rt::{ExceptionFrame, exception};
use firmware_app::report::Report;

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    restart(&Report::panic(info, now().as_us()))
}

// SAFETY: it replaces the handler of that name, and goes back to nothing that the fault may have spoilt.
#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    // SAFETY: reading the status of the fault changes nothing.
    let status = unsafe { (*cortex_m::peripheral::SCB::PTR).cfsr.read() };
    restart(&Report::fault(frame.pc(), frame.lr(), status, now().as_us()))
}

/// The watchdog's first word; were this handler to hang, its second one would be a reset.
// SAFETY: as above.
#[exception]
unsafe fn NonMaskableInt() {
    restart(&Report::watchdog())
}

/// Resets the device, after what `report` says was written down.
fn restart(report: &Report) -> ! {
    cortex_m::interrupt::disable();
    // SAFETY: interrupts are masked, and what follows never returns.
    unsafe { REGION.report(report) };
    cortex_m::peripheral::SCB::sys_reset()
}

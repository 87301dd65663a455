//! What ends a run: panic, fault, watchdog. Each writes down why, where the feature `report` is on, and resets the device.
//!
//! - **Walk:** handler → [`Region::restart`](board_mps2_an500::kept::Region::restart) → reset → `past_reports` → `osap debug`.
//! - **Invariant:** nothing of the program runs on after any of these.
//! - **Context:** handlers, above every task. **Clause:** `[DSC-06]`.

use board_mps2_an500::REGION;
use core::panic::PanicInfo;
use cortex_m_rt::{ExceptionFrame, exception};

#[cfg(feature = "report")]
use board_mps2_an500::now;
#[cfg(feature = "report")]
use firmware_app::report::Report;

#[panic_handler]
#[cfg_attr(not(feature = "report"), expect(unused_variables, reason = "nobody is told"))]
fn panic(info: &PanicInfo<'_>) -> ! {
    #[cfg(feature = "report")]
    REGION.restart(Some(&Report::panic(info, now().as_us())));
    #[cfg(not(feature = "report"))]
    REGION.restart(None)
}

// SAFETY: it replaces the handler of that name and goes back to nothing that the fault may have spoilt.
#[exception]
#[cfg_attr(not(feature = "report"), expect(unused_variables, reason = "nobody is told"))]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    #[cfg(feature = "report")]
    {
        // SAFETY: reading the status of the fault changes nothing.
        let status = unsafe { (*cortex_m::peripheral::SCB::PTR).cfsr.read() };
        REGION.restart(Some(&Report::fault(frame.pc(), frame.lr(), status, now().as_us())))
    }
    #[cfg(not(feature = "report"))]
    REGION.restart(None)
}

/// The watchdog's, which comes first; the reset it makes of itself comes as long after.
#[cfg(feature = "watchdog")]
#[exception]
// SAFETY: as above.
unsafe fn NonMaskableInt() {
    #[cfg(feature = "report")]
    REGION.restart(Some(&Report::watchdog()));
    #[cfg(not(feature = "report"))]
    REGION.restart(None)
}

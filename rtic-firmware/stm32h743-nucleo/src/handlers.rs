//! What ends a run: panic and fault. Each writes down why, where the feature `report` is on, and resets the device.
//!
//! - **Walk:** handler → `board_stm32h743_nucleo::kept::reset_with` → reset → [`tell`] → `osap debug`.
//! - **Invariant:** nothing of the program runs on after any of these. The watchdog resets by itself; its report is made after that.
//! - **Context:** handlers, above every task. **Clause:** `[DSC-06]`.

use board_stm32h743_nucleo::clock::now;
use core::panic::PanicInfo;
use cortex_m_rt::{ExceptionFrame, exception};
use firmware_app::report::Report;

/// Writes a report's lines to the node's debug events.
#[cfg(feature = "report")]
pub(crate) fn tell(node: &mut crate::device::NucleoNode, report: &Report) {
    use osap_protocol::discovery::{Event, Verbosity};
    report.lines().for_each(|line| node.debug_mut().record(Verbosity::Events, now(), || Event::Text(line)));
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    restart(|| Report::panic(info, now().as_us()))
}

// SAFETY: it is called by the hardware alone, reads the frame it is given, and goes back to nothing that the fault may have spoilt
#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    // SAFETY: reading the status of the fault, SCB_CFSR, changes nothing
    let status = unsafe { (*cortex_m::peripheral::SCB::PTR).cfsr.read() };
    restart(|| Report::fault(frame.pc(), frame.lr(), status, now().as_us()))
}

/// Starts anew, after `why` was written down.
#[cfg(feature = "report")]
fn restart(why: impl FnOnce() -> Report) -> ! {
    board_stm32h743_nucleo::kept::reset_with(&why())
}

/// Starts anew; nobody is told why.
#[cfg(not(feature = "report"))]
fn restart(_: impl FnOnce() -> Report) -> ! {
    cortex_m::peripheral::SCB::sys_reset()
}

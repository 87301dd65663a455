//! Panics and faults: a report that outlives the reset they end in.
//!
//! - **Context:** everything else has stopped. **Clause:** `[DSC-06]` for the events made of a report.

use crate::device::PicoNode;
use board_rp2040_pico::{clock, reset_with};
use core::panic::PanicInfo;
use cortex_m_rt::ExceptionFrame;
use firmware_app::report::Report;
use osap_protocol::discovery::{Event, Verbosity};

/// Writes a report's lines to the node's debug events.
pub(crate) fn tell(node: &mut PicoNode, report: &Report) {
    let now = clock::now();
    for line in report.lines() {
        node.debug_mut().record(Verbosity::Events, now, || Event::Text(line));
    }
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    reset_with(&Report::panic(info, clock::now_us()))
}

// SAFETY: it is called by the hardware alone, reads the frame it is given, and does not return
#[cortex_m_rt::exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    // a Cortex-M0+ has no fault status
    reset_with(&Report::fault(frame.pc(), frame.lr(), 0, clock::now_us()))
}

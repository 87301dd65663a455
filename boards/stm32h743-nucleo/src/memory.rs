//! Caches, and what they are kept from.
//!
//! - **Invariants:** no other master writes what is cached: UARTs are served by interrupt, USB through its FIFOs, nothing by DMA. All
//!   data and the stack lie in DTCM, which caches never hold. So the caches serve code and constants in flash bank 1, which do not
//!   change, and need no upkeep at all. Who adds DMA puts its buffers into SRAM1 or SRAM2 (DMA does not reach DTCM), in a region that is
//!   set up here as not cached.
//! - **Context:** start-up, once.

use crate::flash;

/// `MPU_RASR` (ARMv7-M, B3.5.9): never code; read and written; shared device memory; 2^20 bytes; on.
const DEVICE_1_MIB: u32 = 1 << 28 | 0b011 << 24 | 1 << 18 | 1 << 16 | (20 - 1) << 1 | 1;
/// `MPU_CTRL` (ARMv7-M, B3.5.5): all else as without it; on at faults' priority too, where settings are read; on.
const ON: u32 = 1 << 2 | 1 << 1 | 1;

/// Makes flash bank 2 device memory, then turns both caches on.
pub(crate) fn set_up(mut core: cortex_m::Peripherals) {
    // SAFETY: only bank 2 changes its kind, which neither code nor data is in; barriers follow before it is used
    unsafe {
        core.MPU.rnr.write(0);
        core.MPU.rbar.write(flash::BANK);
        core.MPU.rasr.write(DEVICE_1_MIB);
        core.MPU.ctrl.write(ON);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
    core.SCB.enable_icache();
    core.SCB.enable_dcache(&mut core.CPUID);
}

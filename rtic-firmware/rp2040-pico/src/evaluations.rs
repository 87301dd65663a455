//! Cycles of what a beat calls, in this image: what stands before and behind each loop is an edge.
//!
//! - **Walk:** `init` → [`run`] → `fixed_math::kernels` → GPIO16 goes high before a loop and low behind it → who measures its pulses.
//! - **Context:** before any interrupt is enabled, once. **Variant:** with the feature `evaluate` alone.

#![expect(unreachable_pub, reason = "as its neighbours")]

use board_rp2040_pico::signals::SignalPins;

/// Runs all loops. Apart from `init`, whose frame is large as it is.
#[inline(never)]
pub fn run(pins: &mut SignalPins) {
    fixed_math::kernels::run(&mut |is_high| pins.write(u8::from(is_high)));
}

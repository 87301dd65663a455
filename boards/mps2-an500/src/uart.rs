//! A UART as a wire of `firmware-app`: bytes in by interrupt through a ring, frames out by interrupt from a buffer.
//!
//! - **Walk:** receive interrupt → [`UartRx::on_interrupt`] → ring → [`Uart::drain`]; [`Uart::send`] → transmit interrupt →
//!   [`UartTx::on_interrupt`], a byte at a time → the wire.
//! - **Invariants:** a byte's stamp is taken first thing in its interrupt. The buffer of the frame on its way out belongs either to the
//!   task or to the interrupt: it is moved from one to the other and back through two queues, so that neither can touch it meanwhile.
//!   Each interrupt handles one byte, so that none holds up the other UARTs for longer.
//! - **Context:** the interrupts at the links' priority, O(1); [`Uart`] in the routing task.
//! - **Clauses:** `[NOD-08]`, `[FRM-08]`.
//!
//! A byte that the UART itself loses, as its buffer of one was full, leaves a frame that fails its check and is counted as such. QEMU
//! loses none: it offers a byte once there is room.

use crate::clock::now;
#[cfg(feature = "probe")]
use crate::latency::{Count, count};
use crate::pac::{Interrupt, Registers, UartRegisters};
use cortex_m::peripheral::NVIC;
use firmware_app::Wire;
use firmware_app::link::drain_ring;
use fixed_math::time::LocalTicks;
use heapless::spsc::{Consumer, Producer, Queue};
use osap_protocol::framing::{Check, DELIMITER, encoded_len_max};
use osap_runtime::ring::{Capture, HandOver, RxRing};

/// UARTs of the board.
pub const UART_COUNT: usize = 5;
/// Bytes of the longest packet.
pub const MTU_BYTES: u16 = 256;
/// Guard of the frames.
pub const CHECK: Check = Check::Crc16;
/// The divider that gives the highest bit rate there is.
const DIVIDER: u32 = 16;
/// Bits a second. QEMU carries bytes as fast as it can, whatever is set.
pub const BIT_RATE: u32 = 25_000_000 / DIVIDER;

/// Bytes of the longest frame.
pub const FRAME_BYTES: usize = encoded_len_max(MTU_BYTES as usize, CHECK);
/// Bytes a receive ring holds, and one: nearly two of the longest frames, 3.3 ms of the wire at its bit rate.
const RING_BYTES: usize = 512;
/// Frames a receive ring holds, and one.
const RING_FRAMES: usize = 16;

const TX: u32 = 1;
const RX: u32 = 1 << 1;
/// Control: both directions and both interrupts.
const ALL_ON: u32 = 0b1111;

/// A frame's place in memory.
type Frame = [u8; FRAME_BYTES];
/// A frame on its way out and its length.
type Outgoing = (&'static mut Frame, usize);

/// Memory of one UART.
pub struct UartBuffers {
    ring: RxRing<RING_BYTES, RING_FRAMES>,
    frame: Frame,
    outgoing: Queue<Outgoing, 2>,
    returned: Queue<&'static mut Frame, 2>,
}

impl UartBuffers {
    /// Empty.
    #[must_use]
    pub const fn new() -> Self {
        Self { ring: RxRing::new(), frame: [0; FRAME_BYTES], outgoing: Queue::new(), returned: Queue::new() }
    }
}

impl Default for UartBuffers {
    fn default() -> Self {
        Self::new()
    }
}

/// A UART's three users.
pub struct UartParts {
    /// For the routing task.
    pub wire: Uart,
    /// For the receive interrupt.
    pub rx: UartRx,
    /// For the transmit interrupt.
    pub tx: UartTx,
}

/// Turns a UART on.
pub(crate) fn start(
    registers: Registers<UartRegisters>,
    interrupt: Interrupt,
    buffers: &'static mut UartBuffers,
) -> UartParts {
    registers.divider.set(DIVIDER);
    registers.control.set(ALL_ON);
    // SAFETY: the receive half reads the data register, the transmit half writes it; each clears its own interrupt alone.
    let rx_registers = unsafe { registers.share() };
    let (capture, ring) = buffers.ring.split();
    let (outgoing_in, outgoing_out) = buffers.outgoing.split();
    let (returned_in, returned_out) = buffers.returned.split();
    UartParts {
        wire: Uart { ring, room: Some(&mut buffers.frame), outgoing: outgoing_in, returned: returned_out, interrupt },
        rx: UartRx { registers: rx_registers, capture },
        tx: UartTx { registers, sending: None, sent: 0, outgoing: outgoing_out, returned: returned_in },
    }
}

/// The routing task's part of a UART.
pub struct Uart {
    ring: HandOver<'static>,
    /// The frame's buffer, where it is not with the interrupt.
    room: Option<&'static mut Frame>,
    outgoing: Producer<'static, Outgoing>,
    returned: Consumer<'static, &'static mut Frame>,
    /// The transmit interrupt.
    interrupt: Interrupt,
}

impl Wire for Uart {
    fn drain(&mut self, _now: LocalTicks, take: impl FnMut(&[u8], LocalTicks)) {
        drain_ring(&mut self.ring, take);
    }

    fn take_overruns(&mut self) -> u32 {
        self.ring.take_overruns()
    }

    fn clear_at(&mut self, now: LocalTicks) -> Option<LocalTicks> {
        if self.room.is_none() {
            self.room = self.returned.dequeue();
        }
        self.room.is_some().then_some(now)
    }

    fn room(&mut self) -> &mut [u8] {
        self.room.as_deref_mut().map_or(&mut [], |room| &mut room[..])
    }

    fn send(&mut self, len: usize, _at: LocalTicks) {
        let Some(frame) = self.room.take() else { return };
        // there is one buffer, so a queue of one always has room for it
        let _fits = self.outgoing.enqueue((frame, len.min(FRAME_BYTES)));
        NVIC::pend(self.interrupt);
    }
}

/// The receive interrupt's part of a UART.
pub struct UartRx {
    registers: Registers<UartRegisters>,
    capture: Capture<'static>,
}

impl UartRx {
    /// The body of the receive interrupt: whether a frame ended, so that routing has something to do.
    pub fn on_interrupt(&mut self) -> bool {
        let now = now();
        // cleared before the byte is taken, since the next one may come at once and ask for an interrupt of its own
        self.registers.interrupts.set(RX);
        if self.registers.state.get() & RX == 0 {
            return false;
        }
        let [byte, ..] = self.registers.data.get().to_le_bytes();
        self.capture.push(byte, now);
        #[cfg(feature = "probe")]
        count(Count::BytesIn);
        byte == DELIMITER
    }
}

/// The transmit interrupt's part of a UART.
pub struct UartTx {
    registers: Registers<UartRegisters>,
    sending: Option<Outgoing>,
    /// Bytes of it that were given to the UART.
    sent: usize,
    outgoing: Consumer<'static, Outgoing>,
    returned: Producer<'static, &'static mut Frame>,
}

impl UartTx {
    /// The body of the transmit interrupt: whether a frame has left, so that routing may send the next.
    pub fn on_interrupt(&mut self) -> bool {
        self.registers.interrupts.set(TX);
        if self.registers.state.get() & TX != 0 {
            return false; // it comes again once the byte has left
        }
        if self.sending.is_none() {
            self.sending = self.outgoing.dequeue();
            self.sent = 0;
        }
        let Some((frame, len)) = &mut self.sending else { return false };
        if self.sent < *len {
            self.registers.data.set(u32::from(frame[self.sent]));
            self.sent += 1;
            #[cfg(feature = "probe")]
            count(Count::BytesOut);
            return false;
        }
        if let Some((frame, _)) = self.sending.take() {
            // the task gave the one there is, so there is room to give it back
            let _fits = self.returned.enqueue(frame);
        }
        #[cfg(feature = "probe")]
        count(Count::FramesOut);
        true
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::boxed::Box;
    use std::vec::Vec;
    use vcell::VolatileCell;

    /// A UART over memory in place of registers.
    fn uart() -> (&'static UartRegisters, UartParts) {
        let zero = || VolatileCell::new(0);
        let registers: &UartRegisters = Box::leak(Box::new(UartRegisters {
            data: zero(),
            state: zero(),
            control: zero(),
            interrupts: zero(),
            divider: zero(),
        }));
        let buffers = Box::leak(Box::new(UartBuffers::new()));
        (registers, start(Registers::of(registers), Interrupt::UART0TX, buffers))
    }

    /// A frame goes out byte by byte, none while the last has not left, and its buffer comes back when all have.
    #[test]
    fn a_frame_leaves_once_and_its_buffer_comes_back() {
        let (registers, UartParts { mut wire, mut tx, .. }) = uart();
        assert_eq!((registers.divider.get(), registers.control.get()), (16, 0b1111));
        let now = LocalTicks::from_us(5);
        for frame in [&b"abc"[..], b"z"] {
            assert_eq!(wire.clear_at(now), Some(now));
            wire.room()[..frame.len()].copy_from_slice(frame);
            let room = wire.room.take().unwrap(); // as `send` does, but for the pending
            assert!(wire.outgoing.enqueue((room, frame.len())).is_ok());
            assert_eq!(wire.clear_at(now), None);
            let mut left = Vec::new();
            loop {
                registers.state.set(TX);
                registers.data.set(0);
                assert!(!tx.on_interrupt() && registers.data.get() == 0, "nothing is written while the UART is full");
                registers.state.set(0);
                if tx.on_interrupt() {
                    break;
                }
                left.push(u8::try_from(registers.data.get()).unwrap());
            }
            assert_eq!(left, frame);
            assert!(!tx.on_interrupt(), "said once");
        }
        assert_eq!(wire.clear_at(now), Some(now));
    }
}

//! A UART as a link's wire: bytes in by interrupt through a ring, frames out by interrupt from a buffer.
//!
//! - **Walk:** interrupt → [`UartInterrupt::on_interrupt`] → ring → [`Uart::drain`]; [`Uart::send`] pends the interrupt → the transmit
//!   FIFO, refilled when half of it is empty → the wire.
//! - **Invariants:** a stamp is taken first thing in the interrupt that a byte asks for when it has come whole. The buffer of the frame on
//!   its way out belongs either to the task or to the interrupt: it is moved from one to the other and back through two queues, so that
//!   neither can touch it meanwhile. An interrupt moves at most what the FIFOs hold and a byte more, each way.
//! - **Context:** the interrupt at the links' priority; [`Uart`] in the routing task. **Clauses:** `[NOD-08]`, `[FRM-08]`.
//!
//! The receive FIFO holds 16 bytes, 53 µs at 3 Mbaud: so long may an interrupt wait before bytes are lost. Its stamps are late by as much
//! as it waited: for the other UARTs' interrupts, and for the USB driver's critical sections, which copy up to 64 bytes.
//!
//! What a byte costs: by a model of the processor (llvm-mca 22, cortex-m7, registers taken to answer at once), the interrupt takes 125
//! cycles for one byte, so that three links at full load, 900,000 bytes a second, take 29 % of the processor. Entering and leaving, and
//! five accesses to registers at 96 MHz, come on top. Bytes that wait are taken together, so that under load it is less for each.
//!
//! Bytes the UART itself loses are counted as an overrun, and the frame they were cut from fails its check besides.
//!
//! Registers: RM0433 (rev 7), chapter 48, USART: the FIFOs in 48.4, `USART_ISR` in 48.7.9.

use crate::clock;
use core::sync::atomic::{AtomicU32, Ordering};
use cortex_m::peripheral::NVIC;
use firmware_app::Wire;
use firmware_app::link::drain_ring;
use fixed_math::time::{LocalTicks, Span};
use heapless::spsc::{Consumer, Producer, Queue};
use osap_protocol::framing::{Check, DELIMITER, encoded_len_max};
use osap_runtime::ring::{Capture, HandOver, RxRing};
use stm32h7xx_hal::pac;
use stm32h7xx_hal::pac::usart1::RegisterBlock;

/// UARTs of the board.
pub const UART_COUNT: usize = 3;
/// Bits a second: the kernel clock of 96 MHz divided by 32, exactly.
pub const BIT_RATE: u32 = 3_000_000;
/// Start bit, eight bits, stop bit.
pub const BITS_A_BYTE: u8 = 10;
/// Bytes of the longest packet.
pub const MTU_BYTES: u16 = 256;
/// Guard of the frames.
pub const CHECK: Check = Check::Crc16;
/// Bytes of the longest frame.
pub const FRAME_BYTES: usize = encoded_len_max(MTU_BYTES as usize, CHECK);

/// Bytes a receive ring holds, and one: 3.4 ms of the wire.
const RING_BYTES: usize = 1024;
/// Frames a receive ring holds, and one: as many of 16 bytes as there is room for.
const RING_FRAMES: usize = 64;
/// What each FIFO holds, bytes.
const FIFO_BYTES: usize = 16;
/// Routing is woken after so many bytes although no frame has ended, so that most of a long one is unstuffed when it does.
const WAKE_BYTES: u8 = 32;
/// Steps of `LocalTicks` in 3 bytes.
const STEPS_A_3_BYTES: u64 = 3 * BITS_A_BYTE as u64 * 256 / (BIT_RATE as u64 / 1_000_000);

/// The interrupts that [`Uart::send`] pends.
pub(crate) const INTERRUPTS: [pac::Interrupt; UART_COUNT] =
    [pac::Interrupt::USART3, pac::Interrupt::USART2, pac::Interrupt::UART7];

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
    /// How often the receive FIFO ran over; written by the interrupt alone.
    lost: AtomicU32,
}

impl UartBuffers {
    /// Empty.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            ring: RxRing::new(),
            frame: [0; FRAME_BYTES],
            outgoing: Queue::new(),
            returned: Queue::new(),
            lost: AtomicU32::new(0),
        }
    }
}

impl Default for UartBuffers {
    fn default() -> Self {
        Self::new()
    }
}

/// The registers of one UART, which the interrupt alone uses.
pub(crate) struct Registers(*const RegisterBlock);

// SAFETY: the address of registers that are the same from every context
unsafe impl Send for Registers {}

impl Registers {
    /// Those at `block`.
    ///
    /// # Safety
    /// It is a UART's that is set up, and nobody else uses it from here on.
    pub(crate) const unsafe fn new(block: *const RegisterBlock) -> Self {
        Self(block)
    }

    fn get(&self) -> &RegisterBlock {
        // SAFETY: as `new` demands
        unsafe { &*self.0 }
    }
}

/// Gives a UART that is set up to its two users.
pub(crate) fn start(
    registers: Registers,
    interrupt: pac::Interrupt,
    buffers: &'static mut UartBuffers,
) -> (Uart, UartInterrupt) {
    // USART_CR1: RXNEIE, which is RXFNEIE with FIFOs on. An overrun asks for the same interrupt.
    registers.get().cr1.modify(|_, w| w.rxneie().set_bit());
    let (capture, ring) = buffers.ring.split();
    let (to_interrupt, from_task) = buffers.outgoing.split();
    let (to_task, from_interrupt) = buffers.returned.split();
    let lost = &buffers.lost;
    let uart = Uart {
        ring,
        lost,
        lost_seen: 0,
        room: Some(&mut buffers.frame),
        to_interrupt,
        from_interrupt,
        interrupt,
        sent_at: LocalTicks::ZERO,
    };
    (uart, UartInterrupt { registers, capture, lost, unannounced: 0, sending: None, sent: 0, from_task, to_task })
}

/// The routing task's part of a UART.
pub struct Uart {
    ring: HandOver<'static>,
    lost: &'static AtomicU32,
    lost_seen: u32,
    /// The frame's buffer, where it is not with the interrupt.
    room: Option<&'static mut Frame>,
    to_interrupt: Producer<'static, Outgoing>,
    from_interrupt: Consumer<'static, &'static mut Frame>,
    interrupt: pac::Interrupt,
    /// When the last byte given to the UART has left.
    sent_at: LocalTicks,
}

impl Wire for Uart {
    fn drain(&mut self, _now: LocalTicks, take: impl FnMut(&[u8], LocalTicks)) {
        drain_ring(&mut self.ring, take);
    }

    fn take_overruns(&mut self) -> u32 {
        let lost = self.lost.load(Ordering::Relaxed);
        let by_uart = lost.wrapping_sub(core::mem::replace(&mut self.lost_seen, lost));
        self.ring.take_overruns() + by_uart
    }

    fn clear_at(&mut self, now: LocalTicks) -> Option<LocalTicks> {
        if self.room.is_none() {
            self.room = self.from_interrupt.dequeue();
        }
        self.room.is_some().then(|| self.sent_at.max(now))
    }

    fn room(&mut self) -> &mut [u8] {
        self.room.as_deref_mut().map_or(&mut [], |room| &mut room[..])
    }

    fn send(&mut self, len: usize, at: LocalTicks) {
        let Some(frame) = self.room.take() else { return };
        let len = len.min(FRAME_BYTES);
        // there is one buffer, so a queue of one always has room for it
        let _fits = self.to_interrupt.enqueue((frame, len));
        self.sent_at = at + wire_time(len);
        NVIC::pend(self.interrupt);
    }
}

/// How long `bytes` take on the wire, rounded up once.
const fn wire_time(bytes: usize) -> Span {
    Span::from_steps((bytes as u64 * STEPS_A_3_BYTES).div_ceil(3))
}

/// The interrupt's part of a UART.
pub struct UartInterrupt {
    registers: Registers,
    capture: Capture<'static>,
    lost: &'static AtomicU32,
    /// Bytes captured since routing was woken.
    unannounced: u8,
    sending: Option<Outgoing>,
    /// Bytes of it that were given to the UART.
    sent: usize,
    from_task: Consumer<'static, Outgoing>,
    to_task: Producer<'static, &'static mut Frame>,
}

impl UartInterrupt {
    /// The body of the UART's interrupt: whether routing has something to do, as a frame came or has gone to the FIFO.
    pub fn on_interrupt(&mut self) -> bool {
        let now = clock::now();
        let came = self.receive(now);
        self.transmit() | came
    }

    fn receive(&mut self, now: LocalTicks) -> bool {
        let uart = self.registers.get();
        let mut wake = false;
        for _ in 0..=FIFO_BYTES {
            let status = uart.isr.read();
            if status.ore().bit_is_set() {
                uart.icr.write(|w| w.orecf().set_bit());
                // one writer, so a load and a store do
                self.lost.store(self.lost.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
            }
            // RXNE is RXFNE with FIFOs on: one byte at least
            if status.rxne().bit_is_clear() {
                break;
            }
            let [byte, ..] = uart.rdr.read().bits().to_le_bytes();
            self.capture.push(byte, now);
            self.unannounced += 1;
            if byte == DELIMITER || self.unannounced == WAKE_BYTES {
                self.unannounced = 0;
                wake = true;
            }
        }
        wake
    }

    fn transmit(&mut self) -> bool {
        if self.sending.is_none() {
            self.sending = self.from_task.dequeue();
            self.sent = 0;
        }
        let uart = self.registers.get();
        let Some((frame, len)) = &self.sending else { return false };
        for byte in frame[self.sent..*len].iter().take(FIFO_BYTES + 1) {
            // TXE is TXFNF with FIFOs on: room for one byte at least
            if uart.isr.read().txe().bit_is_clear() {
                break;
            }
            uart.tdr.write(|w| w.tdr().bits(u16::from(*byte)));
            self.sent += 1;
        }
        let is_given = self.sent == *len;
        // USART_CR3.TXFTIE: asks for the interrupt while half of the FIFO or more is empty, as long as there is something to fill it
        uart.cr3.modify(|_, w| w.txftie().bit(!is_given));
        if is_given && let Some((frame, _)) = self.sending.take() {
            // the task gave the one there is, so there is room to give it back
            let _fits = self.to_task.enqueue(frame);
        }
        is_given
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A byte of ten bits at 3 Mbaud takes 853.33 steps, and 262 of them 223,573.33.
    #[test]
    fn a_frame_takes_its_bytes_times_ten_bits() {
        assert_eq!([0, 1, 3, 262].map(|bytes| wire_time(bytes).steps()), [0, 854, 2560, 223_574]);
    }
}

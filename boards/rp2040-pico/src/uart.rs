//! UARTs by DMA: each byte that comes is put into a ring and stamped by hardware, each frame that goes is sent without the processor.
//!
//! Three channels a receiver hand over to each other: one moves a byte from the UART to the byte ring, the next copies the sixteenths of a
//! microsecond to a ring of their own and the last the timer's low word to the stamp ring, then the first waits for the next byte. So a stamp
//! is late by a few clock cycles, however long interrupts are masked or the processor is busy.
//!
//! - **Walk:** UART → rings → [`receive`] (interrupt) wakes routing → [`Wire::drain`]; [`Wire::send`] → DMA → UART.
//! - **Invariants:** the rings hold [`RING_BYTES`] bytes, 1.7 ms at 3 Mbaud. A ring that was lapped is noticed by its stamps. Between waking
//!   routing and being drained a UART interrupts no more, so that a busy device spends its time on frames and not on bytes.
//! - **Context:** [`receive`] in `DMA_IRQ_0`, O(bytes since); the rest in the routing task; `DMA_IRQ_1` says that a frame has gone to the
//!   UART, whose FIFO still holds up to 32 bytes of it. **Clauses:** `[FRM-08]`, `[NOD-08]`.

use crate::clock::Stamp;
use crate::{CORE_HZ, UART_BAUD, clock};
use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use firmware_app::Wire;
use fixed_math::time::{LocalTicks, Span};
use osap_protocol::framing::{Check, DELIMITER, encoded_len_max};
use osap_runtime::Stamps;
use rp2040_hal::pac;

/// Bytes and stamps that a receiver's rings hold.
pub const RING_BYTES: usize = 1 << RING_BITS;
const RING_BITS: u32 = 9;
const RING_MASK: usize = RING_BYTES - 1;
/// The longest frame: a packet of 256 bytes.
const FRAME_BYTES: usize = encoded_len_max(256, Check::Crc32);
/// Routing is woken after so many bytes although no frame has ended, so that most of a frame is unstuffed and checked when it does. Each
/// such turn takes about 700 cycles, and 60 more a byte, of the 3,300 in which the bytes come.
const WAKE_BYTES: usize = 8;
/// 1/256 µs a byte of ten bits takes at the rate that the divider makes, times 2^8, rounded up.
const BYTE_STEPS_Q8: u32 =
    ((10 * BIT_CYCLES_Q6 as u64 * (256 * 256 / 64)).div_ceil((CORE_HZ / 1_000_000) as u64)) as u32;

/// How good the stamps of frames are: 1/16 µs, rounded down.
pub const STAMPS: Stamps = Stamps { tick: Span::from_steps(16), wire: DEPARTURE_TO_ARRIVAL, late: Span::ZERO };
/// From the reading of the sixteenths to the write of the first byte: what a load from a peripheral takes.
const STAMP_TO_WRITE_CYCLES: u32 = 4;
/// From the stamp of a departure to that of its arrival, where a wire without length joins two idle transmitters and receivers: 3.301 µs. It is
/// 4 cycles from the stamp to the write that starts the first bit, 9 1/2 bits until the receiver has sampled the middle of the stop bit, and
/// two transfers of the DMA of 6 cycles each, the byte's and the stamp's. Measured in the co-simulation; a chip's UART adds the steps of its
/// bit clock, a sixteenth of a bit each, and a few cycles of synchronisers.
pub const DEPARTURE_TO_ARRIVAL: Span = {
    let cycles_q6 = (STAMP_TO_WRITE_CYCLES + 2 * 6) * 64 + BIT_CYCLES_Q6 * 19 / 2;
    Span::from_steps((cycles_q6 * (256 / 64) / (CORE_HZ / 1_000_000)) as u64)
};
/// An arrival's stamp is late by this at most beyond [`DEPARTURE_TO_ARRIVAL`], with all channels of the DMA at work: 32 cycles, a quarter of a
/// microsecond. 7 for the transfer under way, 6 for one of the other receiver before each of the two, 12 for what the processor has on the same
/// bridge to the peripherals three times. Seen were 17 in the co-simulation, which has no contention on the bridge.
pub const ARRIVAL_LATE_MAX: Span = Span::from_steps((32 * 256 / (CORE_HZ / 1_000_000)) as u64 + 1);
/// Cycles of a bit, in 64ths: sixteen times the divider that is nearest to the rate.
const BIT_CYCLES_Q6: u32 = (CORE_HZ * 4 + UART_BAUD / 2) / UART_BAUD * 16;

/// A ring cannot be lapped in less: all its bytes on end, less one for good measure.
const LAP_MIN: Span = Span::from_steps((RING_BYTES as u64 - 1) * 10 * 256 * 1_000_000 / UART_BAUD as u64);
/// One byte on the wire.
const BYTE: Span = Span::from_steps((BYTE_STEPS_Q8 >> 8) as u64 + 1);
/// Bytes that a UART's transmitter holds.
const FIFO_BYTES: usize = 32;
/// Permanent request: a transfer that waits for nothing.
const TREQ_NONE: u32 = 0x3f;

/// Fields of a channel's control word.
mod ctrl {
    pub(super) const ENABLE: u32 = 1;
    /// Before the channels without it: those that send would make stamps late.
    pub(super) const HIGH_PRIORITY: u32 = 1 << 1;
    pub(super) const WORDS: u32 = 2 << 2;
    pub(super) const INCREMENT_READ: u32 = 1 << 4;
    pub(super) const INCREMENT_WRITE: u32 = 1 << 5;
    pub(super) const RING_ON_WRITE: u32 = 1 << 10;
    pub(super) const QUIET: u32 = 1 << 21;
    pub(super) const BUSY: u32 = 1 << 24;

    pub(super) const fn ring(bits: u32) -> u32 {
        bits << 6
    }

    pub(super) const fn chain_to(channel: usize) -> u32 {
        (channel as u32) << 11
    }

    pub(super) const fn request(number: u32) -> u32 {
        number << 15
    }
}

/// A stamp ring and a ring of bytes or of stamps' sixteenths, each aligned to its size as the DMA's wrapping demands.
#[repr(align(2048))]
struct StampRing(UnsafeCell<[u32; RING_BYTES]>);
#[repr(align(512))]
struct ByteRing(UnsafeCell<[u8; RING_BYTES]>);
struct FrameRoom(UnsafeCell<[u8; FRAME_BYTES]>);

// SAFETY: the DMA writes the rings and the processor reads, by volatile access or behind the DMA's position; a frame's room belongs to the
// one `DmaUart` of its number
unsafe impl Sync for StampRing {}
// SAFETY: as above
unsafe impl Sync for ByteRing {}
// SAFETY: as above
unsafe impl Sync for FrameRoom {}

static RX_STAMP_BUFFER: [StampRing; 2] = [const { StampRing(UnsafeCell::new([0; RING_BYTES])) }; 2];
static RX_SIXTEENTHS_BUFFER: [ByteRing; 2] = [const { ByteRing(UnsafeCell::new([0; RING_BYTES])) }; 2];
static RX_BYTE_BUFFER: [ByteRing; 2] = [const { ByteRing(UnsafeCell::new([0; RING_BYTES])) }; 2];
static TX_FRAME_BUFFER: [FrameRoom; 2] = [const { FrameRoom(UnsafeCell::new([0; FRAME_BYTES])) }; 2];
/// Place up to which bytes were looked at: by the interrupt, or by routing while the interrupt is off.
static RX_SEEN: [AtomicUsize; 2] = [const { AtomicUsize::new(0) }; 2];
/// Bytes since routing was woken last.
static RX_SINCE: [AtomicUsize; 2] = [const { AtomicUsize::new(0) }; 2];
/// The interrupt is off, as there is something to drain. Set by the interrupt, cleared by routing before it looks at the ring.
static RX_WAITS: [AtomicBool; 2] = [const { AtomicBool::new(false) }; 2];

/// DMA channels of one UART.
#[derive(Clone, Copy)]
struct Channels {
    bytes: usize,
    sixteenths: usize,
    stamps: usize,
    transmit: usize,
}

const CHANNELS: [Channels; 2] = [
    Channels { bytes: 0, sixteenths: 6, stamps: 1, transmit: 4 },
    Channels { bytes: 2, sixteenths: 7, stamps: 3, transmit: 5 },
];
/// Request numbers of the UARTs' transmitters and receivers.
const REQUESTS: [(u32, u32); 2] = [(20, 21), (22, 23)];

/// One UART as a link's wire.
pub struct DmaUart {
    number: usize,
    /// Place of the next byte to hand over.
    read: usize,
    /// When the ring was last drained.
    drained_at: LocalTicks,
    overruns: u32,
    /// Bytes of the frame in work that the UART has already.
    head: usize,
    /// When the last byte given to the UART has left.
    sent_at: LocalTicks,
}

/// Sets all channels going. The UARTs are enabled already.
pub(crate) fn start(dma: &pac::DMA, resets: &mut pac::RESETS) -> [DmaUart; 2] {
    resets.reset().modify(|_, w| w.dma().clear_bit());
    while resets.reset_done().read().dma().bit_is_clear() {}
    for number in 0..2 {
        uart(number).uartdmacr().write(|w| w.rxdmae().set_bit().txdmae().set_bit());
        start_receiver(dma, number);
    }
    let receive = 1 << CHANNELS[0].bytes | 1 << CHANNELS[1].bytes;
    let transmit = 1 << CHANNELS[0].transmit | 1 << CHANNELS[1].transmit;
    // SAFETY: these are bits of the channels above
    unsafe {
        dma.inte0().write(|w| w.bits(receive));
        dma.inte1().write(|w| w.bits(transmit));
    }
    [0, 1].map(|number| DmaUart {
        number,
        read: 0,
        drained_at: LocalTicks::ZERO,
        overruns: 0,
        head: 0,
        sent_at: LocalTicks::ZERO,
    })
}

/// A channel that writes one element of 2^`shift` bytes into a ring of [`RING_BYTES`] elements, then has `next` do so.
const fn ring_ctrl(shift: u32, next: usize) -> u32 {
    let ring = ctrl::INCREMENT_WRITE | ctrl::ring(RING_BITS + shift) | ctrl::RING_ON_WRITE;
    ctrl::ENABLE | ctrl::HIGH_PRIORITY | ring | ctrl::chain_to(next)
}

fn start_receiver(dma: &pac::DMA, number: usize) {
    let Channels { bytes, sixteenths, stamps, .. } = CHANNELS[number];
    // in order of their work; what comes last must not be running before the first is triggered
    let setups = [
        (stamps, clock::us_address(), RX_STAMP_BUFFER[number].0.get() as u32),
        (sixteenths, clock::sixteenths_address(), RX_SIXTEENTHS_BUFFER[number].0.get() as u32),
        (bytes, uart(number).uartdr().as_ptr() as u32, RX_BYTE_BUFFER[number].0.get() as u32),
    ];
    let at_once = ctrl::request(TREQ_NONE) | ctrl::QUIET;
    let controls = [
        ctrl::WORDS | ring_ctrl(2, bytes) | at_once,
        ring_ctrl(0, stamps) | at_once,
        ring_ctrl(0, sixteenths) | ctrl::request(REQUESTS[number].1),
    ];
    for ((index, from, to), control) in setups.into_iter().zip(controls) {
        let channel = dma.ch(index);
        // SAFETY: from the counters and the UART's data register, to rings that live for good and are aligned to their size
        unsafe {
            channel.ch_read_addr().write(|w| w.bits(from));
            channel.ch_write_addr().write(|w| w.bits(to));
            channel.ch_trans_count().write(|w| w.bits(1));
            // the first of the three is triggered by its last register, the others by the chain
            if index == bytes {
                channel.ch_ctrl_trig().write(|w| w.bits(control));
            } else {
                channel.ch_al1_ctrl().write(|w| w.bits(control));
            }
        }
    }
}

/// What the receive interrupt does: says whether routing has something to do, since a frame has ended or many bytes wait. The UART it is
/// said for interrupts no more until it was drained.
#[must_use]
pub fn receive() -> bool {
    let pending = dma().ints0().read().bits();
    // SAFETY: ending interrupts that are this one's
    dma().intr().write(|w| unsafe { w.bits(pending) });
    look::<0>(pending) | look::<1>(pending)
}

/// Looks at the bytes of one UART that have come since.
#[expect(clippy::inline_always, reason = "twice in one interrupt that comes for every byte: a call is a tenth of it")]
#[inline(always)]
fn look<const NUMBER: usize>(pending: u32) -> bool {
    let channel = CHANNELS[NUMBER].bytes;
    if pending & 1 << channel == 0 {
        return false;
    }
    let end = ring_place(dma().ch(channel).ch_write_addr().read().bits(), 0);
    let mut seen = RX_SEEN[NUMBER].load(Ordering::Relaxed);
    let mut since = RX_SINCE[NUMBER].load(Ordering::Relaxed);
    let mut wake = false;
    while seen != end {
        since += 1;
        wake |= byte_at(NUMBER, seen) == DELIMITER || since >= WAKE_BYTES;
        seen = (seen + 1) & RING_MASK;
    }
    RX_SEEN[NUMBER].store(end, Ordering::Relaxed);
    RX_SINCE[NUMBER].store(if wake { 0 } else { since }, Ordering::Relaxed);
    if wake {
        set_interrupt(NUMBER, false);
        RX_WAITS[NUMBER].store(true, Ordering::Relaxed);
    }
    wake
}

/// Lets a receiver interrupt or not. By the registers' aliases that set and clear bits (RP2040, 2.1.2), so that interrupt and routing do not
/// undo each other's.
#[inline]
fn set_interrupt(number: usize, on: bool) {
    const SET: usize = 0x2000;
    const CLEAR: usize = 0x3000;
    let alias = dma().inte0().as_ptr().wrapping_byte_add(if on { SET } else { CLEAR });
    // SAFETY: an alias of the register; a bit of this module's channel
    unsafe { alias.write_volatile(1 << CHANNELS[number].bytes) };
}

/// Ends the interrupts of frames that have gone to their UARTs; routing may have the next ones.
pub fn clear_transmitted() {
    let both = 1 << CHANNELS[0].transmit | 1 << CHANNELS[1].transmit;
    // SAFETY: clearing flags of channels that are this module's
    dma().intr().write(|w| unsafe { w.bits(both) });
}

impl DmaUart {
    /// Where the next stamp will stand, and the one that stands there now: as long as a byte does not come in between.
    fn end_and_stamp(&self) -> (usize, Stamp) {
        loop {
            let end = self.end();
            let stamp = stamp_at(self.number, end);
            if self.end() == end {
                return (end, stamp);
            }
        }
    }

    /// When the transmitter's shift register will be empty: `now` where it is, else when what it was given will have left.
    #[must_use]
    pub fn idle_at(&self, now: LocalTicks) -> LocalTicks {
        if self.is_idle() {
            return now;
        }
        // where the reckoning says that all has left, the last byte is still on its way
        self.sent_at.max(now + BYTE)
    }

    /// Nothing is in the shift register, in the FIFO or on its way there.
    fn is_idle(&self) -> bool {
        !self.is_sending() && uart(self.number).uartfr().read().busy().bit_is_clear()
    }

    /// The DMA has still bytes of a frame to give to the UART.
    fn is_sending(&self) -> bool {
        dma().ch(CHANNELS[self.number].transmit).ch_al1_ctrl().read().bits() & ctrl::BUSY != 0
    }

    /// Place behind what has come: a byte is there once its stamp is.
    fn end(&self) -> usize {
        ring_place(dma().ch(CHANNELS[self.number].stamps).ch_write_addr().read().bits(), 2)
    }
}

impl Wire for DmaUart {
    fn drain(&mut self, now: LocalTicks, mut take: impl FnMut(&[u8], LocalTicks)) {
        // what has come of a frame that has not ended can wait
        if !RX_WAITS[self.number].load(Ordering::Relaxed) {
            return;
        }
        RX_WAITS[self.number].store(false, Ordering::Relaxed);
        let (end, oldest) = self.end_and_stamp();
        // what comes from here on interrupts; what came up to `end` is taken now
        RX_SEEN[self.number].store(end, Ordering::Relaxed);
        set_interrupt(self.number, true);
        // without a lap the place written next holds a stamp from before the last drain, as all that came since stands before it
        if now.since(self.drained_at) >= LAP_MIN && clock::at_stamp(oldest, now) > self.drained_at {
            self.overruns += 1;
            self.read = end;
            // ends the frame that was cut
            take(&[DELIMITER], now);
        }
        self.drained_at = now;
        while self.read != end {
            let start = self.read;
            let limit = if end > start { end } else { RING_BYTES };
            // SAFETY: the DMA writes at or beyond `end`, and reaches `start` again only after a lap
            let ring = unsafe { &*RX_BYTE_BUFFER[self.number].0.get() };
            let run = &ring[start..limit];
            let len = run.iter().position(|byte| *byte == DELIMITER).map_or(run.len(), |at| at + 1);
            take(&run[..len], clock::at_stamp(stamp_at(self.number, start), now));
            self.read = (start + len) & RING_MASK;
        }
    }

    fn take_overruns(&mut self) -> u32 {
        core::mem::take(&mut self.overruns)
    }

    fn clear_at(&mut self, now: LocalTicks) -> Option<LocalTicks> {
        // what has left is not reckoned only: a frame with a stamp relies on it
        (!self.is_sending()).then(|| self.idle_at(now))
    }

    fn room(&mut self) -> &mut [u8] {
        // SAFETY: one `DmaUart` has this number, and its DMA is idle while `clear_at` is some, which is asked before
        unsafe { &mut *TX_FRAME_BUFFER[self.number].0.get() }
    }

    fn send_head(&mut self, len: usize) {
        let uart = uart(self.number);
        if !uart.uartfr().read().txfe().bit_is_set() {
            return;
        }
        // SAFETY: as in `room`
        let frame = unsafe { &*TX_FRAME_BUFFER[self.number].0.get() };
        self.head = len.min(FIFO_BYTES);
        for byte in &frame[..self.head] {
            // SAFETY: any byte may be sent
            uart.uartdr().write(|w| unsafe { w.data().bits(*byte) });
        }
    }

    /// The transmitter puts the first byte on the wire at once. Interrupts are masked from the look at the transmitter to that byte, 20 cycles.
    fn send_head_stamped(&mut self, len: usize) -> Option<LocalTicks> {
        let uart = uart(self.number);
        // SAFETY: as in `room`
        let frame = unsafe { &*TX_FRAME_BUFFER[self.number].0.get() };
        let head = &frame[..len.min(FIFO_BYTES)];
        let (first, rest) = head.split_first()?;
        if !self.is_idle() {
            return None;
        }
        let stamp = send_first(uart, *first)?;
        for byte in rest {
            // SAFETY: any byte may be sent
            uart.uartdr().write(|w| unsafe { w.data().bits(*byte) });
        }
        self.head = head.len();
        Some(clock::at_stamp(stamp, clock::now()))
    }

    fn send(&mut self, len: usize, at: LocalTicks) {
        let Channels { transmit, .. } = CHANNELS[self.number];
        let control =
            ctrl::ENABLE | ctrl::INCREMENT_READ | ctrl::chain_to(transmit) | ctrl::request(REQUESTS[self.number].0);
        let channel = dma().ch(transmit);
        let len = len.min(FRAME_BYTES);
        let head = core::mem::take(&mut self.head).min(len);
        // SAFETY: from a buffer that lives for good and is not written before the channel is idle, to the UART's data register
        unsafe {
            channel.ch_read_addr().write(|w| w.bits(TX_FRAME_BUFFER[self.number].0.get() as u32 + head as u32));
            channel.ch_write_addr().write(|w| w.bits(uart(self.number).uartdr().as_ptr() as u32));
            channel.ch_trans_count().write(|w| w.bits((len - head) as u32));
            channel.ch_ctrl_trig().write(|w| w.bits(control));
        }
        self.sent_at = at + Span::from_steps(u64::from((len as u32 * BYTE_STEPS_Q8) >> 8));
    }
}

/// Gives an idle transmitter a byte, and says when: [`STAMP_TO_WRITE_CYCLES`] before. `None` where it was not idle.
///
/// In instructions, as neither the time from stamp to byte nor that for which interrupts are masked may depend on the compiler.
fn send_first(uart: &pac::uart0::RegisterBlock, byte: u8) -> Option<Stamp> {
    let (flags, us, sixteenths): (u32, u32, u32);
    // SAFETY: reads of the UART's flags and of both counters change nothing, and any byte may be sent; PRIMASK ends as it was
    unsafe {
        core::arch::asm!(
            "mrs {mask}, PRIMASK",
            "cpsid i",
            "ldr {flags}, [{uart}, #0x18]", // UARTFR
            "lsls {flags}, {flags}, #28", // the sign is BUSY
            "bmi 2f",
            "ldr {us}, [{us}]",
            "ldr {sixteenths}, [{sixteenths}]",
            "str {byte}, [{uart}]", // UARTDR
            "2: msr PRIMASK, {mask}",
            mask = out(reg) _,
            uart = in(reg) uart.uartdr().as_ptr(),
            byte = in(reg) u32::from(byte),
            flags = out(reg) flags,
            us = inout(reg) clock::us_address() => us,
            sixteenths = inout(reg) clock::sixteenths_address() => sixteenths,
            options(nostack),
        );
    }
    (flags.cast_signed() >= 0).then(|| Stamp { us, sixteenths: sixteenths.to_le_bytes()[0] })
}

/// The stamp at a place of a ring.
fn stamp_at(number: usize, place: usize) -> Stamp {
    let place = place & RING_MASK;
    // SAFETY: `place` is masked to the rings; volatile since the DMA wrote them
    unsafe {
        let us = RX_STAMP_BUFFER[number].0.get().cast::<u32>().add(place).read_volatile();
        let sixteenths = RX_SIXTEENTHS_BUFFER[number].0.get().cast::<u8>().add(place).read_volatile();
        Stamp { us, sixteenths }
    }
}

/// Place in a ring of what is at `address`, for elements of 2^`shift` bytes.
const fn ring_place(address: u32, shift: u32) -> usize {
    (address >> shift) as usize & RING_MASK
}

fn byte_at(number: usize, place: usize) -> u8 {
    // SAFETY: `place` is masked to the ring; volatile since the DMA wrote it
    unsafe { RX_BYTE_BUFFER[number].0.get().cast::<u8>().add(place & RING_MASK).read_volatile() }
}

fn dma() -> &'static pac::dma::RegisterBlock {
    // SAFETY: the block is there for good; each register used belongs to one context, or is write-one-to-clear
    unsafe { &*pac::DMA::ptr() }
}

fn uart(number: usize) -> &'static pac::uart0::RegisterBlock {
    let base = if number == 0 { pac::UART0::ptr() } else { pac::UART1::ptr() };
    // SAFETY: both UARTs have the same registers; only addresses and the DMA switch are used
    unsafe { &*base }
}

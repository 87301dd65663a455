//! USB-CDC as a link's wire: the host's way in.
//!
//! - **Walk:** host → packets of up to 64 bytes → [`Wire::drain`]; [`Wire::send`] → packets → host.
//! - **Invariants:** bytes are never lost: a packet is taken from the driver only to be handed over whole, and the hardware refuses the
//!   host's next one meanwhile. So the stream needs no check, `[FRM-04]`.
//! - **Context:** the routing task and `OTG_FS` at the same priority. The driver keeps asking for its interrupt while a packet waits to be
//!   drained, so the interrupt that routing is bound to must have a lower number than `OTG_FS`: of two that wait at one priority, the
//!   lower number runs first.
//!
//! The port is OTG2 in full speed with its own transceiver (RM0433, chapter 57; the HAL's `USB2`), on the socket "USB USER".

use core::mem::MaybeUninit;
use core::ptr::addr_of_mut;
use firmware_app::Wire;
use fixed_math::time::LocalTicks;
use osap_protocol::framing::{Check, DELIMITER, encoded_len_max};
use stm32h7xx_hal::pac;
use stm32h7xx_hal::usb_hs::{USB2, Usb2BusType};
use usb_device::bus::UsbBusAllocator;
use usb_device::device::{StringDescriptors, UsbDevice, UsbDeviceBuilder, UsbDeviceState, UsbVidPid};
use usbd_serial::{CdcAcmClass, USB_CLASS_CDC};

/// The id shared by serial ports that are told apart by their number; the host looks for it, `[LNK-06]`.
const VENDOR_PRODUCT: UsbVidPid = UsbVidPid(0x16c0, 0x27dd);
/// Full speed's largest.
const PACKET_BYTES: u16 = 64;
/// Bytes of the longest frame.
const FRAME_BYTES: usize = encoded_len_max(256, Check::None);
/// Hexadecimal digits of the unique id.
const SERIAL_BYTES: usize = 24;
/// What the driver receives into: a packet of the control endpoint and one of data, words.
const ENDPOINT_WORDS: usize = 2 * PACKET_BYTES as usize / 4;

static mut BUS: MaybeUninit<UsbBusAllocator<Usb2BusType>> = MaybeUninit::uninit();
static mut ENDPOINTS: [u32; ENDPOINT_WORDS] = [0; ENDPOINT_WORDS];
static mut SERIAL: [u8; SERIAL_BYTES] = [0; SERIAL_BYTES];

/// The USB port.
pub struct UsbWire {
    device: UsbDevice<'static, Usb2BusType>,
    class: CdcAcmClass<'static, Usb2BusType>,
    frame: [u8; FRAME_BYTES],
    /// What of the frame is still to be sent.
    left: core::ops::Range<usize>,
    /// The last packet was a full one, so the host waits for what ends the transfer.
    full: bool,
}

impl UsbWire {
    /// Attaches to the bus; called once.
    pub(crate) fn new(usb: USB2, unique_id: &[u8; 12]) -> Self {
        // SAFETY: in `init` nothing else changes clocks
        let rcc = unsafe { &*pac::RCC::ptr() };
        // RCC_AHB1LPENR (RM0433, chapter 8): without an external transceiver its clock must be off while the processor sleeps, or the
        // port stands still whenever idle waits
        rcc.ahb1lpenr.modify(|_, w| w.usb2otghsulpilpen().clear_bit());
        // SAFETY: called once, from the board's `init`, which owns the peripheral; all three live for good, and `serial` and `bus` are only
        // read from here on
        let (bus, serial) = unsafe {
            let endpoints = &mut *addr_of_mut!(ENDPOINTS);
            let allocator = Usb2BusType::new(usb, endpoints);
            let bus: &'static UsbBusAllocator<Usb2BusType> = (*addr_of_mut!(BUS)).write(allocator);
            let serial = &mut *addr_of_mut!(SERIAL);
            for (digits, byte) in serial.chunks_exact_mut(2).zip(unique_id) {
                digits[0] = hex(byte >> 4);
                digits[1] = hex(byte & 15);
            }
            (bus, core::str::from_utf8(serial).unwrap_or_default())
        };
        let class = CdcAcmClass::new(bus, PACKET_BYTES);
        let strings = StringDescriptors::default().manufacturer("OSAP").product("OSAP device").serial_number(serial);
        let device = UsbDeviceBuilder::new(bus, VENDOR_PRODUCT)
            .strings(&[strings])
            .expect("one language fits")
            .max_packet_size_0(64)
            .expect("64 is a packet size")
            .device_class(USB_CLASS_CDC)
            .build();
        Self { device, class, frame: [0; FRAME_BYTES], left: 0..0, full: false }
    }

    /// Does what the bus asks for. In its interrupt.
    pub fn poll(&mut self) {
        self.device.poll(&mut [&mut self.class]);
        self.go_on();
    }

    /// Gives the hardware the frame's next packet where it takes one.
    fn go_on(&mut self) {
        while !self.left.is_empty() || self.full {
            let end = self.left.end.min(self.left.start + usize::from(PACKET_BYTES));
            let Ok(sent) = self.class.write_packet(&self.frame[self.left.start..end]) else { return };
            self.left.start += sent;
            self.full = sent == usize::from(PACKET_BYTES);
        }
    }
}

impl Wire for UsbWire {
    fn is_up(&self) -> bool {
        // a terminal that is not open reads nothing; frames would wait for it until they expire
        self.device.state() == UsbDeviceState::Configured && self.class.dtr()
    }

    fn drain(&mut self, now: LocalTicks, mut take: impl FnMut(&[u8], LocalTicks)) {
        let mut packet = [0; PACKET_BYTES as usize];
        while let Ok(len) = self.class.read_packet(&mut packet) {
            packet[..len].split_inclusive(|byte| *byte == DELIMITER).for_each(|run| take(run, now));
        }
    }

    fn take_overruns(&mut self) -> u32 {
        0
    }

    fn clear_at(&mut self, now: LocalTicks) -> Option<LocalTicks> {
        if !self.is_up() {
            // what the host did not fetch before it went is for nobody
            self.left = 0..0;
            self.full = false;
        }
        self.left.is_empty().then_some(now)
    }

    fn room(&mut self) -> &mut [u8] {
        &mut self.frame
    }

    fn send(&mut self, len: usize, _at: LocalTicks) {
        self.left = 0..len.min(FRAME_BYTES);
        self.go_on();
    }
}

const fn hex(digit: u8) -> u8 {
    if digit < 10 { b'0' + digit } else { b'a' + digit - 10 }
}

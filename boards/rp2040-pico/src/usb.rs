//! USB-CDC as a link's wire: the host's way in.
//!
//! - **Walk:** host → packets of up to 64 bytes → [`Wire::drain`]; [`Wire::send`] → packets → host.
//! - **Invariants:** bytes are never lost: a packet is taken from the hardware only to be handed over whole, and the hardware refuses the
//!   host's next one meanwhile. So the stream needs no check, `[FRM-04]`.
//! - **Context:** the routing task and `USBCTRL_IRQ` at the same priority.

use core::mem::MaybeUninit;
use core::ptr::addr_of_mut;
use cortex_m::peripheral::NVIC;
use firmware_app::Wire;
use fixed_math::time::LocalTicks;
use osap_protocol::framing::{Check, DELIMITER, encoded_len_max};
use rp2040_hal::clocks::UsbClock;
use rp2040_hal::pac;
use rp2040_hal::usb::UsbBus;
use usb_device::bus::UsbBusAllocator;
use usb_device::device::{StringDescriptors, UsbDevice, UsbDeviceBuilder, UsbDeviceState, UsbVidPid};
use usbd_serial::{CdcAcmClass, USB_CLASS_CDC};

/// Raspberry Pi's id for a Pico with a serial port; the host looks for it, `[LNK-06]`.
const VENDOR_PRODUCT: UsbVidPid = UsbVidPid(0x2e8a, 0x000a);
/// Full speed's largest.
const PACKET_BYTES: u16 = 64;
const FRAME_BYTES: usize = encoded_len_max(256, Check::None);
/// Hexadecimal digits of the unique id.
const SERIAL_BYTES: usize = 16;

static mut BUS: MaybeUninit<UsbBusAllocator<UsbBus>> = MaybeUninit::uninit();
static mut SERIAL: [u8; SERIAL_BYTES] = [0; SERIAL_BYTES];

/// The USB port.
pub struct UsbWire {
    device: UsbDevice<'static, UsbBus>,
    class: CdcAcmClass<'static, UsbBus>,
    frame: [u8; FRAME_BYTES],
    /// What of the frame is still to be sent.
    left: core::ops::Range<usize>,
    /// The last packet was a full one, so the host waits for what ends the transfer.
    full: bool,
    /// A packet that came, and how much of it.
    packet: [u8; PACKET_BYTES as usize],
    came: usize,
    /// The bus had something to say since routing looked last.
    asked: bool,
}

impl UsbWire {
    /// Attaches to the bus; called once.
    pub(crate) fn new(
        registers: pac::USBCTRL_REGS,
        memory: pac::USBCTRL_DPRAM,
        clock: UsbClock,
        resets: &mut pac::RESETS,
        unique_id: &[u8; 12],
    ) -> Self {
        let allocator = UsbBusAllocator::new(UsbBus::new(registers, memory, clock, true, resets));
        // SAFETY: called once, from the board's `init`, which owns the peripheral; both live for good and are only read from here on
        let (bus, serial) = unsafe {
            let bus: &'static UsbBusAllocator<UsbBus> = (*addr_of_mut!(BUS)).write(allocator);
            let serial = &mut *addr_of_mut!(SERIAL);
            for (digits, byte) in serial.chunks_exact_mut(2).zip(&unique_id[4..]) {
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
        Self { device, class, frame: [0; FRAME_BYTES], left: 0..0, full: false, packet: [0; _], came: 0, asked: false }
    }

    /// Does what the bus asks for. In its interrupt, at once, as a host does not wait long between two questions. What it sends is put by
    /// for routing. As long as there is no room for more the interrupt stays away: the hardware goes on asking while a packet waits to
    /// be read, so that whoever only looks is asked for ever.
    pub fn poll(&mut self) {
        self.device.poll(&mut [&mut self.class]);
        if self.came > 0 {
            NVIC::mask(pac::Interrupt::USBCTRL_IRQ);
        } else {
            self.came = self.class.read_packet(&mut self.packet).unwrap_or(0);
        }
        self.asked = true;
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
        // the hardware is not asked in vain: its registers are slow, and routing comes by for every frame of other links
        if !core::mem::take(&mut self.asked) {
            return;
        }
        loop {
            let came = core::mem::take(&mut self.came);
            self.packet[..came].split_inclusive(|byte| *byte == DELIMITER).for_each(|run| take(run, now));
            self.came = self.class.read_packet(&mut self.packet).unwrap_or(0);
            if self.came == 0 {
                break;
            }
        }
        // SAFETY: no lock counts on this interrupt to be off, since routing, which runs this, is of the same priority
        unsafe { NVIC::unmask(pac::Interrupt::USBCTRL_IRQ) };
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

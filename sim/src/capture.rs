//! Captures of what passes over links, for Wireshark: pcapng, packets without framing.
//!
//! - **Walk:** any link, real or simulated, that was asked to → *this writer* → a file that `wireshark/osap.lua` dissects.
//! - **Invariants:** the bytes written depend on the calls alone: no clock, no name of a machine, little-endian everywhere. Times
//!   are those handed in, to the nanosecond below.
//! - **Context:** host and simulator.
//!
//! ```
//! use fixed_math::time::LocalTicks;
//! use osap_sim::capture::{Capture, Direction};
//!
//! let mut file = Vec::new();
//! let mut capture = Capture::new(&mut file)?;
//! let uart = capture.add_interface("hub link 1", 3_000_000)?;
//! capture.packet(uart, LocalTicks::from_us(250), Direction::Sent, &[5, 0xe8, 3, 64, 0, 0x41, 2])?;
//! # Ok::<(), osap_sim::capture::CaptureError>(())
//! ```

use fixed_math::time::{FRACTION_BITS, LocalTicks};
use osap_protocol::DropCause;
use pcap_file::pcapng::blocks::enhanced_packet::{EnhancedPacketBlock, EnhancedPacketOption};
use pcap_file::pcapng::blocks::interface_description::{InterfaceDescriptionBlock, InterfaceDescriptionOption};
use pcap_file::pcapng::{PcapNgBlock, PcapNgWriter};
use pcap_file::{DataLink, Endianness, PcapError};
use std::borrow::Cow;
use std::io::Write;
use std::time::Duration;
use thiserror::Error;

/// `if_tsresol`: 10⁻⁹ s, which is what the writer counts in.
const NANOSECONDS: u8 = 9;
/// `epb_flags`, bits 0 and 1.
const INBOUND: u32 = 0b01;
const OUTBOUND: u32 = 0b10;

/// `epb_flags`, bits 24 to 31: why a frame gave no packet. What has no bit of its own is a symbol error.
const fn error_flag(cause: DropCause) -> u32 {
    match cause {
        DropCause::FrameCheck => 1 << 24,
        DropCause::FrameTooLong => 1 << 25,
        DropCause::FrameTooShort => 1 << 26,
        _ => 1 << 31,
    }
}

/// The capture could not be written.
#[derive(Debug, Error)]
pub enum CaptureError {
    /// The writer failed, or refused a block.
    #[error("cannot write the capture: {}", reason(.0))]
    Write(#[from] PcapError),
    /// More bytes than a capture's block can say.
    #[error("a packet of {len} bytes does not fit a capture")]
    TooLong {
        /// The packet's bytes.
        len: usize,
    },
    /// More interfaces than a capture can number.
    #[error("a capture cannot number another interface")]
    TooManyInterfaces,
}

/// What the system complains about, where it does: the writer's own words are those of a reader, whatever failed.
fn reason(error: &PcapError) -> String {
    match error {
        PcapError::IoError(error) => error.to_string(),
        other => other.to_string(),
    }
}

/// An interface of one capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct InterfaceId(u32);

/// Which way a packet went, seen from the node that owns the interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Direction {
    /// It came in.
    Received,
    /// It went out.
    Sent,
}

impl Direction {
    const fn flags(self) -> u32 {
        match self {
            Self::Received => INBOUND,
            Self::Sent => OUTBOUND,
        }
    }
}

/// A capture that is being written.
pub struct Capture<W: Write> {
    writer: PcapNgWriter<W>,
    interfaces: u32,
}

impl<W: Write> Capture<W> {
    /// Begins a capture.
    ///
    /// # Errors
    /// [`CaptureError::Write`].
    pub fn new(writer: W) -> Result<Self, CaptureError> {
        Ok(Self { writer: PcapNgWriter::with_endianness(writer, Endianness::Little)?, interfaces: 0 })
    }

    /// Adds a link: its name, and its rate in bits a second, 0 where unknown.
    ///
    /// # Errors
    /// [`CaptureError::Write`], `TooManyInterfaces`.
    pub fn add_interface(&mut self, name: &str, bit_rate: u32) -> Result<InterfaceId, CaptureError> {
        let id = InterfaceId(self.interfaces);
        let next = self.interfaces.checked_add(1).ok_or(CaptureError::TooManyInterfaces)?;
        let mut options = vec![
            InterfaceDescriptionOption::IfName(Cow::Borrowed(name)),
            InterfaceDescriptionOption::IfTsResol(NANOSECONDS),
        ];
        if bit_rate > 0 {
            options.push(InterfaceDescriptionOption::IfSpeed(u64::from(bit_rate)));
        }
        let block = InterfaceDescriptionBlock { linktype: DataLink::USER0, snaplen: 0, options };
        self.writer.write_block(&block.into_block())?;
        self.interfaces = next;
        Ok(id)
    }

    /// Writes a packet as it stood on the link, without framing; `at` is the stamp of its first byte.
    ///
    /// # Errors
    /// [`CaptureError::Write`], also for the interface of another capture; `TooLong`.
    pub fn packet(
        &mut self,
        interface: InterfaceId,
        at: LocalTicks,
        direction: Direction,
        bytes: &[u8],
    ) -> Result<(), CaptureError> {
        self.write(interface, at, bytes, vec![EnhancedPacketOption::Flags(direction.flags())])
    }

    /// Writes a frame that gave no packet: its bytes as they came, marked as an error, with the name of its drop as a comment.
    ///
    /// # Errors
    /// As [`Capture::packet`].
    pub fn bad_frame(
        &mut self,
        interface: InterfaceId,
        at: LocalTicks,
        cause: DropCause,
        bytes: &[u8],
    ) -> Result<(), CaptureError> {
        let comment = format!("{}: {}", cause.name(), cause.meaning());
        let options = vec![
            EnhancedPacketOption::Comment(Cow::Owned(comment)),
            EnhancedPacketOption::Flags(Direction::Received.flags() | error_flag(cause)),
        ];
        self.write(interface, at, bytes, options)
    }

    /// Ends the capture and gives the writer back.
    pub fn into_inner(self) -> W {
        self.writer.into_inner()
    }

    fn write(
        &mut self,
        interface: InterfaceId,
        at: LocalTicks,
        bytes: &[u8],
        options: Vec<EnhancedPacketOption<'_>>,
    ) -> Result<(), CaptureError> {
        let original_len = u32::try_from(bytes.len()).map_err(|_| CaptureError::TooLong { len: bytes.len() })?;
        let timestamp = since_origin(at);
        let data = Cow::Borrowed(bytes);
        let block = EnhancedPacketBlock { interface_id: interface.0, timestamp, original_len, data, options };
        self.writer.write_block(&block.into_block())?;
        Ok(())
    }
}

/// A reading as a time since the counter's origin, to the nanosecond below.
const fn since_origin(at: LocalTicks) -> Duration {
    let us = at.as_us();
    let part = at.steps() & ((1 << FRACTION_BITS) - 1);
    Duration::from_micros(us).saturating_add(Duration::from_nanos((part * 1000) >> FRACTION_BITS))
}

#[cfg(test)]
mod tests {
    use super::*;
    use pcap_file::pcapng::{Block, PcapNgReader};

    const PACKET: [u8; 11] = [5, 0xe8, 3, 64, 0, 0x41, 0xc0, 0x18, 0, 0, 0x2a];

    fn written() -> Vec<u8> {
        let mut capture = Capture::new(Vec::new()).unwrap();
        let uart = capture.add_interface("hub link 1", 3_000_000).unwrap();
        let usb = capture.add_interface("hub link 2", 0).unwrap();
        capture.packet(uart, LocalTicks::from_steps(250 * 256 + 128), Direction::Sent, &PACKET).unwrap();
        capture.packet(usb, LocalTicks::from_us(1 << 40), Direction::Received, &[]).unwrap();
        capture.bad_frame(uart, LocalTicks::ZERO, DropCause::FrameCheck, &PACKET[..4]).unwrap();
        capture.into_inner()
    }

    /// What is written is read back: names, rates, times, directions, bytes, comments.
    #[test]
    fn a_capture_reads_back_as_it_was_written() {
        let bytes = written();
        let mut reader = PcapNgReader::new(&bytes[..]).unwrap();
        let mut blocks = Vec::new();
        while let Some(block) = reader.next_block() {
            blocks.push(block.unwrap().into_owned());
        }
        let [Block::InterfaceDescription(uart), Block::InterfaceDescription(usb), packets @ ..] = &blocks[..] else {
            panic!("two interfaces first: {blocks:?}");
        };
        let name = |name| InterfaceDescriptionOption::IfName(Cow::Borrowed(name));
        let resolution = InterfaceDescriptionOption::IfTsResol(9);
        assert_eq!((uart.linktype, u32::from(usb.linktype)), (DataLink::USER0, 147));
        assert_eq!(
            uart.options,
            [name("hub link 1"), resolution.clone(), InterfaceDescriptionOption::IfSpeed(3_000_000)]
        );
        assert_eq!(usb.options, [name("hub link 2"), resolution]);

        let packets: Vec<_> = packets
            .iter()
            .map(|block| match block {
                Block::EnhancedPacket(packet) => packet,
                other => panic!("only packets follow: {other:?}"),
            })
            .collect();
        let [sent, received, bad] = packets[..] else { panic!("three packets: {packets:?}") };
        assert_eq!(
            (sent.interface_id, &sent.data[..], sent.timestamp),
            (0, &PACKET[..], Duration::from_nanos(250_500))
        );
        assert_eq!(sent.options, [EnhancedPacketOption::Flags(2)]);
        assert_eq!((received.interface_id, received.data.len()), (1, 0));
        assert_eq!(
            (received.timestamp, &received.options[..]),
            (Duration::from_micros(1 << 40), &[EnhancedPacketOption::Flags(1)][..])
        );
        let comment = "frame-check: A frame's check did not match its bytes.";
        assert_eq!(
            bad.options,
            [EnhancedPacketOption::Comment(Cow::Borrowed(comment)), EnhancedPacketOption::Flags(1 << 24 | 1)]
        );
    }

    /// A capture of the same calls is the same file.
    #[test]
    fn a_capture_depends_on_its_calls_alone() {
        assert_eq!(written(), written());
        // section header: block type, its length, byte-order magic, version 1.0
        assert_eq!(written()[..16], [0x0a, 0x0d, 0x0d, 0x0a, 0x1c, 0, 0, 0, 0x4d, 0x3c, 0x2b, 0x1a, 1, 0, 0, 0]);
    }

    #[test]
    fn the_interface_of_another_capture_is_refused() {
        let mut other = Capture::new(Vec::new()).unwrap();
        let id = other.add_interface("a", 0).unwrap();
        let mut capture = Capture::new(Vec::new()).unwrap();
        assert!(matches!(capture.packet(id, LocalTicks::ZERO, Direction::Sent, &[]), Err(CaptureError::Write(_))));
    }

    #[test]
    fn a_full_disk_is_called_so() {
        let full = CaptureError::from(PcapError::IoError(std::io::ErrorKind::StorageFull.into()));
        assert_eq!(full.to_string(), "cannot write the capture: no storage space");
    }

    #[test]
    fn no_time_overflows() {
        assert_eq!(since_origin(LocalTicks::from_steps(255)), Duration::from_nanos(996));
        assert_eq!(
            since_origin(LocalTicks::MAX).subsec_nanos(),
            Duration::from_micros(LocalTicks::MAX.as_us()).subsec_nanos() + 996
        );
    }
}

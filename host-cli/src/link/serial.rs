//! Serial ports: USB devices found by what they are, others by name, and opened again when they come back.
//!
//! - **Walk:** system's list of ports → [`SerialOpener`] → `stream` → the link's reader and writer.
//! - **Invariants:** no wait is longer than [`WAIT_MAX`], though a device may stop taking bytes: writes never block. A port is held
//!   alone, so that two links with the same ids get two devices.
//! - **Clauses:** `[LNK-06]`, `[FRM-02]`, `[FRM-04]`.

use super::pump::{self, Attempt, Ending, Form, Opener, WAIT_MAX};
use super::spec::{LinkSpec, SerialTarget, Target, UsbId};
use super::stream::{self, ByteStream, is_wait_over};
use super::{Clock, LinkDescription, LinkError, LinkHandle, Start};
use osap_protocol::framing::Check;
use serialport::{SerialPort, SerialPortType, UsbPortInfo};
use std::io::{self, Read, Write};
use std::path::Path;
use std::time::Duration;

/// Between two looks for a device that is not there.
const LOOK_AGAIN: Duration = Duration::from_millis(200);
/// What full-speed USB carries, bits a second; a serial port over it has no rate of its own.
const USB_BIT_RATE: u32 = 12_000_000;

/// Devices that are a microcontroller's own USB-CDC port. Bridges to a UART are not here, since anything may be behind one: they
/// are given by id or name.
const KNOWN: [UsbId; 4] = [
    UsbId { vendor: 0x2e8a, product: 0x000a }, // Raspberry Pi RP2040 and RP2350
    UsbId { vendor: 0x16c0, product: 0x27dd }, // shared id for CDC devices of V-USB and of Rust's usbd-serial
    UsbId { vendor: 0x16c0, product: 0x0483 }, // Teensy
    UsbId { vendor: 0x0483, product: 0x5740 }, // STM32 virtual port
];
/// Makers of bridges to a UART: FTDI, Silicon Labs, WCH, Prolific.
const BRIDGE_VENDORS: [u16; 4] = [0x0403, 0x10c4, 0x1a86, 0x067b];
/// Begins of port names that are USB-CDC on Linux and macOS.
const CDC_NAMES: [&str; 3] = ["ttyACM", "cu.usbmodem", "tty.usbmodem"];

/// One specification for each device there is now that `spec` means. A specification that names one link is given back as it is, and so
/// is one whose device is not there yet: opened, it waits for it.
#[must_use]
pub fn found(spec: &LinkSpec) -> Vec<LinkSpec> {
    let Target::Serial { target, baud } = &spec.target else { return vec![spec.clone()] };
    let each = |(_, info): (String, UsbPortInfo)| LinkSpec {
        target: Target::Serial {
            target: SerialTarget::Usb { id: id_of(&info), serial: info.serial_number },
            baud: *baud,
        },
        check: spec.check,
    };
    let specs: Vec<LinkSpec> = usb_ports(target).into_iter().map(each).collect();
    if specs.is_empty() { vec![spec.clone()] } else { specs }
}

pub(super) fn open(start: Start<'_>, target: &SerialTarget, baud: u32) -> Result<LinkHandle, LinkError> {
    let is_cdc = is_cdc(target);
    let check = start.spec.check.unwrap_or(if is_cdc { Check::None } else { Check::Crc16 });
    let name = LinkSpec { target: Target::Serial { target: target.clone(), baud }, check: None }.to_string();
    let description = if is_cdc {
        LinkDescription { bit_rate: USB_BIT_RATE, ..start.describe(name, "usb-cdc", check) }
    } else {
        LinkDescription { bit_rate: baud, bits_a_byte: 10, ..start.describe(name, "serial", check) }
    };
    let opener = SerialOpener { target: target.clone(), baud, clock: start.clock.clone() };
    pump::start(start.plan(description, Form::Stuffed(check)), Box::new(opener))
}

/// Whether the port is USB all the way, so that its bytes come checked and at no baud rate.
fn is_cdc(target: &SerialTarget) -> bool {
    match target {
        SerialTarget::Known => true,
        SerialTarget::Usb { id, .. } => !BRIDGE_VENDORS.contains(&id.vendor),
        SerialTarget::Path(path) => {
            let name = path.rsplit('/').next().unwrap_or(path);
            CDC_NAMES.iter().any(|cdc| name.starts_with(cdc))
        }
    }
}

const fn id_of(info: &UsbPortInfo) -> UsbId {
    UsbId { vendor: info.vid, product: info.pid }
}

/// Names and ids of the ports that `target` means; none for one given by name. A system that cannot list its ports has none.
fn usb_ports(target: &SerialTarget) -> Vec<(String, UsbPortInfo)> {
    let wanted = |info: &UsbPortInfo| match target {
        SerialTarget::Known => KNOWN.contains(&id_of(info)),
        SerialTarget::Usb { id, serial } => id_of(info) == *id && (serial.is_none() || *serial == info.serial_number),
        SerialTarget::Path(_) => false,
    };
    // On a Linux without it, as in some containers, `available_ports` would panic.
    if cfg!(target_os = "linux") && !Path::new("/sys/class/tty").is_dir() {
        return Vec::new();
    }
    let ports = serialport::available_ports().unwrap_or_default();
    ports
        .into_iter()
        .filter_map(|port| match port.port_type {
            SerialPortType::UsbPort(info) if wanted(&info) => Some((port.port_name, info)),
            _ => None,
        })
        .collect()
}

struct SerialOpener {
    target: SerialTarget,
    baud: u32,
    clock: Clock,
}

impl Opener for SerialOpener {
    fn open(&mut self, _ending: &Ending<'_>) -> Attempt {
        let paths: Vec<String> = match &self.target {
            SerialTarget::Path(path) => vec![path.clone()],
            by_id => usb_ports(by_id).into_iter().map(|(path, _)| path).collect(),
        };
        let mut reason = format!("no device for {} is plugged in", self.target);
        for path in paths {
            match open_port(&path, self.baud) {
                Ok((reading, writing)) => return Attempt::Opened(stream::session(reading, writing, &self.clock)),
                Err(error) => reason = explain(&path, &error),
            }
        }
        Attempt::Failed(reason)
    }

    fn retry_after(&self, _failures: u32) -> Duration {
        LOOK_AGAIN
    }
}

/// Two handles of one port.
fn open_port(path: &str, baud: u32) -> serialport::Result<(Port, Port)> {
    let port = serialport::new(path, baud).timeout(WAIT_MAX).dtr_on_open(true).open_native()?;
    #[cfg(unix)]
    never_block(&port)?;
    Ok((Port(port.try_clone()?), Port(Box::new(port))))
}

/// A device that stops reading must not hold a thread in the kernel: with this, a write takes what there is room for. Reads wait
/// before they read, so they do not change.
#[cfg(unix)]
pub(super) fn never_block(port: &impl std::os::fd::AsRawFd) -> io::Result<()> {
    nix::fcntl::fcntl(port.as_raw_fd(), nix::fcntl::FcntlArg::F_SETFL(nix::fcntl::OFlag::O_NONBLOCK))?;
    Ok(())
}

fn explain(path: &str, error: &serialport::Error) -> String {
    let hint = match error.kind() {
        serialport::ErrorKind::Io(io::ErrorKind::PermissionDenied) => {
            "; you may have to join its group, often with `sudo usermod -aG dialout $USER`"
        }
        serialport::ErrorKind::NoDevice => "; another program may have it open",
        _ => "",
    };
    format!("{path}: {error}{hint}")
}

/// One handle of a port.
pub(super) struct Port(pub(super) Box<dyn SerialPort>);

impl ByteStream for Port {
    fn read_some(&mut self, into: &mut [u8], wait: Duration) -> io::Result<usize> {
        self.0.set_timeout(wait)?;
        match self.0.read(into) {
            Ok(0) => Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the device is gone")),
            Err(error) if is_wait_over(&error) => Ok(0),
            outcome => outcome,
        }
    }

    fn write_some(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self.0.write(bytes) {
            Err(error) if is_wait_over(&error) => Ok(0),
            outcome => outcome,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn target(text: &str) -> SerialTarget {
        match text.parse::<LinkSpec>().unwrap().target {
            Target::Serial { target, .. } => target,
            other => panic!("{other:?}"),
        }
    }

    /// `[FRM-04]`: only a port that is USB all the way goes without a check by itself.
    #[test]
    fn a_bridge_is_a_uart_and_a_microcontrollers_own_port_is_not() {
        for cdc in ["serial", "serial:usb=2e8a:000a", "serial:/dev/ttyACM0", "serial:/dev/cu.usbmodem1101"] {
            assert!(is_cdc(&target(cdc)), "{cdc}");
        }
        for uart in ["serial:usb=0403:6001", "serial:/dev/ttyUSB0", "serial:/dev/pts/3", "serial:COM3"] {
            assert!(!is_cdc(&target(uart)), "{uart}");
        }
    }

    #[test]
    fn no_known_id_is_that_of_a_bridge() {
        assert!(KNOWN.iter().all(|id| !BRIDGE_VENDORS.contains(&id.vendor)));
    }

    #[test]
    fn a_device_that_is_not_there_is_waited_for_under_its_own_name() {
        for text in ["serial:usb=ffff:ffff", "serial:/dev/none", "tcp:127.0.0.1:1"] {
            let spec: LinkSpec = text.parse().unwrap();
            assert_eq!(found(&spec), [spec]);
        }
    }

    /// Read back from the system: a pseudo-terminal's writes rarely block, so only a stuck USB device would show the difference.
    #[cfg(unix)]
    #[test]
    fn an_open_port_never_blocks() {
        use nix::fcntl::{FcntlArg, OFlag, fcntl};
        use std::os::fd::AsRawFd;
        let (_master, slave) = serialport::TTYPort::pair().unwrap();
        never_block(&slave).unwrap();
        let flags = OFlag::from_bits_truncate(fcntl(slave.as_raw_fd(), FcntlArg::F_GETFL).unwrap());
        assert!(flags.contains(OFlag::O_NONBLOCK));
    }

    #[test]
    fn a_port_that_may_not_be_opened_says_what_to_do() {
        let denied = serialport::Error::new(serialport::ErrorKind::Io(io::ErrorKind::PermissionDenied), "denied");
        assert!(explain("ttyACM0", &denied).contains("usermod -aG dialout"));
    }
}

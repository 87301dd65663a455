//! Which link: the text of a command line, and what it means.
//!
//! | text | is |
//! |---|---|
//! | `serial` | a USB serial port whose vendor and product id is one this project knows |
//! | `serial:usb=2e8a:000a` | one with this id; `serial:usb=2e8a:000a:E66…` and this serial number |
//! | `serial:/dev/ttyUSB0@3000000` | the port of this name, at 3 Mbit/s |
//! | `tcp:127.0.0.1:4100`, `tcp:[::1]:4100` | a TCP connection |
//! | `udp:127.0.0.1:4100` | UDP datagrams |
//! | `pty` | a pseudo-terminal, to listen on |
//!
//! Behind each may stand `,check=none`, `,check=crc16` or `,check=crc32` where it is a stream of bytes.
//!
//! - **Walk:** `--link TEXT` → [`LinkSpec`] → [`open`](super::open) or [`listen`](super::listen).
//! - **Invariant:** what is shown parses back to the same.
//! - **Clauses:** `[LNK-06]` ids instead of names, `[FRM-03]` both ends set to one check.
//!
//! ```
//! use osap::link::LinkSpec;
//!
//! let spec: LinkSpec = "serial:usb=2e8a:000a,check=crc32".parse()?;
//! assert_eq!(spec.to_string(), "serial:usb=2e8a:000a,check=crc32");
//! # Ok::<(), osap::link::SpecError>(())
//! ```

use osap_protocol::framing::Check;
use std::fmt::{self, Display, Formatter};
use std::str::FromStr;

/// Rate of a serial port where none is given, bits a second.
pub(super) const BAUD_DEFAULT: u32 = 115_200;

/// Vendor and product id of a USB device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UsbId {
    /// Given out by the USB-IF.
    pub vendor: u16,
    /// Given out by the vendor.
    pub product: u16,
}

/// How a serial port is found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SerialTarget {
    /// Any of the ids this project knows.
    Known,
    /// By id, `[LNK-06]`.
    Usb {
        /// The id.
        id: UsbId,
        /// The serial number, to tell several of one kind apart.
        serial: Option<String>,
    },
    /// By name.
    Path(String),
}

/// What a link leads to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// A serial port.
    Serial {
        /// Which.
        target: SerialTarget,
        /// Bits a second; has no meaning for a USB device that is no UART.
        baud: u32,
    },
    /// A TCP connection or listener.
    Tcp {
        /// Name or address, without brackets.
        host: String,
        /// Port; 0 lets the system choose where it is listened on.
        port: u16,
    },
    /// UDP datagrams.
    Udp {
        /// Name or address, without brackets.
        host: String,
        /// Port; 0 lets the system choose where it is listened on.
        port: u16,
    },
    /// A new pseudo-terminal.
    Pty,
}

/// Which link, and what guards its frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LinkSpec {
    /// What it leads to.
    pub target: Target,
    /// `None` for what is usual on such a link: no check on USB-CDC and TCP, CRC-16 on other serial ports.
    pub check: Option<Check>,
}

/// Why a text names no link.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SpecError {
    /// The part before the first colon.
    #[error("{text}: a link begins with serial, tcp, udp or pty, such as serial or tcp:127.0.0.1:4100")]
    Kind {
        /// As given.
        text: String,
    },
    /// Behind `tcp:` or `udp:`.
    #[error("{text}: expected a host and a port, such as tcp:127.0.0.1:4100 or tcp:[::1]:4100")]
    Address {
        /// As given.
        text: String,
    },
    /// Behind `serial:`.
    #[error("{text}: expected a device such as serial:/dev/ttyACM0 or serial:/dev/ttyUSB0@3000000")]
    Device {
        /// As given.
        text: String,
    },
    /// Behind `serial:usb=`.
    #[error("{text}: expected vendor and product id of four hexadecimal digits each, such as serial:usb=2e8a:000a")]
    Usb {
        /// As given.
        text: String,
    },
    /// Behind `@`.
    #[error("{text}: expected bits a second behind the @, such as serial:/dev/ttyUSB0@3000000")]
    Baud {
        /// As given.
        text: String,
    },
    /// Behind a comma.
    #[error("{text}: the option {option} is none; there are check=none, check=crc16 and check=crc32")]
    Option {
        /// As given.
        text: String,
        /// The part that is wrong.
        option: String,
    },
    /// A check on datagrams.
    #[error("{text}: a datagram carries one packet without a check; leave the option out")]
    CheckOnDatagrams {
        /// As given.
        text: String,
    },
}

impl FromStr for LinkSpec {
    type Err = SpecError;

    fn from_str(text: &str) -> Result<Self, SpecError> {
        let given = || text.to_owned();
        let (what, option) = match text.split_once(',') {
            Some((what, option)) => (what, Some(option)),
            None => (text, None),
        };
        let check = option.map(|option| match option {
            "check=none" => Ok(Check::None),
            "check=crc16" => Ok(Check::Crc16),
            "check=crc32" => Ok(Check::Crc32),
            _ => Err(SpecError::Option { text: given(), option: option.to_owned() }),
        });
        let check = check.transpose()?;
        let target = match what.split_once(':').map_or((what, None), |(kind, rest)| (kind, Some(rest))) {
            ("serial", None) => Target::Serial { target: SerialTarget::Known, baud: BAUD_DEFAULT },
            ("serial", Some(device)) => serial(device, text)?,
            ("tcp", Some(address)) => {
                let (host, port) = host_and_port(address).ok_or_else(|| SpecError::Address { text: given() })?;
                Target::Tcp { host, port }
            }
            ("udp", Some(_)) if check.is_some() => return Err(SpecError::CheckOnDatagrams { text: given() }),
            ("udp", Some(address)) => {
                let (host, port) = host_and_port(address).ok_or_else(|| SpecError::Address { text: given() })?;
                Target::Udp { host, port }
            }
            ("tcp" | "udp", None) => return Err(SpecError::Address { text: given() }),
            ("pty", None) => Target::Pty,
            _ => return Err(SpecError::Kind { text: given() }),
        };
        Ok(Self { target, check })
    }
}

fn serial(device: &str, text: &str) -> Result<Target, SpecError> {
    let (device, baud) = match device.rsplit_once('@') {
        None => (device, BAUD_DEFAULT),
        Some((device, baud)) => match baud.parse() {
            Ok(baud) if baud > 0 => (device, baud),
            _ => return Err(SpecError::Baud { text: text.to_owned() }),
        },
    };
    let target = match device.strip_prefix("usb=") {
        Some(ids) => usb(ids).ok_or_else(|| SpecError::Usb { text: text.to_owned() })?,
        None if device.is_empty() => return Err(SpecError::Device { text: text.to_owned() }),
        None => SerialTarget::Path(device.to_owned()),
    };
    Ok(Target::Serial { target, baud })
}

fn usb(ids: &str) -> Option<SerialTarget> {
    let mut parts = ids.splitn(3, ':');
    // `from_str_radix` alone would take a sign.
    let mut id = || {
        let digits =
            parts.next().filter(|part| part.len() == 4 && part.bytes().all(|byte| byte.is_ascii_hexdigit()))?;
        u16::from_str_radix(digits, 16).ok()
    };
    let id = UsbId { vendor: id()?, product: id()? };
    let serial = parts.next().map(str::to_owned);
    let is_good = serial.as_ref().is_none_or(|serial| !serial.is_empty());
    is_good.then_some(SerialTarget::Usb { id, serial })
}

fn host_and_port(address: &str) -> Option<(String, u16)> {
    let (host, port) = address.rsplit_once(':')?;
    let host = match host.strip_prefix('[') {
        Some(v6) => v6.strip_suffix(']')?,
        // An address of IPv6 without brackets leaves open where its port begins.
        None if host.contains(':') => return None,
        None => host,
    };
    let port = port.parse().ok().filter(|_| port.bytes().all(|byte| byte.is_ascii_digit()))?;
    (!host.is_empty()).then(|| (host.to_owned(), port))
}

impl Display for UsbId {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{:04x}:{:04x}", self.vendor, self.product)
    }
}

impl Display for SerialTarget {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Known => f.write_str("serial"),
            Self::Usb { id, serial: None } => write!(f, "serial:usb={id}"),
            Self::Usb { id, serial: Some(serial) } => write!(f, "serial:usb={id}:{serial}"),
            Self::Path(path) => write!(f, "serial:{path}"),
        }
    }
}

impl Display for LinkSpec {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let address = |host: &str, port: u16| {
            if host.contains(':') { format!("[{host}]:{port}") } else { format!("{host}:{port}") }
        };
        match &self.target {
            Target::Serial { target, baud } => {
                let is_usual = *baud == BAUD_DEFAULT || *target == SerialTarget::Known;
                write!(f, "{target}{}", if is_usual { String::new() } else { format!("@{baud}") })?;
            }
            Target::Tcp { host, port } => write!(f, "tcp:{}", address(host, *port))?,
            Target::Udp { host, port } => write!(f, "udp:{}", address(host, *port))?,
            Target::Pty => f.write_str("pty")?,
        }
        f.write_str(match self.check {
            None => "",
            Some(Check::None) => ",check=none",
            Some(Check::Crc16) => ",check=crc16",
            Some(Check::Crc32) => ",check=crc32",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_examples_of_the_table_are_what_they_say() {
        let id = UsbId { vendor: 0x2e8a, product: 0x000a };
        let serial = |target, baud| Target::Serial { target, baud };
        let localhost = |host: &str| (host.to_owned(), 4100);
        let (host, port) = localhost("127.0.0.1");
        let cases = [
            ("serial", serial(SerialTarget::Known, BAUD_DEFAULT)),
            ("serial:usb=2e8a:000a", serial(SerialTarget::Usb { id, serial: None }, BAUD_DEFAULT)),
            ("serial:usb=2e8a:000a:E66", serial(SerialTarget::Usb { id, serial: Some("E66".into()) }, BAUD_DEFAULT)),
            ("serial:/dev/ttyUSB0@3000000", serial(SerialTarget::Path("/dev/ttyUSB0".into()), 3_000_000)),
            ("serial:COM3", serial(SerialTarget::Path("COM3".into()), BAUD_DEFAULT)),
            ("tcp:127.0.0.1:4100", Target::Tcp { host: host.clone(), port }),
            ("tcp:[::1]:4100", Target::Tcp { host: "::1".into(), port }),
            ("udp:127.0.0.1:4100", Target::Udp { host, port }),
            ("pty", Target::Pty),
        ];
        for (text, target) in cases {
            assert_eq!(text.parse(), Ok(LinkSpec { target, check: None }), "{text}");
            assert_eq!(text.parse::<LinkSpec>().unwrap().to_string(), text);
        }
        assert_eq!("pty,check=crc32".parse::<LinkSpec>().unwrap().check, Some(Check::Crc32));
    }

    /// Each error shows what was given and an example of what would do.
    #[test]
    fn errors_show_what_was_given_and_an_example() {
        let cases = [
            ("", "serial or tcp:127.0.0.1:4100"),
            ("usb", "serial or tcp:127.0.0.1:4100"),
            ("pty:x", "serial or tcp:127.0.0.1:4100"),
            ("tcp", "tcp:127.0.0.1:4100"),
            ("tcp:localhost", "tcp:127.0.0.1:4100"),
            ("tcp::4100", "tcp:127.0.0.1:4100"),
            ("tcp:::1:4100", "tcp:[::1]:4100"),
            ("tcp:h:+1", "tcp:127.0.0.1:4100"),
            ("tcp:h:65536", "tcp:127.0.0.1:4100"),
            ("serial:", "serial:/dev/ttyACM0"),
            ("serial:usb=2e8a", "serial:usb=2e8a:000a"),
            ("serial:usb=+e8a:000a", "serial:usb=2e8a:000a"),
            ("serial:usb=2e8a:000a:", "serial:usb=2e8a:000a"),
            ("serial:/dev/ttyUSB0@fast", "@3000000"),
            ("serial:/dev/ttyUSB0@0", "@3000000"),
            ("pty,check=md5", "check=crc32"),
            ("pty,check=none,check=none", "check=crc32"),
            ("udp:127.0.0.1:1,check=none", "leave the option out"),
        ];
        for (text, example) in cases {
            let said = text.parse::<LinkSpec>().unwrap_err().to_string();
            assert!(said.starts_with(&format!("{text}: ")) && said.contains(example), "{said}");
        }
    }

    proptest! {
        #[test]
        fn what_is_shown_parses_back(text in "(serial|tcp|udp|pty)(:(usb=)?[0-9a-f:@/.\\[\\]]{0,16})?(,check=crc16)?") {
            if let Ok(spec) = text.parse::<LinkSpec>() {
                prop_assert_eq!(spec.to_string().parse(), Ok(spec));
            }
        }

        #[test]
        fn no_text_panics(text in "\\PC{0,40}") {
            let _ = text.parse::<LinkSpec>();
        }
    }
}

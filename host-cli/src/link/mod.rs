//! Links over what an operating system offers: USB and other serial ports, TCP, UDP, pseudo-terminals, channels.
//!
//! - **Walk:** bytes of a peer → a link's reader thread (`stream` or a datagram; fault layer; check) → [`LinkEvent::Packet`] → the
//!   node's thread → [`LinkHandle::send`] → the link's writer thread → bytes to the peer. `pump` has both threads; each medium's file
//!   only opens, reads and writes.
//! - **Invariants:** two threads a link, bounded channels only: a slow node makes readers wait, and then the peer. No input panics.
//! - **Clauses:** `[LNK-01]`, `[LNK-02]`, `[LNK-04]` to `[LNK-07]`, `[FRM-08]`, `[FRM-09]`.
//!
//! ```
//! use osap::link::{self, Clock, LinkEvent, LinkOptions};
//! use osap_protocol::GatewayIndex;
//! use std::sync::mpsc::sync_channel;
//!
//! let (events, inbox) = sync_channel(64);
//! let (clock, options) = (Clock::new(), LinkOptions::default());
//! let [hub, device] = [0, 1].map(|index| GatewayIndex::new(index).unwrap());
//!
//! let listener = link::listen(&"tcp:127.0.0.1:0".parse()?, hub, events.clone(), &clock, &options)?;
//! let dialler = link::open(&listener.description.name.parse()?, device, events, &clock, &options)?;
//! loop {
//!     match inbox.recv()? {
//!         (gateway, LinkEvent::Up) if gateway == device => dialler.send(vec![5, 0, 7])?,
//!         (gateway, LinkEvent::Packet { bytes, .. }) => break assert_eq!((gateway, bytes), (hub, vec![5, 0, 7])),
//!         _ => {}
//!     }
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod clock;
mod handle;
pub mod in_process;
mod key;
#[cfg(unix)]
mod pty;
mod pump;
mod secure;
mod serial;
mod spec;
mod stream;
mod tcp;
mod udp;

pub use clock::Clock;
pub use handle::{LinkDescription, LinkEvent, LinkFaults, LinkGone, LinkHandle};
pub use key::{Key, KeyError, LoadedKey};
pub use serial::found;
pub use spec::{LinkSpec, SerialTarget, SpecError, Target, UsbId};

use osap_protocol::GatewayIndex;
use osap_protocol::framing::Check;
use osap_sim::faults::FaultConfig;
use std::io;
use std::net::SocketAddr;
use std::sync::mpsc::SyncSender;

/// Longest packet that any link of this crate carries, bytes.
pub const MTU_BYTES_MAX: u16 = 4096;

/// What a link is run with, whatever it is.
#[derive(Clone, Debug)]
pub struct LinkOptions {
    /// Pre-shared key, `[LNK-05]`: beyond loopback TCP needs it, elsewhere on TCP it is used as well.
    pub key: Option<Key>,
    /// Faults for each direction, with draws of their own, `[LNK-07]`.
    pub faults: Option<FaultConfig>,
    /// Longest packet taken from either side, bytes: 1 to [`MTU_BYTES_MAX`].
    pub mtu_bytes: u16,
}

impl Default for LinkOptions {
    fn default() -> Self {
        Self { key: None, faults: None, mtu_bytes: 1024 }
    }
}

/// Why a link cannot be started. What happens later is told by [`LinkEvent::Down`].
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// A pseudo-terminal is made, not dialled.
    #[error(
        "{spec} can only be listened on; its peer opens the device whose name is then shown, as with serial:/dev/pts/3"
    )]
    ListenOnly {
        /// As given.
        spec: String,
    },
    /// A serial port has nobody to wait for.
    #[error("{spec} cannot be listened on: open it as a link, or listen on `pty` to offer a serial port")]
    OpenOnly {
        /// As given.
        spec: String,
    },
    /// `[LNK-04]` on TCP.
    #[error(
        "{address} is beyond loopback, and whoever reaches a link without a key can drive the machine: \
         give both ends `--key FILE`, or use 127.0.0.1"
    )]
    KeyNeeded {
        /// What the host was resolved to.
        address: SocketAddr,
    },
    /// `[LNK-04]` on UDP, which has no key.
    #[error("{address} is beyond loopback, where udp is not offered: use tcp:{address} with `--key FILE`")]
    UdpBeyondLoopback {
        /// What the host was resolved to.
        address: SocketAddr,
    },
    /// A key where nothing would use it.
    #[error("{spec} cannot be encrypted: leave out the key, or use tcp")]
    KeyUnused {
        /// As given.
        spec: String,
    },
    /// A check where encryption already authenticates.
    #[error("{spec} has a check, and a key that makes it superfluous: leave out `,check=`")]
    CheckUnused {
        /// As given.
        spec: String,
    },
    /// A name that means no address.
    #[error("cannot find {host}: {source}")]
    Resolve {
        /// As given.
        host: String,
        /// The resolver's answer.
        source: io::Error,
    },
    /// An address that cannot be listened on.
    #[error("cannot listen on {address}: {source}")]
    Bind {
        /// Resolved.
        address: SocketAddr,
        /// The system's answer.
        source: io::Error,
    },
    /// The system gave no pseudo-terminal.
    #[error("cannot make a pseudo-terminal: {reason}")]
    Pty {
        /// The system's answer.
        reason: String,
    },
    /// A packet size that cannot be.
    #[error("an MTU of {mtu_bytes} bytes: allowed is 1 to {MTU_BYTES_MAX}")]
    Mtu {
        /// As given.
        mtu_bytes: u16,
    },
    /// The system gave no thread.
    #[error("cannot start a thread for {name}: {source}")]
    Thread {
        /// The link.
        name: String,
        /// The system's answer.
        source: io::Error,
    },
}

/// Starts a link to a device or a listener. It returns at once: the link says `Up` when it is open, and opens again when it was lost.
///
/// # Errors
/// [`LinkError`] for what no waiting can mend.
pub fn open(
    spec: &LinkSpec,
    gateway: GatewayIndex,
    events: SyncSender<(GatewayIndex, LinkEvent)>,
    clock: &Clock,
    options: &LinkOptions,
) -> Result<LinkHandle, LinkError> {
    let start = Start { spec, gateway, events, clock, options };
    start.check()?;
    match &spec.target {
        Target::Serial { target, baud } => serial::open(start, target, *baud),
        Target::Tcp { host, port } => tcp::connect(start, host, *port),
        Target::Udp { host, port } => udp::connect(start, host, *port),
        Target::Pty => Err(LinkError::ListenOnly { spec: spec.to_string() }),
    }
}

/// Starts a link that waits for its peer. The description's name has the address it got where the system chose one: a TCP port
/// asked for as 0, the device of a pseudo-terminal.
///
/// # Errors
/// [`LinkError`] for what no waiting can mend.
pub fn listen(
    spec: &LinkSpec,
    gateway: GatewayIndex,
    events: SyncSender<(GatewayIndex, LinkEvent)>,
    clock: &Clock,
    options: &LinkOptions,
) -> Result<LinkHandle, LinkError> {
    let start = Start { spec, gateway, events, clock, options };
    start.check()?;
    match &spec.target {
        Target::Serial { .. } => Err(LinkError::OpenOnly { spec: spec.to_string() }),
        Target::Tcp { host, port } => tcp::listen(start, host, *port),
        Target::Udp { host, port } => udp::listen(start, host, *port),
        #[cfg(unix)]
        Target::Pty => pty::listen(start),
        #[cfg(not(unix))]
        Target::Pty => Err(LinkError::Pty { reason: "this system has none".to_owned() }),
    }
}

/// What [`open`] and [`listen`] were called with.
struct Start<'a> {
    spec: &'a LinkSpec,
    gateway: GatewayIndex,
    events: SyncSender<(GatewayIndex, LinkEvent)>,
    clock: &'a Clock,
    options: &'a LinkOptions,
}

impl<'a> Start<'a> {
    fn check(&self) -> Result<(), LinkError> {
        let (key, tcp) = (self.options.key.is_some(), matches!(self.spec.target, Target::Tcp { .. }));
        check_mtu(self.options)?;
        match self.spec.check {
            _ if key && matches!(self.spec.target, Target::Udp { .. }) => {
                Err(LinkError::KeyUnused { spec: self.spec.to_string() })
            }
            Some(_) if key && tcp => Err(LinkError::CheckUnused { spec: self.spec.to_string() }),
            _ => Ok(()),
        }
    }

    /// What the threads of a link with these frames need.
    fn plan(self, description: LinkDescription, form: pump::Form) -> pump::Plan<'a> {
        let Self { gateway, events, clock, options, .. } = self;
        pump::Plan { description, form, gateway, events, clock, options }
    }

    /// A description with what is the same for every link of a workstation but serial ones.
    fn describe(&self, name: String, type_name: &str, check: Check) -> LinkDescription {
        LinkDescription {
            name,
            type_name: type_name.to_owned(),
            mtu_bytes: self.options.mtu_bytes,
            bit_rate: 0,
            bits_a_byte: 8,
            check,
        }
    }
}

fn check_mtu(options: &LinkOptions) -> Result<(), LinkError> {
    match options.mtu_bytes {
        1..=MTU_BYTES_MAX => Ok(()),
        mtu_bytes => Err(LinkError::Mtu { mtu_bytes }),
    }
}

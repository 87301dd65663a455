//! Two links of one process that lead to each other.
//!
//! - **Walk:** one node's [`LinkHandle::send`] → a bounded channel → the other node's [`LinkEvent::Packet`].
//! - **Invariant:** as any other link: clear to send only as fast as the other side takes packets.
//! - **Clauses:** `[LNK-01]`, `[FRM-09]`.
//!
//! ```
//! use osap::link::{Clock, LinkEvent, LinkOptions, in_process};
//! use osap_protocol::GatewayIndex;
//! use std::sync::mpsc::sync_channel;
//!
//! let (events, inbox) = sync_channel(64);
//! let [left, right] = [0, 1].map(|index| GatewayIndex::new(index).unwrap());
//! let ends = [(left, events.clone()), (right, events)];
//! let (one, _other) = in_process::pair("loop", ends, &Clock::new(), &LinkOptions::default())?;
//! loop {
//!     match inbox.recv()? {
//!         (gateway, LinkEvent::Up) if gateway == left => one.send(vec![1, 2, 3])?,
//!         (gateway, LinkEvent::Packet { bytes, .. }) => break assert_eq!((gateway, bytes), (right, vec![1, 2, 3])),
//!         _ => {}
//!     }
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use super::pump::{self, Attempt, Ending, Form, Incoming, Opener, Plan, Session, Sink, Source};
use super::{Clock, LinkDescription, LinkError, LinkEvent, LinkHandle, LinkOptions, check_mtu};
use osap_protocol::GatewayIndex;
use osap_protocol::framing::Check;
use std::io;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::time::Duration;

/// Packets between the two sides.
const CHANNEL_PACKETS: usize = 4;
/// Between two looks at a channel that is full.
const FULL_RETRY: Duration = Duration::from_millis(1);

/// Makes both links, each with its gateway and where its events go. It ends for good when either handle is dropped.
///
/// # Errors
/// [`LinkError::Mtu`] and [`LinkError::Thread`].
pub fn pair(
    name: &str,
    ends: [(GatewayIndex, SyncSender<(GatewayIndex, LinkEvent)>); 2],
    clock: &Clock,
    options: &LinkOptions,
) -> Result<(LinkHandle, LinkHandle), LinkError> {
    check_mtu(options)?;
    let (to_left, from_right) = sync_channel(CHANNEL_PACKETS);
    let (to_right, from_left) = sync_channel(CHANNEL_PACKETS);
    let end = |(gateway, events), out, inlet| {
        let description = LinkDescription {
            name: format!("in-process:{name}"),
            type_name: "in-process".to_owned(),
            mtu_bytes: options.mtu_bytes,
            bit_rate: 0,
            bits_a_byte: 8,
            check: Check::None,
        };
        let session = Session {
            source: Box::new(Inlet { channel: inlet, clock: clock.clone() }),
            sink: Box::new(Outlet { channel: out }),
        };
        let plan = Plan { description, form: Form::Whole, gateway, events, clock, options };
        pump::start(plan, Box::new(Once(Some(session))))
    };
    let [left, right] = ends;
    Ok((end(left, to_right, from_right)?, end(right, to_left, from_left)?))
}

/// Opens once.
struct Once(Option<Session>);

impl Opener for Once {
    fn open(&mut self, _ending: &Ending<'_>) -> Attempt {
        self.0.take().map_or_else(|| Attempt::Over("the other side is gone".to_owned()), Attempt::Opened)
    }

    fn retry_after(&self, _failures: u32) -> Duration {
        Duration::ZERO
    }
}

fn gone() -> io::Error {
    io::Error::new(io::ErrorKind::BrokenPipe, "the other side is gone")
}

struct Inlet {
    channel: Receiver<Vec<u8>>,
    clock: Clock,
}

impl Source for Inlet {
    fn read(&mut self, wait: Duration, out: &mut Vec<Incoming>) -> io::Result<()> {
        match self.channel.recv_timeout(wait) {
            Ok(bytes) => out.push(Incoming::Frame { bytes, started: self.clock.now() }),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return Err(gone()),
        }
        Ok(())
    }
}

struct Outlet {
    channel: SyncSender<Vec<u8>>,
}

impl Sink for Outlet {
    fn write(&mut self, frame: &[u8], ending: &Ending<'_>) -> io::Result<()> {
        let mut packet = frame.to_vec();
        loop {
            packet = match self.channel.try_send(packet) {
                Ok(()) => return Ok(()),
                Err(TrySendError::Disconnected(_)) => return Err(gone()),
                Err(TrySendError::Full(_)) if ending.is_set() => return Err(gone()),
                Err(TrySendError::Full(packet)) => packet,
            };
            ending.wait(FULL_RETRY);
        }
    }
}

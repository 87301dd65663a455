//! UDP on loopback: one packet a datagram.
//!
//! - **Walk:** [`connect`] or [`listen`] → [`UdpSource`] and [`UdpSink`] → the link's reader and writer.
//! - **Invariants:** never beyond loopback, key or not: protocol decision 4. A listener's peer is who sent last, so that one that
//!   was started again is followed; until somebody sent, the listener is not up.
//! - **Clauses:** `[LNK-04]`, `[FRM-09]`.

use super::pump::{self, Attempt, Ending, Form, Incoming, Opener, Session, Sink, Source, WAIT_MAX};
use super::stream::is_wait_over;
use super::tcp::{first, on_loopback, resolve};
use super::{Clock, LinkError, LinkHandle, MTU_BYTES_MAX, Start};
use osap_protocol::DropCause;
use osap_protocol::framing::Check;
use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Between two tries to open a socket.
const RETRY: Duration = Duration::from_millis(500);

pub(super) fn connect(start: Start<'_>, host: &str, port: u16) -> Result<LinkHandle, LinkError> {
    let peer = loopback(host, port)?;
    let description = start.describe(start.spec.to_string(), "udp", Check::None);
    let opener = Dialler { peer, clock: start.clock.clone() };
    pump::start(start.plan(description, Form::Whole), Box::new(opener))
}

pub(super) fn listen(start: Start<'_>, host: &str, port: u16) -> Result<LinkHandle, LinkError> {
    let address = loopback(host, port)?;
    let bound = UdpSocket::bind(address).and_then(|socket| Ok((socket.local_addr()?, socket)));
    let (bound, socket) = bound.map_err(|source| LinkError::Bind { address, source })?;
    let description = start.describe(format!("udp:{bound}"), "udp", Check::None);
    let opener = Listener { socket, clock: start.clock.clone() };
    pump::start(start.plan(description, Form::Whole), Box::new(opener))
}

/// `[LNK-04]`, before any socket is made.
fn loopback(host: &str, port: u16) -> Result<SocketAddr, LinkError> {
    let addresses = on_loopback(resolve(host, port)?).map_err(|address| LinkError::UdpBeyondLoopback { address })?;
    first(&addresses, host)
}

/// Two handles of one socket, one packet in hand where it brought the peer's address.
fn session(socket: &UdpSocket, peer: SocketAddr, first: Vec<Incoming>, clock: &Clock) -> io::Result<Session> {
    let (reading, writing) = (socket.try_clone()?, socket.try_clone()?);
    writing.set_write_timeout(Some(WAIT_MAX))?;
    let peer = Arc::new(Mutex::new(peer));
    Ok(Session {
        source: Box::new(UdpSource { socket: reading, peer: Arc::clone(&peer), first, clock: clock.clone() }),
        sink: Box::new(UdpSink { socket: writing, peer }),
    })
}

struct Dialler {
    peer: SocketAddr,
    clock: Clock,
}

impl Opener for Dialler {
    fn open(&mut self, _ending: &Ending<'_>) -> Attempt {
        let own: SocketAddr = match self.peer {
            SocketAddr::V4(_) => (Ipv4Addr::LOCALHOST, 0).into(),
            SocketAddr::V6(_) => (Ipv6Addr::LOCALHOST, 0).into(),
        };
        // Not connected: the system would report that nobody listens, which a datagram link need not know.
        match UdpSocket::bind(own).and_then(|socket| session(&socket, self.peer, Vec::new(), &self.clock)) {
            Ok(session) => Attempt::Opened(session),
            Err(error) => Attempt::Failed(error.to_string()),
        }
    }

    fn retry_after(&self, _failures: u32) -> Duration {
        RETRY
    }
}

struct Listener {
    socket: UdpSocket,
    clock: Clock,
}

impl Opener for Listener {
    fn open(&mut self, _ending: &Ending<'_>) -> Attempt {
        let opened = receive(&self.socket, WAIT_MAX, &self.clock).and_then(|received| match received {
            None => Ok(None),
            Some((item, peer)) => session(&self.socket, peer, vec![item], &self.clock).map(Some),
        });
        match opened {
            Ok(Some(session)) => Attempt::Opened(session),
            Ok(None) => Attempt::NotYet,
            Err(error) => Attempt::Failed(error.to_string()),
        }
    }

    fn retry_after(&self, _failures: u32) -> Duration {
        RETRY
    }
}

/// One datagram and who sent it, or `None` after `wait`.
fn receive(socket: &UdpSocket, wait: Duration, clock: &Clock) -> io::Result<Option<(Incoming, SocketAddr)>> {
    // One byte more than fits, to tell a datagram that is cut off.
    let mut buffer = [0; MTU_BYTES_MAX as usize + 1];
    // Zero would mean for ever.
    socket.set_read_timeout(Some(wait.max(Duration::from_micros(1))))?;
    let (len, peer) = match socket.recv_from(&mut buffer) {
        Ok(received) => received,
        Err(error) if is_wait_over(&error) || is_nobody_there(&error) => return Ok(None),
        Err(error) => return Err(error),
    };
    let started = clock.now();
    let item = match buffer.get(..len) {
        Some(bytes) if len < buffer.len() => Incoming::Frame { bytes: bytes.to_vec(), started },
        _ => Incoming::Bad(DropCause::FrameTooLong),
    };
    Ok(Some((item, peer)))
}

/// An earlier datagram of ours reached no socket. The peer may come yet.
fn is_nobody_there(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::ConnectionRefused | io::ErrorKind::ConnectionReset)
}

struct UdpSource {
    socket: UdpSocket,
    peer: Arc<Mutex<SocketAddr>>,
    first: Vec<Incoming>,
    clock: Clock,
}

impl Source for UdpSource {
    fn read(&mut self, wait: Duration, out: &mut Vec<Incoming>) -> io::Result<()> {
        if !self.first.is_empty() {
            out.append(&mut self.first);
            return Ok(());
        }
        if let Some((item, peer)) = receive(&self.socket, wait, &self.clock)? {
            *self.peer.lock().unwrap_or_else(PoisonError::into_inner) = peer;
            out.push(item);
        }
        Ok(())
    }
}

struct UdpSink {
    socket: UdpSocket,
    peer: Arc<Mutex<SocketAddr>>,
}

impl Sink for UdpSink {
    fn write(&mut self, frame: &[u8], ending: &Ending<'_>) -> io::Result<()> {
        let peer = *self.peer.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            match self.socket.send_to(frame, peer) {
                Ok(_) => return Ok(()),
                Err(error) if is_nobody_there(&error) => return Ok(()),
                Err(error) if is_wait_over(&error) && !ending.is_set() => {}
                Err(error) => return Err(error),
            }
        }
    }
}

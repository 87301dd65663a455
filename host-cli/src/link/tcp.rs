//! TCP: a dialler that keeps trying and a listener that serves one peer after the other, plain on loopback or with a key anywhere.
//!
//! - **Walk:** [`connect`] or [`listen`] → address check → connection → without a key `stream`, with one `secure`.
//! - **Invariant:** without a key no socket is bound or connected beyond loopback, whatever a name resolves to later: addresses are
//!   resolved once, before anything is opened.
//! - **Clauses:** `[LNK-04]`, `[LNK-05]`, `[FRM-04]`: TCP checks its bytes, so plain frames carry no check unless told.

use super::pump::{self, Attempt, Ending, Form, Opener, WAIT_MAX};
use super::secure::{self, HandshakeError, Role};
use super::stream::{self, ByteStream, is_wait_over};
use super::{Clock, Key, LinkError, LinkHandle, Start};
use osap_protocol::framing::Check;
use socket2::{SockRef, TcpKeepalive};
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, ToSocketAddrs};
use std::time::Duration;

/// Longest wait for a connection to one address.
const CONNECT_MAX: Duration = Duration::from_secs(1);
/// First wait after a failed connection; it doubles up to the last.
const BACKOFF_FIRST: Duration = Duration::from_millis(100);
const BACKOFF_LAST: Duration = Duration::from_secs(2);
/// When a peer that says nothing is asked whether it is there, how often, and how many answers may fail: a machine that lost its power
/// does not close its connections, and the listener's one place must not wait a quarter of an hour for the system to notice.
const KEEPALIVE: TcpKeepalive =
    TcpKeepalive::new().with_time(Duration::from_secs(5)).with_interval(Duration::from_secs(2)).with_retries(3);
/// Longest time that bytes may go unanswered or untaken, for the same reason.
#[cfg(target_os = "linux")]
const UNANSWERED_MAX: Duration = Duration::from_secs(10);
/// Between two looks for a peer.
const ACCEPT_AGAIN: Duration = Duration::from_millis(50);

pub(super) fn connect(start: Start<'_>, host: &str, port: u16) -> Result<LinkHandle, LinkError> {
    let addresses = match &start.options.key {
        // Who has the key is the peer, wherever the name leads, now or later.
        Some(_) => Vec::new(),
        None => on_loopback(resolve(host, port)?).map_err(|address| LinkError::KeyNeeded { address })?,
    };
    let secured = Secured::new(&start);
    let description = start.describe(start.spec.to_string(), "tcp", secured.check);
    let dialler = Dialler { host: host.to_owned(), port, addresses, secured };
    let form = dialler.secured.form();
    pump::start(start.plan(description, form), Box::new(dialler))
}

pub(super) fn listen(start: Start<'_>, host: &str, port: u16) -> Result<LinkHandle, LinkError> {
    let mut addresses = resolve(host, port)?;
    if start.options.key.is_none() {
        addresses = on_loopback(addresses).map_err(|address| LinkError::KeyNeeded { address })?;
    }
    let address = first(&addresses, host)?;
    let bound = TcpListener::bind(address).and_then(|listener| {
        listener.set_nonblocking(true)?;
        Ok((listener.local_addr()?, listener))
    });
    let (bound, listener) = bound.map_err(|source| LinkError::Bind { address, source })?;
    let secured = Secured::new(&start);
    let description = start.describe(format!("tcp:{bound}"), "tcp", secured.check);
    let form = secured.form();
    pump::start(start.plan(description, form), Box::new(Acceptor { listener, secured }))
}

/// What `host` means, in the system's order.
pub(super) fn resolve(host: &str, port: u16) -> Result<Vec<SocketAddr>, LinkError> {
    let addresses = (host, port).to_socket_addrs();
    addresses.map(Iterator::collect).map_err(|source| LinkError::Resolve { host: host.to_owned(), source })
}

/// `[LNK-04]`: all of them, or the first that is not on loopback.
pub(super) fn on_loopback(addresses: Vec<SocketAddr>) -> Result<Vec<SocketAddr>, SocketAddr> {
    match addresses.iter().find(|address| !address.ip().to_canonical().is_loopback()) {
        Some(beyond) => Err(*beyond),
        None => Ok(addresses),
    }
}

pub(super) fn first(addresses: &[SocketAddr], host: &str) -> Result<SocketAddr, LinkError> {
    addresses.first().copied().ok_or_else(|| LinkError::Resolve {
        host: host.to_owned(),
        source: io::Error::new(io::ErrorKind::NotFound, "the name has no address"),
    })
}

/// What a connection becomes a session with.
struct Secured {
    key: Option<Key>,
    check: Check,
    clock: Clock,
}

impl Secured {
    fn new(start: &Start<'_>) -> Self {
        let check = start.spec.check.unwrap_or(Check::None);
        Self { key: start.options.key.clone(), check, clock: start.clock.clone() }
    }

    const fn form(&self) -> Form {
        if self.key.is_some() { Form::Whole } else { Form::Stuffed(self.check) }
    }

    fn session(&self, connection: TcpStream, role: Role, ending: &Ending<'_>) -> Attempt {
        let result = Tcp::new(connection).map_err(HandshakeError::Io).and_then(|mut reading| {
            let writing = reading.twin().map_err(HandshakeError::Io)?;
            match &self.key {
                None => Ok(stream::session(reading, writing, &self.clock)),
                Some(key) => secure::handshake(&mut reading, key, role, &self.clock, ending)
                    .map(|keys| secure::session(reading, writing, keys, &self.clock)),
            }
        });
        match result {
            Ok(session) => Attempt::Opened(session),
            Err(error) if error.is_refusal(role) => Attempt::Refused(error.to_string()),
            Err(error) => Attempt::Failed(error.to_string()),
        }
    }
}

struct Dialler {
    host: String,
    port: u16,
    /// Checked once; empty where a key makes that needless.
    addresses: Vec<SocketAddr>,
    secured: Secured,
}

impl Dialler {
    fn dial(&self) -> io::Result<TcpStream> {
        let resolved: Vec<SocketAddr> = match &self.addresses[..] {
            [] => (&self.host[..], self.port).to_socket_addrs()?.collect(),
            pinned => pinned.to_vec(),
        };
        let mut failed = io::Error::new(io::ErrorKind::NotFound, "the name has no address");
        for address in resolved {
            match TcpStream::connect_timeout(&address, CONNECT_MAX) {
                // While nobody listens on a port that the system also gives to diallers, a dialler can reach itself.
                Ok(connection) if connection.local_addr().ok() == connection.peer_addr().ok() => {
                    failed = io::Error::new(io::ErrorKind::ConnectionRefused, "nobody listens there");
                }
                Ok(connection) => return Ok(connection),
                Err(error) => failed = error,
            }
        }
        Err(failed)
    }
}

impl Opener for Dialler {
    fn open(&mut self, ending: &Ending<'_>) -> Attempt {
        match self.dial() {
            Ok(connection) => self.secured.session(connection, Role::Dialler, ending),
            Err(error) => Attempt::Failed(error.to_string()),
        }
    }

    fn retry_after(&self, failures: u32) -> Duration {
        let doubled = 2_u32.saturating_pow(failures.saturating_sub(1));
        BACKOFF_FIRST.saturating_mul(doubled).min(BACKOFF_LAST)
    }
}

struct Acceptor {
    listener: TcpListener,
    secured: Secured,
}

impl Opener for Acceptor {
    /// Others wait in the system's queue until this one has left.
    fn open(&mut self, ending: &Ending<'_>) -> Attempt {
        match self.listener.accept() {
            // On some systems an accepted socket inherits this.
            Ok((connection, _)) => match connection.set_nonblocking(false) {
                Ok(()) => self.secured.session(connection, Role::Listener, ending),
                Err(error) => Attempt::Failed(error.to_string()),
            },
            Err(error) if is_wait_over(&error) => {
                ending.wait(ACCEPT_AGAIN);
                Attempt::NotYet
            }
            Err(error) => Attempt::Failed(error.to_string()),
        }
    }

    fn retry_after(&self, _failures: u32) -> Duration {
        ACCEPT_AGAIN
    }
}

/// One handle of a connection.
pub(super) struct Tcp {
    stream: TcpStream,
    /// The read timeout as set last, to spare a system call a read.
    wait: Option<Duration>,
}

impl Tcp {
    fn new(stream: TcpStream) -> io::Result<Self> {
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(WAIT_MAX))?;
        let socket = SockRef::from(&stream);
        socket.set_tcp_keepalive(&KEEPALIVE)?;
        #[cfg(target_os = "linux")]
        socket.set_tcp_user_timeout(Some(UNANSWERED_MAX))?;
        Ok(Self { stream, wait: None })
    }

    fn twin(&self) -> io::Result<Self> {
        Ok(Self { stream: self.stream.try_clone()?, wait: None })
    }
}

impl ByteStream for Tcp {
    fn read_some(&mut self, into: &mut [u8], wait: Duration) -> io::Result<usize> {
        // Zero would mean for ever.
        let wait = wait.max(Duration::from_micros(1));
        if self.wait != Some(wait) {
            self.stream.set_read_timeout(Some(wait))?;
            self.wait = Some(wait);
        }
        match self.stream.read(into) {
            Ok(0) => Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the peer closed the connection")),
            Err(error) if is_wait_over(&error) => Ok(0),
            outcome => outcome,
        }
    }

    fn write_some(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self.stream.write(bytes) {
            Err(error) if is_wait_over(&error) => Ok(0),
            outcome => outcome,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A dead peer is noticed: read back from the system, since nothing else shows it without pulling a plug.
    #[test]
    fn a_connection_asks_whether_its_peer_is_there() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let tcp = Tcp::new(TcpStream::connect(listener.local_addr().unwrap()).unwrap()).unwrap();
        assert!(SockRef::from(&tcp.stream).keepalive().unwrap());
        assert!(tcp.stream.nodelay().unwrap());
        #[cfg(target_os = "linux")]
        assert_eq!(SockRef::from(&tcp.stream).tcp_user_timeout().unwrap(), Some(UNANSWERED_MAX));
    }

    /// `[LNK-04]`: one address beyond loopback is enough to refuse, also an IPv4 one dressed as IPv6.
    #[test]
    fn only_loopback_is_loopback() {
        let parse = |texts: &[&str]| -> Vec<SocketAddr> { texts.iter().map(|text| text.parse().unwrap()).collect() };
        for good in ["127.0.0.1:1", "127.9.9.9:1", "[::1]:1", "[::ffff:127.0.0.1]:1"] {
            assert!(on_loopback(parse(&[good])).is_ok(), "{good}");
        }
        for bad in ["0.0.0.0:1", "192.168.0.1:1", "[::]:1", "[::ffff:10.0.0.1]:1"] {
            assert_eq!(on_loopback(parse(&["127.0.0.1:1", bad])), Err(parse(&[bad])[0]), "{bad}");
        }
    }
}

//! Encryption of a TCP link with a key both ends know: Noise `NNpsk0_25519_ChaChaPoly_BLAKE2s`.
//!
//! - **Walk:** connection → [`handshake`] → one Noise message a packet, each behind its length (`u16`, little-endian).
//! - **Invariants:** a listener opens the link only after the dialler proved that it has the key *now*: its first message after the
//!   handshake is empty and must authenticate. Without it whoever recorded a handshake could replay its first message and hold the
//!   listener's one place. A message that does not authenticate ends the link.
//! - **Context:** the handshake runs in the link's reader thread and takes at most
//!   [`HANDSHAKE_MAX`] or [`ANSWER_MAX`].
//! - **Clause:** `[LNK-05]`.

use super::pump::{Ending, Incoming, Session, Sink, Source, WAIT_MAX};
use super::stream::{ByteStream, write_all};
use super::{Clock, Key, MTU_BYTES_MAX};
use fixed_math::time::{LocalTicks, Span};
use osap_protocol::DropCause;
use snow::{Builder, HandshakeState, StatelessTransportState};
use std::io;
use std::sync::Arc;
use std::time::Duration;

const PATTERN: &str = "Noise_NNpsk0_25519_ChaChaPoly_BLAKE2s";
/// Both ends hash it in: a peer of another protocol or version that has the same key is still refused.
const PROLOGUE: &[u8] = b"OSAP link 1";
/// Longest handshake that a listener waits for, from connection to proof: who connects and says nothing keeps the others out so long.
const HANDSHAKE_MAX: Span = Span::from_us(2_000_000);
/// Longest wait of a dialler: it may stand behind a silent one in the listener's queue.
const ANSWER_MAX: Span = Span::from_us(5_000_000);
/// What authenticates a message, bytes.
const TAG_BYTES: usize = 16;
/// Both messages of the handshake: a public key and a tag.
const HELLO_BYTES: usize = 32 + TAG_BYTES;
/// Longest message: the longest packet and its tag.
const MESSAGE_BYTES_MAX: usize = MTU_BYTES_MAX as usize + TAG_BYTES;
const LENGTH_BYTES: usize = 2;

/// Which end this is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    Dialler,
    Listener,
}

/// Why a connection is no link.
#[derive(Debug, thiserror::Error)]
pub(super) enum HandshakeError {
    /// The connection itself failed, or the link is ending.
    #[error("{0}")]
    Io(io::Error),
    /// What the peer sent was not made with the key.
    #[error("the peer was refused: it does not have this key")]
    WrongKey,
    /// The peer ended the connection before the handshake was over.
    #[error("the peer closed the connection in the handshake: it has another key or none")]
    Closed,
    /// Nothing, or not all, came in time.
    #[error("no handshake from the peer: it has no key, or serves another")]
    TooSlow,
    /// Our own library refused to begin.
    #[error("cannot encrypt: {0}")]
    Library(snow::Error),
}

impl HandshakeError {
    /// Whether the peer shall be counted as one without the key, rather than as one that was busy or left.
    pub(super) fn is_refusal(&self, role: Role) -> bool {
        match self {
            Self::WrongKey => true,
            // A listener hangs up on a wrong key, and answers nobody while it serves another.
            Self::Closed => role == Role::Dialler,
            Self::TooSlow => role == Role::Listener,
            Self::Io(_) | Self::Library(_) => false,
        }
    }
}

/// What an agreed session is encrypted with, and how many messages each way the handshake used up.
pub(super) struct Keys {
    transport: Arc<StatelessTransportState>,
    sent: u64,
    received: u64,
}

/// Agrees on the keys of a session, or refuses the peer.
pub(super) fn handshake(
    stream: &mut impl ByteStream,
    key: &Key,
    role: Role,
    clock: &Clock,
    ending: &Ending<'_>,
) -> Result<Keys, HandshakeError> {
    let limit = if role == Role::Listener { HANDSHAKE_MAX } else { ANSWER_MAX };
    let mut talk = Talk { stream, clock, ending, until: clock.now() + limit };
    let mut noise = begin(key, role).map_err(HandshakeError::Library)?;
    match role {
        Role::Dialler => {
            talk.say(&mut noise)?;
            talk.hear(&mut noise)?;
        }
        Role::Listener => {
            talk.hear(&mut noise)?;
            talk.say(&mut noise)?;
        }
    }
    let transport = Arc::new(noise.into_stateless_transport_mode().map_err(HandshakeError::Library)?);
    let (sent, received) = match role {
        Role::Dialler => {
            let mut proof = [0; TAG_BYTES];
            transport.write_message(0, &[], &mut proof).map_err(HandshakeError::Library)?;
            talk.send(&proof)?;
            (1, 0)
        }
        Role::Listener => {
            let proof = talk.receive::<TAG_BYTES>()?;
            transport.read_message(0, &proof, &mut [0; TAG_BYTES]).map_err(|_| HandshakeError::WrongKey)?;
            (0, 1)
        }
    };
    Ok(Keys { transport, sent, received })
}

fn begin(key: &Key, role: Role) -> Result<HandshakeState, snow::Error> {
    let builder = Builder::new(PATTERN.parse()?).prologue(PROLOGUE)?.psk(0, key.bytes())?;
    match role {
        Role::Dialler => builder.build_initiator(),
        Role::Listener => builder.build_responder(),
    }
}

/// A handshake's messages on a stream, with one time limit for all of them.
struct Talk<'a, S> {
    stream: &'a mut S,
    clock: &'a Clock,
    ending: &'a Ending<'a>,
    until: LocalTicks,
}

impl<S: ByteStream> Talk<'_, S> {
    fn say(&mut self, noise: &mut HandshakeState) -> Result<(), HandshakeError> {
        let mut message = [0; HELLO_BYTES];
        noise.write_message(&[], &mut message).map_err(HandshakeError::Library)?;
        self.send(&message)
    }

    fn hear(&mut self, noise: &mut HandshakeState) -> Result<(), HandshakeError> {
        let message = self.receive::<HELLO_BYTES>()?;
        noise.read_message(&message, &mut [0; HELLO_BYTES]).map_err(|_| HandshakeError::WrongKey)?;
        Ok(())
    }

    /// A few bytes into an empty send buffer: they never wait long.
    fn send(&mut self, message: &[u8]) -> Result<(), HandshakeError> {
        write_all(self.stream, &framed(message), self.ending).map_err(closed_or_io)
    }

    /// A message of `N` bytes and no other; nothing behind it is read.
    fn receive<const N: usize>(&mut self) -> Result<[u8; N], HandshakeError> {
        let length = usize::from(u16::from_le_bytes(self.receive_bytes()?));
        if length == N { self.receive_bytes() } else { Err(HandshakeError::WrongKey) }
    }

    fn receive_bytes<const N: usize>(&mut self) -> Result<[u8; N], HandshakeError> {
        let mut bytes = [0; N];
        let mut rest = &mut bytes[..];
        while !rest.is_empty() {
            let left = self.clock.until(self.until);
            if left.is_zero() {
                return Err(HandshakeError::TooSlow);
            }
            if self.ending.is_set() {
                return Err(HandshakeError::Io(io::Error::new(io::ErrorKind::ConnectionAborted, "the link ended")));
            }
            let len = self.stream.read_some(rest, left.min(WAIT_MAX)).map_err(closed_or_io)?;
            rest = rest.get_mut(len..).unwrap_or_default();
        }
        Ok(bytes)
    }
}

/// A peer that finds our key wrong can only hang up.
fn closed_or_io(error: io::Error) -> HandshakeError {
    match error.kind() {
        io::ErrorKind::UnexpectedEof | io::ErrorKind::ConnectionReset | io::ErrorKind::BrokenPipe => {
            HandshakeError::Closed
        }
        _ => HandshakeError::Io(error),
    }
}

/// A message behind its length. None of ours is longer than [`MESSAGE_BYTES_MAX`].
fn framed(message: &[u8]) -> Vec<u8> {
    let length = u16::try_from(message.len()).expect("messages are bounded by the MTU");
    [&length.to_le_bytes(), message].concat()
}

/// Both halves over two handles of one connection.
pub(super) fn session<S: ByteStream + 'static>(reading: S, writing: S, keys: Keys, clock: &Clock) -> Session {
    let Keys { transport, sent, received } = keys;
    Session {
        source: Box::new(SecureSource {
            stream: reading,
            transport: Arc::clone(&transport),
            received,
            clock: clock.clone(),
            buffer: Vec::new(),
            started: LocalTicks::ZERO,
        }),
        sink: Box::new(SecureSink { stream: writing, transport, sent }),
    }
}

struct SecureSource<S> {
    stream: S,
    transport: Arc<StatelessTransportState>,
    /// Messages so far: the number that the next one must have been encrypted with.
    received: u64,
    clock: Clock,
    /// Bytes that are no whole message yet.
    buffer: Vec<u8>,
    /// When the first of them came.
    started: LocalTicks,
}

impl<S: ByteStream> Source for SecureSource<S> {
    fn read(&mut self, wait: Duration, out: &mut Vec<Incoming>) -> io::Result<()> {
        let mut chunk = [0; LENGTH_BYTES + MESSAGE_BYTES_MAX];
        let len = self.stream.read_some(&mut chunk, wait)?;
        let at = self.clock.now();
        if self.buffer.is_empty() {
            self.started = at;
        }
        self.buffer.extend_from_slice(chunk.get(..len).unwrap_or_default());
        while let Some((length, rest)) = self.buffer.split_first_chunk::<LENGTH_BYTES>() {
            let length = usize::from(u16::from_le_bytes(*length));
            if length > MESSAGE_BYTES_MAX {
                return Err(forged(out));
            }
            let Some(message) = rest.get(..length) else { break };
            let mut packet = vec![0; length];
            let Ok(packet_len) = self.transport.read_message(self.received, message, &mut packet) else {
                return Err(forged(out));
            };
            self.received += 1;
            packet.truncate(packet_len);
            out.push(Incoming::Frame { bytes: packet, started: self.started });
            self.buffer.drain(..LENGTH_BYTES + length);
            // The end of that message came in this read, and so did what is behind it.
            self.started = at;
        }
        Ok(())
    }
}

/// Nothing behind a message that is not the peer's can be trusted, not even where the next one begins.
fn forged(out: &mut Vec<Incoming>) -> io::Error {
    out.push(Incoming::Bad(DropCause::FrameCheck));
    io::Error::new(io::ErrorKind::InvalidData, "a message was changed on its way, or is not the peer's")
}

struct SecureSink<S> {
    stream: S,
    transport: Arc<StatelessTransportState>,
    sent: u64,
}

impl<S: ByteStream> Sink for SecureSink<S> {
    fn write(&mut self, frame: &[u8], ending: &Ending<'_>) -> io::Result<()> {
        let mut message = vec![0; frame.len() + TAG_BYTES];
        self.transport.write_message(self.sent, frame, &mut message).map_err(io::Error::other)?;
        self.sent += 1;
        write_all(&mut self.stream, &framed(&message), ending)
    }
}

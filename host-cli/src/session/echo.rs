//! The application's echo, over each of the three transports.
//!
//! - **Walk:** a payload → port 1 of a device → the same payload. **Clauses:** `[TRN-02]`, `[TRN-03]`, `[TRN-07]`.

use super::Session;
use crate::core::MessageOutcome;
use crate::error::AskError;
use fixed_math::time::Span;
use osap_protocol::PortIndex;
use osap_protocol::transport::Transport;
use osap_runtime::sequenced::{Destination, RequestError};

/// Port of the echo in every device of ours.
pub const ECHO_PORT: PortIndex = PortIndex::from_low_bits(1);

/// What an echo came to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Echo {
    /// What came back.
    pub payload: Vec<u8>,
    /// From sending to the end of its arrival.
    pub round_trip: Span,
    /// How often it was sent; a datagram or message counts as one.
    pub tries: u8,
}

const WHAT: &str = "echo";

impl Session {
    /// Sends `payload` to the echo of a device and waits for it to come back.
    ///
    /// # Errors
    /// [`AskError`].
    pub fn echo(&mut self, to: &Destination, transport: Transport, payload: &[u8]) -> Result<Echo, AskError> {
        // a long message goes in packets of the route's size
        let packet_bytes = payload.len().min(usize::from(to.mtu_bytes));
        let to = self.budgeted(to, packet_bytes, packet_bytes)?;
        let to = Destination { port: ECHO_PORT, ..to };
        match transport {
            Transport::Datagram => self.echo_datagram(&to, payload),
            Transport::Sequenced => {
                let reply = self.request(&to, WHAT, payload)?;
                Ok(Echo { payload: reply.payload, round_trip: reply.round_trip, tries: reply.tries })
            }
            Transport::Segmented => self.echo_message(&to, payload),
        }
    }

    fn echo_datagram(&mut self, to: &Destination, payload: &[u8]) -> Result<Echo, AskError> {
        let started = self.network.now();
        let sent = self.network.send_datagram(to, payload)?;
        sent.map_err(|error| AskError::Send { place: self.place(to), error: RequestError::Send(error) })?;
        let deadline = started + Span::from_us(u64::from(to.ttl_us));
        loop {
            let left = deadline.since(self.network.now());
            match self.network.receive_datagram(left)? {
                Some(back) if back.route == to.route && back.port == to.port && back.payload == payload => {
                    let round_trip = back.arrived.since(started);
                    return Ok(Echo { payload: back.payload, round_trip, tries: 1 });
                }
                Some(_) => {}
                None => {
                    let waited_us = u64::from(to.ttl_us);
                    return Err(AskError::Timeout { place: self.place(to), what: WHAT, tries: 1, waited_us });
                }
            }
        }
    }

    fn echo_message(&mut self, to: &Destination, message: &[u8]) -> Result<Echo, AskError> {
        // each segment may take all its tries
        let patience = Span::from_us(u64::from(to.ttl_us)).saturating_mul(8 + message.len() as u64 / 16);
        let outcome = self.network.exchange_message(to, message, patience)?;
        let place = self.place(to);
        match outcome.map_err(|error| AskError::Message { place: place.clone(), error })? {
            MessageOutcome::Answered { message, round_trip } => Ok(Echo { payload: message, round_trip, tries: 1 }),
            MessageOutcome::Refused(reason) => Err(AskError::MessageRefused { place, reason }),
            MessageOutcome::Stuck { .. } | MessageOutcome::NoAnswer => {
                Err(AskError::Timeout { place, what: WHAT, tries: 1, waited_us: patience.as_us_ceil() })
            }
        }
    }
}

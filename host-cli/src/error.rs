//! What can go wrong between the host and a device: each error says what happened, where, and what to do next.
//!
//! - **Walk:** a driver gives [`NetworkError`]; a session's questions give [`AskError`]; opening one gives [`OpenError`].
//! - **Invariant:** errors carry their operands; nothing here is a string that a caller would have to take apart.
//! - **Context:** any.

use crate::link::{LinkError, SpecError};
use crate::map::RouteText;
use crate::network::SimSpecError;
use crate::session::{RefusalText, RouteTooSlow};
use osap_protocol::discovery::Refusal;
use osap_protocol::motion::MotionRefusal;
use osap_protocol::transport::SegmentRefusal;
use osap_runtime::SendError;
use osap_runtime::segmented::MessageError;
use osap_runtime::sequenced::RequestError;
use std::fmt::{self, Display, Formatter};

/// Where something happened: a device by its name, if that is known, and the way there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// Its name.
    pub name: Option<String>,
    /// The way.
    pub route: RouteText,
}

impl Display for Place {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match &self.name {
            Some(name) if !name.is_empty() => write!(f, "{name} ({})", self.route),
            _ => write!(f, "the device at {}", self.route),
        }
    }
}

/// The network itself cannot go on.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NetworkError {
    /// Waiting for what nobody asked for.
    #[error("no request is open, so there is nothing to wait for")]
    Idle,
    /// The node's thread has ended.
    #[error("the host's node has stopped; open the network again")]
    Stopped,
}

/// Why there is no session.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// No link was given.
    #[error("no link was given: name one, such as `--link serial` or `--link sim:printer`")]
    NoLink,
    /// More links than a node has gateways.
    #[error("{given} links were given; the host has room for {limit}")]
    TooManyLinks {
        /// How many.
        given: usize,
        /// How many there may be.
        limit: usize,
    },
    /// A simulated machine beside something else.
    #[error("a simulated machine is a network of its own: give `{spec}` alone")]
    SimulationNotAlone {
        /// As given.
        spec: String,
    },
    /// A link that does not start.
    #[error("{spec}: {source}")]
    Link {
        /// As given.
        spec: String,
        /// Why.
        source: LinkError,
    },
    /// A capture that cannot be written.
    #[error("the capture {path} cannot be written: {reason}")]
    Capture {
        /// As given.
        path: String,
        /// Why.
        reason: String,
    },
    /// An option that only one of the two kinds of network has.
    #[error("{option} does not go with {spec}: {instead}")]
    Option {
        /// Which.
        option: &'static str,
        /// With what.
        spec: String,
        /// What to do.
        instead: &'static str,
    },
    /// The system gave no thread.
    #[error("the node's thread cannot be started: {0}")]
    Thread(std::io::Error),
}

/// Why a text names no link and no simulated machine.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NetworkSpecError {
    /// It begins with `sim:`.
    #[error(transparent)]
    Sim(#[from] SimSpecError),
    /// It does not.
    #[error("{0}; a simulated machine begins with sim, such as sim:printer")]
    Link(#[from] SpecError),
}

/// Why a question has no answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AskError {
    /// Nobody answered.
    Timeout {
        /// Who was asked.
        place: Place,
        /// What was asked for.
        what: &'static str,
        /// How often.
        tries: u8,
        /// Time each try was given, µs.
        waited_us: u64,
    },
    /// The device refused.
    Refused {
        /// Who was asked.
        place: Place,
        /// What was asked for.
        what: &'static str,
        /// The reason it gave.
        refusal: Refusal,
    },
    /// What came back is no answer to what was asked.
    Malformed {
        /// Who was asked.
        place: Place,
        /// What was asked for.
        what: &'static str,
        /// Length of what came, bytes.
        len: usize,
    },
    /// The wires of the route are too slow for any packet's time to live, `[PKT-11]`.
    TooSlow {
        /// Who was to be asked.
        place: Place,
        /// The sum.
        budget: RouteTooSlow,
    },
    /// The host could not send.
    Send {
        /// Who was to be asked.
        place: Place,
        /// Why.
        error: RequestError,
    },
    /// A message that cannot be cut into packets of this route.
    Message {
        /// Who was to get it.
        place: Place,
        /// Why.
        error: MessageError,
    },
    /// The receiver did not take a message.
    MessageRefused {
        /// Who was to get it.
        place: Place,
        /// The reason it gave.
        reason: SegmentRefusal,
    },
    /// A motion port refused.
    MotionRefused {
        /// Who was asked.
        place: Place,
        /// Why.
        refusal: MotionRefusal,
    },
    /// The network cannot go on.
    Network(NetworkError),
}

impl From<NetworkError> for AskError {
    fn from(error: NetworkError) -> Self {
        Self::Network(error)
    }
}

impl Display for AskError {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Timeout { place, what, tries, waited_us } => write!(
                f,
                "{place} did not answer {what}: {tries} tries of {waited_us} µs each. \
                 Check that it is powered and plugged in; a new scan shows what is reachable"
            ),
            Self::Refused { place, what, refusal } => {
                write!(f, "{place} refused {what}: {refusal}. {}", after_refusal(*refusal))
            }
            Self::Malformed { place, what, len } => write!(
                f,
                "{place} answered {what} with {len} bytes that do not decode. \
                 Its firmware speaks another version: compare `version` in the map and update the older side"
            ),
            Self::TooSlow { place, budget } => write!(f, "{place} cannot be reached in time: {budget}"),
            Self::Send { place, error } => write!(f, "nothing was sent to {place}: {}", RequestText(error)),
            Self::Message { place, error } => write!(f, "nothing was sent to {place}: {}", MessageText(error)),
            Self::MessageRefused { place, reason: SegmentRefusal::Busy } => {
                write!(f, "{place} is taking another message; try again when that is whole")
            }
            Self::MessageRefused { place, reason: SegmentRefusal::TooLong } => {
                write!(f, "{place} has no room for a message of this length; send a shorter one")
            }
            Self::MotionRefused { place, refusal } => write!(f, "{place} refused motion: {}", RefusalText(refusal)),
            Self::Network(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for AskError {}

fn after_refusal(refusal: Refusal) -> &'static str {
    match refusal {
        Refusal::UnknownKey | Refusal::Version | Refusal::Body => "Update its firmware, or use an older osap",
        Refusal::Index => "Scan again: the map may be older than its firmware",
        Refusal::Range => "Nothing was changed; give a value within the range",
        Refusal::TooLong => "Ask for less at once, or use a route with larger packets",
    }
}

/// A [`RequestError`] for people.
pub(crate) struct RequestText<'a>(pub(crate) &'a RequestError);

impl Display for RequestText<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self.0 {
            RequestError::Busy { limit } => write!(f, "{limit} requests are open already; wait for some to end"),
            RequestError::TooLong { len, limit } => {
                write!(f, "the request has {len} bytes, at most {limit} can be kept for a retry; ask for less at once")
            }
            RequestError::Send(SendError::Refused(cause)) => {
                // a cause's meaning is a whole sentence
                let meaning = cause.meaning().trim_end_matches('.');
                write!(f, "{meaning}. Check the link and the first step of the route")
            }
            RequestError::Send(error) => write!(f, "{error}"),
        }
    }
}

/// A [`MessageError`] for people.
struct MessageText<'a>(&'a MessageError);

impl Display for MessageText<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self.0 {
            MessageError::Empty => f.write_str("the message is empty"),
            MessageError::NoRoom { mtu_bytes } => write!(f, "packets of {mtu_bytes} bytes have no room for a segment"),
            MessageError::TooLong { len, limit } => {
                write!(f, "the message has {len} bytes, the route carries {limit}")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osap_protocol::DropCause;

    /// No cause brings a full stop of its own before that of the sentence.
    #[test]
    fn sentences_end_once() {
        for cause in DropCause::ALL {
            let text = RequestText(&RequestError::Send(SendError::Refused(*cause))).to_string();
            assert!(!text.contains("..") && text.contains(". Check the link"), "{text}");
        }
    }
}

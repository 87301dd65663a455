//! Every query of the netresponder as a call.
//!
//! - **Walk:** a call here → [`Session::ask`](super::Session::ask). **Invariant:** lists are followed to their ends, `[DSC-06]`.
//! - **Clauses:** `[DSC-01]`, `[DSC-05]`, `[DSC-06]`, `[DSC-07]`.

use super::Session;
use crate::core::Reply;
use crate::error::{AskError, Place};
use fixed_math::time::{LocalTicks, Span};
use osap_protocol::DropCause;
use osap_protocol::discovery::{
    self, BODY_BYTES_MAX, ClockMark, CounterPage, DebugEvent, DebugPage, LinkInfo, Name, PortInfo, Query, Refusal,
    RuntimeInfo, ScanId, TimeAsymmetry, TimeControl, TimeLink, TimeSettings, TimeStatus, Verbosity,
};
use osap_runtime::sequenced::Destination;
use serde::de::DeserializeOwned;

/// An answer, and what it took to get it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer<A> {
    /// What was asked for.
    pub value: A,
    /// When the answer ended, by the host's clock.
    pub arrived: LocalTicks,
    /// From the last time the question was sent to then.
    pub round_trip: Span,
    /// How often it was sent.
    pub tries: u8,
}

/// A device's debug events.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DebugLog {
    /// Number of the first event here; above the cursor asked for where older ones are gone.
    pub first: u32,
    /// Cursor to go on from later.
    pub next: u32,
    /// Events between the two that made way for newer ones while they were read.
    pub missed: u32,
    /// What the device writes down at present.
    pub verbosity: Verbosity,
    /// System time against the device's own clock, as of the last page; `None` where it has none, `[TIM-15]`.
    pub clock: Option<ClockMark>,
    /// The events, oldest first.
    pub events: Vec<DebugEvent>,
}

/// One of a device's counters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Counter {
    /// Its number.
    pub index: u8,
    /// What it counts; `None` where the device is newer than this program.
    pub cause: Option<DropCause>,
    /// How often it happened.
    pub value: u32,
}

/// Pages read in a row at most: no answer shall keep us for ever.
const PAGES_MAX: usize = 64;

impl Session {
    /// Who the device is. It counts as a visit of scan 0, which no scan is.
    ///
    /// # Errors
    /// [`AskError`].
    pub fn runtime_info(&mut self, to: &Destination) -> Result<Answer<RuntimeInfo>, AskError> {
        self.ask(to, Query::RuntimeInfo, &ScanId::default())
    }

    /// What kind it is.
    ///
    /// # Errors
    /// [`AskError`].
    pub fn type_name(&mut self, to: &Destination) -> Result<Answer<Name>, AskError> {
        self.ask(to, Query::TypeName, &())
    }

    /// What it is called.
    ///
    /// # Errors
    /// [`AskError`].
    pub fn name(&mut self, to: &Destination) -> Result<Answer<Name>, AskError> {
        self.ask(to, Query::RuntimeName, &())
    }

    /// Gives it a name of up to `NAME_BYTES_MAX` bytes, `[DSC-05]`.
    ///
    /// # Errors
    /// [`AskError`]; a name that is too long is refused before anything is sent.
    pub fn set_name(&mut self, to: &Destination, name: &str) -> Result<Answer<()>, AskError> {
        let what = Query::SetRuntimeName.name();
        let fits = Name::try_from(name);
        let name = fits.map_err(|_| AskError::Refused { place: self.place(to), what, refusal: Refusal::Range })?;
        self.ask(to, Query::SetRuntimeName, &name)
    }

    /// One of its links or buses.
    ///
    /// # Errors
    /// [`AskError`].
    pub fn link_info(&mut self, to: &Destination, gateway: u8) -> Result<Answer<LinkInfo>, AskError> {
        self.ask(to, Query::LinkInfo, &gateway)
    }

    /// One of its ports.
    ///
    /// # Errors
    /// [`AskError`].
    pub fn port_info(&mut self, to: &Destination, port: u16) -> Result<Answer<PortInfo>, AskError> {
        self.ask(to, Query::PortInfo, &port)
    }

    /// Its debug events from number `cursor` on, to the one that was the newest when it was first asked, `[DSC-06]`: a device that
    /// writes down every packet writes down our questions too, and faster than they read.
    ///
    /// # Errors
    /// [`AskError`].
    pub fn debug_log(&mut self, to: &Destination, cursor: u32) -> Result<DebugLog, AskError> {
        let mut page = self.ask::<_, DebugPage>(to, Query::DebugMessages, &cursor)?.value;
        let (first, end) = (page.first, page.end);
        let mut log = DebugLog {
            first,
            next: first,
            missed: 0,
            verbosity: page.verbosity,
            clock: page.clock,
            events: Vec::new(),
        };
        // numbers wrap: what counts is how far they are from the first
        let place = |number: u32| number.wrapping_sub(first);
        for _ in 0..PAGES_MAX {
            log.missed += place(page.first).saturating_sub(place(log.next)).min(place(end) - place(log.next));
            let numbers = (0..).map(|n| page.first.wrapping_add(n));
            let wanted = numbers.zip(&page.events).filter(|(number, _)| place(*number) < place(end));
            log.events.extend(wanted.map(|(_, event)| event.clone()));
            log.next = if place(page.next) < place(end) { page.next } else { end };
            if log.next == end || page.events.is_empty() {
                break;
            }
            page = self.ask::<_, DebugPage>(to, Query::DebugMessages, &log.next)?.value;
            log.clock = page.clock;
        }
        Ok(log)
    }

    /// Sets what it writes down.
    ///
    /// # Errors
    /// [`AskError`].
    pub fn set_verbosity(&mut self, to: &Destination, verbosity: Verbosity) -> Result<Answer<()>, AskError> {
        self.ask(to, Query::SetDebugVerbosity, &verbosity)
    }

    /// Its clock, `[DSC-07]`.
    ///
    /// # Errors
    /// [`AskError`].
    pub fn time_control(&mut self, to: &Destination) -> Result<Answer<TimeControl>, AskError> {
        self.ask(to, Query::TimeControl, &())
    }

    /// Sets what can be tuned of its clock.
    ///
    /// # Errors
    /// [`AskError`].
    pub fn set_time_control(&mut self, to: &Destination, settings: &TimeSettings) -> Result<Answer<()>, AskError> {
        self.ask(to, Query::SetTimeControl, settings)
    }

    /// What its clock follows, `[TIM-12]`.
    ///
    /// # Errors
    /// [`AskError`].
    pub fn time_status(&mut self, to: &Destination) -> Result<Answer<TimeStatus>, AskError> {
        self.ask(to, Query::TimeStatus, &())
    }

    /// What it knows of the clock at a gateway's other end, `[TIM-12]`.
    ///
    /// # Errors
    /// [`AskError`].
    pub fn time_link(&mut self, to: &Destination, gateway: u8) -> Result<Answer<TimeLink>, AskError> {
        self.ask(to, Query::TimeLink, &gateway)
    }

    /// Sets the asymmetry of its links of one type, `[TIM-13]`.
    ///
    /// # Errors
    /// [`AskError`].
    pub fn set_time_asymmetry(&mut self, to: &Destination, asymmetry: &TimeAsymmetry) -> Result<Answer<()>, AskError> {
        self.ask(to, Query::SetTimeAsymmetry, asymmetry)
    }

    /// All of its counters, `[DSC-06]`.
    ///
    /// # Errors
    /// [`AskError`].
    pub fn counters(&mut self, to: &Destination) -> Result<Vec<Counter>, AskError> {
        let mut counters = Vec::new();
        let mut first = 0u8;
        loop {
            let page = self.ask::<_, CounterPage>(to, Query::Counters, &first)?.value;
            for (index, value) in (first..=u8::MAX).zip(page.values.iter().copied()) {
                counters.push(Counter { index, cause: DropCause::from_index(usize::from(index)), value });
            }
            let next = usize::from(first) + page.values.len();
            match u8::try_from(next) {
                Ok(next) if next < page.total && !page.values.is_empty() => first = next,
                _ => return Ok(counters),
            }
        }
    }
}

/// Length of the longest answer to a query, key and version included, bytes.
pub(super) const fn reply_bytes(query: Query) -> usize {
    match query {
        Query::RuntimeInfo => 62,
        Query::TypeName | Query::RuntimeName => 35,
        Query::LinkInfo => 90,
        Query::PortInfo | Query::TimeLink => 80,
        Query::DebugMessages => 2 + BODY_BYTES_MAX,
        Query::TimeControl => 63,
        Query::Counters => 86,
        Query::TimeStatus => 100,
        Query::SetRuntimeName | Query::SetDebugVerbosity | Query::SetTimeControl | Query::SetTimeAsymmetry => 3,
    }
}

/// Decodes a reply: the same key, this version, a whole body.
pub(super) fn read_answer<A: DeserializeOwned>(
    reply: &Reply,
    query: Query,
    place: impl FnOnce() -> Place,
) -> Result<Answer<A>, AskError> {
    let message = discovery::decode(&reply.payload).ok().filter(|message| message.key == query.key());
    match message.and_then(|message| message.body.read::<A>().ok()) {
        Some(value) => Ok(Answer { value, arrived: reply.arrived, round_trip: reply.round_trip, tries: reply.tries }),
        None => Err(AskError::Malformed { place: place(), what: query.name(), len: reply.payload.len() }),
    }
}

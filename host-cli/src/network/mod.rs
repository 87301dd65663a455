//! Something that carries requests for us, synchronously: over real links, or in a simulated world.
//!
//! - **Walk:** a session → [`Network::submit`] → [`HostCore`], wherever it runs → [`Network::wait`] → the session.
//! - **Invariants:** a network has two duties, to let a [`Task`] look at the core after all that happens there, and to know the
//!   time. All else here is made of these, so that a simulated network cannot behave otherwise than a real one.
//! - **Context:** the caller's thread. [`real`] runs the core on a thread of its own, [`sim`] on the caller's.

mod capture;
pub mod real;
pub mod sim;
mod spec;

pub use real::RealNetwork;
pub use sim::SimNetwork;
pub use spec::{NetworkSpec, SimKind, SimSpec, SimSpecError};

use crate::core::{Completion, Datagram, HostCore, MessageOutcome, NetworkEvent, Statistics};
use crate::error::NetworkError;
use fixed_math::time::{LocalTicks, Span};
use osap_protocol::discovery::{GatewayKind, LinkInfo, UniqueId};
use osap_protocol::{GatewayIndex, RouteBuf};
use osap_runtime::segmented::MessageError;
use osap_runtime::sequenced::{Destination, Expect, RequestError, Ticket};
use osap_runtime::{SendError, SystemTime};
use std::sync::mpsc::sync_channel;

/// Looks at the core and says whether it has seen what it waits for.
pub type Task = Box<dyn FnMut(&mut HostCore, LocalTicks) -> bool + Send>;

/// The host itself and its links.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LocalInfo {
    /// Which host.
    pub unique_id: UniqueId,
    /// Its links, in order of their indices, with who is at the other end.
    pub links: Vec<LinkInfo>,
    /// What they are for people: `tcp:127.0.0.1:4100`. As many as `links`.
    pub link_names: Vec<String>,
}

/// Carries requests, one caller at a time.
pub trait Network {
    /// Calls `task` at once and after all that happens at the core, until it says so or the host's clock shows `until`.
    ///
    /// # Errors
    /// [`NetworkError::Stopped`].
    fn drive(&mut self, until: LocalTicks, task: Task) -> Result<(), NetworkError>;

    /// The host's clock.
    fn now(&self) -> LocalTicks;

    /// What the host's links are called, in order of their indices.
    fn link_names(&self) -> Vec<String>;

    /// Whether its time is virtual: then it says nothing about this computer.
    fn is_simulated(&self) -> bool;

    /// Why the capture that was asked for ended early, if it did.
    fn capture_fault(&self) -> Option<String>;

    /// Sends a request.
    ///
    /// # Errors
    /// [`RequestError`]; nothing is open then. A network that has stopped is `Busy` with a limit of 0, and says so in [`Network::wait`].
    fn submit(&mut self, to: Destination, expect: Expect, payload: &[u8]) -> Result<Ticket, RequestError> {
        let (mut request, payload) = (Some(to), payload.to_vec());
        let sent = at_once(self, move |core, now| Some(core.request(request.take()?, expect, &payload, now)));
        sent.ok().flatten().unwrap_or(Err(RequestError::Busy { limit: 0 }))
    }

    /// Waits until an open request comes to something.
    ///
    /// # Errors
    /// [`NetworkError::Idle`] where none is open.
    fn wait(&mut self) -> Result<Completion, NetworkError> {
        let next = |core: &mut HostCore, _| match core.take_completion() {
            Some(completion) => Some(Ok(completion)),
            None if core.open_requests() == 0 => Some(Err(NetworkError::Idle)),
            None => None,
        };
        until(self, LocalTicks::MAX, next)?.unwrap_or(Err(NetworkError::Idle))
    }

    /// The host and its links.
    ///
    /// # Errors
    /// [`NetworkError::Stopped`].
    fn local(&mut self) -> Result<LocalInfo, NetworkError> {
        let link_names = self.link_names();
        let found = at_once(self, |core, _| Some((core.unique_id(), core.links())))?;
        let (unique_id, links) = found.ok_or(NetworkError::Stopped)?;
        Ok(LocalInfo { unique_id, links, link_names })
    }

    /// What happened at the links since the last call, in order.
    ///
    /// # Errors
    /// [`NetworkError::Stopped`].
    fn events(&mut self) -> Result<Vec<NetworkEvent>, NetworkError> {
        let all = |core: &mut HostCore, _| Some(std::iter::from_fn(|| core.take_event()).collect());
        Ok(at_once(self, all)?.unwrap_or_default())
    }

    /// Gives links time to open and neighbours time to announce themselves: until each open link has one, at most for `at_most`.
    ///
    /// # Errors
    /// [`NetworkError::Stopped`].
    fn settle(&mut self, at_most: Span) -> Result<(), NetworkError> {
        let is_known = |link: &LinkInfo| link.open && (link.neighbour.is_some() || link.kind != GatewayKind::Link);
        let settled = move |core: &mut HostCore, _| core.links().iter().all(is_known).then_some(());
        let deadline = self.now() + at_most;
        until(self, deadline, settled).map(|_| ())
    }

    /// Lets `span` pass, with the links at work.
    ///
    /// # Errors
    /// [`NetworkError::Stopped`].
    fn pause(&mut self, span: Span) -> Result<(), NetworkError> {
        let deadline = self.now() + span;
        self.drive(deadline, Box::new(|_, _| false))
    }

    /// What went over the links so far.
    ///
    /// # Errors
    /// [`NetworkError::Stopped`].
    fn statistics(&mut self) -> Result<Statistics, NetworkError> {
        at_once(self, |core, _| Some(core.statistics()))?.ok_or(NetworkError::Stopped)
    }

    /// System time at `at` by the host's clock, as the host has it.
    ///
    /// # Errors
    /// [`NetworkError::Stopped`].
    fn system_time(&mut self, at: LocalTicks) -> Result<SystemTime, NetworkError> {
        at_once(self, move |core, _| Some(core.system_time(at)))?.ok_or(NetworkError::Stopped)
    }

    /// Sends a datagram from the host's stream port.
    ///
    /// # Errors
    /// [`SendError`], or that the network has stopped.
    fn send_datagram(&mut self, to: &Destination, payload: &[u8]) -> Result<Result<(), SendError>, NetworkError> {
        let (to, payload) = (to.clone(), payload.to_vec());
        at_once(self, move |core, now| Some(core.send_datagram(&to, &payload, now)))?.ok_or(NetworkError::Stopped)
    }

    /// The next datagram that came to the host's stream port; waits at most `within` for it.
    ///
    /// # Errors
    /// [`NetworkError::Stopped`].
    fn receive_datagram(&mut self, within: Span) -> Result<Option<Datagram>, NetworkError> {
        let deadline = self.now() + within;
        until(self, deadline, |core, _| core.take_datagram())
    }

    /// Sends a message in segments and waits for the one that comes back.
    ///
    /// # Errors
    /// [`MessageError`], or that the network has stopped.
    fn exchange_message(
        &mut self,
        to: &Destination,
        message: &[u8],
        within: Span,
    ) -> Result<Result<MessageOutcome, MessageError>, NetworkError> {
        let (to, message) = (to.clone(), message.to_vec());
        let started = at_once(self, move |core, now| Some(core.start_message(&to, &message, within, now)))?;
        if let Err(error) = started.ok_or(NetworkError::Stopped)? {
            return Ok(Err(error));
        }
        // the core ends it at its deadline at the latest
        let outcome = until(self, LocalTicks::MAX, |core, _| core.take_message_outcome())?;
        outcome.map(Ok).ok_or(NetworkError::Stopped)
    }
}

/// The host's link that a route begins with.
#[must_use]
pub fn first_link(route: &RouteBuf) -> Option<GatewayIndex> {
    route.as_route().steps().next().map(osap_protocol::Step::gateway)
}

/// Waits until `look` finds something; `None` where `deadline` came first.
fn until<N: Network + ?Sized, R: Send + 'static>(
    network: &mut N,
    deadline: LocalTicks,
    mut look: impl FnMut(&mut HostCore, LocalTicks) -> Option<R> + Send + 'static,
) -> Result<Option<R>, NetworkError> {
    let (found, result) = sync_channel(1);
    let task = move |core: &mut HostCore, now: LocalTicks| match look(core, now) {
        // the task is called no more after it said so, and so the channel has room
        Some(value) => found.try_send(value).is_ok(),
        None => false,
    };
    network.drive(deadline, Box::new(task))?;
    Ok(result.try_recv().ok())
}

/// Looks once.
fn at_once<N: Network + ?Sized, R: Send + 'static>(
    network: &mut N,
    look: impl FnMut(&mut HostCore, LocalTicks) -> Option<R> + Send + 'static,
) -> Result<Option<R>, NetworkError> {
    until(network, LocalTicks::ZERO, look)
}

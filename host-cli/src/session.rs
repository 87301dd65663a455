//! Questions to devices, typed, over any network.
//!
//! - **Walk:** `Session::open` → [`Session::scan`](crate::scan) or a route → [`Session::ask`] → [`Network::submit`] → … →
//!   [`Network::wait`] → the answer, decoded.
//! - **Invariants:** an error says who was asked, and what to do. What a session was [taught](Session::learn) by a map gives names in
//!   errors, packet sizes and times to live that can work.
//! - **Context:** the caller's thread. **Clauses:** `[DSC-01]`, `[DSC-06]`, `[PKT-11]`.
//!
//! ```
//! use osap::map::RouteText;
//! use osap::session::Session;
//!
//! let mut session = Session::open(&["sim:line:2".parse()?], &Default::default())?;
//! let host = session.destination(&RouteText::host());
//! let info = session.runtime_info(&host)?;
//! assert_eq!(info.value.gateways, 1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod budget;
mod echo;
mod motion;
mod queries;
mod window;

pub use budget::{RouteBudget, RouteTooSlow, TTL_DEFAULT_US};
pub use echo::{ECHO_PORT, Echo};
pub(crate) use motion::RefusalText;
pub use queries::{Answer, Counter, DebugLog};
pub(crate) use window::{Question, Reported};
pub use window::{WINDOW_A_LINK, WINDOW_IN_ALL, Window};

use crate::core::{HostIdentity, LINKS_MAX, Outcome, Reply};
use crate::error::{AskError, NetworkError, OpenError, Place};
use crate::link::{LinkOptions, LinkSpec};
use crate::map::{Device, NetworkMap, RouteText};
use crate::network::{Network, NetworkSpec, RealNetwork, SimNetwork};
use osap_protocol::PortIndex;
use osap_protocol::discovery::{self, BODY_BYTES_MAX, Query, Refusal, UniqueId};
use osap_runtime::sequenced::{Destination, Expect};
use serde::{Serialize, de::DeserializeOwned};
use std::collections::BTreeMap;
use std::hash::{BuildHasher, Hasher};
use std::path::PathBuf;

/// Packet size where no map tells: what every node of ours holds.
pub const MTU_DEFAULT_BYTES: u16 = 256;

/// How a network is opened.
#[derive(Clone, Debug, Default)]
pub struct OpenOptions {
    /// Key, faults and packet size of links.
    pub link: LinkOptions,
    /// Writes all packets of all links to this pcapng file.
    pub capture: Option<PathBuf>,
    /// Seed of a simulated machine whose text gives none.
    pub seed: u64,
    /// The host's name in the map; `host` where none is given.
    pub name: Option<String>,
    /// Priority by which the host offers its own time as the network's, `[TIM-07]`; `None` to follow others only.
    pub root: Option<u8>,
}

/// What a map taught about one route.
#[derive(Clone, Debug)]
struct Known {
    name: String,
    mtu_bytes: u16,
    budget: RouteBudget,
}

/// A network and what is known of it.
pub struct Session {
    network: Box<dyn Network>,
    known: BTreeMap<RouteText, Known>,
}

impl std::fmt::Debug for Session {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Session").field("links", &self.network.link_names()).field("known", &self.known.len()).finish()
    }
}

impl Session {
    /// Opens all of `specs` as one network: links of this computer, or one simulated machine.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn open(specs: &[NetworkSpec], options: &OpenOptions) -> Result<Self, OpenError> {
        match specs {
            [] => Err(OpenError::NoLink),
            [NetworkSpec::Sim(spec)] => Ok(Self::over(SimNetwork::open(spec, options)?)),
            several => {
                let links = several.iter().map(|spec| match spec {
                    NetworkSpec::Link(link) => Ok(link.clone()),
                    NetworkSpec::Sim(sim) => Err(OpenError::SimulationNotAlone { spec: sim.to_string() }),
                });
                let links = links.collect::<Result<Vec<LinkSpec>, _>>()?;
                if links.len() > LINKS_MAX {
                    return Err(OpenError::TooManyLinks { given: links.len(), limit: LINKS_MAX });
                }
                Ok(Self::over(RealNetwork::open(&links, options)?))
            }
        }
    }

    /// A session over a network that is open already.
    #[must_use]
    pub fn over(network: impl Network + 'static) -> Self {
        Self { network: Box::new(network), known: BTreeMap::new() }
    }

    /// What carries its requests.
    pub fn network(&mut self) -> &mut dyn Network {
        &mut *self.network
    }

    /// Takes names, packet sizes and wire times from a map.
    pub fn learn(&mut self, map: &NetworkMap) {
        self.known.clear();
        for device in &map.devices {
            for way in &device.routes {
                let budget = RouteBudget::along(map, &way.route).unwrap_or_default();
                let known = Known { name: device.label(), mtu_bytes: way.mtu_bytes, budget };
                self.known.insert(way.route.clone(), known);
            }
        }
    }

    /// Port 0 of the device at the end of `route`.
    #[must_use]
    pub fn destination(&self, route: &RouteText) -> Destination {
        let mtu_bytes = self.known.get(route).map_or(MTU_DEFAULT_BYTES, |known| known.mtu_bytes);
        Destination { route: route.to_buf(), mtu_bytes, ttl_us: TTL_DEFAULT_US, port: PortIndex::NETRESPONDER }
    }

    /// Port 0 of a device of the map, by its first route.
    #[must_use]
    pub fn destination_of(&self, device: &Device) -> Destination {
        let mtu_bytes = device.routes[0].mtu_bytes;
        Destination { mtu_bytes, ..self.destination(device.route()) }
    }

    /// A destination as errors call it.
    #[must_use]
    pub fn place(&self, to: &Destination) -> Place {
        let route = RouteText::from(to.route.clone());
        Place { name: self.known.get(&route).map(|known| known.name.clone()), route }
    }

    /// Asks one question and waits for its answer.
    ///
    /// # Errors
    /// [`AskError`].
    pub fn ask<Q: Serialize, A: DeserializeOwned>(
        &mut self,
        to: &Destination,
        query: Query,
        body: &Q,
    ) -> Result<Answer<A>, AskError> {
        let mut bytes = [0; 2 + BODY_BYTES_MAX];
        let len = discovery::encode(query.key(), body, &mut bytes).map_err(|refusal| AskError::Refused {
            place: self.place(to),
            what: query.name(),
            refusal,
        })?;
        let to = self.budgeted(to, len, queries::reply_bytes(query))?;
        let reply = self.request(&to, query.name(), &bytes[..len])?;
        queries::read_answer(&reply, query, || self.place(&to))
    }

    /// Asks all of `questions`, as many at once as the window allows; the answers stand in the order of the questions.
    ///
    /// # Errors
    /// [`NetworkError`] where the network stopped; what went wrong with one question stands in its place.
    pub fn ask_many<Q: Serialize, A: DeserializeOwned>(
        &mut self,
        query: Query,
        questions: &[(Destination, Q)],
    ) -> Result<Vec<Result<Answer<A>, AskError>>, NetworkError> {
        let mut answers: Vec<Option<Result<Answer<A>, AskError>>> = questions.iter().map(|_| None).collect();
        let mut asked = Vec::new();
        for (number, (to, body)) in questions.iter().enumerate() {
            let mut bytes = [0; 2 + BODY_BYTES_MAX];
            let encoded = discovery::encode(query.key(), body, &mut bytes).map_err(|refusal| AskError::Refused {
                place: self.place(to),
                what: query.name(),
                refusal,
            });
            let ready = encoded.and_then(|len| {
                let to = self.budgeted(to, len, queries::reply_bytes(query))?;
                Ok(Question { to, expect: Expect::One, payload: bytes[..len].to_vec(), tag: number })
            });
            match ready {
                Ok(question) => asked.push(question),
                Err(error) => answers[number] = Some(Err(error)),
            }
        }
        let mut outcomes = Vec::new();
        Window::default().run(&mut *self.network, asked, &mut |reported| outcomes.push(reported))?;
        for Reported { tag, result, .. } in outcomes {
            let to = &questions[tag].0;
            let answer = result.map_err(|error| AskError::Send { place: self.place(to), error });
            let answer = answer.and_then(|outcome| self.settle_outcome(to, query.name(), outcome));
            answers[tag] = Some(answer.and_then(|reply| queries::read_answer(&reply, query, || self.place(to))));
        }
        // the window reports each question once
        Ok(answers.into_iter().flatten().collect())
    }

    /// Sends `payload` as a sequenced request and waits for its reply, whatever that is.
    ///
    /// # Errors
    /// [`AskError`].
    pub fn request(&mut self, to: &Destination, what: &'static str, payload: &[u8]) -> Result<Reply, AskError> {
        let outcome = self.outcome_of(to, payload)?;
        self.settle_outcome(to, what, outcome)
    }

    /// Sends `payload` as a sequenced request; what came of it.
    fn outcome_of(&mut self, to: &Destination, payload: &[u8]) -> Result<Outcome, AskError> {
        let mut outcome = None;
        let question = Question { to: to.clone(), expect: Expect::One, payload: payload.to_vec(), tag: 0 };
        Window::default().run(&mut *self.network, vec![question], &mut |reported| outcome = Some(reported.result))?;
        outcome.ok_or(NetworkError::Idle)?.map_err(|error| AskError::Send { place: self.place(to), error })
    }

    /// The reply, or what there was instead of one.
    fn settle_outcome(&self, to: &Destination, what: &'static str, outcome: Outcome) -> Result<Reply, AskError> {
        let place = || self.place(to);
        match outcome {
            Outcome::Reply(reply) => Ok(reply),
            Outcome::Refusal(reply) => Err(match reply.payload.get(2).and_then(|code| Refusal::from_code(*code)) {
                Some(refusal) => AskError::Refused { place: place(), what, refusal },
                None => AskError::Malformed { place: place(), what, len: reply.payload.len() },
            }),
            Outcome::Timeout { tries } => {
                Err(AskError::Timeout { place: place(), what, tries, waited_us: u64::from(to.ttl_us) })
            }
            Outcome::Ended => {
                Err(AskError::Timeout { place: place(), what, tries: 1, waited_us: u64::from(to.ttl_us) })
            }
        }
    }

    /// The destination with a time to live that can work for bodies of these lengths, where a map told of its wires.
    fn budgeted(&self, to: &Destination, request_bytes: usize, reply_bytes: usize) -> Result<Destination, AskError> {
        let Some(known) = self.known.get(&RouteText::from(to.route.clone())) else { return Ok(to.clone()) };
        let ttl_us = known
            .budget
            .ttl_us(request_bytes, reply_bytes)
            .map_err(|budget| AskError::TooSlow { place: self.place(to), budget })?;
        Ok(Destination { ttl_us: ttl_us.max(to.ttl_us), ..to.clone() })
    }
}

/// A host that no other process is: its id differs from run to run, as two of them may scan one machine at a time.
pub(crate) fn host_identity(name: Option<&str>) -> HostIdentity {
    let mut unique_id = *b"host\0\0\0\0\0\0\0\0";
    let [random, epoch] = [0, 1].map(|_| std::hash::RandomState::new().build_hasher().finish());
    unique_id[4..].copy_from_slice(&random.to_le_bytes());
    #[expect(clippy::cast_possible_truncation, reason = "any 32 bits do")]
    let boot_epoch = epoch as u32;
    HostIdentity { unique_id: UniqueId(unique_id), boot_epoch, name: name.unwrap_or("host").to_owned() }
}

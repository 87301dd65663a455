//! What devices say of themselves: names, links, ports.
//!
//! - **Walk:** a layer of devices → all their questions in one window → [`Found`](super::found::Found).
//! - **Invariants:** a question that nobody answers is asked in at most `ROUNDS_HEARD` rounds, and in no more than `ROUNDS` where the
//!   device answered nothing at all. No answer takes away what an earlier one said. **Clauses:** `[DSC-01]`, `[DSC-09]`.

use super::{ROUNDS, ScanPhase, Scanner};
use crate::core::Outcome;
use crate::error::NetworkError;
use crate::session::Question;
use osap_protocol::discovery::{self, LinkInfo, Name, PortInfo, Query};
use osap_runtime::sequenced::Expect;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeSet;

/// Times a question is asked again as a whole where the device answers others: it is there, and the way to it loses packets.
const ROUNDS_HEARD: usize = 8;

/// One question to one device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum What {
    TypeName,
    Name,
    Link(u8),
    Port(u16),
}

impl Scanner<'_> {
    /// Reads all of `devices`.
    pub(super) fn read(&mut self, devices: &[usize]) -> Result<(), NetworkError> {
        let open = devices.iter().flat_map(|device| self.questions(*device)).collect();
        self.ask_until_heard(open, BTreeSet::new())
    }

    /// Asks once more what was not answered by those that were there at the end.
    pub(super) fn read_missing(&mut self) -> Result<(), NetworkError> {
        let there: BTreeSet<usize> = (0..self.found.len()).filter(|device| !self.found[*device].fell_silent).collect();
        let mut open: Vec<(usize, What)> = there.iter().flat_map(|device| self.questions(*device)).collect();
        open.retain(|(device, what)| self.is_missing(*device, *what));
        self.ask_until_heard(open, there)
    }

    /// Asks in rounds; `heard` are those known to be there.
    fn ask_until_heard(
        &mut self,
        mut open: Vec<(usize, What)>,
        mut heard: BTreeSet<usize>,
    ) -> Result<(), NetworkError> {
        let depth = open.first().map_or(0, |(device, _)| self.found[*device].depth());
        for round in 1..=ROUNDS_HEARD {
            if open.is_empty() {
                break;
            }
            let questions = open.iter().map(|(device, what)| self.question(*device, *what)).collect();
            let (mut answers, mut done) = (Vec::new(), 0);
            let (progress, found, of) = (&mut *self.progress, self.found.len(), open.len());
            self.options.window.run(self.network, questions, &mut |reported| {
                done += 1;
                progress(super::ScanProgress { phase: ScanPhase::Reading, depth, done, of, devices: found });
                answers.push((reported.tag, reported.result));
            })?;
            let mut again = Vec::new();
            for ((device, what), result) in answers {
                match result {
                    Ok(Outcome::Reply(reply)) => {
                        heard.insert(device);
                        self.take_answer(device, what, &reply.payload);
                    }
                    // it will refuse the next time too
                    Ok(Outcome::Refusal(_)) => {
                        heard.insert(device);
                    }
                    Ok(Outcome::Timeout { .. } | Outcome::Ended) | Err(_) => again.push((device, what)),
                }
            }
            again.retain(|(device, _)| round < ROUNDS || heard.contains(device));
            again.sort_unstable();
            open = again;
        }
        Ok(())
    }

    /// All that a device can be asked.
    fn questions(&mut self, device: usize) -> Vec<(usize, What)> {
        let with_ports = self.options.ports;
        let found = &mut self.found[device];
        let gateways = found.info.gateways.min(osap_protocol::GatewayIndex::COUNT);
        let ports = if with_ports { found.info.ports.min(osap_protocol::PortIndex::COUNT) } else { 0 };
        found.links.resize(usize::from(gateways), None);
        found.ports.resize(usize::from(ports), None);
        let names = [What::TypeName, What::Name].into_iter();
        names
            .chain((0..gateways).map(What::Link))
            .chain((0..ports).map(What::Port))
            .map(|what| (device, what))
            .collect()
    }

    fn is_missing(&self, device: usize, what: What) -> bool {
        let found = &self.found[device];
        match what {
            What::TypeName => found.type_name.is_none(),
            What::Name => found.name.is_none(),
            What::Link(index) => found.links.get(usize::from(index)).is_some_and(Option::is_none),
            What::Port(index) => found.ports.get(usize::from(index)).is_some_and(Option::is_none),
        }
    }

    fn question(&self, device: usize, what: What) -> Question<(usize, What)> {
        let payload = match what {
            What::TypeName => payload(Query::TypeName, &()),
            What::Name => payload(Query::RuntimeName, &()),
            What::Link(index) => payload(Query::LinkInfo, &index),
            What::Port(index) => payload(Query::PortInfo, &index),
        };
        Question { to: self.found[device].way.destination(), expect: Expect::One, payload, tag: (device, what) }
    }

    fn take_answer(&mut self, device: usize, what: What, bytes: &[u8]) {
        let found = &mut self.found[device];
        match what {
            What::TypeName => {
                let told = read::<Name>(Query::TypeName, bytes).map(|name| name.as_str().to_owned());
                found.type_name = told.or(found.type_name.take());
            }
            What::Name => {
                let told = read::<Name>(Query::RuntimeName, bytes).map(|name| name.as_str().to_owned());
                found.name = told.or(found.name.take());
            }
            What::Link(index) => {
                if let Some(place) = found.links.get_mut(usize::from(index)) {
                    *place = read::<LinkInfo>(Query::LinkInfo, bytes).or(place.take());
                }
            }
            What::Port(index) => {
                if let Some(place) = found.ports.get_mut(usize::from(index)) {
                    *place = read::<PortInfo>(Query::PortInfo, bytes).or(place.take());
                }
            }
        }
    }
}

/// A query's payload.
pub(super) fn payload<Q: Serialize>(query: Query, body: &Q) -> Vec<u8> {
    let mut bytes = [0; 64];
    // every body asked for here is a number or less
    let len = discovery::encode(query.key(), body, &mut bytes).unwrap_or(0);
    bytes[..len].to_vec()
}

/// An answer, if it is one to this query.
pub(super) fn read<A: DeserializeOwned>(query: Query, bytes: &[u8]) -> Option<A> {
    let message = discovery::decode(bytes).ok().filter(|message| message.key == query.key())?;
    message.body.read().ok()
}

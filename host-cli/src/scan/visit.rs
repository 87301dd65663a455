//! One step further: who is there, and is it somebody known?
//!
//! - **Walk:** candidates → one visit each → answers joined by scan id → new devices, further ways to known ones, silent places.
//! - **Invariants:** answers are looked at in the order of their routes when all are in, so that timing does not decide what is the first
//!   path. Whoever announced himself and does not answer is asked in `ROUNDS` rounds under one scan id, `[DSC-03]`.
//! - **Clauses:** `[DSC-03]`, `[DSC-04]`, `[DSC-08]`, `[DSC-09]`, `[PKT-11]`.

use super::found::{Candidate, Edge, Found, Silence, gateway};
use super::read::{payload, read};
use super::{ROUNDS, ScanPhase, Scanner};
use crate::core::Outcome;
use crate::error::NetworkError;
use crate::map::Finding;
use crate::session::Question;
use osap_protocol::discovery::{GatewayKind, LinkInfo, Neighbour, Query, RuntimeInfo, ScanId};
use osap_protocol::{GatewayIndex, Step};
use osap_runtime::sequenced::Expect;
use std::collections::BTreeSet;

/// Length of the longest question and answer of a scan, for the time they take: link information.
const BODY_BYTES: (usize, usize) = (8, 90);

/// A visit and what came of it.
struct Visit {
    way: Candidate,
    id: ScanId,
    info: Option<RuntimeInfo>,
    tries: u8,
}

impl Scanner<'_> {
    /// Visits all of `candidates`; returns the devices that are new.
    pub(super) fn visit(&mut self, candidates: Vec<Candidate>) -> Result<Vec<usize>, NetworkError> {
        let depth = candidates.first().map_or(0, |way| way.route.as_route().steps().count());
        let visits = self.ask_who(candidates, ScanPhase::Visiting, depth)?;
        for visit in &visits {
            if let Some(info) = &visit.info {
                self.visits.join(visit.id, info.previous, &visit.way.route);
            }
        }
        let mut new = Vec::new();
        for visit in visits {
            let Some(info) = visit.info.clone() else {
                self.note_silence(&visit);
                continue;
            };
            let known = match self.visits.device(visit.id) {
                Some(device) => Some(device),
                None => self.find_double(&visit, &info)?,
            };
            let device = known.unwrap_or_else(|| {
                self.found.push(Found::new(info, visit.way.clone()));
                new.push(self.found.len() - 1);
                self.found.len() - 1
            });
            self.visits.reached(visit.id, device);
            self.silent.remove(&visit.way.route);
            if let Some((from, step)) = visit.way.from {
                let edge = Edge { from, step, to: device };
                if !self.edges.contains(&edge) {
                    self.edges.push(edge);
                }
            }
        }
        Ok(new)
    }

    /// A device of this unique id that is known by another way: asked once more along that way, `[DSC-04]`. Is it the one just visited?
    fn find_double(&mut self, visit: &Visit, info: &RuntimeInfo) -> Result<Option<usize>, NetworkError> {
        let doubles: Vec<usize> =
            (0..self.found.len()).filter(|device| self.found[*device].info.unique_id == info.unique_id).collect();
        for device in doubles {
            let way = self.found[device].way.clone();
            let depth = self.found[device].depth();
            let Some(again) = self.ask_who(vec![way], ScanPhase::Visiting, depth)?.pop() else { continue };
            let Some(now) = again.info else { continue };
            if now.previous == visit.id {
                if now.boot_epoch != self.found[device].info.boot_epoch {
                    // seen by its boot epoch: read again when all else is done, `[DSC-09]`
                    self.found[device].is_stale = true;
                }
                return Ok(Some(device));
            }
            self.visits.reached(again.id, device);
        }
        Ok(None)
    }

    /// Asks everybody for runtime information under a scan id of its own.
    fn ask_who(
        &mut self,
        candidates: Vec<Candidate>,
        phase: ScanPhase,
        depth: usize,
    ) -> Result<Vec<Visit>, NetworkError> {
        let mut visits = Vec::new();
        for way in candidates {
            let Some(id) = self.visits.begin() else {
                self.findings.insert(Finding::Limit { what: "a scan has 65535 visits".to_owned() });
                break;
            };
            visits.push(Visit { way, id, info: None, tries: 0 });
        }
        for round in 0..ROUNDS {
            let is_open = |visit: &Visit| visit.info.is_none() && (round == 0 || visit.way.is_certain);
            let open: Vec<usize> = (0..visits.len()).filter(|index| is_open(&visits[*index])).collect();
            if open.is_empty() {
                break;
            }
            let question = |index: &usize| {
                let Visit { way, id, .. } = &visits[*index];
                let expect = if way.is_certain { Expect::One } else { Expect::Many };
                Question { to: way.destination(), expect, payload: payload(Query::RuntimeInfo, id), tag: *index }
            };
            let questions = open.iter().map(question).collect();
            let (mut done, of, devices) = (0, open.len(), self.found.len());
            let progress = &mut *self.progress;
            self.options.window.run(self.network, questions, &mut |reported| {
                let visit: &mut Visit = &mut visits[reported.tag];
                match reported.result {
                    Ok(Outcome::Reply(reply)) => {
                        visit.tries = visit.tries.saturating_add(reply.tries);
                        visit.info = read(Query::RuntimeInfo, &reply.payload).or(visit.info.take());
                    }
                    Ok(Outcome::Timeout { tries }) => visit.tries = visit.tries.saturating_add(tries),
                    Ok(Outcome::Ended) => visit.tries = visit.tries.max(1),
                    Ok(Outcome::Refusal(_)) | Err(_) => {}
                }
                done += 1;
                progress(super::ScanProgress { phase, depth, done: done.min(of), of, devices });
            })?;
        }
        Ok(visits)
    }

    fn note_silence(&mut self, visit: &Visit) {
        let Some((device, step)) = visit.way.from else { return };
        let Visit { way: Candidate { neighbour, is_certain, .. }, tries, .. } = visit;
        // where nobody ever announced himself, silence is what an empty socket gives
        if *is_certain {
            let silence = Silence { device, gateway: step.gateway().get(), neighbour: *neighbour, tries: *tries };
            self.silent.insert(visit.way.route.clone(), silence);
        }
    }

    /// The links of a layer that lead on: open, and not the way by which somebody came.
    pub(super) fn follow_links(&mut self, layer: &[usize]) -> Vec<Candidate> {
        let mut candidates = Vec::new();
        let mut chosen: BTreeSet<(usize, u8)> = BTreeSet::new();
        for device in layer {
            for (index, info) in self.links_of(*device) {
                let leads_on = info.open && info.kind == GatewayKind::Link;
                let end = (*device, index.get());
                if !leads_on || self.followed.contains(&end) {
                    continue;
                }
                let other = self.agreed(end, &info);
                if other.is_some_and(|other| chosen.contains(&other) || self.followed.contains(&other)) {
                    continue;
                }
                chosen.insert(end);
                candidates.extend(self.candidate(*device, Step::Link(index), &info, info.neighbour));
            }
        }
        self.followed.extend(chosen);
        candidates
    }

    /// The other end of a link, where both ends say of each other that they are.
    fn agreed(&self, (device, gateway): (usize, u8), info: &LinkInfo) -> Option<(usize, u8)> {
        let Neighbour { unique_id, gateway: theirs, .. } = info.neighbour?;
        let mine = self.found[device].info.unique_id;
        (0..self.found.len()).find_map(|other| {
            let found = &self.found[other];
            let back = found.links.get(usize::from(theirs))?.as_ref()?.neighbour?;
            let is_it = found.info.unique_id == unique_id && back.unique_id == mine && back.gateway == gateway;
            is_it.then_some((other, theirs))
        })
    }

    /// A way one step beyond a device; `None`, and a finding, where its wires are too slow, `[PKT-11]`, or a header is full.
    pub(super) fn candidate(
        &mut self,
        device: usize,
        step: Step,
        info: &LinkInfo,
        neighbour: Option<Neighbour>,
    ) -> Option<Candidate> {
        let way = &self.found[device].way;
        let Ok(route) = way.route.with(step) else {
            self.findings.insert(Finding::Limit { what: "a route has 250 bytes".to_owned() });
            return None;
        };
        let budget = way.budget.with(&gateway(step.gateway().at(), info));
        let mtu_bytes = way.mtu_bytes.min(info.mtu_bytes);
        let is_certain = neighbour.is_some() || matches!(step, Step::Bus { .. });
        match budget.ttl_us(BODY_BYTES.0, BODY_BYTES.1) {
            Ok(ttl_us) => Some(Candidate {
                from: Some((device, step)),
                route,
                mtu_bytes,
                budget,
                ttl_us,
                neighbour: neighbour.map(|neighbour| neighbour.unique_id),
                is_certain,
            }),
            Err(slow) => {
                self.findings.insert(Finding::TooSlow { device, route: route.into(), need_us: slow.need_us });
                None
            }
        }
    }

    /// The links that a device told of.
    pub(super) fn links_of(&self, device: usize) -> Vec<(GatewayIndex, LinkInfo)> {
        let links = self.found[device].links.iter().enumerate();
        links.filter_map(|(index, info)| Some((GatewayIndex::new(u8::try_from(index).ok()?)?, info.clone()?))).collect()
    }

    /// Visits every device once more, `[DSC-09]`; returns those that restarted or have other neighbours, to be read again.
    pub(super) fn close(&mut self) -> Result<Vec<usize>, NetworkError> {
        let ways = self.found.iter().map(|found| found.way.clone()).collect();
        let visits = self.ask_who(ways, ScanPhase::Closing, 0)?;
        let mut again = Vec::new();
        for (device, Visit { id, info, .. }) in visits.into_iter().enumerate() {
            let found = &mut self.found[device];
            found.fell_silent = info.is_none();
            let Some(info) = info else { continue };
            let has_restarted = info.boot_epoch != found.info.boot_epoch;
            let has_moved = info.topology_generation != found.info.topology_generation;
            if info.unique_id == found.info.unique_id && !has_restarted && !has_moved && !found.is_stale {
                self.visits.reached(id, device);
                continue;
            }
            found.restarts += u32::from(has_restarted);
            found.has_changed |= has_moved && !has_restarted;
            if info.unique_id == found.info.unique_id {
                found.renew(info);
            } else {
                found.forget(info);
            }
            self.visits.reached(id, device);
            again.push(device);
        }
        self.forget_gateways(&again);
        Ok(again)
    }

    /// Lets gateways that led nowhere be followed once more.
    fn forget_gateways(&mut self, devices: &[usize]) {
        let led: BTreeSet<(usize, u8)> = self.edges.iter().map(|edge| (edge.from, edge.step.gateway().get())).collect();
        self.followed.retain(|end| led.contains(end) || !devices.contains(&end.0));
    }
}

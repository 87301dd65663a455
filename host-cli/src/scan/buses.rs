//! Who is on a bus: whoever answers a broadcast.
//!
//! - **Walk:** an open bus gateway of a layer → a few broadcasts → one candidate for each drop that answered; on a full bus, one for each
//!   other address too.
//! - **Invariants:** a bus is asked from one of its nodes only. A broadcast is repeated until a round shows nobody new, since answers of
//!   many drops at once may be lost on their way; at most `BROADCASTS_MAX` times.
//! - **Clauses:** `[DSC-08]`, `[PKT-15]`, `[SYS-06]`.

use super::found::Candidate;
use super::read::{payload, read};
use super::{RouteBuf, Scanner};
use crate::core::Outcome;
use crate::error::NetworkError;
use crate::session::Question;
use osap_protocol::discovery::{GatewayKind, LinkInfo, Query, RuntimeInfo};
use osap_protocol::{BusDrop, GatewayIndex, Step};
use osap_runtime::sequenced::{Destination, Expect};
use std::collections::BTreeSet;

/// From how many answers on every other address is visited too: answers to a broadcast queue on the bus, and on a full one those
/// at the end live too short to arrive, in every round the same.
const SWEEP_FROM: usize = 32;
/// Broadcasts on one bus at most.
const BROADCASTS_MAX: usize = 6;

/// A bus, by the gateway it was asked from.
#[derive(Clone, Debug)]
pub(super) struct FoundBus {
    pub(super) device: usize,
    pub(super) gateway: GatewayIndex,
    /// The asking node's own address.
    pub(super) own_drop: u8,
}

impl Scanner<'_> {
    /// One candidate for each drop on each bus of a layer that is not known yet.
    pub(super) fn follow_buses(&mut self, layer: &[usize]) -> Result<Vec<Candidate>, NetworkError> {
        let mut candidates = Vec::new();
        for device in layer {
            for (gateway, info) in self.links_of(*device) {
                let GatewayKind::Bus { drop } = info.kind else { continue };
                if !info.open || self.came_by(*device, drop) || !self.followed.insert((*device, gateway.get())) {
                    continue;
                }
                if !self.buses.iter().any(|bus| (bus.device, bus.gateway) == (*device, gateway)) {
                    self.buses.push(FoundBus { device: *device, gateway, own_drop: drop });
                }
                candidates.extend(self.bus_candidates(*device, gateway, &info, drop)?);
            }
        }
        Ok(candidates)
    }

    /// One candidate for each drop that answers, and one to be tried once for each that might be there.
    fn bus_candidates(
        &mut self,
        device: usize,
        gateway: GatewayIndex,
        info: &LinkInfo,
        own_drop: u8,
    ) -> Result<Vec<Candidate>, NetworkError> {
        let heard = self.drops(device, gateway, info)?;
        let is_full = heard.len() >= SWEEP_FROM;
        let mut candidates = Vec::new();
        for drop in (0..BusDrop::BROADCAST.0).map(BusDrop) {
            let is_certain = heard.contains(&drop);
            if is_certain || (is_full && drop.0 != own_drop) {
                let way = self.candidate(device, Step::Bus { gateway, drop }, info, None);
                candidates.extend(way.map(|way| Candidate { is_certain, ..way }));
            }
        }
        Ok(candidates)
    }

    /// Whether the bus on which a device has address `drop` is the one that leads to it. Where it has that address on several
    /// buses, that cannot be told, and each is asked.
    pub(super) fn came_by(&self, device: usize, drop: u8) -> bool {
        let same = |info: &LinkInfo| info.kind == GatewayKind::Bus { drop };
        let is_only = self.links_of(device).iter().filter(|(_, info)| same(info)).count() == 1;
        let led_by = |step: Step| matches!(step, Step::Bus { drop: to, .. } if to.0 == drop);
        is_only && self.edges.iter().any(|edge| edge.to == device && led_by(edge.step))
    }

    /// The drops that answer.
    fn drops(
        &mut self,
        device: usize,
        gateway: GatewayIndex,
        info: &LinkInfo,
    ) -> Result<BTreeSet<BusDrop>, NetworkError> {
        let mut drops = BTreeSet::new();
        let step = Step::Bus { gateway, drop: BusDrop::BROADCAST };
        let Some(way) = self.candidate(device, step, info, None) else { return Ok(drops) };
        for round in 0..BROADCASTS_MAX {
            let Some(id) = self.visits.begin_broadcast() else { break };
            let question = Question {
                // the answers wait for each other, and pay for it from the question's time to live
                to: Destination { ttl_us: u16::MAX, ..way.destination() },
                expect: Expect::Many,
                payload: payload(Query::RuntimeInfo, &id),
                tag: (),
            };
            let mut answers: Vec<(RouteBuf, Option<RuntimeInfo>)> = Vec::new();
            self.options.window.run(self.network, vec![question], &mut |reported| match reported.result {
                Ok(Outcome::Reply(reply)) => answers.push((reply.route, read(Query::RuntimeInfo, &reply.payload))),
                // whoever refuses is there all the same
                Ok(Outcome::Refusal(reply)) => answers.push((reply.route, None)),
                Ok(Outcome::Timeout { .. } | Outcome::Ended) | Err(_) => {}
            })?;
            let known = drops.len();
            for (route, answer) in answers {
                if let Some(Step::Bus { drop, .. }) = route.as_route().steps().last() {
                    drops.insert(drop);
                }
                if let Some(answer) = answer {
                    self.visits.heard(id, route, answer.previous);
                }
            }
            if round > 0 && drops.len() == known {
                break;
            }
        }
        Ok(drops)
    }
}

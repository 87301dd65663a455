//! Which visits of a scan reached one and the same node.
//!
//! - **Walk:** every visit gets a number → a node answers with the number of the visit before → both are joined.
//! - **Invariants:** joining is symmetric, so it does not matter in which order answers come, nor whether a repeated visit came after
//!   a later one. A broadcast is heard by many: it joins nothing, but what a drop answered to it is remembered.
//! - **Context:** O(α) a visit. **Clauses:** `[DSC-03]`, `[DSC-04]`.

use osap_protocol::RouteBuf;
use osap_protocol::discovery::ScanId;
use std::collections::BTreeMap;

/// What drops answered to one broadcast, by the route to each.
type Heard = BTreeMap<RouteBuf, ScanId>;

/// All visits of one scan.
#[derive(Debug)]
pub(super) struct Visits {
    scan: u32,
    /// By visit, from 1; [0] stands for none.
    parent: Vec<usize>,
    /// The device a set of joined visits reached, at the set's representative.
    device: Vec<Option<usize>>,
    broadcasts: BTreeMap<u16, Heard>,
}

impl Visits {
    pub(super) fn new(scan: u32) -> Self {
        Self { scan, parent: vec![0], device: vec![None], broadcasts: BTreeMap::new() }
    }

    /// A number for a new visit; `None` where all were given out.
    pub(super) fn begin(&mut self) -> Option<ScanId> {
        let visit = u16::try_from(self.parent.len()).ok()?;
        self.parent.push(usize::from(visit));
        self.device.push(None);
        Some(ScanId { scan: self.scan, visit })
    }

    /// A number for a broadcast.
    pub(super) fn begin_broadcast(&mut self) -> Option<ScanId> {
        let id = self.begin()?;
        self.broadcasts.insert(id.visit, Heard::new());
        Some(id)
    }

    /// Remembers what the drop at `route` answered to a broadcast.
    pub(super) fn heard(&mut self, broadcast: ScanId, route: RouteBuf, previous: ScanId) {
        if let Some(heard) = self.broadcasts.get_mut(&broadcast.visit) {
            heard.insert(route, previous);
        }
    }

    /// Joins a visit by `route` with the one that its answer named; `false` where that is no visit of this scan.
    pub(super) fn join(&mut self, visit: ScanId, previous: ScanId, route: &RouteBuf) -> bool {
        let mut previous = previous;
        // broadcasts are few, and each points to an earlier one
        while let Some(heard) = self.broadcasts.get(&previous.visit).filter(|_| previous.scan == self.scan) {
            let Some(before) = heard.get(route).filter(|before| before.visit < previous.visit) else { return false };
            previous = *before;
        }
        if previous.scan != self.scan || usize::from(previous.visit) >= self.parent.len() || previous.visit == 0 {
            return false;
        }
        let (one, other) = (self.root(visit), self.root(previous));
        if one != other {
            self.parent[other] = one;
            self.device[one] = self.device[one].or(self.device[other]);
        }
        true
    }

    /// The device that a visit reached, if that is known.
    pub(super) fn device(&mut self, visit: ScanId) -> Option<usize> {
        let root = self.root(visit);
        self.device[root]
    }

    /// Says which device a visit reached.
    pub(super) fn reached(&mut self, visit: ScanId, device: usize) {
        let root = self.root(visit);
        self.device[root] = Some(device);
    }

    fn root(&mut self, visit: ScanId) -> usize {
        let mut at = usize::from(visit.visit);
        while self.parent[at] != at {
            self.parent[at] = self.parent[self.parent[at]];
            at = self.parent[at];
        }
        at
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osap_protocol::{BusDrop, GatewayIndex, Step};

    const NONE: ScanId = ScanId { scan: 0, visit: 0 };

    fn bus_route(drop: u8) -> RouteBuf {
        let gateway = GatewayIndex::new(1).unwrap();
        RouteBuf::new().with(Step::Bus { gateway, drop: BusDrop(drop) }).unwrap()
    }

    /// `[DSC-03]`: visit 1 is repeated after visit 2 came, so each names the other. They are one node, not two and no endless loop.
    #[test]
    fn answers_in_any_order_join() {
        for swapped in [false, true] {
            let mut visits = Visits::new(7);
            let (one, two) = (visits.begin().unwrap(), visits.begin().unwrap());
            let mut answers = [(one, two), (two, one)];
            if swapped {
                answers.reverse();
            }
            for (visit, previous) in answers {
                assert!(visits.join(visit, previous, &RouteBuf::new()));
            }
            visits.reached(one, 5);
            assert_eq!(visits.device(two), Some(5));
        }
    }

    /// `[DSC-04]`: a foreign id, and one of this scan that was never given out, join nothing.
    #[test]
    fn foreign_ids_join_nothing() {
        let mut visits = Visits::new(7);
        let one = visits.begin().unwrap();
        for previous in [NONE, ScanId { scan: 8, visit: 1 }, ScanId { scan: 7, visit: 2 }, ScanId { scan: 7, visit: 0 }]
        {
            assert!(!visits.join(one, previous, &RouteBuf::new()), "{previous:?}");
        }
    }

    /// `[PKT-15]`: two drops that heard one broadcast are two nodes; a drop that was visited before by another way is that node.
    #[test]
    fn a_broadcast_joins_nothing_by_itself() {
        let mut visits = Visits::new(7);
        let before = visits.begin().unwrap();
        visits.reached(before, 3);
        let broadcast = visits.begin_broadcast().unwrap();
        visits.heard(broadcast, bus_route(1), NONE);
        visits.heard(broadcast, bus_route(2), before);
        let (one, two, three) = (visits.begin().unwrap(), visits.begin().unwrap(), visits.begin().unwrap());
        assert!(!visits.join(one, broadcast, &bus_route(1)));
        assert!(visits.join(two, broadcast, &bus_route(2)));
        assert!(!visits.join(three, broadcast, &bus_route(9)), "its answer to the broadcast was lost");
        assert_eq!(visits.device(two), Some(3));
        visits.reached(one, 4);
        assert_eq!(visits.device(two), Some(3));
    }

    #[test]
    fn numbers_run_out_without_a_wrap() {
        let mut visits = Visits::new(7);
        assert_eq!((1..=u16::MAX).filter(|_| visits.begin().is_some()).count(), 65_535);
        assert_eq!(visits.begin(), None);
    }
}

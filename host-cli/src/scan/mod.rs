//! Finds what is there: a breadth-first search over nodes, by questions alone.
//!
//! - **Walk:** the host itself → layer by layer: `read` what its nodes say of themselves → `buses` asks who is on their buses →
//!   `visit` goes one step further and tells new nodes from known ones → at last every node is visited once more → `assemble`
//!   makes the map.
//! - **Invariants:** a layer is visited whole before the next, so that the first path to a node has the fewest steps. Every question is
//!   bounded in tries and every repetition in rounds: a scan ends, whatever answers. What did not answer is in the map.
//! - **Context:** the caller's thread.
//! - **Clauses:** `[DSC-03]`, `[DSC-04]`, `[DSC-08]`, `[DSC-09]`, `[PKT-11]`, `[PKT-12]`, `[PKT-15]`.

mod assemble;
mod buses;
mod found;
mod read;
mod visit;
mod visits;

use crate::core::{EventKind, Statistics};
use crate::error::NetworkError;
use crate::map::{Finding, NetworkMap, RouteText};
use crate::network::Network;
use crate::session::{Session, Window};
use fixed_math::time::{LocalTicks, Span};
use found::{Candidate, Edge, Found, Silence};
use osap_protocol::RouteBuf;
use osap_protocol::discovery::{GatewayKind, LinkInfo, UniqueId};
use std::collections::{BTreeMap, BTreeSet};
use visits::Visits;

/// Times a question that nobody answered is asked again as a whole, each with all its tries: links that lose packets lose more of
/// them the longer the way.
const ROUNDS: usize = 3;
/// Times the search goes on after the last visits showed restarts or new neighbours.
const PASSES_MAX: usize = 3;

/// How to scan.
#[derive(Clone, Copy, Debug)]
pub struct ScanOptions {
    /// Questions open at once.
    pub window: Window,
    /// Whether ports are asked for.
    pub ports: bool,
    /// Time that links get at first to open and to hear their neighbours.
    pub settle: Span,
}

impl Default for ScanOptions {
    fn default() -> Self {
        Self { window: Window::default(), ports: true, settle: Span::from_us(1_000_000) }
    }
}

/// How far a scan is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScanProgress {
    /// What it does.
    pub phase: ScanPhase,
    /// Steps from the host.
    pub depth: usize,
    /// Questions of this phase that have ended.
    pub done: usize,
    /// Questions of this phase.
    pub of: usize,
    /// Devices found so far, the host among them.
    pub devices: usize,
}

/// What a scan does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScanPhase {
    /// Asks who is there.
    Visiting,
    /// Reads what those say of themselves.
    Reading,
    /// Looks whether all are still there.
    Closing,
}

/// A scan's map and what it took.
#[derive(Clone, Debug)]
pub struct ScanReport {
    /// What is there.
    pub map: NetworkMap,
    /// What it took.
    pub cost: ScanCost,
}

/// What a scan took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct ScanCost {
    /// Questions asked.
    pub requests: u64,
    /// Times one was sent again.
    pub retries: u64,
    /// Questions that nobody answered.
    pub timeouts: u64,
    /// Packets sent over the host's links.
    pub packets_sent: u64,
    /// Packets received over them.
    pub packets_received: u64,
    /// By the host's clock, µs: virtual where the network is simulated.
    pub elapsed_us: u64,
}

/// Why there is no map.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ScanError {
    /// The network cannot go on.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// Not even the host's own node answered.
    #[error("the host's own node does not answer itself: this is a fault of the program; please report it")]
    HostSilent,
}

impl Session {
    /// Finds what is there. The session learns the map.
    ///
    /// # Errors
    /// [`ScanError`].
    pub fn scan(
        &mut self,
        options: &ScanOptions,
        progress: &mut dyn FnMut(ScanProgress),
    ) -> Result<ScanReport, ScanError> {
        let network = self.network();
        let scan = scan_number(network.local()?.unique_id, network.now());
        let report = Scanner::new(network, scan, *options, progress).run()?;
        self.learn(&report.map);
        Ok(report)
    }
}

/// A scan under way.
struct Scanner<'a> {
    network: &'a mut dyn Network,
    options: ScanOptions,
    progress: &'a mut dyn FnMut(ScanProgress),
    visits: Visits,
    found: Vec<Found>,
    edges: Vec<Edge>,
    /// Gateways that were followed, and into which bus.
    buses: Vec<buses::FoundBus>,
    followed: BTreeSet<(usize, u8)>,
    silent: BTreeMap<RouteBuf, Silence>,
    findings: BTreeSet<Finding>,
}

impl<'a> Scanner<'a> {
    fn new(
        network: &'a mut dyn Network,
        scan: u32,
        options: ScanOptions,
        progress: &'a mut dyn FnMut(ScanProgress),
    ) -> Self {
        Self {
            network,
            options,
            progress,
            visits: Visits::new(scan),
            found: Vec::new(),
            edges: Vec::new(),
            buses: Vec::new(),
            followed: BTreeSet::new(),
            silent: BTreeMap::new(),
            findings: BTreeSet::new(),
        }
    }

    fn run(mut self) -> Result<ScanReport, ScanError> {
        let before = (self.network.now(), self.network.statistics()?);
        self.network.settle(self.options.settle)?;
        let mut layer = self.visit(vec![Candidate::host()])?;
        if layer.is_empty() {
            return Err(ScanError::HostSilent);
        }
        for _ in 0..PASSES_MAX {
            self.search(layer)?;
            layer = self.close()?;
            if layer.is_empty() {
                break;
            }
        }
        // the search is over, but what changed at the very end is read all the same
        self.read(&layer)?;
        self.read_missing()?;
        self.note_silent_links()?;
        let cost = cost(&before.1, &self.network.statistics()?, self.network.now().since(before.0));
        Ok(ScanReport { map: self.assemble(), cost })
    }

    /// Tells the host's own links that led nowhere, and why, so that nobody takes a port that is taken for a machine that is off.
    fn note_silent_links(&mut self) -> Result<(), NetworkError> {
        let local = self.network.local()?;
        let led: BTreeSet<u8> =
            self.edges.iter().filter(|edge| edge.from == 0).map(|edge| edge.step.gateway().get()).collect();
        let is_silent = |(index, link): &(u8, &LinkInfo)| {
            link.kind == GatewayKind::Link && (!link.open || (link.neighbour.is_none() && !led.contains(index)))
        };
        let silent: Vec<(u8, &LinkInfo)> = (0..).zip(&local.links).filter(is_silent).collect();
        // events are taken only where there is something to explain: others wait for them too
        let is_any_closed = silent.iter().any(|(_, link)| !link.open);
        let events = if is_any_closed { self.network.events()? } else { Vec::new() };
        for (index, link) in silent {
            let downs = events.iter().rev().filter(|event| event.gateway.get() == index);
            let told = downs.filter_map(|event| match &event.kind {
                EventKind::Down(reason) => Some(reason.clone()),
                _ => None,
            });
            let unknown = || "it has not opened; look whether it is there, and try again".to_owned();
            let reason = (!link.open).then(|| told.into_iter().next().unwrap_or_else(unknown));
            let name = local.link_names.get(usize::from(index)).cloned().unwrap_or_default();
            self.findings.insert(Finding::SilentLink { link: name, reason });
        }
        Ok(())
    }

    /// Reads a layer of devices and goes one step further, until there is none, `[DSC-08]`.
    fn search(&mut self, mut layer: Vec<usize>) -> Result<(), NetworkError> {
        while !layer.is_empty() {
            self.read(&layer)?;
            let mut candidates = self.follow_links(&layer);
            candidates.extend(self.follow_buses(&layer)?);
            candidates.sort_by_key(|way| RouteText::from(way.route.clone()));
            layer = self.visit(candidates)?;
        }
        Ok(())
    }
}

/// A number that differs from host to host and from scan to scan, and repeats itself in a simulated world. FNV-1a; 0 is no scan.
fn scan_number(host: UniqueId, now: LocalTicks) -> u32 {
    let bytes = host.0.into_iter().chain(now.steps().to_le_bytes());
    bytes.fold(0x811c_9dc5, |hash: u32, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193)).max(1)
}

fn cost(before: &Statistics, after: &Statistics, elapsed: Span) -> ScanCost {
    ScanCost {
        requests: after.requests - before.requests,
        retries: after.retries - before.retries,
        timeouts: after.timeouts - before.timeouts,
        packets_sent: after.sent.saturating_sub(before.sent),
        packets_received: after.received.saturating_sub(before.received),
        elapsed_us: elapsed.as_us_ceil(),
    }
}

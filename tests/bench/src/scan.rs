//! A scan of a random network with loops: what it takes in virtual time, in packets, and in time of this computer.

use fixed_math::time::LocalTicks;
use osap::error::NetworkError;
use osap::network::{Network, SimNetwork, Task};
use osap::scan::ScanOptions;
use osap::session::Session;
use osap_sim::world::LinkModel;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// A simulated network that the bench can still look into while a session owns it.
struct Shared(Arc<Mutex<SimNetwork>>);

impl Shared {
    fn with<T>(&self, act: impl FnOnce(&mut SimNetwork) -> T) -> T {
        act(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Network for Shared {
    fn drive(&mut self, until: LocalTicks, task: Task) -> Result<(), NetworkError> {
        self.with(|network| network.drive(until, task))
    }

    fn now(&self) -> LocalTicks {
        self.with(|network| network.now())
    }

    fn link_names(&self) -> Vec<String> {
        self.with(|network| network.link_names())
    }

    fn is_simulated(&self) -> bool {
        true
    }

    fn capture_fault(&self) -> Option<String> {
        None
    }
}

/// Scans and prints.
pub(crate) fn run(nodes: usize, loops: usize, seed: u64) {
    println!(
        "scan of {nodes} devices with {loops} links more than a tree, 3 Mbaud UARTs, RP2040 at 200 MHz, seed {seed}"
    );
    let started = Instant::now();
    let network = Arc::new(Mutex::new(SimNetwork::network(nodes, loops, LinkModel::WIRE, seed)));
    let built_s = started.elapsed().as_secs_f64();
    let stats = |network: &Arc<Mutex<SimNetwork>>| Shared(Arc::clone(network)).with(|network| network.world().stats());
    let before = stats(&network);
    let mut session = Session::over(Shared(Arc::clone(&network)));
    let started = Instant::now();
    let report = match session.scan(&ScanOptions::default(), &mut |_| {}) {
        Ok(report) => report,
        Err(error) => {
            println!("the scan failed: {error}");
            return;
        }
    };
    let host_s = started.elapsed().as_secs_f64();
    let after = stats(&network);
    let (devices, links) = (report.map.devices.len(), report.map.links.len());
    let cost = report.cost;
    println!("found:        {devices} nodes (the host among them), {links} links");
    println!("questions:    {}, {} retries, {} unanswered", cost.requests, cost.retries, cost.timeouts);
    println!("packets:      {} sent and {} received by the host", cost.packets_sent, cost.packets_received);
    println!("              {} frames on all links, announcements among them", after.frames - before.frames);
    #[expect(clippy::cast_precision_loss, reason = "for people")]
    let (virtual_ms, events) = (cost.elapsed_us as f64 / 1e3, (after.events - before.events) as f64);
    println!("virtual time: {virtual_ms:.1} ms");
    println!(
        "host time:    {host_s:.2} s ({:.1} M events/s), after {built_s:.2} s to build and boot the network",
        events / host_s / 1e6
    );
}

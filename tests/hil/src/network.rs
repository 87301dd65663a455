//! Emulated devices as a network, in virtual time: the host's own core at the outside ports of a co-simulation.
//!
//! - **Walk:** a session → [`Network::drive`] → the core → a frame at an outside port → the image → a frame back → the core.
//! - **Invariants:** the core is the one that runs over real links. It takes no time itself: it acts at the end of the quantum, 2 µs at
//!   most, in which something came. A frame is stamped when its first byte has come, as a UART would, and sent
//!   where the last one ended.
//! - **Context:** the caller's thread; nothing waits for a clock.
//! - **Clauses:** `[LNK-01]`, `[FRM-08]`, `[NOD-12]`.

use crate::cosim::{Cosim, CosimError, Event, NS_PER_S, Ns};
use fixed_math::time::LocalTicks;
use osap::core::{HostCore, HostIdentity};
use osap::error::NetworkError;
use osap::network::{Network, Task};
use osap_protocol::GatewayIndex;
use osap_protocol::discovery::{GatewayKind, UniqueId};
use osap_protocol::framing::{Check, Deframer, encode, encoded_len_max};
use osap_protocol::header::Arrival;
use osap_runtime::{GatewayConfig, Stamps};
use osap_sim::endpoint::Endpoint;
use std::cell::RefCell;
use std::rc::Rc;

/// Rate of the outside ports, bits a second.
pub const BAUD: u32 = 3_000_000;
/// Packets of all images.
pub const PACKET_BYTES: usize = 256;
/// The co-simulation is asked for no more than this at once.
const STRETCH_NS: Ns = 1_000_000_000;
/// The least that is waited for what is due and cannot be done: a frame of four bytes.
const PATIENCE_NS: Ns = 10_000;

/// A co-simulation that a network and a scenario share.
pub type SharedCosim = Rc<RefCell<Cosim>>;

/// A frame that passed an outside port or a tap.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameRecord {
    /// The port or tap; what went out of a port carries a `>` before its name.
    pub place: String,
    /// All bytes, with the delimiter.
    pub bytes: Vec<u8>,
    /// Beginning of the first start bit.
    pub start_ns: Ns,
    /// End of the last stop bit.
    pub end_ns: Ns,
}

/// What a network noted: frames where it was asked to, and what happened to chips.
#[derive(Debug, Default)]
pub struct Journal {
    /// Whether frames are kept.
    pub keeps_frames: bool,
    /// The frames, in order of their becoming known.
    pub frames: Vec<FrameRecord>,
    /// When, which chip, what, and more about it.
    pub chips: Vec<(Ns, String, String, String)>,
}

/// An outside port as the host's link.
#[derive(Clone, Debug)]
pub struct HostPort {
    /// The port's name in the co-simulation.
    pub port: String,
    /// How its frames are guarded.
    pub check: Check,
    /// Rate, bits a second; 0 where it is unknown, as USB's is.
    pub bit_rate: u32,
}

impl HostPort {
    /// A UART of 3 Mbaud with CRC-16.
    #[must_use]
    pub fn uart(port: &str) -> Self {
        Self { port: port.to_owned(), check: Check::Crc16, bit_rate: BAUD }
    }

    /// USB-CDC.
    #[must_use]
    pub fn usb(port: &str) -> Self {
        Self { port: port.to_owned(), check: Check::None, bit_rate: 0 }
    }
}

struct HostLink {
    port: String,
    gateway: GatewayIndex,
    check: Check,
    busy_until_ns: Ns,
    /// From the first start bit to the middle of the byte's stop bit, when a UART has it, rounded up.
    first_byte_ns: Ns,
    deframer: Box<Deframer<{ PACKET_BYTES + 4 }>>,
}

/// The network.
pub struct CosimNetwork {
    cosim: SharedCosim,
    core: HostCore,
    links: Vec<HostLink>,
    journal: Rc<RefCell<Journal>>,
}

impl std::fmt::Debug for CosimNetwork {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("CosimNetwork")
            .field("links", &self.link_names())
            .field("now", &self.now())
            .finish_non_exhaustive()
    }
}

impl CosimNetwork {
    /// A host, the same in each run of a seed, whose links are `ports`. They are open at once.
    #[must_use]
    pub fn new(cosim: SharedCosim, ports: &[HostPort], seed: u64) -> Self {
        let mut unique_id = *b"host\0\0\0\0\0\0\0\0";
        unique_id[4..].copy_from_slice(&seed.to_be_bytes());
        let identity = HostIdentity { unique_id: UniqueId(unique_id), boot_epoch: 1, name: "host".to_owned() };
        let mut core = HostCore::new(&identity);
        let now = ticks(cosim.borrow().now_ns());
        let links = ports.iter().filter_map(|port| open_link(&mut core, port, now)).collect();
        Self { cosim, core, links, journal: Rc::default() }
    }

    /// What is noted while it runs.
    #[must_use]
    pub fn journal(&self) -> Rc<RefCell<Journal>> {
        Rc::clone(&self.journal)
    }

    /// Sends what the core has, by links that are clear to send.
    fn transmit(&mut self) -> Result<(), CosimError> {
        let now_ns = self.cosim.borrow().now_ns();
        let now = ticks(now_ns);
        let mut packet = [0; PACKET_BYTES];
        let mut frame = [0; encoded_len_max(PACKET_BYTES, Check::Crc32)];
        for link in &mut self.links {
            while link.busy_until_ns <= now_ns
                && self.core.has_output(link.gateway, now)
                && let Some(outgoing) = self.core.transmit(link.gateway, now, &mut packet)
            {
                let Ok(len) = encode(&packet[..outgoing.len], link.check, &mut frame) else { continue };
                let (start_ns, end_ns) = self.cosim.borrow_mut().send(&link.port, &frame[..len], now_ns)?;
                link.busy_until_ns = end_ns;
                let mut journal = self.journal.borrow_mut();
                if journal.keeps_frames {
                    let place = format!(">{}", link.port);
                    journal.frames.push(FrameRecord { place, bytes: frame[..len].to_vec(), start_ns, end_ns });
                }
            }
        }
        Ok(())
    }

    /// Lets time pass up to the next thing that happens, `until_ns` at the latest.
    fn step(&mut self, until_ns: Ns) -> Result<(), CosimError> {
        let now_ns = self.cosim.borrow().now_ns();
        let now = ticks(now_ns);
        let mut next = until_ns.min(now_ns + STRETCH_NS);
        if let Some(wake) = self.core.next_wake() {
            // what is due and was not done waits for a link to be free
            next = next.min(if wake > now { first_ns(wake) } else { now_ns + PATIENCE_NS });
        }
        for link in &self.links {
            // a link that becomes free is looked at, so that a task which keeps it busy can
            if link.busy_until_ns > now_ns {
                next = next.min(link.busy_until_ns);
            }
        }
        let events = self.cosim.borrow_mut().run(next.max(now_ns + 1), true)?;
        for event in events {
            self.take(event);
        }
        Ok(())
    }

    fn take(&mut self, event: Event) {
        match event {
            Event::Chip { chip, event, detail } => {
                let now_ns = self.cosim.borrow().now_ns();
                self.journal.borrow_mut().chips.push((now_ns, chip, event, detail));
            }
            Event::Frame { port, bytes, start_ns, end_ns } => {
                if let Some(link) = self.links.iter_mut().find(|link| link.port == port) {
                    let came_ns = (start_ns + link.first_byte_ns).min(end_ns);
                    deliver(&mut self.core, link, &bytes, ticks(came_ns), ticks(end_ns));
                }
                let mut journal = self.journal.borrow_mut();
                if journal.keeps_frames {
                    journal.frames.push(FrameRecord { place: port, bytes, start_ns, end_ns });
                }
            }
        }
    }

    fn drive_on(&mut self, until: LocalTicks, mut task: Task) -> Result<(), CosimError> {
        let until_ns = first_ns(until);
        loop {
            let now = self.now();
            // first what has come, so that the task sees what became of it; then what the task wants sent
            self.core.run(now);
            let is_done = task(&mut self.core, now);
            self.core.run(now);
            self.transmit()?;
            if is_done || now >= until {
                return Ok(());
            }
            self.step(until_ns)?;
        }
    }
}

impl Network for CosimNetwork {
    fn drive(&mut self, until: LocalTicks, task: Task) -> Result<(), NetworkError> {
        self.drive_on(until, task).map_err(|error| {
            eprintln!("{error}");
            NetworkError::Stopped
        })
    }

    fn now(&self) -> LocalTicks {
        ticks(self.cosim.borrow().now_ns())
    }

    fn link_names(&self) -> Vec<String> {
        self.links.iter().map(|link| format!("cosim:{}", link.port)).collect()
    }

    fn is_simulated(&self) -> bool {
        true
    }

    fn capture_fault(&self) -> Option<String> {
        None
    }
}

fn open_link(core: &mut HostCore, port: &HostPort, now: LocalTicks) -> Option<HostLink> {
    let gateway = core.add_link(GatewayConfig {
        type_name: if port.bit_rate == 0 { "usb-cdc" } else { "uart" },
        kind: GatewayKind::Link,
        mtu_bytes: 256,
        bit_rate: port.bit_rate,
        bits_a_byte: if port.bit_rate == 0 { 8 } else { 10 },
        check: port.check,
        packet_hold_max: 0, // the core says what its links may hold
        stamps: Stamps::SOFTWARE,
    })?;
    core.set_link(gateway, None, now);
    let half_bits_ns = |rate: u32| (19 * NS_PER_S).div_ceil(2 * Ns::from(rate));
    let first_byte_ns = if port.bit_rate == 0 { 0 } else { half_bits_ns(port.bit_rate) };
    let (port, check) = (port.port.clone(), port.check);
    let deframer = Box::new(Deframer::new(check));
    Some(HostLink { port, gateway, check, busy_until_ns: 0, first_byte_ns, deframer })
}

fn deliver(core: &mut HostCore, link: &mut HostLink, bytes: &[u8], started: LocalTicks, ended: LocalTicks) {
    for byte in bytes {
        match link.deframer.push(*byte, started) {
            None => {}
            Some(Ok(frame)) => {
                let mut packet = frame.packet.to_vec();
                core.receive(Arrival::Link(link.gateway), &mut packet, frame.started, ended);
            }
            Some(Err(error)) => core.count(error.into(), Some(link.gateway), ended),
        }
    }
}

/// What the host's clock reads at a virtual instant: it is perfect.
#[must_use]
#[expect(clippy::cast_possible_truncation, reason = "a quarter of a number of 64 bits")]
pub const fn ticks(ns: Ns) -> LocalTicks {
    LocalTicks::from_steps((ns as u128 * 256 / 1_000) as u64)
}

/// The first nanosecond at which the host's clock reads at least `ticks`.
#[must_use]
#[expect(clippy::cast_possible_truncation, reason = "compared with the largest before")]
pub const fn first_ns(ticks: LocalTicks) -> Ns {
    let ns = (ticks.steps() as u128 * 1_000).div_ceil(256);
    if ns > Ns::MAX as u128 { Ns::MAX } else { ns as Ns }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wait that ends at [`first_ns`] finds its instant come, and not a nanosecond earlier.
    #[test]
    fn nanoseconds_and_ticks_meet() {
        for steps in [0, 1, 2, 255, 256, 257, 1_000_003, 1 << 50] {
            let ticks_there = LocalTicks::from_steps(steps);
            assert!(ticks(first_ns(ticks_there)) >= ticks_there, "{steps}");
            assert!(steps == 0 || ticks(first_ns(ticks_there) - 1) < ticks_there, "{steps}");
        }
        assert_eq!(first_ns(LocalTicks::MAX), Ns::MAX);
    }
}

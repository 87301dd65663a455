//! Emulated Picos, wired up in the shapes that the scenarios use, with a session of the host in virtual time.
//!
//! - **Walk:** [`Bench::hub_and_device`] → power-on, announcements → a [`Session`] that scans, pings and asks as over any network.
//! - **Invariants:** chips carry numbers of their own; every wire and port runs at 3 Mbaud. The kind's pins are those of the board.
//! - **Context:** the caller's thread.

use crate::cosim::{Chip, Cosim, NS_PER_MS, Ns, WireFaults};
use crate::images::{Image, Places};
use crate::network::{BAUD, CosimNetwork, HostPort, Journal, SharedCosim};
use crate::report::Failure;
use fixed_math::time::Span;
use osap::map::RouteText;
use osap::session::Session;
use std::cell::RefCell;
use std::path::Path;
use std::rc::Rc;

/// The processor's clock on an RP2040, Hz.
pub const CORE_HZ: u64 = 125_000_000;
/// Time after power-on at which everybody has announced himself.
const BOOT_NS: Ns = 300 * NS_PER_MS;
/// Kinds by their number at the straps.
pub const HUB: u8 = 0;
/// Drives a motor.
pub const MOTOR: u8 = 1;
/// Heats and measures.
pub const HEATER: u8 = 3;

/// A Pico of the kind with number `kind` in `firmware_app::kind::KINDS`: its pins GPIO18 to 20 are strapped.
#[must_use]
pub fn pico(name: &str, elf: &Path, unique_id: u64, kind: u8) -> Chip {
    let high_pins = (0..3).filter(|bit| kind >> bit & 1 == 1).map(|bit| 18 + bit).collect();
    Chip { high_pins, ..Chip::new(name, elf, unique_id) }
}

/// A co-simulation with a host at its ports.
pub struct Bench {
    /// The co-simulation.
    pub cosim: SharedCosim,
    /// The host's questions.
    pub session: Session,
    /// What was noted.
    pub journal: Rc<RefCell<Journal>>,
}

impl std::fmt::Debug for Bench {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Bench").field("session", &self.session).finish_non_exhaustive()
    }
}

impl Bench {
    /// Whatever `wire_up` adds, with the host at `ports`, after its boot. Frames are kept from power-on where `keeps_frames` says so.
    ///
    /// # Errors
    /// [`Failure`] where an image is missing or the co-simulation refuses.
    pub fn build(
        places: &Places,
        seed: u64,
        ports: &[HostPort],
        keeps_frames: bool,
        wire_up: impl FnOnce(&mut Cosim, &Path) -> Result<(), Failure>,
    ) -> Result<Self, Failure> {
        let elf = places.image(Image::Rp2040Pico)?;
        let mut cosim = Cosim::start(&places.server())?;
        wire_up(&mut cosim, &elf)?;
        let cosim = Rc::new(RefCell::new(cosim));
        let network = CosimNetwork::new(Rc::clone(&cosim), ports, seed);
        let journal = network.journal();
        journal.borrow_mut().keeps_frames = keeps_frames;
        let mut bench = Self { cosim, session: Session::over(network), journal };
        bench.run_for(BOOT_NS)?;
        Ok(bench)
    }

    /// One Pico, `device`, at the host's link 0.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn device(places: &Places, seed: u64) -> Result<Self, Failure> {
        Self::build(places, seed, &[HostPort::uart("host")], false, |cosim, elf| {
            cosim.chip(&pico("device", elf, 0xd1, MOTOR))?;
            Ok(cosim.port("host", ("device", 0), BAUD, None)?)
        })
    }

    /// A Pico `hub` at the host's link 0, and behind its second UART a Pico `device`. The wire between them, `inner`, is tapped.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn hub_and_device(places: &Places, seed: u64, faults: Option<WireFaults>) -> Result<Self, Failure> {
        Self::build(places, seed, &[HostPort::uart("host")], false, |cosim, elf| {
            cosim.chip(&pico("hub", elf, 0xa1, HUB))?;
            cosim.chip(&pico("device", elf, 0xd1, MOTOR))?;
            cosim.wire("inner", ("hub", 1), ("device", 0), faults)?;
            cosim.tap("inner")?;
            Ok(cosim.port("host", ("hub", 0), BAUD, faults)?)
        })
    }

    /// A Pico `hub` with the host at both its UARTs: link 0, `a`, is at its first, link 1, `b`, at its second. Both are tapped, and frames are
    /// kept from power-on.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn loop_through_hub(places: &Places, seed: u64, faults: Option<WireFaults>) -> Result<Self, Failure> {
        Self::build(places, seed, &[HostPort::uart("a"), HostPort::uart("b")], true, |cosim, elf| {
            cosim.chip(&pico("hub", elf, 0xa1, HUB))?;
            cosim.port("a", ("hub", 0), BAUD, faults)?;
            let other = faults.map(|faults| WireFaults { seed: faults.seed.wrapping_add(1), ..faults });
            cosim.port("b", ("hub", 1), BAUD, other)?;
            cosim.tap("a")?;
            Ok(cosim.tap("b")?)
        })
    }

    /// Lets virtual time pass, with the host at work.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn run_for(&mut self, ns: Ns) -> Result<(), Failure> {
        Ok(self.session.network().pause(Span::from_us(ns / 1_000))?)
    }

    /// The present.
    #[must_use]
    pub fn now_ns(&self) -> Ns {
        self.cosim.borrow().now_ns()
    }

    /// Keeps frames from now on, or no longer; what was kept is given back.
    pub fn keep_frames(&mut self, keep: bool) -> Vec<crate::network::FrameRecord> {
        let mut journal = self.journal.borrow_mut();
        journal.keeps_frames = keep;
        std::mem::take(&mut journal.frames)
    }
}

/// A route of the host.
///
/// # Panics
/// Where `text` is no route: it stands in a scenario.
#[must_use]
pub fn route(text: &str) -> RouteText {
    text.parse().expect("a route written in a scenario")
}

/// Nanoseconds as microseconds.
#[must_use]
pub fn us(ns: Ns) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "exact below 2^53 ns, a hundred days")]
    let ns = ns as f64;
    ns / 1_000.0
}

/// Cycles of the RP2040's clock as microseconds.
#[must_use]
pub fn cycles_us(cycles: u64) -> f64 {
    us(cycles * 8)
}
const _: () = assert!(1_000_000_000 / CORE_HZ == 8, "a cycle has 8 ns");

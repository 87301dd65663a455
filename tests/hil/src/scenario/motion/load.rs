//! What chips have to do beside motion: both wires busy both ways, and user code that never ends.
//!
//! - **Walk:** [`Load::start`] → [`Load::run_until`] again and again. **Invariant:** as in the scenario `clock`: 80 % of a wire of 3 Mbaud each way.
//! - **Context:** virtual time.

use super::stage::Stage;
use crate::report::Failure;
use firmware_app::stream::StreamRequest;
use fixed_math::time::{NetTime, Span};
use osap::core::HostCore;
use osap_protocol::PortIndex;
use osap_runtime::sequenced::{Destination, Expect, Ticket};

/// Ports of every device, `[APP-01]`.
const STREAM: PortIndex = PortIndex::from_low_bits(2);
const SPIN: PortIndex = PortIndex::from_low_bits(3);
/// A packet each way in every such time: 240 bytes of ten bits are 800 µs.
const EVERY_US: u64 = 1_000;
const BYTES: u16 = 222;
/// Turns of a spin: some 20 ms of a processor that does nothing else.
const SPIN_TURNS: u32 = 200_000;

/// The load.
pub(super) struct Load {
    last: Destination,
    spins: Vec<(Destination, Option<Ticket>)>,
}

impl Load {
    /// Has the last chip send for `ms`, and all spin.
    pub(super) fn start(stage: &mut Stage, ms: u32) -> Result<Self, Failure> {
        let ports = stage.ports.clone();
        let last = ports.last().cloned().ok_or_else(|| Failure::Failed("no motors".to_owned()))?;
        let last = Destination { port: STREAM, ..last };
        let request = StreamRequest { interval_us: 1_000, payload_bytes: BYTES, count: ms, ttl_us: 30_000 };
        stage.bench.session.request(&last, "a stream", &request.encode())?;
        let spin = |port: &Destination| (Destination { port: SPIN, ttl_us: u16::MAX, ..port.clone() }, None);
        Ok(Self { last, spins: ports.iter().map(spin).collect() })
    }

    /// Keeps all busy up to a system time.
    pub(super) fn run_until(&mut self, stage: &mut Stage, until: NetTime) -> Result<(), Failure> {
        loop {
            let now = stage.now();
            // instants are whole nanoseconds, times are not
            if now + Span::from_us(1) >= until {
                return Ok(());
            }
            for (to, open) in &mut self.spins {
                if open.is_none_or(|ticket| stage.strangers.contains(&ticket)) {
                    let sent = stage.bench.session.network().submit(to.clone(), Expect::One, &SPIN_TURNS.to_le_bytes());
                    *open = Some(sent.map_err(|error| Failure::Failed(format!("a spin was not sent: {error:?}")))?);
                }
            }
            let to = self.last.clone();
            let local = stage.bench.session.network().now();
            let task = move |core: &mut HostCore, now| {
                // a link that is full for the moment is what the load is for
                let _shed = core.send_datagram(&to, &[0x55; BYTES as usize], now);
                true
            };
            stage.bench.session.network().drive(local + Span::from_us(1), Box::new(task))?;
            stage.run_until((now + Span::from_us(EVERY_US)).min(until))?;
        }
    }
}

//! A pseudo-terminal: looks like a serial port to whoever opens it, as a simulated device offers one.
//!
//! - **Walk:** [`listen`] makes one and tells its name → a peer opens `serial:` and that name → `stream` here, `serial` there.
//! - **Invariants:** the slave side is held open here too, so that peers may come and go without the terminal hanging up. Writes never
//!   block: while nobody reads, the link is not clear to send once the terminal's buffer is full.
//! - **Clauses:** `[LNK-01]`, `[FRM-02]`: guarded like any serial port that is not USB-CDC.

use super::pump::{self, Attempt, Ending, Form, Opener};
use super::serial::{Port, never_block};
use super::stream;
use super::{Clock, LinkError, LinkHandle, Start};
use osap_protocol::framing::Check;
use serialport::{SerialPort, TTYPort};
use std::time::Duration;

pub(super) fn listen(start: Start<'_>) -> Result<LinkHandle, LinkError> {
    let check = start.spec.check.unwrap_or(Check::Crc16);
    let failed = |error: serialport::Error| LinkError::Pty { reason: error.to_string() };
    let (master, slave) = TTYPort::pair().map_err(failed)?;
    never_block(&master).map_err(|error| LinkError::Pty { reason: error.to_string() })?;
    let device = slave.name().ok_or_else(|| LinkError::Pty { reason: "it has no name".to_owned() })?;
    let halves = (Port(master.try_clone().map_err(failed)?), Port(Box::new(master)));
    let description = start.describe(format!("pty:{device}"), "pty", check);
    let opener = PtyOpener { halves: Some(halves), _slave: slave, clock: start.clock.clone() };
    pump::start(start.plan(description, Form::Stuffed(check)), Box::new(opener))
}

struct PtyOpener {
    halves: Option<(Port, Port)>,
    /// Held, not used.
    _slave: TTYPort,
    clock: Clock,
}

impl Opener for PtyOpener {
    fn open(&mut self, _ending: &Ending<'_>) -> Attempt {
        match self.halves.take() {
            Some((reading, writing)) => Attempt::Opened(stream::session(reading, writing, &self.clock)),
            None => Attempt::Over("the pseudo-terminal is gone".to_owned()),
        }
    }

    fn retry_after(&self, _failures: u32) -> Duration {
        Duration::ZERO
    }
}

//! How much gets through to a device and back, and how fast: echoes of several sizes, several at once.
//!
//! - **Walk:** [`Session::bench`] → sequenced requests to the echo port, `window` of them open → [`BenchReport`].
//! - **Invariants:** an echo that does not come back as it was sent is counted as corrupt, never as done. Round trips of what was sent
//!   more than once are in no figure; its bytes count once.
//! - **Context:** the caller's thread; time is the host's clock, virtual where the network is simulated. **Clause:** `[TRN-03]`.

use crate::core::{Completion, Outcome};
use crate::error::{AskError, NetworkError};
use crate::ping::{percentile, us};
use crate::session::{ECHO_PORT, Session};
use fixed_math::time::Span;
use osap_runtime::sequenced::{Destination, Expect, RequestError, Ticket};
use serde::Serialize;
use std::collections::BTreeMap;

/// So many losses one after the other are a device that is gone, not a bad cable: each costs all its tries.
pub const LOST_IN_A_ROW_MAX: u32 = 16;

/// How to measure.
#[derive(Clone, Copy, Debug)]
pub struct BenchOptions {
    /// Payload of each message, bytes.
    pub payload_bytes: usize,
    /// Messages.
    pub count: u32,
    /// Messages open at once.
    pub window: usize,
}

impl Default for BenchOptions {
    fn default() -> Self {
        Self { payload_bytes: 64, count: 1_000, window: crate::session::WINDOW_A_LINK }
    }
}

/// What was measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct BenchReport {
    /// Payload of each message, bytes.
    pub payload_bytes: usize,
    /// Messages open at once.
    pub window: usize,
    /// Messages sent: fewer than asked for where the device was given up.
    pub sent: u32,
    /// Those that came back as they were sent.
    pub answered: u32,
    /// Of these, those sent more than once.
    pub late: u32,
    /// Those that did not come back.
    pub lost: u32,
    /// Those that came back different.
    pub corrupt: u32,
    /// From the first message to the last answer, µs.
    pub elapsed_us: f64,
    /// Messages a second, there and back.
    pub messages_s: f64,
    /// Payload bytes a second, each way.
    pub bytes_s: f64,
    /// Half of the round trips are no longer, µs.
    pub p50_us: f64,
    /// 99 of 100 round trips are no longer, µs.
    pub p99_us: f64,
    /// The longest round trip, µs.
    pub max_us: f64,
}

impl Session {
    /// Sends `count` echoes to a device, or fewer where [`LOST_IN_A_ROW_MAX`] of them do not come back.
    ///
    /// # Errors
    /// [`AskError`] where a message cannot be sent or the network cannot go on. Silence is no error.
    pub fn bench(&mut self, to: &Destination, options: &BenchOptions) -> Result<BenchReport, AskError> {
        let to = Destination { port: ECHO_PORT, ..to.clone() };
        let (payload_bytes, window) = (options.payload_bytes, options.window);
        let mut report = BenchReport { payload_bytes, window, ..BenchReport::default() };
        let (mut times, mut refused, mut lost_in_a_row) = (Vec::new(), None, 0);
        let started = self.network().now();
        report.sent = self.echoes(&to, options, &mut |number, result| {
            match result {
                Ok(Outcome::Reply(reply)) if reply.payload == pattern(number, payload_bytes) => {
                    report.answered += 1;
                    lost_in_a_row = 0;
                    if reply.tries == 1 {
                        times.push(reply.round_trip);
                    } else {
                        report.late += 1;
                    }
                }
                Ok(Outcome::Reply(_) | Outcome::Refusal(_)) => {
                    report.corrupt += 1;
                    lost_in_a_row = 0;
                }
                Ok(Outcome::Timeout { .. } | Outcome::Ended) => {
                    report.lost += 1;
                    lost_in_a_row += 1;
                }
                Err(error) => {
                    refused = Some(error);
                    report.lost += 1;
                    lost_in_a_row += 1;
                }
            }
            lost_in_a_row < LOST_IN_A_ROW_MAX
        })?;
        if let Some(error) = refused.filter(|_| report.answered == 0) {
            return Err(AskError::Send { place: self.place(&to), error });
        }
        report.time(self.network().now().since(started), times);
        Ok(report)
    }

    /// Sends echoes, `window` of them open at once, for as long as `each` wants more; says how many there were.
    fn echoes(
        &mut self,
        to: &Destination,
        options: &BenchOptions,
        each: &mut dyn FnMut(u32, Result<Outcome, RequestError>) -> bool,
    ) -> Result<u32, NetworkError> {
        let mut open: BTreeMap<Ticket, u32> = BTreeMap::new();
        let (mut next, mut goes_on) = (0, true);
        loop {
            while goes_on && next < options.count && open.len() < options.window.max(1) {
                match self.network().submit(to.clone(), Expect::One, &pattern(next, options.payload_bytes)) {
                    Ok(ticket) => {
                        open.insert(ticket, next);
                    }
                    // room comes with the answers to those that are open
                    Err(_) if !open.is_empty() => break,
                    Err(error) => goes_on = each(next, Err(error)),
                }
                next += 1;
            }
            if open.is_empty() {
                return Ok(next);
            }
            let Completion { ticket, outcome, .. } = self.network().wait()?;
            // a ticket of somebody before us is none of ours
            if let Some(number) = open.remove(&ticket) {
                goes_on &= each(number, Ok(outcome));
            }
        }
    }
}

impl BenchReport {
    fn time(&mut self, elapsed: Span, mut times: Vec<Span>) {
        times.sort_unstable();
        self.elapsed_us = us(elapsed);
        self.p50_us = us(percentile(&times, 50));
        self.p99_us = us(percentile(&times, 99));
        self.max_us = us(times.last().copied().unwrap_or(Span::ZERO));
        if self.elapsed_us > 0.0 {
            self.messages_s = f64::from(self.answered) * 1e6 / self.elapsed_us;
            #[expect(clippy::cast_precision_loss, reason = "far below 2^53")]
            let payload = self.payload_bytes as f64;
            self.bytes_s = self.messages_s * payload;
        }
    }
}

/// A payload that differs from message to message, so that an answer to another one is seen.
fn pattern(number: u32, len: usize) -> Vec<u8> {
    number.to_le_bytes().into_iter().chain((4u8..=255).cycle()).take(len).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::OpenOptions;

    /// Too little time for the wires is as silent as a device that is gone.
    #[test]
    fn a_silent_device_is_given_up() {
        let mut session = Session::open(&["sim:line:1".parse().unwrap()], &OpenOptions::default()).unwrap();
        let known = session.destination(&"/0".parse().unwrap());
        let to = Destination { ttl_us: 300, ..known.clone() };
        let options = BenchOptions { window: 1, ..BenchOptions::default() };
        let report = session.bench(&to, &options).unwrap();
        assert_eq!((report.sent, report.lost, report.answered), (LOST_IN_A_ROW_MAX, LOST_IN_A_ROW_MAX, 0));
        let report = session.bench(&known, &options).unwrap();
        assert_eq!((report.sent, report.answered), (1_000, 1_000));
        let nowhere = session.destination(&"/5".parse().unwrap());
        assert!(matches!(session.bench(&nowhere, &options), Err(AskError::Send { .. })));
    }
}

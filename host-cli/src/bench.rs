//! How much gets through to a device and back, and how fast: echoes of several sizes, several at once.
//!
//! - **Walk:** [`Session::bench`] → sequenced requests to the echo port, `window` of them open → [`BenchReport`].
//! - **Invariants:** an echo that does not come back as it was sent is counted as corrupt, never as done. Round trips of what was sent
//!   more than once are in no figure; its bytes count once.
//! - **Context:** the caller's thread; time is the host's clock, virtual where the network is simulated. **Clause:** `[TRN-03]`.

use crate::core::Outcome;
use crate::error::AskError;
use crate::ping::{percentile, us};
use crate::session::{ECHO_PORT, Question, Session, Window};
use fixed_math::time::Span;
use osap_runtime::sequenced::{Destination, Expect};
use serde::Serialize;

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
    /// Messages sent.
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
    /// Sends `count` echoes to a device.
    ///
    /// # Errors
    /// [`AskError`] where a message cannot be sent or the network cannot go on. Silence is no error.
    pub fn bench(&mut self, to: &Destination, options: &BenchOptions) -> Result<BenchReport, AskError> {
        let to = Destination { port: ECHO_PORT, ..to.clone() };
        let questions = (0..options.count).map(|number| Question {
            to: to.clone(),
            expect: Expect::One,
            payload: pattern(number, options.payload_bytes),
            tag: number,
        });
        let (payload_bytes, window) = (options.payload_bytes, options.window);
        let mut report = BenchReport { payload_bytes, window, ..BenchReport::default() };
        let (mut times, mut refused) = (Vec::new(), None);
        let started = self.network().now();
        let open = Window { a_link: window, in_all: window };
        open.run(self.network(), questions.collect(), &mut |reported| match reported.result {
            Ok(Outcome::Reply(reply)) if reply.payload == pattern(reported.tag, payload_bytes) => {
                report.answered += 1;
                if reply.tries == 1 {
                    times.push(reply.round_trip);
                } else {
                    report.late += 1;
                }
            }
            Ok(Outcome::Reply(_) | Outcome::Refusal(_)) => report.corrupt += 1,
            Ok(Outcome::Timeout { .. } | Outcome::Ended) => report.lost += 1,
            Err(error) => refused = Some(error),
        })?;
        if let Some(error) = refused {
            return Err(AskError::Send { place: self.place(&to), error });
        }
        report.sent = options.count;
        report.time(self.network().now().since(started), times);
        Ok(report)
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

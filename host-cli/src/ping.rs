//! Round trips to one device.
//!
//! - **Walk:** [`Session::ping`] → the same question again and again → [`PingReport`].
//! - **Invariants:** one question is open at a time, so that none waits for another. A question that had to be sent again says when the
//!   last try was answered, or a late answer to an earlier one: it counts as lost once and is in no average.
//! - **Context:** the caller's thread. The default question is the 76-byte one of Table 2.7, `[DSC-07]`.

use crate::error::AskError;
use crate::session::Session;
use fixed_math::time::Span;
use osap_protocol::PortIndex;
use osap_protocol::discovery::{Query, ScanId, encode};
use osap_runtime::SendError;
use osap_runtime::sequenced::{Destination, RequestError};
use serde::Serialize;

/// How to ping.
#[derive(Clone, Copy, Debug)]
pub struct PingOptions {
    /// How often.
    pub count: u32,
    /// From one question to the next, at least.
    pub interval: Span,
    /// Which question.
    pub query: Query,
}

impl Default for PingOptions {
    fn default() -> Self {
        Self { count: 10, interval: Span::from_us(100_000), query: Query::TimeControl }
    }
}

/// What came of one question.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PingResult {
    /// Answered at the first try.
    Answered(Span),
    /// Answered, but not at the first try.
    Late {
        /// How often it was sent.
        tries: u8,
    },
    /// Not answered at all.
    Lost {
        /// How often it was sent.
        tries: u8,
    },
    /// Not sent: the host's own link was down, say. It counts as lost, and the next question is asked all the same.
    Unsent {
        /// Why.
        error: SendError,
    },
}

/// Round trips, µs. All but the counts are zero where there were none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PingReport {
    /// Questions asked.
    pub sent: u32,
    /// Answered at the first try: what the times below are of.
    pub answered: u32,
    /// Answered at a later try.
    pub late: u32,
    /// Not answered, or not even sent.
    pub lost: u32,
    /// The shortest.
    pub min_us: f64,
    /// Their mean.
    pub mean_us: f64,
    /// Their standard deviation (of the sample, n − 1).
    pub sigma_us: f64,
    /// Half of them are no longer.
    pub p50_us: f64,
    /// 99 of 100 are no longer.
    pub p99_us: f64,
    /// The longest.
    pub max_us: f64,
}

impl Session {
    /// Asks `count` times; `each` is told of every answer.
    ///
    /// # Errors
    /// [`AskError`] where a question is refused, or the network cannot go on. Silence is no error, nor is a link that is down at times.
    pub fn ping(
        &mut self,
        to: &Destination,
        options: &PingOptions,
        each: &mut dyn FnMut(u32, PingResult),
    ) -> Result<PingReport, AskError> {
        let mut results = Vec::new();
        for number in 0..options.count {
            let started = self.network().now();
            let result = self.ping_once(to, options.query)?;
            each(number, result);
            results.push(result);
            let spent = self.network().now().since(started);
            if number + 1 < options.count {
                self.network().pause(options.interval.saturating_sub(spent))?;
            }
        }
        Ok(PingReport::of(&results))
    }

    fn ping_once(&mut self, to: &Destination, query: Query) -> Result<PingResult, AskError> {
        let to = Destination { port: PortIndex::NETRESPONDER, ..to.clone() };
        match self.request(&to, query.name(), &question(query)) {
            Ok(reply) if reply.tries == 1 => Ok(PingResult::Answered(reply.round_trip)),
            Ok(reply) => Ok(PingResult::Late { tries: reply.tries }),
            Err(AskError::Timeout { tries, .. }) => Ok(PingResult::Lost { tries }),
            Err(AskError::Send { error: RequestError::Send(error), .. }) => Ok(PingResult::Unsent { error }),
            Err(error) => Err(error),
        }
    }
}

/// A query's payload; those that take a value get one that changes nothing.
fn question(query: Query) -> Vec<u8> {
    let mut bytes = [0; 16];
    let len = match query {
        Query::RuntimeInfo => encode(query.key(), &ScanId::default(), &mut bytes),
        Query::LinkInfo | Query::Counters => encode(query.key(), &0u8, &mut bytes),
        Query::PortInfo => encode(query.key(), &0u16, &mut bytes),
        Query::DebugMessages => encode(query.key(), &0u32, &mut bytes),
        // one that would set something is sent without a value, and refused
        _ => encode(query.key(), &(), &mut bytes),
    };
    bytes[..len.unwrap_or(0)].to_vec()
}

impl PingReport {
    /// The figures of some results.
    #[must_use]
    pub fn of(results: &[PingResult]) -> Self {
        let mut report = Self { sent: u32::try_from(results.len()).unwrap_or(u32::MAX), ..Self::default() };
        let mut times: Vec<Span> = Vec::new();
        for result in results {
            match result {
                PingResult::Answered(span) => times.push(*span),
                PingResult::Late { .. } => report.late += 1,
                PingResult::Lost { .. } | PingResult::Unsent { .. } => report.lost += 1,
            }
        }
        times.sort_unstable();
        report.answered = u32::try_from(times.len()).unwrap_or(u32::MAX);
        let (Some(first), Some(last)) = (times.first(), times.last()) else { return report };
        let n = f64::from(report.answered);
        report.min_us = us(*first);
        report.max_us = us(*last);
        report.mean_us = times.iter().copied().map(us).sum::<f64>() / n;
        let squares: f64 = times.iter().map(|span| (us(*span) - report.mean_us).powi(2)).sum();
        report.sigma_us = if times.len() > 1 { (squares / (n - 1.0)).sqrt() } else { 0.0 };
        report.p50_us = us(percentile(&times, 50));
        report.p99_us = us(percentile(&times, 99));
        report
    }
}

/// The smallest of sorted `times` that `percent` of them do not exceed (nearest rank).
pub(crate) fn percentile(times: &[Span], percent: usize) -> Span {
    let rank = (times.len() * percent).div_ceil(100).max(1);
    times.get(rank - 1).copied().unwrap_or(Span::ZERO)
}

pub(crate) fn us(span: Span) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "exact below 2^53 steps, over a year")]
    let steps = span.steps() as f64;
    steps / f64::from(1 << fixed_math::time::FRACTION_BITS)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answered(us: u64) -> PingResult {
        PingResult::Answered(Span::from_us(us))
    }

    /// Worked by hand: 2, 4, 4, 4, 5, 5, 7, 9 have mean 5 and a sum of squares of 32.
    #[test]
    fn figures_are_those_worked_by_hand() {
        let report = PingReport::of(&[9, 2, 4, 4, 5, 4, 7, 5].map(answered));
        assert_eq!((report.min_us, report.mean_us, report.max_us), (2.0, 5.0, 9.0));
        assert!((report.sigma_us - (32.0f64 / 7.0).sqrt()).abs() < 1e-12);
        assert_eq!((report.p50_us, report.p99_us), (4.0, 9.0));
    }

    /// The host has one link; by another nothing is sent, which is no reason to throw away what else was measured.
    #[test]
    fn what_cannot_be_sent_is_lost_with_its_reason_and_the_next_is_asked() {
        let mut session =
            Session::open(&["sim:line:1".parse().unwrap()], &crate::session::OpenOptions::default()).unwrap();
        let to = session.destination(&"/5".parse().unwrap());
        let mut results = Vec::new();
        let options = PingOptions { count: 3, ..PingOptions::default() };
        let report = session.ping(&to, &options, &mut |_, result| results.push(result)).unwrap();
        assert_eq!((report.sent, report.answered, report.lost), (3, 0, 3));
        assert!(results.iter().all(|result| matches!(result, PingResult::Unsent { .. })), "{results:?}");
    }

    #[test]
    fn what_was_sent_again_is_in_no_average() {
        let report = PingReport::of(&[answered(10), PingResult::Late { tries: 2 }, PingResult::Lost { tries: 4 }]);
        assert_eq!((report.sent, report.answered, report.late, report.lost), (3, 1, 1, 1));
        assert_eq!((report.mean_us, report.sigma_us, report.p99_us), (10.0, 0.0, 10.0));
        assert_eq!(PingReport::of(&[]), PingReport::default());
    }
}

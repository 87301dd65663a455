//! Many questions at once, but few enough for the smallest hub on the way.
//!
//! - **Walk:** a list of questions → [`Window::run`] → each reported as it ends, the next one sent in its place.
//! - **Invariants:** at most `a_link` questions are open by one of the host's links: each may take a slot in every hub on its way, and a
//!   hub holds four packets for a gateway. Each question is reported once.
//! - **Context:** the caller's thread.

use crate::core::{Completion, Outcome};
use crate::error::NetworkError;
use crate::network::{Network, first_link};
use osap_protocol::{DropCause, GatewayIndex};
use osap_runtime::SendError;
use osap_runtime::sequenced::{Destination, Expect, RequestError, Ticket};
use std::collections::{BTreeMap, VecDeque};

/// Questions open by one link of the host: what a hub holds for one gateway.
pub const WINDOW_A_LINK: usize = 4;
/// Questions open in all, some fewer than the host's core can keep.
pub const WINDOW_IN_ALL: usize = 48;

/// How many questions may be open.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// By one of the host's links, at least 1.
    pub a_link: usize,
    /// In all, at least 1.
    pub in_all: usize,
}

impl Default for Window {
    fn default() -> Self {
        Self { a_link: WINDOW_A_LINK, in_all: WINDOW_IN_ALL }
    }
}

/// One question.
#[derive(Clone, Debug)]
pub(crate) struct Question<T = usize> {
    pub(crate) to: Destination,
    pub(crate) expect: Expect,
    pub(crate) payload: Vec<u8>,
    /// What the asker knows it by.
    pub(crate) tag: T,
}

/// What came of one.
#[derive(Debug)]
pub(crate) struct Reported<T = usize> {
    pub(crate) tag: T,
    /// Every answer to a broadcast is reported, then its end.
    pub(crate) result: Result<Outcome, RequestError>,
}

impl Window {
    /// Asks all of `questions`, in order for each link, and reports what comes of them.
    pub(crate) fn run<T: Clone>(
        self,
        network: &mut dyn Network,
        questions: Vec<Question<T>>,
        report: &mut dyn FnMut(Reported<T>),
    ) -> Result<(), NetworkError> {
        let mut lanes: BTreeMap<Option<GatewayIndex>, Lane<T>> = BTreeMap::new();
        for question in questions {
            lanes.entry(first_link(&question.to.route)).or_default().waiting.push_back(question);
        }
        let mut open: BTreeMap<Ticket, (Option<GatewayIndex>, T)> = BTreeMap::new();
        loop {
            for (link, lane) in &mut lanes {
                while lane.open < self.a_link.max(1)
                    && open.len() < self.in_all.max(1)
                    && let Some(question) = lane.waiting.pop_front()
                {
                    match network.submit(question.to.clone(), question.expect, &question.payload) {
                        Ok(ticket) => {
                            lane.open += 1;
                            open.insert(ticket, (*link, question.tag));
                        }
                        Err(error) if is_passing(&error) && !open.is_empty() => {
                            lane.waiting.push_front(question);
                            break;
                        }
                        Err(error) => report(Reported { tag: question.tag, result: Err(error) }),
                    }
                }
            }
            if open.is_empty() {
                return Ok(());
            }
            let Completion { ticket, last, outcome } = network.wait()?;
            // a ticket of somebody before us is none of ours
            let Some((link, tag)) = open.get(&ticket).cloned() else { continue };
            if last {
                open.remove(&ticket);
                if let Some(lane) = lanes.get_mut(&link) {
                    lane.open -= 1;
                }
            }
            report(Reported { tag, result: Ok(outcome) });
        }
    }
}

/// Questions that leave by one link.
struct Lane<T> {
    waiting: VecDeque<Question<T>>,
    open: usize,
}

impl<T> Default for Lane<T> {
    fn default() -> Self {
        Self { waiting: VecDeque::new(), open: 0 }
    }
}

/// Whether it is gone when open questions end.
fn is_passing(error: &RequestError) -> bool {
    let full = [DropCause::HoldFull, DropCause::PoolFull];
    matches!(error, RequestError::Busy { .. })
        || matches!(error, RequestError::Send(SendError::Refused(cause)) if full.contains(cause))
}

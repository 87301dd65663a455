//! The spin port: keeps the serving task busy, as a slow user function would, to show what that delays and what it does not.
//!
//! - **Walk:** a sequenced request → *here*, for as long as it asks → its reply.
//! - **Invariants:** it waits by counting, not by a clock, so that it needs none; bounded by [`SPIN_MAX`].
//! - **Context:** the serving task, without the node. **Clauses:** `[APP-10]`, `[APP-11]`.

use fixed_math::time::LocalTicks;
use osap_protocol::DropCause;
use osap_protocol::transport::{SequencedHeader, SequencedKind};
use osap_runtime::{Delivery, Mailbox};

/// Most turns one request may ask for, `[APP-11]`: between 50 and 300 ms on the processors there are.
pub const SPIN_MAX: u32 = 10_000_000;

/// Bytes of a request and of its reply.
const LEN: usize = 4;

/// The only reason for a refusal, `[APP-11]`.
const REFUSED_RANGE: u8 = 1;

/// Answers one packet after it has counted.
pub fn accept(node: &mut impl Mailbox, delivery: Delivery, now: LocalTicks) {
    match delivery.sequenced {
        Some(SequencedHeader { kind: SequencedKind::Request, .. }) => {}
        Some(_) => return node.release(delivery, Some(DropCause::ReplyUnmatched), now),
        None => return node.release(delivery, Some(DropCause::PortRefused), now),
    }
    let turns = node.with_payload(&delivery, |payload| payload.as_array::<LEN>().map(|it| u32::from_le_bytes(*it)));
    let Some(turns) = turns.filter(|turns| *turns <= SPIN_MAX) else {
        let _counted = node.refuse(delivery, &[&[REFUSED_RANGE]], now);
        return;
    };
    for turn in 0..turns {
        core::hint::black_box(turn);
    }
    let _counted = node.reply(delivery, &[&turns.to_le_bytes()], now);
}

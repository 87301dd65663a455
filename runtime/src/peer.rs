//! What a node knows of the clock at the other end of one link, and what it has asked and been asked.
//!
//! - **Walk:** the egress makes [`Peer::request`]s and the replies [`Peer::owe`]d; the ingress gives what came to [`Peer::hear`].
//! - **Invariants:** one request is open at a time; what a neighbour said is believed only with all its checks passed.
//! - **Context:** the node's. **Clauses:** `[TIM-01]`, `[TIM-05]`, `[TIM-06]`, `[TIM-08]`, `[TIM-13]`, `[TIM-17]`.

use crate::gateway::Stamps;
use fixed_math::clock::{Estimate, Exchange, Fault, LinkClock, LinkTraits, PeerEstimate, ewma};
use fixed_math::time::{LocalTicks, Rate, Span};
use osap_protocol::DropCause;
use osap_protocol::discovery::{TimeLink, UniqueId};
use osap_protocol::time::{NO_BOUND, Root, TimeReply, TimeRequest, UnixOffset, unwrap_stamp};

/// Requests to a neighbour that has just appeared, `[TIM-05]`.
pub const BURST: u8 = 200;
/// Between them, µs.
pub const BURST_INTERVAL_US: u64 = 5_000;
/// How much less often neighbours are asked that are no source, `[TIM-05]`.
pub const SLOW_FACTOR: u32 = 8;
/// Absurd replies in a row after which what was known is forgotten, `[TIM-06]`.
pub const OUTLIERS_MAX: u8 = 16;
/// A request that waits for its answer.
#[derive(Clone, Copy, Debug)]
struct Open {
    sequence: u8,
    made: LocalTicks,
}

/// A reply that waits for its gateway.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Owed {
    pub(crate) sequence: u8,
    pub(crate) asked_slot: u32,
    pub(crate) heard: LocalTicks,
}

/// What a neighbour said last, once it was believed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Said {
    pub(crate) tier: u8,
    pub(crate) root: Root,
    pub(crate) age_us: u32,
    pub(crate) is_yours: bool,
    pub(crate) is_settled: bool,
    pub(crate) unix: Option<UnixOffset>,
    pub(crate) at: LocalTicks,
}

impl Said {
    /// Time since its root was heard, µs.
    pub(crate) fn age_us(&self, now: LocalTicks) -> u64 {
        u64::from(self.age_us) + now.since(self.at).as_us_ceil()
    }
}

/// The clock at the other end of a link.
#[derive(Debug)]
pub(crate) struct Peer {
    pub(crate) link: LinkClock,
    pub(crate) asymmetry_steps: i32,
    /// Whose counter is estimated: a device and its boot.
    of: Option<(UniqueId, u32)>,
    /// The rate of a device's counter as a former run knew it.
    pub(crate) kept: Option<(UniqueId, Rate)>,
    /// When there is something to be sent, a reply or a request; the last instant there is where there is nothing. All that a packet's way
    /// has to look at.
    due_at: LocalTicks,
    /// When to ask next.
    request_at: Option<LocalTicks>,
    open: Option<Open>,
    owed: Option<Owed>,
    pub(crate) said: Option<Said>,
    /// System time as of what was said last, composed once: what takes thousands of cycles on a device is not done for each look.
    estimate: Option<Estimate>,
    sequence: u8,
    burst: u8,
    outliers: u8,
    /// One of the two counters runs on no crystal: no rate of crystals explained what was heard.
    is_rc: bool,
    /// Its system time less ours at the last exchange, and its average.
    pub(crate) offset_steps: i64,
    pub(crate) filtered_steps: Option<i64>,
    pub(crate) unanswered: u32,
    pub(crate) refused: u32,
}

impl Peer {
    pub(crate) const fn new(stamps: Stamps) -> Self {
        Self {
            link: LinkClock::new(traits(stamps, Span::ZERO, 0, LinkTraits::CRYSTAL)),
            asymmetry_steps: 0,
            of: None,
            kept: None,
            due_at: LocalTicks::MAX,
            request_at: None,
            open: None,
            owed: None,
            said: None,
            estimate: None,
            sequence: 0,
            burst: 0,
            outliers: 0,
            is_rc: false,
            offset_steps: 0,
            filtered_steps: None,
            unanswered: 0,
            refused: 0,
        }
    }

    /// A neighbour has appeared: it is asked often at first. One that only was away for a while is still known.
    pub(crate) fn appeared(&mut self, who: UniqueId, boot_epoch: u32, now: LocalTicks) {
        if self.of != Some((who, boot_epoch)) {
            self.keep_rate();
            self.of = Some((who, boot_epoch));
            self.is_rc = false;
            self.forget();
        }
        self.burst = BURST;
        self.ask_at(Some(now));
    }

    /// When there is something to be sent.
    #[inline]
    pub(crate) const fn due_at(&self) -> LocalTicks {
        self.due_at
    }

    fn ask_at(&mut self, at: Option<LocalTicks>) {
        self.request_at = at;
        self.due_at = if self.owed.is_some() { LocalTicks::ZERO } else { at.unwrap_or(LocalTicks::MAX) };
    }

    /// A request has come: its answer is to be sent as soon as the gateway is free.
    pub(crate) fn owe(&mut self, owed: Owed) {
        self.owed = Some(owed);
        self.due_at = LocalTicks::ZERO;
    }

    /// The answer that is owed, to be sent now.
    pub(crate) fn take_owed(&mut self) -> Option<Owed> {
        let owed = self.owed.take();
        self.ask_at(self.request_at);
        owed
    }

    /// It is asked no more; what is known of it stays, in case it comes back.
    pub(crate) fn lost(&mut self) {
        self.owed = None;
        self.ask_at(None);
        self.open = None;
        self.said = None;
        self.filtered_steps = None;
    }

    /// Begins the estimate anew.
    pub(crate) fn forget(&mut self) {
        let hot = self.kept.filter(|(of, _)| self.of.is_some_and(|(id, _)| id == *of)).map(|(_, rate)| rate);
        self.link.restart(hot);
        self.said = None;
        self.filtered_steps = None;
        self.outliers = 0;
    }

    /// Sets how much longer the way there is than the way back, and begins anew with it, `[TIM-13]`.
    pub(crate) fn calibrate(&mut self, asymmetry_steps: i32, stamps: Stamps) {
        self.asymmetry_steps = asymmetry_steps;
        self.link = LinkClock::new(traits(stamps, Span::ZERO, asymmetry_steps, self.oscillators()));
        self.forget();
    }

    /// The next request, made at `now`; plans the one after it.
    pub(crate) fn request(&mut self, now: LocalTicks, interval_us: u64, is_near: bool, dither: u32) -> TimeRequest {
        self.unanswered = self.unanswered.saturating_add(u32::from(self.open.is_some()));
        self.sequence = self.sequence.wrapping_add(1);
        self.open = Some(Open { sequence: self.sequence, made: now });
        let interval_us = match (self.burst, is_near) {
            (1.., _) => BURST_INTERVAL_US.min(interval_us),
            (0, true) => interval_us,
            (0, false) => interval_us * u64::from(SLOW_FACTOR),
        };
        self.burst = self.burst.saturating_sub(1);
        // 7/8 to 9/8 of it
        let part = (interval_us >> 2).saturating_mul(u64::from(dither >> 16)) >> 16;
        self.ask_at(Some(now + Span::from_us(interval_us - (interval_us >> 3) + part)));
        TimeRequest { sequence: self.sequence }
    }

    /// Asks often again, from now on: a root was lost, or another time was taken over.
    pub(crate) fn hurry(&mut self, now: LocalTicks) {
        if self.request_at.is_some() {
            self.burst = BURST;
            self.ask_at(Some(now));
        }
    }

    /// Takes a reply whose first byte came at `received`, `[TIM-06]`, `[TIM-08]`.
    pub(crate) fn hear(
        &mut self,
        reply: &TimeReply,
        received: LocalTicks,
        stamps: Stamps,
        me: UniqueId,
    ) -> Result<(), DropCause> {
        let open = self.open.filter(|open| open.sequence == reply.sequence).ok_or(DropCause::TimeUnasked)?;
        let sent = unwrap_stamp(reply.asked_slot, received);
        // a stamp is a reading of the same counter that `made` is, if not of the same tick
        if sent + stamps.tick < open.made {
            return Err(DropCause::TimeUnasked);
        }
        self.open = None;
        self.check_tier(reply, me)?;
        let peer_tick = Span::from_steps(u64::from(reply.tick_steps));
        if self.link.exchanges() == 0 {
            self.link = LinkClock::new(traits(stamps, peer_tick, self.asymmetry_steps, self.oscillators()));
            self.forget();
        }
        let exchange = Exchange { sent, heard: reply.heard, answered: reply.answered(), received };
        match self.link.observe(&exchange) {
            Ok(()) => {}
            Err(Fault::Absurd) => {
                self.outlier(stamps, peer_tick);
                return Err(DropCause::TimeAbsurd);
            }
            Err(_) => return Err(DropCause::TimeOrder),
        }
        let span = |steps: u32| Span::from_steps(u64::from(steps));
        let estimate = PeerEstimate {
            at: reply.heard,
            system: reply.system,
            rate: reply.rate,
            error: span(reply.error_steps),
            bound: if reply.bound_steps == NO_BOUND { Span::MAX } else { span(reply.bound_steps) },
            drift: Rate::saturated(i64::from(reply.drift_bits)),
        };
        self.estimate = Some(self.link.compose(&estimate, received));
        self.said = Some(Said {
            tier: reply.tier,
            root: reply.root,
            age_us: reply.age_us,
            is_yours: reply.is_yours,
            is_settled: reply.is_settled,
            unix: reply.unix,
            at: received,
        });
        Ok(())
    }

    /// Whether the rate is known well and has moved by `ppb` since it was kept.
    pub(crate) fn rate_moved(&self, ppb: u32) -> bool {
        let is_known = self.link.exchanges() > u32::from(BURST);
        let kept = self.kept.filter(|(of, _)| self.of.is_some_and(|(id, _)| id == *of));
        is_known && kept.is_none_or(|(_, rate)| rate.ppb().abs_diff(self.link.rate().ppb()) >= ppb)
    }

    /// Keeps the rate for when this neighbour, or this node, begins anew.
    pub(crate) fn keep_rate(&mut self) {
        if let Some((of, _)) = self.of.filter(|_| self.link.exchanges() > u32::from(BURST)) {
            self.kept = Some((of, self.link.rate()));
        }
    }

    /// One more absurd reply; after too many in a row what was known is forgotten.
    pub(crate) fn outlier(&mut self, stamps: Stamps, peer_tick: Span) {
        self.outliers += 1;
        if self.outliers >= OUTLIERS_MAX {
            self.kept = None;
            self.is_rc = true;
            self.link = LinkClock::new(traits(stamps, peer_tick, self.asymmetry_steps, self.oscillators()));
            self.forget();
        }
    }

    /// What is promised of the two counters' rates.
    const fn oscillators(&self) -> LinkTraits {
        if self.is_rc { LinkTraits::RC } else { LinkTraits::CRYSTAL }
    }

    /// Only a root is its own root, and it has heard itself just now.
    fn check_tier(&self, reply: &TimeReply, me: UniqueId) -> Result<(), DropCause> {
        let own = self.of.is_some_and(|(id, _)| id == reply.root.unique_id);
        let contradicts = match reply.tier {
            u8::MAX => false,
            0 => !own || reply.root.unique_id == me || reply.age_us > 0,
            _ => own,
        };
        if contradicts { Err(DropCause::TimeTier) } else { Ok(()) }
    }

    /// Takes the offset of the last exchange into the average, `[TIM-11]`.
    pub(crate) fn average(&mut self, offset_steps: i64, weight_q16: i32) {
        // the first after a restart agrees with nothing yet
        if self.link.exchanges() > 1 {
            self.outliers = 0;
        }
        self.offset_steps = offset_steps;
        self.filtered_steps = Some(self.filtered_steps.map_or(offset_steps, |was| ewma(was, offset_steps, weight_q16)));
    }

    /// System time as this neighbour has it, as of its last reply; `None` where nothing is known of it.
    pub(crate) fn estimate(&self) -> Option<Estimate> {
        self.said.and(self.estimate)
    }

    /// Answer to query 13, `[TIM-12]`.
    pub(crate) fn info(&self, now: LocalTicks) -> TimeLink {
        let cut = |span: Span| u32::try_from(span.steps()).unwrap_or(u32::MAX);
        let (tier, root) = self.said.map_or((u8::MAX, UniqueId::default()), |said| (said.tier, said.root.unique_id));
        TimeLink {
            tier,
            root,
            exchanges: self.link.exchanges(),
            unanswered: self.unanswered,
            refused: self.refused,
            offset_steps: self.offset_steps,
            rate_ppb: self.link.rate().ppb(),
            round_trip_steps: cut(self.link.round_trip()),
            round_trip_min_steps: cut(self.link.round_trip_min()),
            error_steps: cut(self.link.error_at(now)),
            bound_steps: cut(self.link.bound_at(now)),
            asymmetry_steps: self.asymmetry_steps,
        }
    }

    /// Half the least round trip, once there was one: how long a frame is on its way where nothing else is known, `[TIM-16]`.
    pub(crate) fn one_way(&self) -> Option<Span> {
        self.link.is_started().then(|| Span::from_steps(self.link.round_trip_min().steps() / 2))
    }
}

const fn traits(stamps: Stamps, peer_tick: Span, asymmetry_steps: i32, base: LinkTraits) -> LinkTraits {
    let tick = if peer_tick.steps() > stamps.tick.steps() { peer_tick } else { stamps.tick };
    LinkTraits { wire: stamps.wire, tick, late: stamps.late, asymmetry_steps, ..base }
}

//! What a node knows of the clock at the other end of one link, and what it has asked and been asked.
//!
//! - **Walk:** the egress makes [`Peer::request`]s and the replies [`Peer::owe`]d; the ingress gives what came to [`Peer::hear`].
//! - **Invariants:** one request is open at a time; what a neighbour said is believed only with all its checks passed.
//! - **Context:** the node's. **Clauses:** `[TIM-01]`, `[TIM-05]`, `[TIM-06]`, `[TIM-08]`, `[TIM-13]`, `[TIM-17]`.

use crate::clock::AGE_MARGIN_US;
use crate::gateway::Stamps;
use fixed_math::clock::{Estimate, Exchange, Fault, LinkClock, LinkTraits, PeerEstimate, ewma};
use fixed_math::time::{LocalTicks, Rate, Span};

use osap_protocol::discovery::{TimeLink, UniqueId};
use osap_protocol::time::{ANYBODY, NO_BOUND, Root, TimeReply, TimeRequest, UnixOffset, unwrap_stamp};
use osap_protocol::{BusDrop, DropCause};

/// Requests to a neighbour that has just appeared, `[TIM-05]`.
pub const BURST: u8 = 200;
/// Between them, µs.
pub const BURST_INTERVAL_US: u64 = 5_000;
/// Requests in a row without an answer that end a burst: a neighbour that takes longer than the pause between them would never be heard.
pub const BURST_MISSES_MAX: u8 = 8;
/// How much less often neighbours are asked that are no source, `[TIM-05]`.
pub const SLOW_FACTOR: u32 = 8;
/// Absurd replies in a row after which what was known is forgotten, `[TIM-06]`.
pub const OUTLIERS_MAX: u8 = 16;
/// How much less often a partner on a bus is asked, `[TIM-18]`: all of them share its wire.
pub const BUS_FACTOR: u32 = 8;
/// From the first search for a partner to the next, µs; twice as long each time that none is found.
pub const SEARCH_US: u64 = 1_000_000;
/// So often it becomes twice as long.
const SEARCHES_MAX: u8 = 6;
/// Members of a bus beyond which nobody asks: with so many, requests and replies take a tenth of a wire of 1 Mbit/s.
pub const BUS_MEMBERS_MAX: u32 = 32;
/// Least time from one request to the next for each other member, µs.
const BUS_SHARE_US: u64 = 10_000;
/// Requests to a partner between two searches for a nearer one.
pub const SEARCH_EVERY: u8 = 32;
/// Requests in a row without an answer after which a partner is none.
pub const MISSES_MAX: u8 = 8;
/// Requests to a new partner in quick succession, and the time between them, µs.
const BUS_BURST: u8 = 16;
const BUS_BURST_INTERVAL_US: u64 = 50_000;

/// A request that waits for its answer.
#[derive(Clone, Copy, Debug)]
struct Open {
    sequence: u8,
    made: LocalTicks,
}

/// Whom a node on a bus asks.
#[derive(Clone, Copy, Debug, Default)]
struct Partner {
    drop: Option<BusDrop>,
    misses: u8,
    to_search: u8,
    /// The lowest id below its own that has announced itself: who is asked before all are.
    candidate: Option<(UniqueId, BusDrop)>,
    /// The drops that have announced themselves, one bit each.
    members: [u32; 8],
    /// Searches in a row without a partner.
    searches: u8,
    /// The last search; more than one may answer.
    search: Option<Open>,
    /// The best of its answers.
    best: Option<Offer>,
}

impl Partner {
    /// Members of the bus that have announced themselves.
    fn count(&self) -> u32 {
        self.members.iter().map(|word| word.count_ones()).sum()
    }

    /// No partner, on the same bus.
    fn alone(&self) -> Self {
        Self { members: self.members, search: self.search, ..Self::default() }
    }
}

/// A time that is offered on a bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Offer {
    pub(crate) root: Root,
    pub(crate) tier: u8,
    /// System time less this node's counter.
    pub(crate) ahead_steps: i64,
}

impl Offer {
    /// `[TIM-07]`, and of one root the nearer.
    fn goes_before(&self, other: &Self) -> bool {
        if self.root.unique_id == other.root.unique_id {
            return self.tier < other.tier;
        }
        if self.root.priority != other.root.priority {
            return self.root.priority < other.root.priority;
        }
        let older = self.ahead_steps.saturating_sub(other.ahead_steps);
        let is_clear = older.unsigned_abs() > Span::from_us(AGE_MARGIN_US).steps();
        if is_clear { older > 0 } else { self.root.unique_id < other.root.unique_id }
    }
}

/// Replies that wait for their gateway at once; what else is asked meanwhile is asked again.
const OWED_MAX: usize = 3;

/// A reply that waits for its gateway.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Owed {
    pub(crate) sequence: u8,
    pub(crate) asked_slot: u32,
    pub(crate) heard: LocalTicks,
    /// On a bus, whose request it is.
    pub(crate) by: Option<BusDrop>,
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
    /// On a bus more than one may ask before it is free.
    owed: heapless::Deque<Owed, OWED_MAX>,
    partner: Option<Partner>,
    pub(crate) said: Option<Said>,
    /// System time as of what was said last, composed once: what takes thousands of cycles on a device is not done for each look.
    estimate: Option<Estimate>,
    sequence: u8,
    burst: u8,
    /// Requests in a row without an answer.
    missed: u8,
    outliers: u8,
    /// Replies in a row whose counters agree, but not the system time they tell.
    strange: u8,
    /// How many of the two counters run on no crystal: their nodes say so, or no rate of crystals explained what was heard.
    rc_ends: u8,
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
            owed: heapless::Deque::new(),
            partner: None,
            said: None,
            estimate: None,
            sequence: 0,
            burst: 0,
            missed: 0,
            outliers: 0,
            strange: 0,
            rc_ends: 0,
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
            self.rc_ends = 0;
            self.forget();
        }
        self.burst = BURST;
        self.ask_at(Some(now));
    }

    /// A gateway on a bus has opened: a partner is looked for.
    pub(crate) fn on_bus(&mut self, now: LocalTicks, dither: u32) {
        self.of = None;
        self.forget();
        self.partner = Some(Partner::default());
        // who opens with all others lets them announce themselves first, and does not ask when they do
        let part = (SEARCH_US >> 1).saturating_mul(u64::from(dither >> 16)) >> 16;
        self.ask_at(Some(now + Span::from_us((SEARCH_US >> 2) + part)));
    }

    /// Somebody has announced himself on the bus.
    pub(crate) fn heard_on_bus(&mut self, drop: BusDrop, id: UniqueId, me: UniqueId) {
        let Some(partner) = &mut self.partner else { return };
        if let Some(word) = partner.members.get_mut(usize::from(drop.0 >> 5)) {
            *word |= 1 << (drop.0 & 31);
        }
        if partner.drop.is_none() && id < me && partner.candidate.is_none_or(|(lowest, _)| id < lowest) {
            partner.candidate = Some((id, drop));
        }
        if partner.count() > BUS_MEMBERS_MAX {
            self.ask_at(None);
        }
    }

    /// Whether the time of whoever is at `by` on a bus is this node's source, if this peer is one.
    pub(crate) fn is_partner(&self, by: Option<BusDrop>) -> bool {
        self.partner.is_none_or(|partner| partner.drop == by)
    }

    /// Takes another drop of the bus as partner, if nobody has offered a better time in answer to the same question.
    pub(crate) fn partner_with(&mut self, drop: BusDrop, offer: Offer, now: LocalTicks) {
        let Some(partner) = &mut self.partner else { return };
        if partner.best.is_some_and(|best| !offer.goes_before(&best)) {
            return;
        }
        *partner = Partner { drop: Some(drop), to_search: SEARCH_EVERY, best: Some(offer), ..partner.alone() };
        self.forget();
        self.burst = BUS_BURST;
        self.open = None;
        self.ask_at(Some(now));
    }

    /// What was heard of a partner says that it cannot be one.
    pub(crate) fn part(&mut self) {
        if let Some(partner) = &mut self.partner {
            *partner = partner.alone();
            self.said = None;
        }
    }

    /// When there is something to be sent.
    #[inline]
    pub(crate) const fn due_at(&self) -> LocalTicks {
        self.due_at
    }

    fn ask_at(&mut self, at: Option<LocalTicks>) {
        self.request_at = at;
        self.due_at = if self.owed.is_empty() { at.unwrap_or(LocalTicks::MAX) } else { LocalTicks::ZERO };
    }

    /// A request has come: its answer is to be sent as soon as the gateway is free. A new one of the same sender replaces the old one.
    pub(crate) fn owe(&mut self, owed: Owed) -> Result<(), DropCause> {
        self.due_at = LocalTicks::ZERO;
        if let Some(same) = self.owed.iter_mut().find(|other| other.by == owed.by) {
            *same = owed;
            return Ok(());
        }
        self.owed.push_back(owed).map_err(|_| DropCause::HoldFull)
    }

    /// The answer that is owed, to be sent now.
    pub(crate) fn take_owed(&mut self) -> Option<Owed> {
        let owed = self.owed.pop_front();
        self.ask_at(self.request_at);
        owed
    }

    /// It is asked no more; what is known of it stays, in case it comes back.
    pub(crate) fn lost(&mut self) {
        self.owed.clear();
        self.partner = None;
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
        (self.outliers, self.strange) = (0, 0);
    }

    /// Sets how much longer the way there is than the way back, and begins anew with it, `[TIM-13]`.
    pub(crate) fn calibrate(&mut self, asymmetry_steps: i32, stamps: Stamps) {
        self.asymmetry_steps = asymmetry_steps;
        self.link = LinkClock::new(traits(stamps, Span::ZERO, asymmetry_steps, self.oscillators()));
        self.forget();
    }

    /// The next request, made at `now` by a node of `tier`, and on a bus whom it is for; plans the one after it.
    pub(crate) fn request(
        &mut self,
        now: LocalTicks,
        interval_us: u64,
        is_near: bool,
        tier: u8,
        dither: u32,
    ) -> (TimeRequest, Option<BusDrop>) {
        let (to, below) = self.whom_to_ask(tier);
        self.sequence = self.sequence.wrapping_add(1);
        let open = Some(Open { sequence: self.sequence, made: now });
        match &mut self.partner {
            Some(partner) if to == Some(BusDrop::BROADCAST) => (partner.search, partner.best) = (open, None),
            _ => {
                self.unanswered = self.unanswered.saturating_add(u32::from(self.open.is_some()));
                self.missed = if self.open.is_some() { self.missed.saturating_add(1) } else { 0 };
                if self.missed >= BURST_MISSES_MAX {
                    self.burst = 0;
                }
                self.open = open;
            }
        }
        let is_bus = to.is_some();
        let alone = self.partner.filter(|partner| partner.drop.is_none());
        let interval_us = match (self.burst, is_near) {
            _ if alone.is_some() => SEARCH_US << alone.map_or(0, |partner| partner.searches),
            (1.., _) if is_bus => BUS_BURST_INTERVAL_US,
            (0, _) if is_bus => interval_us * u64::from(BUS_FACTOR),
            (1.., _) => BURST_INTERVAL_US.min(interval_us),
            (0, true) => interval_us,
            (0, false) => interval_us * u64::from(SLOW_FACTOR),
        };
        let share_us = self.partner.map_or(0, |partner| BUS_SHARE_US * u64::from(partner.count()));
        let interval_us = interval_us.max(share_us);
        self.burst = self.burst.saturating_sub(1);
        // 7/8 to 9/8 of it
        let part = (interval_us >> 2).saturating_mul(u64::from(dither >> 16)) >> 16;
        self.ask_at(Some(now + Span::from_us(interval_us - (interval_us >> 3) + part)));
        (TimeRequest { sequence: self.sequence, below }, to)
    }

    /// On a bus the partner, or all where there is none, or where a nearer one may have come, `[TIM-18]`.
    fn whom_to_ask(&mut self, tier: u8) -> (Option<BusDrop>, u8) {
        let Some(partner) = &mut self.partner else { return (None, ANYBODY) };
        if let Some(drop) = partner.drop {
            let is_missed = self.open.is_some();
            partner.misses = if is_missed { partner.misses.saturating_add(1) } else { 0 };
            if partner.misses < MISSES_MAX {
                partner.to_search = partner.to_search.saturating_sub(1);
                // the tier of its source, which is no nearer than itself
                let nearer = tier.saturating_sub(1);
                if partner.to_search > 0 || nearer == 0 || tier == u8::MAX {
                    return (Some(drop), ANYBODY);
                }
                partner.to_search = SEARCH_EVERY;
                return (Some(BusDrop::BROADCAST), nearer);
            }
            *partner = partner.alone();
            self.said = None;
        }
        if let Some((_, drop)) = partner.candidate.take() {
            return (Some(drop), ANYBODY);
        }
        partner.searches = partner.searches.saturating_add(1).min(SEARCHES_MAX);
        (Some(BusDrop::BROADCAST), ANYBODY)
    }

    /// Asks often again, from now on: a root was lost, or another time was taken over.
    pub(crate) fn hurry(&mut self, now: LocalTicks) {
        if self.request_at.is_some() && self.partner.is_none() {
            self.burst = BURST;
            self.ask_at(Some(now));
        }
    }

    /// Takes a reply whose first byte came at `received`, `[TIM-06]`, `[TIM-08]`; `is_rc`: this node's own counter runs on no crystal.
    pub(crate) fn hear(
        &mut self,
        reply: &TimeReply,
        received: LocalTicks,
        stamps: Stamps,
        me: UniqueId,
        is_rc: bool,
    ) -> Result<(), DropCause> {
        let sent = self.asked(reply, received, stamps)?;
        self.open = None;
        self.check_tier(reply, me)?;
        let peer_tick = Span::from_steps(u64::from(reply.tick_steps));
        let declared = u8::from(is_rc) + u8::from(reply.is_rc);
        if self.link.exchanges() == 0 || declared > self.rc_ends {
            self.rc_ends = self.rc_ends.max(declared);
            self.link = LinkClock::new(traits(stamps, peer_tick, self.asymmetry_steps, self.oscillators()));
            self.forget();
        }
        let exchange = Exchange { sent, heard: reply.heard, answered: reply.answered(), received };
        let contradictions = self.link.contradictions();
        match self.link.observe(&exchange) {
            // what was promised of rates is broken: once by a stamp that was late, again and again by an oscillator that is no crystal
            Ok(()) if self.link.contradictions() != contradictions => {
                self.outliers = self.outliers.saturating_add(OUTLIERS_MAX / 2 - 1);
                self.outlier(stamps, peer_tick);
            }
            // the first after a restart agrees with nothing yet
            Ok(()) if self.link.exchanges() > 1 => self.outliers = self.outliers.saturating_sub(1),
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

    /// When the request left that a reply answers; a fault where there is none open.
    pub(crate) fn asked(
        &self,
        reply: &TimeReply,
        received: LocalTicks,
        stamps: Stamps,
    ) -> Result<LocalTicks, DropCause> {
        let asked = [self.open, self.partner.and_then(|partner| partner.search)];
        let open = asked.into_iter().flatten().find(|open| open.sequence == reply.sequence);
        let open = open.ok_or(DropCause::TimeUnasked)?;
        let sent = unwrap_stamp(reply.asked_slot, received);
        // a stamp is a reading of the same counter that `made` is, if not of the same tick
        if sent + stamps.tick < open.made { Err(DropCause::TimeUnasked) } else { Ok(sent) }
    }

    /// Whether a reply from `by` is an offer: this is a bus, and `by` is not the partner there.
    pub(crate) fn is_offer(&self, by: Option<BusDrop>) -> bool {
        !self.is_partner(by)
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
        self.outliers = self.outliers.saturating_add(1);
        if self.outliers >= OUTLIERS_MAX {
            self.kept = None;
            self.rc_ends = self.rc_ends.max(1);
            self.link = LinkClock::new(traits(stamps, peer_tick, self.asymmetry_steps, self.oscillators()));
            self.forget();
        }
    }

    /// One more reply whose system time is too far off; after too many in a row what was known is forgotten.
    pub(crate) fn strange_time(&mut self) {
        self.said = None;
        self.strange += 1;
        if self.strange >= OUTLIERS_MAX {
            self.forget();
        }
    }

    /// What is promised of the two counters' rates.
    const fn oscillators(&self) -> LinkTraits {
        match self.rc_ends {
            0 => LinkTraits::CRYSTAL,
            1 => LinkTraits::RC,
            _ => LinkTraits::RC_BOTH,
        }
    }

    /// Only a root is its own root, and it has heard itself just now.
    fn check_tier(&self, reply: &TimeReply, me: UniqueId) -> Result<(), DropCause> {
        // on a bus nobody has said who he is
        let is_known = self.of.is_some();
        let own = self.of.is_some_and(|(id, _)| id == reply.root.unique_id);
        let contradicts = match reply.tier {
            u8::MAX => false,
            0 => (is_known && !own) || reply.root.unique_id == me || reply.age_us > 0,
            _ => own,
        };
        if contradicts { Err(DropCause::TimeTier) } else { Ok(()) }
    }

    /// Takes the offset of the last exchange into the average, `[TIM-11]`.
    pub(crate) fn average(&mut self, offset_steps: i64, weight_q16: i32) {
        self.strange = 0;
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

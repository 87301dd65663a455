//! The node's clock: which root it follows, what it makes of its neighbours' answers, and the map from its counter to system time.
//!
//! - **Walk:** an accepted time reply → `Clock::follow` → the map; `Clock::reply` tells neighbours; queries 9, 10, 12.
//! - **Invariants:** the counter is never disciplined. What was settled and is live is never stepped. The bound counts what is
//!   not slewed yet. Settings are within their ranges, whatever is asked.
//! - **Context:** the node's; a few products and divisions of 64 bits an accepted reply, at most 200 a second and link.
//! - **Clauses:** `[TIM-07]` to `[TIM-11]`, `[TIM-14]`, `[DSC-02]`, `[DSC-07]`.

mod told;

use crate::gateway::Gateway;
use crate::peer::Offer;
use fixed_math::clock::{Diffusion, Estimate, Follow, Gains, Neighbour, Oldest, Servo, SlewedMap, TimeLine};
use fixed_math::time::{LocalTicks, NetTime, Rate, Span};
use osap_protocol::GatewayIndex;
use osap_protocol::discovery::{Refusal, ServoKind, TIER_FREE_RUNNING, TimeSettings, UniqueId};
use osap_protocol::time::{NO_BOUND, PRIORITY_DEVICE, PRIORITY_NEVER, Root, TIER_MAX, TimeReply, UnixOffset};

/// Settings of a new node: the thesis's 50 ms between exchanges, a quarter of each new offset into the average.
pub const DEFAULT_SETTINGS: TimeSettings = TimeSettings {
    interval_us: 50_000,
    filter_q16: 16_384,
    proportional_q16: 6_554,
    integral_q16: 655,
    skew_limit_ppb: 500_000,
    gate_steps: 256 * 10_000,
    servo: ServoKind::Estimator,
    priority: PRIORITY_DEVICE,
};

/// Age of news of a root after which they are none, µs, `[TIM-08]`; eight intervals where those are longer.
pub const AGE_MAX_US: u64 = 3_000_000;
/// How much older a root's time must be to go before another, µs, `[TIM-07]`.
pub const AGE_MARGIN_US: u64 = 1_000;
/// What is further off may be set anew where nothing is live, µs, `[TIM-10]`.
pub const STEP_MIN_US: u64 = 1_000;
/// How long a node is a root before its programs may rely on its time, µs: others are heard by then.
pub const ROOT_SETTLE_US: u64 = 250_000;
/// Exchanges with a source after which a node is settled.
pub const SETTLE_EXCHANGES: u32 = 16;
/// Most neighbours that are looked at together.
const NEIGHBOURS_MAX: usize = 8;
/// Offset by which a clock is older that is adopted, `[TIM-11]`.
const ADOPT: Span = Span::from_us(1_000);

/// System time, and how good it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SystemTime {
    /// The time.
    pub at: NetTime,
    /// Its greatest possible error; `None` where none can be given.
    pub bound: Option<Span>,
    /// Programs may rely on it.
    pub is_settled: bool,
}

/// The servo in use.
#[derive(Debug)]
enum Steering {
    Estimator(Follow),
    Diffusion(Diffusion),
    Oldest(Oldest),
}

impl Steering {
    fn of(kind: ServoKind) -> Self {
        match kind {
            ServoKind::Estimator => Self::Estimator(Follow),
            ServoKind::Diffusion => Self::Diffusion(Diffusion::default()),
            ServoKind::Oldest => Self::Oldest(Oldest::default()),
        }
    }

    fn servo(&mut self) -> &mut dyn Servo {
        match self {
            Self::Estimator(servo) => servo,
            Self::Diffusion(servo) => servo,
            Self::Oldest(servo) => servo,
        }
    }
}

/// What changed with a call of [`Clock::follow`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Changes {
    /// Another root.
    pub(crate) root: bool,
    /// Time was set anew, by so much.
    pub(crate) stepped: Option<i64>,
    /// The last root was lost.
    pub(crate) lost: bool,
}

/// A node's clock.
#[derive(Debug)]
#[expect(clippy::struct_excessive_bools, reason = "four facts that go their own ways")]
pub struct Clock {
    settings: TimeSettings,
    me: UniqueId,
    steering: Steering,
    map: SlewedMap,
    /// Time as it should be, which is what neighbours are told.
    estimate: Estimate,
    tier: u8,
    root: Root,
    sources: u64,
    /// Age of the news of the root, µs, and when that was.
    news: (u32, LocalTicks),
    /// Since when this node is root, or follows one.
    since: LocalTicks,
    unix: Option<UnixOffset>,
    unix_from: Option<GatewayIndex>,
    is_settled: bool,
    is_live: bool,
    is_rc: bool,
    steps: u16,
    root_changes: u16,
    dither: u32,
    /// When there is something to do though nothing comes; the last instant there is where there is nothing.
    due_at: LocalTicks,
    /// Settings or calibrations were changed and nobody has kept them yet.
    pub(crate) is_changed: bool,
    /// When rates were last kept.
    kept_at: Option<LocalTicks>,
}

impl Clock {
    /// The root of its own time, which is its counter's.
    #[must_use]
    pub fn new(me: UniqueId) -> Self {
        let line = TimeLine { at: LocalTicks::ZERO, system: NetTime::ZERO, rate: Rate::ZERO };
        let seed = me.0.iter().fold(0x811c_9dc5_u32, |hash, byte| (hash ^ u32::from(*byte)).wrapping_mul(0x0100_0193));
        Self {
            settings: DEFAULT_SETTINGS,
            me,
            steering: Steering::of(DEFAULT_SETTINGS.servo),
            map: SlewedMap::new(line),
            estimate: own(line),
            tier: 0,
            root: Root { priority: DEFAULT_SETTINGS.priority, unique_id: me },
            sources: 0,
            news: (0, LocalTicks::ZERO),
            since: LocalTicks::ZERO,
            unix: None,
            unix_from: None,
            is_settled: false,
            is_live: false,
            is_rc: false,
            steps: 0,
            root_changes: 0,
            dither: seed,
            due_at: LocalTicks::from_us(ROOT_SETTLE_US),
            is_changed: false,
            kept_at: None,
        }
    }

    /// Its settings.
    #[must_use]
    pub const fn settings(&self) -> TimeSettings {
        self.settings
    }

    /// Takes new settings.
    ///
    /// # Errors
    /// [`Refusal::Range`] where one is outside its range; nothing is changed then.
    pub fn set(&mut self, settings: TimeSettings) -> Result<(), Refusal> {
        if !settings.in_range() {
            return Err(Refusal::Range);
        }
        if settings.servo != self.settings.servo {
            self.steering = Steering::of(settings.servo);
        }
        self.is_changed |= settings != self.settings;
        self.due_at = LocalTicks::ZERO;
        self.settings = settings;
        if self.tier == 0 {
            self.root.priority = settings.priority;
            if settings.priority == PRIORITY_NEVER {
                self.tier = TIER_FREE_RUNNING;
                self.is_settled = false;
            }
        } else if self.tier == TIER_FREE_RUNNING && settings.priority != PRIORITY_NEVER {
            self.tier = 0;
            self.root = Root { priority: settings.priority, unique_id: self.me };
        }
        Ok(())
    }

    /// System time at `local`, its bound as of then.
    #[must_use]
    pub fn system_time(&self, local: LocalTicks) -> SystemTime {
        let at = self.map.system_at(local);
        SystemTime { at, bound: self.bound_of(at, local), is_settled: self.is_settled }
    }

    /// The map from the counter to system time.
    #[must_use]
    pub const fn map(&self) -> &SlewedMap {
        &self.map
    }

    /// Programs may rely on system time.
    #[must_use]
    pub const fn is_settled(&self) -> bool {
        self.is_settled
    }

    /// Steps to the root.
    #[must_use]
    pub const fn tier(&self) -> u8 {
        self.tier
    }

    /// Whose time it is, itself where it follows nobody.
    #[must_use]
    pub const fn root(&self) -> Root {
        self.root
    }

    /// Says whether something runs by system time now, so that it may not be stepped, `[TIM-10]`.
    pub const fn set_live(&mut self, is_live: bool) {
        self.is_live = is_live;
    }

    /// Says that the node's counter runs on an RC oscillator and not on a crystal, before any neighbour is asked, `[TIM-09]`.
    pub const fn set_rc(&mut self, is_rc: bool) {
        self.is_rc = is_rc;
    }

    /// Whether the counter runs on no crystal.
    pub(crate) const fn is_rc(&self) -> bool {
        self.is_rc
    }

    /// Offers UNIX time, as a host knows it at `now`, µs since 1970, `[TIM-14]`.
    pub fn offer_unix(&mut self, unix_us: i64, now: LocalTicks) {
        let system_us = self.map.system_at(now).as_us().cast_signed();
        self.unix = Some(UnixOffset { offset_us: unix_us.saturating_sub(system_us), hops: 0 });
        self.unix_from = None;
    }

    /// UNIX time less system time, µs, where a host offered it.
    #[must_use]
    pub fn unix_offset_us(&self) -> Option<i64> {
        self.unix.map(|unix| unix.offset_us)
    }

    /// The greatest possible error at `local`, `[TIM-09]`; `None` before it is settled, as what is assumed of a neighbour's oscillator may
    /// still turn out wrong.
    #[must_use]
    pub fn bound_at(&self, local: LocalTicks) -> Option<Span> {
        self.bound_of(self.map.system_at(local), local)
    }

    /// That of `system`, which is what the map makes of `local`.
    fn bound_of(&self, system: NetTime, local: LocalTicks) -> Option<Span> {
        let bound = self.estimate_bound_at(local)?;
        given(bound + Span::from_steps(system.steps_after(self.estimate.line.system_at(local)).unsigned_abs()))
    }

    /// That of what it is slewed to.
    pub(super) fn estimate_bound_at(&self, local: LocalTicks) -> Option<Span> {
        let has_none = self.tier == TIER_FREE_RUNNING || !self.is_settled;
        given(self.estimate.bound_at(local)).filter(|_| !has_none)
    }

    /// A number that is another one each time.
    pub(crate) fn draw(&mut self) -> u32 {
        // xorshift32, whose state may not be zero
        self.dither ^= self.dither << 13;
        self.dither ^= self.dither >> 17;
        self.dither ^= self.dither << 5;
        self.dither = self.dither.max(1);
        self.dither
    }

    pub(crate) fn interval_us(&self) -> u64 {
        u64::from(self.settings.interval_us)
    }

    /// Age of news of a root after which they are none, µs.
    fn age_max_us(&self) -> u64 {
        AGE_MAX_US.max(8 * self.interval_us())
    }

    /// Whether a gateway's neighbour is asked at the full rate.
    pub(crate) fn is_near_source(&self, gateway: &Gateway) -> bool {
        let tier = gateway.peer.said.map_or(0, |said| said.tier);
        // whoever averages needs all
        self.settings.servo == ServoKind::Oldest || tier < self.tier
    }

    /// When [`Clock::follow`] is to be called though nothing comes.
    #[inline]
    pub(crate) const fn due_at(&self) -> LocalTicks {
        self.due_at
    }

    /// When news grow too old, or a root is settled.
    fn next_due(&self) -> LocalTicks {
        let (age_us, at) = self.news;
        match self.tier {
            0 if !self.is_settled => self.since + Span::from_us(ROOT_SETTLE_US),
            0 | TIER_FREE_RUNNING => LocalTicks::MAX,
            _ => at + Span::from_us(self.age_max_us().saturating_sub(age_us.into())) + Span::from_us(1),
        }
    }

    /// Chooses root and sources and steers the map by them: after each accepted reply, and when [`Clock::next_wake`] has come.
    pub(crate) fn follow(&mut self, gateways: &[Gateway], now: LocalTicks) -> Changes {
        let was = (self.root.unique_id, self.tier);
        let mut changes = Changes::default();
        match self.choose(gateways, now) {
            Choice::Follow { root, tier } => self.follow_root(gateways, root, tier, now, &mut changes),
            // who was heard of lately may be heard of again
            Choice::Nobody if self.has_news(now) => {}
            choice => {
                changes.lost = matches!(choice, Choice::Nobody) && self.follows();
                self.be_root(gateways, now);
            }
        }
        if self.root.unique_id != was.0 || (self.tier == TIER_FREE_RUNNING) != (was.1 == TIER_FREE_RUNNING) {
            self.root_changes = self.root_changes.saturating_add(1);
            changes.root = true;
        }
        self.take_unix(gateways);
        self.due_at = self.next_due();
        changes
    }

    /// The time that a reply offers, where it is better than the node's own, or the same from nearer, `[TIM-18]`; its request was heard
    /// when this node's counter read `heard`.
    pub(crate) fn offered(&self, reply: &TimeReply, heard: LocalTicks) -> Option<Offer> {
        if reply.tier >= TIER_MAX || reply.root.unique_id == self.me || reply.is_yours {
            return None;
        }
        let is_better = if reply.root.unique_id == self.root.unique_id {
            reply.tier + 1 < self.tier
        } else {
            let theirs = Claim { root: reply.root, system: reply.system, tier: reply.tier };
            let mine = Claim { root: self.root, system: self.map.system_at(heard), tier: self.tier };
            self.tier == TIER_FREE_RUNNING || theirs.goes_before(&mine)
        };
        let ahead_steps = reply.system.steps_after(NetTime::from_steps(heard.steps()));
        is_better.then_some(Offer { root: reply.root, tier: reply.tier, ahead_steps })
    }

    const fn follows(&self) -> bool {
        self.tier != 0 && self.tier != TIER_FREE_RUNNING
    }

    /// Whether this node follows a root of which it has heard lately.
    fn has_news(&self, now: LocalTicks) -> bool {
        let (age_us, at) = self.news;
        self.follows() && u64::from(age_us) + now.since(at).as_us_ceil() <= self.age_max_us()
    }

    /// Who is to be followed, and the tier of who is nearest to it, `[TIM-07]`.
    fn choose(&self, gateways: &[Gateway], now: LocalTicks) -> Choice {
        let mut lead: Option<Claim> = None;
        for (gateway, _) in self.candidates(gateways, now) {
            let (Some(said), Some(estimate)) = (gateway.peer.said, gateway.peer.estimate()) else { continue };
            let claim = Claim { root: said.root, system: estimate.line.system_at(now), tier: said.tier };
            lead = Some(match lead {
                Some(other) if other.root.unique_id == claim.root.unique_id => {
                    Claim { tier: other.tier.min(claim.tier), ..other }
                }
                Some(other) if other.goes_before(&claim) => other,
                _ => claim,
            });
        }
        let Some(lead) = lead else { return Choice::Nobody };
        let mine = Root { priority: self.settings.priority, unique_id: self.me };
        let stays = self.settings.priority != PRIORITY_NEVER
            && if self.tier == 0 {
                let mine = Claim { root: mine, system: self.map.system_at(now), tier: 0 };
                !lead.goes_before(&mine)
            } else {
                mine.priority < lead.root.priority
            };
        if stays { Choice::Root } else { Choice::Follow { root: lead.root, tier: lead.tier } }
    }

    /// Gateways whose neighbours may be followed, with their indices, `[TIM-08]`.
    fn candidates<'a>(&self, gateways: &'a [Gateway], now: LocalTicks) -> impl Iterator<Item = (&'a Gateway, u8)> {
        let (me, age_max_us, is_settled) = (self.me, self.age_max_us(), self.is_settled);
        let ends = gateways.iter().zip(0u8..);
        ends.filter(move |(gateway, _)| {
            gateway.peer.said.is_some_and(|said| {
                let has_root = said.tier < TIER_MAX && said.root.unique_id != me;
                // who is settled has a bound, and takes nothing from who has none
                has_root && !said.is_yours && said.age_us(now) <= age_max_us && (said.is_settled || !is_settled)
            })
        })
    }

    fn follow_root(&mut self, gateways: &[Gateway], root: Root, tier: u8, now: LocalTicks, changes: &mut Changes) {
        let is_source = |gateway: &Gateway| {
            gateway.peer.said.is_some_and(|said| said.tier == tier && said.root.unique_id == root.unique_id)
        };
        let mut sources = 0u64;
        let (mut age_us, mut exchanges, mut is_settled) = (u64::MAX, u32::MAX, false);
        for (gateway, index) in self.candidates(gateways, now).filter(|(gateway, _)| is_source(gateway)) {
            let Some(said) = gateway.peer.said else { continue };
            sources |= 1 << index;
            age_us = age_us.min(said.age_us(now));
            exchanges = exchanges.min(gateway.peer.link.exchanges());
            is_settled |= said.is_settled;
        }
        let of_sources = gateways.iter().zip(0u8..).filter(|(_, index)| sources & 1 << index != 0);
        let Some(estimate) = Estimate::mean(of_sources.filter_map(|(gateway, _)| gateway.peer.estimate()), now) else {
            return;
        };
        if self.tier == 0 || self.tier == TIER_FREE_RUNNING || self.root.unique_id != root.unique_id {
            self.since = now;
        }
        self.estimate = estimate;
        self.sources = sources;
        self.tier = tier + 1;
        self.root = root;
        self.news = (cut(age_us), now);
        self.steer(gateways, now, changes);
        self.is_settled |= is_settled && exchanges >= SETTLE_EXCHANGES && given(estimate.bound).is_some();
    }

    /// Brings the map towards the estimate, `[TIM-10]`, `[TIM-11]`.
    fn steer(&mut self, gateways: &[Gateway], now: LocalTicks, changes: &mut Changes) {
        let behind = self.estimate.line.system_at(now).steps_after(self.map.system_at(now));
        let is_far = behind.unsigned_abs() > Span::from_us(STEP_MIN_US).steps();
        let follows = self.settings.servo == ServoKind::Estimator;
        if (!self.is_settled && (follows || is_far)) || (is_far && !self.is_live) {
            self.map.step_to(self.estimate.line);
            self.steering.servo().restart();
            if is_far {
                self.steps = self.steps.saturating_add(1);
                self.is_settled = false;
                self.forget_unix();
                changes.stepped = Some(behind);
            }
            return;
        }
        self.run_servo(gateways, now);
    }

    fn run_servo(&mut self, gateways: &[Gateway], now: LocalTicks) {
        let all = self.settings.servo == ServoKind::Oldest;
        let mut neighbours = heapless::Vec::<Neighbour, NEIGHBOURS_MAX>::new();
        for (gateway, index) in gateways.iter().zip(0u8..) {
            let peer = &gateway.peer;
            let (Some(said), Some(estimate)) = (peer.said, peer.estimate()) else { continue };
            if (all && said.tier < TIER_MAX) || self.sources & 1 << index != 0 {
                let (offset_steps, filtered) = (peer.offset_steps, peer.filtered_steps);
                let filtered_steps = filtered.unwrap_or(offset_steps);
                let _no_more = neighbours.push(Neighbour { tier: said.tier, offset_steps, filtered_steps, estimate });
            }
        }
        let TimeSettings { interval_us, filter_q16, proportional_q16, integral_q16, skew_limit_ppb, .. } =
            self.settings;
        let gains = Gains {
            interval: Span::from_us(interval_us.into()),
            filter_q16,
            proportional_q16,
            integral_q16,
            limit: Rate::from_ppb(skew_limit_ppb),
            adopt_steps: if self.is_live { i64::MAX } else { ADOPT.steps().cast_signed() },
        };
        self.steering.servo().steer(now, &neighbours, &gains, &mut self.map);
    }

    /// Goes on as root from where it is, or as nobody's.
    fn be_root(&mut self, gateways: &[Gateway], now: LocalTicks) {
        let is_root = self.settings.priority != PRIORITY_NEVER;
        if self.tier != 0 && self.tier != TIER_FREE_RUNNING {
            // on at once to where it is slewed, or where nobody steers it there, from where it is
            let line = match self.settings.servo {
                ServoKind::Estimator => self.estimate.line,
                ServoKind::Diffusion | ServoKind::Oldest => self.map.target(),
            };
            let line = TimeLine { at: now, system: line.system_at(now), rate: line.rate };
            if is_root {
                self.estimate = own(line);
            }
            self.since = now;
        }
        self.sources = 0;
        self.tier = if is_root { 0 } else { TIER_FREE_RUNNING };
        self.root = Root { priority: self.settings.priority, unique_id: self.me };
        self.news = (0, now);
        if self.settings.servo == ServoKind::Oldest {
            self.run_servo(gateways, now);
            self.estimate = own(TimeLine { at: now, system: self.map.system_at(now), rate: self.map.rate_at(now) });
        }
        self.is_settled = is_root && (self.is_settled || now.since(self.since) >= Span::from_us(ROOT_SETTLE_US));
    }

    /// Takes UNIX time from where it came from before, or from who is nearer to a host, `[TIM-14]`.
    fn take_unix(&mut self, gateways: &[Gateway]) {
        for (gateway, index) in gateways.iter().zip(0u8..) {
            let Some(said) = gateway.peer.said.filter(|said| said.root.unique_id == self.root.unique_id) else {
                continue;
            };
            let Some(UnixOffset { offset_us, hops }) = said.unix else { continue };
            let from = GatewayIndex::new(index);
            let is_nearer = self.unix.is_none_or(|unix| hops.saturating_add(1) < unix.hops);
            if is_nearer || (self.unix_from == from && from.is_some()) {
                self.unix = Some(UnixOffset { offset_us, hops: hops.saturating_add(1) });
                self.unix_from = from;
            }
        }
    }

    const fn forget_unix(&mut self) {
        self.unix = None;
        self.unix_from = None;
    }

    /// Whether what a neighbour takes for system time is too far off to be believed, `[TIM-06]`: from what this node is slewed to, which may be
    /// far from where it is.
    pub(crate) fn is_absurd(&self, system: NetTime, at: LocalTicks, root: UniqueId) -> bool {
        let gate = u64::from(self.settings.gate_steps.unsigned_abs());
        let off = system.steps_after(self.estimate.line.system_at(at)).unsigned_abs();
        self.is_settled && self.tier != 0 && root == self.root.unique_id && off > gate
    }
}

/// A root's own time: no error and no bound but those of others.
const fn own(line: TimeLine) -> Estimate {
    Estimate { line, error: Span::ZERO, bound: Span::ZERO, drift: Rate::ZERO }
}

/// A bound, unless it is more than a reply can say.
fn given(bound: Span) -> Option<Span> {
    (bound < Span::from_steps(NO_BOUND.into())).then_some(bound)
}

/// What a node is to do.
#[derive(Clone, Copy, Debug)]
enum Choice {
    /// To follow this root, which is nearest by neighbours of this tier.
    Follow { root: Root, tier: u8 },
    /// To be root, though there is another.
    Root,
    /// There is none to be followed.
    Nobody,
}

/// A timescale that may be followed.
#[derive(Clone, Copy, Debug)]
struct Claim {
    root: Root,
    system: NetTime,
    tier: u8,
}

impl Claim {
    /// `[TIM-07]`
    fn goes_before(&self, other: &Self) -> bool {
        if self.root.priority != other.root.priority {
            return self.root.priority < other.root.priority;
        }
        let older = self.system.steps_after(other.system);
        if older.unsigned_abs() > Span::from_us(AGE_MARGIN_US).steps() {
            return older > 0;
        }
        self.root.unique_id < other.root.unique_id
    }
}

fn cut(value: u64) -> u32 {
    u32::try_from(value).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `[DSC-02]`: out of range is refused and changes nothing.
    #[test]
    fn settings_out_of_range_change_nothing() {
        let mut clock = Clock::new(UniqueId([1; 12]));
        for bad in [
            TimeSettings { interval_us: 999, ..DEFAULT_SETTINGS },
            TimeSettings { filter_q16: 0, ..DEFAULT_SETTINGS },
            TimeSettings { skew_limit_ppb: -1, ..DEFAULT_SETTINGS },
            TimeSettings { gate_steps: -1, ..DEFAULT_SETTINGS },
        ] {
            assert_eq!(clock.set(bad), Err(Refusal::Range));
            assert_eq!(clock.settings(), DEFAULT_SETTINGS);
        }
        clock.set(TimeSettings { interval_us: 10_000, ..DEFAULT_SETTINGS }).unwrap();
        assert_eq!(clock.control(&[], LocalTicks::ZERO).interval_us, 10_000);
    }

    /// `[TIM-07]`: priority, then age beyond the margin, then the id; no claim goes before itself.
    #[test]
    fn claims_are_ordered() {
        let claim = |priority, us, id| Claim {
            root: Root { priority, unique_id: UniqueId([id; 12]) },
            system: NetTime::from_us(us),
            tier: 0,
        };
        let order = [claim(1, 0, 9), claim(2, 9_000, 8), claim(2, 5_000, 3), claim(2, 4_000, 4), claim(2, 2_000, 1)];
        for (at, first) in order.iter().enumerate() {
            assert!(!first.goes_before(first));
            for second in &order[at + 1..] {
                assert!(first.goes_before(second) && !second.goes_before(first), "{first:?} {second:?}");
            }
        }
    }
}

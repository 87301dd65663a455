//! One link's clock: where the peer's counter stands against one's own, how much faster it runs, and how sure that is.
//!
//! - **Walk:** [`LinkClock::observe`] takes the four stamps of an exchange: refused or measured → time passes over what is known
//!   ([`covariance`](super::covariance), [`interval`](super::interval)) → too surprising or not → filter and interval take their part →
//!   the reference moves to the exchange. Between exchanges [`LinkClock::peer_at`] and [`LinkClock::compose`] read the line.
//! - **Invariants:** all is kept relative to the last exchange accepted, so nothing grows with the counters. The estimate lies inside the
//!   interval of what is certainly so. No stamps make it panic, and none lock it out: [`RUN`] refused exchanges that agree with each
//!   other start it anew.
//! - **Context:** once an exchange. On a Cortex-M0+ an exchange is 6,000 cycles in the median and 7,200 at most, [`LinkClock::compose`]
//!   1,900 and 2,150, [`LinkClock::error_at`] 900 and 1,200: 1 % of 125 MHz at 200 Hz. These are instructions of an emulator at the
//!   manual's cycles, code in RAM, built as images are (`opt-level = "s"`), of 1,141 exchanges of three simulated links. Nothing divides:
//!   two reciprocals an exchange ([`wide`](super::wide)) and one square root to compose.

use super::covariance::{CAP, Covariance, Gains};
use super::interval::{Certain, Interval};
use super::line::{Estimate, PeerEstimate, TimeLine, backwards, distance, forwards, grown};
use super::roundtrip::ShortestRoundTrip;
use super::wide::{Reciprocal, hypotenuse, hypotenuse_of_square, root_up, scale_or_more, square};
use super::{Exchange, Fault, LinkTraits};
use crate::time::{LocalTicks, PeerTicks, Rate, Span};
use crate::widening::product_signed;

/// Refused exchanges that agree with each other and not with what was known, after which they are believed.
pub const RUN: u8 = 8;
/// Longest time between the stamps of one exchange, 67 s: what is longer is no exchange.
const EXCHANGE_MAX: u64 = 1 << 34;
/// Longest time between two exchanges that still have to do with each other, 18 min; longer, and only the rate is kept.
const GAP_MAX: i64 = 1 << 38;
/// Farthest offset that is looked at, 72 min.
const OFFSET_MAX: i64 = 1 << 40;
/// Bits below a step: state and surprises are µs in Q24.
const BELOW_STEP: u32 = 16;
/// Sigma of the rate after a start with a known one, 2 ppm, squared: µs² in Q36 of a unit of 2^16 µs.
const HOT: i64 = (1 << 36) / 1_000_000 * 17_180;
/// How the skew walks at first, (3·10⁻⁸)² a second: 2.53·10⁻⁷ µs² in Q36 a unit of time.
const AGILITY: i64 = 17_400;
/// How far that is doubled, and halved: a crystal in a draught against an RC oscillator, and one in a box.
const AGILITY_LOG2: core::ops::RangeInclusive<i8> = -4..=14;
/// Agreeing signs of successive surprises, less those that do not agree, at which the skew is taken to walk faster, or slower.
const LEAN_MAX: i8 = 12;
/// Exchanges until the shortest round trip is believed to be one without delays: none of 32 is with a probability of 0.76^32, 1 in 6500,
/// where 30 % of stamps are delayed.
const SETTLED: u32 = 32;

/// Square of the most sigmas a surprise may have: 2^this.
const GATE_LOG2: u32 = 5;
/// Sigmas of the rate beforehand that count as certain.
const CERTAIN: i64 = 6;

/// What was refused last, in case it goes on.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    at: LocalTicks,
    peer: PeerTicks,
    run: u8,
}

/// The four stamps as two readings of one instant, halfway.
#[derive(Clone, Copy, Debug)]
struct Measured {
    /// Half way from `sent` to `received`, rounded down to a step.
    at: LocalTicks,
    /// The peer's counter then, less `heard`, µs in Q24.
    after_heard: i64,
    /// The time on the way, both ways, steps.
    round_trip: i64,
    /// Where the peer's counter certainly was, less `heard`, steps.
    certain: Interval,
}

/// Offset and skew of a peer's counter against one's own.
#[derive(Clone, Debug)]
pub struct LinkClock {
    traits: LinkTraits,
    /// Variance of an exchange without delays, µs² in Q36.
    noise: i64,
    /// Time certainly on the way, there and back, steps; both negative or positive.
    there: i64,
    back: i64,
    at: LocalTicks,
    /// Estimated reading of the peer's counter at `at`: whole steps, and what is above them, µs in Q24.
    peer: PeerTicks,
    above: i64,
    /// Skew: µs in Q24 for a unit of 2^16 µs, which is the rate in 2^−40.
    skew: i64,
    covariance: Covariance,
    certain: Certain,
    agility_log2: i8,
    lean: i8,
    /// The last surprise, for its sign.
    surprise: i64,
    answered: PeerTicks,
    shortest: ShortestRoundTrip,
    round_trip: Span,
    offset_steps: i64,
    candidate: Option<Candidate>,
    exchanges: u32,
    restarts: u32,
    contradictions: u32,
}

impl LinkClock {
    /// A link of which nothing but `traits` is known.
    #[must_use]
    pub const fn new(traits: LinkTraits) -> Self {
        let skew = prior(traits.rate_sigma);
        let tick = cut(traits.tick.steps(), 1 << 20);
        let wire = cut(traits.wire.steps(), EXCHANGE_MAX);
        // both ways are counted by the slower counter
        let wire = wire - certain_rate(traits.rate_sigma).over(wire) - 1;
        // a calibration moves the estimate; what is certain holds whether it is right or not: each way takes what the shorter takes at least
        let half = (traits.asymmetry_steps as i64 / 2).abs();
        let least = if wire > half { wire - half } else { 0 };
        Self {
            traits,
            // four stamps, each uniform over a tick: (4 · tick²/12) / 4; from steps² to µs² in Q36
            noise: (tick * tick / 12) << 20,
            there: least - 1,
            back: least - 1,
            at: LocalTicks::ZERO,
            peer: PeerTicks::ZERO,
            above: 0,
            skew: 0,
            covariance: Covariance::apart(CAP, skew),
            certain: Certain::new(certain_rate(traits.rate_sigma), traits.ramp),
            agility_log2: agility_at_first(traits.ramp),
            lean: 0,
            surprise: 0,
            answered: PeerTicks::ZERO,
            shortest: ShortestRoundTrip::NONE,
            round_trip: Span::ZERO,
            offset_steps: 0,
            candidate: None,
            exchanges: 0,
            restarts: 0,
            contradictions: 0,
        }
    }

    /// Forgets all but its traits and its counters of faults. `hot`: a rate kept from a former run, believed to 2 ppm, one sigma.
    pub fn restart(&mut self, hot: Option<Rate>) {
        let (restarts, contradictions) = (self.restarts, self.contradictions);
        *self = Self { restarts, contradictions, ..Self::new(self.traits) };
        if let Some(rate) = hot {
            self.skew = self.certain.rate_near(i64::from(rate.bits()) << 8);
            self.covariance.skew = self.covariance.skew.min(HOT);
        }
    }

    /// Takes one exchange.
    ///
    /// # Errors
    /// What is wrong with its stamps; nothing of it is believed then. After [`RUN`] exchanges that were [`Fault::Past`] or
    /// [`Fault::Absurd`] but agree with each other, the last starts the link anew and is accepted ([`LinkClock::restarts`]).
    pub fn observe(&mut self, exchange: &Exchange) -> Result<(), Fault> {
        let measured = self.measure(exchange)?;
        if !self.is_started() {
            self.start(exchange, &measured);
            return Ok(());
        }
        if exchange.heard <= self.answered || measured.at <= self.at {
            return self.refuse(exchange, &measured, Fault::Past);
        }
        let steps = measured.at.steps_after(self.at);
        if steps > GAP_MAX {
            self.restart(Some(self.rate()));
            self.start(exchange, &measured);
            return Ok(());
        }
        let moved = self.above + scale_or_more(self.skew, steps, 24);
        // the exchange's `heard` against the prediction, whole steps
        let ahead = exchange.heard.steps_after(self.peer).saturating_sub(steps);
        if distance(ahead) > OFFSET_MAX {
            return self.refuse(exchange, &measured, Fault::Absurd);
        }
        let surprise = (ahead << BELOW_STEP) + measured.after_heard - moved;
        if self.filter(steps, moved, surprise, &measured).is_none() {
            return self.refuse(exchange, &measured, Fault::Absurd);
        }
        self.intersect(steps, moved, measured.certain.widened(0, (moved >> BELOW_STEP) - ahead));
        self.accept(exchange, &measured);
        self.offset_steps = surprise >> BELOW_STEP;
        Ok(())
    }

    /// Whether there was an exchange at all.
    #[must_use]
    pub const fn is_started(&self) -> bool {
        self.exchanges > 0
    }

    /// Exchanges accepted since the last start; stays at the largest.
    #[must_use]
    pub const fn exchanges(&self) -> u32 {
        self.exchanges
    }

    /// How often a run of refused exchanges started the link anew.
    #[must_use]
    pub const fn restarts(&self) -> u32 {
        self.restarts
    }

    /// How often an exchange contradicted what was held for certain: the rate changed faster than stated, or a departure was stamped
    /// later than stated. The bound began anew from that exchange.
    #[must_use]
    pub const fn contradictions(&self) -> u32 {
        self.contradictions
    }

    /// The peer's counter when one's own reads `local`.
    #[must_use]
    pub const fn peer_at(&self, local: LocalTicks) -> PeerTicks {
        self.peer_after(local.steps_after(self.at), self.rate())
    }

    const fn peer_after(&self, steps: i64, rate: Rate) -> PeerTicks {
        self.peer.shifted(forwards(rate, steps))
    }

    /// One's own counter when the peer's reads `peer`.
    #[must_use]
    pub const fn local_at(&self, peer: PeerTicks) -> LocalTicks {
        self.at.shifted(backwards(self.rate(), peer.steps_after(self.peer)))
    }

    /// How much faster the peer's counter runs than one's own.
    #[must_use]
    pub const fn rate(&self) -> Rate {
        Rate::saturated((self.skew + (1 << 7)) >> 8)
    }

    /// By how much the last exchange differed from what was predicted, in steps; for people.
    #[must_use]
    pub const fn offset_steps(&self) -> i64 {
        self.offset_steps
    }

    /// One sigma of [`LinkClock::peer_at`]. Four products and a square root; the longest span before the first exchange.
    #[must_use]
    pub fn error_at(&self, local: LocalTicks) -> Span {
        if !self.is_started() {
            return Span::MAX;
        }
        let away = distance(local.steps_after(self.at));
        let Some(variance) = self.variance_after(away) else { return Span::from_steps(self.bound_after(away)) };
        // µs² in Q36 is µs in Q18, of which 10 bits are below a step
        Span::from_steps((root_up(variance.cast_unsigned()) >> 10) + 1)
    }

    /// The square of that `away` from the last exchange, µs² in Q36; `None` so far that only the rate counts.
    const fn variance_after(&self, away: i64) -> Option<i64> {
        self.covariance.offset_after(away, self.agility())
    }

    /// How far [`LinkClock::peer_at`] is from the truth at most; the longest span before the first exchange.
    #[must_use]
    pub const fn bound_at(&self, local: LocalTicks) -> Span {
        Span::from_steps(self.bound_after(distance(local.steps_after(self.at))))
    }

    const fn bound_after(&self, away: i64) -> u64 {
        if self.is_started() { self.certain.reach(away) } else { u64::MAX }
    }

    /// How fast the bound grows: how far the rate can be off, and what it may gain in 2.5 s.
    #[must_use]
    pub const fn drift(&self) -> Rate {
        self.certain.drift().plus(self.certain.ramped_in_life())
    }

    /// Time on the way there and back in the last exchange, in the peer's units.
    #[must_use]
    pub const fn round_trip(&self) -> Span {
        self.round_trip
    }

    /// The shortest of the last 512 to 1024 exchanges; zero before the first.
    #[must_use]
    pub fn round_trip_min(&self) -> Span {
        if self.is_started() { Span::from_steps(self.shortest.steps().max(0).cast_unsigned()) } else { Span::ZERO }
    }

    /// The peer's line over the peer's counter, as a line over one's own, through `at`. The errors of both are independent and add as
    /// squares; the bounds add.
    #[must_use]
    pub fn compose(&self, peer: &PeerEstimate, at: LocalTicks) -> Estimate {
        let (steps, own_rate) = (at.steps_after(self.at), self.rate());
        let away = distance(steps);
        let there = self.peer_after(steps, own_rate);
        let since = there.steps_after(peer.at);
        let system = peer.system.shifted(forwards(peer.rate, since));
        let (mine, its) = (own_rate.bits(), peer.rate.bits());
        let rate = Rate::saturated(i64::from(mine) + i64::from(its) + (product_signed(mine, its) >> 32));
        // in the peer's steps; system time's are longer or shorter by the rate
        let own_bound = self.bound_after(away);
        let longer =
            grown(Rate::from_bits(peer.rate.bits().saturating_abs()), i64::try_from(own_bound).unwrap_or(i64::MAX));
        let bound = own_bound.saturating_add(longer).saturating_add(peer.bound.steps());
        let bound = bound.saturating_add(grown(peer.drift, distance(since))).saturating_add(1);
        // the peer's drift is per unit of its counter: a 16th more covers any rate there is
        let drift = i64::from(self.drift().bits()) + i64::from(peer.drift.bits().max(0));
        let error = match self.variance_after(away).filter(|_| self.is_started()) {
            // µs² in Q36 are steps² in Q20
            Some(variance) => hypotenuse_of_square((variance.cast_unsigned() >> 20) + 1, peer.error.steps()),
            None => hypotenuse(own_bound, peer.error.steps()),
        };
        Estimate {
            line: TimeLine { at, system, rate },
            error: Span::from_steps(error),
            bound: Span::from_steps(bound),
            drift: Rate::saturated(drift + (drift >> 4) + 1),
        }
    }

    /// Looks at the four stamps by themselves.
    fn measure(&self, exchange: &Exchange) -> Result<Measured, Fault> {
        let Exchange { sent, heard, answered, received } = *exchange;
        if answered < heard || received < sent {
            return Err(Fault::Order);
        }
        let (away, turn) = (received.since(sent).steps(), answered.since(heard).steps());
        if away > EXCHANGE_MAX || turn > EXCHANGE_MAX {
            return Err(Fault::Absurd);
        }
        let (away, turn) = (away.cast_signed(), turn.cast_signed());
        let (rate, half) = (self.rate(), away >> 1);
        let (tick, late) = (cut(self.traits.tick.steps(), EXCHANGE_MAX), cut(self.traits.late.steps(), EXCHANGE_MAX));
        let (before, after) = (half + late, away - half + tick);
        // as `forwards`; none is over 2^35
        let theirs = |steps: i64| steps + rate.over(steps);
        let since = if self.is_started() { distance(sent.steps_after(self.at)) } else { 0 };
        let slack = self.certain.drift().plus(self.certain.ramped(since)).over(before.max(after)) + 2;
        let certain = Interval {
            lowest: turn - late + self.back - theirs(after) - slack,
            highest: tick - self.there + theirs(before) + slack,
        };
        if certain.lowest > certain.highest {
            return Err(Fault::RoundTrip);
        }
        let odd = (away & 1) << (BELOW_STEP - 1);
        let asymmetry = i64::from(self.traits.asymmetry_steps) << (BELOW_STEP - 1);
        Ok(Measured {
            at: sent.shifted(half),
            after_heard: (turn << (BELOW_STEP - 1)) - odd - asymmetry,
            round_trip: theirs(away) - turn,
            certain,
        })
    }

    /// The first exchange: offset measured, skew as it was.
    fn start(&mut self, exchange: &Exchange, measured: &Measured) {
        let noise = self
            .noise_of(0)
            .saturating_add(square_q36(measured.round_trip << (BELOW_STEP - 1)).unwrap_or(CAP).min(CAP));
        self.covariance = Covariance::apart(noise, self.covariance.skew);
        self.at = measured.at;
        let (at, whole) = (measured.at, measured.after_heard >> BELOW_STEP);
        self.settle(exchange.heard.shifted(whole), measured.after_heard & 0xffff);
        let out = self.certain.start(at, self.peer, measured.certain.widened(0, whole));
        self.shift(out);
        self.at = at;
        self.offset_steps = 0;
        self.accept(exchange, measured);
    }

    /// What every accepted exchange leaves behind.
    fn accept(&mut self, exchange: &Exchange, measured: &Measured) {
        self.answered = exchange.answered;
        self.shortest.take(measured.round_trip);
        self.round_trip = Span::from_steps(measured.round_trip.max(0).cast_unsigned());
        self.skew = self.certain.rate_near(self.skew);
        self.candidate = None;
        self.exchanges = self.exchanges.saturating_add(1);
    }

    /// Time passes, and the surprise is shared between offset and skew; `None` where it is too large, and nothing has changed then.
    fn filter(&mut self, steps: i64, moved: i64, surprise: i64, measured: &Measured) -> Option<()> {
        let noise = self.noise_of(self.excess(measured.round_trip));
        let agility = self.agility();
        let (offset, skew) = if let Some(later) = self.covariance.after(steps, agility) {
            self.tune(surprise);
            if is_beyond(surprise, later.offset + noise) {
                return None;
            }
            let gains: Gains = later.gains(noise);
            self.covariance = later.measured(noise, gains);
            gains.of(surprise)
        } else {
            // so far from the last that the two make a slope, and what was known of offset says nothing
            let over = Reciprocal::of(steps);
            let slope = over.times(surprise, 24);
            let known = self.covariance.skew.saturating_add(scale_or_more(agility, steps, 24));
            if is_beyond(slope, known) {
                return None;
            }
            self.covariance = Covariance::of_slope(self.covariance.offset, noise, over, steps, agility);
            (surprise, slope)
        };
        self.skew = self.skew.saturating_add(skew);
        self.above = moved + offset;
        Some(())
    }

    /// Surprises of one sign in succession say that the filter lags, of alternating signs that it follows noise.
    fn tune(&mut self, surprise: i64) {
        let agrees = (surprise < 0) == (self.surprise < 0);
        self.surprise = surprise;
        self.lean += if agrees { 1 } else { -1 };
        if self.lean.unsigned_abs() >= LEAN_MAX.unsigned_abs() {
            let (lowest, highest) = AGILITY_LOG2.into_inner();
            self.agility_log2 = (self.agility_log2 + self.lean.signum()).clamp(lowest, highest);
            self.lean = 0;
        }
    }

    /// What was certain before, and what the exchange says, both relative to the prediction; then the reference moves to the estimate.
    fn intersect(&mut self, steps: i64, moved: i64, said: Interval) {
        let whole = self.above >> BELOW_STEP;
        let correction = whole - (moved >> BELOW_STEP);
        self.at = self.at.shifted(steps);
        self.settle(self.peer.shifted(steps.saturating_add(whole)), self.above & 0xffff);
        let ramped = self.certain.ramped(steps);
        let both = self.certain.later(steps, ramped, said);
        let out = both.and_then(|both| self.certain.advance(steps, ramped, self.peer, both.widened(0, correction)));
        let out = out.unwrap_or_else(|| {
            self.contradictions = self.contradictions.saturating_add(1);
            self.certain.start(self.at, self.peer, said.widened(0, correction))
        });
        self.shift(out);
    }

    /// The estimate is `peer`, and `above` it.
    fn settle(&mut self, peer: PeerTicks, above: i64) {
        (self.peer, self.above) = (peer, above);
    }

    /// Moves an estimate outside what is certain to its border, and the skew by what that means for it: what is wrong with the offset
    /// mostly came of the skew since the last exchange that said much.
    fn shift(&mut self, out: i64) {
        if out != 0 {
            self.settle(self.peer.shifted(out), 0);
            self.skew =
                self.skew.saturating_add(self.covariance.skew_for(out.clamp(-OFFSET_MAX, OFFSET_MAX) << BELOW_STEP));
        }
    }

    /// An exchange that does not fit what is known, unless it is one of many that fit each other.
    fn refuse(&mut self, exchange: &Exchange, measured: &Measured, fault: Fault) -> Result<(), Fault> {
        let this = (measured.at, exchange.heard.shifted(measured.after_heard >> BELOW_STEP));
        let run = match self.candidate {
            Some(last) if agrees(last, this, self.drift(), measured.round_trip) => last.run + 1,
            _ => 1,
        };
        self.candidate = Some(Candidate { at: this.0, peer: this.1, run });
        if run < RUN {
            return Err(fault);
        }
        let rate = self.rate();
        self.restarts = self.restarts.saturating_add(1);
        self.restart(None);
        // most likely the same crystal, but nobody said so
        self.skew = self.certain.rate_near(i64::from(rate.bits()) << 8);
        self.start(exchange, measured);
        Ok(())
    }

    /// How much longer than without delays a round trip is, but for what rounding of its stamps explains: above the shortest, once that is
    /// known, and above what is certain before.
    ///
    /// Four roundings add up to anything within two ticks of none, and within one tick 11 times of 12. The shortest has most of two
    /// ticks taken off, so one and a half above it is what most exchanges without delays come to. Where departures may be stamped late,
    /// the shortest are those that were; then only what is certain of the wire counts, and how far either way.
    fn excess(&self, round_trip: i64) -> i64 {
        let certain = round_trip.saturating_sub(self.there + self.back);
        if self.traits.late > Span::ZERO {
            return distance(certain);
        }
        let tick = cut(self.traits.tick.steps(), 1 << 20);
        let excess = if self.exchanges < SETTLED {
            certain.saturating_sub(tick)
        } else {
            self.shortest.excess(round_trip).saturating_sub(tick + (tick >> 1))
        };
        excess.max(0)
    }

    /// Variance of an exchange whose round trip is `excess` steps above the shortest.
    fn noise_of(&self, excess: i64) -> i64 {
        let half = (excess << (BELOW_STEP - 1)).min(1 << 40);
        self.noise.saturating_add(square_q36(half).unwrap_or(CAP)).clamp(1, CAP)
    }

    /// How the skew walks, µs² in Q36 for a unit of time.
    const fn agility(&self) -> i64 {
        if self.agility_log2 < 0 { AGILITY >> self.agility_log2.unsigned_abs() } else { AGILITY << self.agility_log2 }
    }
}

/// Whether two refused exchanges can be of one pair of counters.
fn agrees(last: Candidate, (at, peer): (LocalTicks, PeerTicks), drift: Rate, round_trip: i64) -> bool {
    let (own, its) = (at.steps_after(last.at), peer.steps_after(last.peer));
    let allowed = drift.over(own).saturating_add(own >> 10).saturating_add(round_trip.max(0)).saturating_add(1 << 15);
    own > 0 && its > 0 && distance(its.saturating_sub(own)) <= allowed
}

/// Variance of the skew that one sigma of the rate means: µs² in Q36 of a unit of 2^16 µs. Three in a hundred at most.
const fn prior(sigma: Rate) -> i64 {
    let bits = cut(sigma.bits().unsigned_abs() as u64, 1 << 27);
    (bits * bits) << 4
}

/// Six of it: within that the rate certainly is before anything was measured.
const fn certain_rate(sigma: Rate) -> Rate {
    Rate::saturated(cut(sigma.bits().unsigned_abs() as u64, 1 << 27) * CERTAIN)
}

/// How far [`AGILITY`] is doubled at first: as often as the ramp's doublings over a crystal's, halved, since one that never ramps is paid
/// for too.
const fn agility_at_first(ramp: Rate) -> i8 {
    let times = ramp.bits().unsigned_abs() / LinkTraits::CRYSTAL.ramp.bits().unsigned_abs();
    // a logarithm of 32 bits
    #[expect(clippy::cast_possible_truncation, reason = "at most 15")]
    let doubled = if times == 0 { 0 } else { times.ilog2() as i8 };
    if doubled > *AGILITY_LOG2.end() { *AGILITY_LOG2.end() } else { doubled }
}

/// The square of µs in Q24, as µs² in Q36; `None` from 8.2 ms on.
fn square_q36(value: i64) -> Option<i64> {
    let value = (value >> 6).unsigned_abs();
    u32::try_from(value).ok().filter(|value| value >> 31 == 0).map(|value| square(value).cast_signed())
}

/// Whether the square of `surprise` (µs in Q24) is 2^[`GATE_LOG2`] times `variance` (µs² in Q36), or more.
fn is_beyond(surprise: i64, variance: i64) -> bool {
    match square_q36(surprise) {
        Some(square) => square >> GATE_LOG2 > variance,
        // coarser, up to two seconds
        None => square_q36(surprise >> 8).is_none_or(|square| square >> GATE_LOG2 > variance >> 16),
    }
}

/// At most `most`, which is below 2^63.
const fn cut(value: u64, most: u64) -> i64 {
    if value > most { most.cast_signed() } else { value.cast_signed() }
}

//! What must not harm a link: gaps, counters at their ends, a peer that starts anew, stamps of every kind.

use crate::UART;
use crate::world::{Conditions, Counter, World, run, us};
use fixed_math::clock::{
    Diffusion, Estimate, Exchange, Fault, Follow, Gains, LinkClock, LinkTraits, Neighbour, Oldest, PeerEstimate, RUN,
    Servo, SlewedMap, TimeLine, ewma,
};
use fixed_math::time::{LocalTicks, NetTime, PeerTicks, Rate, Span};
use proptest::prelude::*;

/// A minute without an exchange: the bound has grown and held, and one exchange later the link is about as good as before.
#[test]
fn a_gap_of_a_minute() {
    for seed in 0..30 {
        let mut world = World::new(Conditions::issue(seed), seed);
        world.now_us = 1e6;
        let mut link = LinkClock::new(UART);
        run(&mut world, &mut link, 10.0, 5.0);
        let rate = link.rate();
        let mut last_us = 0.0;
        for second in 1..=60 {
            let (error, bound, _) = world.error_us(&link, world.now_us + f64::from(second) * 1e6);
            assert!(error.abs() <= bound && bound > last_us, "seed {seed}: {error} of {bound} after {second} s");
            last_us = bound;
        }
        // at most 6 µs from the ramp that is promised for either side, and 60 times what the rate was off
        assert!(last_us < 200.0, "{last_us}");
        world.now_us += 60e6;
        let found = run(&mut world, &mut link, 10.0, 5.0);
        assert!(
            found.worst_of_bound <= 1.0 && found.rms_us() < 0.4 && found.contradictions == 0,
            "seed {seed}: {found:?}"
        );
        // the ramp of 0.01 ppm/s over 80 s is 0.8 ppm, and a sigma of the rate is below 0.2
        assert!(link.rate().ppb().abs_diff(rate.ppb()) < 2_000);
        assert_eq!(link.restarts(), 0);
    }
}

/// An hour: longer than exchanges have to do with each other. The rate is kept.
#[test]
fn a_gap_of_an_hour() {
    let quiet = Conditions { peer: Counter { ramp_per_s: 0.0, ..Conditions::issue(3).peer }, ..Conditions::issue(3) };
    let mut world = World::new(quiet, 3);
    world.now_us = 1e6;
    let mut link = LinkClock::new(UART);
    run(&mut world, &mut link, 10.0, 5.0);
    let before = link.rate();
    world.now_us += 3600e6;
    let exchange = world.exchange();
    assert_eq!(link.observe(&exchange), Ok(()));
    assert_eq!((link.exchanges(), link.restarts(), link.rate()), (1, 0, before));
    let found = run(&mut world, &mut link, 10.0, 5.0);
    assert!(found.worst_of_bound <= 1.0 && found.rms_us() < 0.4, "{found:?}");
}

/// From the very start of both counters, and to the last instant there is.
#[test]
fn counters_at_their_ends() {
    const LAST_US: u64 = u64::MAX >> 8;
    for (own_origin_us, peer_origin_us) in [(0, 0), (0, LAST_US - 30_000_000), (LAST_US - 30_000_000, 0), (1 << 55, 17)]
    {
        let issue = Conditions::issue(5);
        let conditions = Conditions {
            own: Counter { origin_us: own_origin_us, ..issue.own },
            peer: Counter { origin_us: peer_origin_us, ..issue.peer },
            ..issue
        };
        let mut world = World::new(conditions, 5);
        let found = run(&mut world, &mut LinkClock::new(UART), 20.0, 5.0);
        assert!(found.worst_of_bound <= 1.0 && found.rms_us() < 0.3, "{own_origin_us} {peer_origin_us} {found:?}");
    }
}

/// A peer that started anew: its stamps are of the past, or absurd, until they agree with each other often enough.
#[test]
fn a_peer_that_starts_anew_is_believed_after_a_run() {
    for origin_us in [7, 1 << 41] {
        let mut world = World::new(Conditions::issue(11), 11);
        world.now_us = 1e6;
        let mut link = LinkClock::new(UART);
        run(&mut world, &mut link, 10.0, 5.0);
        world.conditions.peer.origin_us = origin_us;
        let mut faults = Vec::new();
        for _ in 0..u32::from(RUN) {
            world.now_us += 50_000.0;
            let exchange = world.exchange();
            faults.push(link.observe(&exchange));
        }
        let expected = if origin_us == 7 { Fault::Past } else { Fault::Absurd };
        assert!(faults[..usize::from(RUN) - 1].iter().all(|fault| *fault == Err(expected)), "{faults:?}");
        assert_eq!((faults[usize::from(RUN) - 1], link.restarts(), link.exchanges()), (Ok(()), 1, 1));
        let found = run(&mut world, &mut link, 10.0, 5.0);
        assert!(found.worst_of_bound <= 1.0 && found.rms_us() < 0.3, "{found:?}");
    }
}

/// Lies that do not agree with each other change nothing, however many.
#[test]
fn lies_that_disagree_are_never_believed() {
    let mut world = World::new(Conditions::issue(2), 2);
    world.now_us = 1e6;
    let mut link = LinkClock::new(UART);
    run(&mut world, &mut link, 10.0, 5.0);
    let before = link.clone();
    for lie in 0..1_000i64 {
        world.now_us += 1_000.0;
        let honest = world.exchange();
        // a millisecond and more, this way and that: no round trip explains it
        let by = (256_000 + lie * 37_000) * if lie % 2 == 0 { 1 } else { -1 };
        let lying = Exchange { heard: honest.heard.shifted(by), answered: honest.answered.shifted(by), ..honest };
        assert!(matches!(link.observe(&lying), Err(Fault::Absurd | Fault::Past)), "{lie}");
    }
    let at = LocalTicks::from_us(1 << 41);
    assert_eq!((link.peer_at(at), link.bound_at(at), link.restarts()), (before.peer_at(at), before.bound_at(at), 0));
}

/// Each fault by name.
#[test]
fn each_fault_has_its_name() {
    let mut link = LinkClock::new(LinkTraits { wire: Span::from_us(10), ..LinkTraits::CRYSTAL });
    let us = |sent, heard, answered, received| Exchange {
        sent: LocalTicks::from_us(sent),
        heard: PeerTicks::from_us(heard),
        answered: PeerTicks::from_us(answered),
        received: LocalTicks::from_us(received),
    };
    assert_eq!(link.bound_at(LocalTicks::ZERO), Span::MAX);
    assert_eq!(link.error_at(LocalTicks::ZERO), Span::MAX);
    assert_eq!(link.observe(&us(100, 520, 510, 200)), Err(Fault::Order));
    assert_eq!(link.observe(&us(100, 520, 530, 99)), Err(Fault::Order));
    assert_eq!(link.observe(&us(100, 520, 530, 100_000_100)), Err(Fault::Absurd));
    // 15 µs on the way, both ways, where the wire alone takes 20 and rounding two
    assert_eq!(link.observe(&us(100, 520, 605, 200)), Err(Fault::RoundTrip));
    assert!(!link.is_started());
    assert_eq!(link.observe(&us(100, 520, 600, 200)), Ok(()));
    assert_eq!(link.round_trip(), Span::from_us(20));
    assert_eq!(link.observe(&us(5_100, 600, 680, 5_200)), Err(Fault::Past));
    assert_eq!(link.observe(&us(5_100, 9_520, 9_600, 5_200)), Err(Fault::Absurd));
    assert_eq!(link.observe(&us(5_100, 5_520, 5_600, 5_200)), Ok(()));
    assert_eq!(link.exchanges(), 2);
}

/// A rate kept from a former run: the first second is as good as a later one, and a wrong one does no harm for long.
#[test]
fn a_hot_start_knows_its_rate() {
    let conditions = Conditions::issue(21);
    let known = Rate::from_ppb(((conditions.peer.rate - conditions.own.rate) * 1e9) as i32);
    let mut link = LinkClock::new(UART);
    link.restart(Some(known));
    assert_eq!(link.rate(), known);
    let mut world = World::new(conditions, 21);
    let exchange = world.exchange();
    link.observe(&exchange).unwrap();
    // half a second later, with one exchange: its own error of some µs, and at most 6 · 2 ppm of half a second
    let (error, bound, sigma) = world.error_us(&link, 0.5e6);
    let cold = {
        let mut cold = LinkClock::new(UART);
        cold.observe(&exchange).unwrap();
        world.error_us(&cold, 0.5e6)
    };
    assert!(error.abs() < 12.0 && error.abs() <= bound && sigma < 12.0, "{error} {bound} {sigma}");
    assert!(cold.2 > 10.0 && cold.1 > 100.0, "{cold:?}");
    let wrong = Rate::from_ppb(-known.ppb() + 20_000);
    link.restart(Some(wrong));
    let found = run(&mut world, &mut link, 20.0, 10.0);
    assert!(found.worst_of_bound <= 1.0 && found.rms_us() < 0.3, "{found:?}");
}

fn any_rate() -> impl Strategy<Value = Rate> {
    any::<i32>().prop_map(Rate::from_bits)
}

/// Any stamp there is, with those that make an exchange likely.
fn stamps() -> impl Strategy<Value = [u64; 4]> {
    let plausible = (any::<u64>(), any::<u64>(), 0u64..1 << 36, 0u64..1 << 36)
        .prop_map(|(own, peer, away, turn)| [own, peer, peer.saturating_add(turn), own.saturating_add(away)]);
    prop_oneof![
        any::<[u64; 4]>(),
        plausible,
        (0u64..1 << 40, 0u64..1 << 20).prop_map(|(at, away)| [at, at, at, at + away])
    ]
}

fn any_traits() -> impl Strategy<Value = LinkTraits> {
    let spans = [any::<u64>(), any::<u64>(), any::<u64>()];
    (spans, any::<i32>(), any_rate(), any_rate(), any::<bool>()).prop_map(
        |([wire, tick, late], asymmetry_steps, rate_sigma, ramp, wild)| {
            let span = |steps: u64, bits: u32| Span::from_steps(if wild { steps } else { steps >> bits });
            LinkTraits {
                wire: span(wire, 54),
                tick: span(tick, 55),
                late: span(late, 55),
                asymmetry_steps: asymmetry_steps >> 12,
                rate_sigma,
                ramp,
            }
        },
    )
}

fn any_line() -> impl Strategy<Value = TimeLine> {
    (any::<u64>(), any::<u64>(), any_rate()).prop_map(|(at, system, rate)| TimeLine {
        at: LocalTicks::from_steps(at),
        system: NetTime::from_steps(system),
        rate,
    })
}

fn any_peer() -> impl Strategy<Value = PeerEstimate> {
    (any::<[u64; 4]>(), any_rate(), any_rate()).prop_map(|([at, system, error, bound], rate, drift)| PeerEstimate {
        at: PeerTicks::from_steps(at),
        system: NetTime::from_steps(system),
        rate,
        error: Span::from_steps(error),
        bound: Span::from_steps(bound),
        drift,
    })
}

proptest! {
    /// No stamps, traits or claims of a peer make anything panic or overflow; a bound is never shorter than what it is made of.
    #[test]
    fn nothing_absurd_harms(
        traits in any_traits(),
        exchanges in prop::collection::vec(stamps(), 1..24),
        hot in prop::option::of(any_rate()),
        peer in any_peer(),
        looks in any::<[u64; 3]>(),
    ) {
        let mut link = LinkClock::new(traits);
        link.restart(hot);
        for [sent, heard, answered, received] in exchanges {
            let exchange = Exchange {
                sent: LocalTicks::from_steps(sent),
                heard: PeerTicks::from_steps(heard),
                answered: PeerTicks::from_steps(answered),
                received: LocalTicks::from_steps(received),
            };
            let before = link.exchanges();
            let accepted = link.observe(&exchange).is_ok();
            prop_assert!(!accepted || link.is_started());
            prop_assert!(accepted || link.exchanges() == before);
            for look in looks {
                let local = LocalTicks::from_steps(look);
                let _ = (link.peer_at(local), link.local_at(PeerTicks::from_steps(look)), link.error_at(local), link.drift());
                let composed = link.compose(&peer, local);
                prop_assert!(composed.bound >= peer.bound && composed.bound >= link.bound_at(local));
                let _ = (composed.bound_at(LocalTicks::from_steps(looks[0])), link.round_trip_min(), link.offset_steps());
            }
        }
    }

    /// Nor do gains, offsets or lines in a servo and its map.
    #[test]
    fn no_servo_panics(
        line in any_line(),
        targets in prop::collection::vec((any_line(), any::<u8>(), any::<[i64; 2]>()), 0..4),
        (interval, limit, gains, adopt_steps) in (any::<u64>(), any_rate(), any::<[i32; 3]>(), any::<i64>()),
        looks in any::<[u64; 4]>(),
    ) {
        let neighbours: Vec<Neighbour> = targets.iter().map(|(line, tier, [offset_steps, filtered_steps])| Neighbour {
            tier: *tier,
            offset_steps: *offset_steps,
            filtered_steps: *filtered_steps,
            estimate: Estimate { line: *line, error: Span::from_steps(looks[1]), bound: Span::MAX, drift: line.rate },
        }).collect();
        let [filter_q16, proportional_q16, integral_q16] = gains;
        let gains = Gains { interval: Span::from_steps(interval), filter_q16, proportional_q16, integral_q16, limit, adopt_steps };
        let servos: [&mut dyn Servo; 3] = [&mut Follow, &mut Diffusion::default(), &mut Oldest::default()];
        for servo in servos {
            let mut map = SlewedMap::new(line);
            for look in looks {
                let now = LocalTicks::from_steps(look);
                servo.steer(now, &neighbours, &gains, &mut map);
                let _ = (map.local_at(map.system_at(now)), map.behind_steps(now), map.rate_at(now));
            }
            servo.restart();
        }
    }

    /// A filter ends where it is told to, never overshoots, and takes anything.
    #[test]
    fn a_filter_stays_between(from in any::<i64>(), to in any::<i64>(), weight in any::<i32>()) {
        let found = ewma(from, to, weight);
        prop_assert!((from.min(to)..=from.max(to)).contains(&found), "{found}");
        prop_assert_eq!(ewma(from >> 2, to >> 2, 1 << 16), to >> 2);
        let near = from >> 40;
        let mut filtered = near;
        for _ in 0..200 {
            filtered = ewma(filtered, to >> 40, 1 << 14);
        }
        prop_assert_eq!(filtered, to >> 40);
    }

    /// A line's two directions are each other's inverse, to a step of the finer side.
    #[test]
    fn a_line_leads_back(line in any_line(), ppb in -30_000_000i32..30_000_000, away in -(1i64 << 44)..1 << 44) {
        let line = TimeLine { at: LocalTicks::from_steps(1 << 62), system: NetTime::from_steps(line.system.steps() >> 1 | 1 << 62), rate: Rate::from_ppb(ppb) };
        let local = line.at.shifted(away);
        prop_assert!(line.local_at(line.system_at(local)).steps_after(local).abs() <= 1);
    }
}

/// The mean of equals, their bounds and errors.
#[test]
fn a_mean_of_equals() {
    let at = LocalTicks::from_us(1_000);
    let one = |system_us: u64, bound_us: u64, ppb: i32| Estimate {
        line: TimeLine { at, system: NetTime::from_us(system_us), rate: Rate::from_ppb(ppb) },
        error: Span::from_us(3),
        bound: Span::from_us(bound_us),
        drift: Rate::from_ppb(1_000),
    };
    assert_eq!(Estimate::mean(core::iter::empty(), at), None);
    let mean = Estimate::mean([one(500, 10, 4_000), one(504, 20, 8_000)].into_iter(), at).unwrap();
    assert_eq!(mean.line.system, NetTime::from_us(502));
    assert!((5_998..=6_000).contains(&mean.line.rate.ppb()));
    // √(3² + 3²) / 2, rounded up; (10 + 20) / 2 and two steps
    assert!((us(mean.error) - 2.1213).abs() < 2.0 / 256.0);
    assert_eq!(mean.bound.steps(), 15 * 256 + 2);
    // 1 ppm of a second
    let later = mean.bound_at(LocalTicks::from_us(1_001_000));
    assert!((us(later) - us(mean.bound) - 1.0).abs() < 3.0 / 256.0, "{later:?}");
}

/// Two exchanges of a minute each, a step apart: a slope between them is anything, and longer than any number here. The bound stays what one
/// of them says, half of its round trip and what the rate adds in that: 30 s and a little.
#[test]
fn a_slope_over_a_step_says_nothing() {
    let mut link = LinkClock::new(LinkTraits::CRYSTAL);
    for later in 0..3 {
        let exchange = Exchange {
            sent: LocalTicks::from_steps(later),
            heard: PeerTicks::from_steps((1 << 40) + 2 * later),
            answered: PeerTicks::from_steps((1 << 40) + 2 * later + 1),
            received: LocalTicks::from_steps(later + 256 * 60_000_000),
        };
        assert_eq!(link.observe(&exchange), Ok(()), "{later}");
        let bound = link.bound_at(LocalTicks::from_us(30_000_000)).as_us_ceil();
        assert!((30_000_000..30_100_000).contains(&bound), "{later} {bound}");
    }
    assert_eq!(link.contradictions(), 0);
}

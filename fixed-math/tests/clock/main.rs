//! The estimator of a link against truth: what it reaches, and that its bound holds. `--nocapture` prints the figures.
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    reason = "the truth is kept in floating point"
)]

mod world;

use fixed_math::clock::{LinkClock, LinkTraits};
use fixed_math::time::Span;
use world::{Conditions, Outcome, World, run};

/// A UART of 3 Mbaud: a byte of 10 bits on the way.
const UART: LinkTraits = LinkTraits { wire: Span::from_steps(853), ..LinkTraits::CRYSTAL };

/// rms, p99.9, max, worst time to 1 and 10 µs, worst error over bound, mean bound, error over sigma, refused.
fn summary(name: &str, outcomes: &[Outcome]) -> (f64, f64, f64) {
    let mut all: Vec<f64> = outcomes.iter().flat_map(|outcome| outcome.settled.iter().copied()).collect();
    all.sort_by(f64::total_cmp);
    let rms = (all.iter().map(|error| error * error).sum::<f64>() / all.len() as f64).sqrt();
    let p999 = all[all.len() * 999 / 1000];
    let worst = |of: fn(&Outcome) -> f64| outcomes.iter().map(of).fold(0.0, f64::max);
    let mean = |of: fn(&Outcome) -> f64| outcomes.iter().map(of).sum::<f64>() / outcomes.len() as f64;
    let mut below: Vec<f64> = outcomes.iter().map(|outcome| outcome.below_1us_at_us / 1e6).collect();
    below.sort_by(f64::total_cmp);
    println!(
        "{name}: rms {rms:.3} us (worst run {:.3}), p99.9 {p999:.2}, max {:.2}; < 1 us after {:.2} s median, {:.2} s worst; < 10 us after {:.2} s worst; error over bound {:.2} worst, bound {:.2} us, error over sigma {:.2}, refused {}",
        worst(Outcome::rms_us),
        worst(Outcome::max_us),
        below[below.len() / 2],
        worst(|outcome| outcome.below_1us_at_us) / 1e6,
        worst(|outcome| outcome.below_10us_at_us) / 1e6,
        worst(|outcome| outcome.worst_of_bound),
        mean(|outcome| outcome.bound_us),
        mean(|outcome| outcome.sigmas),
        outcomes.iter().map(|outcome| outcome.refused).sum::<u32>(),
    );
    (rms, p999, worst(|outcome| outcome.worst_of_bound))
}

fn runs(traits: LinkTraits, seconds: f64, conditions: impl Fn(u64) -> Conditions) -> Vec<Outcome> {
    (0..30)
        .map(|seed| {
            let mut world = World::new(conditions(seed), seed);
            world.now_us = 1e6;
            run(&mut world, &mut LinkClock::new(traits), seconds, 5.0)
        })
        .collect()
}

/// One hop of the issue's simulation.
#[test]
fn one_hop_of_the_issue() {
    let outcomes = runs(UART, 60.0, Conditions::issue);
    let (_rms, _, worst) = summary("one hop", &outcomes);
    assert!(worst <= 1.0);
}

#[test]
fn others() {
    summary("wire unknown", &runs(LinkTraits::CRYSTAL, 60.0, Conditions::issue));
    summary("no delay", &runs(UART, 60.0, |seed| Conditions { delayed: 0.0, ..Conditions::issue(seed) }));
    summary("no ramp", &runs(UART, 60.0, |seed| Conditions { ramp_per_s: 0.0, ..Conditions::issue(seed) }));
    summary(
        "low skew",
        &runs(UART, 60.0, |seed| Conditions {
            own_rate: 3e-6,
            peer_rate: 3e-6 + seed as f64 / 30.0 * 1e-6,
            ..Conditions::issue(seed)
        }),
    );
    summary(
        "low skew, no delay",
        &runs(UART, 60.0, |seed| Conditions {
            delayed: 0.0,
            own_rate: 3e-6,
            peer_rate: 3e-6 + seed as f64 / 30.0 * 1e-6,
            ..Conditions::issue(seed)
        }),
    );
    let rc = LinkTraits { wire: UART.wire, ..LinkTraits::RC };
    summary("rc", &runs(rc, 60.0, |seed| Conditions { own_rate: 0.02, ..Conditions::issue(seed) }));
    let late = LinkTraits { late: Span::from_us(20), ..UART };
    summary("late", &runs(late, 60.0, |seed| Conditions { late_us: 20.0, ..Conditions::issue(seed) }));
}

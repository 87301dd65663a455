//! Any points at any time: an axis and its clock under everything that a network, a sender and a clock can do, beside a judge of its own.
//!
//! A case is one axis in virtual time with its own random limits, interval, stop and weather. `--points` is how many are offered in all.

mod judge;
mod scene;
mod sender;
mod truth;

use scene::{Tally, play};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;

/// Points that a case offers.
const POINTS_A_CASE: u64 = 20_000;

/// A violation, and what makes it again.
struct Found {
    seed: u64,
    case: u64,
    what: String,
}

/// Offers `points` from `seed` on, on all processors; or one `case` alone.
pub(crate) fn run(points: u64, seed: u64, case: Option<u64>, json: bool) -> ExitCode {
    let result = match case {
        Some(case) => play(seed, case, POINTS_A_CASE).map_err(|what| Found { seed, case, what }),
        None => inject(points, seed),
    };
    match result {
        Ok(tally) => {
            report(&tally, seed, json);
            ExitCode::SUCCESS
        }
        Err(Found { seed, case, what }) => {
            eprintln!("violation: {what}");
            eprintln!("to see it again: cargo xtask bench motion-inject --seed {seed} --case {case}");
            ExitCode::FAILURE
        }
    }
}

fn inject(points: u64, seed: u64) -> Result<Tally, Found> {
    // a case whose axis cannot be armed any more offers fewer than its share
    let (next, offered, is_over) = (AtomicU64::new(0), AtomicU64::new(0), AtomicBool::new(false));
    let work = || -> Result<Tally, Found> {
        let mut sum = Tally::default();
        while !is_over.load(Ordering::Relaxed) && offered.load(Ordering::Relaxed) < points {
            let case = next.fetch_add(1, Ordering::Relaxed);
            let played = play(seed, case, POINTS_A_CASE);
            let tally = played
                .map_err(|what| Found { seed, case, what })
                .inspect_err(|_| is_over.store(true, Ordering::Relaxed))?;
            offered.fetch_add(tally.offered, Ordering::Relaxed);
            sum.add(&tally);
        }
        Ok(sum)
    };
    let workers = thread::available_parallelism().map_or(1, usize::from);
    thread::scope(|scope| {
        let workers: Vec<_> = (0..workers).map(|_| scope.spawn(work)).collect();
        let mut sum = Tally::default();
        for worker in workers {
            let tally = worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
            sum.add(&tally);
        }
        Ok(sum)
    })
}

impl Tally {
    fn add(&mut self, other: &Self) {
        self.offered += other.offered;
        self.beats += other.beats;
        self.knots += other.knots;
        self.series += other.series;
        self.stops += other.stops;
        self.leaps += other.leaps;
        self.rebuilt_played += other.rebuilt_played;
        self.halts += other.halts;
        let (sum, add) = (&mut self.counters, &other.counters);
        for (sum, add) in [
            (&mut sum.accepted, add.accepted),
            (&mut sum.not_armed, add.not_armed),
            (&mut sum.off_grid, add.off_grid),
            (&mut sum.late, add.late),
            (&mut sum.non_monotonic, add.non_monotonic),
            (&mut sum.gap, add.gap),
            (&mut sum.full, add.full),
            (&mut sum.latched, add.latched),
            (&mut sum.limit, add.limit),
            (&mut sum.rebuilt, add.rebuilt),
            (&mut sum.starved, add.starved),
        ] {
            *sum = sum.saturating_add(add);
        }
    }
}

fn report(tally: &Tally, seed: u64, json: bool) {
    let Tally { offered, beats, knots, counters, series, stops, leaps, rebuilt_played, halts } = tally;
    if json {
        let value = serde_json::json!({
            "seed": seed, "offered": offered, "beats": beats, "knots": knots, "series": series, "violations": 0,
            "accepted": counters.accepted, "late": counters.late, "full": counters.full, "gap": counters.gap,
            "non_monotonic": counters.non_monotonic, "off_grid": counters.off_grid, "limit": counters.limit,
            "latched": counters.latched, "rebuilt": counters.rebuilt, "starved": counters.starved,
            "stops_seen": stops, "leaps": leaps, "rebuilt_played": rebuilt_played, "halts": halts,
        });
        println!("{value}");
        return;
    }
    println!(
        "seed {seed}: {offered} points offered, {} accepted, in {series} series; {beats} beats and {knots} knots judged",
        counters.accepted
    );
    println!(
        "refused: {} late, {} full, {} gap, {} non-monotonic, {} off the grid, {} beyond a limit, {} latched",
        counters.late,
        counters.full,
        counters.gap,
        counters.non_monotonic,
        counters.off_grid,
        counters.limit,
        counters.latched
    );
    println!(
        "{} rebuilt, {rebuilt_played} of them played; {} series starved, {stops} stops seen, {leaps} leaps of time; {halts} halts and resumes",
        counters.rebuilt, counters.starved
    );
    println!("violations: 0");
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The same as the bench, shorter; every kind of refusal has to be among it.
    #[test]
    fn nothing_that_comes_breaks_a_limit() {
        let tally =
            inject(100_000, 1).unwrap_or_else(|Found { seed, case, what }| panic!("seed {seed}, case {case}: {what}"));
        let counters = tally.counters;
        let counts =
            [counters.accepted, counters.late, counters.full, counters.gap, counters.non_monotonic, counters.off_grid];
        assert!(counts.iter().all(|count| *count > 100), "{tally:?}");
        assert!(counters.limit > 20 && counters.rebuilt > 100 && counters.starved > 20, "{tally:?}");
        assert!(tally.stops > 20 && tally.leaps > 5 && tally.rebuilt_played > 100 && tally.halts > 100, "{tally:?}");
    }
}

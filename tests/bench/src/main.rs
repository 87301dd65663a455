//! Benchmarks, each a subcommand of `cargo xtask bench`: figures with their conditions, not tests.
//!
//! `runtime`: µs of CPU a message over 0 to 3 links. `overload`: commands beside telemetry at 120 % of a link, in virtual time. `scan`: a
//! thousand nodes with loops. `motion-error`: how exact splines are. `motion-inject`: any points at any time, and what axes make of them.
//! `clock`: how well clocks agree, in virtual time. `clock-pty`: a host's clock over a
//! real pseudo-terminal.
#![forbid(unsafe_code)]

mod clock;
mod motion;
mod overload;
#[cfg(unix)]
mod pty;
mod report;
mod runtime;
mod scan;

use clap::{Parser, Subcommand};
use std::path::PathBuf;
use std::process::ExitCode;

/// Benchmarks of the project; each prints its conditions.
#[derive(Parser)]
struct Args {
    #[command(subcommand)]
    bench: Option<Bench>,
}

#[derive(Subcommand)]
enum Bench {
    /// CPU time of a 12-byte message at 0, 1, 2 and 3 links, framing included and without.
    Runtime {
        /// Messages in each measurement.
        #[arg(long, default_value_t = 2_000_000)]
        messages: u32,
    },
    /// Commands beside telemetry at 120 % of a 300 kB/s link: losses and latency against idle.
    Overload {
        /// Virtual seconds of each case.
        #[arg(long, default_value_t = 10)]
        seconds: u64,
    },
    /// Clocks against the truth in virtual time: errors, bounds, times to settle, by hops and servo.
    Clock {
        /// Seeds of the four-hop cases; the larger networks take fewer.
        #[arg(long, default_value_t = 30)]
        seeds: u64,
        /// The figures as JSON.
        #[arg(long)]
        json: bool,
        /// A file for the time series of each case's first seed, as CSV.
        #[arg(long)]
        series: Option<PathBuf>,
    },
    /// What `clock`, `clock-pty` and the emulated images found, as one table and a page of plots.
    #[command(hide = true)]
    ClockReport(report::Options),
    /// A host's clock over a real pseudo-terminal against a process with a synthetic counter, idle and under CPU load.
    #[cfg(unix)]
    ClockPty {
        /// Seconds of each case.
        #[arg(long, default_value_t = 60)]
        seconds: u64,
        /// Skew of the other process's counter, parts per 10⁹.
        #[arg(long, default_value_t = 40_000, allow_negative_numbers = true)]
        skew_ppb: i32,
        /// The figures as JSON.
        #[arg(long)]
        json: bool,
    },
    /// What `clock-pty` starts beside itself.
    #[cfg(unix)]
    #[command(hide = true)]
    ClockPtyChild {
        role: pty::Role,
        #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
        skew_ppb: i32,
    },
    /// Evaluators of splines: errors against the exact value and against double precision, time a call.
    MotionError {
        /// The figures as JSON.
        #[arg(long)]
        json: bool,
    },
    /// Any points at any time: limits, stops and clocks of axes beside a judge of its own. Fails at the first violation.
    MotionInject {
        /// Points that are offered in all.
        #[arg(long, default_value_t = 10_000_000)]
        points: u64,
        /// Seed of all cases.
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// One case alone, as a violation names it.
        #[arg(long)]
        case: Option<u64>,
        /// The figures as JSON.
        #[arg(long)]
        json: bool,
    },
    /// What `motion-error`, `motion-inject`, the emulated images and the model of processors found, as one table.
    #[command(hide = true)]
    MotionReport(motion::ReportOptions),
    /// A scan of a random network with loops: virtual time, packets, host time.
    Scan {
        /// Devices.
        #[arg(long, default_value_t = 1_000)]
        nodes: usize,
        /// Links beyond those of a tree: each closes a loop.
        #[arg(long, default_value_t = 200)]
        loops: usize,
        /// Seed of the network.
        #[arg(long, default_value_t = 1)]
        seed: u64,
    },
}

fn main() -> ExitCode {
    match Args::parse().bench {
        Some(Bench::ClockReport(options)) => return report::run(&options),
        Some(Bench::Runtime { messages }) => runtime::run(messages),
        Some(Bench::Overload { seconds }) => overload::run(seconds),
        Some(Bench::Scan { nodes, loops, seed }) => scan::run(nodes, loops, seed),
        Some(Bench::MotionError { json }) => motion::error(json),
        Some(Bench::MotionReport(options)) => return motion::report(&options),
        Some(Bench::MotionInject { points, seed, case, json }) => return motion::inject(points, seed, case, json),
        Some(Bench::Clock { seeds, json, series }) => clock::run(seeds, &clock::Output::new(json, series)),
        #[cfg(unix)]
        Some(Bench::ClockPty { seconds, skew_ppb, json }) => pty::run(pty::Options { seconds, skew_ppb, json }),
        #[cfg(unix)]
        Some(Bench::ClockPtyChild { role, skew_ppb }) => pty::child(role, skew_ppb),
        None => {
            runtime::run(2_000_000);
            overload::run(10);
            scan::run(1_000, 200, 1);
            motion::error(false);
            clock::run(30, &clock::Output::new(false, None));
            #[cfg(unix)]
            pty::run(pty::Options { seconds: 60, skew_ppb: 40_000, json: false });
        }
    }
    ExitCode::SUCCESS
}

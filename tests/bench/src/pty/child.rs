//! The other processes of the measurement: the root at the terminal's other end, and those that only burn time.
//!
//! - **Walk:** [`Child::start`] → this program again, as [`Role::Root`] → its terminal's name and its counter's parameters on one line of
//!   standard output → it serves until its standard input ends, which it does with this process at the latest.

use super::{Fault, Pairing};
use clap::ValueEnum;
use fixed_math::time::{LocalTicks, Span};
use osap::core::HostCore;
use osap::error::OpenError;
use osap::link::{self, Clock, LinkOptions, LinkSpec};
use osap::network::{Network, RealNetwork};
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::process::{Command, Stdio};

/// What the root's counter showed at its start: far from zero, so that nothing agrees by chance.
const OFFSET: Span = Span::from_us(3_600_000_000);

/// What a process of this program shall be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Role {
    /// The node whose time is the network's.
    Root,
    /// Somebody who needs the processor.
    Burn,
}

/// A process that ends with this value.
struct Process(std::process::Child);

impl Process {
    fn start(role: &str, skew_ppb: i32) -> Result<Self, Fault> {
        let program = std::env::current_exe().map_err(|error| format!("this program has no name: {error}"))?;
        let child = Command::new(program)
            .args(["clock-pty-child", role, &format!("--skew-ppb={skew_ppb}")])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn();
        child.map(Self).map_err(|error| format!("cannot start a second process: {error}"))
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // its input ends first, which is its own reason to end
        drop(self.0.stdin.take());
        let _gone = self.0.kill();
        let _waited = self.0.wait();
    }
}

/// Processes that burn time.
pub(super) struct Burners(#[expect(dead_code, reason = "held, so that they run")] Vec<Process>);

impl Burners {
    pub(super) fn start(count: usize) -> Result<Self, Fault> {
        (0..count).map(|_| Process::start("burn", 0)).collect::<Result<_, _>>().map(Self)
    }
}

/// The root.
pub(super) struct Child {
    /// The terminal to open.
    pub(super) device: String,
    counter: Pairing,
    skew_ppb: i32,
    _process: Process,
}

impl Child {
    pub(super) fn start(skew_ppb: i32) -> Result<Self, Fault> {
        let mut process = Process::start("root", skew_ppb)?;
        let output = process.0.stdout.take().ok_or("the second process has no output")?;
        let mut line = String::new();
        BufReader::new(output).read_line(&mut line).map_err(|error| format!("the second process: {error}"))?;
        let words: Vec<&str> = line.split_whitespace().collect();
        let bad = || format!("the second process did not tell its terminal and its counter, but {line:?}");
        let [device, steps, kernel_ns, within_ns] = words[..] else { return Err(bad()) };
        let counter = Pairing {
            steps: steps.parse().map_err(|_| bad())?,
            kernel_ns: kernel_ns.parse().map_err(|_| bad())?,
            within_ns: within_ns.parse().map_err(|_| bad())?,
        };
        Ok(Self { device: device.to_owned(), counter, skew_ppb, _process: process })
    }

    /// What the root's counter, which is the network's time, shows when ours shows `at`, 1/256 µs.
    pub(super) fn truth_steps(&self, ours: Pairing, at: LocalTicks) -> i128 {
        let own_steps = i128::from(at.steps()) - i128::from(ours.steps);
        // 1,000 ns are 256 steps
        let kernel_ns = i128::from(ours.kernel_ns) + own_steps * 125 / 32;
        let since_ns = kernel_ns - i128::from(self.counter.kernel_ns);
        let shown_ns = since_ns + since_ns * i128::from(self.skew_ppb) / 1_000_000_000;
        i128::from(self.counter.steps) + shown_ns * 32 / 125
    }
}

/// Is one of the other processes, until the one that started it ends.
pub(crate) fn run(role: Role, skew_ppb: i32) {
    let done = match role {
        Role::Root => root(skew_ppb),
        Role::Burn => {
            std::thread::spawn(|| {
                let mut number = 1u64;
                loop {
                    number = std::hint::black_box(number.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1));
                }
            });
            until_the_parent_ends();
            Ok(())
        }
    };
    if let Err(fault) = done {
        eprintln!("{fault}");
    }
}

fn root(skew_ppb: i32) -> Result<(), Fault> {
    let clock = Clock::synthetic(OFFSET, skew_ppb);
    let counter = Pairing::of(|| clock.now())?;
    let mut device = String::new();
    let spec = "pty".parse::<LinkSpec>().map_err(|error| error.to_string())?;
    let mut network = RealNetwork::over(&["pty"], clock, |_, gateway, events, clock| {
        let listening = link::listen(&spec, gateway, events, clock, &LinkOptions::default());
        let handle = listening.map_err(|source| OpenError::Link { spec: "pty".to_owned(), source })?;
        handle.description.name.trim_start_matches("pty:").clone_into(&mut device);
        Ok(handle)
    })
    .map_err(|error| error.to_string())?;
    let offer = |core: &mut HostCore, _: LocalTicks| {
        core.set_root(0);
        true
    };
    network.drive(LocalTicks::ZERO, Box::new(offer)).map_err(|error| error.to_string())?;
    let Pairing { steps, kernel_ns, within_ns } = counter;
    println!("{device} {steps} {kernel_ns} {within_ns}");
    std::io::stdout().flush().map_err(|error| error.to_string())?;
    until_the_parent_ends();
    Ok(())
}

fn until_the_parent_ends() {
    // nothing is ever written to it: it ends
    let _ended = std::io::stdin().read(&mut [0]);
}

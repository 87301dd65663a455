//! Seeded fuzzing: `cargo xtask fuzz --inputs N --seed S --target frame|header|node|time|motion|all`.
//!
//! Each input is random bytes, a well-formed packet or frame, or one of these mutated. After each, the target's invariants are
//! asserted; a finding prints target, seed and input number, which repeat it. Finding nothing is reported with the count of inputs that got
//! past each gate, so that a fuzzer that tests only the front door is noticed.
#![forbid(unsafe_code)]

mod inputs;
mod motion;
mod targets;
mod time;

use clap::{Parser, ValueEnum};
use motion::MotionTarget;
use std::process::ExitCode;
use std::time::Instant;
use targets::{FrameTarget, HeaderTarget, NodeTarget, Target};
use time::TimeTarget;

/// What is fed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Which {
    Frame,
    Header,
    Node,
    Time,
    Motion,
    All,
}

/// Seeded fuzzing of frame, header, node ingress, the exchange of time and motion.
#[derive(Parser)]
struct Args {
    /// Inputs for each target.
    #[arg(long, default_value_t = 200_000)]
    inputs: u64,
    /// Seed of everything random; a finding names it.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// What is fed.
    #[arg(long, value_enum, default_value_t = Which::All)]
    target: Which,
}

fn main() -> ExitCode {
    let args = Args::parse();
    let mut targets: Vec<Box<dyn Target>> = Vec::new();
    let wants = |which| args.target == which || args.target == Which::All;
    if wants(Which::Frame) {
        targets.push(Box::new(FrameTarget::new()));
    }
    if wants(Which::Header) {
        targets.push(Box::new(HeaderTarget::new()));
    }
    if wants(Which::Node) {
        targets.push(Box::new(NodeTarget::new()));
    }
    if wants(Which::Time) {
        targets.push(Box::new(TimeTarget::new()));
    }
    if wants(Which::Motion) {
        targets.push(Box::new(MotionTarget::new()));
    }
    let mut findings = 0;
    for mut target in targets {
        let started = Instant::now();
        let found = run(target.as_mut(), args.inputs, args.seed);
        findings += u32::from(found);
        println!(
            "{}: {} inputs, seed {}, {:.1} s: {}; {}",
            target.name(),
            args.inputs,
            args.seed,
            started.elapsed().as_secs_f64(),
            if found { "FINDING" } else { "no finding" },
            target.reached(),
        );
    }
    if findings == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Feeds `inputs` inputs; says whether one broke an invariant, which was printed then.
fn run(target: &mut dyn Target, inputs: u64, seed: u64) -> bool {
    let mut source = inputs::Source::new(seed);
    for number in 0..inputs {
        let bytes = source.next_input();
        let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| target.feed(bytes)));
        let what = match outcome {
            Ok(Ok(())) => continue,
            Ok(Err(broken)) => broken,
            Err(_) => "a panic".to_owned(),
        };
        println!("{}: seed {seed}, input {number}: {what}; bytes {bytes:02x?}", target.name());
        return true;
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A target with a planted fault, to see that the harness finds and reports one.
    struct Faulty(u64);
    impl Target for Faulty {
        fn name(&self) -> &'static str {
            "faulty"
        }
        fn feed(&mut self, bytes: &[u8]) -> Result<(), String> {
            self.0 += 1;
            if bytes.first() == Some(&5) && bytes.get(5).is_some_and(|b| b >> 6 == 2) {
                Err("planted".into())
            } else {
                Ok(())
            }
        }
        fn reached(&self) -> String {
            String::new()
        }
    }

    #[test]
    fn a_planted_fault_is_found() {
        let mut target = Faulty(0);
        assert!(run(&mut target, 10_000, 1));
        assert!(target.0 < 10_000);
    }

    /// The same seed feeds the same bytes, another one others.
    #[test]
    fn inputs_repeat_with_their_seed() {
        let all = |seed| {
            let mut source = inputs::Source::new(seed);
            (0..200).map(|_| source.next_input().to_vec()).collect::<Vec<_>>()
        };
        assert_eq!(all(3), all(3));
        assert_ne!(all(3), all(4));
    }

    /// The real targets hold for a short run, and inputs get as far as each gate.
    #[test]
    fn the_targets_hold_and_are_reached() {
        let mut node = NodeTarget::new();
        assert!(!run(&mut node, 20_000, 7));
        assert!(node.accepted() > 2_000, "{}", node.reached());
        assert!(node.causes_seen() >= 20, "{}", node.reached());
        let mut frame = FrameTarget::new();
        assert!(!run(&mut frame, 5_000, 7));
        assert!(frame.whole() > 500, "{}", frame.reached());
        let mut header = HeaderTarget::new();
        assert!(!run(&mut header, 5_000, 7));
        assert!(header.routable() > 1_000, "{}", header.reached());
        let mut time = TimeTarget::new();
        assert!(!run(&mut time, 20_000, 7));
        let (believed, refused) = time.outcomes();
        assert!(believed > 2_000 && refused > 200, "{}", time.reached());
        let mut motion = MotionTarget::new();
        assert!(!run(&mut motion, 5_000, 7));
        let (done, refused, moved) = motion.outcomes();
        assert!(done > 300 && refused > 300 && moved > 1_000, "{}", motion.reached());
    }
}

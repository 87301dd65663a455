//! `cargo xtask hil NAME`: real images in emulators and on boards.
//!
//! - **Walk:** the command line → a [`Scenario`] → its report: text or a document on stdout, closing lines that add up as those of
//!   `cargo test` do.
#![forbid(unsafe_code)]

use clap::{CommandFactory, Parser, Subcommand};
use osap_hil::images::Places;
use osap_hil::report::{Failure, Report};
use osap_hil::scenario::{Context, Scenario};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

/// Real images in emulators, and on boards where they are attached.
#[derive(Parser)]
#[command(name = "cargo xtask hil", bin_name = "cargo xtask hil")]
struct Args {
    /// Folder of the images, instead of where Cargo puts them
    #[arg(long, value_name = "DIR", global = true)]
    images: Option<PathBuf>,
    /// Where random numbers begin
    #[arg(long, default_value_t = 1, global = true)]
    seed: u64,
    /// One JSON document on stdout
    #[arg(long, global = true)]
    json: bool,
    /// A real board in place of an emulated one: `rp2040-pico=/dev/ttyACM0`
    #[arg(long, value_name = "IMAGE=TTY", global = true, value_parser = board)]
    board: Option<PathBuf>,
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Subcommand)]
enum Command {
    /// Says what there is
    List,
    /// Runs all that is fit for CI, and adds up
    All,
    #[command(flatten)]
    Scenario(Scenario),
}

fn main() -> ExitCode {
    let args = Args::parse();
    let context = Context { places: Places::new(args.images), seed: args.seed, board: args.board };
    let scenarios = match args.command {
        None | Some(Command::List) => {
            list();
            return ExitCode::SUCCESS;
        }
        Some(Command::All) => Scenario::all(),
        Some(Command::Scenario(scenario)) => vec![scenario],
    };
    let (mut failed, mut documents) = (0, Vec::new());
    for scenario in &scenarios {
        let name = scenario.name();
        eprintln!("hil: {name}, seed {}", context.seed);
        let began = Instant::now();
        let report = scenario.run(&context).unwrap_or_else(ended_early);
        failed += report.counts().1;
        let closing = report.closing(name, began.elapsed().as_secs_f64());
        if args.json {
            eprint!("{closing}");
            documents.push(report.document(name));
        } else {
            print!("{}\n{closing}", report.text);
        }
        if report.counts().1 > 0 {
            eprintln!("hil: {name} failed; to see it again: cargo xtask hil {name} --seed {}", context.seed);
        }
    }
    match &documents[..] {
        [] => {}
        [one] => println!("{one:#}"),
        many => println!("{:#}", serde_json::Value::from(many.to_vec())),
    }
    if failed == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// The serial port of `rp2040-pico=TTY`.
fn board(text: &str) -> Result<PathBuf, String> {
    match text.split_once('=') {
        Some(("rp2040-pico", path)) if !path.is_empty() => Ok(path.into()),
        _ => Err("a board is given as its image and where it is plugged in: rp2040-pico=/dev/ttyACM0".to_owned()),
    }
}

/// A scenario that could not go on: failed, or not run at all.
fn ended_early(failure: Failure) -> Report {
    let mut report = Report::new();
    match failure {
        Failure::NotRun(why) => report.not_run("all of it", why),
        Failure::Failed(why) => report.check(false, why),
    }
    report
}

fn list() {
    for command in Args::command().get_subcommands() {
        println!("{:<12} {}", command.get_name(), command.get_about().map(ToString::to_string).unwrap_or_default());
    }
}

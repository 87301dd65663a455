//! `cargo xtask`: the only build driver. What a person, a hook or CI runs goes through here.
//!
//! This file is the command line and nothing else: [`stages`] has the commands, [`setup`] what a machine needs,
//! [`toolchain`] which compiler builds for a chip, [`images`] what is built, [`size`] what it takes, [`flash`] how it comes onto a board, [`hil`] how emulators run it, [`clock`] how clocks are measured, [`motion`] how motion is, [`report`] what `test` closes with, [`tally`]
//! how tests are counted, [`run`] how programs are started, and [`picture`] how the demonstration is drawn.
#![forbid(unsafe_code)]

mod clock;
mod elf;
mod flash;
mod hil;
mod images;
mod motion;
mod picture;
mod report;
mod run;
mod setup;
mod size;
mod stages;
mod system;
mod tally;
mod toolchain;
mod uf2;

use std::process::ExitCode;

use clap::{Parser, Subcommand, ValueEnum};

#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask", about = "The only build driver of this repository")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Set up what is needed, run every check, and close with a table and a count
    Test,
    /// Install what the checks need: components, targets, packages
    Setup,
    /// Format the sources
    Fmt {
        /// Change nothing; fail where something is not formatted
        #[arg(long)]
        check: bool,
    },
    /// Run clippy on everything, warnings denied
    Lint,
    /// Build the cores for bare-metal targets
    Nostd,
    /// Build an image for its chip and say where it is
    Build {
        /// Folder of the image below rtic-firmware/, or `all`
        image: String,
        #[command(flatten)]
        features: FeatureArguments,
    },
    /// Build an image bare, as a node and with each feature, and say what each takes of flash and RAM
    Size {
        /// Folder of the image below rtic-firmware/, or `all`
        #[arg(default_value = "all")]
        image: String,
        /// Print one JSON document
        #[arg(long)]
        json: bool,
        /// Name this many of the largest functions, statics and constants of the image with all its features
        #[arg(long, value_name = "COUNT", default_value_t = 0)]
        largest: usize,
    },
    /// Check the rules of the repository: dependencies, clauses, sizes, words
    Tidy,
    /// Put an image onto the board that is attached, or say what is missing for it
    Flash {
        /// Folder of the image below rtic-firmware/
        image: String,
        /// Go through this debug probe, `VID:PID` or `VID:PID:SERIAL`
        #[arg(long, value_name = "SELECTOR")]
        probe: Option<String>,
        /// Copy to this folder, where the boot ROM's drive is mounted
        #[arg(long, value_name = "PATH", conflicts_with = "probe")]
        drive: Option<std::path::PathBuf>,
    },
    /// Run the images in emulators: what is needed is installed and built, the harness does the rest
    Hil {
        /// What to run, and what else the harness takes; without a name it tells what there is
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Feed random and mutated packets to the parsers and the node
    Fuzz {
        /// How many inputs
        #[arg(long, default_value_t = 1_000_000)]
        inputs: u64,
        /// Where the random numbers start; the same seed gives the same inputs
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// What to feed
        #[arg(long, value_enum, default_value_t = FuzzTarget::All)]
        target: FuzzTarget,
    },
    /// Measure; without a name all benchmarks
    Bench {
        /// A benchmark's name, and what else it takes
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Measure clocks in the simulator, on emulated images and on this computer: one table, and plots
    Clock {
        /// Fewer seeds and shorter runs
        #[arg(long)]
        quick: bool,
        /// A page of plots to write
        #[arg(long, value_name = "FILE")]
        html: Option<std::path::PathBuf>,
        /// A JSON document to write
        #[arg(long, value_name = "FILE")]
        json: Option<std::path::PathBuf>,
    },
    /// Measure motion: cycles, shares of a processor, jitter, errors and injected points, as one table
    Motion {
        /// A hundredth of the injected points
        #[arg(long)]
        quick: bool,
        /// A page to write
        #[arg(long, value_name = "FILE")]
        html: Option<std::path::PathBuf>,
        /// A JSON document to write
        #[arg(long, value_name = "FILE")]
        json: Option<std::path::PathBuf>,
    },
    /// Draw the output of `osap demo` to docs/demo.svg
    DemoPicture {
        /// Write nothing; fail where the committed picture differs
        #[arg(long)]
        check: bool,
    },
    /// Write man pages and shell completions below target/
    Docs,
}

/// Which features of an image to build.
#[derive(clap::Args)]
struct FeatureArguments {
    /// Features to add, separated by commas
    #[arg(long, value_delimiter = ',')]
    features: Vec<String>,
    /// Leave the default features out
    #[arg(long)]
    no_default_features: bool,
}

impl From<FeatureArguments> for images::Features {
    fn from(arguments: FeatureArguments) -> Self {
        Self { no_default: arguments.no_default_features, added: arguments.features }
    }
}

/// What the fuzzer can feed.
#[derive(Clone, Copy, ValueEnum)]
enum FuzzTarget {
    Frame,
    Header,
    Node,
    All,
}

fn main() -> ExitCode {
    let result = match Cli::parse().command {
        Command::Test => return stages::test(),
        Command::Setup => setup::run().complete(),
        Command::Fmt { check } => stages::fmt(check),
        Command::Lint => stages::lint(),
        Command::Nostd => stages::nostd(),
        Command::Build { image, features } => images::build(&image, &features.into()),
        Command::Flash { image, probe, drive } => flash::flash(&image, &flash::Wanted { probe, drive }),
        Command::Size { image, json, largest } => size::size(&image, json, largest),
        Command::Tidy => stages::tidy(),
        Command::Hil { arguments } => hil::hil(&arguments),
        Command::Fuzz { inputs, seed, target } => {
            let target = target.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned());
            stages::fuzz(inputs, seed, &target)
        }
        Command::Bench { arguments } => stages::bench(&arguments),
        Command::Clock { quick, html, json } => clock::clock(quick, html, json),
        Command::Motion { quick, html, json } => motion::motion(quick, html, json),
        Command::DemoPicture { check } => picture::demo(check),
        Command::Docs => stages::docs(),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error @ run::Error::NotRunHere { .. }) => {
            println!("{error}");
            ExitCode::FAILURE
        }
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_sound_and_every_command_has_its_line_of_help() {
        let command = Cli::command();
        command.clone().debug_assert();
        for subcommand in command.get_subcommands() {
            let about = subcommand.get_about().map(ToString::to_string).unwrap_or_default();
            assert!(!about.is_empty() && !about.contains('\n'), "{}: {about:?}", subcommand.get_name());
        }
    }

    #[test]
    fn what_a_benchmark_takes_is_passed_on_untouched() {
        let cli = Cli::parse_from(["xtask", "bench", "route", "--seconds", "2"]);
        let Command::Bench { arguments } = cli.command else { panic!("not the bench command") };
        assert_eq!(arguments, ["route", "--seconds", "2"]);
    }
}

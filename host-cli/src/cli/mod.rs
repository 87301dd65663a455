//! The command `osap`: one file a command, and what they have in common.
//!
//! - **Walk:** `main` → [`Cli`] (the one definition that help, completions and man pages come from) → a command's `run` → the
//!   library → [`Output`].
//! - **Invariants:** a command's `run` writes only to its [`Output`] and ends in an [`Exit`] or a [`CliError`], so that tests can call it.
//!   It decides nothing about the network: what it tells comes from the library.
//! - **Common:** [`exit`] codes, [`error`]s with their next step, [`output`] sinks, [`links`], [`devices`], [`table`]s, [`progress`], [`wait`]ing.

pub mod devices;
pub mod error;
pub mod exit;
pub mod links;
pub mod output;
pub mod progress;
pub mod table;
pub mod wait;

pub mod bench;
pub mod clock;
pub mod completions;
pub mod counters;
pub mod debug;
pub mod decode;
pub mod demo;
pub mod info;
pub mod key;
pub mod man;
pub mod map;
pub mod maxl;
pub mod name;
pub mod ping;
pub mod scan;
pub mod sim;

pub use error::CliError;
pub use exit::Exit;
pub use output::Output;

use clap::{CommandFactory, Parser, Subcommand};
use std::ffi::OsString;
use std::io::{BufWriter, IsTerminal, Write};

/// Widest that help is drawn.
const HELP_COLUMNS_MAX: usize = 100;

/// Finds, shows, times and names the devices of a machine
#[derive(Debug, Parser)]
#[command(
    name = "osap",
    version,
    max_term_width = HELP_COLUMNS_MAX,
    arg_required_else_help = true,
    infer_long_args = false,
    after_help = Exit::table(),
)]
pub struct Cli {
    /// Writes data as JSON: one document a line, each with its "schema"
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::DemoArgs),
    Scan(scan::ScanArgs),
    Sim(sim::SimArgs),
    Map(map::MapArgs),
    Ping(ping::PingArgs),
    Info(info::InfoArgs),
    Name(name::NameArgs),
    Counters(counters::CountersArgs),
    Debug(debug::DebugArgs),
    Bench(bench::BenchArgs),
    Clock(clock::ClockArgs),
    Maxl(maxl::MaxlArgs),
    Decode(decode::DecodeArgs),
    Key(key::KeyArgs),
    Completions(completions::CompletionsArgs),
    Man(man::ManArgs),
}

/// The whole definition, for help, completions and man pages.
#[must_use]
pub fn definition() -> clap::Command {
    Cli::command()
}

/// Runs the process's own command line with its own streams.
#[must_use]
pub fn main() -> Exit {
    let progress = std::io::stderr().is_terminal();
    // Both take colour out where it goes to no terminal, or where NO_COLOR asks for it.
    let mut out = BufWriter::new(anstream::stdout().lock());
    let mut talk = anstream::stderr();
    run(std::env::args_os(), &mut out, &mut talk, progress)
}

/// Runs a command line: `arguments` with the program's name first, data to `out`, talk to `talk`, bars where `progress`.
pub fn run<A: Into<OsString> + Clone>(
    arguments: impl IntoIterator<Item = A>,
    out: &mut dyn Write,
    talk: &mut dyn Write,
    progress: bool,
) -> Exit {
    let arguments: Vec<OsString> = arguments.into_iter().map(Into::into).collect();
    let cli = match Cli::try_parse_from(&arguments) {
        Ok(cli) => cli,
        // clap tells nothing of a command line that it does not take, not even that it wanted documents
        Err(error) if error.use_stderr() && wants_documents(&arguments) => {
            Output::new(out, talk, true, progress).fail(&misused(&error));
            return Exit::Usage;
        }
        Err(error) => return tell(&error, out, talk),
    };
    let mut output = Output::new(out, talk, cli.json, progress);
    let done = dispatch(&cli.command, &mut output);
    let done = output.flush().and(done);
    done.unwrap_or_else(|error| {
        output.fail(&error);
        error.exit()
    })
}

fn dispatch(command: &Command, output: &mut Output<'_>) -> Result<Exit, CliError> {
    match command {
        Command::Demo(args) => demo::run(args, output),
        Command::Scan(args) => scan::run(args, output),
        Command::Sim(args) => sim::run(args, output),
        Command::Map(args) => map::run(args, output),
        Command::Ping(args) => ping::run(args, output),
        Command::Info(args) => info::run(args, output),
        Command::Name(args) => name::run(args, output),
        Command::Counters(args) => counters::run(args, output),
        Command::Debug(args) => debug::run(args, output),
        Command::Bench(args) => bench::run(args, output),
        Command::Clock(args) => clock::run(args, output),
        Command::Maxl(args) => maxl::run(args, output),
        Command::Decode(args) => decoded(args, output),
        Command::Key(args) => key::run(args, output),
        Command::Completions(args) => completions::run(args, output),
        Command::Man(args) => man::run(args, output),
    }
}

/// Explains bytes; what is wrong with the digits themselves is a matter of usage.
fn decoded(args: &decode::DecodeArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    let json = output.json();
    match decode::run(args, json, output.data()) {
        Ok(decode::Outcome::Clean) => Ok(Exit::Ok),
        Ok(decode::Outcome::Faulty) => Ok(Exit::Differs),
        Err(decode::DecodeError::Output(error)) => Err(error.into()),
        Err(error) => {
            let exit = if matches!(error, decode::DecodeError::Input(_)) { Exit::Io } else { Exit::Usage };
            let next = "give bytes as pairs of hexadecimal digits: `osap decode 05 e8 03 40 00 41 c0 18 01 00 2a`";
            Err(CliError::new(exit, error.to_string(), "the digits given", next))
        }
    }
}

/// Whether `--json` stands among the options; what follows `--` is none.
fn wants_documents(arguments: &[OsString]) -> bool {
    arguments.iter().take_while(|argument| *argument != "--").any(|argument| argument == "--json")
}

/// clap's complaint as an error of ours: its first paragraph, the rest of which repeats the usage.
fn misused(error: &clap::Error) -> CliError {
    let text = error.render().to_string();
    let first = text.split("\n\n").next().unwrap_or_default().split_whitespace().collect::<Vec<_>>().join(" ");
    let what = first.strip_prefix("error: ").unwrap_or(&first);
    CliError::new(
        Exit::Usage,
        what,
        "the command line",
        "`osap --help` shows the commands, `osap COMMAND --help` their options",
    )
}

/// What clap has to say: help and version are data, the rest is talk.
fn tell(error: &clap::Error, out: &mut dyn Write, talk: &mut dyn Write) -> Exit {
    let text = error.render().ansi().to_string();
    if error.use_stderr() {
        let _ = write!(talk, "{text}");
        return Exit::Usage;
    }
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()).map_err(CliError::from) {
        Ok(()) => Exit::Ok,
        Err(error) => error.exit(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_definition_is_sound() {
        definition().debug_assert();
    }

    #[test]
    fn help_is_data_and_a_wrong_option_is_talk() {
        let (mut out, mut talk) = (Vec::new(), Vec::new());
        assert_eq!(run(["osap", "--help"], &mut out, &mut talk, false), Exit::Ok);
        assert!(talk.is_empty() && String::from_utf8(out).unwrap().contains("Exit codes:"));
        let (mut out, mut talk) = (Vec::new(), Vec::new());
        assert_eq!(run(["osap", "scan", "--colour"], &mut out, &mut talk, false), Exit::Usage);
        assert!(out.is_empty() && !talk.is_empty());
    }

    /// A sink whose reader has gone.
    struct Gone;

    impl Write for Gone {
        fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
            Err(std::io::ErrorKind::BrokenPipe.into())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_broken_pipe_is_quiet() {
        for arguments in [&["osap", "--help"][..], &["osap", "completions", "bash"]] {
            let mut talk = Vec::new();
            assert_eq!(run(arguments, &mut Gone, &mut talk, false), Exit::Ok);
            assert_eq!(String::from_utf8(talk).unwrap(), "");
        }
    }
}

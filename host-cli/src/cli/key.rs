//! `osap key generate FILE`: the secret that both ends of a link beyond this machine share, `[LNK-05]`.

use super::{CliError, Exit, Output};
use crate::link::{Key, KeyError};
use clap::{Args, Subcommand};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Makes keys for links beyond this machine
#[derive(Debug, Args)]
#[command(arg_required_else_help = true)]
pub struct KeyArgs {
    #[command(subcommand)]
    command: KeyCommand,
}

#[derive(Debug, Subcommand)]
enum KeyCommand {
    /// Writes a new random key to a new file that only you can read
    #[command(after_help = "Example:\n  osap key generate machine.key\n  \
                            osap sim printer --listen tcp:0.0.0.0:4100 --key machine.key")]
    Generate {
        /// File to write; it must not exist
        file: PathBuf,
    },
}

#[derive(Serialize)]
struct Document<'a> {
    file: &'a Path,
}

pub(super) fn run(args: &KeyArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    let KeyCommand::Generate { file } = &args.command;
    Key::generate().and_then(|key| key.save_new(file)).map_err(|error| failed(file, &error))?;
    if output.json() {
        output.document("key-generate", &Document { file })?;
    } else {
        output.line(file.display())?;
        output.say("Copy it to the other end by a way you trust, and give both ends --key with it.");
    }
    Ok(Exit::Ok)
}

/// What failed about a key, with a next step.
pub(super) fn failed(file: &Path, error: &KeyError) -> CliError {
    match error {
        KeyError::File { source, .. } => CliError::file(file, "use the key file", source),
        KeyError::Digits { .. } => {
            let next = format!("make one with `osap key generate {}.new`", file.display());
            CliError::new(Exit::Usage, error.to_string(), file.display().to_string(), next)
        }
        KeyError::Random { .. } => {
            let next = "run it where the system has a source of random numbers";
            CliError::new(Exit::Io, error.to_string(), "the system", next)
        }
    }
}

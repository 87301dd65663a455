//! `osap completions SHELL`: what a shell needs to complete our command lines.

use super::{CliError, Exit, Output, definition};
use clap::Args;
use clap_complete::Shell;
use serde::Serialize;

/// Writes a completion script for a shell
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  osap completions bash > ~/.local/share/bash-completion/completions/osap\n  \
                        osap completions zsh > ~/.zfunc/_osap")]
pub struct CompletionsArgs {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

#[derive(Serialize)]
struct Document {
    shell: String,
    script: String,
}

pub(super) fn run(args: &CompletionsArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut definition(), "osap", &mut script);
    let script = String::from_utf8_lossy(&script).into_owned();
    if output.json() {
        output.document("completions", &Document { shell: args.shell.to_string(), script })?;
    } else {
        output.text(script)?;
    }
    Ok(Exit::Ok)
}

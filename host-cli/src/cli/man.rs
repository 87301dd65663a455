//! `osap man --out DIR`: man pages, from the definition that help comes from.

use super::{CliError, Exit, Output, definition};
use clap::Args;
use serde::Serialize;
use std::path::PathBuf;

/// Writes the man pages of osap and of each command
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  osap man --out ~/.local/share/man/man1 && man osap-scan")]
pub struct ManArgs {
    /// Folder to write them to; made where it does not exist
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

#[derive(Serialize)]
struct Document {
    pages: Vec<PathBuf>,
}

/// A page is read by itself, so that each tells the codes; help has them once, on `osap --help`.
fn with_codes(command: clap::Command) -> clap::Command {
    let own = command.get_after_help().map(|text| format!("{text}\n\n")).unwrap_or_default();
    command.after_help(own + &Exit::table())
}

pub(super) fn run(args: &ManArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    let failed = |error| CliError::file(&args.out, "write the man pages", &error);
    std::fs::create_dir_all(&args.out).map_err(failed)?;
    // Nobody needs a page that says "osap help scan" is the same as "osap scan --help".
    let definition = definition().disable_help_subcommand(true).mut_subcommands(with_codes);
    clap_mangen::generate_to(definition, &args.out).map_err(failed)?;
    let mut pages = Vec::new();
    for entry in std::fs::read_dir(&args.out).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let is_ours = path.file_name().and_then(|name| name.to_str()).is_some_and(|name| name.starts_with("osap"));
        if is_ours && path.extension().is_some_and(|extension| extension == "1") {
            pages.push(path);
        }
    }
    pages.sort();
    if output.json() {
        output.document("man", &Document { pages })?;
    } else {
        for page in pages {
            output.line(page.display())?;
        }
    }
    Ok(Exit::Ok)
}

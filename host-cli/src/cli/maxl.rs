//! `osap maxl`: motion without a machine, by the devices' own arithmetic.
//!
//! - **Walk:** a file → `input` → [`crate::motion`] → CSV, a table or a document; `chart` → `plot` in the terminal, `html` for a page.
//! - **Invariant:** what is shown of a spline is what a device plays: it comes from the same code.

mod chart;
mod error;
mod eval;
mod html;
mod input;
mod plot;

use super::{CliError, Exit, Output};
use crate::motion::curve::Ends;
use clap::{Args, Subcommand, ValueEnum};

/// Evaluates splines as devices do, and finds the interval that a path needs
#[derive(Debug, Args)]
#[command(arg_required_else_help = true)]
pub struct MaxlArgs {
    #[command(subcommand)]
    command: MaxlCommand,
}

#[derive(Debug, Subcommand)]
enum MaxlCommand {
    Eval(eval::EvalArgs),
    Error(error::ErrorArgs),
}

pub(super) fn run(args: &MaxlArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    match &args.command {
        MaxlCommand::Eval(args) => eval::run(args, output),
        MaxlCommand::Error(args) => error::run(args, output),
    }
}

/// How the ends are treated; each command says what that means to it.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum EndsArg {
    Repeat,
    Open,
}

impl From<EndsArg> for Ends {
    fn from(ends: EndsArg) -> Self {
        match ends {
            EndsArg::Repeat => Self::Repeat,
            EndsArg::Open => Self::Open,
        }
    }
}

/// A number with three digits that count, as short as it can be said.
fn figure(value: f64) -> String {
    let size = value.abs();
    if size == 0.0 {
        return "0".to_owned();
    }
    if !(1e-4..1e7).contains(&size) {
        return format!("{value:.2e}");
    }
    #[expect(clippy::cast_possible_truncation, reason = "-4 to 6")]
    let whole_digits = size.log10().floor() as i32 + 1;
    let digits = usize::try_from(3 - whole_digits).unwrap_or(0);
    format!("{value:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_three_digits() {
        for (value, text) in [
            (0.0, "0"),
            (0.000_055, "5.50e-5"),
            (0.003_496, "0.00350"),
            (-1.0, "-1.00"),
            (99.96, "100.0"),
            (12_345.6, "12346"),
            (1.5e12, "1.50e12"),
        ] {
            assert_eq!(figure(value), text);
        }
    }
}

//! `osap clock watch`: how the clocks settle, and what is refused on the way, `[TIM-09]`, `[TIM-12]`.
//!
//! - **Walk:** all clocks, again and again → a table that is drawn in place on a terminal, lines elsewhere, a document a look with `--json`
//!   → at the end the last table, what was refused, and the plot.

use super::plot::{History, draw};
use super::units::{parse_seconds, parse_span};
use super::{documents, html, read, seconds, table};
use crate::cli::devices::Scanned;
use crate::cli::links::LinkArgs;
use crate::cli::output::printable;
use crate::cli::table::Table;
use crate::cli::wait::Until;
use crate::cli::{CliError, Exit, Output};
use crate::clocks::{Clocks, micros};
use crate::map::NetworkMap;
use clap::Args;
use fixed_math::time::Span;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;
use std::io::IsTerminal as _;
use std::path::PathBuf;
use std::time::Duration;

/// Least time between two looks: each asks every device several questions.
const INTERVAL_MIN: Span = Span::from_us(20_000);

/// Shows offset, skew, bound, tier and round trip of each clock as they settle
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  osap clock watch --for 10s\n  osap clock watch --for 60s --html clocks.html\n  osap clock watch --link sim:printer --for 2s --json"
)]
pub(super) struct WatchArgs {
    /// Ends after this time; a bare number is seconds
    #[arg(long = "for", value_name = "TIME", value_parser = parse_seconds)]
    watch_for: Option<Span>,
    /// Time between two looks, at least 20ms
    #[arg(long, value_name = "TIME", default_value = "250ms", value_parser = parse_span)]
    interval: Span,
    /// Writes a page with plots to this file at the end
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    #[command(flatten)]
    links: LinkArgs,
}

#[derive(Serialize)]
struct Document<'a> {
    /// Since the watch began, µs.
    at_us: u64,
    root: Option<String>,
    devices: Vec<super::DeviceDocument<'a>>,
}

pub(super) fn run(args: &WatchArgs, output: &mut Output<'_>) -> Result<Exit, CliError> {
    let mut scanned = Scanned::open(&args.links, output)?;
    let labels: Vec<String> = scanned.map.devices.iter().map(|device| printable(&device.label())).collect();
    let mut history = History::of(labels.len());
    let picture = Picture::over(output);
    if args.watch_for.is_none() {
        output.say("Watching; Ctrl-C ends it.");
    }
    let last = follow(args, &mut scanned, &mut history, &picture, output)?;
    drop(picture);
    if !output.json() {
        let tables = tables(&scanned.map, &last);
        for (heading, table) in &tables {
            output.line(heading)?;
            output.text(table)?;
            output.line("")?;
        }
        output.text(draw(&labels, &history))?;
    }
    if let Some(file) = &args.html {
        let title = format!("Clocks of {}", args.links.place());
        let page = html::page(&title, &labels, &history, &tables(&scanned.map, &last))
            .map_err(|error| CliError::file(file, "draw the page", &std::io::Error::other(error)))?;
        std::fs::write(file, page).map_err(|error| CliError::file(file, "write the page", &error))?;
        output.say(format!("The page is {}", file.display()));
    }
    scanned.finish(Exit::Ok)
}

/// Looks until the end, and gives what was seen last.
fn follow(
    args: &WatchArgs,
    scanned: &mut Scanned<'_>,
    history: &mut History,
    picture: &Picture,
    output: &mut Output<'_>,
) -> Result<Clocks, CliError> {
    let until = Until::new(None);
    let start = scanned.session.network().now();
    let interval = args.interval.max(INTERVAL_MIN);
    // virtual time passes as fast as it can, but for a person who watches without an end
    let pace = if scanned.session.network().is_simulated() && args.watch_for.is_none() {
        Duration::from_micros(interval.as_us_ceil())
    } else {
        Duration::ZERO
    };
    let mut next = start;
    loop {
        let clocks = read(scanned, &args.links)?;
        let at = clocks.at.since(start);
        #[expect(clippy::cast_precision_loss, reason = "for plots")]
        history.push(at.steps() as f64 / 256e6, &clocks);
        if output.json() {
            let root = clocks.root().map(|root| root.to_string());
            let devices = documents(&scanned.map, &clocks);
            output.document("clock-watch", &Document { at_us: at.steps() / 256, root, devices })?;
        } else if let Some(bar) = &picture.0 {
            bar.set_message(format!("{}\n{}", seconds(at), table::devices(&scanned.map, &clocks).plain()));
            bar.tick();
        } else {
            lines(&scanned.map, &clocks, at, output)?;
        }
        let is_over = args.watch_for.is_some_and(|end| at + interval > end);
        if is_over || !until.pause(pace) {
            return Ok(clocks);
        }
        next = (next + interval).max(clocks.at);
        let now = scanned.session.network().now();
        let pause = scanned.session.network().pause(next.since(now));
        pause.map_err(|error| args.links.stopped(&error))?;
    }
}

/// A look as lines, one for each device.
fn lines(map: &NetworkMap, clocks: &Clocks, at: Span, output: &mut Output<'_>) -> Result<(), CliError> {
    for (device, clock) in map.devices.iter().zip(&clocks.devices) {
        let label = printable(&device.label());
        let text = match clock {
            Err(_) => "no answer".to_owned(),
            Ok(clock) => format!(
                "tier {}, offset {}, bound {}, skew {} ppm, round trip {}, {}",
                table::tier(clock.status.tier),
                micros(clock.control.offset_steps.into()),
                table::bound(clock),
                table::ppm(clock.control.skew_ppb),
                micros(clock.control.round_trip_steps.into()),
                if clock.status.is_settled { "settled" } else { "not settled" },
            ),
        };
        output.line(format!("{}  {label}: {text}", seconds(at)))?;
    }
    output.flush()
}

/// All tables that have something to say.
fn tables(map: &NetworkMap, clocks: &Clocks) -> Vec<(&'static str, Table)> {
    let troubles =
        table::troubles(map, clocks).map(|table| ("Links with requests unanswered or replies refused", table));
    let refusals = table::refusals(map, clocks).map(|table| ("Replies about time that were refused, by cause", table));
    [Some(("Clocks", table::devices(map, clocks))), troubles, refusals].into_iter().flatten().collect()
}

/// The table drawn in place, where somebody looks at a terminal; gone when it is dropped.
struct Picture(Option<ProgressBar>);

impl Picture {
    fn over(output: &Output<'_>) -> Self {
        let is_seen = output.progress() && !output.json() && std::io::stdout().is_terminal();
        Self(is_seen.then(|| {
            let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
            // the template is ours: were it wrong, the default look would do
            if let Ok(style) = ProgressStyle::with_template("{msg}") {
                bar.set_style(style);
            }
            bar
        }))
    }
}

impl Drop for Picture {
    fn drop(&mut self) {
        if let Some(bar) = &self.0 {
            bar.finish_and_clear();
        }
    }
}

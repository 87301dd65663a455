//! A bar or a spinner on the terminal, for what takes more than a second; nothing where nobody looks.
//!
//! - **Invariant:** it is drawn on the talk's side only, and gone when the command's own output comes.

use super::output::Output;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::time::Duration;

/// How often a spinner turns.
const TICK: Duration = Duration::from_millis(100);
/// How often a bar is drawn.
const DRAWS_PER_S: u8 = 10;

/// What is drawn until it is dropped.
#[derive(Debug)]
pub struct Progress(ProgressBar);

impl Progress {
    /// A spinner with a text, for work of unknown length.
    #[must_use]
    pub fn spinner(output: &Output<'_>, text: &str) -> Self {
        let bar = ProgressBar::with_draw_target(None, target(output)).with_message(text.to_owned());
        if output.progress() {
            bar.enable_steady_tick(TICK);
        }
        Self(bar)
    }

    /// A bar over `steps` steps.
    #[must_use]
    pub fn bar(output: &Output<'_>, text: &str, steps: u64) -> Self {
        let style = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} {eta}");
        let bar = ProgressBar::with_draw_target(Some(steps), target(output)).with_message(text.to_owned());
        // The template is ours: where it were wrong, the default look would do.
        Self(style.map_or(bar.clone(), |style| bar.with_style(style)))
    }

    /// Nothing at all, for work beside other output.
    #[must_use]
    pub fn none() -> Self {
        Self(ProgressBar::hidden())
    }

    /// Says what is being done now.
    pub fn tell(&self, text: impl Into<String>) {
        self.0.set_message(text.into());
    }

    /// One step further.
    pub fn step(&self) {
        self.0.inc(1);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

fn target(output: &Output<'_>) -> ProgressDrawTarget {
    if output.progress() { ProgressDrawTarget::stderr_with_hz(DRAWS_PER_S) } else { ProgressDrawTarget::hidden() }
}

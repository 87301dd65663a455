//! A bar or a spinner on the terminal, for what takes about a second or more; nothing where nobody looks.
//!
//! - **Invariants:** it is drawn on the talk's side only, and gone when the command's own output comes. What is quick draws nothing.

use super::output::Output;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// What ends sooner draws nothing.
const PATIENCE: Duration = Duration::from_millis(500);
/// How often a spinner turns.
const TICK: Duration = Duration::from_millis(100);
/// How often a bar is drawn.
const DRAWS_PER_S: u8 = 10;

/// What is drawn until it is dropped.
#[derive(Debug)]
pub struct Progress {
    bar: ProgressBar,
    curtain: Option<Curtain>,
}

/// Waits until the bar is worth showing, or until it is not needed any more.
#[derive(Debug)]
struct Curtain {
    is_over: Sender<()>,
    thread: JoinHandle<()>,
}

impl Progress {
    /// A spinner with a text, for work of unknown length.
    #[must_use]
    pub fn spinner(output: &Output<'_>, text: &str) -> Self {
        Self::start(output, ProgressBar::hidden(), "{spinner} {msg}", text)
    }

    /// A bar over `steps` steps.
    #[must_use]
    pub fn bar(output: &Output<'_>, text: &str, steps: u64) -> Self {
        let bar = ProgressBar::with_draw_target(Some(steps), ProgressDrawTarget::hidden());
        Self::start(output, bar, "{msg} {wide_bar} {pos}/{len}, {eta} left", text)
    }

    /// Nothing at all, for work beside other output.
    #[must_use]
    pub fn none() -> Self {
        Self { bar: ProgressBar::hidden(), curtain: None }
    }

    /// Says what is being done now.
    pub fn tell(&self, text: impl Into<String>) {
        self.bar.set_message(text.into());
    }

    /// One step further.
    pub fn step(&self) {
        self.bar.inc(1);
    }

    fn start(output: &Output<'_>, bar: ProgressBar, template: &str, text: &str) -> Self {
        bar.set_message(text.to_owned());
        // The template is ours: were it wrong, the default look would do.
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        let curtain = output.progress().then(|| Curtain::over(bar.clone()));
        Self { bar, curtain }
    }
}

impl Curtain {
    fn over(bar: ProgressBar) -> Self {
        let (is_over, wait) = channel();
        let thread = std::thread::spawn(move || {
            if wait.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Timeout) {
                bar.set_draw_target(ProgressDrawTarget::stderr_with_hz(DRAWS_PER_S));
                bar.enable_steady_tick(TICK);
            }
        });
        Self { is_over, thread }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(Curtain { is_over, thread }) = self.curtain.take() {
            // Joined before the bar is cleared, so that it cannot be shown afterwards.
            drop(is_over);
            let _ = thread.join();
        }
        self.bar.finish_and_clear();
    }
}

//! Waiting for people: until Ctrl-C, or until a time given with `--for` has passed.
//!
//! - **Invariant:** Ctrl-C ends a wait at once, and the command then ends in order: nothing is cut off in the middle of a line.

use std::sync::{Condvar, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

/// Longest time that may be asked for, seconds: a year.
const SECONDS_MAX: f64 = 366.0 * 86_400.0;

/// Reads the argument of `--for`: seconds, with a fraction where wanted.
///
/// # Errors
/// Says what would do, where `text` is no such number.
pub fn parse_seconds(text: &str) -> Result<Duration, String> {
    let seconds: f64 = text.parse().map_err(|_| format!("expected seconds, such as 2.5, not {text:?}"))?;
    if (0.0..=SECONDS_MAX).contains(&seconds) {
        Ok(Duration::from_secs_f64(seconds))
    } else {
        Err(format!("expected 0 to {SECONDS_MAX} seconds"))
    }
}

/// Set by Ctrl-C, once for the process.
struct Interrupt {
    set: Mutex<bool>,
    changed: Condvar,
}

static INTERRUPT: OnceLock<Interrupt> = OnceLock::new();

/// Catches Ctrl-C from the first call on. Where the system lets nobody catch it, it ends the process as ever.
fn interrupt() -> &'static Interrupt {
    INTERRUPT.get_or_init(|| {
        let _ends_the_process_where_it_cannot_be_caught = ctrlc::set_handler(|| {
            if let Some(interrupt) = INTERRUPT.get() {
                *interrupt.set.lock().unwrap_or_else(PoisonError::into_inner) = true;
                interrupt.changed.notify_all();
            }
        });
        Interrupt { set: Mutex::new(false), changed: Condvar::new() }
    })
}

/// The end of a command that goes on until told otherwise.
#[derive(Debug)]
pub struct Until {
    end: Option<Instant>,
}

impl Until {
    /// Ctrl-C, or `duration` from now.
    #[must_use]
    pub fn new(duration: Option<Duration>) -> Self {
        interrupt();
        Self { end: duration.map(|duration| Instant::now() + duration) }
    }

    /// Waits `duration` or to the end, whichever is first, and says whether there is time left.
    #[must_use]
    pub fn pause(&self, duration: Duration) -> bool {
        let now = Instant::now();
        let left = self.end.map_or(duration, |end| end.saturating_duration_since(now).min(duration));
        let interrupt = interrupt();
        let set = interrupt.set.lock().unwrap_or_else(PoisonError::into_inner);
        let (set, _) =
            interrupt.changed.wait_timeout_while(set, left, |set| !*set).unwrap_or_else(PoisonError::into_inner);
        !*set && self.end.is_none_or(|end| Instant::now() < end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_are_what_they_say_and_nothing_absurd_is_taken() {
        assert_eq!(parse_seconds("2.5"), Ok(Duration::from_millis(2500)));
        for absurd in ["", "-1", "NaN", "inf", "1e300", "2s"] {
            assert!(parse_seconds(absurd).is_err(), "{absurd}");
        }
    }

    #[test]
    fn a_time_that_is_up_leaves_none() {
        assert!(!Until::new(Some(Duration::ZERO)).pause(Duration::from_mins(1)));
        assert!(Until::new(None).pause(Duration::ZERO));
    }
}

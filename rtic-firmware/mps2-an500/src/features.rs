//! What each feature of this image adds, and what stands in its place where it is left out: the same names, doing nothing.
//!
//! - **Invariant:** all `cfg` of the tasks' work is here, so that the tasks read the same in every build.
//! - **Context:** start-up, but for [`KeptSettings::keep`] in idle, [`RunningWatchdog::feed`] in routing and [`Turns::count`] in serving.
//! - **Clauses:** `[DSC-05]`, `[DSC-06]`, `[TIM-17]`.

#![allow(clippy::unused_self, reason = "what stands in for a feature has the same shape")]

pub(crate) use motion::{Beats, Parts as MotionParts, Rings, start as start_motion};
pub(crate) use probe::{Probe, Turns, start as start_probe};
pub(crate) use report::past_reports;
pub(crate) use settings::KeptSettings;
pub(crate) use watchdog::RunningWatchdog;

#[cfg(feature = "motion")]
use crate::interpolation as motion;

#[cfg(not(feature = "motion"))]
mod motion {
    use crate::device::Services;
    use board_mps2_an500::outputs::{Enable, StepPins};
    use board_mps2_an500::pace::Pace;
    use board_mps2_an500::signals::SignalPins;

    /// Nothing to share.
    pub(crate) struct Rings;
    /// Nothing to play.
    pub(crate) struct Beats;

    /// The board's parts for it, which stay as they are.
    #[expect(dead_code, reason = "the beat stands still and the pins stay low")]
    pub(crate) struct Parts {
        pub(crate) pace: Pace,
        pub(crate) steps: StepPins,
        pub(crate) enable: Enable,
        pub(crate) signals: SignalPins,
    }

    impl Rings {
        pub(crate) const fn new() -> Self {
            Self
        }
    }

    /// Plays nothing: a motion port refuses.
    pub(crate) fn start(_: &'static mut Rings, _: &mut Services, _: Parts) -> Beats {
        Beats
    }
}

#[cfg(feature = "settings")]
mod settings {
    use crate::device::Node;
    use board_mps2_an500::kept::SettingsFlash;
    use firmware_app::settings::{Changes, Settings};

    /// Settings in memory that outlives a reset.
    pub(crate) struct KeptSettings(Option<Settings<&'static mut SettingsFlash>>);

    impl KeptSettings {
        /// Reads them and counts this start. Where they cannot be read, the device runs without.
        pub(crate) fn load(flash: &'static mut SettingsFlash) -> Self {
            Self(Settings::load(flash, 0..SettingsFlash::BYTES).ok())
        }

        pub(crate) fn name(&self) -> &str {
            self.0.as_ref().map_or("", Settings::name)
        }

        pub(crate) fn boots(&self) -> u32 {
            self.0.as_ref().map_or(0, Settings::boots)
        }

        pub(crate) fn kind(&self) -> Option<u8> {
            self.0.as_ref().and_then(Settings::kind)
        }

        /// Gives a node's clock what a former run kept of it.
        pub(crate) fn restore(&self, node: &mut Node) {
            if let Some(time) = self.0.as_ref().and_then(Settings::time) {
                node.restore_time(time);
            }
        }

        /// Keeps what has changed; the node has it in any case.
        pub(crate) fn keep(&mut self, changes: &Changes) {
            let _until_power_off = self.0.as_mut().map(|settings| settings.keep(changes));
        }
    }
}

#[cfg(not(feature = "settings"))]
mod settings {
    use crate::device::Node;
    use board_mps2_an500::kept::SettingsFlash;
    use firmware_app::settings::Changes;

    /// No settings: no name, and every start is the first.
    pub(crate) struct KeptSettings;

    impl KeptSettings {
        pub(crate) const fn load(_: &'static mut SettingsFlash) -> Self {
            Self
        }

        pub(crate) const fn name(&self) -> &'static str {
            ""
        }

        pub(crate) const fn boots(&self) -> u32 {
            1
        }

        pub(crate) const fn kind(&self) -> Option<u8> {
            None
        }

        pub(crate) const fn restore(&self, _: &mut Node) {}

        pub(crate) const fn keep(&mut self, _: &Changes) {}
    }
}

#[cfg(feature = "report")]
mod report {
    use crate::device::Node;
    use board_mps2_an500::now;
    use firmware_app::report::{REPORT_WORDS, Report};
    use osap_protocol::discovery::{Event, Verbosity};

    /// Tells in `node`'s debug events why it was reset, if a report says so.
    pub(crate) fn past_reports(words: &mut [u32; REPORT_WORDS], node: &mut Node) {
        let Some(report) = Report::decode(words) else { return };
        report.lines().for_each(|line| node.debug_mut().record(Verbosity::Events, now(), || Event::Text(line)));
    }
}

#[cfg(not(feature = "report"))]
mod report {
    use crate::device::Node;
    use firmware_app::report::REPORT_WORDS;

    /// Tells nothing.
    pub(crate) const fn past_reports(_: &mut [u32; REPORT_WORDS], _: &mut Node) {}
}

#[cfg(feature = "watchdog")]
mod watchdog {
    use board_mps2_an500::watchdog::Watchdog;

    /// A watchdog that bites.
    pub(crate) struct RunningWatchdog(Watchdog);

    impl RunningWatchdog {
        pub(crate) fn start(watchdog: Watchdog) -> Self {
            Self(watchdog.start())
        }

        pub(crate) fn feed(&mut self) {
            self.0.feed();
        }
    }
}

#[cfg(not(feature = "watchdog"))]
mod watchdog {
    use board_mps2_an500::watchdog::Watchdog;

    /// A watchdog that sleeps.
    pub(crate) struct RunningWatchdog;

    impl RunningWatchdog {
        pub(crate) fn start(_: Watchdog) -> Self {
            Self
        }

        pub(crate) const fn feed(&mut self) {}
    }
}

#[cfg(feature = "probe")]
mod probe {
    pub(crate) use board_mps2_an500::latency::{Latency as Probe, Turns};

    /// Starts counting how long the links' interrupts wait.
    pub(crate) fn start(probe: Probe) -> (Probe, Turns) {
        let turns = probe.turns();
        (probe.start(), turns)
    }
}

#[cfg(not(feature = "probe"))]
mod probe {
    use board_mps2_an500::latency::Latency;

    /// Counts nothing.
    pub(crate) struct Probe;
    /// Counts nothing.
    pub(crate) struct Turns;

    /// Leaves the timer stopped.
    pub(crate) fn start(_: Latency) -> (Probe, Turns) {
        (Probe, Turns)
    }

    impl Turns {
        /// Runs one turn of serving.
        pub(crate) fn count<R>(&mut self, turn: impl FnOnce() -> R) -> R {
            turn()
        }
    }
}

//! What was odd in a network, each with who is concerned and what to do.
//!
//! - **Walk:** the scan collects findings; maps carry them. **Clauses:** `[DSC-04]`, `[DSC-09]`.

use super::RouteText;
use serde::{Deserialize, Serialize};
use std::fmt::{self, Display, Formatter};

/// Something odd. Numbers of devices are indices into the map.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Finding {
    /// Several devices have one name.
    DuplicateName {
        /// The name.
        name: String,
        /// Who has it.
        devices: Vec<usize>,
    },
    /// Several devices carry one unique id, `[DSC-04]`.
    DuplicateUniqueId {
        /// The id.
        unique_id: String,
        /// Who carries it.
        devices: Vec<usize>,
    },
    /// A device restarted during the scan and was read again, `[DSC-09]`.
    Restarted {
        /// Which.
        device: usize,
        /// How often that was seen.
        times: u32,
    },
    /// A device's neighbours changed during the scan: the map may be older than the machine there.
    Changed {
        /// Which.
        device: usize,
    },
    /// A device answered at first and no longer at the end.
    FellSilent {
        /// Which.
        device: usize,
    },
    /// A device did not answer, or refused, some of the questions.
    Incomplete {
        /// Which.
        device: usize,
        /// What is missing.
        missing: Vec<String>,
    },
    /// The two ends of a link take packets of different sizes; the smaller one counts.
    PacketSizes {
        /// The two devices.
        devices: [usize; 2],
        /// Their packet sizes, bytes.
        mtu_bytes: [u16; 2],
    },
    /// A way was not followed: its wires are too slow for any time to live, `[PKT-11]`.
    TooSlow {
        /// The device before it.
        device: usize,
        /// The way.
        route: RouteText,
        /// What it takes at least, µs.
        need_us: u64,
    },
    /// Ways were not followed since a limit was reached.
    Limit {
        /// Which limit.
        what: String,
    },
    /// A link of the host itself by which nobody was found.
    SilentLink {
        /// What it is called: `tcp:127.0.0.1:4100`.
        link: String,
        /// Why it is closed; `None` where it is open.
        reason: Option<String>,
    },
}

impl Finding {
    /// Who is concerned.
    pub fn devices(&self) -> impl Iterator<Item = usize> + '_ {
        let (one, several): (Option<usize>, &[usize]) = match self {
            Self::DuplicateName { devices, .. } | Self::DuplicateUniqueId { devices, .. } => (None, devices),
            Self::PacketSizes { devices, .. } => (None, devices),
            Self::Restarted { device, .. }
            | Self::Changed { device }
            | Self::FellSilent { device }
            | Self::Incomplete { device, .. }
            | Self::TooSlow { device, .. } => (Some(*device), &[]),
            Self::Limit { .. } | Self::SilentLink { .. } => (None, &[]),
        };
        one.into_iter().chain(several.iter().copied())
    }

    /// The same with other numbers for the devices.
    #[must_use]
    pub(crate) fn renumbered(mut self, new: &[usize]) -> Self {
        match &mut self {
            Self::DuplicateName { devices, .. } | Self::DuplicateUniqueId { devices, .. } => {
                for device in devices.iter_mut() {
                    *device = new[*device];
                }
                devices.sort_unstable();
            }
            Self::PacketSizes { devices, .. } => *devices = devices.map(|device| new[device]),
            Self::Restarted { device, .. }
            | Self::Changed { device }
            | Self::FellSilent { device }
            | Self::Incomplete { device, .. }
            | Self::TooSlow { device, .. } => *device = new[*device],
            Self::Limit { .. } | Self::SilentLink { .. } => {}
        }
        self
    }

    /// What it says, with `label` for the devices, and what to do.
    pub fn text(&self, label: impl Fn(usize) -> String) -> impl Display {
        let all = |devices: &[usize]| devices.iter().map(|device| label(*device)).collect::<Vec<_>>().join(", ");
        Text(match self {
            Self::DuplicateName { name, devices } => format!(
                "{} devices are called {name}: {}. Name them by route or unique id, or rename one",
                devices.len(),
                all(devices)
            ),
            Self::DuplicateUniqueId { unique_id, devices } => {
                format!("one unique id, {unique_id}, on {}: give one of them another", all(devices))
            }
            Self::Restarted { device, times } => format!(
                "{} restarted {times} time(s) during the scan and was read again: look at its power and its debug messages",
                label(*device)
            ),
            Self::Changed { device } => {
                format!("neighbours of {} changed during the scan: scan again when nothing moves", label(*device))
            }
            Self::FellSilent { device } => {
                format!("{} answered at first and no longer at the end: look at its cable and power", label(*device))
            }
            Self::Incomplete { device, missing } => {
                format!(
                    "{} did not tell its {}: scan again, or look at its counters",
                    label(*device),
                    missing.join(", ")
                )
            }
            Self::PacketSizes { devices: [one, other], mtu_bytes: [a, b] } => format!(
                "the link between {} and {} has packets of {a} bytes at one end and {b} at the other; the smaller counts",
                label(*one),
                label(*other)
            ),
            Self::TooSlow { route, need_us, .. } => {
                format!(
                    "{route} was not followed: a question there takes {need_us} µs on its wires alone; raise the rates"
                )
            }
            Self::Limit { what } => format!("not everything was followed: {what}"),
            Self::SilentLink { link, reason: Some(reason) } => format!("{link} is closed: {reason}"),
            Self::SilentLink { link, reason: None } => format!(
                "{link} is open and nobody answers: another program may be using it, or its key or check differs"
            ),
        })
    }
}

struct Text(String);

impl Display for Text {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

//! Which network: the text of a command line, and what it means.
//!
//! | text | is |
//! |---|---|
//! | `sim:printer` | the simulated printer |
//! | `sim:line:5` | five devices one behind the other |
//! | `sim:ring:6` | six devices in a ring |
//! | `sim:bus:6` | a hub with six devices on one bus |
//! | `sim:random:200`, `sim:random:200:20` | a random tree of 200 devices, with 20 links more than a tree has |
//! | anything else | a link of this computer, see [`LinkSpec`] |
//!
//! Behind a simulated machine may stand its seed: `sim:random:200@7`.
//!
//! - **Walk:** `--link TEXT` → [`NetworkSpec`] → [`Session::open`](crate::session::Session::open).
//! - **Invariant:** what is shown parses back to the same.
//!
//! ```
//! use osap::network::{NetworkSpec, SimKind, SimSpec};
//!
//! let spec: NetworkSpec = "sim:random:200:20@7".parse()?;
//! let NetworkSpec::Sim(SimSpec { kind, seed }) = &spec else { unreachable!() };
//! assert_eq!((kind, seed), (&SimKind::Random { devices: 200, extra_links: 20 }, &Some(7)));
//! assert_eq!(spec.to_string(), "sim:random:200:20@7");
//! # Ok::<(), osap::error::NetworkSpecError>(())
//! ```

use crate::error::NetworkSpecError;
use crate::link::LinkSpec;
use std::fmt::{self, Display, Formatter};
use std::str::FromStr;

/// Devices a simulated machine has at most.
pub(super) const SIM_DEVICES_MAX: usize = 5_000;
/// Devices on a bus at most: its addresses end at 254, and the hub has the first.
const SIM_BUS_DEVICES_MAX: usize = 254;
const PREFIX: &str = "sim:";

/// A network to open: one link of several, or a whole simulated machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NetworkSpec {
    /// A link of this computer.
    Link(LinkSpec),
    /// A simulated machine.
    Sim(SimSpec),
}

/// Which simulated machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SimSpec {
    /// What it is made of.
    pub kind: SimKind,
    /// Seed of all its draws, where one is given.
    pub seed: Option<u64>,
}

/// What a simulated machine is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SimKind {
    /// The printer.
    Printer,
    /// Devices one behind the other.
    Line {
        /// How many.
        devices: usize,
    },
    /// Devices in a ring.
    Ring {
        /// How many.
        devices: usize,
    },
    /// A hub with devices on one bus.
    Bus {
        /// How many.
        devices: usize,
    },
    /// A random tree with links added.
    Random {
        /// How many.
        devices: usize,
        /// Links more than a tree has.
        extra_links: usize,
    },
}

/// Why a text names no simulated machine.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SimSpecError {
    /// The part behind `sim:`.
    #[error("{text}: there are sim:printer, sim:line:N, sim:ring:N, sim:bus:N and sim:random:N[:EXTRA]")]
    Kind {
        /// As given.
        text: String,
    },
    /// A number of devices or links.
    #[error("{text}: expected {least} to {most} {what}, such as sim:line:5 or sim:random:200:20")]
    Count {
        /// As given.
        text: String,
        /// Of what.
        what: &'static str,
        /// The least.
        least: usize,
        /// The most.
        most: usize,
    },
    /// Behind the `@`.
    #[error("{text}: expected a whole number below 2^64 as seed behind the @")]
    Seed {
        /// As given.
        text: String,
    },
}

impl FromStr for NetworkSpec {
    type Err = NetworkSpecError;

    fn from_str(text: &str) -> Result<Self, NetworkSpecError> {
        if text == "sim" || text.starts_with(PREFIX) {
            Ok(Self::Sim(text.parse()?))
        } else {
            Ok(Self::Link(text.parse()?))
        }
    }
}

impl Display for NetworkSpec {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Link(spec) => spec.fmt(f),
            Self::Sim(spec) => spec.fmt(f),
        }
    }
}

impl FromStr for SimSpec {
    type Err = SimSpecError;

    fn from_str(text: &str) -> Result<Self, SimSpecError> {
        let given = || text.to_owned();
        let (what, seed) = match text.split_once('@') {
            Some((what, seed)) => (what, Some(seed.parse().map_err(|_| SimSpecError::Seed { text: given() })?)),
            None => (text, None),
        };
        let parts: Vec<&str> = what.strip_prefix(PREFIX).unwrap_or_default().split(':').collect();
        let count = |number: &str, what, least: usize, most: usize| {
            let value = number.parse().ok().filter(|n| (least..=most).contains(n));
            value.ok_or_else(|| SimSpecError::Count { text: given(), what, least, most })
        };
        let devices = |number: &str, least| count(number, "devices", least, SIM_DEVICES_MAX);
        let kind = match parts[..] {
            ["printer"] => SimKind::Printer,
            ["line", n] => SimKind::Line { devices: devices(n, 1)? },
            ["ring", n] => SimKind::Ring { devices: devices(n, 3)? },
            ["bus", n] => SimKind::Bus { devices: count(n, "devices on a bus", 1, SIM_BUS_DEVICES_MAX)? },
            ["random", n] => SimKind::Random { devices: devices(n, 1)?, extra_links: 0 },
            ["random", n, extra] => {
                let extra_links = count(extra, "extra links", 0, SIM_DEVICES_MAX)?;
                SimKind::Random { devices: devices(n, 1)?, extra_links }
            }
            _ => return Err(SimSpecError::Kind { text: given() }),
        };
        Ok(Self { kind, seed })
    }
}

impl Display for SimSpec {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(PREFIX)?;
        match self.kind {
            SimKind::Printer => f.write_str("printer")?,
            SimKind::Line { devices } => write!(f, "line:{devices}")?,
            SimKind::Ring { devices } => write!(f, "ring:{devices}")?,
            SimKind::Bus { devices } => write!(f, "bus:{devices}")?,
            SimKind::Random { devices, extra_links: 0 } => write!(f, "random:{devices}")?,
            SimKind::Random { devices, extra_links } => write!(f, "random:{devices}:{extra_links}")?,
        }
        match self.seed {
            Some(seed) => write!(f, "@{seed}"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn errors_say_what_would_do() {
        let said = |text: &str| text.parse::<NetworkSpec>().unwrap_err().to_string();
        assert!(said("sim:toaster").starts_with("sim:toaster: there are sim:printer, sim:line:N"));
        assert!(said("sim").starts_with("sim: there are sim:printer"));
        assert!(said("sim:line:0").contains("expected 1 to 5000 devices"));
        assert!(said("sim:line:99999999999999999999").contains("expected 1 to 5000 devices"));
        assert!(said("sim:bus:255").contains("expected 1 to 254 devices on a bus"));
        assert!(said("sim:bus:0").contains("expected 1 to 254 devices on a bus"));
        assert!(said("sim:random:5:x").contains("expected 0 to 5000 extra links"));
        assert!(said("sim:printer@-1").contains("as seed behind the @"));
        assert!(said("printer").ends_with("such as sim:printer"));
    }

    proptest! {
        #[test]
        fn what_is_shown_parses_back(which in 0..5, n in 3..=SIM_DEVICES_MAX, extra_links in 0..=SIM_DEVICES_MAX, seed: Option<u64>) {
            let devices = n;
            let kind = match which {
                0 => SimKind::Printer,
                1 => SimKind::Line { devices },
                2 => SimKind::Ring { devices },
                3 => SimKind::Bus { devices: devices.min(SIM_BUS_DEVICES_MAX) },
                _ => SimKind::Random { devices, extra_links },
            };
            let spec = SimSpec { kind, seed };
            prop_assert_eq!(spec.to_string().parse(), Ok(spec));
        }

        #[test]
        fn no_text_panics(text in "(sim:)?\\PC{0,30}") {
            let _ = text.parse::<NetworkSpec>();
        }
    }
}

//! A simulated machine as a network: the host's core is one node of the world, and waiting is stepping it.
//!
//! - **Walk:** [`Network::drive`] → the task looks at the core → the world's next event → the task again.
//! - **Invariants:** time is virtual: nothing waits, and one seed gives one run. The core is the one that runs over real links.
//! - **Context:** the caller's thread.

use super::{Network, SimSpec, Task};
use crate::core::HostCore;
use crate::error::{NetworkError, OpenError};
use crate::session::{OpenOptions, host_identity};
use fixed_math::time::LocalTicks;

/// A simulated machine as a network.
#[derive(Debug)]
pub struct SimNetwork {
    core: HostCore,
    now: LocalTicks,
}

impl SimNetwork {
    /// The machine that `spec` names.
    ///
    /// # Errors
    /// [`OpenError`] for options that a simulated machine does not have.
    pub fn open(spec: &SimSpec, options: &OpenOptions) -> Result<Self, OpenError> {
        let _ = spec;
        Ok(Self { core: HostCore::new(&host_identity(options.name.as_deref())), now: LocalTicks::ZERO })
    }
}

impl Network for SimNetwork {
    fn drive(&mut self, until: LocalTicks, mut task: Task) -> Result<(), NetworkError> {
        loop {
            self.core.run(self.now);
            if task(&mut self.core, self.now) || self.now >= until {
                return Ok(());
            }
            self.now = self.core.next_wake().unwrap_or(until).clamp(self.now, until);
        }
    }

    fn now(&self) -> LocalTicks {
        self.now
    }

    fn link_names(&self) -> Vec<String> {
        Vec::new()
    }

    fn is_simulated(&self) -> bool {
        true
    }
}

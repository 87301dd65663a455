//! The halt: a stop of all motion along its path, or its resume, told from neighbour to neighbour.
//!
//! - **Walk:** an application raises one → the egress of every open gateway → the neighbour's ingress → its other gateways, and its
//!   application.
//! - **Invariants:** fixed width; of two halts one is the later, whatever order they come in.
//! - **Context:** any. **Clauses:** `[MOT-20]` to `[MOT-23]`.
//!
//! ```
//! use fixed_math::time::NetTime;
//! use osap_protocol::discovery::UniqueId;
//! use osap_protocol::halt::{Action, Halt};
//!
//! let stop = Halt { action: Action::Stop, sequence: 1, epoch: NetTime::from_us(5), origin: UniqueId([7; 12]) };
//! assert_eq!(Halt::decode(&stop.encode()), Ok(stop));
//! let resume = Halt { action: Action::Resume, sequence: 2, ..stop };
//! assert!(resume.is_later_than(&stop));
//! ```

use crate::discovery::UniqueId;
use crate::drops::DropCause;
use fixed_math::time::NetTime;

/// Version of the message.
pub const HALT_VERSION: u8 = 1;
/// How often a node tells each of its neighbours, `[MOT-22]`: a frame lost twice in a row is still made good.
pub const HALT_REPEATS: u8 = 3;
/// Time between two tellings, µs.
pub const HALT_REPEAT_US: u64 = 2_000;

/// What all motion shall do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Action {
    /// Come to rest on its path.
    Stop = 0,
    /// Go on from there.
    Resume = 1,
}

/// A stop or a resume and when it begins, `[MOT-20]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Halt {
    /// Stop or resume.
    pub action: Action,
    /// One more than that of the last halt its maker knew of.
    pub sequence: u32,
    /// System time at which it begins.
    pub epoch: NetTime,
    /// Who made it.
    pub origin: UniqueId,
}

impl Halt {
    /// Bytes it takes.
    pub const LEN: usize = 26;

    /// The message's bytes.
    #[must_use]
    pub fn encode(&self) -> [u8; Self::LEN] {
        let mut out = [0; Self::LEN];
        out[0] = HALT_VERSION;
        out[1] = self.action as u8;
        out[2..6].copy_from_slice(&self.sequence.to_le_bytes());
        out[6..14].copy_from_slice(&self.epoch.steps().to_le_bytes());
        out[14..].copy_from_slice(&self.origin.0);
        out
    }

    /// Reads one.
    ///
    /// # Errors
    /// [`DropCause::SystemMalformed`] where the length, the version or the action is none of these.
    pub fn decode(bytes: &[u8]) -> Result<Self, DropCause> {
        let bytes = bytes.as_array::<{ Self::LEN }>().ok_or(DropCause::SystemMalformed)?;
        let [HALT_VERSION, action, s0, s1, s2, s3, e0, e1, e2, e3, e4, e5, e6, e7, origin @ ..] = *bytes else {
            return Err(DropCause::SystemMalformed);
        };
        let action = match action {
            0 => Action::Stop,
            1 => Action::Resume,
            _ => return Err(DropCause::SystemMalformed),
        };
        Ok(Self {
            action,
            sequence: u32::from_le_bytes([s0, s1, s2, s3]),
            epoch: NetTime::from_steps(u64::from_le_bytes([e0, e1, e2, e3, e4, e5, e6, e7])),
            origin: UniqueId(origin),
        })
    }

    /// Whether it overrules `other`, `[MOT-21]`: the greater sequence; of equal ones the stop, then the earlier epoch, then the lower origin.
    #[must_use]
    pub fn is_later_than(&self, other: &Self) -> bool {
        let key = |it: &Self| (it.sequence, core::cmp::Reverse((it.action as u8, it.epoch, it.origin.0)));
        key(self) > key(other)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STOP: Halt =
        Halt { action: Action::Stop, sequence: 5, epoch: NetTime::from_steps(0x0102), origin: UniqueId([3; 12]) };

    /// `[MOT-21]`: whatever two halts meet, exactly one of them is the later.
    #[test]
    fn the_order_is_total_and_a_stop_beats_a_resume() {
        let resume = Halt { action: Action::Resume, ..STOP };
        let earlier = Halt { epoch: NetTime::ZERO, ..STOP };
        let next = Halt { sequence: 6, ..resume };
        let other = Halt { origin: UniqueId([2; 12]), ..STOP };
        for (later, former) in [(STOP, resume), (earlier, STOP), (next, STOP), (next, earlier), (other, STOP)] {
            assert!(later.is_later_than(&former) && !former.is_later_than(&later), "{later:?} and {former:?}");
        }
        assert!(!STOP.is_later_than(&STOP));
    }

    /// `[MOT-20]`
    #[test]
    fn what_is_cut_or_of_another_version_is_refused() {
        let bytes = STOP.encode();
        assert_eq!(Halt::decode(&bytes), Ok(STOP));
        assert_eq!(Halt::decode(&bytes[1..]), Err(DropCause::SystemMalformed));
        for at in [0, 1] {
            let mut wrong = bytes;
            wrong[at] = 2;
            assert_eq!(Halt::decode(&wrong), Err(DropCause::SystemMalformed), "byte {at}");
        }
    }
}

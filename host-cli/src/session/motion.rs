//! Requests to a motion port, and what its refusals mean to a person.
//!
//! - **Walk:** a request or points → the port of type `motion` of a device → its reply, or a refusal with its operands.
//! - **Invariants:** numbers are the device's own: LSB, differences per interval, steps of 1/256 µs. **Clauses:** `[MOT-01]`, `[MOT-04]`.

use super::Session;
use crate::core::Outcome;
use crate::error::AskError;
use osap_protocol::motion::{
    Fault, LimitKind, MotionRefusal, MotionReply, MotionRequest, POINTS_MAX, Points, REPLY_BYTES_MAX, refusal, reply,
};
use osap_runtime::sequenced::Destination;
use std::fmt;

const WHAT: &str = "motion";

impl Session {
    /// Asks the motion port that `to` leads to.
    ///
    /// # Errors
    /// [`AskError`], [`AskError::MotionRefused`] among them.
    pub fn motion(&mut self, to: &Destination, request: &MotionRequest) -> Result<MotionReply, AskError> {
        let mut bytes = [0; REPLY_BYTES_MAX];
        let len = request.encode(&mut bytes).unwrap_or(0);
        self.ask_motion(to, &bytes[..len])
    }

    /// Sends points, at most [`POINTS_MAX`], and waits until they are taken or refused.
    ///
    /// # Errors
    /// [`AskError`], [`AskError::MotionRefused`] among them.
    pub fn motion_points(&mut self, to: &Destination, points: &Points<'_>) -> Result<MotionReply, AskError> {
        let mut bytes = [0; Points::HEAD_BYTES + 4 * POINTS_MAX];
        let len = points.encode(&mut bytes).unwrap_or(0);
        self.ask_motion(to, &bytes[..len])
    }

    fn ask_motion(&mut self, to: &Destination, payload: &[u8]) -> Result<MotionReply, AskError> {
        let to = self.budgeted(to, payload.len(), REPLY_BYTES_MAX)?;
        let malformed = |place, len| AskError::Malformed { place, what: WHAT, len };
        match self.outcome_of(&to, payload)? {
            Outcome::Reply(answer) => {
                reply(&answer.payload).ok_or_else(|| malformed(self.place(&to), answer.payload.len()))
            }
            Outcome::Refusal(answer) => {
                let read = refusal(&answer.payload);
                let place = self.place(&to);
                Err(match read {
                    Some(refusal) => AskError::MotionRefused { place, refusal },
                    None => malformed(place, answer.payload.len()),
                })
            }
            other => self.settle_outcome(&to, WHAT, other).and(Err(malformed(self.place(&to), 0))),
        }
    }
}

/// A refusal in words, with what to do next.
pub(crate) struct RefusalText<'a>(pub(crate) &'a MotionRefusal);

impl fmt::Display for RefusalText<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let us = |steps: u64| steps >> 8;
        match *self.0 {
            MotionRefusal::Malformed => {
                write!(f, "it does not know the message. Compare `version` in the map and update the older side")
            }
            MotionRefusal::NoSuch { index, count } => {
                write!(f, "there is no number {index}, it has {count}, from 0 on")
            }
            MotionRefusal::NotArmed => write!(f, "the axis is not armed. Arm it at the position that it has"),
            MotionRefusal::Moving => write!(f, "the axis moves. Wait until it rests, or halt"),
            MotionRefusal::Late { point_steps, earliest_steps } => write!(
                f,
                "the point of {} µs is late, the earliest it would take is that of {} µs. Send further ahead",
                us(point_steps),
                us(earliest_steps)
            ),
            MotionRefusal::Full { taken, capacity } => {
                write!(f, "its queue of {capacity} points is full after {taken} of these. Send the others later")
            }
            MotionRefusal::Gap { missing, missing_max } => write!(
                f,
                "{missing} points are missing before this one, and it makes up for {missing_max}. Send them first"
            ),
            MotionRefusal::NonMonotonic { point_steps, last_steps } => write!(
                f,
                "the point of {} µs does not come after the last one, of {} µs",
                us(point_steps),
                us(last_steps)
            ),
            MotionRefusal::OffGrid { point_steps, interval_log2 } => {
                let (whole, rest) = (us(point_steps), point_steps & 255);
                write!(f, "the time of {whole} µs and {rest}/256 is no multiple of 2^{interval_log2} µs")
            }
            MotionRefusal::Limit(fault) => write!(f, "{}. It has halted all motion", FaultText(&fault)),
            MotionRefusal::Latched(fault) => {
                write!(f, "it is at fault since {}. Clear the fault at rest, and arm the axis anew", FaultText(&fault))
            }
            MotionRefusal::Setting { field, value, bound } => {
                write!(f, "field {field} of the settings is {value}, the nearest it could be is {bound}")
            }
            MotionRefusal::StopTooLong { intervals, most } => write!(
                f,
                "a stop from full speed would take {intervals} intervals, it takes {most} at the most. \
                 Allow more acceleration or jerk, or a longer interval"
            ),
            MotionRefusal::HaltTooShort { stop_log2, least } => write!(
                f,
                "halts of 3·2^{stop_log2} µs leave no acceleration or no jerk of what is allowed, the least is 3·2^{least} µs"
            ),
            MotionRefusal::NotInHistory { earliest_steps, latest_steps } => {
                write!(f, "it remembers {} to {} µs", us(earliest_steps), us(latest_steps))
            }
            MotionRefusal::Halting => write!(f, "a halt is on its way. Try again when that has ended"),
            MotionRefusal::Clock { bound_us } => {
                write!(f, "its clock is not settled, or unsure by {bound_us} µs. `osap clock wait` waits for that")
            }
            MotionRefusal::Order { start_steps, end_steps } => {
                write!(f, "{} µs is no start for what ends at {} µs", us(start_steps), us(end_steps))
            }
            MotionRefusal::Busy => write!(f, "it is not done with what was asked before. Ask again"),
            MotionRefusal::Node { operation, operand } => {
                write!(f, "a node of operation {operation} cannot have {operand} as a source or operand")
            }
        }
    }
}

/// A fault in words.
struct FaultText<'a>(&'a Fault);

impl fmt::Display for FaultText<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Fault { point_steps, limit, value, bound } = *self.0;
        let limit = match limit {
            LimitKind::Position => "position",
            LimitKind::Velocity => "velocity",
            LimitKind::Acceleration => "acceleration",
            LimitKind::Jerk => "jerk",
        };
        write!(f, "the point of {} µs, of which the {limit} is {value} where {bound} is allowed", point_steps >> 8)
    }
}

//! Messages of a motion port: settings, points, what is asked and what is refused.
//!
//! - **Walk:** workstation → port of type [`PORT_TYPE`] → track queues; refusals and readings go back.
//! - **Invariants:** integers only, in units of the device; no allocation, no panic on a peer's bytes. Numbers of variants are wire format:
//!   append, never reorder.
//! - **Context:** any. **Clauses:** `[MOT-01]` to `[MOT-14]`.
//!
//! ```
//! use fixed_math::time::NetTime;
//! use osap_protocol::motion::{Points, PointsRef};
//!
//! let mut out = [0; 32];
//! let len = Points { axis: 1, time: NetTime::from_us(4096), positions: &[10, -10] }.encode(&mut out).unwrap();
//! assert_eq!(len, 2 + 1 + 8 + 2 * 4);
//! let read = PointsRef::decode(&out[2..len]).unwrap();
//! assert_eq!((read.axis, read.time.as_us()), (1, 4096));
//! assert!(read.positions().eq([10, -10]));
//! ```

mod refusal;
mod settings;
mod status;

pub use refusal::MotionRefusal;
pub use settings::{AxisSettings, CurveSettings, StarvedPolicy, TriggerSettings};
pub use status::{AxisState, AxisStatus, Fault, HaltReason, LimitKind};

use fixed_math::time::NetTime;
use serde::{Deserialize, Serialize};

/// The type such a port gives.
pub const PORT_TYPE: &str = "motion";
/// Version of all messages here.
pub const MOTION_VERSION: u8 = 1;
/// Operation of a message with points; requests of the other kind have [`REQUEST_OPERATION`].
pub const POINTS_OPERATION: u8 = 1;
/// Operation of a message with a [`MotionRequest`].
pub const REQUEST_OPERATION: u8 = 0;
/// Operation of a datagram with readings, `[MOT-14]`.
pub const READINGS_OPERATION: u8 = 2;
/// Operation of a datagram with a [`MotionRefusal`], the answer to a datagram, `[MOT-01]`.
pub const REFUSAL_OPERATION: u8 = 3;
/// Most points of one message, `[MOT-03]`.
pub const POINTS_MAX: usize = 32;
/// Most nodes of signals, `[MOT-13]`.
pub const NODES_MAX: usize = 16;
/// A clock less sure than this stops motion, µs, `[MOT-11]`.
pub const CLOCK_BOUND_US_MAX: u32 = 1_000;
/// An axis that moves without a fresh point for longer stops, µs, `[MOT-11]`.
pub const FRESH_US_MAX: u32 = 500_000;
/// Most bytes of a reply or refusal.
pub const REPLY_BYTES_MAX: usize = 112;

/// What can be asked of a motion port beside taking points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum MotionRequest {
    /// What is there: answered by [`MotionReply::Described`].
    Describe,
    /// Settings of an axis.
    Configure {
        /// Which axis.
        axis: u8,
        /// What it is to be.
        settings: AxisSettings,
    },
    /// Makes an axis ready to take points, at rest at a position, `[MOT-08]`.
    Arm {
        /// Which axis.
        axis: u8,
        /// Where it is.
        position: i32,
    },
    /// How an axis does: answered by [`MotionReply::Status`].
    Status {
        /// Which axis.
        axis: u8,
    },
    /// Where an axis was: answered by [`MotionReply::Motion`], `[MOT-10]`.
    MotionAt {
        /// Which axis.
        axis: u8,
        /// System time, 1/256 µs.
        time_steps: u64,
    },
    /// Forgets a fault, at rest.
    ClearFault {
        /// Which axis.
        axis: u8,
    },
    /// Halts all motion of the network from so long on, or has it go on, `[MOT-20]`.
    Halt {
        /// Whether to go on.
        resume: bool,
        /// From now to its epoch, µs.
        lead_us: u32,
    },
    /// A ramp for a track, `[MOT-12]`.
    Ramp {
        /// Which track of ramps.
        track: u8,
        /// Start, 1/256 µs; without it the former ramp's end.
        start_steps: Option<u64>,
        /// End, 1/256 µs.
        end_steps: u64,
        /// Value at the start; without it the former ramp's last.
        from: Option<i32>,
        /// Value at the end and after it.
        to: i32,
    },
    /// A level for a track, `[MOT-12]`.
    Level {
        /// Which track of levels.
        track: u8,
        /// From when on, 1/256 µs.
        start_steps: u64,
        /// The value.
        value: i32,
    },
    /// A node of the signals, `[MOT-13]`; its bytes are those of `fixed_math::logic`.
    SetNode {
        /// Which node.
        node: u8,
        /// What it does, of which sources.
        bytes: [u8; NODE_BYTES],
    },
    /// Has an output pin follow a node, or stay low.
    SetOutput {
        /// Which output.
        output: u8,
        /// Which node.
        node: Option<u8>,
    },
    /// When a channel is read, and that readings come to who asks, `[MOT-14]`.
    SetTrigger {
        /// Which trigger.
        trigger: u8,
        /// Which channel.
        channel: u8,
        /// When.
        settings: TriggerSettings,
    },
}

/// Bytes of a node of the signals.
pub const NODE_BYTES: usize = 12;

/// What a motion port answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum MotionReply {
    /// Done.
    Done,
    /// What there is.
    Described {
        /// Axes.
        axes: u8,
        /// From one beat to the next, µs.
        beat_us: u8,
        /// Points an axis holds.
        queue: u16,
        /// Points an axis remembers.
        history: u16,
        /// Tracks of ramps.
        ramps: u8,
        /// Tracks of levels.
        levels: u8,
        /// Output pins that follow nodes.
        outputs: u8,
        /// Channels to read.
        channels: u8,
        /// Triggers.
        triggers: u8,
    },
    /// Points taken, `[MOT-03]`.
    Accepted {
        /// How many of the message.
        taken: u8,
        /// Room for so many more.
        free: u16,
        /// Time of the last point held, 1/256 µs.
        last_steps: u64,
    },
    /// An axis.
    Status(AxisStatus),
    /// An axis at a time, all per interval.
    Motion {
        /// LSB.
        position: i32,
        /// LSB an interval, in 1/16.
        velocity: i32,
        /// LSB an interval², in 1/16.
        acceleration: i32,
        /// LSB an interval³.
        jerk: i32,
    },
    /// A halt was made.
    Halted {
        /// Its number.
        sequence: u32,
        /// Its epoch, 1/256 µs.
        epoch_steps: u64,
    },
}

impl MotionRequest {
    /// Writes version, operation and body; `None` where `out` is too short.
    pub fn encode(&self, out: &mut [u8]) -> Option<usize> {
        let (head, body) = out.split_at_mut_checked(2)?;
        head.copy_from_slice(&[MOTION_VERSION, REQUEST_OPERATION]);
        Some(2 + postcard::to_slice(self, body).ok()?.len())
    }
}

/// A message to a motion port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Message<'a> {
    /// Points.
    Points(PointsRef<'a>),
    /// Anything else.
    Request(MotionRequest),
}

impl<'a> Message<'a> {
    /// Reads a message, `[MOT-01]`; `None` where it is none.
    #[must_use]
    pub fn decode(bytes: &'a [u8]) -> Option<Self> {
        match bytes {
            [MOTION_VERSION, POINTS_OPERATION, body @ ..] => PointsRef::decode(body).map(Self::Points),
            [MOTION_VERSION, REQUEST_OPERATION, body @ ..] => whole(body).map(Self::Request),
            _ => None,
        }
    }
}

/// Points to be sent, `[MOT-03]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Points<'a> {
    /// Which axis.
    pub axis: u8,
    /// Time of the first.
    pub time: NetTime,
    /// One interval apart.
    pub positions: &'a [i32],
}

impl Points<'_> {
    /// Bytes before the positions, version and operation included.
    pub const HEAD_BYTES: usize = 2 + 1 + 8;

    /// Writes version, operation and points; `None` where there are more than [`POINTS_MAX`], or `out` is too short.
    pub fn encode(&self, out: &mut [u8]) -> Option<usize> {
        let len = Self::HEAD_BYTES + 4 * self.positions.len();
        let out = out.get_mut(..len).filter(|_| self.positions.len() <= POINTS_MAX)?;
        let (head, body) = out.split_at_mut(Self::HEAD_BYTES);
        head[..3].copy_from_slice(&[MOTION_VERSION, POINTS_OPERATION, self.axis]);
        head[3..].copy_from_slice(&self.time.steps().to_le_bytes());
        for (room, position) in body.chunks_exact_mut(4).zip(self.positions) {
            room.copy_from_slice(&position.to_le_bytes());
        }
        Some(len)
    }
}

/// Points that came, read in place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PointsRef<'a> {
    /// Which axis.
    pub axis: u8,
    /// Time of the first.
    pub time: NetTime,
    positions: &'a [[u8; 4]],
}

impl<'a> PointsRef<'a> {
    /// Reads what stands behind the operation; `None` where it is cut, without a point or with too many.
    #[must_use]
    pub fn decode(bytes: &'a [u8]) -> Option<Self> {
        let (&axis, rest) = bytes.split_first()?;
        let (time, rest) = rest.split_first_chunk()?;
        let (positions, []) = rest.as_chunks::<4>() else { return None };
        let in_range = (1..=POINTS_MAX).contains(&positions.len());
        in_range.then(|| Self { axis, time: NetTime::from_steps(u64::from_le_bytes(*time)), positions })
    }

    /// The positions, in their order.
    #[must_use]
    pub fn positions(&self) -> impl ExactSizeIterator<Item = i32> + use<'a> {
        self.positions.iter().map(|bytes| i32::from_le_bytes(*bytes))
    }
}

/// One reading, `[MOT-14]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ReadingMessage {
    /// System time of its beat.
    pub time: NetTime,
    /// Which channel.
    pub channel: u8,
    /// What was read.
    pub value: i32,
}

impl ReadingMessage {
    /// Bytes it takes.
    pub const LEN: usize = 13;

    /// Its bytes.
    #[must_use]
    pub fn encode(&self) -> [u8; Self::LEN] {
        let mut out = [0; Self::LEN];
        out[..8].copy_from_slice(&self.time.steps().to_le_bytes());
        out[8] = self.channel;
        out[9..].copy_from_slice(&self.value.to_le_bytes());
        out
    }

    /// The readings of a datagram; `None` where it is none of readings.
    #[must_use]
    pub fn decode_all(bytes: &[u8]) -> Option<impl ExactSizeIterator<Item = Self>> {
        let [MOTION_VERSION, READINGS_OPERATION, body @ ..] = bytes else { return None };
        let (readings, []) = body.as_chunks::<{ Self::LEN }>() else { return None };
        Some(readings.iter().map(|&[t0, t1, t2, t3, t4, t5, t6, t7, channel, v0, v1, v2, v3]| Self {
            time: NetTime::from_steps(u64::from_le_bytes([t0, t1, t2, t3, t4, t5, t6, t7])),
            channel,
            value: i32::from_le_bytes([v0, v1, v2, v3]),
        }))
    }
}

impl MotionReply {
    /// Its bytes in `out`; `None` where that is shorter than [`REPLY_BYTES_MAX`] and it does not fit.
    pub fn encode<'o>(&self, out: &'o mut [u8]) -> Option<&'o [u8]> {
        postcard::to_slice(self, out).ok().map(|bytes| &*bytes)
    }
}

/// Reads a reply; `None` where it is none, or something follows.
#[must_use]
pub fn reply(bytes: &[u8]) -> Option<MotionReply> {
    whole(bytes)
}

/// Reads a refusal; `None` where it is none, or something follows.
#[must_use]
pub fn refusal(bytes: &[u8]) -> Option<MotionRefusal> {
    whole(bytes)
}

fn whole<'a, T: Deserialize<'a>>(bytes: &'a [u8]) -> Option<T> {
    match postcard::take_from_bytes(bytes) {
        Ok((it, [])) => Some(it),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `[MOT-03]`: nothing but whole points is read, and never none of them.
    #[test]
    fn points_that_are_cut_are_no_points() {
        let mut out = [0; Points::HEAD_BYTES + 4 * POINTS_MAX];
        let positions = [7; POINTS_MAX];
        let points = Points { axis: 3, time: NetTime::from_us(1 << 40), positions: &positions };
        let len = points.encode(&mut out).unwrap();
        for cut in 0..len {
            let whole = (cut.saturating_sub(Points::HEAD_BYTES)).is_multiple_of(4) && cut > Points::HEAD_BYTES;
            assert_eq!(Message::decode(&out[..cut]).is_some(), whole, "{cut} bytes");
        }
        assert!(Points { positions: &[0; POINTS_MAX + 1], ..points }.encode(&mut [0; 512]).is_none());
    }

    /// The longest there is fits what is kept for it.
    #[test]
    fn replies_and_refusals_fit() {
        let fault = Fault { point_steps: u64::MAX, limit: LimitKind::Jerk, value: i32::MIN, bound: i32::MIN };
        let status = AxisStatus {
            state: AxisState::Released,
            position: i32::MIN,
            free: u16::MAX,
            last_steps: u64::MAX,
            delay_steps: u64::MAX,
            fault: Some(fault),
            accepted: u32::MAX,
            refused: u32::MAX,
            rebuilt: u32::MAX,
            starved: u32::MAX,
            steps_late: u32::MAX,
            halted: Some(HaltReason::Silence { axis: u8::MAX }),
        };
        let mut out = [0; REPLY_BYTES_MAX];
        let len = postcard::to_slice(&MotionReply::Status(status), &mut out).unwrap().len();
        assert_eq!(reply(&out[..len]), Some(MotionReply::Status(status)));
        let refused = MotionRefusal::Latched(fault);
        let len = postcard::to_slice(&refused, &mut out).unwrap().len();
        assert_eq!(refusal(&out[..len]), Some(refused));
        assert_eq!(refusal(&out[..=len]), None, "something follows");
    }

    #[test]
    fn readings_round_trip() {
        let reading = ReadingMessage { time: NetTime::from_steps(0x0102_0304_0506), channel: 2, value: -5 };
        let mut out = [0; 2 + 2 * ReadingMessage::LEN];
        out[..2].copy_from_slice(&[MOTION_VERSION, READINGS_OPERATION]);
        out[2..15].copy_from_slice(&reading.encode());
        out[15..].copy_from_slice(&reading.encode());
        assert!(ReadingMessage::decode_all(&out).unwrap().eq([reading, reading]));
        assert!(ReadingMessage::decode_all(&out[..14]).is_none());
    }
}

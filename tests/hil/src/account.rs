//! The account of one leg of a wire under faults: what was sent, what came, and which losses and drops follow from it.
//!
//! - **Walk:** bytes as they were sent, and as they came, in order → [`Leg`] → whole frames, bad ones by cause, delimiters made and destroyed.
//! - **Invariants:** a fault changes bytes and takes none away, so that both streams stay in step. What the receiver must count follows from
//!   the bytes alone, by the reference deframer. One lost frame is not one drop: a delimiter that was destroyed joins two frames into one
//!   bad one, one that was made cuts one in two. [`Leg::balances`] has both in the sum.
//! - **Context:** pure. **Clauses:** `[FRM-05]` to `[FRM-08]`, `[NOD-09]`.

use fixed_math::time::LocalTicks;
use osap_protocol::DropCause;
use osap_protocol::framing::{Check, DELIMITER, Deframer};
use std::collections::{BTreeMap, VecDeque};

/// One direction of one wire.
pub struct Leg {
    deframer: Box<Deframer<258>>,
    sent: VecDeque<u8>,
    came: VecDeque<u8>,
    /// Frames sent, empty ones included: one a delimiter.
    pub frames_sent: u64,
    /// Frames that came whole.
    pub good: u64,
    /// Bad ones by the cause under which the receiver must count them.
    pub bad: BTreeMap<DropCause, u64>,
    /// Delimiters that came right behind another: no frame, and nothing to count.
    pub empty: u64,
    /// Delimiters that a fault made something else of.
    pub destroyed: u64,
    /// Delimiters that a fault made.
    pub made: u64,
    /// Bytes that came different.
    pub changed: u64,
    /// Bytes that were compared.
    pub bytes: u64,
    last_came: u8,
}

impl Default for Leg {
    fn default() -> Self {
        Self {
            deframer: Box::new(Deframer::new(Check::Crc16)),
            sent: VecDeque::new(),
            came: VecDeque::new(),
            frames_sent: 0,
            good: 0,
            bad: BTreeMap::new(),
            empty: 0,
            destroyed: 0,
            made: 0,
            changed: 0,
            bytes: 0,
            last_came: DELIMITER,
        }
    }
}

impl Leg {
    /// Bytes that went onto the wire.
    pub fn sent(&mut self, bytes: &[u8]) {
        self.frames_sent += bytes.iter().map(|byte| u64::from(*byte == DELIMITER)).sum::<u64>();
        self.sent.extend(bytes);
        self.compare();
    }

    /// Bytes that came off it; each packet that is whole is given to `packet`.
    pub fn came(&mut self, bytes: &[u8], mut packet: impl FnMut(&[u8])) {
        for byte in bytes {
            match self.deframer.push(*byte, LocalTicks::ZERO) {
                None => self.empty += u64::from(*byte == DELIMITER && self.last_came == DELIMITER),
                Some(Ok(frame)) => {
                    self.good += 1;
                    packet(frame.packet);
                }
                Some(Err(error)) => *self.bad.entry(error.into()).or_default() += 1,
            }
            self.last_came = *byte;
        }
        self.came.extend(bytes);
        self.compare();
    }

    fn compare(&mut self) {
        let len = self.sent.len().min(self.came.len());
        for (sent, came) in self.sent.drain(..len).zip(self.came.drain(..len)) {
            self.bytes += 1;
            self.changed += u64::from(sent != came);
            self.destroyed += u64::from(sent == DELIMITER && came != DELIMITER);
            self.made += u64::from(sent != DELIMITER && came == DELIMITER);
        }
    }

    /// Frames that did not come whole.
    #[must_use]
    pub const fn lost(&self) -> u64 {
        self.frames_sent.saturating_sub(self.good)
    }

    /// Drops that the receiver must have counted for this leg.
    #[must_use]
    pub fn bad_all(&self) -> u64 {
        self.bad.values().sum()
    }

    /// Whether all that was sent has come, and every lost frame is in the sum: lost = bad + empty + destroyed − made.
    #[must_use]
    pub fn balances(&self) -> bool {
        let is_over = self.sent.is_empty() && self.came.is_empty();
        is_over && self.lost() + self.made == self.bad_all() + self.empty + self.destroyed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osap_protocol::framing::encode;

    fn frame(packet: &[u8]) -> Vec<u8> {
        let mut out = [0; 64];
        let len = encode(packet, Check::Crc16, &mut out).unwrap();
        out[..len].to_vec()
    }

    fn leg(faults: &[(usize, u8)]) -> Leg {
        let mut stream = [frame(&[1, 2, 3]), frame(&[4, 5, 6]), frame(&[7, 8, 9])].concat();
        let mut leg = Leg::default();
        leg.sent(&stream);
        for (at, flip) in faults {
            stream[*at] ^= flip;
        }
        leg.came(&stream, |_| ());
        leg
    }

    #[test]
    fn a_clean_leg_loses_nothing() {
        let leg = leg(&[]);
        assert_eq!((leg.frames_sent, leg.good, leg.lost(), leg.changed), (3, 3, 0, 0));
        assert!(leg.balances());
    }

    /// A frame of three bytes has code, three bytes, two of check, delimiter: the first one's delimiter is byte 6.
    #[test]
    fn a_destroyed_delimiter_joins_two_frames_into_one_drop() {
        let leg = leg(&[(6, 0x10)]);
        assert_eq!((leg.good, leg.lost(), leg.bad_all(), leg.destroyed), (1, 2, 1, 1));
        assert!(leg.balances());
    }

    #[test]
    fn a_made_delimiter_makes_two_drops_of_one_frame() {
        let leg = leg(&[(2, 2)]); // the byte 2 becomes 0
        assert_eq!((leg.good, leg.lost(), leg.made), (2, 1, 1));
        assert_eq!(leg.bad_all(), 2);
        assert!(leg.balances());
    }

    #[test]
    fn a_first_byte_that_becomes_a_delimiter_is_an_empty_frame() {
        let code = frame(&[1, 2, 3])[0];
        let leg = leg(&[(7, code)]);
        assert_eq!((leg.good, leg.lost(), leg.empty, leg.made), (2, 1, 1, 1));
        assert!(leg.balances());
    }

    /// What was sent and has not come is no loss yet, and no balance.
    #[test]
    fn what_is_under_way_is_not_balanced() {
        let mut leg = Leg::default();
        leg.sent(&frame(&[1]));
        assert!(!leg.balances());
    }
}

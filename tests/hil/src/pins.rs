//! What the pins of an emulated RP2040 do: edges to the cycle, and what its PWM puts out.
//!
//! - **Walk:** [`Cosim::pins`] chooses → [`Cosim::run`] → [`Cosim::edges`] → [`Edge`]s in order; [`Cosim::pwm`] at any instant.
//! - **Invariants:** an edge is what the pad drives, so that a reset is one too. A store to SIO makes all its edges at one instant. The server
//!   keeps 2^20 edges from one question to the next and counts what it had no room for: [`Edges::lost`].
//! - **Context:** the caller's thread.

use crate::cosim::{Cosim, CosimError};
use serde::{Deserialize, Serialize};
use serde_json::json;

/// What a pin carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "u8", into = "u8")]
pub enum Level {
    /// Driven to 0 V.
    Low,
    /// Driven to 3.3 V.
    High,
    /// Driven by nothing.
    Open,
}

impl TryFrom<u8> for Level {
    type Error = String;

    fn try_from(number: u8) -> Result<Self, String> {
        match number {
            0 => Ok(Self::Low),
            1 => Ok(Self::High),
            2 => Ok(Self::Open),
            _ => Err(format!("level {number}; there are 0, 1 and 2")),
        }
    }
}

impl From<Level> for u8 {
    fn from(level: Level) -> Self {
        level as Self
    }
}

/// One pin's change.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(from = "(f64, f64, u8, Level)")]
pub struct Edge {
    /// Global time, ns with their fraction.
    pub global_ns: f64,
    /// The chip's own since its boot, ns: two edges of one boot lie whole cycles of its clock apart.
    pub local_ns: f64,
    /// Which pin of bank 0.
    pub pin: u8,
    /// What it carries from then on.
    pub level: Level,
}

impl From<(f64, f64, u8, Level)> for Edge {
    fn from((global_ns, local_ns, pin, level): (f64, f64, u8, Level)) -> Self {
        Self { global_ns, local_ns, pin, level }
    }
}

/// What a chip's pins did since the last question.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct Edges {
    /// In order of time, and of pins within one store.
    pub edges: Vec<Edge>,
    /// How many more there were than are kept: the last ones.
    pub lost: u64,
}

/// The levels of pins, one bit each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub struct Levels {
    /// Those driven to 3.3 V.
    pub high: u32,
    /// Those driven by nothing. What is in neither is driven to 0 V.
    pub open: u32,
}

/// Values of a slice, counts: of `top` + 1 counts, channel A is high for `a` and B for `b`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub struct Duty {
    /// The last count of a period.
    pub top: u32,
    /// Compare value of channel A.
    pub a: u32,
    /// Compare value of channel B.
    pub b: u32,
}

/// One slice of a chip's PWM.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct PwmSlice {
    /// Counts.
    pub enabled: bool,
    /// Channel A is turned over.
    pub invert_a: bool,
    /// Channel B is.
    pub invert_b: bool,
    /// Cycles of the system clock a count.
    pub count_cycles: f64,
    /// What is in use.
    #[serde(flatten)]
    pub now: Duty,
    /// What the next wrap takes.
    pub next: Duty,
    /// Pins that carry channel A.
    pub pins_a: Vec<u8>,
    /// Pins that carry channel B.
    pub pins_b: Vec<u8>,
}

impl Cosim {
    /// Has the edges of the pins in `mask`, a bit each, be kept from now on; says how they are now.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn pins(&mut self, chip: &str, mask: u32) -> Result<Levels, CosimError> {
        self.ask(&json!({ "cmd": "pins", "chip": chip, "mask": mask }))
    }

    /// The edges since the last question.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn edges(&mut self, chip: &str) -> Result<Edges, CosimError> {
        self.ask(&json!({ "cmd": "edges", "chip": chip }))
    }

    /// The eight slices of a chip's PWM.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn pwm(&mut self, chip: &str) -> Result<Vec<PwmSlice>, CosimError> {
        #[derive(Deserialize)]
        struct Slices {
            slices: Vec<PwmSlice>,
        }
        Ok(self.ask::<Slices>(&json!({ "cmd": "pwm", "chip": chip }))?.slices)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_are_read_and_levels_that_are_none_refused() {
        let line = r#"{"edges":[[1000.5,999.9,6,1],[1008.5,1007.9,7,2]],"lost":3}"#;
        let read: Edges = serde_json::from_str(line).unwrap();
        assert_eq!(read.lost, 3);
        assert_eq!(read.edges[0], Edge { global_ns: 1000.5, local_ns: 999.9, pin: 6, level: Level::High });
        assert_eq!(read.edges[1].level, Level::Open);
        let error = serde_json::from_str::<Edges>(&line.replace("7,2", "7,4")).unwrap_err();
        assert!(error.to_string().contains("level 4"), "{error}");
        assert!([Level::Low, Level::High, Level::Open].map(u8::from) == [0, 1, 2]);
    }

    #[test]
    fn a_slice_is_read_with_what_is_in_use_and_what_comes_next() {
        let line = r#"{"enabled":true,"invert_a":false,"invert_b":false,"count_cycles":1,"top":99,"a":10,"b":30,
            "next":{"top":99,"a":0,"b":100},"pins_a":[26],"pins_b":[27]}"#;
        let slice: PwmSlice = serde_json::from_str(line).unwrap();
        assert_eq!(slice.now, Duty { top: 99, a: 10, b: 30 });
        assert_eq!((slice.next, &slice.pins_a[..]), (Duty { top: 99, a: 0, b: 100 }, &[26][..]));
    }
}

//! What the pins of an emulated RP2040 do: edges to the cycle, steps, and what its PWM puts out; and what an emulated MPS2 board counts instead.
//!
//! - **Walk:** [`Cosim::pins`] chooses → [`Cosim::run`] → [`Cosim::edges`] → [`Edge`]s in order → [`StepCount`]; [`Cosim::pwm`] at any instant.
//!   A QEMU device's memory → [`Outputs::decode`].
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

/// Step and direction of each axis on a Pico, as `boards/rp2040-pico/src/outputs.rs` says.
pub const PICO_AXES: [(u8, u8); AXES] = [(6, 7), (8, 9), (10, 11), (12, 13)];
/// The enable of the drivers on a Pico.
pub const PICO_ENABLE: u8 = 14;
/// The pins of a Pico that follow signals, as `boards/rp2040-pico/src/signals.rs` says.
pub const PICO_OUTPUTS: [u8; 4] = [16, 17, 21, 22];
/// Axes that a board drives by steps.
pub const AXES: usize = 4;

/// What a driver makes of an axis's two pins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepCount {
    step: Level,
    direction: Level,
    /// When the direction changed last and when the last step was, the chip's ns; before all edges where they were not yet.
    direction_ns: f64,
    step_ns: f64,
    /// Steps: edges of the step pin from low to high.
    pub steps: u32,
    /// Steps with the direction high less those with it low.
    pub position: i32,
    /// Steps at the very instant at which the direction changed, which a driver may take either way.
    pub late_directions: u32,
}

impl StepCount {
    /// Of pins that are low and have not moved.
    #[must_use]
    pub const fn new() -> Self {
        let (step, direction) = (Level::Low, Level::Low);
        let (direction_ns, step_ns) = (f64::NEG_INFINITY, f64::NEG_INFINITY);
        Self { step, direction, direction_ns, step_ns, steps: 0, position: 0, late_directions: 0 }
    }

    /// Takes in the edges of one boot that are of the pins `step` and `direction`; others are left out. Edges of one instant count in whichever
    /// order they stand: the direction is that behind all of them.
    pub fn take(&mut self, edges: &[Edge], (step, direction): (u8, u8)) {
        for edge in edges {
            if edge.pin == direction {
                self.turn(edge);
            } else if edge.pin == step {
                if self.step == Level::Low && edge.level == Level::High {
                    self.steps += 1;
                    self.position += self.sign();
                    self.late_directions += u32::from(same(self.direction_ns, edge.local_ns));
                    self.step_ns = edge.local_ns;
                }
                self.step = edge.level;
            }
        }
    }

    /// The direction changes.
    fn turn(&mut self, edge: &Edge) {
        let before = self.sign();
        self.direction = edge.level;
        self.direction_ns = edge.local_ns;
        if same(self.step_ns, edge.local_ns) {
            self.position += self.sign() - before;
            self.late_directions += 1;
        }
    }

    fn sign(&self) -> i32 {
        if self.direction == Level::High { 1 } else { -1 }
    }
}

impl Default for StepCount {
    fn default() -> Self {
        Self::new()
    }
}

/// Whether two instants are those of one store: less than half a cycle apart.
fn same(one_ns: f64, other_ns: f64) -> bool {
    (one_ns - other_ns).abs() < 4.0
}

/// What an MPS2 board says it has put out, since QEMU has no model of its pins: see `boards/mps2-an500/src/outputs.rs`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outputs {
    /// Stores to the pins.
    pub writes: u32,
    /// Levels of the pins.
    pub levels: u32,
    /// The drivers are on.
    pub is_enabled: bool,
    /// Steps of each axis.
    pub steps: [u32; AXES],
    /// Steps with the direction high less those with it low.
    pub positions: [i32; AXES],
    /// Steps at which the direction changed with the same store.
    pub late_directions: u32,
}

impl Outputs {
    /// Where the record stands in the memory that outlives a reset.
    pub const OFFSET: u64 = 0x7000;
    /// How long it is.
    pub const BYTES: usize = 52;
    /// What it begins with.
    const MARK: u32 = 0x0511_0a75;

    /// Reads a record; `None` where there is none.
    #[must_use]
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (words, []) = bytes.as_chunks::<4>() else { return None };
        let words: [u32; Self::BYTES / 4] =
            words.iter().map(|word| u32::from_le_bytes(*word)).collect::<Vec<_>>().try_into().ok()?;
        let [Self::MARK, writes, levels, enabled, s0, s1, s2, s3, p0, p1, p2, p3, late_directions] = words else {
            return None;
        };
        let positions = [p0, p1, p2, p3].map(u32::cast_signed);
        Some(Self { writes, levels, is_enabled: enabled == 1, steps: [s0, s1, s2, s3], positions, late_directions })
    }
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
    fn steps_count_by_the_direction_behind_all_edges_of_an_instant() {
        let edge = |ns: u32, pin, level| Edge { global_ns: f64::from(ns), local_ns: f64::from(ns), pin, level };
        let (high, low) = (Level::High, Level::Low);
        let edges = [
            edge(0, 6, Level::Open),
            edge(8, 6, low),
            edge(100, 6, high), // backward
            edge(200, 6, low),
            edge(200, 7, high),
            edge(300, 6, high), // forward
            edge(300, 9, high), // of another axis
            edge(400, 6, low),
            edge(500, 6, high), // backward, with its direction at once
            edge(500, 7, low),
            edge(600, 6, Level::Open),
            edge(700, 6, high), // out of nothing: no step
        ];
        let mut count = StepCount::new();
        count.take(&edges[..8], PICO_AXES[0]);
        assert_eq!((count.steps, count.position, count.late_directions), (2, 0, 0));
        count.take(&edges[8..], PICO_AXES[0]);
        assert_eq!((count.steps, count.position, count.late_directions), (3, -1, 1));
    }

    #[test]
    fn a_boards_record_is_read_as_it_writes_it_and_nothing_else_for_one() {
        let words = [0x0511_0a75, 1, 2, 1, 4, 5, 6, 7, u32::MAX, 9, 10, 11, 12_u32];
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        let read = Outputs::decode(&bytes).unwrap();
        assert_eq!((read.writes, read.levels, read.is_enabled, read.late_directions), (1, 2, true, 12));
        assert_eq!((read.steps, read.positions), ([4, 5, 6, 7], [-1, 9, 10, 11]));
        assert_eq!(
            (Outputs::decode(&[0; 52]), Outputs::decode(&bytes[..48]), Outputs::decode(&bytes[..51])),
            (None, None, None)
        );
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

//! Client of the RP2040 co-simulation: a Node.js process that runs real images in lock-step virtual time.
//!
//! - **Walk:** a scenario → [`Cosim`] → one JSON line → the server → one JSON line → a typed answer.
//! - **Invariants:** every command has exactly one answer. The process ends with its client. All times are global virtual nanoseconds,
//!   rounded to whole ones; the server calculates in fractions.
//! - **Context:** the caller's thread, which waits for the process. The same commands give the same run, to the bit.
//!
//! What it is not: no cache of the flash chip's interface, no PIO, no boot ROM and no second stage of it are modelled.

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::{self, BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

/// Global virtual time, ns since the co-simulation began.
pub type Ns = u64;

/// Nanoseconds in a millisecond.
pub const NS_PER_MS: Ns = 1_000_000;
/// Nanoseconds in a second.
pub const NS_PER_S: Ns = 1_000_000_000;

/// Why the co-simulation did not do what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum CosimError {
    /// The process did not start.
    #[error("cannot start `node {}`: {source}. `cargo xtask hil` installs Node.js and its packages", server.display())]
    Start {
        /// The server's file.
        server: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The process has gone.
    #[error(
        "the co-simulation ended while it was to do `{command}`; what it wrote last stands above. Run `npm test` in tests/hil/rp2040"
    )]
    Gone {
        /// What it was to do.
        command: String,
    },
    /// The command was refused.
    #[error("the co-simulation refused `{command}`: {why}")]
    Refused {
        /// What it was to do.
        command: String,
        /// Its words.
        why: String,
    },
    /// The answer was none that this client knows.
    #[error("the co-simulation answered `{command}` with `{answer}`: client and server are of different versions")]
    Answer {
        /// What it was to do.
        command: String,
        /// The line it sent.
        answer: String,
    },
}

/// An RP2040 to be run.
#[derive(Clone, Debug, PartialEq)]
pub struct Chip {
    /// What it is called in commands and events.
    pub name: String,
    /// Its image.
    pub elf: PathBuf,
    /// How much faster than global time its crystal runs, parts per million.
    pub ppm: f64,
    /// When it is switched on.
    pub start_ns: Ns,
    /// Number of its flash chip.
    pub unique_id: u64,
    /// Where its flash is kept from one process to the next.
    pub flash: Option<PathBuf>,
    /// Pins that are tied to 3.3 V.
    pub high_pins: Vec<u8>,
}

impl Chip {
    /// A chip with a perfect crystal, switched on at once, with an empty flash.
    #[must_use]
    pub fn new(name: &str, elf: &Path, unique_id: u64) -> Self {
        let (name, elf) = (name.to_owned(), elf.to_owned());
        Self { name, elf, ppm: 0.0, start_ns: 0, unique_id, flash: None, high_pins: Vec::new() }
    }
}

/// What happens to the bytes of a wire, each direction with draws of its own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct WireFaults {
    /// Where the random numbers begin.
    pub seed: u64,
    /// Part of the bytes in which one bit is turned over.
    pub byte_error: f64,
    /// Part of the bytes that do not arrive.
    pub byte_loss: f64,
}

/// Which instant of a chip's clock is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ClockAt {
    /// The present.
    Now,
    /// A global instant, ns with their fraction.
    GlobalNs(f64),
    /// What the chip's own clock reads, ns since its boot.
    LocalNs(f64),
}

/// The truth about a chip's clock at one instant.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
pub struct ChipTime {
    /// Global time, ns.
    pub global_ns: f64,
    /// The chip's own since its boot, ns: its microsecond timer with all its fraction.
    pub local_ns: f64,
    /// How much faster than global time it runs now, parts per million.
    pub ppm: f64,
}

/// Something happened while the co-simulation ran.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// Bytes came to an outside port, or passed a tap, up to and with a delimiter.
    Frame {
        /// The port, or the wire and its direction: `w:ab`.
        port: String,
        /// The bytes.
        bytes: Vec<u8>,
        /// Beginning of the first start bit.
        start_ns: Ns,
        /// End of the last stop bit.
        end_ns: Ns,
    },
    /// Something happened to a chip.
    Chip {
        /// Which.
        chip: String,
        /// `watchdog`, `reset` or `fault`.
        event: String,
        /// More about it.
        detail: String,
    },
}

/// What one exception of a chip took since its profile was last reset, cycles of the processor's clock.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
pub struct ExceptionProfile {
    /// 16 plus the interrupt's number.
    pub number: u32,
    /// How often it ran.
    pub count: u64,
    /// The most it took itself, entry and return included, without what preempted it.
    pub cycles_max: u64,
    /// The sum of that.
    pub cycles_total: u64,
    /// The longest from its becoming pending to its first instruction.
    pub latency_cycles_max: u64,
    /// The longest from entry to return, with what preempted it.
    pub span_cycles_max: u64,
    /// How often it took how many cycles from its becoming pending to its first instruction, where that were no more than 1,023.
    #[serde(default)]
    pub latencies: Vec<(u64, u64)>,
}

/// What one UART of a chip did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
pub struct UartProfile {
    /// Bytes read.
    pub rx_bytes: u64,
    /// Bytes sent.
    pub tx_bytes: u64,
    /// Bytes lost for want of room in its FIFO.
    pub overruns: u64,
    /// The longest from a byte's arrival in the FIFO to its being read, ns.
    pub rx_wait_ns_max: f64,
}

/// Where a chip's time went since its profile was last reset.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
pub struct Profile {
    /// Cycles that passed.
    pub cycles: u64,
    /// Cycles asleep.
    pub sleep_cycles: u64,
    /// Instructions.
    pub instructions: u64,
    /// By exception.
    pub exceptions: Vec<ExceptionProfile>,
    /// The longest stretch with interrupts masked, cycles.
    pub primask_cycles_max: u64,
    /// Both UARTs.
    pub uarts: Vec<UartProfile>,
}

impl Profile {
    /// What interrupt `irq` took; zeros where it never ran.
    #[must_use]
    pub fn irq(&self, irq: u32) -> ExceptionProfile {
        let found = self.exceptions.iter().find(|exception| exception.number == 16 + irq);
        found.cloned().unwrap_or(ExceptionProfile { number: 16 + irq, ..ExceptionProfile::default() })
    }
}

/// What passed over a wire or an outside port, whose `a` is the outside.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
pub struct WireCounts {
    /// Which.
    pub name: String,
    /// Bytes from a to b.
    pub bytes_ab: u64,
    /// Bytes from b to a.
    pub bytes_ba: u64,
    /// Bytes with a bit turned over, a to b.
    pub errors_ab: u64,
    /// The same, b to a.
    pub errors_ba: u64,
    /// Bytes that did not arrive, a to b.
    pub lost_ab: u64,
    /// The same, b to a.
    pub lost_ba: u64,
}

/// The running co-simulation.
#[derive(Debug)]
pub struct Cosim {
    child: Child,
    to: ChildStdin,
    from: BufReader<ChildStdout>,
    now_ns: Ns,
    taps: bool,
}

impl Cosim {
    /// Starts the server in its file `server`.
    ///
    /// # Errors
    /// [`CosimError::Start`].
    pub fn start(server: &Path) -> Result<Self, CosimError> {
        let fail = |source| CosimError::Start { server: server.to_owned(), source };
        // the server compares its own name with the one it was started by
        let script = server.canonicalize().map_err(fail)?;
        let spawned = Command::new("node").arg(script).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
        let mut child = spawned.map_err(fail)?;
        let pipes = child.stdin.take().zip(child.stdout.take());
        let (to, from) = pipes.ok_or_else(|| fail(io::ErrorKind::BrokenPipe.into()))?;
        Ok(Self { child, to, from: BufReader::new(from), now_ns: 0, taps: false })
    }

    /// The present.
    #[must_use]
    pub const fn now_ns(&self) -> Ns {
        self.now_ns
    }

    /// Adds a chip.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn chip(&mut self, chip: &Chip) -> Result<(), CosimError> {
        let straps: BTreeMap<String, bool> = chip.high_pins.iter().map(|pin| (pin.to_string(), true)).collect();
        let mut command = json!({
            "cmd": "chip", "name": chip.name, "elf": chip.elf, "ppm": chip.ppm, "start_ns": chip.start_ns,
            "unique_id": format!("{:016x}", chip.unique_id), "flash": chip.flash,
        });
        command["straps"] = json!(straps);
        self.tell(&command)
    }

    /// Connects two UARTs, each a chip's name and a number, with each other.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn wire(
        &mut self,
        name: &str,
        a: (&str, u8),
        b: (&str, u8),
        faults: Option<WireFaults>,
    ) -> Result<(), CosimError> {
        self.tell(&json!({ "cmd": "wire", "name": name, "a": a, "b": b, "delay_ns": 0, "faults": faults }))
    }

    /// An outside endpoint at a UART, with a perfect rate of `baud` bits a second.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn port(
        &mut self,
        name: &str,
        to: (&str, u8),
        baud: u32,
        faults: Option<WireFaults>,
    ) -> Result<(), CosimError> {
        self.tell(&json!({ "cmd": "port", "name": name, "to": to, "baud": baud, "delay_ns": 0, "faults": faults }))
    }

    /// An outside endpoint at a chip's USB: a host's class driver, without timing.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn usb(&mut self, name: &str, chip: &str) -> Result<(), CosimError> {
        self.tell(&json!({ "cmd": "usb", "name": name, "chip": chip }))
    }

    /// From now on frames on a wire are events too, named by the wire and `:ab` or `:ba`.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn tap(&mut self, wire: &str) -> Result<(), CosimError> {
        self.taps = true;
        self.tell(&json!({ "cmd": "tap", "wire": wire }))
    }

    /// Whether any wire is tapped.
    #[must_use]
    pub const fn has_taps(&self) -> bool {
        self.taps
    }

    /// Queues bytes at an outside port, back to back with what is being sent, not before `at_ns`; says when they begin and end.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn send(&mut self, port: &str, bytes: &[u8], at_ns: Ns) -> Result<(Ns, Ns), CosimError> {
        #[derive(Deserialize)]
        struct Sent {
            start_ns: f64,
            end_ns: f64,
        }
        let sent: Sent = self.ask(&json!({ "cmd": "send", "port": port, "bytes": to_hex(bytes), "at_ns": at_ns }))?;
        Ok((whole(sent.start_ns), whole(sent.end_ns)))
    }

    /// Runs up to `until_ns`, or with `stop` to the end of the quantum in which something happened.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn run(&mut self, until_ns: Ns, stop: bool) -> Result<Vec<Event>, CosimError> {
        #[derive(Deserialize)]
        struct Ran {
            now_ns: f64,
            events: Vec<RawEvent>,
        }
        let command = json!({ "cmd": "run", "until_ns": until_ns, "stop": stop });
        let ran: Ran = self.ask(&command)?;
        self.now_ns = whole(ran.now_ns);
        let unreadable = || CosimError::Answer { command: command.to_string(), answer: "an odd frame".to_owned() };
        ran.events.into_iter().map(|event| event.typed().ok_or_else(unreadable)).collect()
    }

    /// Has a wire or port carry nothing, or carry again.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn cut(&mut self, wire: &str, cut: bool) -> Result<(), CosimError> {
        self.tell(&json!({ "cmd": "cut", "wire": wire, "cut": cut }))
    }

    /// Switches a chip off; its flash stays.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn power_off(&mut self, chip: &str) -> Result<(), CosimError> {
        self.tell(&json!({ "cmd": "stop", "chip": chip }))
    }

    /// Switches a chip on again.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn power_on(&mut self, chip: &str) -> Result<(), CosimError> {
        self.tell(&json!({ "cmd": "start", "chip": chip }))
    }

    /// Resets a chip by its RUN pin; its RAM stays.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn reset(&mut self, chip: &str) -> Result<(), CosimError> {
        self.tell(&json!({ "cmd": "reset", "chip": chip }))
    }

    /// The truth about a chip's clock at an instant since its last boot.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn time(&mut self, chip: &str, at: ClockAt) -> Result<ChipTime, CosimError> {
        let mut command = json!({ "cmd": "time", "chip": chip });
        match at {
            ClockAt::Now => {}
            ClockAt::GlobalNs(ns) => command["at_ns"] = json!(ns),
            ClockAt::LocalNs(ns) => command["local_ns"] = json!(ns),
        }
        self.ask(&command)
    }

    /// Has a chip's crystal run at `ppm`, and change by `ramp_ppm_per_s` from now on.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn crystal(&mut self, chip: &str, ppm: f64, ramp_ppm_per_s: f64) -> Result<(), CosimError> {
        self.tell(&json!({ "cmd": "crystal", "chip": chip, "ppm": ppm, "ramp_ppm_per_s": ramp_ppm_per_s }))
    }

    /// Reads a chip's memory.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn peek(&mut self, chip: &str, address: u32, len: usize) -> Result<Vec<u8>, CosimError> {
        #[derive(Deserialize)]
        struct Read {
            hex: String,
        }
        let command = json!({ "cmd": "peek", "chip": chip, "address": address, "bytes": len });
        let read: Read = self.ask(&command)?;
        from_hex(&read.hex).ok_or_else(|| CosimError::Answer { command: command.to_string(), answer: read.hex })
    }

    /// Writes instructions over the beginning of the function `symbol`, in a chip's RAM.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn poke_code(&mut self, chip: &str, symbol: &str, bytes: &[u8]) -> Result<(), CosimError> {
        // a function's symbol has the lowest bit set, which says Thumb and is no part of the address
        self.tell(&json!({ "cmd": "poke", "chip": chip, "symbol": symbol, "address": -1, "hex": to_hex(bytes) }))
    }

    /// Writes a chip's memory.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn poke(&mut self, chip: &str, address: u32, bytes: &[u8]) -> Result<(), CosimError> {
        self.tell(&json!({ "cmd": "poke", "chip": chip, "address": address, "hex": to_hex(bytes) }))
    }

    /// Where a chip's time went; with `reset` it is counted anew from now on.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn profile(&mut self, chip: &str, reset: bool) -> Result<Profile, CosimError> {
        self.ask(&json!({ "cmd": "profile", "chip": chip, "reset": reset }))
    }

    /// What passed over all wires and outside UART ports.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn wires(&mut self) -> Result<Vec<WireCounts>, CosimError> {
        #[derive(Deserialize)]
        struct Wires {
            wires: Vec<WireCounts>,
        }
        Ok(self.ask::<Wires>(&json!({ "cmd": "wires" }))?.wires)
    }

    /// What passed over one of them; zeros where there is no such.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn wire_counts(&mut self, name: &str) -> Result<WireCounts, CosimError> {
        Ok(self.wires()?.into_iter().find(|wire| wire.name == name).unwrap_or_default())
    }

    /// Writes the chips' flashes to their files.
    ///
    /// # Errors
    /// [`CosimError`].
    pub fn save(&mut self) -> Result<(), CosimError> {
        self.tell(&json!({ "cmd": "save" }))
    }

    fn tell(&mut self, command: &Value) -> Result<(), CosimError> {
        self.ask::<Value>(command).map(|_| ())
    }

    pub(crate) fn ask<A: serde::de::DeserializeOwned>(&mut self, command: &Value) -> Result<A, CosimError> {
        let gone = |_| CosimError::Gone { command: command.to_string() };
        writeln!(self.to, "{command}").and_then(|()| self.to.flush()).map_err(gone)?;
        let mut line = String::new();
        self.from.read_line(&mut line).map_err(gone)?;
        read_answer(command, &line)
    }
}

impl Drop for Cosim {
    fn drop(&mut self) {
        // it may have ended already
        let _killed = self.child.kill();
        let _reaped = self.child.wait();
    }
}

/// An event as it stands in the line.
#[derive(Deserialize)]
struct RawEvent {
    #[serde(default)]
    port: String,
    #[serde(default)]
    bytes: String,
    #[serde(default)]
    start_ns: f64,
    #[serde(default)]
    end_ns: f64,
    chip: Option<String>,
    #[serde(default)]
    event: String,
    #[serde(default)]
    detail: Value,
}

impl RawEvent {
    fn typed(self) -> Option<Event> {
        Some(match self.chip {
            Some(chip) => Event::Chip { chip, event: self.event, detail: self.detail.to_string() },
            None => Event::Frame {
                bytes: from_hex(&self.bytes)?,
                port: self.port,
                start_ns: whole(self.start_ns),
                end_ns: whole(self.end_ns),
            },
        })
    }
}

fn read_answer<A: serde::de::DeserializeOwned>(command: &Value, line: &str) -> Result<A, CosimError> {
    let command = || command.to_string();
    if line.is_empty() {
        return Err(CosimError::Gone { command: command() });
    }
    let answer = || CosimError::Answer { command: command(), answer: line.trim().to_owned() };
    let value: Value = serde_json::from_str(line).map_err(|_| answer())?;
    if let Some(why) = value.get("error") {
        return Err(CosimError::Refused { command: command(), why: why.as_str().unwrap_or("?").to_owned() });
    }
    serde_json::from_value(value).map_err(|_| answer())
}

/// Nanoseconds to the next whole one; below zero, which nothing is, 0.
fn whole(ns: f64) -> Ns {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "saturates; far below 2^53 in practice"
    )]
    let whole = ns.round() as Ns;
    whole
}

fn to_hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        // writing to a string never fails
        let _fits = write!(text, "{byte:02x}");
        text
    })
}

fn from_hex(text: &str) -> Option<Vec<u8>> {
    let digits = text.as_bytes();
    let pair = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok();
    digits.len().is_multiple_of(2).then(|| digits.chunks(2).map(pair).collect())?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_are_read_and_refusals_say_who_and_why() {
        let command = json!({ "cmd": "profile", "chip": "hub" });
        let line = r#"{"cycles":10,"sleep_cycles":4,"instructions":5,"primask_cycles_max":1,"uarts":[],
            "exceptions":[{"number":27,"count":2,"cycles_max":90,"cycles_total":100,"latency_cycles_max":16,"span_cycles_max":95}]}"#
            .replace('\n', "");
        let profile: Profile = read_answer(&command, &line).unwrap();
        assert_eq!((profile.irq(11).cycles_max, profile.irq(12).count), (90, 0));
        let error = read_answer::<Profile>(&command, r#"{"error":"profile: no chip \"hub\""}"#).unwrap_err();
        assert!(error.to_string().contains("no chip") && error.to_string().contains("profile"), "{error}");
        assert!(matches!(read_answer::<Profile>(&command, ""), Err(CosimError::Gone { .. })));
        assert!(matches!(read_answer::<Profile>(&command, "{}\n"), Err(CosimError::Answer { .. })));
    }

    #[test]
    fn events_are_frames_or_what_happened_to_a_chip() {
        let frame = r#"{"port":"p","bytes":"0102ff00","start_ns":10.4,"end_ns":20.6}"#;
        let event = serde_json::from_str::<RawEvent>(frame).unwrap().typed().unwrap();
        let (port, bytes) = ("p".to_owned(), vec![1, 2, 255, 0]);
        assert_eq!(event, Event::Frame { port, bytes, start_ns: 10, end_ns: 21 });
        let reset = r#"{"chip":"hub","event":"watchdog","detail":"timer"}"#;
        let event = serde_json::from_str::<RawEvent>(reset).unwrap().typed();
        assert!(matches!(event, Some(Event::Chip { chip, .. }) if chip == "hub"));
        assert!(from_hex("012").is_none() && from_hex("zz").is_none());
        assert_eq!(from_hex(&to_hex(&[0, 16, 255])), Some(vec![0, 16, 255]));
    }

    #[test]
    fn a_server_that_is_not_there_is_told_with_what_to_do() {
        let error = Cosim::start(Path::new("nowhere/server.mjs")).unwrap_err();
        assert!(error.to_string().contains("cargo xtask hil"), "{error}");
    }
}

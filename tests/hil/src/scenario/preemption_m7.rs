//! A Cortex-M7 hub forwards while its user port spins: shown by counting, as QEMU has instructions and no cycles.
//!
//! - **Walk:** [`CountedHub`] → a long spin at the hub, and pings through it to the motor one after the other, until the hub's probe has
//!   noted the end of that turn of serving → the probe's [`Record`], read from the hub's memory.
//! - **Invariants:** a ping counts as forwarded during the spin if it was answered before the turn's end was noted: then it went into the
//!   hub and out of it twice. The first one may have come before the spin began, and does not count. No wall clock is judged.
//! - **Context:** real time between the processes; within the hub 4 ns an instruction. **Clauses:** `[APP-10]`, `[NOD-08]`.

use super::Context;
use crate::machine::{CountedHub, Part};
use crate::pico::route;
use crate::qemu::UARTS;
use crate::report::{Failure, Report, table};
use fixed_math::time::Span;
use osap::core::Outcome;
use osap::session::{ECHO_PORT, Session};
use osap_protocol::PortIndex;
use osap_protocol::discovery::TimeSettings;
use osap_runtime::sequenced::{Destination, Expect, Ticket};
use serde_json::json;

/// Ports of every device, `[APP-01]`.
const SPIN: PortIndex = PortIndex::from_low_bits(3);
/// Where the probe's record stands in the hub's memory, as `boards/mps2-an500/src/kept.rs` says.
const RECORD_OFFSET: u64 = 0x6000;
/// Begins it, as `boards/mps2-an500/src/latency.rs` says.
const RECORD_MARK: u32 = 0x0511_1a7e;
/// Words of it.
const RECORD_WORDS: usize = 8;
/// The probe counts ticks of 40 ns.
const TICKS_A_MS: u32 = 25_000;
/// The spin lasts at least so long.
const SPIN_TICKS_MIN: u32 = 50 * TICKS_A_MS;
/// So long it is meant to last, for several pings to fit in: each of their bytes takes a round of QEMU's, which hands them over one by one.
const SPIN_TICKS: u32 = 150 * TICKS_A_MS;
/// Turns of the first spin, whose time tells what a turn takes.
const TRIAL_TURNS: u32 = 100_000;
/// Most turns that the spin port takes, `[APP-11]`.
const TURNS_MAX: u32 = 10_000_000;
/// Questions until a device that was just started must have answered.
pub(super) const TRIES: usize = 40;
/// Pause after one that was not answered.
pub(super) const RETRY: Span = Span::from_us(50_000);
/// Nodes that have just met ask each other for the time without end, a second by their own clocks; QEMU, which hands bytes over one by one, is
/// busy with that. Three times as long, as an emulated clock may be slower than the host's.
const BURSTS: Span = Span::from_us(3 * osap_runtime::BURST as u64 * osap_runtime::BURST_INTERVAL_US);
/// Spins that are tried until a ping got through during one.
const ATTEMPTS_MAX: u32 = 3;
/// Frames that the hub sends for a ping through it: there and back.
const FRAMES_A_PING: u32 = 2;
/// Pings during one spin at most: a spin that never ends is an error.
const PINGS_MAX: u32 = 20_000;

/// The longest frame here, of announcements and pings; the table shows the mean.
const FRAME_BYTES: u32 = 32;
/// Instructions of the interrupts for a byte in and for a byte out: all that stand there, RTIC's entry and `now` among them, are 189 and 101,
/// and none is a loop but the counting by exclusive access.
const BYTE_INSTRUCTIONS: [u32; 2] = [200, 110];
/// The hub's.
const LINKS: u32 = 5;
const _: () = assert!(UARTS == 5, "as many");
/// Instructions in a tick: 4 ns each.
const TICK_INSTRUCTIONS: u32 = 10;
/// What an interrupt of the links may wait: that all UARTs take in and send a frame on end, with one interrupt more for each. Nothing in it
/// depends on how long a user function takes.
const WAIT_TICKS_MAX: u32 =
    LINKS * (FRAME_BYTES + 1) * (BYTE_INSTRUCTIONS[0] + BYTE_INSTRUCTIONS[1]) / TICK_INSTRUCTIONS;

/// What the hub's probe counted; the table in `boards/mps2-an500/src/latency.rs`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Record {
    turn_ticks: u32,
    wait_ticks: u32,
    bytes_in: u32,
    bytes_out: u32,
    frames_out: u32,
}

impl Record {
    /// Reads it; `None` where the image writes none.
    fn decode(bytes: &[u8]) -> Option<Self> {
        let mut words = [0; RECORD_WORDS];
        for (word, four) in words.iter_mut().zip(bytes.as_chunks().0) {
            *word = u32::from_le_bytes(*four);
        }
        let [mark, _, _, turn_ticks, wait_ticks, bytes_in, bytes_out, frames_out] = words;
        (mark == RECORD_MARK).then_some(Self { turn_ticks, wait_ticks, bytes_in, bytes_out, frames_out })
    }
}

pub(super) fn run(context: &Context) -> Result<Report, Failure> {
    let mut report = Report::new();
    for attempt in 1..=ATTEMPTS_MAX {
        let (turns, forwarded, spun) = measure(context)?;
        // a computer that is busy with others may not get a ping through in time: that says nothing about the hub
        if forwarded > 0 || attempt == ATTEMPTS_MAX {
            describe(&mut report, turns, forwarded, &spun);
            break;
        }
    }
    Ok(report)
}

/// Turns spun, pings forwarded meanwhile, and what the hub counted in that time.
fn measure(context: &Context) -> Result<(u32, u32, Record), Failure> {
    let machine = CountedHub::start(&context.places)?;
    let mut session = machine.session()?;
    let hub = session.destination(&route(Part::Hub.route()));
    let motor = session.destination(&route(Part::Motor.route()));
    for device in [&hub, &motor] {
        await_answer(&mut session, device)?;
        // from then on once in ten seconds at the most
        let settings = session.time_status(device)?.value.settings;
        session.set_time_control(device, &TimeSettings { interval_us: 10_000_000, ..settings })?;
    }
    session.network().pause(BURSTS)?;
    let a_turn = trial(&machine, &mut session, &hub)?;
    let turns = u64::from(SPIN_TICKS) * u64::from(TRIAL_TURNS) / u64::from(a_turn.turn_ticks.max(1));
    let turns = u32::try_from(turns).unwrap_or(TURNS_MAX).min(TURNS_MAX);
    let forwarded = pings_during(&machine, &mut session, turns, &a_turn)?;
    Ok((turns, forwarded, record(&machine)?))
}

/// Spins for a short while: what a turn takes.
fn trial(machine: &CountedHub, session: &mut Session, hub: &Destination) -> Result<Record, Failure> {
    let spin = Destination { port: SPIN, ttl_us: u16::MAX, ..hub.clone() };
    // the reply leaves before the turn of serving has ended; that of the second one does not come before the first is in the record
    for turns in [TRIAL_TURNS, 1] {
        session.request(&spin, "spin", &turns.to_le_bytes())?;
    }
    record(machine)
}

fn describe(report: &mut Report, turns: u32, forwarded: u32, spun: &Record) {
    report.line(
        "Forwarding through a Cortex-M7 hub while its user port spins, by counting in QEMU at 4 ns an instruction",
    );
    let ms = format!("{:.2}", f64::from(spun.turn_ticks) / f64::from(TICKS_A_MS));
    let counts = [turns, forwarded, spun.frames_out, spun.bytes_in, spun.bytes_out, spun.wait_ticks];
    let mut row = counts.map(|count| count.to_string()).to_vec();
    row.insert(1, ms.clone());
    let head = ["turns", "spun ms", "pings forwarded", "frames sent", "bytes in", "bytes out", "longest wait, 40 ns"];
    report.line(table(&head, &[row]));
    report.datum(
        "m7",
        json!({ "spun_ticks": spun.turn_ticks, "pings": forwarded, "frames_sent": spun.frames_out, "wait_ticks_max": spun.wait_ticks }),
    );
    report
        .check(spun.turn_ticks >= SPIN_TICKS_MIN, format!("Cortex-M7: the user port spun for {ms} ms of instructions"));
    report.check(
        forwarded > 0 && spun.frames_out >= forwarded * FRAMES_A_PING,
        format!(
            "Cortex-M7: {forwarded} pings went there and back through the spinning hub, which sent {} frames meanwhile",
            spun.frames_out
        ),
    );
    report.check(
        spun.wait_ticks <= WAIT_TICKS_MAX,
        format!(
            "Cortex-M7: an interrupt of the links waited {} ticks of 40 ns at most, of {WAIT_TICKS_MAX}",
            spun.wait_ticks
        ),
    );
}

fn record(machine: &CountedHub) -> Result<Record, Failure> {
    let bytes = machine.hub_memory(RECORD_OFFSET, RECORD_WORDS * 4)?;
    Record::decode(&bytes).ok_or_else(|| {
        Failure::NotRun("the hub's image counts nothing: build it with its default features, which have `probe`".into())
    })
}

/// Asks until a device that was just started answers.
pub(super) fn await_answer(session: &mut Session, to: &Destination) -> Result<(), Failure> {
    for _ in 0..TRIES {
        if session.runtime_info(to).is_ok() {
            return Ok(());
        }
        session.network().pause(RETRY)?;
    }
    Err(Failure::Failed(format!("{:?} did not answer {TRIES} questions", to.route)))
}

fn submit(session: &mut Session, to: &Destination, payload: &[u8]) -> Result<Ticket, Failure> {
    let sent = session.network().submit(to.clone(), Expect::One, payload);
    sent.map_err(|error| Failure::Failed(format!("not sent: {error:?}")))
}

/// Pings the motor while the hub spins; says how many were answered meanwhile.
fn pings_during(machine: &CountedHub, session: &mut Session, turns: u32, trial: &Record) -> Result<u32, Failure> {
    let hub = session.destination(&route(Part::Hub.route()));
    let motor = session.destination(&route(Part::Motor.route()));
    // the shortest there is: what takes QEMU long to hand over may not be too old for the hub
    let ping_to = Destination { port: ECHO_PORT, ttl_us: u16::MAX, ..motor };
    submit(session, &Destination { port: SPIN, ttl_us: u16::MAX, ..hub }, &turns.to_le_bytes())?;
    let (mut answered, mut is_over) = (0, false);
    for number in 0..PINGS_MAX {
        let ping = submit(session, &ping_to, &[1])?;
        let outcome = loop {
            let completion = session.network().wait()?;
            if completion.ticket == ping {
                break completion.outcome;
            }
        };
        if is_over {
            return Ok(answered);
        }
        // the words are not written at once: what is read after one more ping is whole
        is_over = record(machine)?.turn_ticks > trial.turn_ticks;
        let once = matches!(outcome, Outcome::Reply(reply) if reply.tries == 1);
        answered += u32::from(once && number > 0 && !is_over);
    }
    Err(Failure::Failed(format!("the hub's spin did not end within {PINGS_MAX} pings")))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The table in `boards/mps2-an500/src/latency.rs`.
    #[test]
    fn a_record_is_read_as_the_board_writes_it_and_nothing_else_for_one() {
        let words: [u32; RECORD_WORDS] = [RECORD_MARK, 1, 2, 3, 4, 5, 6, 7];
        let bytes = words.map(u32::to_le_bytes).concat();
        let seen = Record { turn_ticks: 3, wait_ticks: 4, bytes_in: 5, bytes_out: 6, frames_out: 7 };
        assert_eq!(Record::decode(&bytes), Some(seen));
        assert_eq!(Record::decode(&[0; 32]), None);
    }
}

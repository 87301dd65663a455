//! Levels through a gate to an output pin, and readings at an interval and at an edge.
//!
//! - **Walk:** levels and a node by the motion port → the pin's edges in system time, the readings' stamps. **Clauses:** `[MOT-12]` to `[MOT-14]`.

use super::judge::BEAT_US;
use super::play::seen;
use super::stage::Stage;
use crate::pins::{AXES, PICO_OUTPUTS};
use crate::report::{Failure, Report};
use fixed_math::logic::{Node, Source};
use fixed_math::time::{NetTime, Span};
use osap_protocol::motion::{MotionRequest, TriggerSettings};

/// Input of the first level: two of each axis and two ramps stand before it.
const INPUT_LEVELS: usize = 2 * AXES + 2;
/// Node of the gate, output that follows it, triggers.
const NODE: u8 = 0;
const OUTPUT: u8 = 1;
const AT_INTERVAL: u8 = 0;
const AT_EDGE: u8 = 1;
/// Channel of the inputs' levels.
const CHANNEL: u8 = 1;
/// From one reading to the next.
const BEATS: u32 = 50;
/// When the level changes, µs after the gate opens, none of them on a beat; the last with the gate closed.
const CHANGES_US: [u64; 5] = [1_001, 3_333, 7_777, 9_030, 15_000];
const CLOSES_US: u64 = 12_345;

pub(super) fn run(stage: &mut Stage, report: &mut Report, delay: Span) -> Result<(), Failure> {
    drop(seen(stage)?);
    stage.pins[0].others.clear();
    stage.readings.clear();
    let input = |index: u8| {
        let at = u8::try_from(INPUT_LEVELS).unwrap_or(u8::MAX) + index;
        Source::input(at).ok_or_else(|| Failure::Failed(format!("no input {at}")))
    };
    let bytes = Node::Gate { a: input(0)?, open: input(1)?, otherwise: 0 }.encode();
    stage.ask(0, &MotionRequest::SetNode { node: NODE, bytes })?;
    stage.ask(0, &MotionRequest::SetOutput { output: OUTPUT, node: Some(NODE) })?;
    let edge = TriggerSettings::Edge { node: NODE, rising: true, falling: true };
    stage.tell(0, &MotionRequest::SetTrigger { trigger: AT_EDGE, channel: CHANNEL, settings: edge })?;
    // tracks are played behind system time by what stops have used up
    let opens = (stage.now() + Span::from_us(40_000)).shifted(-delay.steps().cast_signed());
    let mut level = |track: u8, us: u64, value: i32| {
        let start_steps = (opens + Span::from_us(us)).steps();
        stage.ask(0, &MotionRequest::Level { track, start_steps, value }).map(|_| ())
    };
    level(1, 0, 1)?;
    level(1, CLOSES_US, 0)?;
    for (number, us) in (0..).zip(CHANGES_US) {
        level(0, us, i32::from(number % 2 == 0))?;
    }
    let system = |us: u64| opens + Span::from_us(us) + delay;
    stage.run_until(system(20_000))?;
    stage.tell(0, &MotionRequest::SetTrigger { trigger: AT_EDGE, channel: CHANNEL, settings: TriggerSettings::Off })?;
    let at_edges = std::mem::take(&mut stage.readings);
    let at_interval = interval(stage)?;
    drop(seen(stage)?);
    let pin = PICO_OUTPUTS[usize::from(OUTPUT)];
    let edges: Vec<(bool, f64)> =
        stage.pins[0].others.iter().filter(|(of, ..)| *of == pin).map(|(_, is_high, at)| (*is_high, *at)).collect();
    // the first four changes, of which the last leaves it low; the fifth comes behind the closed gate
    let wanted: Vec<(bool, NetTime)> =
        (0..).zip(&CHANGES_US[..4]).map(|(number, us)| (number % 2 == 0, beat_from(system(*us)))).collect();
    let late: Vec<f64> = edges
        .iter()
        .zip(&wanted)
        .map(|((_, at), (_, due))| at / 1_000.0 - super::stage::ns(due.steps()) / 1_000.0)
        .collect();
    let is_so = edges.len() == wanted.len()
        && edges.iter().zip(&wanted).all(|((is_high, _), (high, _))| is_high == high)
        && late.iter().all(|us| (0.0..2.0).contains(us));
    report.check(
        is_so,
        format!("signals: a level through a gate turns output {OUTPUT} over {} times of {}, so many µs after the first beat at which it holds: {late:.2?}", edges.len(), wanted.len()),
    );
    let stamps: Vec<NetTime> = at_edges.iter().map(|reading| reading.time).collect();
    let due: Vec<NetTime> = wanted.iter().map(|(_, at)| *at).collect();
    report.check(
        stamps == due,
        format!("readings: at {} edges of the node, each stamped with the edge's beat", stamps.len()),
    );
    let period = Span::from_us(u64::from(BEATS) * BEAT_US);
    // the first comes with the beat after it was asked for, in no phase with the others
    let regular = at_interval[1.min(at_interval.len())..].windows(2).all(|pair| pair[1].since(pair[0]) == period);
    let on_beats = at_interval.iter().all(|time| time.steps().is_multiple_of(BEAT_US << 8));
    report.check(
        at_interval.len() >= 20 && regular && on_beats,
        format!(
            "readings: {} at an interval of {BEATS} beats, each stamped with a beat, none missing",
            at_interval.len()
        ),
    );
    Ok(())
}

/// Stamps of readings at an interval.
fn interval(stage: &mut Stage) -> Result<Vec<NetTime>, Failure> {
    let settings = TriggerSettings::Interval { beats: BEATS };
    stage.tell(0, &MotionRequest::SetTrigger { trigger: AT_INTERVAL, channel: CHANNEL, settings })?;
    stage.run_until(stage.now() + Span::from_us(90_000))?;
    stage.tell(
        0,
        &MotionRequest::SetTrigger { trigger: AT_INTERVAL, channel: CHANNEL, settings: TriggerSettings::Off },
    )?;
    stage.run_until(stage.now() + Span::from_us(30_000))?;
    Ok(std::mem::take(&mut stage.readings).into_iter().map(|reading| reading.time).collect())
}

/// The first beat at or after a time.
fn beat_from(time: NetTime) -> NetTime {
    let beat = BEAT_US << 8;
    NetTime::from_steps(time.steps().div_ceil(beat) * beat)
}

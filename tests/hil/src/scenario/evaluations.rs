//! Cycles of what a beat calls, on a Cortex-M0+ in a real image, and the share of the processor that playing takes.
//!
//! - **Walk:** the Pico image with the feature `evaluate` marks each of its loops by a pulse at GPIO16 → the pulses' lengths less those of
//!   empty loops → cycles an evaluation, against the goals. Then images that play: [`super::motion::share`].
//! - **Invariants:** code runs from RAM, as on the chip, so that nothing waits for flash; nobody else uses the bus. An edge is exact to the cycle.
//! - **What it is not:** a loop's turn beside the evaluation is taken off as an empty loop has it; what registers the evaluation takes from it is not.

use super::Context;
use crate::cosim::{Cosim, NS_PER_MS};
use crate::images::Image;
use crate::pico::{CORE_HZ, MOTOR, pico};
use crate::pins::{Level, PICO_OUTPUTS};
use crate::report::{Failure, Report, real, table};
use fixed_math::kernels::{BLOCKS, Block};
use serde_json::json;

/// Goals: cycles a position with its velocity, and a sample of a block.
const GOALS: [(&str, f64); 2] = [("horner_position_velocity", 40.0), ("differences_block", 20.0)];
/// All loops are over before, ms: most of it goes to copying the image to RAM by the slow clock of the start.
const RUN_MS: u64 = 300;

pub(super) fn run(context: &Context) -> Result<Report, Failure> {
    let mut report = Report::new();
    cycles(context, &mut report)?;
    super::motion::share::run(context, &mut report)?;
    Ok(report)
}

fn cycles(context: &Context, report: &mut Report) -> Result<(), Failure> {
    let pulses = pulses(context)?;
    let wanted = BLOCKS.len();
    if pulses.len() != wanted {
        return Err(Failure::Failed(format!("{} pulses at GPIO{}, not {wanted}", pulses.len(), PICO_OUTPUTS[0])));
    }
    report.line("Cycles an evaluation on a Cortex-M0+, all in memory, less a loop that only loads and stores");
    let (mut rows, mut data) = (Vec::new(), Vec::new());
    for (block, pulse) in BLOCKS.iter().zip(&pulses) {
        let Some(cycles) = net(block, *pulse, &pulses) else { continue };
        let goal = GOALS.iter().find(|(name, _)| *name == block.name).map(|(_, goal)| *goal);
        rows.push(vec![
            block.name.to_owned(),
            format!("{cycles:.1}"),
            goal.map_or_else(String::new, |it| it.to_string()),
        ]);
        data.push(json!({ "name": block.name, "cycles": cycles, "goal": goal, "evaluations": block.evaluations }));
        if let Some(goal) = goal {
            report.check(cycles <= goal, format!("{}: {cycles:.1} cycles, of {goal}", block.name));
        }
    }
    report.line(table(&["evaluation", "cycles", "goal"], &rows));
    report.datum("evaluations", data.into());
    Ok(())
}

/// Cycles an evaluation of `block`, whose pulse was `pulse` long; `None` for an empty one.
fn net(block: &Block, pulse: f64, pulses: &[f64]) -> Option<f64> {
    let empty = BLOCKS.iter().position(|other| Some(other.name) == block.empty)?;
    Some((pulse - pulses.get(empty)?) / f64::from(block.evaluations))
}

/// Lengths of all pulses, cycles.
fn pulses(context: &Context) -> Result<Vec<f64>, Failure> {
    let elf = context.places.image(Image::Rp2040PicoEvaluate)?;
    let mut cosim = Cosim::start(&context.places.server())?;
    cosim.chip(&pico("device", &elf, 0xd1, MOTOR))?;
    cosim.pins("device", 1 << PICO_OUTPUTS[0])?;
    cosim.run(RUN_MS * NS_PER_MS, false)?;
    let edges = cosim.edges("device")?;
    let (mut began, mut lengths) = (None, Vec::new());
    for edge in &edges.edges {
        match (edge.level, began) {
            (Level::High, None) => began = Some(edge.local_ns),
            (Level::Low, Some(since)) => {
                lengths.push(((edge.local_ns - since) * real(CORE_HZ) / 1e9).round());
                began = None;
            }
            _ => {}
        }
    }
    Ok(lengths)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_loop_is_taken_off_its_own_kind_and_goals_are_of_blocks_that_there_are() {
        let pulses: Vec<f64> = (1..=BLOCKS.len()).map(|at| 100.0 * real(at as u64)).collect();
        assert_eq!(net(&BLOCKS[0], pulses[0], &pulses), None);
        let (at, block) = BLOCKS.iter().enumerate().find(|(_, block)| block.name == "horner_position").unwrap();
        let empty = BLOCKS.iter().position(|other| other.name == "empty_part").unwrap();
        let expected = (pulses[at] - pulses[empty]) / f64::from(block.evaluations);
        assert_eq!(net(block, pulses[at], &pulses), Some(expected));
        assert!(GOALS.iter().all(|(name, _)| BLOCKS.iter().any(|block| block.name == *name)));
    }
}

//! Worst cycles of each task of the Pico image, measured under several loads.
//!
//! - **Walk:** a load → the co-simulation's profile → the most of each task, for the table in the image's `main.rs`.
//! - **Invariants:** a task's cycles are its own: what preempted it is not in them, entry and return are. The figures in the image's table
//!   must not be below what is measured here. That of `receive` is for a burst: the worst single interrupt, as often as both UARTs may
//!   interrupt from one drain to the next. That they do not more often is checked under every load.
//! - **What it is not:** code runs from RAM, as on the chip, so that no cache is missing; contention of both bus masters is not modelled.

use super::Context;
use crate::cosim::{NS_PER_MS, NS_PER_S, Profile, WireFaults};
use crate::network::HostPort;
use crate::pico::{Bench, HUB, cycles_us, pico, route};
use crate::report::{Failure, Report, real, table};
use crate::tasks::TaskTable;
use crate::traffic::Traffic;
use fixed_math::time::Span;
use osap::ping::PingOptions;
use osap::scan::ScanOptions;
use osap_protocol::PortIndex;
use osap_protocol::transport::Transport;
use serde_json::json;
use std::collections::BTreeMap;

/// Tasks of the image and the interrupts that they are bound to.
pub(super) const TASKS: [(&str, u32); 7] = [
    ("interpolate", 4),
    ("receive", RECEIVE),
    ("transmitted", 12),
    ("wake", 0),
    ("usb", 5),
    ("route", ROUTE),
    ("serve", 27),
];

/// Interrupts of two of them.
const RECEIVE: u32 = 11;
const ROUTE: u32 = 26;
/// Of a Pico.
const UARTS: u64 = 2;

/// What a task took at most under one load: cycles, and cycles from pending to its first instruction.
type Most = BTreeMap<&'static str, (u64, u64)>;

pub(super) fn run(context: &Context) -> Result<Report, Failure> {
    let mut loads: Vec<(&str, Profile)> = Vec::new();
    let mut bench = Bench::hub_and_device(&context.places, context.seed, None)?;
    for load in ["idle", "scan", "pings", "segments", "naming", "spin"] {
        profile(&bench)?;
        apply(&mut bench, load)?;
        loads.push((load, profile(&bench)?));
    }
    drop(bench);
    loads.push(("usb", over_usb(context)?));
    let faults = WireFaults { seed: context.seed, byte_error: 1e-4, byte_loss: 0.0 };
    for (load, faults) in [("full load", None), ("full, errors", Some(faults))] {
        let mut bench = Bench::loop_through_hub(&context.places, context.seed, faults)?;
        profile(&bench)?;
        let mut traffic =
            Traffic::new(context.seed, ["/0/1", "/1/0"].map(|text| route(text).to_buf()), PortIndex::from_low_bits(2));
        let until = bench.session.network().now() + Span::from_us(200_000);
        let task = move |core: &mut osap::core::HostCore, now| {
            traffic.take(core);
            traffic.feed(core, now);
            false
        };
        bench.session.network().drive(until, Box::new(task))?;
        loads.push((load, profile(&bench)?));
    }
    let mut report = Report::new();
    report.line("Own cycles of each task at most, of the Pico hub at 125 MHz (8 ns a cycle)");
    let most = describe(&mut report, &loads);
    let burst = burst(context)?;
    for (load, profile) in &loads {
        let (receive, routed) = (profile.irq(RECEIVE).count, profile.irq(ROUTE).count);
        // one turn may have drained before the profile began
        let bound = (routed + 1) * burst;
        report.check(
            receive <= bound,
            format!("{load}: {receive} receive interrupts, at most {burst} a turn of route are {bound}"),
        );
    }
    compare(&mut report, context, &most, burst)?;
    Ok(report)
}

/// A scan and echoes over USB.
fn over_usb(context: &Context) -> Result<Profile, Failure> {
    let mut bench = Bench::build(&context.places, context.seed, &[HostPort::usb("usb")], false, |cosim, elf| {
        cosim.chip(&pico("hub", elf, 0xa1, HUB))?;
        Ok(cosim.usb("usb", "hub")?)
    })?;
    bench.run_for(NS_PER_S)?;
    profile(&bench)?;
    bench.session.scan(&ScanOptions::default(), &mut |_| {})?;
    let hub = bench.session.destination(&route("/0"));
    for len in [1, 64, 200] {
        bench.session.echo(&hub, Transport::Sequenced, &vec![7; len])?;
    }
    profile(&bench)
}

/// How often both UARTs interrupt at most from one drain to the next: each until routing is woken, once a byte, and once more for a byte that
/// was asked for while the interrupt was off and drained since.
fn burst(context: &Context) -> Result<u64, Failure> {
    let file = "boards/rp2040-pico/src/uart.rs";
    let source = std::fs::read_to_string(context.places.file(file))?;
    let (_, behind) = source.split_once("const WAKE_BYTES: usize = ").unwrap_or_default();
    let number = behind.split(';').next().and_then(|number| number.trim().parse::<u64>().ok());
    let wake_bytes = number.ok_or_else(|| Failure::Failed(format!("{file} states no number as WAKE_BYTES")))?;
    Ok(UARTS * (wake_bytes + 1))
}

fn profile(bench: &Bench) -> Result<Profile, Failure> {
    Ok(bench.cosim.borrow_mut().profile("hub", true)?)
}

fn apply(bench: &mut Bench, load: &str) -> Result<(), Failure> {
    let hub = bench.session.destination(&route("/0"));
    let device = bench.session.destination(&route("/0/1"));
    match load {
        "scan" => drop(bench.session.scan(&ScanOptions::default(), &mut |_| {})?),
        "pings" => {
            let options = PingOptions { count: 100, interval: Span::from_us(700), ..PingOptions::default() };
            bench.session.ping(&hub, &options, &mut |_, _| ())?;
            bench.session.ping(&device, &options, &mut |_, _| ())?;
        }
        "segments" => {
            for len in [300, 700, 1_000] {
                bench.session.echo(&hub, Transport::Segmented, &vec![7; len])?;
                bench.session.echo(&device, Transport::Segmented, &vec![7; len])?;
            }
        }
        "naming" => {
            for name in ["a", "a hub with a longer name", "b"] {
                bench.session.set_name(&hub, name)?;
                bench.run_for(20 * NS_PER_MS)?;
            }
        }
        "spin" => drop(super::preemption::spin(bench, &hub, 100_000)?),
        _ => bench.run_for(300 * NS_PER_MS)?,
    }
    Ok(())
}

fn describe(report: &mut Report, loads: &[(&str, Profile)]) -> Most {
    let mut most = Most::new();
    let mut rows = Vec::new();
    for (name, irq) in TASKS {
        let runs = loads.iter().map(|(_, profile)| profile.irq(irq));
        let worst = runs.clone().map(|run| run.cycles_max).max().unwrap_or(0);
        let latency = runs.clone().map(|run| run.latency_cycles_max).max().unwrap_or(0);
        most.insert(name, (worst, latency));
        let cells = runs.map(|run| run.cycles_max.to_string());
        let ends = [worst.to_string(), format!("{:.1}", cycles_us(worst)), format!("{:.1}", cycles_us(latency))];
        rows.push(std::iter::once(name.to_owned()).chain(cells).chain(ends).collect());
    }
    let masked = loads.iter().map(|(_, profile)| profile.primask_cycles_max).max().unwrap_or(0);
    let mut head = vec!["task"];
    head.extend(loads.iter().map(|(load, _)| *load));
    head.extend(["worst", "µs", "pending µs"]);
    report.line(table(&head, &rows));
    for (load, profile) in loads {
        let busy = 100.0 - 100.0 * real(profile.sleep_cycles) / real(profile.cycles.max(1));
        let (receive, routed) = (profile.irq(RECEIVE).count, profile.irq(ROUTE).count);
        let share = |(name, irq): &(&str, u32)| {
            let part = 100.0 * real(profile.irq(*irq).cycles_total) / real(profile.cycles.max(1));
            (part >= 1.0).then(|| format!("{name} {part:.0} %"))
        };
        let shares: Vec<String> = TASKS.iter().filter_map(share).collect();
        report.line(format!(
            "{load}: {busy:.0} % busy ({}), {receive} receive interrupts, {routed} runs of route",
            shares.join(", ")
        ));
    }
    report.line(format!("longest with all interrupts masked: {masked} cycles"));
    report.datum(
        "worst_cycles",
        most.iter()
            .map(|(task, (worst, latency))| json!({ "task": task, "cycles": worst, "pending_cycles": latency }))
            .collect(),
    );
    most
}

/// The image's own table must not claim less than was measured.
fn compare(report: &mut Report, context: &Context, most: &Most, burst: u64) -> Result<(), Failure> {
    let source = std::fs::read_to_string(context.places.file("rtic-firmware/rp2040-pico/src/main.rs"))?;
    let claimed = match TaskTable::read(&source) {
        Ok(claimed) => claimed,
        Err(error) => {
            report.not_run("the image's table against these figures", error.to_string());
            return Ok(());
        }
    };
    for (task, (worst, _)) in most {
        let Some(row) = claimed.tasks.iter().find(|row| row.name == *task) else {
            report.check(false, format!("{task}: {worst} cycles measured, and no row in the table"));
            continue;
        };
        let (runs, what) = if *task == "receive" { (burst, format!("{burst} times ")) } else { (1, String::new()) };
        match (row.worst_cycles, row.deadline_us) {
            (Some(claim), _) => report.check(
                real(runs * worst) <= claim,
                format!("{task}: {what}{worst} cycles measured, {claim} in the table"),
            ),
            // user functions take what they take
            (None, None) => report.line(format!("{task}: {worst} cycles here; the table promises nothing of it")),
            (None, Some(_)) => report.check(false, format!("{task}: a deadline and no cycles in the table")),
        }
    }
    Ok(())
}

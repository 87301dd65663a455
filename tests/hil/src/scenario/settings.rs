//! What outlives power-off and reset on a Pico: its name, and why it started anew. The latter on an emulated Cortex-M7 too.
//!
//! - **Walk:** a name → idle writes it to flash, while pings pass through → power-off, reset → the name is still there. Code that was
//!   overwritten → a fault, or a hang that the watchdog ends → the report in the debug log.
//! - **Invariants:** the flash takes the time that its data sheet gives. Virtual time; the Cortex-M7's part is in real time.
//! - **Clauses:** `[DSC-05]`, `[DSC-06]`.

use super::Context;
use super::preemption_m7::{RETRY, TRIES, await_answer};
use crate::cosim::{NS_PER_MS, NS_PER_S};
use crate::machine::CountedHub;
use crate::pico::{Bench, route};
use crate::report::{Failure, Report};
use fixed_math::time::Span;
use osap::ping::{PingOptions, PingReport};
use osap::session::Session;
use osap_protocol::discovery::Event;
use osap_runtime::sequenced::Destination;

/// The function that routes; what is written over it decides how the chip fails.
const ROUTE: &str = "SW0_IRQ";
/// The vector of what routes on the mps2-an500, `PORT0`: the table begins at 0 with 16 exceptions, and it is interrupt 6.
const ROUTE_VECTOR: u32 = (16 + 6) * 4;
/// `udf #0`: no instruction.
const UNDEFINED: [u8; 2] = [0x00, 0xde];
/// `b .`: for ever.
const FOREVER: [u8; 2] = [0xfe, 0xe7];
/// Starts a hub anew.
type Restart = fn(&mut Bench) -> Result<(), Failure>;
/// A boot, and the announcements after it.
const BOOT_NS: u64 = 400 * NS_PER_MS;

pub(super) fn run(context: &Context) -> Result<Report, Failure> {
    let mut report = Report::new();
    let mut bench = Bench::hub_and_device(&context.places, context.seed, None)?;
    name(&mut report, &mut bench)?;
    failure(&mut report, &mut bench, "a fault", UNDEFINED, "fault at")?;
    failure(&mut report, &mut bench, "a hang", FOREVER, "watchdog")?;
    match fault_m7(context) {
        Ok(told) => {
            report.line(format!("After a fault of the Cortex-M7: {told}"));
            report.check(
                told.contains("fault at"),
                format!("after a fault of the Cortex-M7 the debug log says {told:?}"),
            );
        }
        Err(Failure::NotRun(why)) => report.not_run("a fault of the Cortex-M7", why),
        Err(failed @ Failure::Failed(_)) => return Err(failed),
    }
    Ok(report)
}

fn pings(bench: &mut Bench, count: u32) -> Result<PingReport, Failure> {
    let device = bench.session.destination(&route("/0/1"));
    let options = PingOptions { count, interval: Span::ZERO, ..PingOptions::default() };
    Ok(bench.session.ping(&device, &options, &mut |_, _| ())?)
}

fn name(report: &mut Report, bench: &mut Bench) -> Result<(), Failure> {
    let hub = bench.session.destination(&route("/0"));
    let before = pings(bench, 100)?;
    bench.session.set_name(&hub, "Hub of the test")?;
    let during = pings(bench, 100)?;
    report.line(format!(
        "Pings through the hub: {:.1} µs at most before, {:.1} µs while it writes its name; {} of {} answered at once",
        before.max_us, during.max_us, during.answered, during.sent
    ));
    report.check(
        during.answered == during.sent,
        format!("{} pings while the hub writes to flash, {} answered at once", during.sent, during.answered),
    );
    let epoch = bench.session.runtime_info(&hub)?.value.boot_epoch;
    let restarts: [(&str, Restart); 2] = [("power-off", power_cycle), ("reset", reset)];
    for (number, (what, restart)) in (1..).zip(restarts) {
        restart(bench)?;
        let kept = bench.session.name(&hub)?.value;
        let now = bench.session.runtime_info(&hub)?.value.boot_epoch;
        report.check(kept == "Hub of the test", format!("after {what} the hub is called {:?}", kept.as_str()));
        report.check(now == epoch + number, format!("after {what} its boot epoch is {now}, from {epoch}"));
    }
    Ok(())
}

fn power_cycle(bench: &mut Bench) -> Result<(), Failure> {
    bench.cosim.borrow_mut().power_off("hub")?;
    bench.run_for(10 * NS_PER_MS)?;
    bench.cosim.borrow_mut().power_on("hub")?;
    bench.run_for(BOOT_NS)
}

fn reset(bench: &mut Bench) -> Result<(), Failure> {
    bench.cosim.borrow_mut().reset("hub")?;
    bench.run_for(BOOT_NS)
}

/// Spoils the code of routing, waits for the restart, and reads what the hub tells of it.
fn failure(report: &mut Report, bench: &mut Bench, what: &str, code: [u8; 2], wanted: &str) -> Result<(), Failure> {
    bench.cosim.borrow_mut().poke_code("hub", ROUTE, &code)?;
    bench.run_for(2 * NS_PER_S)?;
    let hub = bench.session.destination(&route("/0"));
    let told = told(&mut bench.session, &hub)?;
    report.line(format!("After {what}: {told}"));
    report.check(told.contains(wanted), format!("after {what} the debug log says {told:?}"));
    Ok(())
}

/// The texts of a device's debug log.
fn told(session: &mut Session, to: &Destination) -> Result<String, Failure> {
    let log = session.debug_log(to, 0)?;
    let texts = log.events.iter().filter_map(|event| match &event.event {
        Event::Text(text) => Some(text.as_str()),
        _ => None,
    });
    Ok(texts.collect())
}

/// Spoils the code of an emulated Cortex-M7's routing, and reads what it tells after its restart, in real time.
fn fault_m7(context: &Context) -> Result<String, Failure> {
    let machine = CountedHub::start(&context.places)?;
    let mut session = machine.session()?;
    let hub = session.destination(&route("/0"));
    await_answer(&mut session, &hub)?;
    let mut debugger = machine.debug_hub()?;
    let handler = debugger.read_word(ROUTE_VECTOR)?;
    debugger.write(handler & !1, &UNDEFINED)?;
    debugger.detach()?;
    for _ in 0..TRIES {
        // it answers nothing while it starts
        if let Some(told) = told(&mut session, &hub).ok().filter(|told| !told.is_empty()) {
            return Ok(told);
        }
        session.network().pause(RETRY)?;
    }
    Ok(String::new())
}

//! The Pico's USB: enumeration by a host's class driver, and a scan over it.
//!
//! - **Walk:** the co-simulation's USB host → the image's USB-CDC → the same session as over a UART.
//! - **What it is not:** USB carries no timing here.
//! - **Clause:** `[FRM-04]` stuffing without a check.

use super::Context;
use crate::network::HostPort;
use crate::pico::{Bench, HUB, pico};
use crate::report::{Failure, Report};
use osap::scan::ScanOptions;
use osap_protocol::transport::Transport;

pub(super) fn run(context: &Context) -> Result<Report, Failure> {
    let mut bench = Bench::build(&context.places, context.seed, &[HostPort::usb("usb")], false, |cosim, elf| {
        cosim.chip(&pico("hub", elf, 0xa1, HUB))?;
        Ok(cosim.usb("usb", "hub")?)
    })?;
    bench.run_for(crate::cosim::NS_PER_S)?;
    let scanned = bench.session.scan(&ScanOptions::default(), &mut |_| {})?;
    let mut report = Report::new();
    let found: Vec<String> =
        scanned.map.devices.iter().map(|device| format!("{} at {}", device.type_name, device.route())).collect();
    report.line(format!("Found over USB: {}", found.join(", ")));
    report.check(
        found.iter().any(|device| device == "hub at /0"),
        format!("a scan over USB-CDC finds {}", found.join(", ")),
    );
    let to = bench.session.destination(&crate::pico::route("/0"));
    for len in [1, 63, 64, 65, 128, 200] {
        let payload: Vec<u8> = (0..len).collect();
        let echo = bench.session.echo(&to, Transport::Sequenced, &payload);
        let came = echo.map_or_else(
            |error| error.to_string(),
            |echo| if echo.payload == payload { "as they were".to_owned() } else { "different".to_owned() },
        );
        report.check(came == "as they were", format!("{len} bytes sent over USB come back {came}"));
    }
    Ok(report)
}

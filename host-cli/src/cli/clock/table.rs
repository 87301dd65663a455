//! The table of `osap clock watch`: a row for each device, and below it what was refused where.

use super::root_name;
use crate::cli::output::printable;
use crate::cli::table::{Align, Table};
use crate::clocks::{Clocks, DeviceClock, micros};
use crate::map::NetworkMap;
use osap_protocol::discovery::TIER_FREE_RUNNING;

/// A bound for people; `-` where there is none.
pub(super) fn bound(clock: &DeviceClock) -> String {
    if clock.control.bound_steps < 0 { "-".to_owned() } else { micros(clock.control.bound_steps.into()) }
}

/// Parts per 10⁹ as ppm.
pub(super) fn ppm(ppb: i32) -> String {
    let size = ppb.unsigned_abs();
    format!("{}{}.{:03}", if ppb < 0 { "-" } else { "" }, size / 1_000, size % 1_000)
}

/// Steps from the root, for people.
pub(super) fn tier(tier: u8) -> String {
    if tier == TIER_FREE_RUNNING { "-".to_owned() } else { tier.to_string() }
}

/// All devices, one a row.
pub(super) fn devices(map: &NetworkMap, clocks: &Clocks) -> Table {
    let mut table = Table::new([
        ("device", Align::Left),
        ("root", Align::Left),
        ("tier", Align::Right),
        ("settled", Align::Left),
        ("offset", Align::Right),
        ("bound", Align::Right),
        ("behind", Align::Right),
        ("skew ppm", Align::Right),
        ("round trip", Align::Right),
        ("least", Align::Right),
        ("servo", Align::Left),
        ("refused", Align::Right),
        ("from here", Align::Right),
    ]);
    for (device, clock) in map.devices.iter().zip(&clocks.devices) {
        let label = printable(&device.label());
        let Ok(clock) = clock else {
            table.row([label, "no answer".to_owned()]);
            continue;
        };
        let (status, control) = (&clock.status, &clock.control);
        let has_source = status.tier != 0 && status.tier != TIER_FREE_RUNNING;
        let of_source = |steps: i32| if has_source { micros(steps.into()) } else { "-".to_owned() };
        table.row([
            label,
            if status.tier == TIER_FREE_RUNNING { "-".to_owned() } else { root_name(map, status.root) },
            tier(status.tier),
            if status.is_settled { "yes" } else { "no" }.to_owned(),
            of_source(control.offset_steps),
            bound(clock),
            micros(status.behind_steps),
            ppm(control.skew_ppb),
            of_source(control.round_trip_steps),
            of_source(control.round_trip_min_steps),
            status.settings.servo.name().to_owned(),
            clock.refused.total().to_string(),
            clock.measured.map_or_else(
                || "-".to_owned(),
                |it| {
                    let within = i64::try_from(it.within_steps).unwrap_or(i64::MAX);
                    format!("{} ± {}", micros(it.offset_steps), micros(within))
                },
            ),
        ]);
    }
    table
}

/// Links with requests that nobody answered or replies that were refused; `None` where there are none.
pub(super) fn troubles(map: &NetworkMap, clocks: &Clocks) -> Option<Table> {
    let mut table = Table::new([
        ("device", Align::Left),
        ("link", Align::Right),
        ("exchanges", Align::Right),
        ("unanswered", Align::Right),
        ("refused", Align::Right),
    ]);
    for (device, clock) in map.devices.iter().zip(&clocks.devices) {
        let links = clock.as_ref().map_or(&[][..], |clock| &clock.links);
        for it in links.iter().filter(|it| it.link.unanswered > 0 || it.link.refused > 0) {
            table.row([
                printable(&device.label()),
                it.gateway.to_string(),
                it.link.exchanges.to_string(),
                it.link.unanswered.to_string(),
                it.link.refused.to_string(),
            ]);
        }
    }
    (!table.is_empty()).then_some(table)
}

/// Devices that refused replies about time, by what was wrong with those, `[TIM-06]`, `[TIM-08]`; `None` where there are none.
pub(super) fn refusals(map: &NetworkMap, clocks: &Clocks) -> Option<Table> {
    let names = ["device", "time-unasked", "time-order", "time-absurd", "time-tier"];
    let mut table = Table::new(names.map(|name| (name, if name == "device" { Align::Left } else { Align::Right })));
    for (device, clock) in map.devices.iter().zip(&clocks.devices) {
        let Some(drops) = clock.as_ref().ok().map(|clock| clock.refused).filter(|drops| drops.total() > 0) else {
            continue;
        };
        let counts = [drops.unasked, drops.order, drops.absurd, drops.tier].map(|count| count.to_string());
        table.row(std::iter::once(printable(&device.label())).chain(counts));
    }
    (!table.is_empty()).then_some(table)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_shown_in_ppm_with_their_sign() {
        assert_eq!((ppm(-40_001).as_str(), ppm(7).as_str(), tier(255).as_str()), ("-40.001", "0.007", "-"));
    }
}

//! `osap scan --json` of an emulated network of real images, in every order of start, with devices killed and restarted meanwhile.
//!
//! - **Walk:** [`Machine`] → the program `osap` in a process of its own → its document → what must be in it.
//! - **Invariants:** the program is the one that people run. Real time: how long a scan takes depends on this computer, so a scan that
//!   finds too little is repeated; what one finds must be right.
//! - **Clauses:** `[DSC-03]`, `[SYS-04]`, `[DSC-05]`.

use super::Context;
use crate::machine::{Machine, Part};
use crate::report::{Failure, Report, table};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::mpsc::channel;
use std::time::Duration;

/// Scans that are tried until all is found that must be.
const SCANS_MAX: usize = 12;
/// Time that a scan gets to begin.
const MIDST: Duration = Duration::from_millis(50);
/// Every order in which three devices can start.
const ORDERS: [[Part; 3]; 6] = [
    [Part::Hub, Part::Motor, Part::Heater],
    [Part::Hub, Part::Heater, Part::Motor],
    [Part::Motor, Part::Hub, Part::Heater],
    [Part::Motor, Part::Heater, Part::Hub],
    [Part::Heater, Part::Hub, Part::Motor],
    [Part::Heater, Part::Motor, Part::Hub],
];

/// What a scan tells of one device.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Seen {
    name: String,
    type_name: String,
    boot_epoch: u64,
    routes: Vec<String>,
}

pub(super) fn run(context: &Context) -> Result<Report, Failure> {
    let osap = context.places.osap()?;
    let mut machine = Machine::new(&context.places, context.board.clone(), 0)?;
    let mut report = Report::new();
    report.line("Scans of an emulated Cortex-M7 hub, a Cortex-M7 motor and an RP2040 heater behind it (QEMU, co-simulation, real time)");
    let mut rows = Vec::new();
    let mut epochs: BTreeMap<Part, u64> = BTreeMap::new();
    for order in ORDERS {
        // a real board stays powered: it has no switch here
        for part in Part::ALL {
            machine.kill(part);
        }
        for part in order {
            machine.start(part)?;
        }
        let name = order.map(Part::type_name).join(", ");
        let (seen, scans) = scan_until_whole(&osap, &machine)?;
        let higher = |part: &Part| epochs.get(part).is_none_or(|epoch| seen[part].boot_epoch > *epoch);
        let is_higher = Part::ALL.iter().all(|part| higher(part) || context.board.is_some() && *part == Part::Heater);
        report.check(is_higher, format!("started {name}: all found, boot epochs gone up"));
        epochs = seen.iter().map(|(part, seen)| (*part, seen.boot_epoch)).collect();
        rows.push(row(&format!("start {name}"), &seen, scans));
    }
    rename(&osap, &machine)?;
    for part in Part::ALL {
        if part == Part::Heater && context.board.is_some() {
            report.not_run("killing the RP2040", "a real board has no switch here: reset it by hand");
            continue;
        }
        let (seen, scans) = kill_and_restart(&osap, &mut machine, part)?;
        let is_higher = seen[&part].boot_epoch > epochs[&part];
        let others =
            Part::ALL.iter().filter(|other| **other != part).all(|other| seen[other].boot_epoch == epochs[other]);
        report.check(
            is_higher && others,
            format!("{} restarted during a scan: its epoch alone went up", part.type_name()),
        );
        let kept = Part::ALL.iter().all(|part| seen[part].name == new_name(*part));
        report.check(kept, format!("{} restarted: all names kept", part.type_name()));
        epochs = seen.iter().map(|(part, seen)| (*part, seen.boot_epoch)).collect();
        rows.push(row(&format!("restart {}", part.type_name()), &seen, scans));
    }
    report.line(table(&["what", "scans", "hub epoch", "motor", "heater"], &rows));
    Ok(report)
}

fn row(what: &str, seen: &BTreeMap<Part, Seen>, scans: usize) -> Vec<String> {
    let epochs = Part::ALL.iter().map(|part| seen[part].boot_epoch.to_string());
    [what.to_owned(), scans.to_string()].into_iter().chain(epochs).collect()
}

fn new_name(part: Part) -> String {
    format!("the {}", part.type_name())
}

fn rename(osap: &Path, machine: &Machine) -> Result<(), Failure> {
    for part in Part::ALL {
        for attempt in 1.. {
            let status = Command::new(osap)
                .args(["name", part.route(), &new_name(part), "--link", &machine.link()])
                .stdout(Stdio::null())
                .status()?;
            match status.success() {
                true => break,
                false if attempt < SCANS_MAX => {}
                false => return Err(Failure::Failed(format!("`osap name {}` failed: {status}", part.route()))),
            }
        }
    }
    // kept by the time it is answered for the second time: writing is the idle task's
    scan_until_whole(osap, machine).map(|_| ())
}

/// Kills a device while a scan is under way, restarts it while another is, and scans until all is there again.
fn kill_and_restart(osap: &Path, machine: &mut Machine, part: Part) -> Result<(BTreeMap<Part, Seen>, usize), Failure> {
    let during = scan_process(osap, machine).spawn()?;
    // into its midst, as far as a loaded computer lets one tell; whenever it happens, what follows must hold
    std::thread::sleep(MIDST);
    machine.kill(part);
    let cut = during.wait_with_output()?;
    // whatever it found, it ends and writes a document
    document(&cut.stdout)?;
    let during = scan_process(osap, machine).spawn()?;
    machine.start(part)?;
    document(&during.wait_with_output()?.stdout)?;
    scan_until_whole(osap, machine)
}

/// Scans until all devices are found, and checks what was found; says how many scans it took.
fn scan_until_whole(osap: &Path, machine: &Machine) -> Result<(BTreeMap<Part, Seen>, usize), Failure> {
    let mut last = String::new();
    for scans in 1..=SCANS_MAX {
        let output = scan_process(osap, machine).output()?;
        let document = document(&output.stdout)?;
        match read(&document) {
            Ok(seen) => return Ok((seen, scans)),
            Err(why) => last = why,
        }
    }
    Err(Failure::Failed(format!("after {SCANS_MAX} scans: {last}")))
}

fn scan_process(osap: &Path, machine: &Machine) -> Command {
    let mut command = Command::new(osap);
    command.args(["scan", "--json", "--link", &machine.link()]).stdout(Stdio::piped()).stderr(Stdio::null());
    command
}

fn document(stdout: &[u8]) -> Result<Value, Failure> {
    serde_json::from_slice(stdout).map_err(|error| {
        Failure::Failed(format!("`osap scan --json` wrote no document: {error}: {}", String::from_utf8_lossy(stdout)))
    })
}

/// Every part with what was seen of it, or what is missing or wrong.
fn read(document: &Value) -> Result<BTreeMap<Part, Seen>, String> {
    let devices = document["map"]["devices"].as_array().ok_or("the document has no devices")?;
    let mut seen = BTreeMap::new();
    for part in Part::ALL {
        let those: Vec<&Value> = devices.iter().filter(|device| device["unique_id"] == part.unique_id()).collect();
        let [device] = those[..] else {
            return Err(format!("{} devices have the id of the {}", those.len(), part.type_name()));
        };
        let text = |key: &str| device[key].as_str().unwrap_or_default().to_owned();
        let routes = device["routes"].as_array().into_iter().flatten();
        let found = Seen {
            name: text("name"),
            type_name: text("type_name"),
            boot_epoch: device["boot_epoch"].as_u64().unwrap_or(0),
            routes: routes.filter_map(|way| way["route"].as_str()).map(str::to_owned).collect(),
        };
        if found.type_name != part.type_name() || !found.routes.contains(&part.route().to_owned()) {
            return Err(format!("the {} is a {} at {:?}", part.type_name(), found.type_name, found.routes));
        }
        seen.insert(part, found);
    }
    if devices.len() != Part::ALL.len() + 1 {
        return Err(format!("{} devices were found beside the host, not {}", devices.len() - 1, Part::ALL.len()));
    }
    Ok(seen)
}

/// Leaves the network running, for another terminal.
pub(super) fn up(context: &Context, port: u16, seconds: Option<u64>) -> Result<Report, Failure> {
    let mut machine = Machine::new(&context.places, context.board.clone(), port)?;
    for part in Part::ALL {
        machine.start(part)?;
    }
    let osap = context.places.osap().unwrap_or_else(|_| PathBuf::from("osap"));
    let link = machine.link();
    println!("The network is up: in another terminal\n  {} scan --link {link}\nCtrl-C ends it.", osap.display());
    // the machine is dropped, and with it all processes, whatever ends this
    let (ender, end) = channel();
    let at_signal = ender.clone();
    let caught = ctrlc::set_handler(move || {
        // told twice is told enough
        let _told = at_signal.send(());
    });
    caught.map_err(|error| Failure::Failed(format!("cannot catch Ctrl-C: {error}")))?;
    let for_ever = Duration::from_secs(u64::from(u32::MAX));
    let _ended = end.recv_timeout(seconds.map_or(for_ever, Duration::from_secs));
    drop(ender);
    Ok(Report::new())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn device(part: Part) -> Value {
        let routes = json!([{ "route": part.route(), "mtu_bytes": 256 }]);
        json!({ "unique_id": part.unique_id(), "name": "n", "type_name": part.type_name(), "boot_epoch": 3, "routes": routes })
    }

    fn scanned(devices: Vec<Value>) -> Value {
        let all = [vec![json!({ "unique_id": "host" })], devices].concat();
        json!({ "map": { "devices": all } })
    }

    #[test]
    fn a_scan_must_show_each_device_once_at_its_place_and_nobody_else() {
        let all = || Part::ALL.map(device).to_vec();
        let seen = read(&scanned(all())).unwrap();
        assert_eq!(seen[&Part::Motor].boot_epoch, 3);
        assert!(read(&scanned(all()[..2].to_vec())).is_err(), "one is missing");
        assert!(read(&scanned([all(), vec![device(Part::Hub)]].concat())).is_err(), "an id twice");
        assert!(read(&scanned([all(), vec![json!({})]].concat())).is_err(), "a stranger");
        let mut moved = all();
        moved[1]["routes"][0]["route"] = json!("/0/3");
        assert!(read(&scanned(moved)).is_err(), "at another place");
    }
}

//! `osap sim` as a process, found by `osap scan` as another: over TCP and over pseudo-terminals it is the machine that is scanned
//! in virtual time.

use serde_json::Value;
use std::collections::BTreeSet;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

/// Longest wait for a line that must come; a machine under load needs some of it.
const PATIENCE: Duration = Duration::from_mins(1);

fn osap() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_osap"));
    command.env_remove("OSAP_LINK").stdin(Stdio::null()).stderr(Stdio::null()).arg("--json");
    command
}

/// A process that writes documents. It ends with the test, and by itself even where the test is killed.
struct Running {
    child: Child,
    documents: Receiver<Value>,
}

impl Running {
    fn start(arguments: &[&str]) -> Self {
        let mut child = osap().args(arguments).args(["--for", "120"]).stdout(Stdio::piped()).spawn().unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let (sender, documents) = channel();
        std::thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                let _ = sender.send(serde_json::from_str(&line).unwrap_or(Value::Null));
            }
        });
        Self { child, documents }
    }

    fn document(&self, schema: &str) -> Value {
        let document = self.documents.recv_timeout(PATIENCE).expect("a document in time");
        assert_eq!(document["schema"], schema, "{document}");
        document
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// `--link` options for all that a simulated machine offers.
fn links(offered: &Value) -> Vec<String> {
    let endpoints = offered["endpoints"].as_array().unwrap();
    endpoints.iter().flat_map(|one| ["--link".to_owned(), one["link"].as_str().unwrap().to_owned()]).collect()
}

fn scan(links: &[String]) -> Value {
    let output = osap().arg("scan").args(links).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Who is there, with type, id and route, without the host.
fn devices(scan: &Value) -> BTreeSet<String> {
    let devices = scan["map"]["devices"].as_array().unwrap().iter().skip(1);
    devices
        .map(|device| {
            let route = &device["routes"][0]["route"];
            format!("{} {} {} {route}", device["name"], device["type_name"], device["unique_id"])
        })
        .collect()
}

fn in_virtual_time() -> BTreeSet<String> {
    devices(&scan(&["--link".to_owned(), "sim:printer".to_owned()]))
}

fn is_found_as_in_virtual_time(listen: &str) {
    let machine = Running::start(&["sim", "printer", "--listen", listen]);
    let links = links(&machine.document("osap.sim/1"));
    assert_eq!(links.len(), 2 * 3);
    let expected = in_virtual_time();
    assert_eq!(expected.len(), 12);
    assert_eq!(devices(&scan(&links)), expected);
    // Whoever comes next finds it again: leaving frees the links.
    assert_eq!(devices(&scan(&links)), expected);
}

#[test]
fn a_machine_on_tcp_ports_is_the_one_in_virtual_time() {
    is_found_as_in_virtual_time("tcp:127.0.0.1:0");
}

#[cfg(unix)]
#[test]
fn a_machine_on_pseudo_terminals_is_the_one_in_virtual_time() {
    is_found_as_in_virtual_time("pty");
}

/// A watch tells that the machine went away, each device by its name.
#[test]
fn a_watch_tells_what_is_lost() {
    let machine = Running::start(&["sim", "line:2", "--listen", "tcp:127.0.0.1:0"]);
    let links = links(&machine.document("osap.sim/1"));
    let mut arguments = vec!["scan", "--watch"];
    arguments.extend(links.iter().map(String::as_str));
    let watch = Running::start(&arguments);
    assert_eq!(devices(&watch.document("osap.scan/1")).len(), 2);
    drop(machine);
    let changes = watch.document("osap.scan-changes/1");
    let lost = changes["changes"].as_array().unwrap().iter().filter(|change| change["kind"] == "lost");
    let names: BTreeSet<_> = lost.filter_map(|change| change["device"].as_str()).collect();
    assert_eq!(names, BTreeSet::from(["hub-1", "hub-2"]), "{changes}");
}

/// A watch in virtual time runs for a day of it; Ctrl-C and a polite request to end are heard all the same.
#[cfg(unix)]
#[test]
fn a_watch_in_virtual_time_hears_ctrl_c() {
    for signal in ["-INT", "-TERM"] {
        let line = ["scan", "--link", "sim:line:1", "--watch", "--for", "30000000"];
        let mut child = osap().args(line).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        // it says so once it listens for signals; before that one would end it the rude way
        let mut talk = BufReader::new(child.stderr.take().unwrap());
        let mut said = String::new();
        while !said.contains("Watching") {
            assert_ne!(talk.read_line(&mut said).unwrap(), 0, "it ended before it watched: {said}");
        }
        assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
        let mut waits = 0;
        let status = loop {
            match child.try_wait().unwrap() {
                Some(status) => break status,
                None if waits < 100 => std::thread::sleep(Duration::from_millis(100)),
                None => {
                    child.kill().unwrap();
                    panic!("{signal} was not heard");
                }
            }
            waits += 1;
        };
        assert!(status.success(), "{signal}: {status}");
    }
}

/// Its devices boot again with another epoch, as hardware does: a map of before tells.
#[test]
fn a_restart_of_the_machine_is_seen() {
    let file = std::env::temp_dir().join(format!("osap-restart-{}.json", std::process::id()));
    let map = |option: &str| {
        let machine = Running::start(&["sim", "line:2", "--listen", "tcp:127.0.0.1:0"]);
        let links = links(&machine.document("osap.sim/1"));
        osap().args(["map", option]).arg(&file).args(links).output().unwrap()
    };
    let saved = map("--save");
    assert!(saved.status.success(), "{saved:?}");
    let compared = map("--compare");
    std::fs::remove_file(&file).unwrap();
    let changes: Value = serde_json::from_slice(&compared.stdout).unwrap();
    let rebooted = changes["changes"].as_array().unwrap().iter().filter(|change| change["kind"] == "rebooted").count();
    assert_eq!((compared.status.code(), rebooted), (Some(1), 2), "{changes}");
}

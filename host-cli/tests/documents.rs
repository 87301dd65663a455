//! With `--json` every command writes documents that parse and name their schema, and errors are documents too.

use osap::cli::{Exit, definition, run};
use serde_json::Value;
use std::path::PathBuf;

/// A folder of this test alone, gone when it ends.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Self {
        let folder = std::env::temp_dir().join(format!("osap-documents-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        Self(folder)
    }

    fn file(&self, name: &str) -> String {
        self.0.join(name).display().to_string()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Runs a command line and parses what it wrote, line by line: data, then talk that is a document.
fn documents(line: &[&str]) -> (Exit, Vec<Value>, Vec<Value>) {
    let (mut out, mut talk) = (Vec::new(), Vec::new());
    let arguments = ["osap", "--json"].iter().chain(line).map(ToString::to_string);
    let exit = run(arguments, &mut out, &mut talk, false);
    let text = String::from_utf8(out).unwrap();
    let data = text.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}")));
    let talk = String::from_utf8(talk).unwrap();
    (exit, data.collect(), talk.lines().filter_map(|line| serde_json::from_str(line).ok()).collect())
}

#[test]
fn every_command_writes_documents_of_its_schema() {
    let folder = Folder::new();
    let (key, map, pages) = (folder.file("key"), folder.file("map.json"), folder.file("pages"));
    let sim = ["--link", "sim:line:2"];
    let with_sim = |line: &[&'static str]| [line, &sim].concat();
    let lines: Vec<(Vec<&str>, &str)> = vec![
        (vec!["demo", "-n", "2"], "osap.demo/1"),
        (with_sim(&["scan"]), "osap.scan/1"),
        (vec!["sim", "line:1", "--listen", "tcp:127.0.0.1:0", "--for", "0"], "osap.sim/1"),
        ([&["map", "--save", &map][..], &sim].concat(), "osap.map/1"),
        ([&["map", "--compare", &map][..], &sim].concat(), "osap.map-compare/1"),
        (with_sim(&["ping", "/0", "-n", "2"]), "osap.ping/1"),
        (with_sim(&["info", "/0"]), "osap.info/1"),
        (with_sim(&["name", "/0"]), "osap.name/1"),
        (with_sim(&["name", "/0", "first"]), "osap.name/1"),
        (with_sim(&["counters", "--all"]), "osap.counters/1"),
        (with_sim(&["debug", "/0"]), "osap.debug/1"),
        (with_sim(&["bench", "/0", "-n", "2"]), "osap.bench/1"),
        (with_sim(&["clock", "watch", "--for", "0"]), "osap.clock-watch/1"),
        (with_sim(&["clock", "wait", "--within", "1ms"]), "osap.clock-wait/1"),
        (with_sim(&["clock", "tune", "/0", "--interval", "20ms"]), "osap.clock-tune/1"),
        (vec!["maxl", "eval", "tests/cli/maxl.in/points.csv", "--interval-us", "1024"], "osap.maxl-eval/1"),
        (vec!["maxl", "error", "tests/cli/maxl.in/corner.csv", "--tolerance", "0.1"], "osap.maxl-error/1"),
        (vec!["decode", "05 e8 03 40 00 41 c0 18 01 00 2a"], "osap.decode/1"),
        (vec!["key", "generate", &key], "osap.key-generate/1"),
        (vec!["completions", "bash"], "osap.completions/1"),
        (vec!["man", "--out", &pages], "osap.man/1"),
    ];
    for (line, schema) in &lines {
        let (exit, data, talk) = documents(line);
        assert_eq!(exit, Exit::Ok, "{line:?}: {talk:?}");
        let schemas: Vec<_> = data.iter().map(|document| document["schema"].as_str().unwrap_or("none")).collect();
        assert_eq!(schemas, [*schema], "{line:?}");
    }
    for command in definition().get_subcommands() {
        let is_walked = lines.iter().any(|(line, _)| line[0] == command.get_name());
        assert!(is_walked, "no line above runs `osap {}`", command.get_name());
    }
}

/// What a script does with them: the figures are where their names say.
#[test]
fn the_fields_that_scripts_read_are_there() {
    let (_, scan, _) = documents(&["scan", "--link", "sim:printer"]);
    assert_eq!(scan[0]["map"]["devices"].as_array().unwrap().len(), 13);
    assert_eq!(scan[0]["map"]["schema"], "osap.map/1");
    let (_, ping, _) = documents(&["ping", "Load Cell", "-n", "3", "--link", "sim:printer"]);
    assert_eq!((ping[0]["route"].as_str(), ping[0]["answered"].as_u64()), (Some("/0/5"), Some(3)));
    assert!(ping[0]["round_trips_us"].as_array().unwrap().iter().all(|us| us.as_f64().unwrap() > 400.0));
    let (_, demo, _) = documents(&["demo", "-n", "2"]);
    let rows = demo[0]["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 12);
    assert!(rows.iter().all(|row| row["ours"]["mean_us"].is_f64() && row["thesis"]["mean_us"].is_f64()));
}

/// Each code that can be had without hardware, as a document that says what, where and what next.
#[test]
fn errors_are_documents_with_their_codes() {
    let cases: [(&[&str], Exit); 15] = [
        // Nobody is there, which a datagram link cannot know.
        (&["scan", "--link", "udp:127.0.0.1:9"], Exit::NoAnswer),
        (&["scan", "--colour"], Exit::Usage),
        (&["map", "--dot", "--link", "sim:line:1"], Exit::Usage),
        (&["decode", "0g"], Exit::Usage),
        (&["maxl", "eval", "tests/cli/maxl.in/ragged.csv", "--interval-us", "1024"], Exit::Io),
        (&["maxl", "eval", "tests/cli/maxl.in/points.csv", "--interval-us", "1000"], Exit::Usage),
        (&["maxl", "error", "tests/cli/maxl.in/corner.csv", "--plot"], Exit::Usage),
        (&["scan", "--link", "tcp:127.0.0.1:1"], Exit::NoLink),
        (&["ping", "toaster", "--link", "sim:line:1"], Exit::DeviceNotFound),
        (&["ping", "73696d2d", "--link", "sim:line:2"], Exit::DeviceAmbiguous),
        (&["ping", "/0", "-n", "1", "--ttl-us", "1", "--link", "sim:line:1"], Exit::NoAnswer),
        (&["map", "--compare", "no/such/map", "--link", "sim:line:1"], Exit::Io),
        (&["sim", "printer", "--listen", "tcp:0.0.0.0:0"], Exit::KeyNeeded),
        (&["clock", "wait", "--within", "0us", "--timeout", "100ms", "--link", "sim:line:2"], Exit::NotSettled),
        (&["clock", "tune", "/0", "--gate=-1us", "--link", "sim:line:2"], Exit::Refused),
    ];
    for (line, expected) in cases {
        let (exit, _, talk) = documents(line);
        assert_eq!(exit, expected, "{line:?}");
        let error = talk.last().unwrap_or_else(|| panic!("{line:?} said nothing"));
        assert_eq!(
            (error["schema"].as_str(), error["code"].as_u64()),
            (Some("osap.error/1"), Some(exit.code().into()))
        );
        for field in ["what", "where", "next"] {
            assert!(error[field].as_str().is_some_and(|text| !text.is_empty()), "{line:?}: {field}");
        }
    }
    let (exit, data, _) = documents(&["decode", "04 e8 03 40 00 41"]);
    assert_eq!((exit, data.len()), (Exit::Differs, 1));
}

/// The man pages come from the same definition as the help: the codes are in them.
#[test]
fn man_pages_tell_the_exit_codes() {
    let folder = std::env::temp_dir().join(format!("osap-pages-{}", std::process::id()));
    let (exit, data, _) = documents(&["man", "--out", &folder.display().to_string()]);
    assert_eq!(exit, Exit::Ok);
    let [page, of_scan] = ["osap.1", "osap-scan.1"].map(|page| std::fs::read_to_string(folder.join(page)).unwrap());
    let pages = data[0]["pages"].as_array().unwrap().len();
    std::fs::remove_dir_all(&folder).unwrap();
    for page in [page, of_scan] {
        assert!(Exit::ALL.iter().all(|exit| page.contains(exit.meaning())), "{page}");
    }
    // Itself, its commands and theirs, such as `key generate`.
    let of_command = |command: &clap::Command| 1 + command.get_subcommands().count();
    assert_eq!(pages, 1 + definition().get_subcommands().map(of_command).sum::<usize>());
}

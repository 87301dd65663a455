//! `osap maxl` from outside: its pipe, its pages, its documents, and the sample paths that its transcripts are about.

use osap::cli::{Exit, run};
use osap::motion::paths::Shape;
use serde_json::Value;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

const SAMPLES: &str = "tests/cli/maxl.in";

fn osap(line: &[&str]) -> (Exit, String, String) {
    let (mut out, mut talk) = (Vec::new(), Vec::new());
    let arguments = ["osap", "maxl"].iter().chain(line).map(ToString::to_string);
    let exit = run(arguments, &mut out, &mut talk, false);
    let [out, talk] =
        [out, talk].map(|bytes| anstream::adapter::strip_str(&String::from_utf8(bytes).unwrap()).to_string());
    (exit, out, talk)
}

fn document(line: &[&str]) -> (Exit, Value) {
    let (exit, out, talk) = osap(line);
    (exit, serde_json::from_str(&out).unwrap_or_else(|error| panic!("{error}: {out}{talk}")))
}

/// What is committed is what the generator makes, so that whoever changes one sees the other.
#[test]
fn the_sample_paths_are_those_of_the_generator() {
    for shape in [Shape::Circle, Shape::Square, Shape::Corner] {
        let file = Path::new(SAMPLES).join(format!("{}.csv", shape.name()));
        let made = shape.rows(1, 1_024);
        assert_eq!(
            std::fs::read_to_string(&file).unwrap(),
            made,
            "{}: `cargo run -p osap --example paths`",
            file.display()
        );
    }
}

#[test]
fn points_come_from_a_pipe_as_well() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_osap"))
        .args(["maxl", "eval", "-", "--interval-us", "256", "--every-us", "256", "--lsb", "1"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(b"6\n12\n18\n").unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    // (6 + 4·6 + 12)/6 = 7 at the first point's time, an interval after the begin; 12 an interval is 46875 a second at full speed
    let text = String::from_utf8(output.stdout).unwrap();
    let positions: Vec<&str> = text.lines().skip(1).map(|line| line.split(',').nth(1).unwrap()).collect();
    assert_eq!(positions, ["6", "7", "12", "17", "18"], "{text}");
    let at_second = text.lines().nth(3).unwrap();
    assert!(at_second.starts_with("512,12,23437.5,0,"), "{at_second}");
}

/// Scripts take an interval from here: the recommendation is one of the rows, and keeps what it says.
#[test]
fn a_recommendation_is_among_the_measured() {
    let file = format!("{SAMPLES}/circle.csv");
    let (exit, found) = document(&["error", &file, "--json", "--tolerance", "0.01", "--batch", "8"]);
    assert_eq!(exit, Exit::Ok);
    let take = &found["recommendation"];
    let row =
        found["intervals"].as_array().unwrap().iter().find(|it| it["interval_us"] == take["interval_us"]).unwrap();
    let fit = row["fits"].as_array().unwrap().iter().find(|it| it["fit"] == take["fit"]).unwrap();
    assert_eq!(fit["norm"]["max"], take["deviation"]);
    assert!(take["deviation"].as_f64().unwrap() <= 0.01);
    // 16 bytes of packet and frame, 11 of the message, 4 for each of 8 points
    let bytes_per_s = take["points_per_s"].as_f64().unwrap() * (16.0 + 11.0 + 32.0) / 8.0;
    assert!((take["bytes_per_s_per_axis"].as_f64().unwrap() - bytes_per_s).abs() < 1e-9 * bytes_per_s);
    for report in found["intervals"].as_array().unwrap() {
        let sample = &report["fits"][0];
        assert!(sample["norm"]["max"].as_f64().unwrap() <= sample["bound"].as_f64().unwrap(), "{report}");
    }
}

#[test]
fn a_path_that_no_interval_keeps_ends_with_a_code_of_its_own() {
    let file = format!("{SAMPLES}/corner.csv");
    let (exit, found) = document(&["error", &file, "--json", "--tolerance", "0.0001", "--fit", "quasi"]);
    assert_eq!((exit, &found["recommendation"]), (Exit::Differs, &Value::Null));
    let fits = found["intervals"].as_array().unwrap().iter().flat_map(|it| it["fits"].as_array().unwrap());
    assert!(fits.map(|it| &it["fit"]).all(|fit| fit == "quasi"));
}

#[test]
fn pages_have_their_plots() {
    let page = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("maxl.html");
    let name = page.display().to_string();
    let points = format!("{SAMPLES}/points.csv");
    let path = format!("{SAMPLES}/corner.csv");
    let lines: [(&[&str], usize); 2] = [
        (&["eval", &points, "--interval-us", "1024", "--html", &name], 4),
        (&["error", &path, "--tolerance", "0.1", "--html", &name], 1),
    ];
    for (line, plots) in lines {
        let (exit, _, talk) = osap(line);
        assert_eq!(exit, Exit::Ok, "{talk}");
        let text = std::fs::read_to_string(&page).unwrap();
        assert_eq!(text.matches("<svg").count(), plots);
        assert!(talk.contains("The page is") && !text.contains("<script"));
        std::fs::remove_file(&page).unwrap();
    }
}

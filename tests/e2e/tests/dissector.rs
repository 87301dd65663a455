//! `protocol-spec/wireshark/osap.lua` in a real `tshark`, over a capture written by `osap_sim::capture` from the vectors.

use fixed_math::time::LocalTicks;
use osap_e2e::{ScratchFile, bytes, root, text, vectors};
use osap_protocol::DropCause;
use osap_sim::capture::{Capture, Direction};
use std::fs::File;
use std::process::Command;

/// One packet, its expected `Info` column and the name of the drop that shall be flagged.
struct Case {
    packet: Vec<u8>,
    info: Option<String>,
    flagged: Option<String>,
}

fn sound(packet: Vec<u8>, info: &str) -> Case {
    Case { packet, info: Some(info.to_owned()), flagged: None }
}

fn flagged(packet: Vec<u8>, cause: &str) -> Case {
    Case { packet, info: None, flagged: Some(cause.to_owned()) }
}

/// A packet over link 1 in transport `key`, asking port 0 or coming from it.
fn over_link_1(ports: [u8; 3], key: u8, payload: &[u8]) -> Vec<u8> {
    [&[5, 0xe8, 3, 0, 1, 0x41], &ports[..], &[key], payload].concat()
}

const TO_PORT_0: [u8; 3] = [0xc0, 0x18, 0x00];
const TO_PORT_1: [u8; 3] = [0xc0, 0x18, 0x01];
const FROM_PORT_0: [u8; 3] = [0xc0, 0x00, 0x03];

fn cases() -> Vec<Case> {
    let mut cases = vec![
        sound(
            vec![5, 0xe8, 3, 64, 0, 0x41, 0x82, 7, 0x43, 0xc0, 0x18, 1, 0, 0x2a],
            "link 1 › bus 2 drop 7 › link 3 › port 3→1  datagram",
        ),
        sound(
            over_link_1(TO_PORT_1, 2, &[0, 9, 0, 0, 3, 0, 0xaa]),
            "link 1 › port 3→1  segmented data of message 9, 0 of 3",
        ),
    ];
    for vector in vectors("discovery.toml", "message") {
        let message = bytes(&vector, "bytes");
        let (ports, way, kind) = match message[1] {
            0..0x40 => (TO_PORT_0, "3→0", "request"),
            _ => (FROM_PORT_0, "0→3", "reply"),
        };
        let number = vector["sequence"].as_integer().unwrap();
        let info = format!("link 1 › port {way}  sequenced {kind} #{number} {}", text(&vector, "query"));
        cases.push(sound(over_link_1(ports, 1, &message), &info));
    }
    for vector in vectors("discovery.toml", "refusal") {
        let packet = over_link_1(FROM_PORT_0, 1, &bytes(&vector, "bytes"));
        cases.push(Case { packet, info: None, flagged: None });
    }
    for vector in vectors("system.toml", "announcement") {
        let step = if vector["step"].get("link").is_some() { "link " } else { "bus " };
        let packet = bytes(&vector, "bytes");
        let gateway = packet[5] & 0x3f;
        let drop = if step == "bus " { " drop all" } else { "" };
        cases.push(sound(packet, &format!("{step}{gateway}{drop} › system link announcement")));
    }
    cases.extend(bad_cases());
    cases
}

/// Every refused header, arrival, transport and message: the name of its drop shall be found.
fn bad_cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for vector in vectors("header.toml", "refused").into_iter().filter(|vector| !text(vector, "bytes").is_empty()) {
        cases.push(flagged(bytes(&vector, "bytes"), text(&vector, "cause")));
    }
    for vector in vectors("routes.toml", "refused") {
        // whether a step fits the link it came by does not stand in the packet
        if vector["arrival"].get("link").is_some() && text(&vector, "name") != "a link hands over a bus step" {
            cases.push(flagged(bytes(&vector, "bytes"), text(&vector, "cause")));
        }
    }
    for vector in vectors("transport.toml", "refused") {
        let payload = bytes(&vector, "bytes");
        let packet = match vector.get("transport").and_then(toml::Value::as_str) {
            Some("sequenced") => over_link_1(TO_PORT_1, 1, &payload),
            Some(_) => over_link_1(TO_PORT_1, 2, &payload),
            None => over_link_1(TO_PORT_1, payload[0], &[]),
        };
        cases.push(flagged(packet, text(&vector, "cause")));
    }
    for vector in vectors("system.toml", "refused") {
        let key = u8::try_from(vector["key"].as_integer().unwrap()).unwrap();
        let packet = [&[5, 0xe8, 3, 0, 1, 0x41, key], &bytes(&vector, "bytes")[..]].concat();
        cases.push(flagged(packet, text(&vector, "cause")));
    }
    for vector in vectors("discovery.toml", "dropped") {
        cases.push(flagged(over_link_1(TO_PORT_0, 1, &bytes(&vector, "bytes")), text(&vector, "cause")));
    }
    cases.push(flagged(vec![5, 0xe8, 3, 8, 0, 0x41, 0xc0, 0x18, 1, 0], "over-mtu"));
    cases.push(flagged(vec![5, 0, 0, 64, 0, 0x41, 0xc0, 0x18, 1, 0], "expired"));
    cases
}

fn write_capture(file: &ScratchFile, cases: &[Case]) {
    let mut capture = Capture::new(File::create(file.path()).unwrap()).unwrap();
    let interface = capture.add_interface("link 1", 3_000_000).unwrap();
    for (at, case) in (0..).zip(cases) {
        capture.packet(interface, LocalTicks::from_us(at * 1000), Direction::Sent, &case.packet).unwrap();
    }
    let at = LocalTicks::from_us(1_000_000);
    capture.bad_frame(interface, at, DropCause::FrameCheck, &[4, 0x2a, 0xd8, 0x65, 0]).unwrap();
}

/// The named columns of each packet; `None` where `tshark` is not there.
fn tshark(capture: &ScratchFile, columns: &[&str]) -> Option<Vec<Vec<String>>> {
    let script = root().join("protocol-spec/wireshark/osap.lua");
    let mut command = Command::new("tshark");
    command.arg("-X").arg(format!("lua_script:{}", script.display())).arg("-r").arg(capture.path());
    command.args(["-T", "fields", "-E", "separator=/t", "-E", "occurrence=a"]);
    for column in columns {
        command.args(["-e", column]);
    }
    let output = match command.output() {
        Ok(output) => output,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            eprintln!("NOT RUN: tshark is not installed (apt-get install tshark)");
            return None;
        }
        Err(error) => panic!("tshark cannot be started: {error}"),
    };
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && !errors.contains("Lua"), "tshark: {errors}");
    let text = String::from_utf8(output.stdout).unwrap();
    Some(text.lines().map(|line| line.split('\t').map(str::to_owned).collect()).collect())
}

/// `[NOD-09]`: Wireshark shows the words of the specification, and flags a bad packet under the name of its drop.
#[test]
fn packets_are_dissected_and_bad_ones_flagged() {
    let (file, cases) = (ScratchFile::new("dissector.pcapng"), cases());
    write_capture(&file, &cases);
    let Some(rows) = tshark(&file, &["_ws.col.Protocol", "_ws.col.Info", "_ws.expert.message"]) else { return };
    assert_eq!(rows.len(), cases.len() + 1);
    for (row, case) in rows.iter().zip(&cases) {
        let [protocol, info, message] = &row[..] else { panic!("three columns: {row:?}") };
        let packet = &case.packet;
        assert_eq!(protocol, "OSAP", "{packet:02x?}");
        if let Some(expected) = &case.info {
            assert_eq!(info, expected, "{packet:02x?}");
        }
        match &case.flagged {
            Some(cause) => {
                assert!(message.starts_with(&format!("{cause}: ")), "{packet:02x?}: {cause} expected, {message} found");
                assert!(info.starts_with(&format!("[{cause}")), "{packet:02x?}: {info}");
            }
            None => assert_eq!(message, "", "{packet:02x?}"),
        }
    }
    let bad = rows.last().unwrap();
    // the comment on the frame is an expert item of Wireshark's own
    let named = bad[2].starts_with(DropCause::FrameCheck.name()) && bad[2].contains(",bad-frame: ");
    assert!(bad[1].starts_with("[bad-frame]") && named, "{bad:?}");
}

/// `[PKT-01]`, `[PKT-03]`, `[TRN-03]`, `[SYS-02]`: fields have their values, not only their words.
#[test]
fn fields_have_their_values() {
    let file = ScratchFile::new("fields.pcapng");
    let announcement = bytes(&vectors("system.toml", "announcement")[2], "bytes");
    let on_its_way = vec![8, 0xe8, 3, 64, 0, 0x44, 0x85, 9, 0x43, 0xc0, 0x18, 0, 1, 5, 0, 1, 1, 0xac, 2, 1];
    write_capture(&file, &[sound(on_its_way, ""), sound(announcement, "")]);
    let columns = [
        "osap.pointer",
        "osap.ttl",
        "osap.mtu",
        "osap.step.taken",
        "osap.step.current",
        "osap.step.to_come",
        "osap.port.source",
        "osap.port.destination",
        "osap.sequence",
        "osap.query",
        "osap.scan",
        "osap.visit",
        "osap.announcement.boot_epoch",
        "osap.announcement.drop",
        "frame.packet_flags_direction",
        "frame.interface_name",
    ];
    let Some(rows) = tshark(&file, &columns) else { return };
    let way = [
        "8",
        "1000",
        "64",
        "link 4,bus 5 drop 9",
        "link 3",
        "port 3→0",
        "3",
        "0",
        "5",
        "1",
        "300",
        "1",
        "",
        "",
        "0x00000002",
        "link 1",
    ];
    assert_eq!(rows[0], way);
    let (taken, to_come) = ("", "system link announcement");
    let announced = [
        "5",
        "65535",
        "128",
        taken,
        "bus 2 drop all",
        to_come,
        "",
        "",
        "",
        "",
        "",
        "",
        "4294967295",
        "3",
        "0x00000002",
        "link 1",
    ];
    assert_eq!(rows[1], announced);
}

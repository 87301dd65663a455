//! `osap decode` and the vectors say the same of the same bytes: a good one has no problem, a bad one its named cause.

use osap::explain::{Explanation, Options, explain};
use osap_e2e::{bytes, text, vectors};
use osap_protocol::framing::Check;

fn causes(explanation: &Explanation) -> Vec<Option<&'static str>> {
    explanation.problems.iter().map(|problem| problem.drop_cause).collect()
}

/// A packet at port 1 of its destination, in transport `key`, or from port 0 to port 3 with `answer`.
fn packet(terminal: [u8; 3], key: u8, payload: &[u8]) -> Vec<u8> {
    [&[6, 0xe8, 3, 0, 1, 0x41], &terminal[..], &[key], payload].concat()
}

const TO_PORT_1: [u8; 3] = [0xc0, 0x18, 0x01];
const TO_PORT_0: [u8; 3] = [0xc0, 0x18, 0x00];
const FROM_PORT_0: [u8; 3] = [0xc0, 0x00, 0x03];

/// `[PKT-02]`, `[PKT-05]`, `[PKT-12]`
#[test]
fn headers_that_a_node_refuses_are_refused() {
    for vector in vectors("header.toml", "refused") {
        let explanation = explain(&bytes(&vector, "bytes"), Options::Packet);
        assert_eq!(causes(&explanation), [Some(text(&vector, "cause"))], "{}", text(&vector, "name"));
    }
    for vector in vectors("mtu.toml", "packet") {
        let explanation = explain(&bytes(&vector, "bytes"), Options::Packet);
        let mtu = vector["mtu_bytes"].as_integer();
        let over = mtu.is_some_and(|mtu| mtu < 11);
        assert_eq!(causes(&explanation).contains(&Some("over-mtu")), over, "{}", text(&vector, "name"));
    }
}

/// `[PKT-07]`, `[PKT-09]`: whoever reads a packet of a route on its way finds as many steps as there were hops.
#[test]
fn routes_are_shown_with_the_steps_they_took() {
    for vector in vectors("routes.toml", "route") {
        let name = text(&vector, "name");
        let hops = vector["hops"].as_array().unwrap();
        for (taken, hop) in hops.iter().enumerate().map(|(n, hop)| (n + 1, hop.as_table().unwrap())) {
            let explanation = explain(&bytes(hop, "bytes"), Options::Packet);
            let shown = explanation.fields.iter().filter(|field| field.name.ends_with(", taken")).count();
            assert_eq!(shown, taken, "{name}");
        }
    }
}

/// `[FRM-01]` to `[FRM-07]`
#[test]
fn frames_are_judged_as_a_receiver_does() {
    let check = |vector: &toml::Table| match text(vector, "check") {
        "none" => Check::None,
        "crc16" => Check::Crc16,
        _ => Check::Crc32,
    };
    for vector in vectors("framing.toml", "frame") {
        let explanation = explain(&bytes(&vector, "bytes"), Options::Frame(check(&vector)));
        let name = text(&vector, "name");
        assert!(
            !causes(&explanation).iter().flatten().any(|cause| cause.starts_with("frame-")),
            "{name}: {explanation:?}"
        );
        let packet = osap::explain::parse_hex(explanation.packet.as_deref().unwrap()).unwrap();
        assert_eq!(packet, bytes(&vector, "packet"), "{name}");
    }
    for vector in vectors("framing.toml", "refused") {
        let explanation = explain(&bytes(&vector, "bytes"), Options::Frame(check(&vector)));
        assert_eq!(causes(&explanation), [Some(text(&vector, "cause"))], "{}", text(&vector, "name"));
    }
}

/// `[TRN-01]` to `[TRN-08]`
#[test]
fn transports_are_judged_as_a_node_does() {
    for (kind, key) in [("sequenced", 1), ("segment", 2)] {
        for vector in vectors("transport.toml", kind) {
            let explanation = explain(&packet(TO_PORT_1, key, &bytes(&vector, "bytes")), Options::Packet);
            assert_eq!(causes(&explanation), [], "{}", text(&vector, "name"));
        }
    }
    for vector in vectors("transport.toml", "refused") {
        let payload = bytes(&vector, "bytes");
        let whole = match vector.get("transport").and_then(toml::Value::as_str) {
            Some("sequenced") => packet(TO_PORT_1, 1, &payload),
            Some(_) => packet(TO_PORT_1, 2, &payload),
            None => packet(TO_PORT_1, payload[0], &[]),
        };
        let explanation = explain(&whole, Options::Packet);
        assert_eq!(causes(&explanation), [Some(text(&vector, "cause"))], "{}", text(&vector, "name"));
    }
}

/// `[SYS-01]`, `[SYS-02]`, `[SYS-05]`
#[test]
fn system_messages_are_judged_as_a_node_does() {
    for vector in vectors("system.toml", "announcement") {
        let explanation = explain(&bytes(&vector, "bytes"), Options::Packet);
        assert_eq!(causes(&explanation), [], "{}", text(&vector, "name"));
        let epoch = vector["boot_epoch"].as_integer().unwrap().to_string();
        assert_eq!(explanation.field("boot epoch").unwrap().value, epoch);
    }
    for vector in vectors("system.toml", "refused") {
        let key = u8::try_from(vector["key"].as_integer().unwrap()).unwrap();
        let whole = [&[6, 0xe8, 3, 0, 1, 0x41, key], &bytes(&vector, "bytes")[..]].concat();
        let explanation = explain(&whole, Options::Packet);
        assert_eq!(causes(&explanation), [Some(text(&vector, "cause"))], "{}", text(&vector, "name"));
    }
}

/// `[DSC-01]`, `[DSC-02]`
#[test]
fn queries_and_answers_are_judged_as_a_node_does() {
    let good = ["message", "time_control", "refusal"].map(|kind| vectors("discovery.toml", kind));
    for vector in good.into_iter().flatten() {
        let message = bytes(&vector, "bytes");
        let terminal = if message[1] < 0x40 { TO_PORT_0 } else { FROM_PORT_0 };
        let explanation = explain(&packet(terminal, 1, &message), Options::Packet);
        assert!(explanation.problems.is_empty(), "{}: {:?}", text(&vector, "name"), explanation.problems);
    }
    for vector in vectors("discovery.toml", "unreadable") {
        let explanation = explain(&packet(TO_PORT_0, 1, &bytes(&vector, "bytes")), Options::Packet);
        assert_eq!(causes(&explanation), [None], "{}", text(&vector, "name"));
        assert!(explanation.problems[0].then.starts_with("the node answers with refusal"), "{}", text(&vector, "name"));
    }
    for vector in vectors("discovery.toml", "dropped") {
        let explanation = explain(&packet(TO_PORT_0, 1, &bytes(&vector, "bytes")), Options::Packet);
        assert_eq!(causes(&explanation), [Some(text(&vector, "cause"))], "{}", text(&vector, "name"));
    }
}

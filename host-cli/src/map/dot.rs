//! A map as a graph for Graphviz.
//!
//! - **Invariant:** names are quoted, whatever is in them.

use super::{NetworkMap, short_id};
use std::fmt::Write;

impl NetworkMap {
    /// The map as an undirected graph: `dot -Tsvg` draws it.
    #[must_use]
    pub fn dot(&self) -> String {
        let mut text = String::from("graph network {\n  node [shape=box];\n");
        // writing into a string cannot fail
        for (index, device) in self.devices.iter().enumerate() {
            let label = format!("{}\n{}\n{}", device.label(), device.type_name, short_id(device.unique_id));
            let _ = writeln!(text, "  d{index} [label={}];", quoted(&label));
        }
        for link in &self.links {
            let gateway = |gateway: Option<u8>| gateway.map_or_else(String::new, |index| index.to_string());
            let style = if link.in_tree { "" } else { ", style=dashed" };
            let (near, far) = (link.near, link.far);
            let _ = writeln!(
                text,
                "  d{} -- d{} [taillabel=\"{}\", headlabel=\"{}\"{style}];",
                near.device,
                far.device,
                gateway(near.gateway),
                gateway(far.gateway)
            );
        }
        for (index, bus) in self.buses.iter().enumerate() {
            let _ = writeln!(text, "  b{index} [shape=point];");
            for member in &bus.members {
                let _ = writeln!(text, "  d{} -- b{index} [headlabel=\"{}\"];", member.device, member.drop);
            }
        }
        for (index, place) in self.silent.iter().enumerate() {
            let label = place.neighbour.map_or_else(|| "silent".to_owned(), |id| format!("silent\n{}", short_id(id)));
            let _ = writeln!(text, "  s{index} [label={}, style=dotted];", quoted(&label));
            let _ = writeln!(text, "  d{} -- s{index} [taillabel=\"{}\", style=dotted];", place.device, place.gateway);
        }
        text.push_str("}\n");
        text
    }
}

/// A string as DOT reads it back.
fn quoted(text: &str) -> String {
    let mut quoted = String::from('"');
    for character in text.chars() {
        match character {
            '"' | '\\' => quoted.extend(['\\', character]),
            '\n' => quoted.push_str("\\n"),
            _ => quoted.push(character),
        }
    }
    quoted.push('"');
    quoted
}

#[cfg(test)]
mod tests {
    #[test]
    fn quotes_and_backslashes_do_not_end_a_string() {
        assert_eq!(super::quoted("a\"b\\c\nd"), r#""a\"b\\c\nd""#);
    }
}

//! Who may depend on whom: the table of the design page, section 2, as data and a check.
//!
//! The cores build for a microcontroller, so each crate they use is a decision of its own; on the host any crate from
//! outside may be used. `dev-dependencies` are free, but for one thing: nothing that `osap` may not be a part of can
//! reach it, not even through a helper crate, or a core could no longer be tested without the host's half.

use std::collections::{BTreeMap, BTreeSet};

use crate::manifest::{self, Dependency, Kind, Member};
use crate::problem::Problem;
use crate::tree::Tree;

/// Crates that build without the standard library and run on a device.
pub const CORES: [&str; 4] = ["fixed-math", "osap-protocol", "osap-runtime", "firmware-app"];

/// The host's crate, which nothing below it may reach.
const HOST: &str = "osap";

/// Crates that may be used from one side of the border of this workspace.
#[derive(Clone, Copy, Debug)]
enum May {
    Any,
    Only(&'static [&'static str]),
}

impl May {
    fn allows(self, name: &str) -> bool {
        match self {
            Self::Any => true,
            Self::Only(names) => names.contains(&name),
        }
    }
}

/// What one crate may use.
#[derive(Clone, Copy, Debug)]
struct Rule {
    folder: &'static str,
    name: &'static str,
    ours: May,
    outside: May,
}

/// The table. A crate that is not in it may not be in the workspace; those under `tests/` may use anything.
const RULES: [Rule; 7] = [
    Rule { folder: "fixed-math", name: "fixed-math", ours: May::Only(&[]), outside: May::Only(&["fixed"]) },
    Rule {
        folder: "protocol-spec",
        name: "osap-protocol",
        ours: May::Only(&["fixed-math"]),
        outside: May::Only(&["cobs", "crc", "postcard", "heapless", "serde"]),
    },
    Rule {
        folder: "runtime",
        name: "osap-runtime",
        ours: May::Only(&["osap-protocol", "fixed-math"]),
        outside: May::Only(&["heapless", "serde", "postcard"]),
    },
    Rule {
        folder: "rtic-firmware/app",
        name: "firmware-app",
        ours: May::Only(&["osap-runtime", "osap-protocol", "fixed-math"]),
        outside: May::Only(&["heapless"]),
    },
    Rule {
        folder: "sim",
        name: "osap-sim",
        ours: May::Only(&["osap-protocol", "osap-runtime", "fixed-math", "firmware-app"]),
        outside: May::Any,
    },
    Rule { folder: "host-cli", name: HOST, ours: May::Any, outside: May::Any },
    Rule { folder: "xtask", name: "xtask", ours: May::Only(&[]), outside: May::Any },
];

/// Where this table stands, for the messages.
const TABLE: &str = "`RULES` in tests/tidy/src/dependencies.rs";

/// Every member stands in the table and uses only what the table grants it.
#[must_use]
pub fn follow_the_table(tree: &Tree) -> Vec<Problem> {
    let (members, mut problems) = manifest::members(tree);
    let by_name: BTreeMap<&str, &Member> = members.iter().map(|member| (member.name.as_str(), member)).collect();
    problems.extend(members.iter().flat_map(|member| check_member(member, &by_name)));
    problems
}

fn check_member(member: &Member, by_name: &BTreeMap<&str, &Member>) -> Vec<Problem> {
    if member.folder.starts_with("tests/") {
        return Vec::new();
    }
    let Some(rule) = RULES.iter().find(|rule| rule.folder == member.folder && rule.name == member.name) else {
        let what = format!("no rule says what the crate `{}` in `{}` may depend on", member.name, member.folder);
        let mend = format!("add a row for this folder and name to {TABLE}, as the design page says");
        return vec![Problem::in_file(&member.manifest, what, mend)];
    };
    member.dependencies.iter().filter_map(|dependency| check_dependency(member, rule, dependency, by_name)).collect()
}

fn check_dependency(
    member: &Member,
    rule: &Rule,
    dependency: &Dependency,
    by_name: &BTreeMap<&str, &Member>,
) -> Option<Problem> {
    let (name, used) = (&member.name, dependency.package.as_str());
    let problem =
        |what: String, mend: String| Some(Problem { path: member.manifest.clone(), line: dependency.line, what, mend });
    if dependency.kind == Kind::Dev {
        let path = if rule.ours.allows(HOST) { None } else { path_to_host(used, by_name) };
        let what = format!("the tests of `{name}` reach `{HOST}`: {name} → {}", path?.join(" → "));
        return problem(what, "move the test that needs it to a crate under tests/".to_owned());
    }
    let is_ours = by_name.contains_key(used);
    let may = if is_ours { rule.ours } else { rule.outside };
    if may.allows(used) {
        return None;
    }
    let May::Only(granted) = may else { return None };
    let list = if granted.is_empty() { "none".to_owned() } else { granted.join(", ") };
    let side = if is_ours { "our crates" } else { "crates from outside" };
    problem(
        format!("`{name}` may not depend on `{used}`: of {side} it may use {list}"),
        format!("drop the dependency, or decide otherwise on the design page and then in {TABLE}"),
    )
}

/// The chain of our crates from `start` to the host's crate, where there is one.
fn path_to_host(start: &str, by_name: &BTreeMap<&str, &Member>) -> Option<Vec<String>> {
    let mut seen = BTreeSet::new();
    let mut open = vec![vec![start.to_owned()]];
    while let Some(path) = open.pop() {
        let last = path.last()?.as_str();
        if last == HOST {
            return Some(path);
        }
        let Some(member) = by_name.get(last).filter(|_| seen.insert(last.to_owned())) else { continue };
        for next in member.dependencies.iter().filter(|dependency| dependency.kind == Kind::Normal) {
            open.push([&path[..], std::slice::from_ref(&next.package)].concat());
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A workspace of `(folder, name, rest of the manifest)` members.
    fn workspace(members: &[(&str, &str, &str)]) -> Tree {
        let folders: Vec<_> = members.iter().map(|(folder, ..)| format!("{folder:?}")).collect();
        let root = format!("[workspace]\nmembers = [{}]\n", folders.join(", "));
        let manifests: Vec<_> = members
            .iter()
            .map(|(folder, name, rest)| (format!("{folder}/Cargo.toml"), format!("[package]\nname = {name:?}\n{rest}")))
            .collect();
        let mut files = vec![("Cargo.toml", root.as_str())];
        files.extend(manifests.iter().map(|(path, text)| (path.as_str(), text.as_str())));
        Tree::from_files(&files)
    }

    #[test]
    fn what_the_table_grants_is_no_problem() {
        let tree = workspace(&[
            ("fixed-math", "fixed-math", "[dependencies]\nfixed = \"1\"\n[dev-dependencies]\nproptest = \"1\"\n"),
            ("protocol-spec", "osap-protocol", "[dependencies]\nfixed-math.path = \"x\"\ncobs = \"1\"\n"),
            ("sim", "osap-sim", "[dependencies]\nosap-protocol.path = \"x\"\nrand = \"1\"\n"),
            ("host-cli", "osap", "[dependencies]\nosap-sim.path = \"x\"\nclap = \"1\"\n"),
            ("tests/e2e", "e2e", "[dependencies]\nosap.path = \"x\"\n"),
        ]);
        assert_eq!(follow_the_table(&tree), []);
    }

    #[test]
    fn a_core_may_not_take_a_crate_from_outside_that_was_not_decided() {
        let tree = workspace(&[("fixed-math", "fixed-math", "[dependencies]\nlibm = \"1\"\n")]);
        assert_eq!(
            follow_the_table(&tree)[0].to_string(),
            "fixed-math/Cargo.toml:4: `fixed-math` may not depend on `libm`: of crates from outside it may use fixed; \
             drop the dependency, or decide otherwise on the design page and then in `RULES` in \
             tests/tidy/src/dependencies.rs"
        );
    }

    #[test]
    fn our_crates_may_not_be_used_against_the_arrows() {
        let tree = workspace(&[
            ("fixed-math", "fixed-math", "[dependencies]\nosap-protocol.path = \"x\"\n"),
            ("protocol-spec", "osap-protocol", ""),
            ("sim", "osap-sim", "[build-dependencies]\nhost = { package = \"osap\", path = \"x\" }\n"),
            ("host-cli", "osap", ""),
            ("xtask", "xtask", "[target.'cfg(unix)'.dependencies]\nosap.path = \"x\"\n"),
        ]);
        let found: Vec<_> = follow_the_table(&tree).iter().map(|problem| problem.what.clone()).collect();
        assert_eq!(
            found,
            [
                "`fixed-math` may not depend on `osap-protocol`: of our crates it may use none",
                "`osap-sim` may not depend on `osap`: of our crates it may use osap-protocol, osap-runtime, fixed-math, firmware-app",
                "`xtask` may not depend on `osap`: of our crates it may use none",
            ]
        );
    }

    #[test]
    fn the_tests_of_a_core_may_not_reach_the_host_not_even_through_a_helper() {
        let tree = workspace(&[
            ("runtime", "osap-runtime", "[dev-dependencies]\nhelper.path = \"x\"\n"),
            ("tests/helper", "helper", "[dependencies]\nosap.path = \"x\"\n"),
            ("host-cli", "osap", "[dependencies]\nosap-runtime.path = \"x\"\n"),
        ]);
        let [problem] = &follow_the_table(&tree)[..] else { panic!("one problem") };
        assert_eq!(problem.what, "the tests of `osap-runtime` reach `osap`: osap-runtime → helper → osap");
    }

    #[test]
    fn a_member_without_a_row_is_told_to_get_one() {
        for (folder, name) in [("pipes", "osap-pipes"), ("runtime", "renamed"), ("elsewhere", "osap-runtime")] {
            let [problem] = &follow_the_table(&workspace(&[(folder, name, "")]))[..] else { panic!("one problem") };
            assert!(problem.what.contains(name) && problem.mend.contains("add a row"), "{problem}");
        }
    }
}

//! Who may depend on whom: the table of the design page, section 2, as data and a check.
//!
//! Boards and images are many and alike, so they have one row each for all of their kind. They are built one by one for their
//! chips; `default-members` has all other members, and only those.
//!
//! The cores build for a microcontroller, so each crate they use is a decision of its own; on the host any crate from
//! outside may be used. `dev-dependencies` are free, but for one thing: nothing that `osap` may not be a part of can
//! reach it, not even through a helper crate, or a core could no longer be tested without the host's half.

use std::collections::{BTreeMap, BTreeSet};

use crate::manifest::{self, Dependency, Kind, Member, Place};
use crate::problem::Problem;
use crate::tree::Tree;

/// Crates that build without the standard library and run on a device.
pub const CORES: [&str; 5] = ["fixed-math", "osap-protocol", "osap-runtime", "osap-maxl", "firmware-app"];

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
const RULES: [Rule; 8] = [
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
    Rule { folder: "maxl", name: "osap-maxl", ours: May::Only(&["fixed-math"]), outside: May::Only(&["heapless"]) },
    Rule {
        folder: "rtic-firmware/app",
        name: "firmware-app",
        ours: May::Only(&["osap-runtime", "osap-maxl", "osap-protocol", "fixed-math"]),
        outside: May::Only(&[
            "heapless",
            "sequential-storage",
            "embedded-storage",
            "embedded-storage-async",
            "embassy-futures",
        ]),
    },
    Rule {
        folder: "sim",
        name: "osap-sim",
        ours: May::Only(&["osap-protocol", "osap-runtime", "osap-maxl", "fixed-math", "firmware-app"]),
        outside: May::Any,
    },
    Rule { folder: "host-cli", name: HOST, ours: May::Any, outside: May::Any },
    Rule { folder: "xtask", name: "xtask", ours: May::Only(&[]), outside: May::Any },
];

/// What every board may use: its interrupts hand over to the device's parts, and any crate of its vendor.
const OF_A_BOARD: [&str; 5] = ["firmware-app", "osap-runtime", "osap-maxl", "osap-protocol", "fixed-math"];

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
    if let Place::Board(folder) | Place::Image(folder) = member.place() {
        return check_embedded(member, folder, by_name);
    }
    let Some(rule) = RULES.iter().find(|rule| rule.folder == member.folder && rule.name == member.name) else {
        let what = format!("no rule says what the crate `{}` in `{}` may depend on", member.name, member.folder);
        let mend = format!("add a row for this folder and name to {TABLE}, as the design page says");
        return vec![Problem::in_file(&member.manifest, what, mend)];
    };
    member.dependencies.iter().filter_map(|dependency| check_dependency(member, rule, dependency, by_name)).collect()
}

/// The kind of hardware that a folder is named for: up to its first dash.
fn family(folder: &str) -> &str {
    folder.split_once('-').map_or(folder, |(family, _)| family)
}

/// An image uses the board of its own folder. Beyond that, both may use boards of their family, which share registers.
fn check_embedded(member: &Member, folder: &str, by_name: &BTreeMap<&str, &Member>) -> Vec<Problem> {
    let (kind, board) = match member.place() {
        Place::Image(_) => ("image", Some(format!("board-{folder}"))),
        _ => ("board", None),
    };
    let expected = format!("{kind}-{folder}");
    let mut problems = Vec::new();
    if member.name != expected {
        let what = format!("the crate in `{}` is called `{}`", member.folder, member.name);
        problems.push(Problem::in_file(&member.manifest, what, format!("call it `{expected}`, after its folder")));
    }
    let is_of_family = |used: &str| used.strip_prefix("board-").is_some_and(|other| family(other) == family(folder));
    let is_granted = |used: &str| OF_A_BOARD.contains(&used) || board.as_deref() == Some(used) || is_of_family(used);
    for dependency in &member.dependencies {
        let used = dependency.package.as_str();
        if !by_name.contains_key(used) || is_granted(used) {
            continue;
        }
        let own = board.as_ref().map_or_else(String::new, |board| format!("{board}, "));
        let granted = OF_A_BOARD.join(", ");
        problems.push(Problem {
            path: member.manifest.clone(),
            line: dependency.line,
            what: format!("`{}` may not depend on `{used}`: of our crates it may use {own}{granted}", member.name),
            mend: format!("drop the dependency, or decide otherwise on the design page and then in {TABLE}"),
        });
    }
    problems
}

/// What builds on a host is a default member, so that a plain `cargo test` reaches it; boards and images are none, so that
/// it does not try to build them for the host.
#[must_use]
pub fn default_members_build_on_a_host(tree: &Tree) -> Vec<Problem> {
    let (members, mut problems) = manifest::members(tree);
    let default = manifest::default_members(tree);
    let root = "Cargo.toml";
    for member in &members {
        let folder = &member.folder;
        match (member.place(), default.contains(folder)) {
            (Place::Host, false) => {
                let what = format!("`{folder}` builds on a host and is no default member");
                problems.push(Problem::in_file(root, what, "add it to `default-members`"));
            }
            (Place::Board(_) | Place::Image(_), true) => {
                let what = format!("`{folder}` builds for a chip only and is a default member");
                problems.push(Problem::in_file(root, what, "take it out of `default-members`"));
            }
            _ => {}
        }
    }
    problems
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
                "`osap-sim` may not depend on `osap`: of our crates it may use osap-protocol, osap-runtime, osap-maxl, fixed-math, firmware-app",
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
    fn boards_and_images_may_use_what_their_kind_may() {
        let ours = "firmware-app.path = \"x\"\nosap-runtime.path = \"x\"\n";
        let image = format!("[dependencies]\nboard-a.path = \"x\"\nrtic = \"2\"\n{ours}");
        let tree = workspace(&[
            ("runtime", "osap-runtime", ""),
            ("rtic-firmware/app", "firmware-app", "[dependencies]\nsequential-storage = \"1\"\n"),
            ("boards/a", "board-a", &format!("[dependencies]\nvendor-hal = \"1\"\n{ours}")),
            ("boards/chip-two", "board-chip-two", "[dependencies]\nboard-chip-one.path = \"x\"\n"),
            ("boards/chip-one", "board-chip-one", ""),
            ("rtic-firmware/a", "image-a", &image),
        ]);
        assert_eq!(follow_the_table(&tree), []);
    }

    #[test]
    fn boards_and_images_may_not_use_what_is_the_hosts_or_another_boards() {
        let tree = workspace(&[
            ("host-cli", "osap", ""),
            ("boards/a", "board-a", "[dependencies]\nosap.path = \"x\"\n"),
            ("boards/b", "board-b", "[dependencies]\nboard-a.path = \"x\"\n"),
            ("rtic-firmware/a", "image-a", "[dependencies]\nboard-b.path = \"x\"\n"),
            ("rtic-firmware/b", "b", ""),
        ]);
        let found: Vec<_> = follow_the_table(&tree).iter().map(|problem| problem.what.clone()).collect();
        let granted = "firmware-app, osap-runtime, osap-maxl, osap-protocol, fixed-math";
        assert_eq!(
            found,
            [
                format!("`board-a` may not depend on `osap`: of our crates it may use {granted}"),
                format!("`board-b` may not depend on `board-a`: of our crates it may use {granted}"),
                format!("`image-a` may not depend on `board-b`: of our crates it may use board-a, {granted}"),
                "the crate in `rtic-firmware/b` is called `b`".to_owned(),
            ]
        );
    }

    #[test]
    fn a_default_member_that_needs_a_chip_or_a_member_of_the_host_that_is_none_is_found() {
        let with_default = |default: &str| {
            let manifests = ["sim", "boards/a", "rtic-firmware/a", "rtic-firmware/app"];
            let members = format!("[workspace]\nmembers = {manifests:?}\ndefault-members = {default}\n");
            let mut files = vec![("Cargo.toml".to_owned(), members)];
            files.extend(
                manifests.map(|folder| (format!("{folder}/Cargo.toml"), "[package]\nname = \"a\"\n".to_owned())),
            );
            let files: Vec<_> = files.iter().map(|(path, text)| (&path[..], &text[..])).collect();
            let found = default_members_build_on_a_host(&Tree::from_files(&files));
            found.iter().map(|problem| problem.what.clone()).collect::<Vec<_>>()
        };
        assert_eq!(with_default("[\"sim\", \"rtic-firmware/app\"]"), [""; 0]);
        assert_eq!(
            with_default("[\"sim\", \"boards/a\", \"rtic-firmware/a\"]"),
            [
                "`boards/a` builds for a chip only and is a default member",
                "`rtic-firmware/a` builds for a chip only and is a default member",
                "`rtic-firmware/app` builds on a host and is no default member",
            ]
        );
    }

    #[test]
    fn a_member_without_a_row_is_told_to_get_one() {
        for (folder, name) in [("pipes", "osap-pipes"), ("runtime", "renamed"), ("elsewhere", "osap-runtime")] {
            let [problem] = &follow_the_table(&workspace(&[(folder, name, "")]))[..] else { panic!("one problem") };
            assert!(problem.what.contains(name) && problem.mend.contains("add a row"), "{problem}");
        }
    }
}

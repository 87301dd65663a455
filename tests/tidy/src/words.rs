//! Words that have no place in committed files: names of a machine, leftovers, and clocks where time is an argument.
//!
//! The patterns are put together from parts, so that this file does not find itself.

use crate::problem::Problem;
use crate::tree::{File, Tree};

/// Folders of the person or machine that a file was written on. The last needs a name after it.
const MACHINE_PATHS: [&str; 4] =
    [concat!("/wo", "rk/"), concat!("/ro", "ot/"), concat!("/t", "mp/"), concat!("/ho", "me/")];

/// Hosts that packages are fetched from. Which one serves is a setting of a machine.
const REGISTRY_HOSTS: [&str; 6] = [
    concat!("index.crates", ".io"),
    concat!("static.crates", ".io"),
    concat!("deb.debian", ".org"),
    concat!("pypi", ".org"),
    concat!("pythonhosted", ".org"),
    concat!("registry.npmjs", ".org"),
];

/// Where every package of the lock file comes from: the default registry, by the name that Cargo gives it everywhere.
const LOCKED_SOURCE: &str = concat!("registry+https://github.com/rust-lang/crates", ".io-index");

/// What excuses the line it stands on and the next one, with a reason behind it.
const PATH_MARKER: &str = concat!("tidy: ", "path:");

/// Marks of work that was left undone, or that was only there to look.
const LEFTOVERS: [&str; 5] = [
    concat!("TO", "DO"),
    concat!("FIX", "ME"),
    concat!("unimpl", "emented!"),
    concat!("to", "do!"),
    concat!("db", "g!"),
];

/// Reads of a real clock, and waiting for one.
const CLOCKS: [&str; 3] = [concat!("Instant::", "now"), concat!("SystemTime::", "now"), concat!("thread::", "sleep")];

/// Folders in which time is an argument: the cores, and the simulator with its virtual time.
const TIMELESS: [&str; 5] = ["fixed-math/", "protocol-spec/", "runtime/", "rtic-firmware/app/", "sim/"];

/// No file names a folder of somebody's machine or the host of a registry.
#[must_use]
pub fn name_no_machine(tree: &Tree) -> Vec<Problem> {
    let mut problems = Vec::new();
    for file in tree.files().filter(|file| file.path != "Cargo.lock" && !file.is_npm_lock()) {
        let mut is_excused_from_above = false;
        for (number, line) in file.lines() {
            let is_excused = has_path_marker(line);
            if !is_excused && !is_excused_from_above {
                problems.extend(machine_name(line).map(|(name, mend)| {
                    Problem::at(&file.path, number, format!("`{name}` is a name of one machine"), mend)
                }));
            }
            is_excused_from_above = is_excused;
        }
    }
    problems
}

/// Every package of the lock file comes from the default registry: no mirror, no repository, no folder elsewhere.
#[must_use]
pub fn lock_names_one_source(tree: &Tree) -> Vec<Problem> {
    let Some(lock) = tree.file("Cargo.lock") else {
        let mend = "build once and commit it: all builds use the same versions";
        return vec![Problem::in_file("Cargo.lock", "the lock file is missing", mend)];
    };
    let source = |line: &str| line.strip_prefix("source = ").map(|source| source.trim_matches('"').to_owned());
    let others = lock.lines().filter_map(|(number, line)| Some((number, source(line)?)));
    let mend = "use the released package, or leave the registry's place to the machine's own Cargo settings";
    others
        .filter(|(_, source)| source != LOCKED_SOURCE)
        .map(|(number, source)| Problem::at("Cargo.lock", number, format!("a package comes from `{source}`"), mend))
        .collect()
}

/// No list of npm's packages says where one was fetched: that is a setting of a machine, as it is for the other lock file.
#[must_use]
pub fn npm_locks_name_no_source(tree: &Tree) -> Vec<Problem> {
    let mend = "write the file with npm's setting `omit-lockfile-registry-resolved`: the hash of each package stays";
    let mut problems = Vec::new();
    for file in tree.files().filter(|file| file.is_npm_lock()) {
        for (number, line) in file.lines().filter(|(_, line)| line.trim_start().starts_with("\"resolved\":")) {
            let what = format!("a package comes from {}", line.trim().trim_start_matches("\"resolved\":").trim());
            problems.push(Problem::at(&file.path, number, what, mend));
        }
    }
    problems
}

/// No source has work left undone in it.
#[must_use]
pub fn leave_nothing_undone(tree: &Tree) -> Vec<Problem> {
    let is_source =
        |file: &&File| ["rs", "lua", "mjs", "sh", "toml"].iter().any(|extension| file.has_extension(extension));
    let mend = "do it now, or open an issue and take this out";
    find(tree.files().filter(is_source), &LEFTOVERS, |_| true, "stands for work left undone", mend)
}

/// Neither the cores nor the simulator look at a real clock, in their tests neither.
#[must_use]
pub fn cores_read_no_clock(tree: &Tree) -> Vec<Problem> {
    let is_timeless = |file: &&File| TIMELESS.iter().any(|folder| file.path.starts_with(folder));
    let is_code = |line: &str| !line.trim_start().starts_with("//");
    let mend = "take the time as an argument: the caller has the clock, or the simulated world";
    find(tree.rust_files().filter(is_timeless), &CLOCKS, is_code, "uses a real clock where time is an argument", mend)
}

/// A problem for each line of `files` that has one of `words`.
fn find<'a>(
    files: impl Iterator<Item = &'a File>,
    words: &[&str],
    is_checked: impl Fn(&str) -> bool,
    what: &str,
    mend: &str,
) -> Vec<Problem> {
    let mut problems = Vec::new();
    for file in files {
        for (number, line) in file.lines().filter(|(_, line)| is_checked(line)) {
            if let Some(word) = words.iter().find(|word| has_word(line, word)) {
                problems.push(Problem::at(&file.path, number, format!("`{word}` {what}"), mend));
            }
        }
    }
    problems
}

/// Whether `word` stands in `line` and is not a part of a longer word.
fn has_word(line: &str, word: &str) -> bool {
    let is_part = |c: Option<char>| c.is_some_and(|c| c.is_alphanumeric() || c == '_');
    line.match_indices(word).any(|(at, _)| {
        let after = line[at + word.len()..].chars().next();
        !is_part(line[..at].chars().next_back()) && (word.ends_with('!') || !is_part(after))
    })
}

fn has_path_marker(line: &str) -> bool {
    let reason = line.split_once(PATH_MARKER).map(|(_, reason)| reason);
    reason.is_some_and(|reason| reason.chars().any(char::is_alphanumeric))
}

/// The first name of a machine in `line`, and what to write instead.
fn machine_name(line: &str) -> Option<(&'static str, String)> {
    if let Some(path) = MACHINE_PATHS.into_iter().find(|path| has_absolute_path(line, path)) {
        let mend =
            format!("use a path from the repository or the environment, or say `{PATH_MARKER} <reason>` beside it");
        return Some((path, mend));
    }
    let host = REGISTRY_HOSTS.into_iter().find(|host| line.contains(host))?;
    Some((host, "name the package and its kind of registry only".to_owned()))
}

/// Whether `folder` starts an absolute path in `line`: nothing before it that would make it the middle of one.
fn has_absolute_path(line: &str, folder: &str) -> bool {
    let continues = |c: char| c.is_alphanumeric() || "._-~$})>*/".contains(c);
    line.match_indices(folder).any(|(at, _)| {
        let has_name = line[at + folder.len()..].starts_with(|c: char| c.is_alphanumeric());
        !line[..at].ends_with(continues) && (folder != MACHINE_PATHS[3] || has_name)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(check: fn(&Tree) -> Vec<Problem>, path: &str, text: &str) -> Vec<usize> {
        check(&Tree::from_files(&[(path, text)])).iter().filter_map(|problem| problem.line).collect()
    }

    #[test]
    fn paths_of_a_machine_are_found_in_every_kind_of_file() {
        for extension in ["rs", "md", "toml", "sh", "lua"] {
            for folder in MACHINE_PATHS {
                let text = format!("\n// see {folder}somebody/file\n");
                assert_eq!(lines(name_no_machine, &format!("a/b.{extension}"), &text), [2], "{extension} {folder}");
            }
        }
        assert_eq!(lines(name_no_machine, ".ci/run", &format!("cd {}x\n", MACHINE_PATHS[0])), [1]);
    }

    #[test]
    fn paths_that_only_look_alike_are_let_be() {
        let text = format!(
            "target{tmp}a\n\"$DIR\"/work\n./dev{tmp}\n/dev/ttyACM0\n{home}<name>\nthe /home page\n",
            tmp = MACHINE_PATHS[2],
            home = MACHINE_PATHS[3]
        );
        assert_eq!(lines(name_no_machine, "a.md", &text), [0; 0]);
    }

    #[test]
    fn a_marker_with_a_reason_excuses_its_line_and_the_next() {
        let path = MACHINE_PATHS[2];
        let text = format!("// {PATH_MARKER} shown to users\n{path}a\n{path}b\n{path}c // {PATH_MARKER} so\n");
        assert_eq!(lines(name_no_machine, "a.rs", &text), [3]);
        assert_eq!(lines(name_no_machine, "a.rs", &format!("{path}c // {PATH_MARKER} \n")), [1]);
    }

    #[test]
    fn hosts_of_registries_are_found() {
        for host in REGISTRY_HOSTS {
            assert_eq!(lines(name_no_machine, "README.md", &format!("from https://{host}/x\n")), [1]);
        }
    }

    #[test]
    fn a_lock_file_that_names_a_mirror_or_is_missing_is_found() {
        let good = format!("[[package]]\nname = \"a\"\nsource = \"{LOCKED_SOURCE}\"\n");
        assert_eq!(lines(lock_names_one_source, "Cargo.lock", &good), [0; 0]);
        let bad = good.clone() + "[[package]]\nname = \"b\"\nsource = \"sparse+http://mirror.example/index/\"\n";
        assert_eq!(lines(lock_names_one_source, "Cargo.lock", &bad), [6]);
        assert_eq!(lock_names_one_source(&Tree::from_files(&[])).len(), 1);
    }

    #[test]
    fn an_npm_lock_that_names_a_place_is_found_and_hashes_are_let_be() {
        let good = "{\n  \"node_modules/a\": {\n    \"integrity\": \"sha512-x\"\n";
        assert_eq!(lines(npm_locks_name_no_source, "a/package-lock.json", good), [0; 0]);
        let bad = format!("{good}    \"resolved\": \"https://mirror.example/a.tgz\",\n");
        assert_eq!(lines(npm_locks_name_no_source, "a/package-lock.json", &bad), [4]);
        assert_eq!(lines(npm_locks_name_no_source, "a/other.mjs", &bad), [0; 0]);
    }

    #[test]
    fn leftovers_are_found_and_longer_words_are_not_taken_for_them() {
        for word in LEFTOVERS {
            assert_eq!(lines(leave_nothing_undone, "a/src/b.rs", &format!("//! A.\n{word}(x);\n")), [2], "{word}");
        }
        let upper = LEFTOVERS[0];
        assert_eq!(lines(leave_nothing_undone, "a/src/b.rs", &format!("// {upper}S {upper}_LIST MY{upper}\n")), [0; 0]);
        assert_eq!(lines(leave_nothing_undone, "a/b.lua", &format!("-- {upper}: x\n")), [1]);
        assert_eq!(lines(leave_nothing_undone, "a/b.mjs", &format!("// {upper}: x\n")), [1]);
    }

    #[test]
    fn a_clock_in_a_core_or_the_simulator_is_found_and_elsewhere_it_is_not() {
        for clock in CLOCKS {
            let text = format!("//! No {clock} here.\nfn a() {{ std::time::{clock}(); }}\n");
            for folder in TIMELESS {
                assert_eq!(lines(cores_read_no_clock, &format!("{folder}src/b.rs"), &text), [2], "{folder}");
                assert_eq!(lines(cores_read_no_clock, &format!("{folder}tests/b.rs"), &text), [2], "{folder}");
            }
            assert_eq!(lines(cores_read_no_clock, "host-cli/src/b.rs", &text), [0; 0]);
        }
    }
}

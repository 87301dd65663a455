//! The members of the workspace: their names, dependencies and crate roots, read from `Cargo.toml`.

use toml::{Table, Value};

use crate::problem::Problem;
use crate::tree::{File, Tree};

/// Folder whose members hold what differs from board to board.
pub const BOARDS: &str = "boards/";

/// Folder whose members are images, but for one.
pub const IMAGES: &str = "rtic-firmware/";

/// The member of that folder which all images share.
const LIBRARY: &str = "rtic-firmware/app";

/// Where a member runs, with its folder's own name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place<'a> {
    /// On a workstation, whatever else it is built for.
    Host,
    /// Below an image, on one kind of board.
    Board(&'a str),
    /// It is what a board runs.
    Image(&'a str),
}

/// Which table of a manifest a dependency stands in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// `[dependencies]` or `[build-dependencies]`, for any target.
    Normal,
    /// `[dev-dependencies]`, for any target.
    Dev,
}

/// One dependency of a member.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Dependency {
    /// The package's own name, whatever the manifest calls it.
    pub package: String,
    /// Where it stands.
    pub kind: Kind,
    /// Line of the manifest that names it, counted from one, where it was found.
    pub line: Option<usize>,
}

/// One member of the workspace.
#[derive(Clone, Debug)]
pub struct Member {
    /// Its folder, from the root with forward slashes.
    pub folder: String,
    /// Path of its manifest.
    pub manifest: String,
    /// Name of the package.
    pub name: String,
    /// All it depends on.
    pub dependencies: Vec<Dependency>,
    /// Files that are the root of a library or binary.
    pub roots: Vec<String>,
}

impl Member {
    /// Where it runs.
    #[must_use]
    pub fn place(&self) -> Place<'_> {
        let below = |folder: &str| self.folder.strip_prefix(folder).filter(|name| !name.contains('/'));
        match (below(BOARDS), below(IMAGES)) {
            (Some(name), _) => Place::Board(name),
            (_, Some(name)) if self.folder != LIBRARY => Place::Image(name),
            _ => Place::Host,
        }
    }
}

/// The members that the root manifest lists, and a problem for each manifest that is missing, is not TOML, or lacks
/// what is needed. One bad manifest does not hide the other members from a check.
#[must_use]
pub fn members(tree: &Tree) -> (Vec<Member>, Vec<Problem>) {
    let root = match parse(tree, "Cargo.toml") {
        Ok(root) => root,
        Err(problem) => return (Vec::new(), vec![problem]),
    };
    let workspace = root.get("workspace").and_then(Value::as_table);
    let listed = workspace.and_then(|table| table.get("members")).and_then(Value::as_array);
    let folders: Vec<&str> = listed.into_iter().flatten().filter_map(Value::as_str).collect();
    let shared = workspace.and_then(|table| table.get("dependencies")).and_then(Value::as_table);
    let empty = Table::new();
    let (mut members, mut problems) = (Vec::new(), Vec::new());
    if folders.is_empty() {
        let mend = "list the folders of the crates under `[workspace] members`";
        problems.push(Problem::in_file("Cargo.toml", "the workspace lists no member", mend));
    }
    for folder in folders {
        match member(tree, folder, shared.unwrap_or(&empty)) {
            Ok(member) => members.push(member),
            Err(problem) => problems.push(problem),
        }
    }
    (members, problems)
}

/// Folders that `default-members` of the root manifest lists: what Cargo builds where no package is named.
#[must_use]
pub fn default_members(tree: &Tree) -> Vec<String> {
    let root = parse(tree, "Cargo.toml").unwrap_or_default();
    let listed = root.get("workspace").and_then(|workspace| workspace.get("default-members")).and_then(Value::as_array);
    listed.into_iter().flatten().filter_map(Value::as_str).map(str::to_owned).collect()
}

fn parse(tree: &Tree, path: &str) -> Result<Table, Problem> {
    let Some(file) = tree.file(path) else {
        let mend = "create it, or take the folder out of the `members` in the root Cargo.toml";
        return Err(Problem::in_file(path, "this manifest of a workspace member does not exist", mend));
    };
    file.text.parse().map_err(|error: toml::de::Error| {
        Problem::in_file(path, format!("not a manifest: {}", error.message()), "mend the TOML")
    })
}

fn member(tree: &Tree, folder: &str, shared: &Table) -> Result<Member, Problem> {
    let manifest = format!("{folder}/Cargo.toml");
    let table = parse(tree, &manifest)?;
    let package = table.get("package").and_then(|package| package.get("name")).and_then(Value::as_str);
    let Some(name) = package else {
        return Err(Problem::in_file(manifest, "the package has no name", "give it `[package] name`"));
    };
    let file = tree.file(&manifest);
    Ok(Member {
        name: name.to_owned(),
        dependencies: dependencies(&table, shared, file),
        roots: roots(tree, folder, &table),
        folder: folder.to_owned(),
        manifest,
    })
}

/// All dependencies of a manifest, for every target, under their packages' own names.
fn dependencies(manifest: &Table, shared: &Table, file: Option<&File>) -> Vec<Dependency> {
    let targets = manifest.get("target").and_then(Value::as_table);
    let sections = targets.into_iter().flat_map(Table::values).filter_map(Value::as_table);
    let mut found = Vec::new();
    for section in std::iter::once(manifest).chain(sections) {
        for (table, kind) in
            [("dependencies", Kind::Normal), ("build-dependencies", Kind::Normal), ("dev-dependencies", Kind::Dev)]
        {
            for (key, entry) in section.get(table).and_then(Value::as_table).into_iter().flatten() {
                let inherited = entry.get("workspace").is_some().then(|| shared.get(key)).flatten();
                let package = inherited.unwrap_or(entry).get("package").and_then(Value::as_str).unwrap_or(key);
                let line = file.and_then(|file| line_naming(file, key));
                found.push(Dependency { package: package.to_owned(), kind, line });
            }
        }
    }
    found
}

/// First line that sets `key`: `key = …`, `key.workspace = …` or `[dependencies.key]`.
fn line_naming(file: &File, key: &str) -> Option<usize> {
    let names = |line: &str| {
        let line = line.trim();
        let rest = line.strip_prefix(key).map(str::trim_start);
        rest.is_some_and(|rest| rest.starts_with(['=', '.'])) || line.ends_with(&format!("dependencies.{key}]"))
    };
    file.lines().find(|(_, line)| names(line)).map(|(number, _)| number)
}

/// Root files of a member's library and binaries that exist.
fn roots(tree: &Tree, folder: &str, manifest: &Table) -> Vec<String> {
    let path = |value: &Value| value.get("path").and_then(Value::as_str).map(|path| format!("{folder}/{path}"));
    let mut roots = vec![format!("{folder}/src/lib.rs"), format!("{folder}/src/main.rs")];
    roots.extend(manifest.get("lib").and_then(path));
    roots.extend(manifest.get("bin").and_then(Value::as_array).into_iter().flatten().filter_map(path));
    let bin = format!("{folder}/src/bin/");
    let is_binary = |file: &&File| match file.path.strip_prefix(&bin) {
        Some(rest) => !rest.contains('/') || rest.ends_with("/main.rs") && rest.matches('/').count() == 1,
        None => false,
    };
    roots.extend(tree.rust_files().filter(is_binary).map(|file| file.path.clone()));
    roots.retain(|root| tree.file(root).is_some());
    roots.sort_unstable();
    roots.dedup();
    roots
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROOT: &str =
        "[workspace]\nmembers = [\"a\"]\n[workspace.dependencies]\nshort = { package = \"long-name\" }\n";

    #[test]
    fn dependencies_are_read_from_every_table_under_their_own_names() {
        let manifest = "[package]\nname = \"a-crate\"\n[dependencies]\nshort.workspace = true\nplain = \"1\"\n\
                        [dev-dependencies.other]\npackage = \"renamed\"\nversion = \"1\"\n\
                        [target.'cfg(unix)'.build-dependencies]\nnarrow = \"1\"\n";
        let tree = Tree::from_files(&[("Cargo.toml", ROOT), ("a/Cargo.toml", manifest)]);
        let (members, problems) = members(&tree);
        assert_eq!(problems, []);
        let mut found: Vec<_> =
            members[0].dependencies.iter().map(|one| (&one.package[..], one.kind, one.line)).collect();
        found.sort_unstable_by_key(|one| one.2);
        assert_eq!(members[0].name, "a-crate");
        assert_eq!(
            found,
            [
                ("long-name", Kind::Normal, Some(4)),
                ("plain", Kind::Normal, Some(5)),
                ("renamed", Kind::Dev, Some(6)),
                ("narrow", Kind::Normal, Some(10)),
            ]
        );
    }

    #[test]
    fn crate_roots_are_those_that_cargo_would_build() {
        let manifest = "[package]\nname = \"a\"\n[[bin]]\nname = \"x\"\npath = \"odd/x.rs\"\n";
        let tree = Tree::from_files(&[
            ("Cargo.toml", ROOT),
            ("a/Cargo.toml", manifest),
            ("a/src/lib.rs", ""),
            ("a/src/node.rs", ""),
            ("a/src/bin/one.rs", ""),
            ("a/src/bin/two/main.rs", ""),
            ("a/src/bin/two/part.rs", ""),
            ("a/odd/x.rs", ""),
        ]);
        let expected = ["a/odd/x.rs", "a/src/bin/one.rs", "a/src/bin/two/main.rs", "a/src/lib.rs"];
        assert_eq!(members(&tree).0[0].roots, expected);
    }

    #[test]
    fn manifests_that_cannot_be_used_are_problems() {
        for (files, expected) in [
            (vec![("README.md", "")], "does not exist"),
            (vec![("Cargo.toml", "[workspace]\n")], "lists no member"),
            (vec![("Cargo.toml", ROOT)], "does not exist"),
            (vec![("Cargo.toml", ROOT), ("a/Cargo.toml", "[package\n")], "not a manifest"),
            (vec![("Cargo.toml", ROOT), ("a/Cargo.toml", "[package]\n")], "has no name"),
        ] {
            let (_, problems) = members(&Tree::from_files(&files));
            assert!(problems[0].what.contains(expected), "{expected}: {problems:?}");
        }
    }
}

//! The text files of a repository, held in memory, with what is known of each.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::{fs, io};

use crate::facts::Facts;
use crate::problem::Problem;

/// Folders that hold nothing of ours.
const SKIPPED_FOLDERS: [&str; 3] = ["target", "node_modules", ".git"];

/// Endings of the files that the checks read.
const READ_EXTENSIONS: [&str; 6] = ["rs", "md", "toml", "sh", "lua", "mjs"];

/// Names of files that programs write and that checks read, wherever they lie.
const READ_LOCKS: [&str; 1] = ["package-lock.json"];

/// Why a repository could not be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// A folder could not be listed.
    #[error("cannot list {}: {source}; give the root of the repository, and check the folder's permissions", path.display())]
    List {
        /// The folder.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A file could not be read as UTF-8 text.
    #[error("cannot read {}: {source}; it has to be UTF-8 text that you may read", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

/// One text file.
#[derive(Debug)]
pub struct File {
    /// Path from the root of the repository, with forward slashes.
    pub path: String,
    /// Its whole text.
    pub text: String,
    /// What was read off it, where it is Rust that parses.
    pub facts: Option<Facts>,
    /// All of it is test code: it lies in a `tests` folder or is the body of a `#[cfg(test)]` module.
    pub is_test: bool,
}

impl File {
    /// Its lines with their numbers, counted from one.
    pub fn lines(&self) -> impl Iterator<Item = (usize, &str)> {
        self.text.lines().enumerate().map(|(index, line)| (index + 1, line))
    }

    /// Whether `line`, counted from one, is test code.
    #[must_use]
    pub fn is_test_line(&self, line: usize) -> bool {
        self.is_test || self.facts.as_ref().is_some_and(|facts| facts.is_test_line(line))
    }

    /// Whether its name ends in `.extension`.
    #[must_use]
    pub fn has_extension(&self, extension: &str) -> bool {
        Path::new(&self.path).extension().is_some_and(|have| have == extension)
    }

    /// Whether it is npm's list of the packages that were chosen.
    #[must_use]
    pub fn is_npm_lock(&self) -> bool {
        self.path.rsplit('/').next() == Some(READ_LOCKS[0])
    }

    /// Whether one of the folders it lies in is called `name`.
    #[must_use]
    pub fn lies_in(&self, name: &str) -> bool {
        self.path.rsplit('/').skip(1).any(|folder| folder == name)
    }
}

/// The text files of a repository, by path.
#[derive(Debug)]
pub struct Tree {
    files: BTreeMap<String, File>,
    unparsed: Vec<Problem>,
}

impl Tree {
    /// Reads the files under `root` that checks look at; what lies in `target` and the like is left out.
    ///
    /// The folder is walked instead of asking git, so that a file is checked before it is committed.
    ///
    /// # Errors
    /// Where a folder or file cannot be read.
    pub fn read(root: &Path) -> Result<Self, ReadError> {
        let mut texts = Vec::new();
        read_folder(root, "", &mut texts)?;
        Ok(Self::from_texts(texts))
    }

    /// A tree made in memory of `(path, text)` pairs.
    #[must_use]
    pub fn from_files(files: &[(&str, &str)]) -> Self {
        Self::from_texts(files.iter().map(|&(path, text)| (path.to_owned(), text.to_owned())).collect())
    }

    /// All files, by path.
    pub fn files(&self) -> impl Iterator<Item = &File> {
        self.files.values()
    }

    /// All Rust files, by path.
    pub fn rust_files(&self) -> impl Iterator<Item = &File> {
        self.files().filter(|file| file.has_extension("rs"))
    }

    /// The file at `path`, from the root with forward slashes.
    #[must_use]
    pub fn file(&self, path: &str) -> Option<&File> {
        self.files.get(path)
    }

    /// Rust files that the parser does not know, of which no other check can say anything.
    #[must_use]
    pub fn unparsed(&self) -> &[Problem] {
        &self.unparsed
    }

    fn from_texts(texts: Vec<(String, String)>) -> Self {
        let mut tree = Self { files: BTreeMap::new(), unparsed: Vec::new() };
        for (path, text) in texts {
            let mut file = File { path: path.clone(), text, facts: None, is_test: false };
            file.is_test = file.lies_in("tests");
            if file.has_extension("rs") {
                match Facts::parse(&file.text) {
                    Ok(facts) => file.facts = Some(facts),
                    Err(error) => tree.unparsed.push(Problem::at(
                        &path,
                        error.span().start().line,
                        format!("not Rust that can be parsed: {error}"),
                        "mend the syntax, or update `syn` where the compiler takes it",
                    )),
                }
            }
            tree.files.insert(path, file);
        }
        tree.mark_test_modules();
        tree
    }

    /// A `#[cfg(test)] mod tests;` makes another file, and all below it, test code.
    fn mark_test_modules(&mut self) {
        let mut stems = Vec::new();
        for file in self.files.values() {
            for module in file.facts.iter().flat_map(|facts| &facts.test_module_files) {
                stems.push(module_stem(&file.path, &module.name, module.path.as_deref()));
            }
        }
        for file in self.files.values_mut() {
            let below = |stem: &String| file.path == format!("{stem}.rs") || file.path.starts_with(&format!("{stem}/"));
            file.is_test |= stems.iter().any(below);
        }
    }
}

/// Where the module `name`, declared in the file `parent`, lives: `stem.rs` or `stem/mod.rs`, and below `stem/`.
fn module_stem(parent: &str, name: &str, explicit: Option<&str>) -> String {
    let (folder, file) = parent.rsplit_once('/').unwrap_or(("", parent));
    if let Some(path) = explicit {
        return format!("{folder}/{}", path.trim_end_matches(".rs"));
    }
    match file {
        "lib.rs" | "main.rs" | "mod.rs" => format!("{folder}/{name}"),
        other => format!("{folder}/{}/{name}", other.trim_end_matches(".rs")),
    }
}

/// Collects the files below `folder`, whose path from the root is `prefix`.
fn read_folder(folder: &Path, prefix: &str, texts: &mut Vec<(String, String)>) -> Result<(), ReadError> {
    let failed = |source| ReadError::List { path: folder.to_owned(), source };
    for entry in fs::read_dir(folder).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let kind = entry.file_type().map_err(failed)?;
        // A name that is not UTF-8 has none of the endings that are read.
        let Ok(name) = entry.file_name().into_string() else { continue };
        let path = if prefix.is_empty() { name.clone() } else { format!("{prefix}/{name}") };
        if kind.is_dir() && !SKIPPED_FOLDERS.contains(&name.as_str()) {
            read_folder(&entry.path(), &path, texts)?;
        } else if kind.is_file() && is_read(&path) {
            let text =
                fs::read_to_string(entry.path()).map_err(|source| ReadError::Read { path: entry.path(), source })?;
            texts.push((path, text));
        }
    }
    Ok(())
}

fn is_read(path: &str) -> bool {
    let extension = Path::new(path).extension().and_then(|extension| extension.to_str());
    let is_lock = path.rsplit('/').next().is_some_and(|name| READ_LOCKS.contains(&name));
    path == "Cargo.lock"
        || is_lock
        || path.starts_with(".ci/")
        || extension.is_some_and(|known| READ_EXTENSIONS.contains(&known))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reading_takes_sources_and_leaves_what_was_built() {
        let root = tempfile::tempdir().unwrap();
        for (path, text) in [
            ("a/src/lib.rs", "//! A.\n"),
            ("a/target/debug/b.rs", "not rust"),
            (".ci/run", "true\n"),
            (".git/config.toml", "x"),
            ("picture.png", "x"),
            ("a/b.mjs", "x"),
            ("a/package-lock.json", "x"),
            ("a/node_modules/b/c.mjs", "x"),
        ] {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
        let tree = Tree::read(root.path()).unwrap();
        assert_eq!(
            tree.files().map(|file| &file.path[..]).collect::<Vec<_>>(),
            [".ci/run", "a/b.mjs", "a/package-lock.json", "a/src/lib.rs"]
        );
    }

    #[test]
    fn a_missing_root_says_what_to_give() {
        let root = tempfile::tempdir().unwrap();
        let said = Tree::read(&root.path().join("missing")).unwrap_err().to_string();
        assert!(said.contains("missing") && said.contains("give the root of the repository"), "{said}");
    }

    #[test]
    fn text_that_is_no_utf8_is_named() {
        let root = tempfile::tempdir().unwrap();
        fs::write(root.path().join("bad.md"), [0xff, 0xfe]).unwrap();
        let said = Tree::read(root.path()).unwrap_err().to_string();
        assert!(said.contains("bad.md") && said.contains("UTF-8"), "{said}");
    }

    #[test]
    fn a_file_that_does_not_parse_is_a_problem_with_its_line() {
        let tree = Tree::from_files(&[("a/src/lib.rs", "//! A.\nfn (\n")]);
        let [problem] = tree.unparsed() else { panic!("one problem, got {:?}", tree.unparsed()) };
        assert_eq!((&problem.path[..], problem.line), ("a/src/lib.rs", Some(2)));
    }

    #[test]
    fn test_code_is_told_from_the_rest() {
        let tree = Tree::from_files(&[
            ("a/src/lib.rs", "#[cfg(test)]\nmod checks;\nmod node;\n"),
            ("a/src/checks.rs", ""),
            ("a/src/checks/deep.rs", ""),
            ("a/src/node.rs", "#[cfg(test)]\nmod tests;\n#[cfg(test)]\n#[path = \"odd.rs\"]\nmod b;\n"),
            ("a/src/node/tests.rs", ""),
            ("a/src/odd.rs", ""),
            ("a/tests/whole.rs", ""),
            ("tests/fuzz/src/main.rs", ""),
        ]);
        let outside: Vec<_> = tree.files().filter(|file| !file.is_test).map(|file| &file.path[..]).collect();
        assert_eq!(outside, ["a/src/lib.rs", "a/src/node.rs"]);
        let root = tree.file("a/src/lib.rs").unwrap();
        assert!(root.is_test_line(2) && !root.is_test_line(3));
    }
}

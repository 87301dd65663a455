//! Runs every check on this repository. That each check can fail is shown beside it, in its own unit tests.

use std::path::{Path, PathBuf};

use tidy::{Problem, Tree, chips, clauses, dependencies, modules, readme_walk, sizes, words};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn tree() -> Tree {
    Tree::read(&root()).unwrap_or_else(|error| panic!("{error}"))
}

#[track_caller]
fn assert_none(problems: &[Problem]) {
    let list: Vec<_> = problems.iter().map(ToString::to_string).collect();
    assert!(list.is_empty(), "{} problem(s):\n  {}\n", list.len(), list.join("\n  "));
}

/// Guards all tests below: a wrong root would leave them nothing to find.
#[test]
fn the_tree_is_this_repository() {
    let tree = tree();
    for path in ["Cargo.toml", "tests/tidy/src/lib.rs", "tests/tidy/tests/this_repository.rs", ".ci/run"] {
        assert!(tree.file(path).is_some(), "{path} was not read");
    }
}

#[test]
fn every_rust_file_parses() {
    assert_none(tree().unparsed());
}

#[test]
fn dependencies_follow_the_table() {
    assert_none(&dependencies::follow_the_table(&tree()));
}

#[test]
fn default_members_build_on_a_host() {
    assert_none(&dependencies::default_members_build_on_a_host(&tree()));
}

#[test]
fn unsafe_code_has_its_reason() {
    assert_none(&chips::explain_unsafe(&tree()));
}

#[test]
fn images_tell_their_tasks() {
    assert_none(&chips::images_tell_their_tasks(&tree()));
}

#[test]
fn npm_locks_name_no_source() {
    assert_none(&words::npm_locks_name_no_source(&tree()));
}

#[test]
fn crates_forbid_unsafe_code() {
    assert_none(&modules::forbid_unsafe(&tree()));
}

#[test]
fn cores_are_no_std() {
    assert_none(&modules::cores_are_no_std(&tree()));
}

#[test]
fn modules_have_docs() {
    assert_none(&modules::have_docs(&tree()));
}

#[test]
fn clauses_are_covered() {
    assert_none(&clauses::are_covered(&tree()));
}

#[test]
fn files_and_functions_are_small() {
    assert_none(&sizes::are_small(&tree()));
}

#[test]
fn files_name_no_machine() {
    assert_none(&words::name_no_machine(&tree()));
}

#[test]
fn the_lock_file_names_one_source() {
    assert_none(&words::lock_names_one_source(&tree()));
}

#[test]
fn sources_leave_nothing_undone() {
    assert_none(&words::leave_nothing_undone(&tree()));
}

#[test]
fn cores_and_simulator_read_no_clock() {
    assert_none(&words::cores_read_no_clock(&tree()));
}

#[test]
fn the_readme_tells_one_packets_walk() {
    let stages = readme_walk(&root()).unwrap_or_else(|error| panic!("{error}"));
    // In, routed, out: fewer would be no walk.
    assert!(stages.len() >= 3, "only {stages:?}");
}

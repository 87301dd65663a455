//! What only boards and images may do, and what they owe for it: unsafe code with its reason, and tasks with their table.

use proc_macro2::{Delimiter, TokenStream, TokenTree};

use crate::manifest::{self, Member, Place};
use crate::problem::Problem;
use crate::tree::{File, Tree};

/// What a reason for unsafe code begins with, in a comment.
const REASON: &str = "SAFETY";

/// Lines above an unsafe block in which its reason may begin; a comment right above may be longer.
const REASON_WITHIN_LINES: usize = 3;

/// How the table of tasks begins, without blanks.
const TABLE_HEAD: &str = "|task|boundto|priority|";

/// Every `unsafe` block and `unsafe impl` of a board or image has its reason beside it.
///
/// Looked for among the tokens, so that what stands within a macro call counts too. An `unsafe fn` only asks for something
/// and needs no reason; who calls it does.
#[must_use]
pub fn explain_unsafe(tree: &Tree) -> Vec<Problem> {
    let (members, mut problems) = manifest::members(tree);
    for member in members.iter().filter(|member| member.place() != Place::Host) {
        let folder = format!("{}/", member.folder);
        for file in tree.rust_files().filter(|file| file.path.starts_with(&folder)) {
            // What does not parse is told by the tree itself.
            let Ok(tokens) = file.text.parse::<TokenStream>() else { continue };
            let mut lines = Vec::new();
            note_unsafe(tokens, &mut lines);
            problems.extend(lines.into_iter().filter(|&line| !has_reason(file, line)).map(|line| {
                let mend = format!("say in a comment `// {REASON}: …` right above why this is sound");
                Problem::at(&file.path, line, "unsafe code without its reason", mend)
            }));
        }
    }
    problems
}

/// Lines on which an unsafe block or `unsafe impl` begins.
fn note_unsafe(tokens: TokenStream, lines: &mut Vec<usize>) {
    let mut tokens = tokens.into_iter().peekable();
    while let Some(token) = tokens.next() {
        match token {
            TokenTree::Group(group) => note_unsafe(group.stream(), lines),
            TokenTree::Ident(word) if word == "unsafe" => {
                let is_use = match tokens.peek() {
                    Some(TokenTree::Group(next)) => next.delimiter() == Delimiter::Brace,
                    Some(TokenTree::Ident(next)) => next == "impl",
                    _ => false,
                };
                if is_use {
                    lines.push(word.span().start().line);
                }
            }
            _ => {}
        }
    }
}

fn has_reason(file: &File, line: usize) -> bool {
    let says = |text: &str| text.split_once("//").is_some_and(|(_, comment)| comment.contains(REASON));
    let begins_with_it =
        file.text.lines().nth(line).is_some_and(|below| below.trim_start().starts_with("//") && says(below));
    let lines: Vec<&str> = file.text.lines().take(line).collect();
    let Some((own, above)) = lines.split_last() else { return false };
    let near = above.iter().rev().take(REASON_WITHIN_LINES);
    let joined = above.iter().rev().take_while(|text| text.trim_start().starts_with(['/', '#']));
    says(own) || begins_with_it || near.chain(joined).any(|text| says(text))
}

/// The `main.rs` of every image opens with the table of its tasks.
#[must_use]
pub fn images_tell_their_tasks(tree: &Tree) -> Vec<Problem> {
    let (members, mut problems) = manifest::members(tree);
    let images = members.iter().filter(|member| matches!(member.place(), Place::Image(_)));
    problems.extend(images.filter_map(|image| check_table(tree, image)));
    problems
}

fn check_table(tree: &Tree, image: &Member) -> Option<Problem> {
    let path = format!("{}/src/main.rs", image.folder);
    let mend = "open it with `//! | task | bound to | priority | …` and a row for each task, as the design page shows";
    let Some(file) = tree.file(&path) else {
        return Some(Problem::in_file(path, "the image has no such file", mend));
    };
    let docs = file.text.lines().map(str::trim).skip_while(|line| line.is_empty());
    let docs = docs.map_while(|line| line.strip_prefix("//!"));
    let squeezed = docs.map(|line| line.split_whitespace().collect::<String>());
    let mut table = squeezed.skip_while(|line| !line.to_lowercase().starts_with(TABLE_HEAD)).skip(1);
    let is_row = |line: &String| line.starts_with('|') && line.chars().any(char::is_alphanumeric);
    let has_rows = table.by_ref().take_while(|line| line.starts_with('|')).any(|line| is_row(&line));
    (!has_rows).then(|| Problem::at(path, 1, "the image does not open with the table of its tasks", mend))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One member in `folder` with one file below its `src`.
    fn tree(folder: &str, file: &str, text: &str) -> Tree {
        Tree::from_files(&[
            ("Cargo.toml", &format!("[workspace]\nmembers = [{folder:?}]\n")),
            (&format!("{folder}/Cargo.toml"), "[package]\nname = \"a\"\n"),
            (&format!("{folder}/src/{file}"), text),
        ])
    }

    fn lines(text: &str) -> Vec<usize> {
        explain_unsafe(&tree("boards/a", "lib.rs", text)).iter().filter_map(|problem| problem.line).collect()
    }

    #[test]
    fn unsafe_code_without_its_reason_is_found_in_boards_and_images() {
        for folder in ["boards/a", "rtic-firmware/a"] {
            let [problem] = &explain_unsafe(&tree(folder, "deep/b.rs", "fn a() {\n    unsafe { b() }\n}\n"))[..] else {
                panic!("one problem in {folder}")
            };
            assert_eq!((&problem.path[..], problem.line), (&format!("{folder}/src/deep/b.rs")[..], Some(2)));
        }
        assert_eq!(lines("unsafe impl Sync for A {}\n"), [1]);
        assert_eq!(lines("call!(\n    unsafe { b() }\n);\n"), [2]);
        assert_eq!(lines("// This is safe.\nfn a() { unsafe { b() } }\n"), [2]);
    }

    #[test]
    fn a_reason_beside_or_right_above_counts_and_one_far_above_does_not() {
        assert_eq!(lines("// SAFETY: nobody else has it\nunsafe impl Sync for A {}\n"), [0; 0]);
        assert_eq!(lines("unsafe impl Sync for A {} // SAFETY: nobody else has it\n"), [0; 0]);
        assert_eq!(lines("// SAFETY: so\n\n\nunsafe impl Sync for A {}\n"), [0; 0]);
        assert_eq!(lines("// SAFETY: so\n\n\n\nunsafe impl Sync for A {}\n"), [5]);
        assert_eq!(lines("fn a() { unsafe {\n    // SAFETY: so\n    b() } }\n"), [0; 0]);
        assert_eq!(lines("fn a() { unsafe {\n    b() } }\n// SAFETY: so\n"), [1]);
        let long = "// SAFETY: so\n// and\n// so\n// and\n#[cfg(x)]\nunsafe impl Sync for A {}\n";
        assert_eq!(lines(long), [0; 0]);
    }

    #[test]
    fn what_only_has_the_word_in_it_needs_no_reason() {
        assert_eq!(
            lines("#[unsafe(no_mangle)]\nunsafe fn a() {}\n// unsafe { }\nconst B: &str = \"unsafe {}\";\n"),
            [0; 0]
        );
    }

    const HEAD: &str = "//! | task  | bound to | priority | period |\n";

    fn told(text: &str) -> usize {
        images_tell_their_tasks(&tree("rtic-firmware/a", "main.rs", text)).len()
    }

    #[test]
    fn an_image_that_does_not_open_with_its_tasks_is_found() {
        let row = "//! | route | SW0_IRQ  | 2        | TTL    |\n";
        let line = "//! |-------|----------|----------|--------|\n";
        assert_eq!(told(&format!("//! An image.\n//!\n//! ```text\n{HEAD}{row}//! ```\n#![no_std]\n")), 0);
        assert_eq!(told(&format!("//! An image.\n{HEAD}{line}{row}")), 0);
        assert_eq!(told("//! An image.\n"), 1);
        assert_eq!(told(&format!("//! An image.\n{HEAD}{line}")), 1, "a table without tasks");
        assert_eq!(told(&format!("//! An image.\nfn main() {{}}\n{HEAD}{row}")), 1, "below the code");
        assert_eq!(images_tell_their_tasks(&tree("rtic-firmware/a", "lib.rs", HEAD)).len(), 1, "no main.rs");
        assert_eq!(images_tell_their_tasks(&tree("boards/a", "lib.rs", "")), []);
    }
}

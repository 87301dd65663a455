//! Cycles on processors that nothing here emulates to the cycle: the machine code of `fixed_math::kernels` through LLVM's model of them.
//!
//! - **Walk:** Cargo makes assembly → each function's body → `llvm-mca` → cycles, less those of an empty function → one document.
//! - **Invariants:** only functions that do not branch are taken, since the model does not; memory answers at once. A model is not a
//!   measurement: the rows say so.

use std::path::PathBuf;

use serde_json::{Value, json};

use crate::run::{Error, Program, root, write};
use crate::setup;

/// Model names and ours.
const PROCESSORS: [(&str, &str); 2] = [("cortex-m4", "M4F"), ("cortex-m7", "M7")];
const TARGET: &str = "thumbv7em-none-eabihf";
/// Functions, those that are taken off, and evaluations in each: those of `fixed_math::kernels::BLOCKS` that do not branch.
const KERNELS: [(&str, &str, f64); 3] = [
    ("horner_position", "empty_part", 8.0),
    ("horner_position_velocity", "empty_part_pair", 8.0),
    ("differences_block", "empty", 128.0),
];
/// How often the model runs a function.
const ITERATIONS: f64 = 100.0;

/// The document of all processors.
pub(super) fn document() -> Result<String, Error> {
    setup::programs_of(setup::MODEL).complete()?;
    let missing = |why: &str| Error::NotRunHere { what: "llvm-mca".to_owned(), why: why.to_owned() };
    let version = Program::new("llvm-mca").args(["--version"]).ask();
    let version = version.ok_or_else(|| missing("it is not installed; `cargo xtask setup` tells why"))?;
    let version = version.lines().find(|line| line.contains("version")).unwrap_or("LLVM").trim().to_owned();
    let mut rows: Vec<Value> = Vec::new();
    for (processor, name) in PROCESSORS {
        let assembly = assembly(processor)?;
        let cycles = |kernel: &str| {
            let body = body(&assembly, kernel).ok_or_else(|| missing(&format!("no code of {kernel}")))?;
            modelled(processor, kernel, &body)
        };
        for (kernel, empty, evaluations) in KERNELS {
            let net = (cycles(kernel)? - cycles(empty)?) / evaluations;
            rows.push(json!({ "processor": name, "name": kernel, "cycles": net }));
        }
    }
    let model = format!("llvm-mca, {version}");
    Ok(json!({ "version": 1, "report": "motion-model", "model": model, "rows": rows }).to_string())
}

/// What the compiler makes of the functions for `processor`. It stands in the build's own folder, so that it is there while Cargo says that
/// there is nothing to do.
fn assembly(processor: &str) -> Result<String, Error> {
    let folder = root().join(format!("target/motion/{processor}"));
    let path = folder.join("kernels.s");
    let cargo = Program::cargo("rustc --release -p fixed-math --lib --features kernels --target").args([TARGET]);
    let cargo = cargo.args(["--target-dir".into(), folder.into_os_string(), "--".into()]);
    let emit = format!("--emit=asm={}", path.display());
    let cpu = format!("-Ctarget-cpu={processor}");
    cargo.args([emit.as_str(), cpu.as_str(), "-Copt-level=3", "-Ccodegen-units=1", "-Cdebuginfo=0"]).run()?;
    std::fs::read_to_string(&path).map_err(|source| Error::File { what: "read", path, source })
}

/// The instructions of a function in `fixed_math::kernels`.
fn body(assembly: &str, kernel: &str) -> Option<String> {
    let symbol = format!("7kernels{}{kernel}17h", kernel.len());
    let is_begun = |line: &&str| line.ends_with(':') && line.contains(&symbol);
    let mut lines = assembly.lines().skip_while(|line| !is_begun(line));
    lines.next()?;
    let instructions = lines.take_while(|line| !line.trim_start().starts_with(".fnend")).filter(|line| {
        let line = line.trim_start();
        // local labels stay, since branches name them; the rest of what begins with a dot is for the assembler
        (!line.starts_with('.') && !line.starts_with('@') && !line.is_empty()) || line.starts_with(".LBB")
    });
    Some(instructions.collect::<Vec<_>>().join("\n") + "\n")
}

/// Cycles of one run of a function.
fn modelled(processor: &str, kernel: &str, body: &str) -> Result<f64, Error> {
    let path: PathBuf = root().join(format!("target/motion/{processor}-{kernel}.s"));
    write(&path, body)?;
    let iterations = format!("--iterations={ITERATIONS}");
    let program =
        Program::new("llvm-mca").args([format!("--mtriple={TARGET}"), format!("--mcpu={processor}"), iterations]);
    let text = program.args([&path]).capture()?;
    total(&text).map(|cycles| cycles / ITERATIONS).ok_or_else(|| Error::NotRunHere {
        what: "llvm-mca".to_owned(),
        why: format!("it told no cycles of {kernel} on {processor}; is its LLVM older than the compiler's?"),
    })
}

/// The cycles that a model told.
fn total(text: &str) -> Option<f64> {
    let line = text.lines().find_map(|line| line.strip_prefix("Total Cycles:"))?;
    line.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_functions_instructions_are_found_without_what_is_for_the_assembler() {
        let assembly = "_ZN10fixed_math7kernels5empty17h0E:\n\t.fnstart\n\tbx\tlr\n\t.fnend\n\
                        _ZN10fixed_math7kernels10empty_part17h1E:\n\t.fnstart\n\t@ note\n\tpush\t{r7}\n.LBB1_1:\n\tbne\t.LBB1_1\n\t.fnend\n";
        assert_eq!(body(assembly, "empty").as_deref(), Some("\tbx\tlr\n"));
        assert_eq!(body(assembly, "empty_part").as_deref(), Some("\tpush\t{r7}\n.LBB1_1:\n\tbne\t.LBB1_1\n"));
        assert_eq!(body(assembly, "part"), None);
    }

    #[test]
    fn cycles_are_read_where_a_model_told_them() {
        assert_eq!(total("Iterations:        100\nTotal Cycles:      6801\n"), Some(6801.0));
        assert_eq!(total("error: no such processor"), None);
    }
}

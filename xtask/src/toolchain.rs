//! Which compiler builds for a bare-metal target: your own, completed by rustup, or else one put together from Debian's.
//!
//! Where rustup may not fetch a target, Debian's own compiler and its library source can take its place: the core library
//! is built once, and a folder laid out as the compiler expects one (a *sysroot*) is put together from it and links to the
//! system's. rustup's compilers and Debian's source do not mix: each knows lang items that the other does not.
//!
//! Everything here is idempotent, and asks before it does: what is there is found in some milliseconds.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use crate::run::{Error, Program, root, write};
use crate::system;

/// Debian's compiler, as new as its browsers need it, with its library source and linter. `rust-web-llvm` has nothing but the
/// name `rust-lld` for a linker that comes with `lld-22`.
const PACKAGES: [&str; 7] =
    ["rustc-web", "cargo-web", "rust-web-src", "rustfmt-web", "rust-web-clippy", "rust-web-llvm", "lld-22"];

/// Where Debian puts programs.
const DEBIAN_PROGRAMS: &str = "/usr/bin";

/// Where Debian puts the compiler's libraries and sources.
const DEBIAN_LIBRARIES: &str = "/usr/lib/rustlib";

/// Where the sysroot is put together, below the root of the repository.
const SYSROOT: &str = "target/toolchain/debian";

/// Libraries that make up a bare-metal sysroot.
const LIBRARIES: [&str; 3] = ["libcore-", "liballoc-", "libcompiler_builtins-"];

/// A compiler that can build for some target.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Toolchain {
    /// The one that built this driver.
    Own,
    /// The one put together from Debian's, in this folder.
    Debian(PathBuf),
}

/// What is to be done to have a compiler for a target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    /// Nothing: this one can.
    Use(Have),
    /// Ask rustup for the target.
    AskRustup,
}

/// Where a target is to be had at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Have {
    Own,
    Debian,
}

impl Toolchain {
    /// Cargo of this compiler, with `arguments` that are split at spaces.
    pub(crate) fn cargo(&self, arguments: &str) -> Program {
        match self {
            Self::Own => Program::cargo(arguments),
            Self::Debian(sysroot) => {
                // The cargo that runs this driver leaves its own compiler's place in these variables.
                let leftovers = ["CARGO", "RUSTC", "RUSTUP_TOOLCHAIN", "LD_LIBRARY_PATH"];
                let path = format!("{}:{DEBIAN_PROGRAMS}:/bin", sysroot.join("bin").display());
                let program = Program::new(sysroot.join("bin/cargo")).args(arguments.split_whitespace());
                leftovers.into_iter().fold(program.env("PATH", &path), Program::env_remove)
            }
        }
    }
}

/// A compiler for `target`, installed where there is none yet; else why not, and what to do.
pub(crate) fn provide(target: &str) -> Result<Toolchain, String> {
    // Said once for each target, however often it is asked for.
    static SAID: Mutex<Vec<String>> = Mutex::new(Vec::new());
    let toolchain = find_or_install(target)?;
    let mut said = SAID.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    if !said.iter().any(|other| other == target) {
        said.push(target.to_owned());
        match &toolchain {
            Toolchain::Own => eprintln!("{target}: your own compiler"),
            Toolchain::Debian(_) => eprintln!("{target}: Debian's compiler, put together in {SYSROOT}"),
        }
    }
    Ok(toolchain)
}

fn find_or_install(target: &str) -> Result<Toolchain, String> {
    let sysroot = root().join(SYSROOT);
    match decide(has_target(target), debian().is_some_and(|debian| is_built(&sysroot, target, &debian.release))) {
        Step::Use(Have::Own) => Ok(Toolchain::Own),
        Step::Use(Have::Debian) => Ok(Toolchain::Debian(sysroot)),
        Step::AskRustup => {
            let Err(refused) = Program::new("rustup").args(["target", "add", target]).run() else {
                return Ok(Toolchain::Own);
            };
            eprintln!(
                "rustup has no {target} for us ({refused}); taking Debian's compiler, which takes some minutes once"
            );
            let sysroot = assemble(&sysroot, target).map_err(|why| {
                format!("{refused}; Debian's compiler cannot take its place: {why}; or install the target `{target}` yourself")
            })?;
            Ok(Toolchain::Debian(sysroot))
        }
    }
}

/// The compiler in use comes first, whatever else there is: it is what the person chose.
fn decide(own_has_target: bool, debian_has_target: bool) -> Step {
    match (own_has_target, debian_has_target) {
        (true, _) => Step::Use(Have::Own),
        (false, true) => Step::Use(Have::Debian),
        (false, false) => Step::AskRustup,
    }
}

/// Whether the compiler in use has a core library for `target`. Asked of the compiler itself, which need not come from
/// rustup.
fn has_target(target: &str) -> bool {
    let folder = Program::new("rustc").args(["--print", "target-libdir", "--target", target]).ask();
    folder.is_some_and(|folder| has_library(Path::new(&folder), LIBRARIES[0]))
}

fn has_library(folder: &Path, prefix: &str) -> bool {
    let mut files = fs::read_dir(folder).into_iter().flatten().flatten();
    files.any(|file| file.file_name().to_string_lossy().starts_with(prefix))
}

/// What Debian's compiler says of itself.
#[derive(Debug, PartialEq, Eq)]
struct Debian {
    /// Its version.
    release: String,
    /// The machine that it runs on, as compilers call it.
    host: String,
}

/// Debian's compiler, where it is installed with the source of its library.
fn debian() -> Option<Debian> {
    let source = Path::new(DEBIAN_LIBRARIES).join("src/rust/library/core/src/lib.rs");
    if !source.exists() {
        return None;
    }
    let rustc = Program::new(Path::new(DEBIAN_PROGRAMS).join("rustc")).env_remove("LD_LIBRARY_PATH");
    describe(&rustc.args(["-vV"]).ask()?)
}

/// Reads what `rustc -vV` tells.
fn describe(said: &str) -> Option<Debian> {
    let after = |name: &str| said.lines().find_map(|line| line.strip_prefix(name)).map(str::to_owned);
    Some(Debian { release: after("release: ")?, host: after("host: ")? })
}

fn libraries(sysroot: &Path, target: &str) -> PathBuf {
    sysroot.join("lib/rustlib").join(target).join("lib")
}

/// File whose presence says that all was done, for one version of the compiler.
fn stamp(sysroot: &Path, target: &str, version: &str) -> PathBuf {
    sysroot.join("lib/rustlib").join(target).join(format!("built-{version}"))
}

/// Whether the sysroot has `target`, built by this version of the compiler.
fn is_built(sysroot: &Path, target: &str, version: &str) -> bool {
    stamp(sysroot, target, version).exists() && has_library(&libraries(sysroot, target), LIBRARIES[0])
}

/// Installs Debian's compiler, builds the core library for `target` and puts the sysroot together.
fn assemble(sysroot: &Path, target: &str) -> Result<PathBuf, String> {
    if debian().is_none() {
        system::install(&PACKAGES)?;
    }
    let debian = debian().ok_or("it was installed, but has no library source or does not start")?;
    let said = |error: std::io::Error| format!("cannot put together {}: {error}", sysroot.display());
    lay_out(sysroot, &debian.host).map_err(said)?;
    build_core(sysroot, target).map_err(|error| error.to_string())?;
    collect_libraries(sysroot, target).map_err(said)?;
    write(&stamp(sysroot, target, &debian.release), "").map_err(|error| error.to_string())?;
    Ok(sysroot.to_owned())
}

/// Programs and links of the sysroot, but for the libraries of a target.
fn lay_out(sysroot: &Path, host: &str) -> std::io::Result<()> {
    let (bin, rustlib) = (sysroot.join("bin"), sysroot.join("lib/rustlib"));
    fs::create_dir_all(&bin)?;
    fs::create_dir_all(&rustlib)?;
    for name in [host, "src"] {
        let here = rustlib.join(name);
        if !here.exists() {
            link(&Path::new(DEBIAN_LIBRARIES).join(name), &here)?;
        }
    }
    for name in ["cargo", "cargo-fmt", "rustfmt"] {
        let here = bin.join(name);
        if !here.exists() {
            link(&Path::new(DEBIAN_PROGRAMS).join(name), &here)?;
        }
    }
    let folder = sysroot.display();
    for name in ["rustc", "rustdoc"] {
        write_script(&bin.join(name), &format!("exec {DEBIAN_PROGRAMS}/{name} --sysroot \"{folder}\" \"$@\""))?;
    }
    for name in ["cargo-clippy", "clippy-driver"] {
        write_script(&bin.join(name), &format!("SYSROOT=\"{folder}\" exec {DEBIAN_PROGRAMS}/{name} \"$@\""))?;
    }
    Ok(())
}

/// Builds the core library for `target` below the sysroot's own folder for it.
///
/// The library's source is built as a dependency of an empty crate, which is what `build-std` offers. Debian's compiler is
/// a stable one, so it has to be told that we know that this is not.
fn build_core(sysroot: &Path, target: &str) -> Result<(), Error> {
    let probe = sysroot.join("probe");
    let manifest = "[package]\nname = \"sysroot-probe\"\nversion = \"0.0.0\"\nedition = \"2024\"\n\
                    [profile.release]\nopt-level = 3\ndebug = 0\npanic = \"abort\"\n[workspace]\n";
    write(&probe.join("Cargo.toml"), manifest)?;
    write(&probe.join("src/lib.rs"), "#![no_std]\n")?;
    let cargo = Toolchain::Debian(sysroot.to_owned()).cargo("build --release -Zbuild-std=core,alloc");
    // Bitcode in the libraries is what lets link-time optimisation reach into them.
    let cargo = cargo.env("RUSTC_BOOTSTRAP", "1").env("RUSTFLAGS", "-Cembed-bitcode=yes");
    let folder = probe.join("target");
    cargo.args(["--target", target]).args(["--target-dir".as_ref(), folder.as_os_str()]).within(&probe).run()
}

/// Moves what [`build_core`] built to where the compiler looks for it.
fn collect_libraries(sysroot: &Path, target: &str) -> std::io::Result<()> {
    let (built, here) = (sysroot.join("probe/target").join(target).join("release/deps"), libraries(sysroot, target));
    if here.exists() {
        fs::remove_dir_all(&here)?;
    }
    fs::create_dir_all(&here)?;
    for entry in fs::read_dir(built)? {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let is_rlib = Path::new(&name).extension().is_some_and(|extension| extension == "rlib");
        if is_rlib && LIBRARIES.iter().any(|prefix| name.starts_with(prefix)) {
            fs::copy(entry.path(), here.join(&name))?;
        }
    }
    fs::remove_dir_all(sysroot.join("probe"))
}

#[cfg(unix)]
fn link(to: &Path, here: &Path) -> std::io::Result<()> {
    std::os::unix::fs::symlink(to, here)
}

#[cfg(unix)]
fn write_script(path: &Path, line: &str) -> std::io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    fs::write(path, format!("#!/bin/sh\n{line}\n"))?;
    fs::set_permissions(path, fs::Permissions::from_mode(0o755))
}

/// Debian is a unix: elsewhere nothing gets this far, as there is no apt-get.
#[cfg(not(unix))]
fn link(_to: &Path, _here: &Path) -> std::io::Result<()> {
    Err(std::io::ErrorKind::Unsupported.into())
}

#[cfg(not(unix))]
fn write_script(_path: &Path, _line: &str) -> std::io::Result<()> {
    Err(std::io::ErrorKind::Unsupported.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_target_that_no_compiler_has_is_not_taken_to_be_there() {
        assert!(!has_target("no-such-target"));
    }

    #[test]
    fn the_compilers_own_target_is_found() {
        let version = Program::new("rustc").args(["-vV"]).ask().expect("rustc runs");
        let host = version.lines().find_map(|line| line.strip_prefix("host: ")).expect("rustc names its host");
        assert!(has_target(host), "{host}");
    }

    #[test]
    fn the_compiler_in_use_comes_before_debians_and_nothing_is_fetched_where_one_can() {
        assert_eq!(decide(true, true), Step::Use(Have::Own));
        assert_eq!(decide(true, false), Step::Use(Have::Own));
        assert_eq!(decide(false, true), Step::Use(Have::Debian));
        assert_eq!(decide(false, false), Step::AskRustup);
    }

    #[test]
    fn a_sysroot_of_an_older_compiler_or_half_built_is_not_taken() {
        let sysroot = tempfile::tempdir().unwrap();
        let sysroot = sysroot.path();
        assert!(!is_built(sysroot, "t", "1.96.0"));
        write(&stamp(sysroot, "t", "1.96.0"), "").unwrap();
        assert!(!is_built(sysroot, "t", "1.96.0"), "a stamp without libraries");
        write(&libraries(sysroot, "t").join("libcore-12ab.rlib"), "").unwrap();
        assert!(is_built(sysroot, "t", "1.96.0"));
        assert!(!is_built(sysroot, "t", "1.97.0") && !is_built(sysroot, "u", "1.96.0"));
    }

    #[test]
    fn release_and_host_are_read_off_what_the_compiler_says() {
        let said = "rustc 1.96.0\nbinary: rustc\nhost: x86_64-unknown-linux-gnu\nrelease: 1.96.0\nLLVM version: 22";
        let expected = Debian { release: "1.96.0".to_owned(), host: "x86_64-unknown-linux-gnu".to_owned() };
        assert_eq!(describe(said), Some(expected));
        assert_eq!(describe("sh: rustc: not found"), None);
    }

    #[cfg(unix)]
    #[test]
    fn built_libraries_are_collected_and_nothing_else() {
        let sysroot = tempfile::tempdir().unwrap();
        let sysroot = sysroot.path();
        let built = sysroot.join("probe/target/t/release/deps");
        for name in
            ["libcore-1.rlib", "libcore-1.rmeta", "liballoc-2.rlib", "libcompiler_builtins-3.rlib", "libprobe-4.rlib"]
        {
            write(&built.join(name), "").unwrap();
        }
        write(&libraries(sysroot, "t").join("libcore-0.rlib"), "of an older compiler").unwrap();
        collect_libraries(sysroot, "t").unwrap();
        let mut found: Vec<_> =
            fs::read_dir(libraries(sysroot, "t")).unwrap().flatten().map(|e| e.file_name()).collect();
        found.sort();
        assert_eq!(found, ["liballoc-2.rlib", "libcompiler_builtins-3.rlib", "libcore-1.rlib"]);
        assert!(!sysroot.join("probe").exists());
    }
}

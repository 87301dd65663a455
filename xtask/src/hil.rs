//! Runs the images in emulators, through the harness in `tests/hil`: what it needs is made ready first, each thing once.

use std::fs;
use std::path::Path;

use crate::images::{Image, Images, Load};
use crate::run::{Error, Program, root, write};
use crate::setup;

/// The harness, one front for all emulators.
pub(crate) const HARNESS: &str = "osap-hil";

/// The emulated RP2040, which is a package of Node.js.
const RP2040: &str = "tests/hil/rp2040";

/// The program that the harness runs beside itself, as a user would.
const HOST_PROGRAM: &str = "build --release -p osap --bin osap";

/// `cargo xtask hil`: makes ready what is needed, and hands over to the harness with `arguments` as they are.
pub(crate) fn hil(arguments: &[String]) -> Result<(), Error> {
    ready(&Images::read()?)?;
    harness(arguments).run()
}

/// The harness, once all that it needs is [`ready`].
pub(crate) fn harness(arguments: &[String]) -> Program {
    Program::cargo("run --release -p").args([HARNESS, "--"]).args(arguments)
}

/// Installs emulators and packages where they are missing, and builds the images that the emulators run and the host's
/// program.
pub(crate) fn ready(images: &Images) -> Result<(), Error> {
    setup::programs_of(setup::HIL).complete()?;
    install_packages()?;
    for image in images.all().iter().filter(|image| is_emulated(image)) {
        images.build_with_variants(image)?;
    }
    Program::cargo(HOST_PROGRAM).run()
}

/// Whether an emulator runs this image: those without a board, and those of the RP2040. Of the others none has a model.
fn is_emulated(image: &Image) -> bool {
    matches!(image.load, Load::Emulator | Load::Uf2 { .. })
}

/// The tests of the emulated RP2040 itself.
pub(crate) fn rp2040_tests() -> Result<Program, Error> {
    install_packages()?;
    Ok(npm("test"))
}

fn npm(command: &str) -> Program {
    Program::new("npm").args(["--prefix", RP2040, command])
}

/// Installs the packages that the lock file names, unless they are those of the last time.
pub(crate) fn install_packages() -> Result<(), Error> {
    let (folder, stamp) = (root().join(RP2040), root().join("target/npm").join(RP2040).join("package-lock.json"));
    let path = folder.join("package-lock.json");
    let lock = fs::read_to_string(&path).map_err(|source| Error::File { what: "read", path, source })?;
    if is_installed(&lock, &stamp, &folder) {
        return Ok(());
    }
    npm("ci").args(["--include=dev", "--no-audit", "--no-fund"]).run().map_err(|error| Error::NotRunHere {
        what: format!("the packages of {RP2040}"),
        why: format!("{error}; can this machine reach npm's registry, and does package-lock.json fit package.json?"),
    })?;
    write(&stamp, &lock)
}

/// Whether the packages in `folder` are those of `lock`: the stamp is a copy of the lock file that they were installed from.
fn is_installed(lock: &str, stamp: &Path, folder: &Path) -> bool {
    folder.join("node_modules").is_dir() && fs::read_to_string(stamp).is_ok_and(|installed| installed == lock)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packages_are_installed_once_for_each_lock_file() {
        let folder = tempfile::tempdir().unwrap();
        let (folder, stamp) = (folder.path(), folder.path().join("deep/stamp"));
        assert!(!is_installed("a", &stamp, folder), "nothing was ever installed");
        write(&stamp, "a").unwrap();
        assert!(!is_installed("a", &stamp, folder), "somebody removed the packages");
        fs::create_dir(folder.join("node_modules")).unwrap();
        assert!(is_installed("a", &stamp, folder));
        assert!(!is_installed("b", &stamp, folder), "the lock file has changed");
    }

    #[test]
    fn what_an_emulator_runs_is_built_for_it_and_what_none_can_run_is_not() {
        let image = |load| Image {
            name: "a".to_owned(),
            package: "image-a".to_owned(),
            target: "t".to_owned(),
            load,
            features: std::collections::BTreeMap::new(),
            variants: Vec::new(),
        };
        let chip = || "C".to_owned();
        assert!(is_emulated(&image(Load::Emulator)) && is_emulated(&image(Load::Uf2 { chip: chip() })));
        assert!(!is_emulated(&image(Load::Probe { chip: chip() })));
    }
}

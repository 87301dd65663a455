//! Puts an image onto a board: through a debug probe, or by the drive that a Pico's boot ROM shows. What can be done is
//! decided by what is seen; where nothing can be done, the reason comes with the next step.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::images::{Features, Image, Images, Load, shown};
use crate::run::{Error, Program};
use crate::size::read;
use crate::uf2;

/// What the boot ROM calls its drive, and its board in [`DRIVE_FILE`].
const DRIVE: &str = "RPI-RP2";

/// The file by which a UF2 drive is known.
const DRIVE_FILE: &str = "INFO_UF2.TXT";

/// Folders below which systems mount drives, with how deep they lie.
const MOUNTS: [(&str, usize); 4] = [("/media", 2), ("/run/media", 2), ("/Volumes", 1), ("/mnt", 1)];

/// What was asked for beyond the image.
#[derive(Clone, Debug, Default)]
pub(crate) struct Wanted {
    /// This probe, as probe-rs selects one.
    pub(crate) probe: Option<String>,
    /// This drive.
    pub(crate) drive: Option<PathBuf>,
}

/// What is attached to this machine.
#[derive(Clone, Debug, Default)]
struct Seen {
    /// Debug probes as probe-rs lists them; `None` where it is not installed.
    probes: Option<Vec<String>>,
    /// Mounted drives of boot ROMs.
    drives: Vec<PathBuf>,
    /// Devices of boot ROMs that are plugged in and not mounted.
    unmounted: Vec<String>,
}

/// What to do.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Plan {
    /// Through a probe, to this chip.
    Probe { chip: String, probe: Option<String> },
    /// Copy the UF2 file to this drive.
    Copy(PathBuf),
}

/// `cargo xtask flash`.
pub(crate) fn flash(name: &str, wanted: &Wanted) -> Result<(), Error> {
    let not_run = |why| Error::NotRunHere { what: format!("flash {name}"), why };
    let images = Images::read()?;
    let [image] = images.named(name)?[..] else {
        return Err(not_run("each board takes one image; name the one that is attached".to_owned()));
    };
    if image.load == Load::Emulator {
        return decide(image, wanted, &Seen::default(), Path::new("")).map(drop).map_err(not_run);
    }
    let elf = images.build(image, &Features::default())?;
    let uf2 = match image.load {
        Load::Uf2 { .. } => write_uf2(&images, image, &elf)?,
        _ => PathBuf::new(),
    };
    match decide(image, wanted, &look(), &uf2).map_err(not_run)? {
        Plan::Probe { chip, probe } => {
            let select = |command: &str| {
                let program = Program::new("probe-rs").args([command, "--chip", &chip]);
                program.args(probe.iter().flat_map(|probe| ["--probe", probe]))
            };
            select("download").args([&elf]).run()?;
            select("reset").run()?;
        }
        Plan::Copy(drive) => copy(&uf2, &drive)?,
    }
    println!(
        "{name} is flashed and has started; `cargo osap scan` finds it once it is plugged in as a USB or serial device"
    );
    Ok(())
}

fn write_uf2(images: &Images, image: &Image, elf: &Path) -> Result<PathBuf, Error> {
    let path = images.made_folder().join(format!("{}.uf2", image.name));
    let file = uf2::encode(&read(elf)?.segments).map_err(|source| Error::Uf2 { path: elf.to_owned(), source })?;
    let written = path.parent().map_or(Ok(()), fs::create_dir_all).and_then(|()| fs::write(&path, file));
    written.map_err(|source| Error::File { what: "write", path: path.clone(), source })?;
    println!("wrote {}", shown(&path));
    Ok(path)
}

/// What to do for `image`, whose UF2 file, where it has one, is `uf2`; else why nothing can be done, and the next
/// step.
fn decide(image: &Image, wanted: &Wanted, seen: &Seen, uf2: &Path) -> Result<Plan, String> {
    match &image.load {
        Load::Emulator => Err(format!(
            "this image runs in an emulator and there is no board to flash; `cargo xtask build {}` builds it and \
             `cargo xtask hil` runs it",
            image.name
        )),
        Load::Probe { chip } => through_probe(chip, wanted, seen),
        Load::Uf2 { chip } if wanted.probe.is_some() => through_probe(chip, wanted, seen),
        Load::Uf2 { .. } => to_drive(image, wanted, seen, &shown(uf2)),
    }
}

fn through_probe(chip: &str, wanted: &Wanted, seen: &Seen) -> Result<Plan, String> {
    let again = "and run this again";
    let Some(probes) = &seen.probes else {
        let install = "`cargo install probe-rs-tools --locked`";
        return Err(format!("probe-rs is not installed; install it with {install}, plug in the board {again}"));
    };
    match (&probes[..], &wanted.probe) {
        ([], _) => Err(format!(
            "probe-rs sees no debug probe; plug in the board's debug USB socket, check that your user may use it \
             (probe-rs's udev rules) {again}"
        )),
        ([_, _, ..], None) => Err(format!(
            "there are {} debug probes:\n  {}\ngive the one to use as `--probe VID:PID:SERIAL` {again}",
            probes.len(),
            probes.join("\n  ")
        )),
        (_, probe) => Ok(Plan::Probe { chip: chip.to_owned(), probe: probe.clone() }),
    }
}

fn to_drive(image: &Image, wanted: &Wanted, seen: &Seen, uf2: &str) -> Result<Plan, String> {
    let name = &image.name;
    if let Some(drive) = &wanted.drive {
        if drive.join(DRIVE_FILE).is_file() {
            return Ok(Plan::Copy(drive.clone()));
        }
        return Err(format!(
            "{} has no {DRIVE_FILE}, so it is not the drive of a boot ROM; give the folder where {DRIVE} is mounted",
            drive.display()
        ));
    }
    match (&seen.drives[..], &seen.unmounted[..]) {
        ([drive], _) => Ok(Plan::Copy(drive.clone())),
        ([_, _, ..], _) => {
            let drives: Vec<_> = seen.drives.iter().map(|drive| drive.display().to_string()).collect();
            Err(format!("there are {} drives {DRIVE}; choose with `--drive`: {}", drives.len(), drives.join(", ")))
        }
        ([], [device, ..]) => Err(format!(
            "{DRIVE} is plugged in as {device} and not mounted; mount it (`udisksctl mount -b {device}`) and run \
             `cargo xtask flash {name}` again"
        )),
        ([], []) => Err(format!(
            "no drive {DRIVE} is mounted; hold the button BOOTSEL while you plug in the Pico, then run \
             `cargo xtask flash {name}` again, or copy {uf2} to the drive that appears"
        )),
    }
}

/// Looks at what is attached. Nothing is changed.
fn look() -> Seen {
    let probes = Program::new("probe-rs").args(["list"]).ask().map(|said| probes_in(&said));
    let (mounted, unmounted) = lsblk();
    let mut drives: Vec<PathBuf> = MOUNTS.iter().flat_map(|&(folder, depth)| below(Path::new(folder), depth)).collect();
    drives.extend(('D'..='Z').filter(|_| cfg!(windows)).map(|letter| PathBuf::from(format!("{letter}:\\"))));
    drives.extend(mounted);
    drives.retain(|drive| is_boot_drive(drive));
    drives.sort_unstable();
    drives.dedup();
    Seen { probes, drives, unmounted }
}

/// The probes in what `probe-rs list` says: lines that begin with a number in brackets.
fn probes_in(said: &str) -> Vec<String> {
    let probe = |line: &str| line.trim().strip_prefix('[')?.split_once("]: ").map(|(_, probe)| probe.to_owned());
    said.lines().filter_map(probe).collect()
}

/// Whether a folder is the drive of an RP2040's boot ROM, by the file that it shows.
fn is_boot_drive(folder: &Path) -> bool {
    fs::read_to_string(folder.join(DRIVE_FILE)).is_ok_and(|text| text.contains(DRIVE))
}

/// Folders that lie `depth` below `folder`.
fn below(folder: &Path, depth: usize) -> Vec<PathBuf> {
    let mut found = vec![folder.to_owned()];
    for _ in 0..depth {
        let inner = found.iter().filter_map(|folder| fs::read_dir(folder).ok());
        found = inner.flatten().flatten().map(|entry| entry.path()).collect();
    }
    found
}

/// What `lsblk` lists.
#[derive(Deserialize)]
struct Devices {
    blockdevices: Vec<Device>,
}

#[derive(Deserialize)]
struct Device {
    path: String,
    label: Option<String>,
    mountpoint: Option<PathBuf>,
}

/// Where drives of boot ROMs are mounted, and devices of those that are not.
fn lsblk() -> (Vec<PathBuf>, Vec<String>) {
    let said = Program::new("lsblk").args(["--json", "--list", "--output", "PATH,LABEL,MOUNTPOINT"]).ask();
    said.map_or_else(Default::default, |said| boot_devices(&said))
}

fn boot_devices(said: &str) -> (Vec<PathBuf>, Vec<String>) {
    let devices = serde_json::from_str::<Devices>(said).map(|list| list.blockdevices).unwrap_or_default();
    let (mut mounted, mut unmounted) = (Vec::new(), Vec::new());
    for device in devices.into_iter().filter(|device| device.label.as_deref() == Some(DRIVE)) {
        match device.mountpoint {
            Some(place) => mounted.push(place),
            None => unmounted.push(device.path),
        }
    }
    (mounted, unmounted)
}

/// Copies the file. The chip starts with the last block, and the drive goes away before the system has heard that all was
/// written: an error counts only while the drive is still there.
fn copy(uf2: &Path, drive: &Path) -> Result<(), Error> {
    let path = drive.join(uf2.file_name().unwrap_or_default());
    let copied = fs::copy(uf2, &path).and_then(|_| File::open(&path)?.sync_all());
    match copied {
        Err(source) if is_boot_drive(drive) => Err(Error::File { what: "write", path, source }),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(load: Load) -> Image {
        let (name, package) = ("pico".to_owned(), "image-pico".to_owned());
        Image {
            name,
            package,
            target: "t".to_owned(),
            load,
            features: std::collections::BTreeMap::new(),
            variants: Vec::new(),
        }
    }

    fn said(load: Load, wanted: &Wanted, seen: &Seen) -> String {
        decide(&image(load), wanted, seen, Path::new("target/images/pico.uf2")).unwrap_err()
    }

    fn uf2() -> Load {
        Load::Uf2 { chip: "RP2040".to_owned() }
    }

    fn probe() -> Load {
        Load::Probe { chip: "STM32H743ZITx".to_owned() }
    }

    fn with_probes(probes: &[&str]) -> Seen {
        Seen { probes: Some(probes.iter().map(|&probe| probe.to_owned()).collect()), ..Seen::default() }
    }

    #[test]
    fn an_image_of_an_emulator_is_flashed_nowhere() {
        let why = said(Load::Emulator, &Wanted::default(), &with_probes(&["a"]));
        assert!(why.contains("runs in an emulator") && why.contains("`cargo xtask hil`"), "{why}");
    }

    #[test]
    fn without_probe_rs_or_a_probe_the_next_step_is_told() {
        let none = Wanted::default();
        let why = said(probe(), &none, &Seen::default());
        assert!(why.contains("cargo install probe-rs-tools") && why.ends_with("and run this again"), "{why}");
        let why = said(probe(), &none, &with_probes(&[]));
        assert!(why.starts_with("probe-rs sees no debug probe; plug in"), "{why}");
    }

    #[test]
    fn one_probe_is_taken_and_among_several_one_has_to_be_chosen() {
        let (none, chip) = (Wanted::default(), "STM32H743ZITx".to_owned());
        let plan = |wanted: &Wanted, seen: &Seen| decide(&image(probe()), wanted, seen, Path::new(""));
        assert_eq!(plan(&none, &with_probes(&["a"])), Ok(Plan::Probe { chip: chip.clone(), probe: None }));
        let two = with_probes(&["a -- 0483:374e:1", "b -- 0483:374e:2"]);
        let why = said(probe(), &none, &two);
        assert!(why.contains("there are 2 debug probes:\n  a --") && why.contains("--probe"), "{why}");
        let chosen = Wanted { probe: Some("0483:374e:2".to_owned()), ..Wanted::default() };
        assert_eq!(plan(&chosen, &two), Ok(Plan::Probe { chip, probe: chosen.probe.clone() }));
    }

    #[test]
    fn a_pico_takes_the_drive_that_is_there_and_else_is_told_how_to_get_one() {
        let none = Wanted::default();
        let drives = |drives: &[&str]| Seen { drives: drives.iter().map(PathBuf::from).collect(), ..Seen::default() };
        let plan = decide(&image(uf2()), &none, &drives(&["/media/me/RPI-RP2"]), Path::new("a.uf2"));
        assert_eq!(plan, Ok(Plan::Copy("/media/me/RPI-RP2".into())));
        let why = said(uf2(), &none, &drives(&["/media/a", "/media/b"]));
        assert!(why.contains("choose with `--drive`: /media/a, /media/b"), "{why}");
        let why = said(uf2(), &none, &Seen { unmounted: vec!["/dev/sdb1".to_owned()], ..Seen::default() });
        assert!(why.contains("udisksctl mount -b /dev/sdb1"), "{why}");
        let why = said(uf2(), &none, &Seen::default());
        assert!(why.contains("BOOTSEL") && why.contains("copy target/images/pico.uf2"), "{why}");
    }

    #[test]
    fn a_pico_goes_through_a_probe_only_where_one_is_named() {
        let seen = with_probes(&["a"]);
        assert!(said(uf2(), &Wanted::default(), &seen).contains("BOOTSEL"));
        let wanted = Wanted { probe: Some("2e8a:000c".to_owned()), ..Wanted::default() };
        let plan = decide(&image(uf2()), &wanted, &seen, Path::new(""));
        assert_eq!(plan, Ok(Plan::Probe { chip: "RP2040".to_owned(), probe: wanted.probe.clone() }));
    }

    #[test]
    fn a_drive_is_known_by_its_file_and_the_image_is_copied_to_it() {
        let folder = tempfile::tempdir().unwrap();
        let drive = folder.path().join("drive");
        fs::create_dir(&drive).unwrap();
        let wanted = Wanted { drive: Some(drive.clone()), ..Wanted::default() };
        assert!(said(uf2(), &wanted, &Seen::default()).contains("has no INFO_UF2.TXT"));
        assert!(!is_boot_drive(&drive));
        fs::write(drive.join(DRIVE_FILE), "UF2 Bootloader v3.0\nModel: Raspberry Pi RP2\nBoard-ID: RPI-RP2\n").unwrap();
        assert!(is_boot_drive(&drive) && below(folder.path(), 1) == std::slice::from_ref(&drive));
        assert_eq!(decide(&image(uf2()), &wanted, &Seen::default(), Path::new("")), Ok(Plan::Copy(drive.clone())));
        let file = folder.path().join("pico.uf2");
        fs::write(&file, "blocks").unwrap();
        copy(&file, &drive).unwrap();
        assert_eq!(fs::read(drive.join("pico.uf2")).unwrap(), b"blocks");
    }

    #[test]
    fn what_the_tools_list_is_read() {
        let list = "The following debug probes were found:\n[0]: STLink V3 -- 0483:374e:0001 (ST-LINK)\n\
                    [1]: Debug Probe (CMSIS-DAP) -- 2e8a:000c:E6 (CMSIS-DAP)\n";
        assert_eq!(probes_in(list)[1], "Debug Probe (CMSIS-DAP) -- 2e8a:000c:E6 (CMSIS-DAP)");
        assert_eq!(probes_in("No debug probes were found.\n"), [""; 0]);
        let list = r#"{"blockdevices": [{"path":"/dev/sda1","label":"root","mountpoint":"/"},
            {"path":"/dev/sdb1","label":"RPI-RP2","mountpoint":"/media/me/RPI-RP2"},
            {"path":"/dev/sdc1","label":"RPI-RP2","mountpoint":null},{"path":"/dev/sdd","label":null,"mountpoint":null}]}"#;
        assert_eq!(boot_devices(list), (vec!["/media/me/RPI-RP2".into()], vec!["/dev/sdc1".to_owned()]));
        assert_eq!(boot_devices("lsblk: not found"), (Vec::new(), Vec::new()));
    }
}

//! Where the images, the server and the `osap` program are, as `cargo xtask hil` builds them.
//!
//! - **Invariant:** what is missing is told with the command that makes it.

use std::path::{Path, PathBuf};
use std::process::Command;

/// An image that emulators run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Image {
    /// RP2040, co-simulated.
    Rp2040Pico,
    /// The same whose first axis is a motor that closes its loop by a simulated encoder.
    Rp2040PicoServo,
    /// The same that steps at 125 kHz.
    Rp2040PicoFast,
    /// The same that measures itself at its start.
    Rp2040PicoEvaluate,
    /// Cortex-M7 in QEMU.
    Mps2An500,
}

impl Image {
    /// Its name: folder below `rtic-firmware/`, and file.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rp2040Pico => "rp2040-pico",
            Self::Rp2040PicoServo => "rp2040-pico+servo",
            Self::Rp2040PicoFast => "rp2040-pico+fast",
            Self::Rp2040PicoEvaluate => "rp2040-pico+evaluate",
            Self::Mps2An500 => "mps2-an500",
        }
    }

    const fn target(self) -> &'static str {
        match self {
            Self::Rp2040Pico | Self::Rp2040PicoServo | Self::Rp2040PicoFast | Self::Rp2040PicoEvaluate => {
                "thumbv6m-none-eabi"
            }
            Self::Mps2An500 => "thumbv7em-none-eabihf",
        }
    }
}

/// Something that a scenario needs is not here.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what} is not at {}: {mend}", path.display())]
pub struct Missing {
    /// What.
    pub what: String,
    /// Where it was looked for.
    pub path: PathBuf,
    /// How it comes there.
    pub mend: String,
}

/// Folders of a run.
#[derive(Clone, Debug)]
pub struct Places {
    root: PathBuf,
    images: Option<PathBuf>,
}

impl Places {
    /// The repository this was built from. Images are looked for in `images`, or where Cargo puts them.
    #[must_use]
    pub fn new(images: Option<PathBuf>) -> Self {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).unwrap_or(Path::new("."));
        Self { root: root.to_owned(), images }
    }

    /// A file of the repository.
    #[must_use]
    pub fn file(&self, path: &str) -> PathBuf {
        self.root.join(path)
    }

    /// Where an image's file is.
    ///
    /// # Errors
    /// [`Missing`].
    pub fn image(&self, image: Image) -> Result<PathBuf, Missing> {
        let path = match &self.images {
            Some(folder) => folder.join(image.name()),
            None => self.root.join("target").join(image.target()).join("image").join(image.name()),
        };
        let mend = "`cargo xtask hil` builds what it runs; or name its folder with --images".to_owned();
        present(path, format!("the image {}", image.name()), mend)
    }

    /// The co-simulation's server.
    #[must_use]
    pub fn server(&self) -> PathBuf {
        self.root.join("tests/hil/rp2040/src/server.mjs")
    }

    /// The program `osap`, beside this one; Cargo builds it where Cargo runs this, so that it is never an old one.
    ///
    /// # Errors
    /// [`Missing`].
    pub fn osap(&self) -> Result<PathBuf, Missing> {
        if let Some(cargo) = std::env::var_os("CARGO") {
            let build = Command::new(cargo)
                .args(["build", "--quiet", "--release", "-p", "osap"])
                .current_dir(&self.root)
                .status();
            let is_built = build.is_ok_and(|status| status.success());
            if !is_built {
                eprintln!("hil: the program osap was not built: an older one is taken, if there is one");
            }
        }
        let here = std::env::current_exe().unwrap_or_default();
        let path = here.with_file_name(format!("osap{}", std::env::consts::EXE_SUFFIX));
        let mend = "build it with `cargo build --release -p osap`".to_owned();
        present(path, "the program osap".to_owned(), mend)
    }
}

fn present(path: PathBuf, what: String, mend: String) -> Result<PathBuf, Missing> {
    if path.is_file() { Ok(path) } else { Err(Missing { what, path, mend }) }
}

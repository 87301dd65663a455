//! The images: which there are, what each says of itself in its manifest, and how one is built.
//!
//! An image is a member of the workspace directly below `rtic-firmware/` that is not the library `app`. What this driver
//! has to know of its chip stands in its own manifest, so that a new board changes nothing here:
//!
//! ```toml
//! [package.metadata.image]
//! target = "thumbv7em-none-eabihf"    # what the compiler calls the processor
//! load = "probe"                      # "probe", "uf2" (a drive over USB) or "emulator"
//! chip = "STM32H743ZITx"              # probe-rs's name of the chip; none for an emulator
//! variants = ["servo"]                # features that emulators also run it with, one at a time; none where left out
//! ```

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::run::{Error, Program, root};
use crate::toolchain::{self, Toolchain};

/// Folder that images stand in, each in one of its own.
const FOLDER: &str = "rtic-firmware/";

/// The member of that folder which is a library.
const LIBRARY: &str = "rtic-firmware/app";

/// Name that stands for every image on the command line.
const ALL: &str = "all";

/// What the commands say about images that they cannot use.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ImageError {
    /// Cargo's description of the workspace could not be read.
    #[error("cannot read what `cargo metadata` says of the workspace: {0}; is this cargo older than 1.93?")]
    Metadata(#[from] serde_json::Error),
    /// There is no image of this name.
    #[error("there is no image `{name}`; {}", offer(known))]
    Unknown {
        /// What was asked for.
        name: String,
        /// What there is.
        known: Vec<String>,
    },
    /// The manifest of an image does not tell what is needed.
    #[error(
        "{FOLDER}{name}/Cargo.toml: the table `[package.metadata.image]` is missing or wrong: {source}; it needs `target`, \
         `load` (\"probe\", \"uf2\" or \"emulator\") and, but for an emulator, `chip`"
    )]
    Table {
        /// The image.
        name: String,
        /// What is wrong.
        source: serde_json::Error,
    },
    /// The image cannot be compared with the bare one.
    #[error(
        "{FOLDER}{name}/Cargo.toml: `default` in `[features]` has no `node`; `size` builds the image without it, with it \
         alone, and with each further default feature"
    )]
    NoNode {
        /// The image.
        name: String,
    },
    /// The package is not called after its folder.
    #[error("{FOLDER}{name}/Cargo.toml: the package is called `{package}`; call it `image-{name}`")]
    Name {
        /// The folder.
        name: String,
        /// The package.
        package: String,
    },
}

fn offer(known: &[String]) -> String {
    if known.is_empty() {
        return format!("the root Cargo.toml lists no image below {FOLDER} yet");
    }
    format!("there are {} and `{ALL}`", known.join(", "))
}

/// How an image comes onto its device.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(tag = "load", rename_all = "kebab-case")]
pub(crate) enum Load {
    /// Through a debug probe, by probe-rs.
    Probe {
        /// probe-rs's name of the chip.
        chip: String,
    },
    /// Copied as a UF2 file to the drive that the chip's boot ROM shows; or through a probe.
    Uf2 {
        /// probe-rs's name of the chip.
        chip: String,
    },
    /// Not at all: it runs in an emulator.
    Emulator,
}

/// One image.
#[derive(Clone, Debug)]
pub(crate) struct Image {
    /// Its folder's name, which is its binary's name too.
    pub(crate) name: String,
    /// The package.
    pub(crate) package: String,
    /// What the compiler calls the processor.
    pub(crate) target: String,
    /// How it comes onto its device.
    pub(crate) load: Load,
    /// The features of the package, each with what it turns on.
    pub(crate) features: BTreeMap<String, Vec<String>>,
    /// Features that emulators also run it with, one at a time, each in a file of its own: `NAME+FEATURE`.
    pub(crate) variants: Vec<String>,
}

/// Which features an image is built with.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Features {
    /// Leave out the default ones.
    pub(crate) no_default: bool,
    /// These on top.
    pub(crate) added: Vec<String>,
}

impl Features {
    /// Exactly these features.
    pub(crate) fn only(added: &[&str]) -> Self {
        Self { no_default: true, added: added.iter().map(|&feature| feature.to_owned()).collect() }
    }

    /// The default ones and this.
    pub(crate) fn with(feature: &str) -> Self {
        Self { no_default: false, added: vec![feature.to_owned()] }
    }

    fn arguments(&self) -> Vec<String> {
        let mut arguments = Vec::new();
        if self.no_default {
            arguments.push("--no-default-features".to_owned());
        }
        if !self.added.is_empty() {
            arguments.extend(["--features".to_owned(), self.added.join(",")]);
        }
        arguments
    }
}

/// All images of the workspace, and where Cargo puts what it builds.
#[derive(Clone, Debug)]
pub(crate) struct Images {
    list: Vec<Image>,
    target_folder: PathBuf,
    members: Vec<String>,
}

/// The part of `cargo metadata` that is used.
#[derive(Deserialize)]
struct Metadata {
    packages: Vec<Package>,
    workspace_root: PathBuf,
    target_directory: PathBuf,
}

#[derive(Deserialize)]
struct Package {
    name: String,
    manifest_path: PathBuf,
    features: BTreeMap<String, Vec<String>>,
    metadata: Option<serde_json::Value>,
}

/// The table of an image's manifest.
#[derive(Deserialize)]
struct Table {
    target: String,
    #[serde(flatten)]
    load: Load,
    #[serde(default)]
    variants: Vec<String>,
}

impl Images {
    /// Asks Cargo which images there are.
    pub(crate) fn read() -> Result<Self, Error> {
        let text = Program::cargo("metadata --no-deps --format-version 1").quiet().capture()?;
        Ok(Self::parse(&text)?)
    }

    fn parse(metadata: &str) -> Result<Self, ImageError> {
        let metadata: Metadata = serde_json::from_str(metadata)?;
        let members = metadata.packages.iter().map(|package| package.name.clone()).collect();
        let mut list = Vec::new();
        for package in metadata.packages {
            let manifest = package.manifest_path.strip_prefix(&metadata.workspace_root);
            let folder = manifest.ok().and_then(Path::parent).map(|folder| folder.to_string_lossy().replace('\\', "/"));
            let Some(folder) = folder.filter(|folder| folder != LIBRARY) else { continue };
            let Some(name) = folder.strip_prefix(FOLDER).filter(|name| !name.contains('/')) else { continue };
            list.push(Image::new(name, package)?);
        }
        list.sort_by(|one, other| one.name.cmp(&other.name));
        Ok(Self { list, target_folder: metadata.target_directory, members })
    }

    /// The images that `name` means: one, or all.
    pub(crate) fn named(&self, name: &str) -> Result<Vec<&Image>, ImageError> {
        let found: Vec<_> = self.list.iter().filter(|image| name == ALL || image.name == name).collect();
        if found.is_empty() {
            let known = self.list.iter().map(|image| image.name.clone()).collect();
            return Err(ImageError::Unknown { name: name.to_owned(), known });
        }
        Ok(found)
    }

    /// All of them; none before the first board is written.
    pub(crate) fn all(&self) -> &[Image] {
        &self.list
    }

    /// Whether the workspace has a package of this name, image or not.
    pub(crate) fn has_member(&self, name: &str) -> bool {
        self.members.iter().any(|member| member == name)
    }

    /// Where the ELF of `image` is once it was built.
    pub(crate) fn elf(&self, image: &Image) -> PathBuf {
        self.target_folder.join(&image.target).join("image").join(&image.name)
    }

    /// Where files made of images are put.
    pub(crate) fn made_folder(&self) -> PathBuf {
        self.target_folder.join("images")
    }

    /// Builds one image, in a call of Cargo of its own so that what one chip wants never reaches another.
    pub(crate) fn build(&self, image: &Image, features: &Features) -> Result<PathBuf, Error> {
        let cargo = image.toolchain()?.cargo("build --profile image");
        cargo.args(["--package", &image.package, "--target", &image.target]).args(features.arguments()).run()?;
        Ok(self.elf(image))
    }

    /// Builds one image as it is, and its variants in files beside it.
    pub(crate) fn build_with_variants(&self, image: &Image) -> Result<(), Error> {
        for feature in &image.variants {
            let built = self.build(image, &Features::with(feature))?;
            let kept = built.with_file_name(format!("{}+{feature}", image.name));
            std::fs::copy(&built, &kept).map_err(|source| Error::File { what: "write", path: kept, source })?;
        }
        // last, so that the file of the image's own name is the image as it is
        self.build(image, &Features::default()).map(|_| ())
    }
}

impl Image {
    fn new(name: &str, package: Package) -> Result<Self, ImageError> {
        let name = name.to_owned();
        if package.name != format!("image-{name}") {
            return Err(ImageError::Name { name, package: package.name });
        }
        let table = package.metadata.and_then(|mut metadata| metadata.get_mut("image").map(serde_json::Value::take));
        let table = serde_json::from_value(table.unwrap_or_default());
        let Table { target, load, variants } =
            table.map_err(|source| ImageError::Table { name: name.clone(), source })?;
        Ok(Self { name, package: package.name, target, load, features: package.features, variants })
    }

    /// Clippy on this image with what it uses of ours, as it is and bare, warnings denied.
    pub(crate) fn lint(&self) -> Result<(), Error> {
        let variants = self.variants.iter().map(|feature| Features::with(feature));
        for features in [Features::default(), Features::only(&[])].into_iter().chain(variants) {
            let cargo = self.toolchain()?.cargo("clippy --profile image");
            let cargo = cargo.args(["--package", &self.package, "--target", &self.target]).args(features.arguments());
            cargo.args(["--", "-D", "warnings"]).run()?;
        }
        Ok(())
    }

    fn toolchain(&self) -> Result<Toolchain, Error> {
        let what = format!("build for {}", self.target);
        toolchain::provide(&self.target).map_err(|why| Error::NotRunHere { what, why })
    }
}

/// `cargo xtask build`: builds and says on standard output where the result is, one path a line.
pub(crate) fn build(name: &str, features: &Features) -> Result<(), Error> {
    let images = Images::read()?;
    for image in images.named(name)? {
        println!("{}", shown(&images.build(image, features)?));
    }
    Ok(())
}

/// A path as short as it can be said in the root of the repository.
pub(crate) fn shown(path: &Path) -> String {
    path.strip_prefix(root()).unwrap_or(path).display().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What Cargo says of a workspace with one member in each of `folders`, called `name` and with `table` as metadata.
    fn metadata(members: &[(&str, &str, &str)]) -> String {
        let package = |(folder, name, table): &(&str, &str, &str)| {
            format!(
                r#"{{"name":"{name}","manifest_path":"/r/{folder}/Cargo.toml","features":{{"default":["node"],"node":[]}},
                     "metadata":{table},"version":"0.1.0"}}"#
            )
        };
        let packages = members.iter().map(package).collect::<Vec<_>>().join(",");
        format!(r#"{{"packages":[{packages}],"workspace_root":"/r","target_directory":"/r/target","version":1}}"#)
    }

    const PICO: (&str, &str, &str) = (
        "rtic-firmware/rp2040-pico",
        "image-rp2040-pico",
        r#"{"image":{"target":"thumbv6m-none-eabi","load":"uf2","chip":"RP2040"}}"#,
    );
    const EMULATED: (&str, &str, &str) = (
        "rtic-firmware/mps2-an500",
        "image-mps2-an500",
        r#"{"image":{"target":"thumbv7em-none-eabihf","load":"emulator"}}"#,
    );

    #[test]
    fn members_below_the_folder_are_images_and_the_library_is_none() {
        let others =
            [("rtic-firmware/app", "firmware-app", "null"), ("boards/rp2040-pico", "board-rp2040-pico", "null")];
        let images = Images::parse(&metadata(&[&others[..], &[PICO, EMULATED]].concat())).unwrap();
        let names: Vec<_> = images.named(ALL).unwrap().iter().map(|image| image.name.clone()).collect();
        assert_eq!(names, ["mps2-an500", "rp2040-pico"]);
        assert!(images.has_member("firmware-app") && !images.has_member("osap-hil"));
        let pico = images.named("rp2040-pico").unwrap()[0];
        assert_eq!((&pico.package[..], &pico.target[..]), ("image-rp2040-pico", "thumbv6m-none-eabi"));
        assert_eq!(pico.load, Load::Uf2 { chip: "RP2040".to_owned() });
        assert_eq!(pico.features["default"], ["node"]);
        assert_eq!(images.elf(pico), Path::new("/r/target/thumbv6m-none-eabi/image/rp2040-pico"));
    }

    #[test]
    fn an_image_that_does_not_exist_is_told_with_those_that_do() {
        let images = Images::parse(&metadata(&[EMULATED, PICO])).unwrap();
        let said = images.named("pico").unwrap_err().to_string();
        assert_eq!(said, "there is no image `pico`; there are mps2-an500, rp2040-pico and `all`");
        let none = Images::parse(&metadata(&[])).unwrap();
        assert!(none.named(ALL).unwrap_err().to_string().contains("lists no image below rtic-firmware/ yet"));
    }

    #[test]
    fn a_manifest_that_tells_too_little_is_named_with_what_it_needs() {
        for (table, expected) in [
            ("null", "invalid type: null"),
            (r#"{"image":{"load":"emulator"}}"#, "missing field `target`"),
            (r#"{"image":{"target":"t","load":"probe"}}"#, "missing field `chip`"),
            (r#"{"image":{"target":"t","load":"magic"}}"#, "unknown variant `magic`"),
        ] {
            let said = Images::parse(&metadata(&[(PICO.0, PICO.1, table)])).unwrap_err().to_string();
            assert!(said.starts_with("rtic-firmware/rp2040-pico/Cargo.toml: the table"), "{said}");
            assert!(said.contains(expected), "{table}: {said}");
        }
        let said = Images::parse(&metadata(&[(PICO.0, "pico", PICO.2)])).unwrap_err().to_string();
        assert!(said.ends_with("the package is called `pico`; call it `image-rp2040-pico`"), "{said}");
    }

    #[test]
    fn features_become_the_arguments_that_cargo_knows() {
        assert_eq!(Features::default().arguments(), [""; 0]);
        assert_eq!(Features::only(&[]).arguments(), ["--no-default-features"]);
        assert_eq!(Features::only(&["node", "usb"]).arguments(), ["--no-default-features", "--features", "node,usb"]);
        let added = Features { no_default: false, added: vec!["trace".to_owned()] };
        assert_eq!(added.arguments(), ["--features", "trace"]);
    }
}

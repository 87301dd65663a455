//! What an image takes of its device's flash and RAM, what each of its features adds, and how that stands to the goals.
//!
//! All figures are read from ELFs that were built for it. Flash is all that is kept there: vectors, code, constants, and what
//! is copied to RAM at start. RAM is statics; the stack takes what is left and is not in it. Buffers, which are as large as
//! somebody wants them, are told apart by their names: a static that is called a buffer, such as `RX_BUFFER` or RTIC's
//! `rx_buffers`, or a section with `.buffers`.
//! Code that is copied to RAM counts once, as code.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs;
use std::path::Path;

use serde::Serialize;

use crate::elf::{Layout, Section, Symbol};
use crate::images::{Features, Image, ImageError, Images};
use crate::run::Error;

/// What is printed as JSON has this version; it changes with the meaning of a field.
const JSON_VERSION: u32 = 1;

/// What the bare image has to grow by at most: the node with all that an image has by default.
const FLASH_GOAL_BYTES: u64 = 15_000;

/// What statics may take at most, buffers left out.
const RAM_GOAL_BYTES: u64 = 4_000;

/// In the names of statics that are buffers, in capitals or not: those of RTIC's resources keep the case of their fields.
const BUFFER_NAME: &str = "buffer";

/// In the names of sections that hold nothing but buffers.
const BUFFER_SECTION: &str = ".buffers";

/// The section of code that is copied to RAM.
const RAM_CODE_SECTION: &str = ".ram_text";

/// The feature that makes a bare image a node.
const NODE: &str = "node";

/// What one build takes.
#[expect(clippy::struct_field_names, reason = "units stand last in names")]
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
struct Sizes {
    /// Kept in flash.
    flash_bytes: u64,
    /// Statics in RAM, without buffers and code.
    ram_bytes: u64,
    /// Buffers in RAM.
    buffer_bytes: u64,
    /// Code that is copied to RAM, which is in `flash_bytes` too.
    ram_code_bytes: u64,
}

/// A static, or a whole section, that is counted as a buffer.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
struct Buffer {
    bytes: u64,
    name: String,
}

/// A function or static of the image with all its features.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
struct Largest {
    bytes: u64,
    /// `code`, `static` in RAM, or `constant` in flash.
    kind: &'static str,
    name: String,
}

/// One build of an image and what it takes.
#[derive(Clone, Debug, Serialize)]
struct Row {
    /// `all`, `bare`, the node, or the feature that was added to it.
    build: String,
    #[serde(flatten)]
    sizes: Sizes,
}

/// One image with all its builds.
#[derive(Clone, Debug, Serialize)]
struct Sized {
    image: String,
    target: String,
    builds: Vec<Row>,
    /// Buffers of the image with all its features, largest first.
    buffers: Vec<Buffer>,
    goals: Vec<Goal>,
    /// What takes most of the image with all its features: code first, then statics, then constants.
    largest: Vec<Largest>,
}

/// A figure and what it should be at most.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
struct Goal {
    what: String,
    bytes: i64,
    limit_bytes: u64,
    met: bool,
}

#[derive(Serialize)]
struct Document<'a> {
    version: u32,
    images: &'a [Sized],
}

/// `cargo xtask size`: builds every variant of the images that `name` means, and prints a table for each or one document, with
/// the `largest_count` largest functions and as many statics and constants.
pub(crate) fn size(name: &str, is_json: bool, largest_count: usize) -> Result<(), Error> {
    let images = Images::read()?;
    let named = images.named(name)?.into_iter();
    let sized = named.map(|image| measure(&images, image, largest_count)).collect::<Result<Vec<_>, _>>()?;
    if is_json {
        let document = serde_json::to_string_pretty(&Document { version: JSON_VERSION, images: &sized });
        println!("{}", document.map_err(ImageError::from)?);
    } else {
        for one in &sized {
            println!("{}", table(one));
        }
    }
    Ok(())
}

fn measure(images: &Images, image: &Image, largest_count: usize) -> Result<Sized, Error> {
    let (mut builds, mut buffers, mut largest) = (Vec::new(), Vec::new(), Vec::new());
    for (build, features) in builds_of(image)? {
        let layout = read(&images.build(image, &features)?)?;
        let (sizes, found) = sizes(&layout);
        builds.push(Row { build, sizes });
        buffers = found;
        largest = largest_of(layout, largest_count);
    }
    let goals = goals(&builds);
    Ok(Sized { image: image.name.clone(), target: image.target.clone(), builds, buffers, goals, largest })
}

/// The `count` largest functions, then as many statics and constants.
fn largest_of(layout: Layout, count: usize) -> Vec<Largest> {
    let Layout { sections, mut symbols, .. } = layout;
    let mut seen = BTreeSet::new();
    symbols.retain(|symbol| seen.insert(symbol.address));
    symbols.sort_by_key(|symbol| std::cmp::Reverse(symbol.bytes));
    let is_constant = |address| {
        let section = sections.iter().find(|section| section.contains(address));
        section.is_some_and(|section| section.kept_at == Some(section.address))
    };
    let kind = |symbol: &Symbol| match symbol.is_function {
        true => "code",
        false if is_constant(symbol.address) => "constant",
        false => "static",
    };
    let of = |wanted: &'static str| {
        let symbols = symbols.iter().filter(|symbol| kind(symbol) == wanted).take(count);
        symbols.map(|symbol| Largest { bytes: symbol.bytes, kind: wanted, name: symbol.name.clone() }).collect()
    };
    let lists: [Vec<_>; 3] = ["code", "static", "constant"].map(of);
    lists.into_iter().flatten().collect()
}

/// Reads the ELF at `path`.
pub(crate) fn read(path: &Path) -> Result<Layout, Error> {
    let file = fs::read(path).map_err(|source| Error::File { what: "read", path: path.to_owned(), source })?;
    Layout::parse(&file).map_err(|source| Error::Elf { path: path.to_owned(), source })
}

/// The builds of `image`, with all its features last, so that this is what is left where Cargo puts it. An image that is
/// always a node has this one only.
fn builds_of(image: &Image) -> Result<Vec<(String, Features)>, ImageError> {
    let all = ("all".to_owned(), Features::default());
    if !image.features.contains_key(NODE) {
        return Ok(vec![all]);
    }
    let default = image.features.get("default").map_or(&[][..], Vec::as_slice);
    if !default.iter().any(|feature| feature == NODE) {
        return Err(ImageError::NoNode { name: image.name.clone() });
    }
    let mut builds = vec![("bare".to_owned(), Features::only(&[])), (NODE.to_owned(), Features::only(&[NODE]))];
    // What is of another crate (`crate/feature`) has no row of its own: it is no feature of the image.
    for feature in default.iter().filter(|&feature| feature != NODE && image.features.contains_key(feature)) {
        builds.push((format!("{NODE} + {feature}"), Features::only(&[NODE, feature])));
    }
    builds.push(all);
    Ok(builds)
}

/// What a build takes, and its buffers, largest first.
fn sizes(layout: &Layout) -> (Sizes, Vec<Buffer>) {
    let (mut sizes, mut buffers) = (Sizes::default(), Vec::new());
    for section in &layout.sections {
        if section.kept_at.is_some() {
            sizes.flash_bytes += section.bytes;
        }
        if section.kept_at == Some(section.address) {
            continue;
        }
        let code = code_bytes(section, layout);
        let found = if code == section.bytes { Vec::new() } else { buffers_in(section, layout) };
        let buffer: u64 = found.iter().map(|buffer| buffer.bytes).sum();
        sizes.ram_code_bytes += code;
        sizes.buffer_bytes += buffer;
        sizes.ram_bytes += section.bytes.saturating_sub(code + buffer);
        buffers.extend(found);
    }
    buffers.sort_unstable_by(|one, other| other.cmp(one));
    (sizes, buffers)
}

/// How much of a section in RAM is code: all where it can only be code, else the functions that were put among its data.
fn code_bytes(section: &Section, layout: &Layout) -> u64 {
    if section.kept_at.is_none() {
        return 0;
    }
    let is_only_code = section.is_code && !section.is_writable;
    if is_only_code || section.name.starts_with(RAM_CODE_SECTION) {
        return section.bytes;
    }
    within(section, layout, true).map(|symbol| symbol.bytes).sum()
}

fn buffers_in(section: &Section, layout: &Layout) -> Vec<Buffer> {
    if section.name.contains(BUFFER_SECTION) {
        return vec![Buffer { bytes: section.bytes, name: section.name.clone() }];
    }
    let named = within(section, layout, false).filter(|symbol| is_buffer(&symbol.name));
    named.map(|symbol| Buffer { bytes: symbol.bytes, name: symbol.name.clone() }).collect()
}

/// Whether a static is called a buffer itself, whatever the modules around it are called.
fn is_buffer(path: &str) -> bool {
    let name = path.rsplit("::").next().unwrap_or(path);
    name.to_ascii_lowercase().contains(BUFFER_NAME)
}

/// Functions or statics in a section, each once however many names it has.
fn within<'a>(section: &'a Section, layout: &'a Layout, is_function: bool) -> impl Iterator<Item = &'a Symbol> {
    let mut seen = BTreeSet::new();
    let symbols = layout.symbols.iter().filter(move |symbol| symbol.is_function == is_function);
    symbols.filter(move |symbol| section.contains(symbol.address) && seen.insert(symbol.address))
}

/// How the node alone, and the image with all its features, stand to the goals.
fn goals(builds: &[Row]) -> Vec<Goal> {
    let sizes = |name: &str| builds.iter().find(|row| row.build == name).map(|row| &row.sizes);
    let Some(bare) = sizes("bare") else { return Vec::new() };
    let mut goals = Vec::new();
    for name in [NODE, "all"] {
        let Some(sizes) = sizes(name) else { continue };
        let flash = difference(sizes.flash_bytes, bare.flash_bytes);
        goals.push(Goal::new(format!("flash of `{name}` over `bare`"), flash, FLASH_GOAL_BYTES));
        let ram = difference(sizes.ram_bytes, 0);
        goals.push(Goal::new(format!("RAM of `{name}` without buffers"), ram, RAM_GOAL_BYTES));
    }
    goals
}

impl Goal {
    fn new(what: String, bytes: i64, limit_bytes: u64) -> Self {
        let met = u64::try_from(bytes).is_ok_and(|bytes| bytes <= limit_bytes) || bytes < 0;
        Self { what, bytes, limit_bytes, met }
    }
}

/// `one − other`. Both are sizes of memories of 32-bit processors, so the difference has room.
fn difference(one: u64, other: u64) -> i64 {
    one.cast_signed() - other.cast_signed()
}

/// The table of one image, its buffers and its goals. Differences are to the node alone, where it was built.
fn table(sized: &Sized) -> String {
    let node = sized.builds.iter().find(|row| row.build == NODE).map(|row| &row.sizes);
    let against =
        |own: u64, other: Option<u64>| other.map_or(String::new(), |other| format!("{:+}", difference(own, other)));
    let width = sized.builds.iter().map(|row| row.build.chars().count()).max().unwrap_or(0);
    let mut text = format!("{} ({}), bytes\n", sized.image, sized.target);
    // Writing to a string cannot fail.
    let head = ("flash", "± node", "RAM", "± node", "buffers", "RAM code");
    let _ = writeln!(
        text,
        "{:width$} {:>9} {:>8} {:>9} {:>8} {:>9} {:>9}",
        "", head.0, head.1, head.2, head.3, head.4, head.5
    );
    for Row { build, sizes } in &sized.builds {
        let flash = against(sizes.flash_bytes, node.map(|node| node.flash_bytes));
        let ram = against(sizes.ram_bytes, node.map(|node| node.ram_bytes));
        let _ = writeln!(
            text,
            "{build:width$} {:>9} {flash:>8} {:>9} {ram:>8} {:>9} {:>9}",
            sizes.flash_bytes, sizes.ram_bytes, sizes.buffer_bytes, sizes.ram_code_bytes
        );
    }
    for Buffer { name, bytes } in &sized.buffers {
        let _ = writeln!(text, "buffer {bytes:>7}  {name}");
    }
    for Largest { bytes, kind, name } in &sized.largest {
        let _ = writeln!(text, "{kind:8} {bytes:>5}  {name}");
    }
    if sized.goals.is_empty() {
        let _ = writeln!(text, "no goal: the image has no feature `{NODE}` that could be left out to compare");
    }
    for Goal { what, bytes, limit_bytes, met } in &sized.goals {
        let met = if *met { "met" } else { "missed" };
        let _ = writeln!(text, "goal {met:6}  {what}: {bytes} of {limit_bytes}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::elf::Symbol;
    use crate::images::Load;

    const FLASH: u64 = 0x1000_0000;
    const RAM: u64 = 0x2000_0000;

    fn section(name: &str, address: u64, bytes: u64, kept_at: Option<u64>, flags: &str) -> Section {
        let (is_code, is_writable) = (flags.contains('x'), flags.contains('w'));
        Section { name: name.to_owned(), address, bytes, kept_at, is_code, is_writable }
    }

    fn symbol(name: &str, address: u64, bytes: u64, is_function: bool) -> Symbol {
        Symbol { name: name.to_owned(), address, bytes, is_function }
    }

    /// 100 B of code, 40 B of data of which 12 B are a function, 30 B zeroed of which 20 B are a buffer, 8 B left alone.
    fn layout() -> Layout {
        Layout {
            sections: vec![
                section(".text", FLASH, 100, Some(FLASH), "x"),
                section(".data", RAM, 40, Some(FLASH + 100), "wx"),
                section(".bss", RAM + 40, 30, None, "w"),
                section(".uninit", RAM + 70, 8, None, "w"),
            ],
            symbols: vec![
                symbol("app::in_flash", FLASH + 8, 50, true),
                symbol("app::hot", RAM + 4, 12, true),
                symbol("app::hot_by_another_name", RAM + 4, 12, true),
                symbol("app::RX_BUFFER", RAM + 40, 20, false),
                symbol("app::COUNT", RAM + 60, 4, false),
                symbol("buffer::TABLE", FLASH + 60, 16, false),
            ],
            segments: Vec::new(),
        }
    }

    #[test]
    fn flash_ram_buffers_and_code_are_told_apart() {
        let (sizes, buffers) = sizes(&layout());
        // flash: 100 + 40. RAM: 40 − 12 of data, 30 − 20 zeroed, 8 left alone.
        let expected = Sizes { flash_bytes: 140, ram_bytes: 28 + 10 + 8, buffer_bytes: 20, ram_code_bytes: 12 };
        assert_eq!(sizes, expected);
        assert_eq!(buffers, [Buffer { bytes: 20, name: "app::RX_BUFFER".to_owned() }]);
    }

    #[test]
    fn a_buffer_is_what_is_called_one_in_any_case_and_not_what_lies_in_a_module_of_that_name() {
        assert!(is_buffer("board::uart::RX_BYTE_BUFFER") && is_buffer("app::__rtic_internal_local_init_uart_buffers"));
        assert!(!is_buffer("buffer::COUNT") && !is_buffer("app::NODE"));
    }

    #[test]
    fn sections_of_buffers_and_of_code_in_ram_count_whole() {
        let mut layout = layout();
        layout.sections.push(section(".uninit.buffers", RAM + 100, 64, None, "w"));
        layout.sections.push(section(".ram_text", RAM + 200, 24, Some(FLASH + 200), "wx"));
        layout.sections.push(section(".fast", RAM + 300, 16, Some(FLASH + 300), "x"));
        let (sizes, buffers) = sizes(&layout);
        let expected = Sizes { flash_bytes: 140 + 24 + 16, ram_bytes: 46, buffer_bytes: 84, ram_code_bytes: 12 + 40 };
        assert_eq!(sizes, expected);
        assert_eq!(buffers[0], Buffer { bytes: 64, name: ".uninit.buffers".to_owned() });
    }

    #[test]
    fn an_image_that_is_always_a_node_has_one_row_and_no_goals() {
        let always = Image { features: std::collections::BTreeMap::new(), ..image(&[]) };
        assert_eq!(builds_of(&always).unwrap(), [("all".to_owned(), Features::default())]);
        let builds = vec![rows(0, 3500, 200).remove(2)];
        let (image, target, goals) = ("a".to_owned(), "t".to_owned(), goals(&builds));
        let expected = "a (t), bytes
        flash   ± node       RAM   ± node   buffers  RAM code
all      3500                201                  0         0
no goal: the image has no feature `node` that could be left out to compare
";
        let sized = Sized { image, target, builds, buffers: Vec::new(), goals, largest: Vec::new() };
        assert_eq!(table(&sized), expected);
    }

    fn image(default: &[&str]) -> Image {
        let own = |name: &str| (name.to_owned(), Vec::new());
        let mut features: std::collections::BTreeMap<_, _> = ["node", "usb", "debug"].map(own).into();
        features.insert("default".to_owned(), default.iter().map(|&name| name.to_owned()).collect());
        let (name, package) = ("a".to_owned(), "image-a".to_owned());
        Image { name, package, target: "t".to_owned(), load: Load::Emulator, features, variants: Vec::new() }
    }

    #[test]
    fn each_default_feature_is_added_to_the_node_alone_and_all_come_last() {
        let builds = builds_of(&image(&["usb", "node", "firmware-app/trace", "debug"])).unwrap();
        let expected = [
            ("bare", Features::only(&[])),
            ("node", Features::only(&["node"])),
            ("node + usb", Features::only(&["node", "usb"])),
            ("node + debug", Features::only(&["node", "debug"])),
            ("all", Features::default()),
        ];
        assert_eq!(builds, expected.map(|(name, features)| (name.to_owned(), features)));
        let said = builds_of(&image(&["usb"])).unwrap_err().to_string();
        assert!(said.starts_with("rtic-firmware/a/Cargo.toml:") && said.contains("`node`"), "{said}");
    }

    #[test]
    fn the_largest_come_first_and_two_names_of_one_are_one() {
        let found = largest_of(layout(), 9);
        let names: Vec<_> = found.iter().map(|largest| (largest.kind, &largest.name[..])).collect();
        assert_eq!(
            names,
            [
                ("code", "app::in_flash"),
                ("code", "app::hot"),
                ("static", "app::RX_BUFFER"),
                ("static", "app::COUNT"),
                ("constant", "buffer::TABLE"),
            ]
        );
    }

    fn rows(node: u64, all: u64, ram: u64) -> Vec<Row> {
        let row = |build: &str, flash_bytes, ram_bytes| Row {
            build: build.to_owned(),
            sizes: Sizes { flash_bytes, ram_bytes, ..Sizes::default() },
        };
        vec![row("bare", 1000, 10), row("node", node, ram), row("all", all, ram + 1)]
    }

    #[test]
    fn a_goal_is_met_up_to_its_last_byte_and_missed_by_one_more() {
        let found = goals(&rows(16_000, 16_001, 4_000));
        let met: Vec<_> = found.iter().map(|goal| (goal.bytes, goal.met)).collect();
        assert_eq!(met, [(15_000, true), (4_000, true), (15_001, false), (4_001, false)]);
        // a node that takes less than the bare image meets its goal too
        assert!(goals(&rows(900, 900, 0))[0].met);
    }

    #[test]
    fn the_table_has_a_row_for_each_build_with_its_difference_to_the_node() {
        let builds = rows(3000, 3500, 200);
        let goals = goals(&builds);
        let buffers = vec![Buffer { bytes: 2048, name: "app::POOL_BUFFER".to_owned() }];
        let largest = largest_of(layout(), 1);
        let sized = Sized { image: "a".to_owned(), target: "t".to_owned(), builds, buffers, goals, largest };
        let expected = "a (t), bytes
         flash   ± node       RAM   ± node   buffers  RAM code
bare      1000    -2000        10     -190         0         0
node      3000       +0       200       +0         0         0
all       3500     +500       201       +1         0         0
buffer    2048  app::POOL_BUFFER
code        50  app::in_flash
static      20  app::RX_BUFFER
constant    16  buffer::TABLE
goal met     flash of `node` over `bare`: 2000 of 15000
goal met     RAM of `node` without buffers: 200 of 4000
goal met     flash of `all` over `bare`: 2500 of 15000
goal met     RAM of `all` without buffers: 201 of 4000
";
        assert_eq!(table(&sized), expected);
        let document = serde_json::to_value(Document { version: JSON_VERSION, images: &[sized] }).unwrap();
        assert_eq!(document["images"][0]["builds"][2]["flash_bytes"], 3500);
        assert_eq!(document["images"][0]["buffers"][0]["bytes"], 2048);
    }
}

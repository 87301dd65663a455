//! Writes the sample paths of `osap maxl error` into a folder: `cargo run -p osap --example paths -- FOLDER [EVERY_US [SEED]]`.
#![forbid(unsafe_code)]

use osap::motion::paths::Shape;
use std::path::Path;

/// Period of rows where none is given, µs: a sixteenth of the shortest interval.
const EVERY_US: u32 = 16;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder =
        arguments.next().ok_or("which folder? `cargo run -p osap --example paths -- FOLDER [EVERY_US [SEED]]`")?;
    let every_us = arguments.next().map_or(Ok(EVERY_US), |text| text.parse())?;
    let seed = arguments.next().map_or(Ok(1), |text| text.parse())?;
    std::fs::create_dir_all(&folder)?;
    for shape in Shape::ALL {
        let file = Path::new(&folder).join(format!("{}.csv", shape.name()));
        std::fs::write(&file, shape.rows(seed, every_us))?;
        println!("{}", file.display());
    }
    Ok(())
}

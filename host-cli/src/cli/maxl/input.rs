//! Files of numbers for `osap maxl`, and what is wrong with them told with a next step.

use crate::cli::{CliError, Exit};
use crate::motion::curve::CurveError;
use crate::motion::path::PathError;
use crate::motion::points::PointsError;
use crate::motion::table::{Table, TableError};
use fixed_math::spline::{INTERVAL_LOG2_MAX, INTERVAL_LOG2_MIN, IntervalLog2};
use std::io::Read;
use std::path::Path;

/// What a file or pipe has in it.
pub(super) fn table(file: &Path) -> Result<Table, CliError> {
    if file == Path::new("-") {
        return read(std::io::stdin().lock(), &place(file));
    }
    let opened = std::fs::File::open(file).map_err(|error| CliError::file(file, "read the numbers", &error))?;
    read(opened, &place(file))
}

fn read(source: impl Read, place: &str) -> Result<Table, CliError> {
    Table::read(source).map_err(|error| {
        let next = match &error {
            TableError::Read(_) => "choose a file that can be read, or `-` for standard input",
            TableError::Format { .. } => "save it as CSV in UTF-8",
            TableError::NoNumber { text, .. } if text.contains(';') || text.contains('\t') => {
                "separate columns by commas, with a point in decimal numbers"
            }
            TableError::NoNumber { .. } => {
                "write a number such as -1.25 there; names may stand in the first row alone, comments behind `#`"
            }
            TableError::NotFinite { .. } => "mend what made the file: a machine can only be somewhere",
            TableError::Ragged { .. } => "give each row a number for every axis",
            TableError::Name { .. } => "give every column a name of its own, or leave out the row of names",
            TableError::Empty => "give one row for each point, one column for each axis",
        };
        CliError::new(Exit::Io, error.to_string(), place, next)
    })
}

/// A file by its name, or standard input.
pub(super) fn place(file: &Path) -> String {
    if file == Path::new("-") { "standard input".to_owned() } else { file.display().to_string() }
}

/// An interval of a device, µs.
pub(super) fn parse_interval(text: &str) -> Result<IntervalLog2, String> {
    let us: u32 = text.parse().map_err(|_| format!("expected a number of µs, such as 1024, not {text:?}"))?;
    let log2 = us.checked_ilog2().unwrap_or(0);
    if let Some(interval) = IntervalLog2::new(log2).filter(|interval| interval.us() == us) {
        return Ok(interval);
    }
    let below = log2.clamp(INTERVAL_LOG2_MIN, INTERVAL_LOG2_MAX);
    let above = (log2 + 1).clamp(INTERVAL_LOG2_MIN, INTERVAL_LOG2_MAX);
    let nearest = if below == above {
        format!("the nearest is {}", 1 << below)
    } else {
        format!("the nearest are {} and {}", 1 << below, 1 << above)
    };
    Err(format!("a device's interval is a power of two from 256 to 16384 µs; {nearest}"))
}

/// A list of points that is none.
pub(super) fn no_points(file: &Path, error: &PointsError) -> CliError {
    let next = match error {
        PointsError::NoAxis => "add a column of positions for each axis".to_owned(),
        PointsError::OffGrid { interval_us, .. } => {
            format!("begin at a multiple of {interval_us} µs, or leave the column of times out")
        }
        PointsError::Gap { .. } => {
            "give the interval that the points were made for, and each point once; without a column of times they follow each other"
                .to_owned()
        }
        PointsError::OutOfRange { .. } => "take a coarser step by --lsb, or positions nearer to 0".to_owned(),
    };
    CliError::new(Exit::Io, error.to_string(), place(file), next)
}

/// Points that a device would not play; `at` names row and column of one of `axis`.
pub(super) fn no_curve(file: &Path, error: &CurveError, at: impl Fn(usize, usize) -> String) -> CliError {
    match error {
        CurveError::TooFew { .. } => {
            let next = "add points, or leave out `--ends open`";
            CliError::new(Exit::Io, error.to_string(), place(file), next)
        }
        CurveError::TooFar { axis, point, distance } => {
            let most = fixed_math::spline::DIFFERENCE_MAX;
            let what = format!(
                "{}: {} LSB from the point before it, more than the {most} that a device plays",
                at(*axis, point + 1),
                distance.unsigned_abs()
            );
            let next = "take a coarser step by --lsb, or points that are closer in time";
            CliError::new(Exit::Io, what, place(file), next)
        }
    }
}

/// A time series that is none.
pub(super) fn no_path(file: &Path, error: &PathError) -> CliError {
    let next = match error {
        PathError::NoTime { .. } => "name the columns in the first row, such as `time_us,x,y`",
        PathError::NoAxis => "add a column of positions for each axis",
        PathError::TooShort { .. } => "give the path at two times or more",
        PathError::TimeStands { .. } => "sort the rows by time, and give each time once",
        PathError::TooLong { .. } => "give a part of it: a path may take a day",
    };
    CliError::new(Exit::Io, error.to_string(), place(file), next)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interval_is_one_of_seven_or_the_nearest_are_told() {
        for us in [256, 512, 1024, 2048, 4096, 8192, 16_384] {
            assert_eq!(parse_interval(&us.to_string()).map(IntervalLog2::us), Ok(us));
        }
        for (text, nearest) in [
            ("3000", "the nearest are 2048 and 4096"),
            ("0", "the nearest is 256"),
            ("255", "the nearest is 256"),
            ("257", "the nearest are 256 and 512"),
            ("16383", "the nearest are 8192 and 16384"),
            ("4294967295", "the nearest is 16384"),
            ("1ms", "not \"1ms\""),
        ] {
            let error = parse_interval(text).unwrap_err();
            assert!(error.ends_with(nearest), "{text}: {error}");
        }
    }

    #[test]
    fn standard_input_is_named_as_such() {
        let error = read("1;2\n3;4\n".as_bytes(), &place(Path::new("-"))).unwrap_err().to_string();
        assert!(error.contains("standard input") && error.contains("by commas"), "{error}");
    }
}

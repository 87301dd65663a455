//! Control points as a file has them, in units, made into those that a device is sent: whole LSB at multiples of an interval.
//!
//! - **Walk:** file → [`Table`] → [`Points::from_table`] → [`Curve`](super::curve::Curve).
//! - **Invariants:** every point fits 32 bits and is the nearest to what the file says; times, where the file has them, are the
//!   interval's own grid without a gap.
//!
//! ```
//! use fixed_math::spline::IntervalLog2;
//! use osap::motion::{points::{Lsb, Points}, table::Table};
//! let table = Table::read("x\n0\n0.5\n".as_bytes()).unwrap();
//! let points = Points::from_table(&table, IntervalLog2::new(10).unwrap(), Lsb::DEFAULT).unwrap();
//! assert_eq!(points.axes(), [[0, 32_768]]);
//! ```

use super::table::Table;
use fixed_math::spline::IntervalLog2;
use std::fmt;
use std::str::FromStr;

/// The unit of a track's positions, in the units of a file: what one step of a 32-bit position means.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct Lsb(f64);

impl Lsb {
    /// 2^-16 of a unit: at millimetres 15 nm, over a range of ±32 m.
    pub const DEFAULT: Self = Self(1.0 / 65_536.0);

    /// A step of `units`; `None` where it is not a number above zero.
    #[must_use]
    pub fn new(units: f64) -> Option<Self> {
        (units.is_finite() && units > 0.0).then_some(Self(units))
    }

    /// The step, units.
    #[must_use]
    pub const fn units(self) -> f64 {
        self.0
    }

    /// The nearest whole number of steps; `None` where 32 bits do not hold it.
    #[must_use]
    pub fn steps(self, units: f64) -> Option<i32> {
        let steps = (units / self.0).round();
        let fits = (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&steps);
        #[expect(clippy::cast_possible_truncation, reason = "it is whole and within 32 bits")]
        fits.then_some(steps as i32)
    }
}

/// `2^-16`, `1/256` or a number.
impl FromStr for Lsb {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |part: &str| part.trim().parse::<f64>().ok();
        let value = match (text.split_once('^'), text.split_once('/')) {
            (Some((base, power)), _) => number(base).zip(number(power)).map(|(base, power)| base.powf(power)),
            (None, Some((over, under))) => number(over).zip(number(under)).map(|(over, under)| over / under),
            (None, None) => number(text),
        };
        let wanted = || format!("expected a step above zero, such as 2^-16, 1/256 or 0.001, not {text:?}");
        value.and_then(Self::new).ok_or_else(wanted)
    }
}

/// As a power of two where it is one.
impl fmt::Display for Lsb {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let log2 = self.0.log2();
        if log2.fract() == 0.0 && log2 != 0.0 { write!(f, "2^{log2}") } else { write!(f, "{}", self.0) }
    }
}

/// Points of one or more axes at one interval.
#[derive(Clone, Debug, PartialEq)]
pub struct Points {
    names: Vec<String>,
    interval: IntervalLog2,
    lsb: Lsb,
    start_us: Option<u64>,
    /// Line of the file for each point.
    lines: Vec<u64>,
    /// Number of the first axis's column, from 1.
    first_column: usize,
    axes: Vec<Vec<i32>>,
}

/// Why a table is no list of control points.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PointsError {
    /// There is a time and nothing else.
    #[error("there is no axis beside the time")]
    NoAxis,
    /// A time is no multiple of the interval, or negative.
    #[error("row {line}, column 1: {time_us} µs is no multiple of the interval, {interval_us} µs")]
    OffGrid {
        /// Line of the file.
        line: u64,
        /// The time.
        time_us: f64,
        /// The interval.
        interval_us: u32,
    },
    /// A point is missing, or there twice.
    #[error("row {line}, column 1: the time is {time_us} µs where the row before it asks for {expected_us} µs")]
    Gap {
        /// Line of the file.
        line: u64,
        /// The time.
        time_us: f64,
        /// One interval after the row before.
        expected_us: f64,
    },
    /// A position takes more than 32 bits.
    #[error("row {line}, column {column}: {value} is more than 2^31 steps of {lsb}")]
    OutOfRange {
        /// Line of the file.
        line: u64,
        /// From 1.
        column: usize,
        /// The position, units.
        value: f64,
        /// The step.
        lsb: Lsb,
    },
}

impl Points {
    /// Points of a table: every column is an axis, but for a first one named `time_us` or `time_s`.
    ///
    /// # Errors
    /// Where times are not those of the interval, or a position does not fit.
    pub fn from_table(table: &Table, interval: IntervalLog2, lsb: Lsb) -> Result<Self, PointsError> {
        let time_scale_us = table.time_scale_us();
        let first_axis = usize::from(time_scale_us.is_some());
        if table.columns() <= first_axis {
            return Err(PointsError::NoAxis);
        }
        let start_us = time_scale_us.map(|scale| start_us(table, scale, interval)).transpose()?;
        let axis = |column: usize| {
            let point = |row: &super::table::Row| {
                let (line, value) = (row.line, row.values[column]);
                lsb.steps(value).ok_or(PointsError::OutOfRange { line, column: column + 1, value, lsb })
            };
            table.rows().iter().map(point).collect::<Result<Vec<i32>, PointsError>>()
        };
        Ok(Self {
            names: table.axis_names(first_axis),
            interval,
            lsb,
            start_us,
            lines: table.rows().iter().map(|row| row.line).collect(),
            first_column: first_axis + 1,
            axes: (first_axis..table.columns()).map(axis).collect::<Result<_, _>>()?,
        })
    }

    /// Names of the axes.
    #[must_use]
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Time between two points.
    #[must_use]
    pub const fn interval(&self) -> IntervalLog2 {
        self.interval
    }

    /// What the numbers of [`Points::axes`] count.
    #[must_use]
    pub const fn lsb(&self) -> Lsb {
        self.lsb
    }

    /// Time of the first point, µs, where the file has times.
    #[must_use]
    pub const fn start_us(&self) -> Option<u64> {
        self.start_us
    }

    /// For each axis its points, LSB.
    #[must_use]
    pub fn axes(&self) -> &[Vec<i32>] {
        &self.axes
    }

    /// Line of the file that a point stood on.
    #[must_use]
    pub fn line(&self, point: usize) -> u64 {
        self.lines.get(point).copied().unwrap_or(0)
    }

    /// Column of the file that an axis stood in, from 1.
    #[must_use]
    pub const fn column(&self, axis: usize) -> usize {
        self.first_column + axis
    }
}

/// Time of the first point, all others being where they have to be.
fn start_us(table: &Table, scale_us: f64, interval: IntervalLog2) -> Result<u64, PointsError> {
    let h = f64::from(interval.us());
    // Seconds with a point in them do not meet a microsecond exactly: what is nearer than a thousandth of one is meant to.
    let whole = |row: &super::table::Row| {
        let us = row.values[0] * scale_us;
        if (us - us.round()).abs() < 1e-3 { us.round() } else { us }
    };
    let rows = table.rows();
    let first = whole(&rows[0]);
    // below 2^53 µs, 285 years, every whole number is itself
    if first < 0.0 || first % h != 0.0 || first > 2f64.powi(53) {
        return Err(PointsError::OffGrid { line: rows[0].line, time_us: first, interval_us: interval.us() });
    }
    for pair in rows.windows(2) {
        let (expected_us, time_us) = (whole(&pair[0]) + h, whole(&pair[1]));
        // both are whole where they are meant to be: see above
        if (time_us - expected_us).abs() > 0.0 {
            return Err(PointsError::Gap { line: pair[1].line, time_us, expected_us });
        }
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "whole, not negative, below 2^53")]
    Ok(first as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(text: &str) -> Result<Points, PointsError> {
        let table = Table::read(text.as_bytes()).unwrap();
        Points::from_table(&table, IntervalLog2::new(10).unwrap(), Lsb::DEFAULT)
    }

    #[test]
    fn steps_are_given_as_powers_fractions_and_numbers() {
        for (text, units, shown) in [
            ("2^-16", 1.0 / 65_536.0, "2^-16"),
            ("1/256", 1.0 / 256.0, "2^-8"),
            ("0.001", 0.001, "0.001"),
            ("1", 1.0, "1"),
            ("4", 4.0, "2^2"),
        ] {
            let lsb: Lsb = text.parse().unwrap();
            assert_eq!((lsb.units(), lsb.to_string().as_str()), (units, shown));
        }
        for wrong in ["", "0", "-1", "2^", "nan", "1/0", "mm", "2^9999"] {
            assert!(wrong.parse::<Lsb>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn positions_are_the_nearest_steps_and_times_the_grid() {
        let read = points("time_us,x,y\n2048,1,-0.00001\n3072,-1,0.00001\n").unwrap();
        assert_eq!((read.start_us(), read.names()), (Some(2048), &["x".to_owned(), "y".to_owned()][..]));
        // 0.00001 · 65536 = 0.655
        assert_eq!(read.axes(), [[65_536, -65_536], [-1, 1]]);
        assert_eq!((read.line(1), read.column(1)), (3, 3));
        assert_eq!(points("time_s,x\n0.002048,1\n0.003072,2\n").unwrap().start_us(), Some(2048));
        assert_eq!(points("1,2\n").unwrap().start_us(), None);
    }

    #[test]
    fn what_cannot_be_a_point_is_told_with_its_row_and_column() {
        for (text, expected) in [
            ("time_us,x\n1000,1\n", "row 2, column 1: 1000 µs is no multiple of the interval, 1024 µs"),
            ("time_us,x\n-1024,1\n", "row 2, column 1: -1024 µs is no multiple of the interval, 1024 µs"),
            (
                "time_us,x\n0,1\n2048,1\n",
                "row 3, column 1: the time is 2048 µs where the row before it asks for 1024 µs",
            ),
            ("x,y\n0,0\n0,32768\n", "row 3, column 2: 32768 is more than 2^31 steps of 2^-16"),
            ("time_us\n0\n", "there is no axis beside the time"),
        ] {
            assert_eq!(points(text).unwrap_err().to_string(), expected, "{text:?}");
        }
        // the ends of 32 bits themselves
        let ends = points("-32768\n32767.9999847\n").unwrap();
        assert_eq!(ends.axes(), [[i32::MIN, i32::MAX]]);
    }
}

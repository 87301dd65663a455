//! A path as a time series: what a control point is taken from, and what a spline is compared with.
//!
//! - **Walk:** file → [`Table`] → [`Path`] → [`Path::position`] by [`fit`](super::fit), [`Path::bends`] by [`bound`](super::bound).
//! - **Invariants:** time grows from row to row. Between two rows the path is a straight line run through at constant speed; before
//!   its first row and after its last it stands still. So it is a polyline of time, and all that bends it are its rows.
//!
//! ```
//! use osap::motion::{path::Path, table::Table};
//! let table = Table::read("time_us,x\n5000,0\n6000,10\n".as_bytes()).unwrap();
//! let path = Path::from_table(&table).unwrap();
//! assert_eq!((path.start_us(), path.duration_us()), (5000.0, 1000.0));
//! assert_eq!(path.position(0, 250.0, &mut 0), 2.5);
//! ```

use super::table::{Row, Table};

/// Microseconds in a second.
const US_PER_S: f64 = 1e6;

/// Longest path, µs: a day, within which an `f64` keeps nanoseconds and a `u64` of µs is far from its end.
const DURATION_MAX_US: f64 = 86_400.0 * US_PER_S;

/// One or more axes over time.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    names: Vec<String>,
    start_us: f64,
    /// Since the first row.
    times_us: Vec<f64>,
    /// For each axis a position at each time.
    axes: Vec<Vec<f64>>,
}

/// What bends a polyline at one of its rows: the change of velocity there, over the time that the row stands for.
#[derive(Clone, Debug, PartialEq)]
pub struct Bend {
    /// Since the first row, µs.
    pub at_us: f64,
    /// To the row before, µs; infinite for the first.
    pub before_us: f64,
    /// To the row after, µs; infinite for the last.
    pub after_us: f64,
    /// Change of velocity of each axis, units/s.
    pub velocity_change_per_s: Vec<f64>,
}

/// Why a table is no path.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PathError {
    /// Nothing says what the first column is.
    #[error("the first column has to be named time_us or time_s, it is {found}")]
    NoTime {
        /// Its name in quotes, or that there is none.
        found: String,
    },
    /// There is a time and nothing else.
    #[error("there is no axis beside the time")]
    NoAxis,
    /// One row is no path.
    #[error("a path has at least two rows, this has {found}")]
    TooShort {
        /// How many rows.
        found: usize,
    },
    /// A time is not after the one before it.
    #[error("row {line}, column 1: the time {time} is not after {before}, the one before it")]
    TimeStands {
        /// Line of the file.
        line: u64,
        /// The time.
        time: f64,
        /// The time before it.
        before: f64,
    },
    /// It takes longer than a day.
    #[error("row {line}, column 1: {time} is over a day after the first row")]
    TooLong {
        /// Line of the file.
        line: u64,
        /// The time.
        time: f64,
    },
}

impl Path {
    /// A path from a table whose first column is named `time_us` or `time_s`; every other column is an axis.
    ///
    /// # Errors
    /// Where that is not what the table is.
    pub fn from_table(table: &Table) -> Result<Self, PathError> {
        let Some(scale) = table.time_scale_us() else {
            let found = table.head().map_or_else(|| "without a name".to_owned(), |head| format!("{:?}", head[0]));
            return Err(PathError::NoTime { found });
        };
        let rows = table.rows();
        if table.columns() < 2 {
            return Err(PathError::NoAxis);
        }
        if rows.len() < 2 {
            return Err(PathError::TooShort { found: rows.len() });
        }
        let start = rows[0].values[0];
        let after = |pair: &[Row]| {
            let (before, time, line) = (pair[0].values[0], pair[1].values[0], pair[1].line);
            match () {
                () if time <= before => Err(PathError::TimeStands { line, time, before }),
                () if (time - start) * scale > DURATION_MAX_US => Err(PathError::TooLong { line, time }),
                () => Ok((time - start) * scale),
            }
        };
        let later: Result<Vec<f64>, PathError> = rows.windows(2).map(after).collect();
        let times_us = std::iter::once(0.0).chain(later?).collect();
        let positions = |column: usize| rows.iter().map(|row| row.values[column]).collect();
        let axes = (1..table.columns()).map(positions).collect();
        Ok(Self { names: table.axis_names(1), start_us: start * scale, times_us, axes })
    }

    /// Names of the axes.
    #[must_use]
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Time of the first row as the file has it, µs. All other times count from it.
    #[must_use]
    pub const fn start_us(&self) -> f64 {
        self.start_us
    }

    /// From the first row to the last, µs.
    #[must_use]
    pub fn duration_us(&self) -> f64 {
        self.times_us.last().copied().unwrap_or(0.0)
    }

    /// How many rows, at least two.
    #[must_use]
    pub fn len(&self) -> usize {
        self.times_us.len()
    }

    /// Never: there are two rows or more.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.times_us.is_empty()
    }

    /// Where `axis` is at `at_us` after the first row. `cursor` is where the last look found its row, 0 for the first: looks that go
    /// forward in time are cheap.
    ///
    /// # Panics
    /// Where there is no such axis.
    #[must_use]
    pub fn position(&self, axis: usize, at_us: f64, cursor: &mut usize) -> f64 {
        let (times, values) = (&self.times_us, &self.axes[axis]);
        let row = self.row_before(at_us, cursor);
        let (Some(&before), Some(&after)) = (times.get(row), times.get(row + 1)) else {
            return values[times.len() - 1];
        };
        if at_us <= before {
            return values[row];
        }
        values[row] + (values[row + 1] - values[row]) * ((at_us - before) / (after - before))
    }

    /// The last row at or before a time, or the first one.
    fn row_before(&self, at_us: f64, cursor: &mut usize) -> usize {
        if *cursor >= self.times_us.len() || self.times_us[*cursor] > at_us {
            *cursor = self.times_us.partition_point(|&time| time <= at_us).saturating_sub(1);
        }
        while self.times_us.get(*cursor + 1).is_some_and(|&next| next <= at_us) {
            *cursor += 1;
        }
        *cursor
    }

    /// Velocity of `axis` from its first row on and up to its last, units/µs.
    ///
    /// # Panics
    /// Where there is no such axis.
    #[must_use]
    pub fn end_slopes(&self, axis: usize) -> [f64; 2] {
        let (times, values) = (&self.times_us, &self.axes[axis]);
        [0, times.len() - 2].map(|row| (values[row + 1] - values[row]) / (times[row + 1] - times[row]))
    }

    /// Where the velocity changes. With `rests` it is zero before the first row and after the last, so that these two count as well.
    #[must_use]
    pub fn bends(&self, rests: bool) -> Vec<Bend> {
        let last = self.times_us.len() - 1;
        let rows = if rests { 0..=last } else { 1..=last - 1 };
        let bend = |row: usize| {
            let gap = |to: usize| (self.times_us[to + 1] - self.times_us[to]) / US_PER_S;
            let slope = |axis: &[f64], to: usize| (axis[to + 1] - axis[to]) / gap(to);
            let change = |axis: &Vec<f64>| {
                let before = if row == 0 { 0.0 } else { slope(axis, row - 1) };
                let after = if row == last { 0.0 } else { slope(axis, row) };
                after - before
            };
            Bend {
                at_us: self.times_us[row],
                before_us: if row == 0 { f64::INFINITY } else { gap(row - 1) * US_PER_S },
                after_us: if row == last { f64::INFINITY } else { gap(row) * US_PER_S },
                velocity_change_per_s: self.axes.iter().map(change).collect(),
            }
        };
        rows.map(bend).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(text: &str) -> Result<Path, PathError> {
        Path::from_table(&Table::read(text.as_bytes()).unwrap())
    }

    #[test]
    fn seconds_and_microseconds_are_the_same_path() {
        let us = path("time_us,x,y\n0,0,5\n500000,1,5\n1000000,0,6\n").unwrap();
        let s = path("time_s,x,y\n0,0,5\n0.5,1,5\n1,0,6\n").unwrap();
        assert_eq!(us, s);
        assert_eq!((us.names(), us.len()), (&["x".to_owned(), "y".to_owned()][..], 3));
    }

    #[test]
    fn it_is_straight_between_rows_and_stands_outside_of_them() {
        let path = path("time_us,x\n0,1\n100,3\n300,-1\n").unwrap();
        let mut cursor = 0;
        let expected = [(-50.0, 1.0), (0.0, 1.0), (50.0, 2.0), (100.0, 3.0), (200.0, 1.0), (300.0, -1.0), (1e9, -1.0)];
        for (at_us, position) in expected {
            // exact: halves and quarters of small numbers
            assert!((path.position(0, at_us, &mut cursor) - position).abs() < f64::EPSILON, "{at_us}");
        }
        // backwards as well
        for (at_us, position) in expected.into_iter().rev() {
            // exact: halves and quarters of small numbers
            assert!((path.position(0, at_us, &mut cursor) - position).abs() < f64::EPSILON, "{at_us}");
        }
    }

    #[test]
    fn bends_are_changes_of_velocity() {
        let path = path("time_s,x\n0,0\n1,2\n3,0\n").unwrap();
        let changes = |rests| path.bends(rests).iter().map(|it| it.velocity_change_per_s[0]).collect::<Vec<_>>();
        assert_eq!(changes(true), [2.0, -3.0, 1.0]);
        assert_eq!(changes(false), [-3.0]);
        let bend = &path.bends(false)[0];
        assert_eq!((bend.at_us, bend.before_us, bend.after_us), (1e6, 1e6, 2e6));
    }

    #[test]
    fn what_is_no_path_says_why() {
        for (text, expected) in [
            ("0,1\n1,2\n", "the first column has to be named time_us or time_s, it is without a name"),
            ("t,x\n1,2\n", "the first column has to be named time_us or time_s, it is \"t\""),
            ("time_us\n1\n2\n", "there is no axis beside the time"),
            ("time_us,x\n1,2\n", "a path has at least two rows, this has 1"),
            ("time_us,x\n1,2\n1,2\n", "row 3, column 1: the time 1 is not after 1, the one before it"),
            ("time_s,x\n0,2\n86401,2\n", "row 3, column 1: 86401 is over a day after the first row"),
        ] {
            assert_eq!(path(text).unwrap_err().to_string(), expected, "{text:?}");
        }
    }
}

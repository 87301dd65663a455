//! Numbers in columns, as a file of comma-separated values has them.
//!
//! - **Walk:** file or pipe → [`Table::read`] → [`Points`](super::points::Points) or [`Path`](super::path::Path).
//! - **Invariants:** every row has a number for every column, and each is finite. Rows keep the line they stood on, so that what is
//!   found wrong later is told where it is. A first row without any number is the head; lines that begin with `#` are comments.
//!
//! ```
//! use osap::motion::table::Table;
//! let table = Table::read("time_us,x\n0,1.5\n1024,2\n".as_bytes()).unwrap();
//! assert_eq!(table.head(), Some(&["time_us".to_owned(), "x".to_owned()][..]));
//! assert_eq!(table.rows()[1].values, [1024.0, 2.0]);
//! let error = Table::read("0,1\n2,x\n".as_bytes()).unwrap_err();
//! assert_eq!(error.to_string(), "row 2, column 2: \"x\" is no number");
//! ```

use csv::{ReaderBuilder, StringRecord, Trim};
use std::collections::BTreeSet;
use std::io::Read;

/// Names of the columns, and all rows.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    head: Option<Vec<String>>,
    rows: Vec<Row>,
}

/// One row.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Its line in the file, from 1, comments and empty lines counted.
    pub line: u64,
    /// A finite number for each column.
    pub values: Vec<f64>,
}

/// Why a file is no table of numbers.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// It could not be read.
    #[error("cannot read it: {0}")]
    Read(std::io::Error),
    /// It is no text of comma-separated values.
    #[error("row {line}: {what}")]
    Format {
        /// Line of the file.
        line: u64,
        /// What the reader said.
        what: String,
    },
    /// A cell is no number.
    #[error("row {line}, column {column}: {text:?} is no number")]
    NoNumber {
        /// Line of the file.
        line: u64,
        /// From 1.
        column: usize,
        /// What stands there.
        text: String,
    },
    /// A cell is infinite or not a number at all.
    #[error("row {line}, column {column}: {value} is not finite")]
    NotFinite {
        /// Line of the file.
        line: u64,
        /// From 1.
        column: usize,
        /// What stands there.
        value: f64,
    },
    /// A row is shorter or longer than the first one.
    #[error("row {line} has {found} columns, the rows before it have {expected}")]
    Ragged {
        /// Line of the file.
        line: u64,
        /// How many it has.
        found: usize,
        /// How many it should have.
        expected: usize,
    },
    /// A column's name is empty, or given twice.
    #[error("row {line}, column {column}: the name {name:?} is empty or there twice")]
    Name {
        /// Line of the file.
        line: u64,
        /// From 1.
        column: usize,
        /// The name.
        name: String,
    },
    /// There is no row of numbers.
    #[error("there is no row of numbers in it")]
    Empty,
}

impl Table {
    /// Reads all of `source`.
    ///
    /// # Errors
    /// Where it cannot be read, or where a row or cell is not as it should be: the first one that is not.
    pub fn read(mut source: impl Read) -> Result<Self, TableError> {
        let mut bytes = Vec::new();
        source.read_to_end(&mut bytes).map_err(TableError::Read)?;
        let lines = Lines::of(&bytes);
        let mut reader = ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .comment(Some(b'#'))
            .trim(Trim::All)
            .from_reader(&bytes[..]);
        let mut table = Self { head: None, rows: Vec::new() };
        let mut columns = None;
        for record in reader.records() {
            let record = record.map_err(|error| format_error(&error, &lines))?;
            let line = lines.number(record.position());
            let expected = *columns.get_or_insert(record.len());
            if record.len() != expected {
                return Err(TableError::Ragged { line, found: record.len(), expected });
            }
            let is_first = table.head.is_none() && table.rows.is_empty();
            if is_first && record.iter().all(|cell| cell.parse::<f64>().is_err()) {
                table.head = Some(names(&record, line)?);
            } else {
                table.rows.push(Row { line, values: numbers(&record, line)? });
            }
        }
        if table.rows.is_empty() { Err(TableError::Empty) } else { Ok(table) }
    }

    /// Names of the columns, where the file has them.
    #[must_use]
    pub fn head(&self) -> Option<&[String]> {
        self.head.as_deref()
    }

    /// All rows, at least one.
    #[must_use]
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// How many columns each row has.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.rows.first().map_or(0, |row| row.values.len())
    }

    /// Microseconds in a unit of the first column, where its name says that it is a time: `time_us` or `time_s`.
    #[must_use]
    pub fn time_scale_us(&self) -> Option<f64> {
        match self.head()?.first()?.as_str() {
            "time_us" => Some(1.0),
            "time_s" => Some(1e6),
            _ => None,
        }
    }

    /// Names of the columns from `first` on: those of the head, or `axis1`, `axis2`, ….
    #[must_use]
    pub fn axis_names(&self, first: usize) -> Vec<String> {
        match &self.head {
            Some(head) => head[first..].to_vec(),
            None => (1..=self.columns().saturating_sub(first)).map(|number| format!("axis{number}")).collect(),
        }
    }
}

/// Where lines begin, those left out that are empty or comments.
struct Lines {
    /// Byte at which a line with something in it begins, and its number.
    starts: Vec<(u64, u64)>,
}

impl Lines {
    fn of(bytes: &[u8]) -> Self {
        let mut at = 0;
        let mut starts = Vec::new();
        for (line, number) in bytes.split_inclusive(|&byte| byte == b'\n').zip(1..) {
            if !matches!(line, [] | [b'\r' | b'\n' | b'#', ..]) {
                starts.push((at, number));
            }
            at += line.len() as u64;
        }
        Self { starts }
    }

    /// The line of a record that was looked for from `position` on: the reader tells where it began to look.
    fn number(&self, position: Option<&csv::Position>) -> u64 {
        let byte = position.map_or(0, csv::Position::byte);
        // behind a `\r` it has not yet taken the `\n`, so what it looks at is the end of the line before
        let next = self.starts.partition_point(|&(start, _)| start < byte);
        self.starts.get(next).or(self.starts.last()).map_or(0, |&(_, number)| number)
    }
}

fn format_error(error: &csv::Error, lines: &Lines) -> TableError {
    let line = lines.number(error.position());
    match error.kind() {
        csv::ErrorKind::Utf8 { err, .. } => TableError::Format { line, what: err.to_string() },
        // none other is made of bytes in memory where rows may have any length
        _ => TableError::Format { line, what: error.to_string() },
    }
}

fn names(record: &StringRecord, line: u64) -> Result<Vec<String>, TableError> {
    let mut seen = BTreeSet::new();
    let mut check = |(at, name): (usize, &str)| {
        if name.is_empty() || !seen.insert(name.to_owned()) {
            return Err(TableError::Name { line, column: at + 1, name: name.to_owned() });
        }
        Ok(name.to_owned())
    };
    record.iter().enumerate().map(&mut check).collect()
}

fn numbers(record: &StringRecord, line: u64) -> Result<Vec<f64>, TableError> {
    let number = |(at, text): (usize, &str)| {
        let column = at + 1;
        let value: f64 = text.parse().map_err(|_| TableError::NoNumber { line, column, text: text.to_owned() })?;
        if value.is_finite() { Ok(value) } else { Err(TableError::NotFinite { line, column, value }) }
    };
    record.iter().enumerate().map(number).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(text: &str) -> String {
        Table::read(text.as_bytes()).unwrap_err().to_string()
    }

    #[test]
    fn comments_blanks_and_a_missing_head_are_no_trouble() {
        let table = Table::read("# made by hand\n\n 1 , -2.5e1\n3,4\n".as_bytes()).unwrap();
        assert_eq!((table.head(), table.columns()), (None, 2));
        assert_eq!(table.axis_names(0), ["axis1", "axis2"]);
        assert_eq!(table.rows(), [Row { line: 3, values: vec![1.0, -25.0] }, Row { line: 4, values: vec![3.0, 4.0] }]);
        let other = Table::read("\u{feff}x,y\r\n\r\n\"1\",2\r\n# none\r\n3,4".as_bytes()).unwrap();
        assert_eq!(other.axis_names(0), ["x", "y"]);
        assert_eq!(other.rows().iter().map(|row| row.line).collect::<Vec<_>>(), [3, 5]);
    }

    #[test]
    fn what_is_wrong_is_told_with_its_row_and_column() {
        for (text, expected) in [
            ("x,y\n1,2\n3\n", "row 3 has 1 columns, the rows before it have 2"),
            ("x,y\n1,2\n3,inf\n", "row 3, column 2: inf is not finite"),
            ("x,y\n1,NaN\n", "row 2, column 2: NaN is not finite"),
            ("x,1\n1,2\n", "row 1, column 1: \"x\" is no number"),
            ("x,x\n1,2\n", "row 1, column 2: the name \"x\" is empty or there twice"),
            ("x,\n1,2\n", "row 1, column 2: the name \"\" is empty or there twice"),
            ("1,\n", "row 1, column 2: \"\" is no number"),
            ("", "there is no row of numbers in it"),
            ("x,y\n", "there is no row of numbers in it"),
        ] {
            assert_eq!(told(text), expected, "{text:?}");
        }
    }

    #[test]
    fn bytes_that_are_no_text_are_told_with_their_row() {
        let error = Table::read(&b"1,2\n\xff,3\n"[..]).unwrap_err().to_string();
        assert!(error.starts_with("row 2: ") && error.contains("utf-8"), "{error}");
    }
}

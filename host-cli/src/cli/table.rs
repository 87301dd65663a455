//! Columns of text, as wide as what stands in them.
//!
//! ```
//! use osap::cli::table::{Align, Table};
//! let mut table = Table::new([("device", Align::Left), ("µs", Align::Right)]);
//! table.row(["bed", "7"]);
//! table.row(["hub-a", "350"]);
//! assert_eq!(table.plain(), "device   µs\nbed       7\nhub-a   350\n");
//! ```

use super::output::STRONG;
use std::fmt::{self, Write as _};

/// Where a cell stands in its column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Align {
    /// Words.
    Left,
    /// Numbers.
    Right,
}

/// Spaces between columns.
const GAP: usize = 2;

/// A table that draws itself with a bold head; see [`Table::plain`] for one without colour.
#[derive(Clone, Debug)]
pub struct Table {
    head: Vec<(String, Align)>,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// A table with its columns' heads and alignments.
    pub fn new<S: Into<String>>(head: impl IntoIterator<Item = (S, Align)>) -> Self {
        Self { head: head.into_iter().map(|(name, align)| (name.into(), align)).collect(), rows: Vec::new() }
    }

    /// Adds a row; what is missing is empty, what is too much is left out.
    pub fn row<S: Into<String>>(&mut self, cells: impl IntoIterator<Item = S>) {
        let mut cells: Vec<String> = cells.into_iter().map(Into::into).collect();
        cells.resize(self.head.len(), String::new());
        self.rows.push(cells);
    }

    /// Whether there is no row.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The table without colour.
    #[must_use]
    pub fn plain(&self) -> String {
        anstream::adapter::strip_str(&self.to_string()).to_string()
    }

    /// The rows alone, without head and colour: for lists of a name and a value.
    #[must_use]
    pub fn plain_body(&self) -> String {
        let widths = self.widths();
        self.rows.iter().map(|row| self.draw(&widths, row.iter()) + "\n").collect()
    }

    fn widths(&self) -> Vec<usize> {
        let width = |text: &String| text.chars().count();
        let column = |(at, (name, _)): (usize, &(String, Align))| {
            self.rows.iter().map(|row| width(&row[at])).chain([width(name)]).max().unwrap_or(0)
        };
        self.head.iter().enumerate().map(column).collect()
    }

    /// A row without blanks at its end.
    fn draw<'a>(&self, widths: &[usize], cells: impl Iterator<Item = &'a String>) -> String {
        let mut line = String::new();
        for ((cell, width), (_, align)) in cells.zip(widths).zip(&self.head) {
            if !line.is_empty() {
                line.extend(std::iter::repeat_n(' ', GAP));
            }
            // Writing to a string cannot fail.
            let _ = match align {
                Align::Left => write!(line, "{cell:<width$}"),
                Align::Right => write!(line, "{cell:>width$}"),
            };
        }
        line.truncate(line.trim_end().len());
        line
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let widths = self.widths();
        let head = self.draw(&widths, self.head.iter().map(|(name, _)| name));
        writeln!(f, "{STRONG}{head}{STRONG:#}")?;
        for row in &self.rows {
            writeln!(f, "{}", self.draw(&widths, row.iter()))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_fit_their_widest_cell_and_lines_end_where_their_text_does() {
        let mut table = Table::new([("a", Align::Right), ("what", Align::Left)]);
        assert!(table.is_empty());
        table.row(["1", "µs"]);
        table.row(["1000"]);
        assert_eq!(table.plain(), "   a  what\n   1  µs\n1000\n");
    }
}

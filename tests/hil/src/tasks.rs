//! The task table of an image's `main.rs`, as a program reads it.
//!
//! - **Walk:** `main.rs` → [`TaskTable::read`] → [`rta`](crate::rta).
//! - **Invariants:** the table is the one in the module's docs: what people read is what is calculated with. A cell that cannot be read is
//!   an error that names it; a task without figures is none that passes.
//!
//! ```text
//! //! … at 125 MHz …
//! //! | task | bound to | priority | every µs | deadline µs | shares | worst cycles | lock cycles |
//! ```
//! `every µs` is the shortest time between two of its runs under the load that the text below the table states, `-` where it only runs
//! beside others. `deadline µs` is how long after its cause a run must have ended, `-` where nothing depends on it. `worst cycles` is what
//! one run takes itself, as `cargo xtask hil cycles` measured it; `lock cycles` the longest it keeps others from shared resources.

/// One row.
#[derive(Clone, Debug, PartialEq)]
pub struct Task {
    /// Its name.
    pub name: String,
    /// Higher ones go first.
    pub priority: u8,
    /// Shortest time between two runs, µs.
    pub every_us: Option<f64>,
    /// After its cause, µs.
    pub deadline_us: Option<f64>,
    /// What it shares with others.
    pub shares: Vec<String>,
    /// Of one run, cycles.
    pub worst_cycles: Option<f64>,
    /// The longest it holds what it shares, cycles.
    pub lock_cycles: Option<f64>,
}

/// The table.
#[derive(Clone, Debug, PartialEq)]
pub struct TaskTable {
    /// The processor's clock.
    pub mhz: f64,
    /// Its rows.
    pub tasks: Vec<Task>,
}

/// Why there is no table to calculate with.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TableError {
    /// It has no column of this name: nobody measured.
    #[error("no cycle figures: the table has no column `{0}`")]
    NoFigures(&'static str),
    /// Nothing begins with `| task | bound to |`.
    #[error("the file does not open with a table of tasks")]
    NoTable,
    /// The docs do not say how fast the processor is.
    #[error("the docs before the table do not say `at … MHz`")]
    NoClock,
    /// A cell is no number and no `-`.
    #[error("task {task}: `{cell}` under `{column}` is neither a number nor `-`")]
    Cell {
        /// Whose.
        task: String,
        /// Under which head.
        column: String,
        /// What stands there.
        cell: String,
    },
}

impl TaskTable {
    /// Reads the table in the module docs at the head of `source`.
    ///
    /// # Errors
    /// [`TableError`].
    pub fn read(source: &str) -> Result<Self, TableError> {
        let docs: Vec<&str> = source.lines().map_while(|line| line.strip_prefix("//!")).map(str::trim).collect();
        let head_at =
            docs.iter().position(|line| cells(line).starts_with(&["task".to_owned()])).ok_or(TableError::NoTable)?;
        let head = cells(docs[head_at]);
        let column = |name: &'static str| {
            head.iter().position(|cell| cell.to_lowercase().starts_with(name)).ok_or(TableError::NoFigures(name))
        };
        let (every, deadline) = (column("every")?, column("deadline")?);
        let (worst, lock) = (column("worst cycles")?, column("lock cycles")?);
        let (priority, shares) = (column("priority")?, column("shares")?);
        let mhz = docs.iter().find_map(|line| clock(line)).ok_or(TableError::NoClock)?;
        let rows = docs[head_at + 1..].iter().take_while(|line| line.starts_with('|')).map(|line| cells(line));
        let rows = rows.filter(|row| row.iter().any(|cell| cell.chars().any(char::is_alphanumeric)));
        let tasks = rows.map(|row| {
            let cell = |at: usize| row.get(at).cloned().unwrap_or_default();
            let name = cell(0);
            let value = |at: usize| number(&cell(at)).map_err(|cell| wrong(&name, &head[at], cell));
            let level = value(priority)?.ok_or_else(|| wrong(&name, "priority", "-".to_owned()))?;
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a priority is below 256; saturates"
            )]
            let priority = level as u8;
            let (every_us, deadline_us) = (value(every)?, value(deadline)?);
            let (worst_cycles, lock_cycles) = (value(worst)?, value(lock)?);
            let text = cell(shares);
            let shares = text.split(',').map(str::trim).filter(|share| !matches!(*share, "" | "-")).map(str::to_owned);
            let shares = shares.collect();
            Ok(Task { name, priority, every_us, deadline_us, shares, worst_cycles, lock_cycles })
        });
        Ok(Self { mhz, tasks: tasks.collect::<Result<_, TableError>>()? })
    }
}

fn wrong(task: &str, column: &str, cell: String) -> TableError {
    TableError::Cell { task: task.to_owned(), column: column.to_owned(), cell }
}

/// The cells of a row, without blanks and back-ticks around them.
fn cells(line: &str) -> Vec<String> {
    let Some(inner) = line.strip_prefix('|') else { return Vec::new() };
    let inner = inner.strip_suffix('|').unwrap_or(inner);
    inner.split('|').map(|cell| cell.trim().trim_matches('`').to_owned()).collect()
}

/// A number with commas between its thousands, or nothing.
fn number(cell: &str) -> Result<Option<f64>, String> {
    match cell {
        "-" | "" => Ok(None),
        text => {
            text.replace(',', "").parse().ok().filter(|value| *value >= 0.0).map(Some).ok_or_else(|| text.to_owned())
        }
    }
}

/// The number in `at 125 MHz`.
fn clock(line: &str) -> Option<f64> {
    let before = line.split(" MHz").next().filter(|before| before.len() < line.len())?;
    before.rsplit(' ').next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOURCE: &str = "//! An image at 125 MHz.\n//!\n\
        //! | task  | bound to | priority | every µs | deadline µs | shares      | worst cycles (measured) | lock cycles |\n\
        //! |-------|----------|----------|----------|-------------|-------------|-------------------------|-------------|\n\
        //! | `rx`  | IRQ      | 3        | 1.67     | 1,700       | -           | 120                     | -           |\n\
        //! | idle  | -        | 0        | -        | -           | node, links | -                       | 1,000       |\n#![no_std]\n";

    #[test]
    fn a_table_is_read_by_its_heads() {
        let table = TaskTable::read(SOURCE).unwrap();
        assert!((table.mhz - 125.0).abs() < f64::EPSILON);
        let [rx, idle] = &table.tasks[..] else { panic!("two rows") };
        assert_eq!((rx.name.as_str(), rx.priority, rx.every_us, rx.deadline_us), ("rx", 3, Some(1.67), Some(1_700.0)));
        assert_eq!((rx.worst_cycles, rx.lock_cycles, rx.shares.len()), (Some(120.0), None, 0));
        assert_eq!((idle.lock_cycles, &idle.shares[..]), (Some(1_000.0), &["node".to_owned(), "links".to_owned()][..]));
    }

    #[test]
    fn what_cannot_be_read_is_told() {
        assert_eq!(TaskTable::read("//! Nothing.\n"), Err(TableError::NoTable));
        assert_eq!(TaskTable::read(&SOURCE.replace("every µs", "period")), Err(TableError::NoFigures("every")));
        assert_eq!(TaskTable::read(&SOURCE.replace(" MHz", "")), Err(TableError::NoClock));
        let error = TaskTable::read(&SOURCE.replace("1.67", "often")).unwrap_err();
        assert!(error.to_string().contains("`often` under `every µs`"), "{error}");
    }
}

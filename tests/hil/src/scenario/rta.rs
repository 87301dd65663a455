//! Response times of every image, from the table at the head of its `main.rs`.
//!
//! - **Walk:** [`TaskTable`] → [`analyse`] → a table of response times against deadlines.
//! - **Invariant:** an image without measured cycles is not run, and says so; a deadline that cannot be met fails.

use super::Context;
use crate::report::{Failure, Report, table};
use crate::rta::analyse;
use crate::tasks::{TableError, TaskTable};
use serde_json::json;

pub(super) fn run(context: &Context) -> Result<Report, Failure> {
    let mut report = Report::new();
    let folder = context.places.file("rtic-firmware");
    let mut images: Vec<_> = std::fs::read_dir(&folder)?.filter_map(|entry| Some(entry.ok()?.path())).collect();
    images.sort();
    for path in images.into_iter().map(|image| image.join("src/main.rs")).filter(|path| path.is_file()) {
        let name = path.iter().rev().nth(2).map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        match TaskTable::read(&std::fs::read_to_string(&path)?) {
            Ok(tasks) => image(&mut report, &name, &tasks),
            Err(TableError::NoFigures(column)) => report.not_run(name, TableError::NoFigures(column).to_string()),
            Err(error) => report.check(false, format!("{name}: {error}")),
        }
    }
    Ok(report)
}

fn image(report: &mut Report, name: &str, tasks: &TaskTable) {
    let responses = match analyse(tasks) {
        Ok(responses) => responses,
        Err(error) => return report.check(false, format!("{name}: {error}")),
    };
    let text = |us: Option<f64>| us.map_or("none".to_owned(), |us| format!("{us:.1}"));
    let rows: Vec<Vec<String>> = responses
        .iter()
        .map(|it| {
            vec![
                it.name.clone(),
                text(Some(it.own_us)),
                text(Some(it.blocked_us)),
                text(it.response_us),
                text(it.deadline_us),
            ]
        })
        .collect();
    report.line(format!("{name} at {} MHz, µs", tasks.mhz));
    report.line(table(&["task", "own", "blocked", "response", "deadline"], &rows));
    let load: f64 = tasks.tasks.iter().filter_map(|task| Some(task.worst_cycles? / tasks.mhz / task.every_us?)).sum();
    report.line(format!("load, all at their worst: {:.0} %", load * 100.0));
    report.datum(
        name,
        responses
            .iter()
            .map(|it| json!({ "task": it.name, "response_us": it.response_us, "deadline_us": it.deadline_us }))
            .collect(),
    );
    for response in responses.iter().filter(|response| response.deadline_us.is_some()) {
        let what = format!(
            "{name}: {} responds in {} µs of {}",
            response.name,
            text(response.response_us),
            text(response.deadline_us)
        );
        report.check(response.is_met(), what);
    }
}

//! Response times of a table of tasks under fixed-priority preemptive scheduling.
//!
//! - **Walk:** [`TaskTable`] → [`analyse`] → a response time a task, against its deadline.
//! - **What:** the recurrence of Joseph and Pandya, with blocking as Sha, Rajkumar and Lehoczky have it for ceilings:
//!   R = C + B + Σ ⌈R / Tⱼ⌉ · Cⱼ over all tasks j of higher or equal priority, from R = C up to where it stays. B is the longest lock of a
//!   task of lower priority on something that one of this or a higher priority shares.
//! - **Invariants:** tasks of equal priority count as if they could come first each time, which they cannot: they do not preempt. So the
//!   result is never below the true worst case. Where it passes every bound there is no response time.
//! - **Context:** pure.

use crate::tasks::{Task, TaskTable};

/// Response times above this are none: a tenth of a minute, far above every deadline there is.
const UNBOUNDED_US: f64 = 6_000_000.0;

/// What one task comes to.
#[derive(Clone, Debug, PartialEq)]
pub struct Response {
    /// Which task.
    pub name: String,
    /// Its own time, µs.
    pub own_us: f64,
    /// What a lower task's lock may hold it up, µs.
    pub blocked_us: f64,
    /// From its cause to its end at worst, µs; `None` where there is no bound.
    pub response_us: Option<f64>,
    /// What it may be.
    pub deadline_us: Option<f64>,
}

impl Response {
    /// Whether its deadline is kept; one without a deadline keeps it.
    #[must_use]
    pub fn is_met(&self) -> bool {
        match (self.response_us, self.deadline_us) {
            (_, None) => true,
            (Some(response), Some(deadline)) => response <= deadline,
            (None, Some(_)) => false,
        }
    }
}

/// A table that nothing can be calculated from.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RtaError {
    /// A task with a deadline, or one that goes before such, has no worst cycles.
    #[error("task {0} has no worst cycles: measure them with `cargo xtask hil cycles`")]
    NoCycles(String),
    /// It goes before a task with a deadline, and nothing says how often.
    #[error("task {0} goes before others and does not say how often: state its shortest interval")]
    NoInterval(String),
}

/// Response times of all tasks that have cycles.
///
/// # Errors
/// [`RtaError`] where a figure is missing that is needed.
pub fn analyse(table: &TaskTable) -> Result<Vec<Response>, RtaError> {
    let us = |cycles: f64| cycles / table.mhz;
    let mut responses = Vec::new();
    for (place, task) in table.tasks.iter().enumerate() {
        let Some(own) = task.worst_cycles else {
            if task.deadline_us.is_some() {
                return Err(RtaError::NoCycles(task.name.clone()));
            }
            continue;
        };
        let mut others = Vec::new();
        for (_, other) in
            table.tasks.iter().enumerate().filter(|(at, other)| *at != place && other.priority >= task.priority)
        {
            let cycles = other.worst_cycles.ok_or_else(|| RtaError::NoCycles(other.name.clone()))?;
            let every = other.every_us.ok_or_else(|| RtaError::NoInterval(other.name.clone()))?;
            others.push((every, us(cycles)));
        }
        let blocked_us = us(longest_lock(&table.tasks, task));
        let response_us = fixed_point(us(own), blocked_us, &others);
        let (name, deadline_us) = (task.name.clone(), task.deadline_us);
        responses.push(Response { name, own_us: us(own), blocked_us, response_us, deadline_us });
    }
    Ok(responses)
}

/// The longest lock of a lower task on something with a ceiling at or above `task`'s priority.
fn longest_lock(tasks: &[Task], task: &Task) -> f64 {
    let reaches =
        |share: &String| tasks.iter().any(|user| user.priority >= task.priority && user.shares.contains(share));
    let lower = tasks.iter().filter(|other| other.priority < task.priority && other.shares.iter().any(reaches));
    lower.filter_map(|other| other.lock_cycles).fold(0.0, f64::max)
}

/// Where the recurrence stays, from below; `None` where it passes every bound.
fn fixed_point(own: f64, blocked: f64, others: &[(f64, f64)]) -> Option<f64> {
    let mut response = own + blocked;
    loop {
        let interference: f64 = others.iter().map(|(every, cost)| (response / every).ceil() * cost).sum();
        let next = own + blocked + interference;
        if next > UNBOUNDED_US {
            return None;
        }
        if next <= response {
            return Some(next);
        }
        response = next;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn task(name: &str, priority: u8, every: f64, cost: f64, deadline: f64) -> Task {
        Task {
            name: name.into(),
            priority,
            every_us: Some(every),
            deadline_us: Some(deadline),
            shares: Vec::new(),
            worst_cycles: Some(cost),
            lock_cycles: None,
        }
    }

    fn responses(tasks: Vec<Task>) -> Vec<Option<f64>> {
        analyse(&TaskTable { mhz: 1.0, tasks }).unwrap().into_iter().map(|it| it.response_us).collect()
    }

    /// Burns and Wellings, Real-Time Systems and Programming Languages: periods 7, 12, 20 and costs 3, 3, 5 respond in 3, 6 and 20.
    #[test]
    fn the_example_of_the_literature_comes_out() {
        let tasks = vec![task("a", 3, 7.0, 3.0, 7.0), task("b", 2, 12.0, 3.0, 12.0), task("c", 1, 20.0, 5.0, 20.0)];
        assert_eq!(responses(tasks), [Some(3.0), Some(6.0), Some(20.0)]);
    }

    /// The same with one microsecond less for the last one, and with a higher load than the processor has.
    #[test]
    fn a_table_that_cannot_be_met_fails() {
        let mut tasks = vec![task("a", 3, 7.0, 3.0, 7.0), task("b", 2, 12.0, 3.0, 12.0), task("c", 1, 20.0, 5.0, 19.0)];
        let met: Vec<bool> =
            analyse(&TaskTable { mhz: 1.0, tasks: tasks.clone() }).unwrap().iter().map(Response::is_met).collect();
        assert_eq!(met, [true, true, false]);
        tasks[0].worst_cycles = Some(7.0);
        assert_eq!(responses(tasks)[1..], [None, None], "nothing is left for the others");
    }

    /// A lock of a low task blocks the middle one, which shares nothing, because the high one shares it: the ceiling is the high one's.
    #[test]
    fn a_lock_blocks_all_below_its_ceiling() {
        let share = vec!["node".to_owned()];
        let high = Task { shares: share.clone(), ..task("high", 3, 100.0, 2.0, 100.0) };
        let low = Task { shares: share, lock_cycles: Some(5.0), ..task("low", 1, 100.0, 10.0, 100.0) };
        let middle = task("middle", 2, 100.0, 3.0, 100.0);
        assert_eq!(responses(vec![high, middle, low]), [Some(7.0), Some(10.0), Some(15.0)]);
    }

    /// Equal ones do not preempt one another, but each may have come first.
    #[test]
    fn equal_priorities_stand_in_each_others_way() {
        assert_eq!(
            responses(vec![task("a", 1, 50.0, 4.0, 50.0), task("b", 1, 50.0, 6.0, 50.0)]),
            [Some(10.0), Some(10.0)]
        );
    }

    #[test]
    fn missing_figures_are_told() {
        let mut table = TaskTable { mhz: 1.0, tasks: vec![task("a", 2, 1.0, 1.0, 1.0), task("b", 1, 9.0, 1.0, 9.0)] };
        table.tasks[0].every_us = None;
        assert_eq!(analyse(&table), Err(RtaError::NoInterval("a".into())));
        table.tasks[0].worst_cycles = None;
        assert_eq!(analyse(&table), Err(RtaError::NoCycles("a".into())));
    }
}

//! Motion: how exact the evaluators of splines are and what they cost here, beside those that they are to replace.

mod baseline;
mod evaluators;
mod injection;
mod report;

pub(crate) use evaluators::run as error;
pub(crate) use injection::run as inject;
pub(crate) use report::{Options as ReportOptions, run as report};

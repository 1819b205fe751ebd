//! Scans become verdicts: a scan that correlates strongly with each of the last kept ones brings nothing new and is
//! dropped before anything costly touches it (An. Filatov, LETI 2021, chapter 4).

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod correlation;
mod description;
mod filter;
mod lidar_history;
pub mod process;
mod settings;
mod tally;

pub use filter::CorrelationFilter;
pub use settings::{Mode, Settings};
pub use tally::tally;

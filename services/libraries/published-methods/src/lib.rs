//! What exists to reproduce the two source works step by step. By default something better does the same work; the configuration selects
//! these (the profiles `vinyslam` and `ndt`, `correlation_filter.mode`, `dynamic_cleaner.method`, `flockslam swarm --protocol`).

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod meeting;
mod sampling;
mod sector_scan;
mod seed_exact;

pub use meeting::{CellFusion, Layer, MeetingCounts, Meetings, Snapshot};
pub use sampling::{beam_weight, hill_climbing, monte_carlo};
pub use sector_scan::{Ray, SectorScan};
pub use seed_exact::PublishedFilter;

//! Submaps become constraints, one consistent solution and a fused map.
//!
//! [`SyncManager`] is pure logic: it is given every published pose and the scans that entered the map, and
//! answers each closed submap with a correction for the front end. What it has concluded is a graph of
//! measured constraints; poses are solved from it again and again, so each closure can be revoked at any
//! time.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod back_end;
mod between;
mod filled_trajectory;
mod localizing;
mod manager;
mod measured_views;
mod pose_record;
pub mod process;
mod settings;
mod solution;

pub use back_end::BackEnd;
pub use localizing::LocalizingManager;
pub use manager::SyncManager;
pub use settings::Settings;
pub use solution::{ClosureCounts, DetachedPart, FrozenScan, MAP_ANCHOR, PlacedScan, Solution};

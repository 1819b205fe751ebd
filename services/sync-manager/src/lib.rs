//! Submaps become constraints, one consistent layout and a fused map.
//!
//! [`SyncManager`] is pure logic: it is given every published pose and the scans that entered the map, and
//! answers each closed submap with a correction for the front end. What it has concluded is a graph of
//! measured constraints; poses are solved from it again and again, so each closure can be revoked at any
//! time.

mod agreement;
mod between;
mod chain;
mod cholesky;
mod closure;
mod coverage;
mod dense;
mod edge;
mod fields;
pub mod flock;
mod fuse;
mod fusion;
mod graph;
mod hindsight;
mod manager;
mod ordering;
mod place;
mod polar;
pub mod process;
mod rays;
mod refine;
mod robust;
mod scans;
mod segment;
mod settings;
mod solution;
mod stale;
mod strands;
mod symmetric;
mod trajectory;

pub use fusion::{Fusion, Step};
pub use manager::SyncManager;
pub use settings::{ClosureSettings, FlockSettings, ProximitySource, Settings};
pub use solution::{ClosureCounts, PlacedScan, PlacedSubmap, SettledScan, Solution};

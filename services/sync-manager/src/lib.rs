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

/// The pose graph and its robust solver, as sync-manager uses them: nodes are numbered from 0, edges are measured motions between
/// them, and of the edges that may be wrong the solver says which are outliers.
pub mod pose_graph {
    pub use crate::edge::Edge;
    pub use crate::graph::PoseGraph;
    pub use crate::robust::{RobustSettings, Solved, solve};
    pub use crate::symmetric::Symmetric;
}

pub use fusion::{Fusion, Step};
pub use manager::SyncManager;
pub use settings::{FlockSettings, ProximitySource, Settings};
pub use solution::{ClosureCounts, PlacedScan, PlacedSubmap, SettledScan, Solution};

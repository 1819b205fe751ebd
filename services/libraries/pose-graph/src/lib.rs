//! Pose graphs: nodes are numbered from 0, edges are measured motions between them with their information, and of the edges that may
//! be wrong the robust solver classifies outliers.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod cholesky;
mod edge;
mod graph;
mod marginals;
mod ordering;
mod robust;
mod symmetric;

pub use edge::Edge;
pub use graph::PoseGraph;
pub use marginals::Marginals;
pub use robust::{RobustSettings, Solved, solve};
pub use symmetric::{Symmetric, in_frame, inflated, inverse, times};

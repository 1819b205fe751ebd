//! Loop closure: scans of a trajectory become nodes and segments, a node is looked for in older segments, and what is found becomes a
//! constraint when enough others agree with it.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

pub mod agreement;
pub mod attachment;
pub mod closure;
pub mod connectivity;
pub mod dense;
mod fields;
pub mod finder;
pub mod graph_distances;
pub mod node;
pub mod odometry_graph;
pub mod open_finder;
pub mod place;
pub mod polar;
pub mod refine;
pub mod scans;
pub mod segment;
mod segment_matcher;
mod smoothing;
pub mod wall_directions;

//! Several robots in one solution: what they have recorded becomes one graph, whose poses every robot works out for itself, and to the
//! same bits.
//!
//! [`Flock`] is what one robot knows and concludes: a collection of records, its own among them, and the search for places that it
//! shares with others. A [`FlockGraph`] is the graph that a collection describes, a [`FlockSolution`] its solution: both are functions of the
//! records alone, whatever the order in which they came.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod alternatives;
mod consistency;
mod findings;
mod flock_graph;
mod flock_map;
mod flock_solution;
mod flock_trajectory;
mod inspection;
mod inter_robot_search;
mod joint;
mod member;
mod overlap;
mod similarity;
mod start;

pub use findings::{Findings, OwnLoop};
pub use flock_graph::FlockGraph;
pub use flock_map::FlockMap;
pub use flock_solution::{FlockSolution, PlacedNode, PlacedRecord};
pub use flock_trajectory::{OwnPose, in_flock_frame};
pub use inspection::Inspected;
pub use member::Flock;

//! Map fusion: submaps at their optimised poses become one map, and what later scans saw free is cleared in it.

mod coverage;
mod fusion;
mod hindsight;
mod rays;
mod stale;

pub use fusion::{Fusion, PlacedSubmap, Step};
pub use hindsight::{APART_NS, Hindsight, VIEWS};
pub use stale::stale_cells;

//! Map fusion: submaps at their optimised poses become one map, and what later scans saw free is cleared in it.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod coverage;
mod direction_set;
mod final_cleaning;
mod final_map;
mod footprint;
mod fused_map;
mod fusion;
mod rays;
mod resampling;
mod stale;

pub use final_cleaning::{APART_NS, FinalCleaning, VIEWS};
pub use final_map::FinalMap;
pub use footprint::Footprint;
pub use fused_map::{FusedMap, NotFused, stored_map};
pub use fusion::{Fusion, PlacedSubmap, Step};
pub use stale::stale_cells;

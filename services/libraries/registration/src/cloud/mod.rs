//! Fitting clouds of points to submaps: branch and bound over a score field, then point-to-line refinement
//! against the moments of the submap's points.
//!
//! Everything here gives the same bits on every machine: sums are kept in integers, elementary functions
//! come from `flockslam_geometry::elementary`, and nothing depends on the order of a hash table.

mod align;
mod cloud_point;
mod cloud_search;
mod line_batch;
mod moments;
mod placement;
mod pooled_field;

pub use align::{AlignSettings, Aligner, Alignment};
pub use cloud_point::PackedPoint;
pub use cloud_search::{Found, Searcher, Window};
pub use moments::{MomentGrid, PlacedPoint};
pub use placement::Placement;
pub use pooled_field::PooledField;

//! Strategies that fit a scan to a map, shared by scan-matcher (grids) and sync-manager (clouds of points).

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod batch;
mod bounds;
pub mod cloud;
mod correlative;
#[cfg(test)]
mod covariance_consistency;
mod degenerate;
mod field;
mod gauss_newton;
mod lattice;
mod ndt;
mod surface_counts;
mod surface_map;
mod sweep;
#[cfg(test)]
mod test_room;

pub use correlative::{CorrelativeSearch, Window};
pub use degenerate::degenerate_direction;
pub use field::{GridField, Sample, ScoreField, ScoreRead, bilinear, nearest};
pub use gauss_newton::{Fit, GaussNewton, inflated_along, inflated_everywhere};
pub use lattice::Correlative;
pub use ndt::{Expected, Ndt, NdtSettings};
pub use surface_counts::SurfaceCounts;
pub use surface_map::{Explained, SURFACE_RANGE_MAX_M, SurfaceFit, SurfaceMap, SurfacePrior};
pub use sweep::{MotionState, Sweep, TwistSigma};

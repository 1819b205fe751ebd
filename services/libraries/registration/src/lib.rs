//! Strategies that fit a scan to a map, shared by scan-matcher (grids) and sync-manager (clouds of points).

mod batch;
mod bounds;
pub mod cloud;
#[cfg(test)]
mod consistency;
mod correlative;
mod field;
mod gauss_newton;
mod lattice;
mod ndt;
#[cfg(test)]
mod room;
mod shape;
mod sweep;

pub use correlative::{CorrelativeSearch, Window};
pub use field::{GridField, Sample, ScoreField, ScoreRead, bilinear, nearest};
pub use gauss_newton::{Fit, GaussNewton, roughened, widened};
pub use lattice::Correlative;
pub use ndt::{Expected, Ndt, NdtSettings};
pub use shape::least_held;
pub use sweep::{Moving, Sweep, TwistSigma};

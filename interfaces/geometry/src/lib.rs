//! SE(2) geometry: poses, twists, angles and points.
//!
//! Frames follow REP-105 (`flock ← map ← odom ← base_link ← laser`), units REP-103 (metres, radians, seconds).
//! A transform named `a_from_b` takes coordinates in `b` to coordinates in `a`.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod angle;
mod covariance;
pub mod elementary;
mod point;
mod pose;
mod twist;

pub use angle::wrap_angle;
pub use covariance::Covariance;
pub use point::Point;
pub use pose::Pose;
pub use twist::Twist;

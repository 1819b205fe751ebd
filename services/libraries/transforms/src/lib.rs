//! Poses of frames on a robot, over time and in space, as `/tf` and `/tf_static` give them, and what a scan in the plane needs of them.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod mounting;
mod time_watch;
mod transform_buffer;

pub use mounting::{Mounting, MountingError, planar};
pub use nalgebra::Isometry3;
pub use time_watch::TimeWatch;
pub use transform_buffer::{LookupError, StampedTransform, TransformBuffer, frame_name, pose_in_space};

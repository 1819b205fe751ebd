//! Calibration of a lidar from a drive: its mounting on the robot, how far its stamps are off those of odometry, and where it sees the
//! robot's own body.
//!
//! All of it is a function of scans, poses and odometry: the end of a run, a recording and a running set use the same code.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod body_mask;
mod drive_samples;
mod estimate;
mod hand_eye;

pub use body_mask::{BodyMask, MaskError};
pub use drive_samples::{DriveSample, DriveSamples};
pub use estimate::{CalibrationError, LidarEstimate};
pub use hand_eye::estimate;

//! A sensor, a log or a simulated world becomes scans.
//!
//! Everything here is a function of its inputs: bytes of a log or a seed go in, scans come out. Opening files, pacing
//! and publishing belong to the process around it.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

pub mod carmen;
mod cloud_slice;
mod continuity;
pub mod experiment;
mod gyro_heading;
mod lidar_order;
pub mod process;
mod scan_locator;
mod self_mask;
mod settings;
pub mod stamp;

pub use scan_locator::LocateError;
pub use settings::{LidarCalibration, LidarMounting, Settings};

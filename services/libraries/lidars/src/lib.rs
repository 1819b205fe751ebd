//! Lidars: what they send, decoded into turns, and the requests to them. No port, no clock: bytes and times of arrival
//! come from the caller, and so do the answers go. One file a family.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "no result depends on tests"))]

mod assembly;
mod byte_counts;
mod byte_frames;
mod device;
mod driver;
pub mod encoders;
mod family;
mod ld06;
mod rplidar;
mod rplidar_requests;
mod rplidar_samples;
mod sick_tim;
mod turn;
mod urg;
mod ydlidar;
mod ydlidar_models;

pub use byte_counts::Counts;
pub use device::{Device, Health};
pub use driver::{Act, Driver};
pub use family::{Family, UnknownModel};
pub use turn::Turn;

//! What lidars send, for tests: the other direction of the decoders. Packets come one by one, in their order, so that a test can
//! play them at their pace.

pub mod ld06_encoder;
pub mod rplidar_encoder;
pub mod sick_tim_encoder;
pub mod urg_encoder;
pub mod ydlidar_encoder;

use std::f64::consts::{PI, TAU};

/// The range in a direction, metres; radians counter-clockwise, as in a turn.
pub type World<'a> = &'a dyn Fn(f64) -> f64;

/// The direction of a lidar that counts degrees clockwise, radians counter-clockwise within a half turn.
fn counter_clockwise_rad(clockwise_deg: f64) -> f64 {
    let angle_rad = -clockwise_deg.to_radians();
    angle_rad - TAU * ((angle_rad + PI) / TAU).floor()
}

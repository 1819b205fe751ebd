//! What lidars send, for tests: the other direction of the decoders. Packets come one by one, in their order, so that a test can
//! play them at their pace.

pub mod ld06;
pub mod rplidar;
pub mod sick_tim;
pub mod urg;
pub mod ydlidar;

use std::f64::consts::{PI, TAU};

/// The range in a direction, metres; radians counter-clockwise, as in a turn.
pub type World<'a> = &'a dyn Fn(f64) -> f64;

/// The direction of a lidar that counts degrees clockwise, radians counter-clockwise within a half turn.
fn counter_clockwise_rad(clockwise_deg: f64) -> f64 {
    let angle_rad = -clockwise_deg.to_radians();
    angle_rad - TAU * ((angle_rad + PI) / TAU).floor()
}

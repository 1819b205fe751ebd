//! Times, headers, poses.

use super::message;
use flockslam_geometry::elementary::{atan2, sin_cos};
use serde::{Deserialize, Serialize};

/// `builtin_interfaces/Time`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Time {
    /// Seconds.
    pub sec: i32,
    /// Nanoseconds after them.
    pub nanosec: u32,
}

impl Time {
    /// From nanoseconds. Times that do not fit are the nearest that do.
    pub fn from_ns(ns: i64) -> Self {
        let sec = ns.div_euclid(1_000_000_000).clamp(i64::from(i32::MIN), i64::from(i32::MAX));
        Self { sec: sec as i32, nanosec: ns.rem_euclid(1_000_000_000) as u32 }
    }

    /// As nanoseconds.
    pub fn ns(self) -> i64 {
        i64::from(self.sec) * 1_000_000_000 + i64::from(self.nanosec)
    }
}

/// `std_msgs/Header`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// When.
    pub stamp: Time,
    /// In which frame.
    pub frame_id: String,
}

impl Header {
    /// At a time in nanoseconds, in a frame.
    pub fn new(stamp_ns: i64, frame: &str) -> Self {
        Self { stamp: Time::from_ns(stamp_ns), frame_id: frame.to_owned() }
    }
}

/// `geometry_msgs/Point` and `geometry_msgs/Vector3`, which are alike.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Vector3 {
    /// Along x.
    pub x: f64,
    /// Along y.
    pub y: f64,
    /// Along z.
    pub z: f64,
}

/// `geometry_msgs/Quaternion`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    /// i.
    pub x: f64,
    /// j.
    pub y: f64,
    /// k.
    pub z: f64,
    /// The real part.
    pub w: f64,
}

impl Default for Quaternion {
    fn default() -> Self {
        Self { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }
}

impl Quaternion {
    /// A turn about z, radians.
    pub fn about_z(heading_rad: f64) -> Self {
        let (z, w) = sin_cos(heading_rad / 2.0);
        Self { x: 0.0, y: 0.0, z, w }
    }

    /// The heading of a rotation: its turn about z, radians.
    pub fn heading_rad(self) -> f64 {
        let Self { x, y, z, w } = self;
        atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    }
}

/// `geometry_msgs/Pose`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Where.
    pub position: Vector3,
    /// Towards what.
    pub orientation: Quaternion,
}

impl Pose {
    /// A pose in the plane: metres and radians.
    pub fn planar(x_m: f64, y_m: f64, heading_rad: f64) -> Self {
        Self { position: Vector3 { x: x_m, y: y_m, z: 0.0 }, orientation: Quaternion::about_z(heading_rad) }
    }
}

/// `geometry_msgs/PoseWithCovariance`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseWithCovariance {
    /// The pose.
    pub pose: Pose,
    /// Of x, y, z and the turns about them: m², m·rad, rad².
    pub covariance: [[f64; 6]; 6],
}

message! {
    /// `geometry_msgs/PoseWithCovarianceStamped`.
    PoseWithCovarianceStamped = "geometry_msgs" {
        /// When and where.
        header: Header,
        /// The pose.
        pose: PoseWithCovariance,
    }
}

message! {
    /// `rosgraph_msgs/Clock`.
    Clock = "rosgraph_msgs" {
        /// The time of a simulation or of a recording that is played.
        clock: Time,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn times_come_back(ns in -4_000_000_000_000_000_000_i64..4_000_000_000_000_000_000) {
            let fits = (ns / 1_000_000_000).abs() < i64::from(i32::MAX);
            prop_assert_eq!(Time::from_ns(ns).ns() == ns, fits);
        }
    }
}

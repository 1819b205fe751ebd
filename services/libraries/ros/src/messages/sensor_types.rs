//! What sensors say.

use super::{Header, PoseWithCovariance, Quaternion, Vector3, message};
use serde::{Deserialize, Serialize};

message! {
    /// `sensor_msgs/LaserScan`.
    LaserScan = "sensor_msgs" {
        /// When the first beam was measured, in the frame of the lidar.
        header: Header,
        /// Of the first beam, radians.
        angle_min: f32,
        /// Of the last beam, radians.
        angle_max: f32,
        /// From beam to beam, radians.
        angle_increment: f32,
        /// From beam to beam, seconds.
        time_increment: f32,
        /// From scan to scan, seconds.
        scan_time: f32,
        /// Nothing is measured below, metres.
        range_min: f32,
        /// Nothing is measured beyond, metres.
        range_max: f32,
        /// Metres.
        ranges: Vec<f32>,
        /// In the unit of the lidar; none, or one for each range.
        intensities: Vec<f32>,
    }
}

message! {
    /// `sensor_msgs/Imu`.
    Imu = "sensor_msgs" {
        /// When, in the frame of the IMU.
        header: Header,
        /// Its pose.
        orientation: Quaternion,
        /// Of it.
        orientation_covariance: [[f64; 3]; 3],
        /// Radians a second.
        angular_velocity: Vector3,
        /// Of it.
        angular_velocity_covariance: [[f64; 3]; 3],
        /// Metres a second².
        linear_acceleration: Vector3,
        /// Of it.
        linear_acceleration_covariance: [[f64; 3]; 3],
    }
}

/// `geometry_msgs/TwistWithCovariance`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TwistWithCovariance {
    /// Metres a second.
    pub linear: Vector3,
    /// Radians a second.
    pub angular: Vector3,
    /// Of both.
    pub covariance: [[f64; 6]; 6],
}

message! {
    /// `nav_msgs/Odometry`.
    Odometry = "nav_msgs" {
        /// When, in the frame of odometry.
        header: Header,
        /// The frame of the robot.
        child_frame_id: String,
        /// Its pose.
        pose: PoseWithCovariance,
        /// Its velocity, in its own frame.
        twist: TwistWithCovariance,
    }
}

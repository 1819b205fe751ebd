//! The message about moving bodies around the robot: position, velocity and prediction of each track.

use crate::message::message;
use crate::{ScanId, Times};
use flockslam_geometry::Point;

message! {
    /// Moving bodies around the robot, published for every scan with a certain pose. A slice of [`Track`] follows.
    pub struct TracksHeader = "flockslam/tracks/v1" {
        /// The scan.
        pub id: ScanId,
        /// Its times, as in the scan.
        pub times: Times,
        /// Number of tracks that follow.
        pub count: u32,
        /// Reserved, zero.
        pub reserved: u32,
    }
}

message! {
    /// A body that moves in known free space. All positions are in odom.
    pub struct Track = "flockslam/track/v1" {
        /// Its name as long as it is followed.
        pub id: u64,
        /// Centre at the scan's stamp, metres.
        pub position: Point,
        /// Velocity, m/s along x and y.
        pub velocity_m_s: Point,
        /// Variance of each coordinate, m².
        pub position_variance: f64,
        /// Covariance of each coordinate with its velocity, m²/s.
        pub position_velocity_covariance: f64,
        /// Variance of each component of the velocity, m²/s².
        pub velocity_variance: f64,
        /// Since it was seen first, seconds.
        pub age_s: f64,
        /// Since it was seen last, seconds.
        pub unseen_s: f64,
        /// Where it will be in one, two and three seconds if it goes on like this, metres.
        pub predicted: [Point; 3],
    }
}

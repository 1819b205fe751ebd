//! The message that requests a global localization in the known map.

use crate::message::message;
use flockslam_geometry::Pose;

message! {
    /// Look for the robot anew, near a pose or everywhere.
    pub struct LocalisationOrder = "flockslam/localisation-order/v1" {
        /// A guess of where it is; it counts when [`Self::sigma_m`] is above zero.
        pub map_from_base: Pose,
        /// Standard deviation of its position, metres; 0 = the robot may be anywhere.
        pub sigma_m: f64,
        /// Standard deviation of its heading, radians.
        pub sigma_rad: f64,
    }
}

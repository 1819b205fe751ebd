//! The message of a correction of the front end.

use crate::message::message;
use flockslam_geometry::Pose;

message! {
    /// What sync-manager concluded after a scan that has entered the map, as far as the front end needs it; the whole solution is in
    /// the store.
    pub struct Correction = "flockslam/correction/v2" {
        /// The new correction of the front end.
        pub map_from_odom: Pose,
        /// Sequence of the scan after which it was computed.
        pub scan: u64,
        /// Cold start that it belongs to.
        pub run: u32,
        /// The last submap whose closing it knows of; 0 before the first as well.
        pub submap: u32,
        /// Counts the corrections of this run from 1.
        pub revision: u32,
        /// Loop closures that are inliers.
        pub closures: u32,
        /// The newest trajectory in the solution.
        pub trajectory: u32,
        /// 1 when closures connect that trajectory with the map; 0 while its place in the map is a guess.
        pub attached: u32,
    }
}

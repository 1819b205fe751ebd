use crate::message::message;
use flockslam_geometry::Pose;

message! {
    /// How the robot's map lies in the common map of its flock; sent while the robot is part of it.
    pub struct FlockFrame = "flockslam/flock-frame/v1" {
        /// Takes coordinates of the robot's map to the frame of the flock.
        pub flock_from_map: Pose,
        /// Hash of the common layout and of the map fused in it: equal for robots that know the same.
        pub map_hash: u64,
        /// Robots that are part of the common map.
        pub members: u32,
        /// Counts the common layouts of this process from 1.
        pub revision: u32,
    }
}

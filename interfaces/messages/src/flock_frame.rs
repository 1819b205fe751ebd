//! Messages about the flock: the frame of the common map, and the poses of other robots.

use crate::message::message;
use flockslam_geometry::Pose;

message! {
    /// Pose of the robot's map in the common map of its flock; sent while the robot is part of it.
    pub struct FlockFrame = "flockslam/flock-frame/v1" {
        /// Takes coordinates of the robot's map to the frame of the flock.
        pub flock_from_map: Pose,
        /// Hash of the common solution and of the map fused in it: equal for robots that know the same.
        pub map_hash: u64,
        /// Robots that are part of the common map.
        pub members: u32,
        /// Counts the common solutions of this process from 1.
        pub revision: u32,
    }
}

/// Greatest number of robots in one message.
pub const FLOCK_ROBOTS_MAX: usize = 16;

message! {
    /// Poses of other robots of the flock, as they publish them; sent whenever one of them is received.
    pub struct FlockRobots = "flockslam/flock-robots/v2" {
        /// Those that are known, `count` of them.
        pub robots: [FlockRobot; FLOCK_ROBOTS_MAX],
        /// How many.
        pub count: u32,
        /// Reserved, zero.
        pub reserved: u32,
    }
}

message! {
    /// Another robot of the flock.
    pub struct FlockRobot = "flockslam/flock-robot/v2" {
        /// Where it is in this robot's map.
        pub map_from_base: Pose,
        /// CLOCK_MONOTONIC of its reception, nanoseconds: clocks of other robots are not trusted.
        pub received_ns: u64,
        /// Radius of a circle around it that holds its body, metres.
        pub radius_m: f64,
        /// Its name in the flock, with zeros behind.
        pub name: [u8; 32],
    }
}

impl FlockRobots {
    /// Those that are known.
    pub fn as_slice(&self) -> &[FlockRobot] {
        &self.robots[..(self.count as usize).min(FLOCK_ROBOTS_MAX)]
    }
}

impl FlockRobot {
    /// Its name.
    pub fn name(&self) -> &str {
        let name = self.name.split(|byte| *byte == 0).next().unwrap_or_default();
        std::str::from_utf8(name).unwrap_or_default()
    }
}

//! Poses of the other robots of the common map, from their last messages, in this robot's map.

use super::common::Common;
use flockslam_geometry::Pose;
use flockslam_messages::{FLOCK_ROBOTS_MAX, FlockRobot, FlockRobots};
use flockslam_records::{Presence, RobotId};
use std::collections::BTreeMap;

/// Where the other robots of the common map say that they are.
#[derive(Debug, Default)]
pub struct RobotPoses {
    /// The newest of each, and CLOCK_MONOTONIC of when it was received, nanoseconds.
    newest: BTreeMap<RobotId, (Presence, u64)>,
}

impl RobotPoses {
    /// Takes in the pose that a robot publishes; false when that is not used: it is not newer than the last, or nobody knows how
    /// its map is.
    pub fn insert(&mut self, presence: Presence, received_ns: u64, common: &Common) -> bool {
        self.newest.retain(|_, (known, _)| common.place_of(known).is_some());
        let known = self.newest.get(&presence.robot);
        let is_new = known.is_none_or(|(known, _)| presence.is_newer_than(known));
        let has_room = known.is_some() || self.newest.len() < FLOCK_ROBOTS_MAX;
        if !is_new || !has_room || common.place_of(&presence).is_none() {
            return false;
        }
        self.newest.insert(presence.robot.clone(), (presence, received_ns));
        true
    }

    /// Where they are in this robot's map, given the pose of that map in the flock's. `radius_m` is that of a body.
    pub fn in_map(&self, common: &Common, flock_from_map: Pose, radius_m: f64) -> FlockRobots {
        let mut robots = FlockRobots::default();
        let places = self.newest.values().filter_map(|(presence, received_ns)| {
            let map_from_base =
                flock_from_map.inverse() * common.place_of(presence)? * presence.odom_from_base;
            let mut name = [0; 32];
            let text = presence.robot.name().as_bytes();
            name[..text.len()].copy_from_slice(text);
            Some(FlockRobot { map_from_base, received_ns: *received_ns, radius_m, name })
        });
        for (robot, place) in robots.robots.iter_mut().zip(places) {
            *robot = place;
            robots.count += 1;
        }
        robots
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_records::RobotKey;

    #[test]
    fn poses_of_robots_in_the_common_map_are_used_unless_outdated() {
        let [a, b, outsider] = ["a", "b", "outsider"].map(|name| RobotKey::of_replay(name).unwrap());
        let pose = |x: f64| Pose::new(x, 0.0, 0.0);
        let common =
            Common::with_submaps(a.id(), [((b.id().clone(), 1), vec![(0, pose(10.0)), (3, pose(20.0))])]);
        let says = |key: &RobotKey, sequence, submap| Presence::sign(key, 1, sequence, submap, pose(1.0));
        let mut poses = RobotPoses::default();
        assert!(!poses.insert(says(&outsider, 5, 0), 7, &common));
        assert!(poses.insert(says(&b, 5, 4), 7, &common));
        assert!(!poses.insert(says(&b, 5, 4), 8, &common) && !poses.insert(says(&b, 4, 4), 8, &common));
        let published = poses.in_map(&common, pose(100.0), 0.4);
        let [robot] = published.as_slice() else { panic!("{published:?}") };
        assert_eq!((robot.name(), robot.received_ns, robot.radius_m), ("b", 7, 0.4));
        assert!((robot.map_from_base.x_m + 79.0).abs() < 1e-9, "{robot:?}");
        // The submap that it is in is not known yet: the one before it is the best reference.
        assert!(poses.insert(says(&b, 6, 2), 9, &common));
        assert!((poses.in_map(&common, pose(100.0), 0.4).robots[0].map_from_base.x_m + 89.0).abs() < 1e-9);
        // A robot that is no longer part of it has no pose.
        let apart = Common::with_submaps(a.id(), []);
        assert_eq!(poses.in_map(&apart, pose(0.0), 0.4).count, 0);
    }
}

//! Presences: receives the poses of neighbours, and publishes the pose of this robot.

use super::FlockExchange;
use crate::drops::Dropped;
use crate::link::address;
use crate::thread_state::locked;
use flockslam_messages::{PoseEstimate, Quality};
use flockslam_records::Presence;
use flockslam_telemetry::monotonic_ns;
use std::time::{Duration, Instant};

/// Radius of a circle that holds the body of any robot of the flock, metres: where another robot says that it is, so much is taken for
/// its body and kept out of the map. The robots are small, and the error of the common frame comes on top.
const BODY_RADIUS_M: f64 = 0.35;
/// The robot's pose is sent to neighbours this often.
const PERIOD: Duration = Duration::from_secs(1);

impl FlockExchange {
    /// Takes the pose that a neighbour publishes. No robot publishes it for another.
    pub(super) fn meet(&mut self, presence: Presence, sender: &str) {
        if address(&presence.robot) != sender {
            return self.drops.count(Dropped::Malformed, 1);
        }
        if self.robot_poses.insert(presence, monotonic_ns(), &self.common) {
            self.show_robot_poses();
        }
    }

    pub(super) fn show_robot_poses(&self) {
        let Some(frame) = *locked(&self.shared.frame) else { return };
        *locked(&self.shared.robots) =
            self.robot_poses.in_map(&self.common, frame.flock_from_map, BODY_RADIUS_M);
    }

    /// Publishes the pose of this robot to robots that are near, when it has changed and is known.
    pub(super) fn publish_place(&mut self) {
        let now = Instant::now();
        let Some(pose) = locked(&self.shared.pose).filter(|_| !self.near.is_empty()) else { return };
        let is_published = |(at, sequence)| now - at < PERIOD || sequence >= pose.id.sequence;
        let Some(link) = self.link.as_ref().filter(|_| !self.was_here.is_some_and(is_published)) else {
            return;
        };
        if pose.quality != Quality::Tracking as u32 {
            return;
        }
        self.was_here = Some((now, pose.id.sequence));
        let PoseEstimate { id, submap, odom_from_base, .. } = pose;
        let here = self.publisher.flock().here(id.sequence, submap, odom_from_base);
        for (peer, neighbour) in &mut self.near {
            if neighbour.budget.left(now) > 0 {
                neighbour.budget.spend(link.send_to(peer, &here));
            }
        }
    }
}

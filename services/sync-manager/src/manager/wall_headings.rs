//! Headings by walls while the robot drives: nodes behind the last closure drift less. The final solution does not use them.

use super::SyncManager;
use flockslam_loop_closure::wall_directions::{WallDirections, wall_direction_rad};
use flockslam_pose_graph::Edge;
use flockslam_registration::cloud::Placement;
use std::ops::Range;

/// A new node is turned by this share towards the walls that it sees, if they agree: over a few metres, since one scan is off by half a
/// degree. With 0.05 and 0.2 published poses of the public logs are within a tenth as accurate.
const SHARE: f64 = 0.1;
/// Standard deviation of a node's heading by walls in the solution, radians. What scans have in common there, as a wall that is not
/// quite parallel, does not become less over many nodes, so it is more than that of one scan.
const SIGMA_RAD: f64 = 0.06;

/// The directions of walls that nodes have seen.
#[derive(Debug, Default)]
pub(super) struct WallHeadings {
    /// By node: the direction of walls modulo a quarter turn in the robot's frame, radians; `None` where it does not count.
    seen_rad: Vec<Option<f64>>,
    /// Directions in the map, as the poses are now.
    directions: WallDirections,
}

impl WallHeadings {
    /// Takes out nodes.
    pub(super) fn take_out(&mut self, nodes: Range<usize>) {
        self.seen_rad.drain(nodes);
    }

    /// Counts the directions anew: these are the poses of the first nodes.
    fn count(&mut self, poses: &[Placement]) {
        self.directions = WallDirections::default();
        for (pose, seen_rad) in poses.iter().zip(&self.seen_rad) {
            if let Some(seen_rad) = seen_rad {
                self.directions.add(pose.heading_rad + seen_rad);
            }
        }
    }

    /// The pose of a new node, turned towards the walls that it sees.
    fn turned(&mut self, node: usize, pose: Placement) -> Placement {
        let Some(seen_rad) = self.seen_rad[node] else { return pose };
        let walls = self.directions.parallel(pose.heading_rad + seen_rad);
        let turn_rad = walls.map_or(0.0, |walls| SHARE * walls.agreement * walls.off_rad);
        let turned = Placement::new(pose.x_m, pose.y_m, pose.heading_rad + turn_rad);
        self.directions.add(turned.heading_rad + seen_rad);
        turned
    }

    /// Constraints on the headings of nodes, which have these poses now, relative to the first.
    fn edges(&self, poses: &[Placement]) -> Vec<Edge> {
        let seen = poses.iter().zip(&self.seen_rad).enumerate().skip(1);
        let edge = |(to, (pose, seen_rad)): (usize, (&Placement, &Option<f64>))| {
            let walls = self.directions.parallel(pose.heading_rad + (*seen_rad)?)?;
            let heading_rad = pose.heading_rad + walls.off_rad - poses[0].heading_rad;
            let information = walls.agreement / (SIGMA_RAD * SIGMA_RAD);
            let motion = Placement::new(0.0, 0.0, heading_rad);
            Some(Edge { from: 0, to, motion, information: [0.0, 0.0, 0.0, 0.0, 0.0, information] })
        };
        seen.filter_map(edge).collect()
    }
}

impl SyncManager {
    /// Notes the walls that the newest node sees. Where loops are not closed, in the open, and where nothing connects the robot with its
    /// first trajectory, they do not count.
    pub(super) fn see_walls(&mut self) {
        let known = self.odometry.nodes().len();
        let Some(node) = self.odometry.nodes().last() else { return };
        let counts = self.settings.close_loops
            && !node.is_open
            && (node.trajectory == self.odometry.nodes()[0].trajectory
                || self.connectivity(known).is_attached(node.trajectory));
        let seen_rad = if counts { wall_direction_rad(self.scans.points(node.scan)) } else { None };
        self.walls.seen_rad.push(seen_rad);
    }

    /// Poses of nodes newer than the last solution.
    pub(super) fn follow_odometry(&mut self, known: usize) {
        for node in self.poses.len()..known {
            let pose = match (self.entered(node), node.checked_sub(1)) {
                (Some(entered), _) => entered,
                (None, None) => self.odometry.nodes()[0].local_pose,
                (None, Some(last)) => self.driven_from(last),
            };
            let pose = self.walls.turned(node, pose);
            self.poses.push(pose);
        }
    }

    /// Poses of the nodes behind the node `held` anew.
    pub(super) fn follow_behind(&mut self, held: usize) {
        self.walls.count(&self.poses[..=held]);
        for node in held + 1..self.poses.len() {
            self.poses[node] = self.walls.turned(node, self.driven_from(node - 1));
        }
    }

    /// The pose of the next node, as odometry leads to it from this one.
    fn driven_from(&self, node: usize) -> Placement {
        let nodes = self.odometry.nodes();
        self.poses[node].compose(nodes[node].local_pose.to(nodes[node + 1].local_pose))
    }

    /// Takes the directions of walls from a new solution.
    pub(super) fn count_walls(&mut self) {
        self.walls.count(&self.poses);
    }

    /// Constraints on the headings of the first `known` nodes.
    pub(super) fn wall_edges(&self, known: usize) -> Vec<Edge> {
        self.walls.edges(&self.poses[..known])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flockslam_random::Random;

    /// A robot drives 90 m along a corridor. Its odometry turns by a twentieth of a degree from node to node.
    #[test]
    fn headings_drift_a_fifth_as_much_once_the_directions_of_walls_are_known() {
        let mut random = Random::new(1, "wall headings");
        let (drift_rad, nodes) = (0.05f64.to_radians(), 300);
        // In truth the robot always drives towards the same side.
        let seen_rad = (0..nodes).map(|_| Some(0.2 + 0.008 * random.normal())).collect();
        let mut walls = WallHeadings { seen_rad, ..WallHeadings::default() };
        let mut poses = vec![walls.turned(0, Placement::IDENTITY)];
        for node in 1..nodes {
            let driven = poses[node - 1].compose(Placement::new(0.3, 0.0, drift_rad));
            poses.push(walls.turned(node, driven));
        }
        let drifted_rad = drift_rad * f64::from(nodes as u32 - 1);
        let left_rad = poses[nodes - 1].heading_rad;
        assert!(
            drifted_rad > 0.25 && left_rad.abs() < 0.2 * drifted_rad,
            "{left_rad} rad of {drifted_rad} rad"
        );
        // What turns a node by a degree is put right.
        poses[200] = Placement::new(poses[200].x_m, poses[200].y_m, poses[199].heading_rad + 0.02);
        let edges = walls.edges(&poses);
        let edge = edges.iter().find(|edge| edge.to == 200).expect("walls of this direction are known");
        let off_rad = edge.motion.heading_rad + poses[0].heading_rad - poses[199].heading_rad;
        assert!(edge.from == 0 && off_rad.abs() < 0.015, "{off_rad} rad");
    }
}

//! When and where loops are searched for while the robot drives: every few metres, at each node while closures that were found wait for
//! others, and at once behind the first of these.

use super::SyncManager;
use flockslam_loop_closure::agreement::eligible;
use flockslam_loop_closure::closure::Closure;
use flockslam_loop_closure::finder::{EVERY_M, QUERY_NODES, World, in_reach};
use flockslam_loop_closure::graph_distances::{CLOSURE_M, JOINT_M, graph_distances, graph_distances_to};

/// Searches from one closed submap to the next beyond the usual ones while the newest trajectory is not connected with the map.
const DETACHED_SEARCHES: u64 = 100;

/// While closures found in the last so many metres wait for others that agree with them …
const AWAITED_M: f64 = 3.0;
/// … a search starts after this much travel: at each node.
const AWAITED_EVERY_M: f64 = 0.25;
/// When the first closures that wait are found, nodes that were passed over before it are searched for too, so far apart, metres: what
/// the robot has driven past already need not be waited for.
const BEHIND_EVERY_M: f64 = 0.5;

impl SyncManager {
    /// Searches at all nodes at which it is due, at most so often since the last closed submap.
    pub(super) fn search_due(&mut self, known: usize, searches: usize) {
        while let Some(query) = self.due_query(known) {
            let waited = self.waits(query);
            self.search_within(query, known, searches);
            if !waited && self.waits(query) {
                for node in self.passed_over(query) {
                    self.search_within(node, known, searches);
                }
            }
            let every_m = if self.waits(query) { AWAITED_EVERY_M } else { EVERY_M };
            self.next_search_m = self.odometry.nodes()[query].travel_m + every_m;
        }
    }

    /// Searches at the node `query`, unless there were `searches` since the last closed submap.
    fn search_within(&mut self, query: usize, known: usize, searches: usize) {
        // An unconnected trajectory is searched for everywhere: it gets more searches, but not without a limit.
        let trajectory = self.odometry.nodes()[query].trajectory;
        let searches = searches as u64;
        let most = if self.connectivity(known).is_attached(trajectory) {
            searches
        } else {
            searches.min(DETACHED_SEARCHES) + DETACHED_SEARCHES
        };
        if self.finder.counts().searches - self.concluded.searches < most {
            self.search(query, known);
        }
    }

    /// The nodes between the last search and the node `query` that are searched for once this one has shown something.
    fn passed_over(&self, query: usize) -> Vec<usize> {
        let nodes = self.odometry.nodes();
        let at_m = nodes[query].travel_m;
        let mut passed: Vec<usize> = Vec::new();
        for node in (0..query).rev() {
            if nodes[node].travel_m <= at_m - EVERY_M || nodes[node].trajectory != nodes[query].trajectory {
                break;
            }
            let last = passed.last().copied().unwrap_or(query);
            let may_be_searched = !nodes[node].is_open && !nodes[node].is_given;
            if may_be_searched && nodes[last].travel_m - nodes[node].travel_m >= BEHIND_EVERY_M {
                passed.push(node);
            }
        }
        passed
    }

    /// The first node at which a search is due and whose surroundings are complete.
    fn due_query(&self, known: usize) -> Option<usize> {
        let nodes = &self.odometry.nodes()[..known.saturating_sub(QUERY_NODES)];
        let first = nodes.partition_point(|node| node.travel_m < self.next_search_m);
        (first..nodes.len()).find(|node| !nodes[*node].is_given)
    }

    /// Whether closures found shortly before the node `query`, or there, wait for others.
    fn waits(&self, query: usize) -> bool {
        let nodes = self.odometry.nodes();
        let at_m = nodes[query].travel_m;
        let found = self.closures.iter().zip(&self.is_inlier).rev();
        let recent = found.take_while(|(closure, _)| nodes[closure.edge.to].travel_m >= at_m - AWAITED_M);
        // A robot that may be anywhere is not found sooner: queries so near to each other err alike.
        let is_own = |closure: &Closure| nodes[closure.edge.from].trajectory == nodes[query].trajectory;
        let mut waiting = recent.filter(|(closure, is_inlier)| !**is_inlier && is_own(closure));
        !nodes[query].is_open && waiting.next().is_some()
    }

    /// What connects nodes beside driving, with the uncertainty between them as a length of path, metres.
    pub(super) fn connections(&self, known: usize) -> Vec<(usize, usize, f64)> {
        let inliers = self.closures.iter().zip(&self.is_inlier).filter(|(_, is_inlier)| **is_inlier);
        let closures = inliers.map(|(c, _)| (c.edge.from, c.edge.to, CLOSURE_M));
        closures.chain(self.joints(known).map(|joint| (joint.from, joint.to, JOINT_M))).collect()
    }

    fn search(&mut self, query: usize, known: usize) {
        let nodes = &self.odometry.nodes()[..known];
        let world = World { nodes, scans: &self.scans, segments: &self.segments, poses: &self.poses };
        let connections = self.connections(known);
        let is_one_trajectory = nodes.last().is_some_and(|last| last.trajectory == nodes[0].trajectory);
        let distances_m = if is_one_trajectory && !nodes[query].is_open {
            graph_distances_to(nodes, &connections, query, &in_reach(&world, query))
        } else {
            graph_distances(nodes, &connections, query)
        };
        let found = if nodes[query].is_open {
            self.open_finder.find(&world, query, &distances_m)
        } else {
            self.finder.find(&world, query, &distances_m)
        };
        if let Some(unpublished) = &mut self.unpublished {
            unpublished.found(&found, self.odometry.nodes());
        }
        self.closures.extend(found);
        // New ones count at once for the windows of the next queries.
        let eligible = eligible(&self.closures, nodes);
        let old = self.is_inlier.len();
        self.is_inlier.extend(&eligible[old..]);
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::Settings;
    use flockslam_geometry::Pose;
    use flockslam_messages::{PoseEstimate, PoseFlags, ScanBuffer};

    /// Ranges in a room of 12 m × 4 m, from this far ahead of its middle.
    fn scan(x_m: f64) -> ScanBuffer {
        let range = |degrees: i32| {
            let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
            ((6.0 - x_m * cos.signum()) / cos.abs()).min(2.0 / sin.abs()) as f32
        };
        ScanBuffer::from_ranges(&(0..360).map(range).collect::<Vec<_>>(), 0.0, 1f64.to_radians())
    }

    /// A robot that has driven 4 m, in a new trajectory from this step of 0.31 m on: each is a node.
    fn driven(new_from: u64) -> SyncManager {
        let mut manager = SyncManager::new(Settings::default());
        for step in 0..=13 {
            let at = Pose::new(0.31 * step as f64, 0.0, 0.0);
            drive_to(&mut manager, (step, u32::from(step >= new_from)), at, &scan(at.x_m));
        }
        manager
    }

    /// Gives a manager the scan with this sequence in this trajectory, taken there.
    pub(crate) fn drive_to(
        manager: &mut SyncManager,
        (sequence, trajectory): (u64, u32),
        at: Pose,
        scan: &ScanBuffer,
    ) {
        let mut pose =
            PoseEstimate { flags: PoseFlags::MATCHED | PoseFlags::INSERT, ..PoseEstimate::default() };
        (pose.id.sequence, pose.odom_from_base, pose.trajectory) = (sequence, at, trajectory);
        manager.pose(&pose);
        manager.node(scan.view().unwrap(), &pose, &[]);
    }

    #[test]
    fn nodes_passed_over_are_half_a_metre_apart_between_two_searches() {
        let manager = driven(u64::MAX);
        let nodes = manager.odometry.nodes();
        let query = nodes.len() - 1;
        let behind_m = |node: &usize| nodes[query].travel_m - nodes[*node].travel_m;
        let behind_m: Vec<f64> = manager.passed_over(query).iter().map(behind_m).collect();
        assert_eq!(behind_m.len(), 2, "{behind_m:?}");
        assert!((0.5..0.75).contains(&behind_m[0]), "{behind_m:?}");
        assert!((0.5..0.75).contains(&(behind_m[1] - behind_m[0])) && behind_m[1] < EVERY_M, "{behind_m:?}");
        assert_eq!(manager.passed_over(0), [0; 0]);
    }

    #[test]
    fn nodes_of_an_earlier_trajectory_are_not_passed_over() {
        let manager = driven(12);
        let nodes = manager.odometry.nodes();
        assert_eq!((nodes[0].trajectory, nodes[nodes.len() - 1].trajectory), (0, 1));
        assert_eq!(manager.passed_over(nodes.len() - 1), [0; 0]);
    }
}

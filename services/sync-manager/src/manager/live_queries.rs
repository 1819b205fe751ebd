//! The state of the back end for readers while it works.

use super::SyncManager;
use super::final_solution::placed;
use flockslam_geometry::Pose;
use flockslam_loop_closure::closure::Closure;
use flockslam_map_fusion::PlacedSubmap;
use std::collections::BTreeMap;

impl SyncManager {
    /// Closed loops in the present solution: x and y of both ends, metres; then 1 for an inlier, else 0.
    pub fn loops(&self) -> Vec<[f64; 5]> {
        let ends = |(closure, is_inlier): (&Closure, &bool)| {
            let (from, to) = (self.poses.get(closure.edge.from)?, self.poses.get(closure.edge.to)?);
            Some([from.x_m, from.y_m, to.x_m, to.y_m, f64::from(u8::from(*is_inlier))])
        };
        self.closures.iter().zip(&self.is_inlier).filter_map(ends).collect()
    }

    /// Where the mapper's submaps lie in the present solution, by number: each as the node in its middle says. Those that nothing
    /// but driving connects with the map are left out.
    pub fn submap_poses(&self) -> Vec<PlacedSubmap> {
        let connectivity = self.connectivity(self.poses.len());
        let nodes: Vec<(u32, usize)> = self
            .kept
            .iter()
            .filter(|k| k.is_node && k.node < self.poses.len())
            .filter(|k| connectivity.is_attached(self.records[k.record].trajectory))
            .map(|k| (self.records[k.record].submap, k.node))
            .collect();
        let place = |group: &[(u32, usize)]| {
            let (number, node) = group[group.len() / 2];
            if self.odometry.nodes()[node].is_given {
                return (number, Pose::IDENTITY);
            }
            let map_from_odom = self.poses[node].compose(self.odometry.nodes()[node].odom.inverse()).pose();
            (number, map_from_odom)
        };
        let mut submaps: BTreeMap<u32, Pose> =
            self.frozen_poses().map(|(number, at)| (number, at.pose())).collect();
        submaps.extend(nodes.chunk_by(|a, b| a.0 == b.0).map(place));
        submaps.retain(|number, _| self.is_of_map(*number));
        placed(submaps)
    }
}

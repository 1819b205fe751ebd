//! The solution: poses of scans and submaps from those of the nodes.

use super::SyncManager;
use crate::pose_record::PoseRecord;
use crate::solution::{PlacedScan, Solution};
use flockslam_geometry::Pose;
use flockslam_loop_closure::connectivity::TrajectoryConnectivity;
use flockslam_map_fusion::PlacedSubmap;
use flockslam_registration::cloud::Placement;
use std::collections::BTreeMap;

impl SyncManager {
    /// The solution with these poses for all records, turned so that the first of the map is where the front end put it.
    pub(super) fn solution(&self, poses: &[Placement]) -> Solution {
        let connectivity = self.connectivity(self.odometry.nodes().len());
        let begin = self.records.iter().position(|r| connectivity.is_attached(r.trajectory)).unwrap_or(0);
        let gauge = match (self.records.get(begin), poses.get(begin)) {
            (Some(record), Some(pose)) => record.odom.compose(pose.inverse()),
            _ => Placement::IDENTITY,
        };
        let poses: Vec<Placement> = poses.iter().map(|pose| gauge.compose(*pose)).collect();
        let place = |(record, pose): (&PoseRecord, &Placement)| PlacedScan {
            id: record.id,
            stamp_ns: record.stamp_ns,
            map_from_base: pose.pose(),
        };
        let mut submaps: BTreeMap<u32, Pose> =
            self.frozen_poses().map(|(number, at)| (number, gauge.compose(at).pose())).collect();
        submaps.extend(self.place_submaps(&poses, &connectivity));
        let anchors = self.odometry.nodes().iter().zip(&self.poses);
        Solution {
            trajectory: self.records.iter().zip(&poses).map(place).collect(),
            anchors: anchors.map(|(node, at)| (node.sequence, gauge.compose(*at).pose())).collect(),
            submaps: placed(submaps),
            closures: self.counts(&connectivity),
        }
    }

    /// Each submap of the mapper that is part of the map goes where the median of its scans' corrections takes the one in
    /// its middle.
    pub(super) fn place_submaps(
        &self,
        poses: &[Placement],
        connectivity: &TrajectoryConnectivity,
    ) -> Vec<(u32, Pose)> {
        let mut submaps = Vec::new();
        let certain = |(record, _): &(&PoseRecord, &Placement)| {
            !record.lost && connectivity.is_attached(record.trajectory)
        };
        let scans: Vec<(&PoseRecord, &Placement)> = self.records.iter().zip(poses).filter(certain).collect();
        for group in scans.chunk_by(|a, b| a.0.submap == b.0.submap) {
            let middle = group[group.len() / 2].0;
            let carried =
                |(record, pose): &(&PoseRecord, &Placement)| pose.compose(record.odom.to(middle.odom));
            let carried: Vec<Placement> = group.iter().map(carried).collect();
            let map_from_odom = median(&carried).compose(middle.odom.inverse()).pose();
            submaps.push((middle.submap, map_from_odom));
        }
        submaps
    }
}

pub(super) fn placed(submaps: BTreeMap<u32, Pose>) -> Vec<PlacedSubmap> {
    let place = |(number, map_from_odom)| PlacedSubmap { number, map_from_odom };
    submaps.into_iter().map(place).collect()
}

/// The median of poses that are close together, coordinate by coordinate.
fn median(poses: &[Placement]) -> Placement {
    let near = poses[poses.len() / 2];
    let middle = |pick: fn(&Placement) -> f64| {
        let mut values: Vec<f64> = poses.iter().map(|pose| pick(&near.to(*pose))).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    near.compose(Placement::new(middle(|p| p.x_m), middle(|p| p.y_m), middle(|p| p.heading_rad)))
}

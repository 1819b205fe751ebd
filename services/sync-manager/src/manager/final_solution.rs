//! The solution: poses of scans and submaps from those of the nodes.

use super::SyncManager;
use crate::pose_record::PoseRecord;
use crate::solution::{DetachedPart, PlacedScan, Solution};
use flockslam_geometry::Pose;
use flockslam_loop_closure::connectivity::TrajectoryConnectivity;
use flockslam_loop_closure::finder::ClosureFinder;
use flockslam_loop_closure::open_finder::OpenFinder;
use flockslam_loop_closure::scans::ScanStore;
use flockslam_map_fusion::PlacedSubmap;
use flockslam_registration::cloud::Placement;
use std::collections::BTreeMap;

impl SyncManager {
    /// Frees the points of all scans and what searches keep: nothing needs them once the run is concluded. No scan may be given afterwards.
    pub fn drop_scans(&mut self) {
        self.scans = ScanStore::default();
        self.finder = ClosureFinder::default();
        self.open_finder = OpenFinder::default();
    }

    /// The solution with these poses for all records, turned so that the first of the map is where the front end put it.
    pub(super) fn solution(&self, poses: &[Placement]) -> Solution {
        let connectivity = self.connectivity(self.odometry.nodes().len());
        let begin = self.records.iter().position(|r| connectivity.is_attached(r.trajectory)).unwrap_or(0);
        let is_given = self.records.first().is_some_and(|record| record.is_given);
        let gauge = match (self.records.get(begin), poses.get(begin)) {
            // The frame of an imported map stays the frame.
            _ if is_given => Placement::IDENTITY,
            (Some(record), Some(pose)) => record.odom.compose(pose.inverse()),
            _ => Placement::IDENTITY,
        };
        let poses: Vec<Placement> = poses.iter().map(|pose| gauge.compose(*pose)).collect();
        let mut submaps: BTreeMap<u32, Pose> =
            self.frozen_poses().map(|(number, at)| (number, gauge.compose(at).pose())).collect();
        submaps.retain(|number, _| self.is_of_map(*number));
        submaps.extend(self.place_submaps(&poses, |trajectory| connectivity.is_attached(trajectory)));
        let driven = self.records.iter().zip(&poses).filter(|(record, _)| !record.is_given);
        let anchors = self.odometry.nodes().iter().zip(&self.poses);
        Solution {
            trajectory: driven.map(placed_scan).collect(),
            anchors: anchors.map(|(node, at)| (node.sequence, gauge.compose(*at).pose())).collect(),
            submaps: placed(submaps),
            closures: self.counts(&connectivity),
            detached: self.detached(&poses, &connectivity),
        }
    }

    /// The parts of the drive that nothing connects with the map, the longest first.
    fn detached(&self, poses: &[Placement], connectivity: &TrajectoryConnectivity) -> Vec<DetachedPart> {
        let mut numbers: Vec<u32> = self.records.iter().map(|record| record.trajectory).collect();
        numbers.dedup();
        let is_first = |number: &u32| connectivity.part(*number) == *number;
        let apart = numbers.iter().filter(|number| is_first(number) && !connectivity.is_attached(**number));
        let mut parts: Vec<DetachedPart> =
            apart.map(|number| self.part(poses, connectivity, *number)).collect();
        parts.sort_by(|a, b| b.scans.len().cmp(&a.scans.len()).then(a.trajectory.cmp(&b.trajectory)));
        parts
    }

    fn part(
        &self,
        poses: &[Placement],
        connectivity: &TrajectoryConnectivity,
        trajectory: u32,
    ) -> DetachedPart {
        let belongs = |number: u32| connectivity.part(number) == trajectory;
        let own: Vec<(&PoseRecord, &Placement)> =
            self.records.iter().zip(poses).filter(|(record, _)| belongs(record.trajectory)).collect();
        let together = own.windows(2).filter(|pair| pair[0].0.trajectory == pair[1].0.trajectory);
        DetachedPart {
            trajectory,
            travel_m: together.map(|pair| pair[0].1.distance_m(pair[1].1)).sum(),
            scans: own.into_iter().map(placed_scan).collect(),
            submaps: placed(self.place_submaps(poses, belongs).into_iter().collect()),
        }
    }

    /// Each submap of the mapper with scans of trajectories that `belongs` names goes where the median of its scans' corrections takes the one in
    /// its middle.
    pub(super) fn place_submaps(
        &self,
        poses: &[Placement],
        belongs: impl Fn(u32) -> bool,
    ) -> Vec<(u32, Pose)> {
        let mut submaps = Vec::new();
        let certain = |(record, _): &(&PoseRecord, &Placement)| !record.lost && belongs(record.trajectory);
        let scans: Vec<(&PoseRecord, &Placement)> = self.records.iter().zip(poses).filter(certain).collect();
        for group in scans.chunk_by(|a, b| a.0.submap == b.0.submap) {
            if !self.is_of_map(group[0].0.submap) {
                continue;
            }
            let middle = group[group.len() / 2].0;
            if middle.is_given {
                submaps.push((middle.submap, Pose::IDENTITY));
                continue;
            }
            let carried =
                |(record, pose): &(&PoseRecord, &Placement)| pose.compose(record.odom.to(middle.odom));
            let carried: Vec<Placement> = group.iter().map(carried).collect();
            let map_from_odom = median(&carried).compose(middle.odom.inverse()).pose();
            submaps.push((middle.submap, map_from_odom));
        }
        submaps
    }
}

fn placed_scan((record, pose): (&PoseRecord, &Placement)) -> PlacedScan {
    PlacedScan { id: record.id, stamp_ns: record.stamp_ns, map_from_base: pose.pose() }
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

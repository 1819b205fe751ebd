//! What keeps the back end bounded: a stretch through a place that is known well is not kept. Its scans get their poses once
//! and for all, relative to a node that stays, and its nodes leave the graph.

use super::placed_stretch::Stretch;
use super::{FINAL_NODES, SyncManager};
use crate::filled_trajectory::{Between, filled};
use crate::solution::FrozenScan;
use flockslam_loop_closure::agreement::WIDE_M;
use flockslam_loop_closure::finder::window;
use flockslam_loop_closure::graph_distances::graph_distances_to;
use flockslam_loop_closure::place::Placer;
use flockslam_pose_graph::Symmetric;
use flockslam_registration::cloud::Placement;
use std::ops::Range;

/// How many stretches through the same place, in the same direction, stay in the graph: later ones are frozen relative to them, which
/// keeps memory and work bounded in a building that is known. Enough to hold the others in place, few enough to stay cheap to solve: with
/// two, the final trajectory of Intel is off by 1.5 % more.
const VISITS_KEPT: usize = 3;
/// Nodes less than this back are never frozen, metres of travel: loops that they may close are still searched.
const HORIZON_M: f64 = 60.0;
/// Stretches are of the same place and direction when their middles are closer than this, metres and radians: half of what the
/// middles of successive ones are apart, so that each visit counts once.
const SAME: (f64, f64) = (2.6, 0.6);
/// How well the ends of a stretch that was taken out are known to each other (information): 5 cm and 0.01 rad each.
const BRIDGE: Symmetric = [400.0, 0.0, 0.0, 400.0, 0.0, 1e4];
/// Share of the kept points that may belong to scans that have left before they are cleared away.
const WASTE: f64 = 0.12;

/// Where a submap of the mapper is whose scans are frozen: relative to the node with this sequence.
#[derive(Clone, Copy, Debug)]
pub(super) struct FrozenSubmap {
    pub(super) anchor: u64,
    pub(super) anchor_from_odom: Placement,
}

impl SyncManager {
    /// Freezes the stretches that have passed the horizon through places that enough older ones cover.
    pub(super) fn freeze(&mut self, known: usize) {
        let Some(newest_m) = known.checked_sub(1).map(|last| self.odometry.nodes()[last].travel_m) else {
            return;
        };
        while let Some(segment) = self.segments.get(self.next_frozen) {
            let nodes = segment.nodes.clone();
            if newest_m - self.odometry.nodes()[nodes.end - 1].travel_m < HORIZON_M {
                break;
            }
            if self.odometry.nodes()[nodes.start].is_given {
                // What is imported is no drive.
                self.next_frozen += 1;
                continue;
            }
            match self.host(self.next_frozen) {
                Some(host) => self.freeze_segment(self.next_frozen, host),
                None => self.next_frozen += 1,
            }
        }
        if self.gone_scans as f64 > WASTE * self.scans.len() as f64 {
            self.clear_away();
        }
    }

    /// The node that a stretch is frozen at: the nearest of those older stretches that cover its place, if there are enough, and if
    /// closures hold the two together. Otherwise they may only seem to be of one place: a later solution that moves them apart would
    /// carry what is frozen away from its neighbours.
    fn host(&self, number: usize) -> Option<usize> {
        let segment = &self.segments[number];
        let connectivity = self.connectivity(self.poses.len());
        let part = |node: usize| connectivity.part(self.odometry.nodes()[node].trajectory);
        let middle = self.poses[segment.anchor];
        let same = |older: &&flockslam_loop_closure::segment::Segment| {
            let at = &self.poses[older.anchor];
            at.distance_m(&middle) < SAME.0
                && at.turn_rad(&middle) < SAME.1
                && part(older.anchor) == part(segment.anchor)
        };
        let covering: Vec<usize> = self.segments[..number].iter().filter(same).map(|s| s.anchor).collect();
        let away_m = |node: &usize| self.poses[*node].distance_m(&middle);
        let nearest = covering.iter().min_by(|a, b| away_m(a).total_cmp(&away_m(b)));
        let host = nearest.copied().filter(|_| covering.len() >= VISITS_KEPT)?;
        self.holds_together(segment.anchor, host).then_some(host)
    }

    /// Whether so little of the graph is between two nodes that a loop from one to the other would be looked for in a narrow window.
    fn holds_together(&self, a: usize, b: usize) -> bool {
        let known = self.poses.len();
        let (nodes, connections) = (&self.odometry.nodes()[..known], self.connections(known));
        let distance_m = graph_distances_to(nodes, &connections, a, &[b])[b];
        window(distance_m).reach_m <= WIDE_M
    }

    /// Gives the scans of a segment their poses relative to the node `host`, and takes its nodes out of the graph.
    fn freeze_segment(&mut self, number: usize, host: usize) {
        let nodes = self.segments[number].nodes.clone();
        let kept = self.kept_of(&nodes);
        let records = self.kept[kept.start].record..self.kept[kept.end].record;
        let poses = self.placed_records(&kept, &records);
        let (anchor, host_pose) = (self.odometry.nodes()[host].sequence, self.poses[host]);
        for (record, pose) in self.records[records.clone()].iter().zip(&poses) {
            let anchor_from_base = host_pose.to(*pose);
            self.frozen.push(FrozenScan {
                id: record.id,
                stamp_ns: record.stamp_ns,
                anchor,
                anchor_from_base: anchor_from_base.pose(),
            });
            if !record.lost && !self.retired_submaps.contains(&record.submap) {
                let anchor_from_odom = anchor_from_base.compose(record.odom.inverse());
                self.frozen_submaps.insert(record.submap, FrozenSubmap { anchor, anchor_from_odom });
            }
        }
        self.remove(number, &nodes, &kept, &records);
    }

    /// The kept scans from the first of these nodes up to the node behind the last.
    fn kept_of(&self, nodes: &Range<usize>) -> Range<usize> {
        let at = |node: usize| self.kept.partition_point(|k| k.node < node);
        at(nodes.start)..at(nodes.end)
    }

    /// Final poses of these records, whose kept scans these are; the next kept scan behind them is a node.
    fn placed_records(&mut self, kept: &Range<usize>, records: &Range<usize>) -> Vec<Placement> {
        let (first, next) = (records.start, self.kept[kept.end]);
        let stretch = self.kept[kept.start..=kept.end].iter();
        let nodes: Vec<_> =
            stretch.filter(|k| k.is_node).map(|k| (k.record - first, self.poses[k.node])).collect();
        let placer = Placer {
            nodes: self.odometry.nodes(),
            scans: &self.scans,
            poses: &self.poses,
            reach: FINAL_NODES,
        };
        let stretch = Stretch {
            first: (first, self.kept[kept.start].node),
            records: &self.records[first..=next.record],
            kept: &self.kept[kept.clone()],
            nodes: &nodes,
        };
        let mut pairs = stretch.placed(&placer, self.finder.scratch());
        pairs.push((next.record - first, self.poses[next.node]));
        let mut poses = filled(&self.records[first..=next.record], &pairs, Between::Measured);
        poses.truncate(records.len());
        poses
    }

    fn remove(&mut self, number: usize, nodes: &Range<usize>, kept: &Range<usize>, records: &Range<usize>) {
        self.move_entries(nodes);
        self.odometry.take_out(nodes.clone(), &self.poses, BRIDGE);
        self.poses.drain(nodes.clone());
        self.walls.take_out(nodes.clone());
        self.gone_scans += kept.len();
        self.kept.drain(kept.clone());
        self.records.drain(records.clone());
        for later in &mut self.kept[kept.start..] {
            later.record -= records.len();
            later.node -= nodes.len();
        }
        self.segments.remove(number);
        for later in &mut self.segments[number..] {
            later.nodes = later.nodes.start - nodes.len()..later.nodes.end - nodes.len();
            later.anchor -= nodes.len();
        }
        let stays = |node: usize| !nodes.contains(&node);
        let renamed = |node: usize| if node < nodes.start { node } else { node - nodes.len() };
        let is_inlier = std::mem::take(&mut self.is_inlier);
        let closures = std::mem::take(&mut self.closures);
        for (mut closure, is_inlier) in closures.into_iter().zip(is_inlier) {
            let edge = &mut closure.edge;
            if stays(edge.from) && stays(edge.to) {
                (edge.from, edge.to) = (renamed(edge.from), renamed(edge.to));
                self.closures.push(closure);
                self.is_inlier.push(is_inlier);
            } else {
                self.frozen_closures += 1;
            }
        }
    }

    /// Frees the memory of scans that have left.
    fn clear_away(&mut self) {
        let mut wanted = vec![false; self.scans.len()];
        self.kept.iter().for_each(|k| wanted[k.scan] = true);
        let renamed = self.scans.retain(&wanted);
        self.kept.iter_mut().for_each(|k| k.scan = renamed[k.scan]);
        self.odometry.rename_scans(&renamed);
        self.gone_scans = 0;
    }

    /// Scans that were frozen since the last call, in order: the caller keeps them.
    pub fn take_frozen(&mut self) -> Vec<FrozenScan> {
        std::mem::take(&mut self.frozen)
    }

    /// Poses of submaps whose scans are all frozen, in the present solution.
    pub(super) fn frozen_poses(&self) -> impl Iterator<Item = (u32, Placement)> + '_ {
        let (nodes, connectivity) = (self.odometry.nodes(), self.connectivity(self.poses.len()));
        self.frozen_submaps.iter().filter_map(move |(number, frozen)| {
            let node = nodes.partition_point(|node| node.sequence < frozen.anchor);
            let attached = connectivity.is_attached(nodes[node].trajectory);
            attached.then(|| (*number, self.poses[node].compose(frozen.anchor_from_odom)))
        })
    }

    /// Nodes, records and scans that are held in memory.
    pub fn held(&self) -> (usize, usize, usize) {
        (self.odometry.nodes().len(), self.records.len(), self.scans.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Settings;
    use crate::manager::loop_search::tests::drive_to;
    use flockslam_geometry::Pose;
    use flockslam_messages::{ScanBuffer, ScanId, SubmapClosed};

    /// Ranges from a pose in a room of 14 m × 11 m.
    fn scan(at: Pose) -> ScanBuffer {
        let range_m = |degrees: i32| {
            let (y, x) = (at.heading_rad + f64::from(degrees).to_radians()).sin_cos();
            ((7.0 - at.x_m * x.signum()) / x.abs()).min((5.5 - at.y_m * y.signum()) / y.abs()) as f32
        };
        ScanBuffer::from_ranges(&(0..360).map(range_m).collect::<Vec<_>>(), 0.0, 1f64.to_radians())
    }

    /// Scans that are frozen on a drive of 250 m along a circle of 25 m.
    fn frozen(close_loops: bool) -> usize {
        let mut manager = SyncManager::new(Settings { close_loops, ..Settings::default() });
        for sequence in 0..800 {
            let angle_rad = sequence as f64 * std::f64::consts::TAU / 80.0;
            let heading_rad = angle_rad + std::f64::consts::FRAC_PI_2;
            let at = Pose::new(4.0 * angle_rad.cos(), 4.0 * angle_rad.sin(), heading_rad);
            drive_to(&mut manager, (sequence, 0), at, &scan(at));
            if sequence % 16 == 15 {
                let last = ScanId { sequence, ..ScanId::default() };
                manager.submap_closed(&SubmapClosed { last, ..SubmapClosed::default() });
            }
        }
        manager.take_frozen().len()
    }

    #[test]
    fn only_stretches_that_closures_hold_together_are_frozen() {
        assert_eq!(frozen(false), 0);
        assert!(frozen(true) > 100);
    }
}

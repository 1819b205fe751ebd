//! Poses of the kept scans of a stretch from those of its nodes: by their own points.

use super::Kept;
use super::mid_scan_poses::{Sample, at_stamps};
use crate::filled_trajectory::{Between, filled};
use crate::pose_record::PoseRecord;
use flockslam_loop_closure::place::{DROPPED_MOVE_MAX, KeptScan, MATCHED_MOVE_MAX, Placer};
use flockslam_registration::cloud::{MomentGrid, Placement};

/// A stretch of the drive whose nodes have their final poses.
pub(super) struct Stretch<'a> {
    /// Numbers of its first record and its first node among all.
    pub first: (usize, usize),
    /// Its records.
    pub records: &'a [PoseRecord],
    /// The scans kept of it. Before the first node are those that were taken before all nodes.
    pub kept: &'a [Kept],
    /// Its nodes: the number of the record in `records`, and the pose.
    pub nodes: &'a [(usize, Placement)],
}

impl Stretch<'_> {
    /// The kept scans, as (record, pose) in order. First those that the front end has matched; where these lie tells best where those
    /// between them are, which it has not. `grid` is lent empty and given back so.
    pub fn placed(&self, placer: &Placer<'_>, grid: &mut MomentGrid) -> Vec<(usize, Placement)> {
        let record = |kept: &Kept| kept.record - self.first.0;
        let (matched, dropped): (Vec<Kept>, Vec<Kept>) = self.kept.iter().partition(|kept| kept.is_matched);
        let mut place = |kept: &[Kept], expected: Vec<KeptScan>| {
            let placed = kept.iter().zip(placer.place_all(&expected, grid));
            let sample =
                |(kept, pose): (&Kept, Placement)| Sample { record: record(kept), pose, middle: kept.middle };
            placed.map(sample).collect::<Vec<_>>()
        };
        let mut samples = place(&matched, self.expected(&matched));
        if !dropped.is_empty() {
            let between = filled(self.records, &at_stamps(self.records, &samples), Between::Measured);
            let expect = |kept: &Kept| kept.expected([between[record(kept)]; 2]);
            samples.extend(place(&dropped, dropped.iter().map(expect).collect()));
            samples.sort_by_key(|sample| sample.record);
        }
        at_stamps(self.records, &samples)
    }

    /// Where scans that the front end has matched are expected: by its path between the nodes around them, and, should that have
    /// jumped, straight between these.
    fn expected(&self, kept: &[Kept]) -> Vec<KeptScan> {
        let (first_record, first_node) = self.first;
        let guesses = filled(self.records, self.nodes, Between::FrontEnd);
        let (records, nodes) = (self.records, self.nodes);
        let straight = |record: usize, node: usize| match (nodes.get(node), nodes.get(node + 1)) {
            (Some(&(start, from)), Some(&(end, to)))
                if start <= record && records[start].trajectory == records[end].trajectory =>
            {
                from.interpolate(&to, (record - start) as f64 / (end - start) as f64)
            }
            _ => guesses[record],
        };
        let expect = |kept: &Kept| {
            let record = kept.record - first_record;
            kept.expected([guesses[record], straight(record, kept.node - first_node)])
        };
        kept.iter().map(expect).collect()
    }
}

impl Kept {
    fn expected(&self, guesses: [Placement; 2]) -> KeptScan {
        let move_max = if self.is_matched { MATCHED_MOVE_MAX } else { DROPPED_MOVE_MAX };
        KeptScan { scan: self.scan, guesses, move_max, node: self.node, is_node: self.is_node }
    }
}

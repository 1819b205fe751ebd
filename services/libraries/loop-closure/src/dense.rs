//! The dense pass: matches each node to all segments near it and solves the graph of these matches. Takes poses that loops have brought close, gives
//! better ones.

use crate::connectivity::TrajectoryConnectivity;
use crate::node::Node;
use crate::scans::ScanStore;
use crate::segment::Segment;
use crate::segment_matcher::{ROBUST, SegmentMatcher};
use flockslam_pose_graph::{Edge, solve};
use flockslam_registration::cloud::{MomentGrid, Placement};

/// Segments within this of a node are matched to, metres.
const NEAR_M: f64 = 3.0;
/// Most segments that a node is matched to. With four, poses in places seen only twice are worse: what the segments share counts more than once.
const SEGMENTS_MAX: usize = 2;
/// Errors of a match beyond those of its points.
const SLACK: (f64, f64) = (0.04, 0.01);

/// Re-measures the whole solution once loops have brought it close: each node against the segments near it, in
/// place of the loops.
pub struct DensePass<'a> {
    /// The nodes.
    pub nodes: &'a [Node],
    /// Their points.
    pub scans: &'a ScanStore,
    /// All segments, none missing.
    pub segments: &'a [Segment],
    /// The odometry edges.
    pub odometry: &'a [Edge],
    /// Constraints of nodes that are not matched again, those in the open and of an imported map: they stay.
    pub constraints: &'a [Edge],
    /// Which trajectories are connected: only among those does nearness mean anything.
    pub connectivity: &'a TrajectoryConnectivity,
}

impl DensePass<'_> {
    /// Measures and solves, from the poses given to the poses left.
    pub fn run(&self, grid: &mut MomentGrid, poses: &mut [Placement]) {
        let mut edges = self.odometry.to_vec();
        edges.extend_from_slice(self.constraints);
        let wanted = self.pairs(poses);
        let matcher = SegmentMatcher::new(self.nodes, self.scans, SLACK);
        for (segment, nodes) in self.segments.iter().zip(wanted).filter(|(_, nodes)| !nodes.is_empty()) {
            edges.extend(matcher.constraints(grid, segment, nodes, |node| poses[node]));
        }
        solve(self.nodes.len(), &edges, self.odometry.len(), &ROBUST, poses);
    }

    /// For each segment the nodes to match to it.
    fn pairs(&self, poses: &[Placement]) -> Vec<Vec<usize>> {
        let mut pairs = vec![Vec::new(); self.segments.len()];
        let part = |node: usize| self.connectivity.part(self.nodes[node].trajectory);
        for (node, at) in poses.iter().enumerate().filter(|(node, _)| !self.nodes[*node].is_held()) {
            let mut near: Vec<(f64, usize)> = Vec::new();
            for (number, segment) in self.segments.iter().enumerate() {
                // The node's own segment and the one before it were matched by the odometry already.
                if segment.nodes.contains(&node)
                    || (segment.nodes.end..segment.nodes.end + segment.nodes.len()).contains(&node)
                {
                    continue;
                }
                if part(node) != part(segment.anchor) {
                    continue;
                }
                // Nodes of a segment lie within its length of the anchor.
                if poses[segment.anchor].distance_m(at) > NEAR_M + 6.0 {
                    continue;
                }
                let nodes = segment.nodes.clone();
                let apart_m = nodes.map(|i| poses[i].distance_m(at)).fold(f64::INFINITY, f64::min);
                if apart_m <= NEAR_M {
                    near.push((apart_m, number));
                }
            }
            near.sort_by(|a, b| a.0.total_cmp(&b.0));
            near.iter().take(SEGMENTS_MAX).for_each(|&(_, number)| pairs[number].push(node));
        }
        pairs
    }
}

//! The dense pass: matches each node to all segments near it and solves the graph of these matches. Takes poses that loops have brought close, gives
//! better ones.

use crate::connectivity::TrajectoryConnectivity;
use crate::node::{Node, POINT_INFORMATION};
use crate::scans::ScanStore;
use crate::segment::{Segment, load, unload};
use flockslam_pose_graph::Edge;
use flockslam_pose_graph::{RobustSettings, solve};
use flockslam_pose_graph::{in_frame, inflated};
use flockslam_registration::cloud::{AlignSettings, Aligner, MomentGrid, Placement};

/// Segments within this of a node are matched to, metres.
const NEAR_M: f64 = 3.0;
/// Most segments that a node is matched to.
const SEGMENTS_MAX: usize = 4;
/// Share of points on lines that a match needs.
const INLIERS_MIN: f64 = 0.5;
/// Farthest that a match may move, metres and radians.
const MOVE_MAX: (f64, f64) = (0.4, 0.1);
/// Errors of a match beyond those of its points.
const SLACK: (f64, f64) = (0.04, 0.01);
/// Squared Mahalanobis error from which a match is an outlier.
const CHI_SQUARED_MAX: f64 = 25.0;

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
        let aligner = Aligner::new(AlignSettings { gate_wide_m: 0.4, ..AlignSettings::default() });
        for (segment, nodes) in self.segments.iter().zip(&wanted) {
            if nodes.is_empty() {
                continue;
            }
            load(grid, self.nodes, self.scans, segment.nodes.clone(), |i| poses[i]);
            edges.extend(nodes.iter().filter_map(|&node| self.measure(&aligner, grid, segment, node, poses)));
            unload(grid, self.nodes, self.scans, segment.nodes.clone(), |i| poses[i]);
        }
        let settings =
            RobustSettings { chi_squared_max: CHI_SQUARED_MAX, growth: 2.0, rounds: 12, warm_up: 2 };
        solve(self.nodes.len(), &edges, self.odometry.len(), &settings, poses);
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

    fn measure(
        &self,
        aligner: &Aligner,
        grid: &mut MomentGrid,
        segment: &Segment,
        node: usize,
        poses: &[Placement],
    ) -> Option<Edge> {
        let guess = poses[node];
        let points = self.scans.points(self.nodes[node].scan);
        let found = aligner.align(grid, points, guess)?;
        let moved = (found.placement.distance_m(&guess), found.placement.turn_rad(&guess));
        if found.inliers < INLIERS_MIN || moved.0 > MOVE_MAX.0 || moved.1 > MOVE_MAX.1 {
            return None;
        }
        let nearest = segment
            .nodes
            .clone()
            .min_by(|&a, &b| poses[a].distance_m(&guess).total_cmp(&poses[b].distance_m(&guess)))?;
        let from = poses[nearest];
        let mut information = found.information.map(|v| POINT_INFORMATION * v);
        // A direction that the points leave open must not make the matrix singular.
        [0, 3, 5].into_iter().for_each(|i| information[i] += 1.0);
        let information = inflated(&information, SLACK.0, SLACK.1)?;
        Some(Edge {
            from: nearest,
            to: node,
            motion: from.to(found.placement),
            information: in_frame(&information, &from),
        })
    }
}

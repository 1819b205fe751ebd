//! Matches nodes to a segment of the trajectory near them: takes where they are expected, gives constraints with their information.

use crate::node::{Node, POINT_INFORMATION};
use crate::scans::ScanStore;
use crate::segment::{Segment, load, unload};
use flockslam_pose_graph::{Edge, RobustSettings, in_frame, inflated};
use flockslam_registration::cloud::{AlignSettings, Aligner, MomentGrid, Placement};

/// Share of points on lines that a match needs.
const INLIERS_MIN: f64 = 0.5;
/// Farthest that a match may move, metres and radians.
const MOVE_MAX: (f64, f64) = (0.4, 0.1);
/// How graphs of such matches are solved: a match whose squared Mahalanobis error exceeds 25 is an outlier.
pub(crate) const ROBUST: RobustSettings =
    RobustSettings { chi_squared_max: 25.0, growth: 2.0, rounds: 12, warm_up: 2 };

/// Matches nodes to segments near them.
pub(crate) struct SegmentMatcher<'a> {
    nodes: &'a [Node],
    scans: &'a ScanStore,
    /// Errors of a match beyond those of its points: the segment's own bending, metres and radians.
    slack: (f64, f64),
    aligner: Aligner,
}

impl<'a> SegmentMatcher<'a> {
    pub(crate) fn new(nodes: &'a [Node], scans: &'a ScanStore, slack: (f64, f64)) -> Self {
        let aligner = Aligner::new(AlignSettings { gate_wide_m: 0.4, ..AlignSettings::default() });
        Self { nodes, scans, slack, aligner }
    }

    /// The constraints from `segment` to those of `nodes` that match, all nodes being where `at` has them. `grid` is empty before and after.
    pub(crate) fn constraints(
        &self,
        grid: &mut MomentGrid,
        segment: &Segment,
        nodes: impl IntoIterator<Item = usize>,
        at: impl Fn(usize) -> Placement + Copy,
    ) -> Vec<Edge> {
        load(grid, self.nodes, self.scans, segment.nodes.clone(), at);
        let found = nodes.into_iter().filter_map(|node| self.constraint(grid, segment, node, at)).collect();
        unload(grid, self.nodes, self.scans, segment.nodes.clone(), at);
        found
    }

    fn constraint(
        &self,
        grid: &mut MomentGrid,
        segment: &Segment,
        node: usize,
        at: impl Fn(usize) -> Placement,
    ) -> Option<Edge> {
        let guess = at(node);
        let found = self.aligner.align(grid, self.scans.points(self.nodes[node].scan), guess)?;
        let moved = (found.placement.distance_m(&guess), found.placement.turn_rad(&guess));
        if found.inliers < INLIERS_MIN || moved.0 > MOVE_MAX.0 || moved.1 > MOVE_MAX.1 {
            return None;
        }
        let apart_m = |node: usize| at(node).distance_m(&guess);
        let nearest = segment.nodes.clone().min_by(|&a, &b| apart_m(a).total_cmp(&apart_m(b)))?;
        let from = at(nearest);
        let mut information = found.information.map(|v| POINT_INFORMATION * v);
        // A direction that the points leave open must not make the matrix singular.
        [0, 3, 5].into_iter().for_each(|i| information[i] += 1.0);
        let information = inflated(&information, self.slack.0, self.slack.1)?;
        Some(Edge {
            from: nearest,
            to: node,
            motion: from.to(found.placement),
            information: in_frame(&information, &from),
        })
    }
}

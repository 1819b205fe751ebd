//! The refinement of all poses against the map that all nodes make together: matches each node to it, solves the graph, and repeats.

use crate::node::{Node, POINT_INFORMATION};
use crate::scans::ScanStore;
use flockslam_pose_graph::Edge;
use flockslam_pose_graph::{RobustSettings, solve};
use flockslam_pose_graph::{in_frame, inflated};
use flockslam_registration::cloud::{
    AlignSettings, Aligner, Alignment, MomentGrid, PackedPoint, PlacedPoint, Placement,
};
use std::collections::BTreeMap;

/// Side of the squares that scans are matched in together, metres: around each, all points within reach fit on a grid's torus. In larger ones
/// fewer points are brought in several times.
const SQUARE_M: f64 = 16.0;
/// Points are in reach of a square within this of its centre along both axes, metres: a scan in a corner of it has all points near its own.
const REACH_M: f64 = 29.4;
/// Side of the squares in whose order matches come, metres.
const ORDER_M: f64 = 8.0;
/// Share of points on lines that a match needs.
const INLIERS_MIN: f64 = 0.5;
/// Largest root mean square distance of those from their lines, metres.
const SPREAD_MAX_M: f64 = 0.055;
/// Farthest that a match may move, metres and radians.
const MOVE_MAX: (f64, f64) = (0.15, 0.06);
/// Errors of a match beyond those of its points: the map that it is matched to is itself a little wrong.
const SLACK: (f64, f64) = (0.02, 0.005);
/// Squared Mahalanobis error from which a match is an outlier.
const CHI_SQUARED_MAX: f64 = 25.0;

/// Matches scans to the map that all of them make together, in place of the few around each.
///
/// Alternates between the map as the points of all nodes at their poses, and the poses as what fits this map best, held together
/// by the odometry.
pub struct Refinement<'a> {
    /// The nodes.
    pub nodes: &'a [Node],
    /// Their points.
    pub scans: &'a ScanStore,
    /// The odometry edges.
    pub odometry: &'a [Edge],
    /// Constraints of nodes that are not matched again, those in the open and of an imported map: they stay.
    pub constraints: &'a [Edge],
    /// By node: whether it is part of the map.
    pub in_map: &'a [bool],
}

/// Points of the map around a square, at their places, by node.
type Around = Vec<(usize, Vec<PlacedPoint>)>;

impl Refinement<'_> {
    /// Matches every node to the map of the present poses, and solves all poses again. `grid` is empty before and after.
    pub fn run(&self, grid: &mut MomentGrid, poses: &mut [Placement]) {
        let aligner = Aligner::new(AlignSettings { iterations: 6, ..AlignSettings::default() });
        let mut edges = self.odometry.to_vec();
        edges.extend_from_slice(self.constraints);
        let mut matches = Vec::new();
        self.for_each_node(grid, poses, |grid, around, node| {
            let points = self.scans.points(self.nodes[node].scan);
            let place = around.binary_search_by_key(&node, |(i, _)| *i);
            let own = place.map_or(&[][..], |place| &around[place].1);
            // It must not be matched to itself: it would stay where it is.
            grid.withdraw_placed(own);
            let found = aligner.align(grid, points, poses[node]);
            grid.add_placed(own);
            let accepted = found.filter(|found| is_accepted(found, &poses[node]));
            matches.extend(accepted.and_then(|found| held(&found, &poses[0], node)));
        });
        matches.sort_by_key(|edge| (square(&poses[edge.to], ORDER_M), edge.to));
        edges.extend(matches);
        let settings =
            RobustSettings { chi_squared_max: CHI_SQUARED_MAX, growth: 2.0, rounds: 12, warm_up: 2 };
        solve(self.nodes.len(), &edges, self.odometry.len(), &settings, poses);
    }

    /// Calls `visit` for each node of the map but the first, which is held, with the map around it in the grid.
    fn for_each_node(
        &self,
        grid: &mut MomentGrid,
        poses: &[Placement],
        mut visit: impl FnMut(&mut MomentGrid, &Around, usize),
    ) {
        let mut squares: BTreeMap<(i32, i32), Vec<usize>> = BTreeMap::new();
        for i in (1..self.nodes.len()).filter(|i| self.in_map[*i] && !self.nodes[*i].is_held()) {
            squares.entry(square(&poses[i], SQUARE_M)).or_default().push(i);
        }
        for ((row, column), members) in squares {
            let centre = ((f64::from(column) + 0.5) * SQUARE_M, (f64::from(row) + 0.5) * SQUARE_M);
            let around = self.around(poses, centre);
            around.iter().for_each(|(_, points)| grid.add_placed(points));
            members.into_iter().for_each(|i| visit(grid, &around, i));
            around.iter().for_each(|(_, points)| grid.withdraw_placed(points));
        }
    }

    /// The map's points in reach of a square, by node in ascending order.
    fn around(&self, poses: &[Placement], (x_m, y_m): (f64, f64)) -> Around {
        let in_reach = |i: usize| {
            let at = poses[i];
            let near = |p: &&PackedPoint| {
                let (x, y) = at.apply(p.x_m(), p.y_m());
                (x - x_m).abs() < REACH_M && (y - y_m).abs() < REACH_M
            };
            let points = self.scans.points(self.nodes[i].scan).iter().filter(near);
            points.map(|point| PlacedPoint::new(&at, *point)).collect::<Vec<_>>()
        };
        let nodes = (0..self.nodes.len()).filter(|i| self.in_map[*i]);
        nodes.map(|i| (i, in_reach(i))).filter(|(_, points)| !points.is_empty()).collect()
    }
}

/// Row and column of the square of this side that a pose is in.
fn square(at: &Placement, side_m: f64) -> (i32, i32) {
    let number = |metres: f64| (metres / side_m).floor() as i32;
    (number(at.y_m), number(at.x_m))
}

/// A match as an edge from node 0, whose pose is held.
fn held(found: &Alignment, origin: &Placement, node: usize) -> Option<Edge> {
    let mut information = found.information.map(|v| POINT_INFORMATION * v);
    // A direction that the points leave open must not make the matrix singular.
    [0, 3, 5].into_iter().for_each(|i| information[i] += 1.0);
    let information = inflated(&information, SLACK.0, SLACK.1)?;
    let motion = origin.to(found.placement);
    Some(Edge { from: 0, to: node, motion, information: in_frame(&information, origin) })
}

fn is_accepted(found: &Alignment, guess: &Placement) -> bool {
    found.inliers >= INLIERS_MIN
        && found.spread_m <= SPREAD_MAX_M
        && found.placement.distance_m(guess) <= MOVE_MAX.0
        && found.placement.turn_rad(guess) <= MOVE_MAX.1
}
